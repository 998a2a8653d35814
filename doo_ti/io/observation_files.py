"""Observations in files (docs/observations.md): read in any format, by suffix and, of CSV files, by their first lines; written
as arrays or tables.

Recordings of rods in motion, as ``identify`` and ``simulate`` take them, are in the same files, of which motion capture states
its rate; their .npz has positions_mm (R, T, V, 3) or (T, V, 3), rate_hz, and optionally recording (R,) names and up (3,).

Axes: D observations, R recordings, T frames, V markers.
"""

import hashlib
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from doo_ti.io.arrays import read_npz
from doo_ti.io.curves import Curves, is_motive, is_nexus, is_polyline, read_motive, read_nexus, read_polylines
from doo_ti.io.foreign import read_mujoco, read_usd
from doo_ti.io.observation_tables import KEYS_IN_TABLES, LABELS, RENAMED, read_table, write_table
from doo_ti.io.pose_table import put_frames
from doo_ti.rod.material import mm_in
from doo_ti.rod.observations import KEYS, LENGTHS, Observations
from doo_ti.rod.types import unit_up
from doo_ti.system.arguments import typed
from doo_ti.system.errors import InputError, real_array, require
from doo_ti.system.files import MOST_BYTES, MOST_TEXT_BYTES, read_content, write_whole
from doo_ti.system.terminal import in_line

TABLES = (".csv", ".parquet")
OWN = (".npz", *TABLES)  # suffixes of files that the package also writes
OF_OTHERS = {".txt": read_polylines, ".xyz": read_polylines, ".xml": read_mujoco,
             ".usd": read_usd, ".usda": read_usd, ".usdc": read_usd}
NAMES = ("name", "names")  # keys of an npz that name its observations, as those of perceive do
VERDICT, LIKELY = "verdict", 1  # key of files of perceive and track; higher ones are ambiguous or not found
WHOLE = ("rest_length", "up", "spacing_error")  # fields that are the same in all observations
MOST_CSV_BYTES = 1 << 28  # reading CSV takes about fifteen times as much memory
MOST_LEFT_OUT = 10  # frames of a recording in all for each that is there


def checked_suffix(path: Path, known: tuple[str, ...] = OWN) -> None:
    """Raise InputError unless the suffix of ``path`` is ``known``."""
    require(path.suffix in known, path, "file", f"suffix {path.suffix!r} is not a format of observations",
            f"use one of {', '.join(known)}")


def read_keys(path: Path, columns=None) -> tuple[bytes, dict[str, np.ndarray]]:
    """The bytes of a file, and its keys of the npz format. ``unit`` among them: mm in the unit that the file states.

    columns  as in :func:`doo_ti.io.observation_files.load_observations`

    Raises InputError for files that cannot be read, and for ``columns`` that do not fit the format.
    """
    content, read = _opened(path)
    if read is not None:
        curves = read(path, content, _names(path, columns))
        return content, curves.keys() | {"unit": curves.unit}
    if path.suffix == ".npz":
        require(columns is None, path, "columns", "an npz has keys", "leave `columns` out")
        keys = read_npz(path, content, (*KEYS_IN_TABLES, LABELS, *NAMES))
        lists = [keys.pop(key) for key in NAMES if key in keys]
        names = next((one for one in lists if one.dtype.kind == "U" and one.ndim == 1), None)
        if names is not None:  # what messages call the observations
            keys.setdefault(LABELS, names)
    else:
        keys = read_table(path, content, _renamed(path, columns))
    put_frames(path, keys, "frame")  # of grippers whose x axis points along the rod
    return content, keys


def read_curves(path: Path, columns=None) -> Curves | None:
    """The curves of a file of another program, or None of a file in a format of this package. Raises as :func:`read_keys`."""
    content, read = _opened(path)
    return None if read is None else read(path, content, _names(path, columns))


def _opened(path: Path) -> tuple[bytes, Callable[..., Curves] | None]:
    """The bytes of a file, and the reader of curves for it; None where it is in a format of this package."""
    if os.path.isfile(path):  # else the reason is that it is missing, or a folder
        checked_suffix(path, (*OWN, *OF_OTHERS))
    most = MOST_CSV_BYTES if path.suffix == ".csv" else MOST_TEXT_BYTES if path.suffix in OF_OTHERS else MOST_BYTES
    content = read_content(path, most)
    require(content, path, "file", "0 bytes, the file is empty", "write the observations again")
    if path.suffix != ".csv":
        return content, OF_OTHERS.get(path.suffix)
    readers = ((is_motive, read_motive), (is_nexus, read_nexus), (is_polyline, read_polylines))
    return content, next((read for fits, read in readers if fits(content)), None)


def _names(path: Path, columns) -> list[str] | None:
    require(not isinstance(columns, Mapping), path, "columns", "the file is not a table of vertices",
            "name its markers or curves in their order along the rod: A,B,C")
    return None if columns is None else list(columns)


def _renamed(path: Path, columns) -> dict[str, str]:
    if columns is None:
        return {}
    unknown = [name for name in columns if name not in RENAMED]
    require(not unknown and isinstance(columns, Mapping), path, "columns", f"{','.join(unknown or columns)!r}",
            f"give NAME=COLUMN for some of {', '.join(RENAMED)}")
    return dict(columns)


@typed
def load_observations(path: str | os.PathLike[str], up: ArrayLike | None = None, unit: str | None = None,
                      columns: Mapping[str, str] | Sequence[str] | None = None, without_lost: bool = False) -> Observations:
    """Read and check observations of an ``.npz``, ``.csv`` or ``.parquet`` file, or curves of another program: motion capture
    of OptiTrack and Vicon, MuJoCo cables, USD curves, plain polylines (docs/observations.md).

    up       (3,) direction against gravity, instead of the file's
    unit     "mm", "cm", "m" or "in": the unit of all lengths in the file, whatever it states itself
    columns  of a table: {"x": "PosX", …}, the columns that hold x, y, z, observation and vertex where they have other names;
             of other files: names of markers or curves, in their order along the rod
    without_lost  leave out observations with fewer than two marks, which are else an error

    Raises InputError for a file that cannot be read and for whatever :class:`Observations` refuses.
    """
    path = Path(path)
    with np.errstate(over="ignore"):  # what is no longer finite in mm is refused below
        content, keys = read_keys(path, columns)
        values = {name: keys[key] if name == "labels" else real_array(path, key, keys[key], "store real numbers", "fiub")
                  for name, key in KEYS.items() if key in keys}
        if "total_twist" in values and values["total_twist"].dtype.kind != "b":
            values["total_twist"] = np.radians(values["total_twist"].astype(np.float64))
        if unit is not None:
            factor = mm_in(unit, "load_observations") / keys.get("unit", 1.0)
            values |= {name: value * factor for name, value in values.items() if name in LENGTHS and value.dtype.kind != "b"}
    require("vertices_mm" in keys, path, "vertices_mm", "the key is missing", "store the vertices as vertices_mm (D, V, 3)")
    if without_lost:
        values = _without_lost(values)
    observations = Observations(**values, name=in_line(path.stem), source=str(path), sha256=hashlib.sha256(content).hexdigest())
    if observations.total_twist is not None:
        most, degrees = 180.0 * (observations.edges - 1), np.degrees(observations.total_twist)  # half a turn at each joint
        bad = np.flatnonzero(np.abs(degrees) > most * (1.0 + 1e-12))
        if len(bad):
            hint = f"{degrees[bad[0]]:g} of observation {observations.labels[bad[0]]}"
            raise InputError(path, "total_twist_deg", hint, f"give degrees; {observations.edges} edges hold at most {most:g}")
    return observations if up is None else replace(observations, up=np.asarray(up))


def rows_with_marks(path: str | os.PathLike[str], columns: Mapping[str, str] | Sequence[str] | None = None) -> np.ndarray:
    """(D,) bool: which observations of a file :func:`load_observations` returns ``without_lost``."""
    keys = read_keys(Path(path), columns)[1]
    return _with_marks({name: keys[key] for name, key in KEYS.items() if key in keys})


def ambiguous_rods(path: str | os.PathLike[str], count: int) -> np.ndarray:
    """(D,) bool: which of ``count`` observations are rods of ``perceive`` or ``track`` that are neither clear nor likely."""
    path = Path(path)
    known = read_npz(path, read_content(path, remedy="name a readable file"), (VERDICT,)) if path.suffix == ".npz" else {}
    verdict = known.get(VERDICT, np.zeros(0))
    return verdict > LIKELY if verdict.shape == (count,) and verdict.dtype.kind == "i" else np.zeros(count, dtype=bool)


def _with_marks(values: dict) -> np.ndarray:
    """(D,) bool: the observations of two marks or more; all where none has them, or ``values`` have not the shapes that
    :class:`Observations` demands."""
    vertices, count = values["vertices"], len(values["vertices"]) if values["vertices"].ndim == 3 else 0
    seen = ~np.isnan(vertices).any(axis=-1)
    valid = values.get("valid", seen)
    each = [value for name, value in values.items() if name not in WHOLE and value.ndim]
    if valid.shape != seen.shape or any(len(value) != count for value in each):
        return np.ones(count, dtype=bool)
    enough = (seen & valid.astype(bool)).sum(axis=-1) >= 2
    return enough if enough.any() else ~enough


def _without_lost(values: dict) -> dict:
    """``values`` of a file without its observations of one mark or none, labelled as they were numbered."""
    enough = _with_marks(values)
    if enough.all():
        return values
    values = {"labels": np.arange(len(enough))} | values
    return {name: value if name in WHOLE or not value.ndim else value[enough] for name, value in values.items()}


@typed
def save_observations(path: str | os.PathLike[str], observations: Observations) -> None:
    """Write ``observations`` to an ``.npz``, ``.csv`` or ``.parquet`` file, whole or not at all. Raises InputError for another
    suffix."""
    path = Path(path)
    checked_suffix(path)
    keys = {KEYS[field.name]: getattr(observations, field.name) for field in fields(observations) if field.name in KEYS}
    if observations.valid.all():
        keys["valid"] = None
    if observations.spacing_error == 0:
        keys["spacing_error"] = None
    if np.array_equal(observations.labels, np.arange(observations.count)):
        keys["observation"] = None
    if observations.total_twist is not None:
        keys["total_twist_deg"] = np.degrees(observations.total_twist)
    keys = {key: value for key, value in keys.items() if value is not None}
    if path.suffix in TABLES:
        write_whole(path, lambda file: write_table(file, path.suffix, keys))
    else:
        write_whole(path, lambda file: np.savez_compressed(file, **keys))


@dataclass(frozen=True)
class MotionRecording:
    """What a file of recordings holds.

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
    path, stated = Path(path), None if unit is None else mm_in(unit, "RecordedMotion.load")
    if path.suffix == ".npz":
        require(columns is None, path, "columns", "the file has no columns", "leave `columns` out")
        return _of_arrays(path, rate, 1.0 if stated is None else stated)
    curves = read_curves(path, columns)
    if curves is not None and curves.rate is not None:
        factor = curves.unit if stated is None else stated
        labels = np.arange(len(curves.points)) if curves.labels is None else curves.labels
        frames, points = _every_frame(path, labels, curves.points)
        return MotionRecording(factor * points, rate or curves.rate, up=np.array(curves.up), frames=frames)
    require(rate is not None, path, "rate", "the file states no frames per second", "give `rate`")
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
    require(count <= MOST_LEFT_OUT * len(labels), path, "observation", f"frames {labels[0]} to {labels[-1]}, of which "
            f"{len(labels)} are there", "number the frames from one to the next")
    whole = np.full((count, *positions.shape[1:]), np.nan)
    whole[place] = positions
    return labels[0] + step * np.arange(count), whole


def _of_arrays(path: Path, rate: float | None, unit: float) -> MotionRecording:
    """The recordings of an npz, its lengths in a ``unit`` of so many mm."""
    found = read_npz(path, read_content(path), ("positions_mm", "rate_hz", "recording", "up"))
    if rate is not None:
        found["rate_hz"] = np.float64(rate)
    for key in ("positions_mm", "rate_hz"):
        require(key in found, path, key, "missing", "give positions_mm (R, T, V, 3) or (T, V, 3) and rate_hz")
        found[key] = real_array(path, key, found[key], "store real numbers")
    positions, names = unit * found["positions_mm"].astype(np.float64), found.get("recording")
    if found["rate_hz"].size != 1:
        raise InputError(path, "rate_hz", f"shape {found['rate_hz'].shape}", "give one number: frames per second")
    count = 1 if positions.ndim == 3 else len(positions) if positions.ndim else 0
    if names is not None and names.shape != (count,):
        raise InputError(path, "recording", f"shape {names.shape}", f"give ({count},) names")
    up = unit_up(found["up"], str(path)) if "up" in found else None
    return MotionRecording(positions, float(found["rate_hz"].reshape(())), None if names is None else names.tolist(), up)
