"""Recordings of rods in motion, as ``identify`` and ``simulate`` take them, from their files:

    .npz               positions_mm (R, T, V, 3) or (T, V, 3), rate_hz; optionally recording (R,) names, up (3,)
    .csv of motion capture (OptiTrack Motive, Vicon Nexus)
    .csv, .parquet     a row for each mark of a frame, and other files of observations; they state no rate

Axes: R recordings, T frames, V markers.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from doo_ti.io.arrays import read_npz
from doo_ti.io.observation_files import load_observations, read_curves
from doo_ti.rod.physical_units import UNITS_IN_MM
from doo_ti.rod.types import unit_up
from doo_ti.system.errors import InputError
from doo_ti.system.files import read_content

MOST_LEFT_OUT = 10
"""Frames in all for each that is there."""


@dataclass(frozen=True)
class MotionRecording:
    """What a file holds.

    positions  (R, T, V, 3), or (T, V, 3) of a single recording, mm; NaN where a marker was not seen
    rate       frames per second
    names      (R,), or None
    up         (3,) unit vector against gravity, or None where the file states none
    frames     (T,) what the file calls the frames, or None: 0, 1, …
    """

    positions: np.ndarray
    rate: float
    names: list | None = None
    up: np.ndarray | None = None
    frames: np.ndarray | None = None


def read_recording(path: str | Path, unit: str | None = None, columns: Mapping[str, str] | Sequence[str] | None = None,
                   rate: float | None = None) -> MotionRecording:
    """The recordings in a file.

    unit, columns  as of :func:`doo_ti.io.observation_files.load_observations`
    rate           frames per second, instead of what the file states

    Raises InputError for files that cannot be read, and where neither the file nor ``rate`` states the rate.
    """
    path = Path(path)
    if path.suffix == ".npz":
        if columns is not None:
            raise InputError(path, "columns", "the file has no columns", "leave `columns` out")
        return _of_arrays(path, rate, 1.0 if unit is None else UNITS_IN_MM[unit])
    curves = read_curves(path, columns)
    if curves is not None and curves.rate is not None:
        factor = curves.unit if unit is None else UNITS_IN_MM[unit]
        labels = np.arange(len(curves.points)) if curves.labels is None else curves.labels
        frames, points = _every_frame(path, labels, curves.points)
        return MotionRecording(factor * points, rate or curves.rate, up=np.array(curves.up), frames=frames)
    if rate is None:
        raise InputError(path, "rate", "the file states no frames per second", "give `rate`")
    observations = load_observations(path, None, unit, columns)
    frames, positions = _every_frame(path, observations.labels, observations.vertices)
    return MotionRecording(positions, rate, up=observations.up, frames=frames)


def _every_frame(path: Path, labels: np.ndarray, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The numbers of all frames (T,) and their positions (T, V, 3), NaN in those that the file leaves out: frames are as far
    apart as the numbers that it has allow, so that 2, 4, 8 lack 6."""
    if labels.dtype.kind not in "iu" or len(labels) < 2:
        return labels, positions
    step = np.gcd.reduce(np.diff(labels))
    place = (labels - labels[0]) // step
    count = int(place[-1]) + 1
    if count > MOST_LEFT_OUT * len(labels):
        raise InputError(path, "observation", f"frames {labels[0]} to {labels[-1]}, of which {len(labels)} are there",
                         "number the frames from one to the next")
    whole = np.full((count, *positions.shape[1:]), np.nan)
    whole[place] = positions
    return labels[0] + step * np.arange(count), whole


def _of_arrays(path: Path, rate: float | None, unit: float) -> MotionRecording:
    """The recordings of an npz, its lengths in a ``unit`` of so many mm."""
    found = read_npz(path, read_content(path), ("positions_mm", "rate_hz", "recording", "up"))
    if rate is not None:
        found["rate_hz"] = np.float64(rate)
    for key in ("positions_mm", "rate_hz"):
        if key not in found:
            raise InputError(path, key, "missing", "give positions_mm (R, T, V, 3) or (T, V, 3) and rate_hz")
        if found[key].dtype.kind not in "fiu":
            raise InputError(path, key, f"dtype {found[key].dtype} is not numeric", "store real numbers")
    positions, names = unit * found["positions_mm"].astype(np.float64), found.get("recording")
    if found["rate_hz"].size != 1:
        raise InputError(path, "rate_hz", f"shape {found['rate_hz'].shape}", "give one number: frames per second")
    count = 1 if positions.ndim == 3 else len(positions) if positions.ndim else 0
    if names is not None and names.shape != (count,):
        raise InputError(path, "recording", f"shape {names.shape}", f"give ({count},) names")
    up = unit_up(found["up"], str(path)) if "up" in found else None
    return MotionRecording(positions, float(found["rate_hz"].reshape(())), None if names is None else names.tolist(), up)
