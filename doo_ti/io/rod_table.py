"""The arrays of a result as a CSV file, one row per vertex of each rod.

    axes of the rods (observation, or moment and rod), vertex, x_mm, y_mm, z_mm, then the other arrays:
    of a vertex                    its own value
    of an edge                     at the vertex where it begins, empty at the last one; frames in nine columns
    of a rod, or one of its axes   repeated in all rows of the rod
    of several numbers             NAME_0, NAME_1, …; of forces and moments NAME_x, NAME_y, NAME_z

A table that ``relax``, ``perceive`` or ``track`` wrote can be read as observations.
"""

from typing import BinaryIO

import numpy as np

from doo_ti.io.arrays import AXES, frame_columns
from doo_ti.io.observation_tables import KEYS_IN_TABLES

POSITIONS = ("vertices_mm", "positions_mm")
OWNERS = {"time_s": "first axis", "recording": "first axis", "rest_length_mm": "file", "up": "file", "rate_hz": "file"}
"""Of arrays whose shape alone does not tell; others belong to rods, or to the last axis of the rods."""
OF_EDGES = ("rest_length_mm", "frames", "unsupported")
VECTORS = ("start_force", "start_moment", "end_force", "end_moment", "up")
OF_VERTICES = ("valid", "sigma_mm", *POSITIONS)


def write_rod_table(file: BinaryIO, arrays: dict[str, np.ndarray], axes: tuple[str, ...]) -> list[str]:
    """Write ``arrays`` to ``file``; returns the names of those that have no place in the table.

    axes  names of the leading axes of the positions, such as ("moment", "rod")
    """
    shape = next(arrays[name] for name in POSITIONS if name in arrays).shape[:-1]  # (*rods, V)
    index = np.indices(shape)
    columns = {name: index[place].ravel() for place, name in enumerate((*axes, "vertex"))}
    left_out = []
    for name, value in arrays.items():
        spread = _per_vertex(name, np.asarray(value), shape)
        if spread is None or spread.ndim > len(shape) + 1 and spread.shape[len(shape) :] != (3, 3):
            left_out.append(name)
            continue
        inner = spread.shape[len(shape) :]
        spread = spread.reshape(index[0].size, -1)
        columns |= {column: spread[:, place] for place, column in enumerate(_names(name, inner))}
    write_columns(file, columns)
    return left_out


def write_columns(file: BinaryIO, columns: dict[str, np.ndarray]) -> None:
    """Write columns of equal length as CSV; NaN is an empty cell."""
    import pyarrow
    import pyarrow.csv

    pyarrow.csv.write_csv(pyarrow.table({
        name: pyarrow.array(values, mask=np.isnan(values) if values.dtype.kind == "f" else None)
        for name, values in columns.items()}), file)


def _per_vertex(name: str, value: np.ndarray, shape: tuple[int, ...]) -> np.ndarray | None:
    """(*shape, …) the value of every vertex, or None where ``value`` does not fit."""
    rods, marks = shape[:-1], shape[-1]
    owner = OWNERS.get(name, "rod" if value.shape[: len(rods)] == rods else "last axis")
    if owner == "first axis" and value.shape == rods[:1]:
        value = value.reshape(-1, *[1] * (len(rods) - 1))
    if owner == "last axis" and value.shape not in ((), rods[-1:]):
        return None
    if owner != "rod":
        value = np.broadcast_to(value, (*rods, *value.shape) if owner == "file" else rods)
    inner = value.shape[len(rods) :]
    if name in OF_VERTICES and inner[:1] == (marks,):
        return value
    if name in OF_EDGES:
        last = np.full((*rods, 1, *inner[1:]), np.nan)
        return np.concatenate([value.astype(np.float64), last], axis=len(rods))
    return np.broadcast_to(value.reshape(*rods, 1, *inner), (*shape, *inner))


def _names(name: str, inner: tuple[int, ...]) -> tuple[str, ...]:
    """The columns of an array with ``inner`` numbers for each vertex."""
    if name in POSITIONS:
        return KEYS_IN_TABLES["vertices_mm"][2]
    if name in KEYS_IN_TABLES:
        return KEYS_IN_TABLES[name][2]
    if inner == (3, 3):
        return frame_columns(name)
    return (name,) if not inner else tuple(f"{name}_{end}" for end in (AXES if name in VECTORS else range(*inner)))
