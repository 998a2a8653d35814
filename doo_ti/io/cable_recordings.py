"""Recordings of the public cable data (Chen et al., CoRL 2024, docs/cables.md): a pickle each, turned into one npz.

Axes: R recordings, T frames, V markers.
"""

import os
from pathlib import Path

import numpy as np

from doo_ti.io.pickled_arrays import read_pickled_array
from doo_ti.rod.types import LARGEST
from doo_ti.system.errors import InputError
from doo_ti.system.files import write_whole

RATE_HZ = 100.0
"""Of the published recordings; their files do not contain it."""
MOST_RECORDINGS = 10_000


def read_recordings(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Positions (R, T, V, 3) float32 in mm, and names (R,), of one pickle or of all in a folder, in the order of their numbers.

    Each pickle holds T frames (3, V) in m. Raises InputError for other content, and for recordings of different shapes.
    """
    path = Path(path)
    paths = [path] if not os.path.isdir(path) else sorted(path.glob("*.pkl"), key=_number)
    if not 1 <= len(paths) <= MOST_RECORDINGS:
        raise InputError(path, "folder", f"{len(paths)} files *.pkl", "name a folder of recordings")
    found = []
    for each in paths:
        frames = read_pickled_array(each)
        if frames.ndim != 3 or frames.shape[1] != 3 or min(frames.shape) < 2:
            raise InputError(each, "positions", f"shape {frames.shape}", "give frames (T, 3, V) in m")
        if not (np.abs(frames) <= LARGEST).all():
            raise InputError(each, "positions", "not finite", "give finite numbers")
        if found and frames.shape != found[0].shape:
            raise InputError(each, "positions", f"shape {frames.shape} beside {found[0].shape}",
                             "give recordings of equal length and equally many markers")
        found.append(frames)
    names = [each.stem for each in paths]
    numbers = np.array(names, dtype=np.int64) if all(name.isdecimal() and len(name) < 10 for name in names) else np.array(names)
    return (1e3 * np.swapaxes(np.stack(found), 2, 3)).astype(np.float32), numbers


def save_recordings(path: Path, positions: np.ndarray, names: np.ndarray) -> None:
    """Write what ``doo-ti identify`` and ``doo-ti simulate`` read: ``positions_mm``, ``rate_hz``, ``recording``."""
    write_whole(path, lambda file: np.savez_compressed(file, positions_mm=positions, rate_hz=RATE_HZ, recording=names))


def _number(path: Path) -> tuple[int, str]:
    return (int(path.stem), "") if path.stem.isdecimal() and len(path.stem) < 10 else (1 << 40, path.stem)
