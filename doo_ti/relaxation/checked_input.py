"""Checks of the input of ``relax`` before any work (§III-B): shapes, kinds of clamps, and the rows that make up each rod.

Raises InputError that names the argument, its value and a remedy.
"""

import numpy as np

from doo_ti.relaxation.external import External
from doo_ti.relaxation.point_loads import PointLoads
from doo_ti.rod.types import Clamps, Configuration, Material
from doo_ti.system.errors import InputError, real_array


def check_shapes(configuration: Configuration, clamps: Clamps) -> None:
    """Raise InputError unless starts and clamps are tables of the same rods, of two edges at least."""
    if configuration.quaternions.dtype.kind != "f":
        raise InputError("configuration", "quaternions", "not an array of floating-point numbers", "give an array (R, E, 4)")
    if configuration.edges < 2:
        raise InputError("configuration", "quaternions", f"{configuration.edges} edges", "give two or more")
    if len(clamps.start_position) != configuration.count:
        raise InputError("clamps", "start_position", f"{len(clamps.start_position)} rows for {configuration.count} starts",
                         "give a row for each start")


def rest_lengths(configuration: Configuration) -> np.ndarray:
    """(1 or S, E) rest lengths. Raises InputError where they are not positive; those of the first and of the last edge may be
    zero, where at least two others are between them."""
    lengths = real_array("configuration", "rest_length", configuration.rest_length, "give positive lengths in mm")
    # A copy: the result must not change when the caller's array does.
    lengths = np.array(lengths, dtype=np.float64, order="C")
    if lengths.ndim == 1:
        lengths = lengths[None]
    wrong = ~((lengths > 0) & (lengths < np.inf))
    if not wrong.any():
        return lengths
    wrong[:, [0, -1]] &= lengths[:, [0, -1]] != 0
    if wrong.any():
        raise InputError("configuration", "rest_length", f"{lengths[wrong][0]:g}",
                         "give positive lengths in mm; only the first and the last edge may have none")
    if ((lengths > 0).sum(axis=1) < 2).any():
        raise InputError("configuration", "rest_length", "fewer than two edges with a length", "give more edges")
    return lengths


def check_material(material: Material, edges: int, floating: bool) -> None:
    """Raise InputError where ``material`` does not fit that many edges, or has weight while a rod has two free ends
    (``floating``)."""
    if floating and (material.weight > 0).any():
        raise InputError("clamps", "start, end", "both ends are free and the rod has weight", "hold one end, or set weight 0")
    for name, array, length in (("twist", material.twist, edges - 1), ("bend", material.bend, edges)):
        if array.shape[1] not in (1, length):
            raise InputError("material", name, f"{array.shape[1]} entries along the rod", f"give one or {length}")
    rest = material.rest_curvature
    if rest is not None and rest.shape[1] not in (1, edges - 1):
        raise InputError("material", "rest_curvature", f"{rest.shape[1]} joints", f"give one or {edges - 1}")


def clamp_kinds(clamps: Clamps, count: int) -> np.ndarray:
    """(S, 2) Clamp numbers of both ends."""
    kinds = np.empty((count, 2), dtype=np.int64)
    kinds[:, 0], kinds[:, 1] = clamps.start, clamps.end
    return kinds


def paired_rows(configurations: int, materials: int, configuration_index, material_index, function: str = "relax"
                ) -> tuple[np.ndarray, np.ndarray]:
    """The two index vectors, (R,) each. Tables without one are paired one to one with the rods that the other makes, without
    either with each other; a single row with every row. Raises InputError, naming ``function``."""
    first = None if configuration_index is None else _row_numbers("configuration_index", configuration_index, function)
    second = None if material_index is None else _row_numbers("material_index", material_index, function)
    if first is None and second is None:
        if configurations != materials and 1 not in (configurations, materials):
            raise InputError(function, "material", f"{materials} rows for {configurations} rods", "give one, or one per rod")
        count = min(configurations, materials) and max(configurations, materials)
        return np.arange(count) % max(configurations, 1), np.arange(count) % max(materials, 1)
    if first is None:
        first = _one_each("configuration", configurations, second, "configuration_index", function)
    elif second is None:
        second = _one_each("material", materials, first, "material_index", function)
    elif first.shape != second.shape:
        if first.size != 1 and second.size != 1:
            raise InputError(function, "material_index", f"shape {second.shape} beside {first.shape} of configuration_index",
                             "give (R,) row numbers both")
        first, second = np.broadcast_arrays(first, second)
    for name, index, size in (("configuration_index", first, configurations), ("material_index", second, materials)):
        if index.ndim != 1 or (index.size and (index.min() < 0 or index.max() >= size)):
            raise InputError(function, name, f"not a vector of rows below {size}", "give (R,) row numbers")
    return np.ascontiguousarray(first), np.ascontiguousarray(second)


def _one_each(name: str, rows: int, other: np.ndarray, missing: str, function: str) -> np.ndarray:
    """Of the shape of the ``other`` index, row k of a table for rod k, or its single row."""
    if rows not in (1, other.size):
        raise InputError(function, name, f"{rows} rows for {other.size} rods", f"give one, one per rod, or {missing}")
    return (np.arange(other.size) % rows).reshape(other.shape)


def external_rows(external: External | None, index, count: int, edges: int) -> np.ndarray:
    """(R,) rows of the external energy; without ``index`` rods and rows are paired one to one, or all have the one row."""
    if external is None:
        if index is not None:
            raise InputError("relax", "external_index", "given without an external energy", "give both, or neither")
        return np.zeros(count, dtype=np.int64)
    if external.vertices not in (None, edges + 1):
        raise InputError("external", "points", f"{external.vertices} vertices", f"give {edges + 1}, as the rods have")
    if index is None:
        if external.count not in (1, count):
            raise InputError("relax", "external", f"{external.count} rows for {count} rods", "give one, or one for each rod")
        return np.arange(count) % external.count
    rows = _row_numbers("external_index", index, "relax")
    if rows.shape != (count,) or (rows.size and (rows.min() < 0 or rows.max() >= external.count)):
        raise InputError("relax", "external_index", f"not {count} rows below {external.count}", "give (R,) row numbers")
    return rows


def loads_along(loads: PointLoads, up: np.ndarray, floating: bool) -> PointLoads:
    """``loads`` whose masses hang against ``up``. Raises InputError where nothing holds a rod (``floating``)."""
    if floating and loads.springs is None:
        raise InputError("clamps", "start, end", "both ends are free under point loads", "hold one end, or give springs too")
    return loads.hanging(up)


def _row_numbers(name: str, value, function: str) -> np.ndarray:
    """``value`` as an int64 array. Raises InputError for anything but whole numbers."""
    rows = real_array(function, name, value, "give (R,) row numbers")
    if rows.size and rows.dtype.kind not in "iu":
        raise InputError(function, name, f"dtype {rows.dtype}", "give whole row numbers")
    return rows.astype(np.int64)
