"""Observations in files: read in any format, written as arrays or tables (docs/observations.md)."""

import hashlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from doo_ti.io.formats import TABLES, checked_suffix, read_keys
from doo_ti.io.observation_tables import write_table
from doo_ti.rod.observations import KEYS, LENGTHS, Observations
from doo_ti.rod.physical_units import UNITS_IN_MM
from doo_ti.system.arguments import typed
from doo_ti.system.errors import InputError, real_array
from doo_ti.system.files import write_whole
from doo_ti.system.terminal import in_line


@typed
def load_observations(path: str | os.PathLike[str], up: ArrayLike | None = None, unit: str | None = None,
                      columns: Mapping[str, str] | Sequence[str] | None = None, without_lost: bool = False) -> Observations:
    """Read and check observations of an ``.npz``, ``.csv`` or ``.parquet`` file, or curves of another program: motion capture
    of OptiTrack and Vicon, MuJoCo cables, USD curves, plain polylines (docs/observations.md).

    up       (3,) direction against gravity, instead of the file's
    unit     "mm", "cm" or "m": the unit of all lengths in the file, whatever it states itself
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
            values = _in_mm(values, keys.get("unit", 1.0), unit)
    if "vertices_mm" not in keys:
        raise InputError(path, "vertices_mm", "the key is missing", "store the vertices as vertices_mm (D, V, 3)")
    if without_lost:
        values = _without_lost(values)
    observations = Observations(**values, name=in_line(path.stem), source=str(path), sha256=hashlib.sha256(content).hexdigest())
    if observations.total_twist is not None:
        _check_turns(observations)
    return observations if up is None else replace(observations, up=np.asarray(up))


def _in_mm(values: dict, read_as: float, unit: str) -> dict:
    """``values`` with all lengths taken to be in ``unit``; they were read as ``read_as`` mm."""
    if unit not in UNITS_IN_MM:
        raise InputError("load_observations", "unit", f"{unit!r}", f"give one of {', '.join(UNITS_IN_MM)}")
    factor = UNITS_IN_MM[unit] / read_as
    return {name: value * factor if name in LENGTHS and value.dtype.kind != "b" else value for name, value in values.items()}


def _without_lost(values: dict) -> dict:
    """``values`` of a file without its observations of one mark or none; as they are where that leaves none, or they have not
    the shapes that :class:`Observations` demands."""
    vertices, count = values["vertices"], len(values["vertices"]) if values["vertices"].ndim == 3 else 0
    seen = ~np.isnan(vertices).any(axis=-1)
    valid = values.get("valid", seen)
    if not count or valid.shape != seen.shape:
        return values
    enough = (seen & valid.astype(bool)).sum(axis=1) >= 2
    whole = "rest_length", "up", "spacing_error"
    if not enough.any() or any(len(value) != count for name, value in values.items() if name not in whole and value.ndim):
        return values
    values = {"labels": np.arange(count)} | values
    return {name: value if name in whole or not value.ndim else value[enough] for name, value in values.items()}


def _check_turns(observations: Observations) -> None:
    """Raise InputError for a total twist above half a turn at each joint."""
    most = 180.0 * (observations.edges - 1)
    degrees = np.degrees(observations.total_twist)
    bad = np.flatnonzero(np.abs(degrees) > most * (1.0 + 1e-12))
    if len(bad):
        hint = f"{degrees[bad[0]]:g} of observation {observations.labels[bad[0]]}"
        raise InputError(observations.source, "total_twist_deg", hint,
                         f"give degrees; {observations.edges} edges hold at most {most:g}")


@typed
def save_observations(path: str | os.PathLike[str], observations: Observations) -> None:
    """Write ``observations`` to an ``.npz``, ``.csv`` or ``.parquet`` file, whole or not at all.

    Raises InputError for another suffix.
    """
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
