"""The input of ``relax``, checked before any work, as tables (§III-B).

Raises InputError that names the argument, its value and a remedy.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from doo_ti.contact.obstacles import Obstacle
from doo_ti.contact.surroundings import Surroundings
from doo_ti.relaxation import tables as of
from doo_ti.relaxation.bows import projectable
from doo_ti.relaxation.clamp_table import INFEASIBLE, clamp_table
from doo_ti.relaxation.contact_table import contact_table
from doo_ti.relaxation.external import External, PointLoads
from doo_ti.relaxation.newton_policy import MOST_SHIFT
from doo_ti.relaxation.tables import FREE, Tables, rod_rows, room
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
        raise InputError("clamps", "start, end", "both ends are free and the rod has weight",
                         "hold one end, set weight 0, or `simulate` it coming to rest")
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
        first = _one_each("configuration", configurations, second, function)
    elif second is None:
        second = _one_each("material", materials, first, function)
    elif first.shape != second.shape:
        if first.size != 1 and second.size != 1:
            raise InputError(function, "material_index", f"shape {second.shape} beside {first.shape} of configuration_index",
                             "give (R,) row numbers both")
        first, second = np.broadcast_arrays(first, second)
    for name, index, size in (("configuration_index", first, configurations), ("material_index", second, materials)):
        if index.ndim != 1 or (index.size and (index.min() < 0 or index.max() >= size)):
            raise InputError(function, name, f"not a vector of rows below {size}", "give (R,) row numbers")
    return np.ascontiguousarray(first), np.ascontiguousarray(second)


def _one_each(name: str, rows: int, other: np.ndarray, function: str) -> np.ndarray:
    """Of the shape of the ``other`` index, row k of a table for rod k, or its single row."""
    if rows not in (1, other.size):
        raise InputError(function, name, f"{rows} rows for {other.size} rods", f"give one, one per rod, or {name}_index")
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
        return _one_each("external", external.count, np.arange(count), "relax")
    rows = _row_numbers("external_index", index, "relax")
    if rows.shape != (count,) or (rows.size and (rows.min() < 0 or rows.max() >= external.count)):
        raise InputError("relax", "external_index", f"not {count} rows below {external.count}", "give (R,) row numbers")
    return rows


def _row_numbers(name: str, value, function: str) -> np.ndarray:
    """``value`` as an int64 array. Raises InputError for anything but whole numbers."""
    rows = real_array(function, name, value, "give (R,) row numbers")
    if rows.size and rows.dtype.kind not in "iu":
        raise InputError(function, name, f"dtype {rows.dtype}", "give whole row numbers")
    return rows.astype(np.int64)


UNEVEN = MOST_SHIFT
"""Of the largest stiffness of a rod to its smallest, above which it is relaxed with evener ones first (:func:`evened`): up to
there no shift is limited (:meth:`.Loading.shift_share`)."""
RATIOS = (1e2, 1e4, 1e6, 1e8)  # of their stiffness then, one after the other


def tables(
    configuration: Configuration, material: Material, clamps: Clamps, up: np.ndarray, pairs: tuple = (None, None),
    external: External | None = None, external_index=None, obstacles: Sequence[Obstacle] = (), radius=None,
    in_motion: bool = False,
) -> Tables:
    """Check the input of F and lay it out for the kernels; ``pairs``: the rows of configuration and of material of each rod, or
    None (:func:`paired_rows`).

    Raises InputError where shapes do not match, an index is out of range, or both ends of a rod with weight are free that no
    external energy holds.
    """
    check_shapes(configuration, clamps)
    count, edges = configuration.count, configuration.edges
    lengths = rest_lengths(configuration)
    index_c, index_m = paired_rows(count, material.count, *pairs)
    rods = len(index_c)
    if max(count, rods) * edges * 4 > of.MOST_NUMBERS:
        raise InputError("relax", "configuration", f"{max(count, rods):,} rods of {edges} edges in one call",
                         f"give at most {of.MOST_NUMBERS // (4 * edges):,} at a time")
    index_e = external_rows(external, external_index, rods, edges)
    kinds = clamp_kinds(clamps, count)
    floating = not kinds.any(axis=1).all()
    if isinstance(external, PointLoads):
        if floating and external.springs is None:
            raise InputError("clamps", "start, end", "both ends are free under point loads",
                             "hold one end, or give springs too")
        external = external.hanging(up)
    check_material(material, edges, floating and external is None)
    clamp, found = clamp_table(configuration, lengths, kinds, clamps)
    if (external is not None or obstacles) and (kinds[:, 0] == FREE).any():
        _loosen(clamp, kinds, configuration, clamps)
    around = Surroundings.checked("contact", obstacles, radius, rods)
    contact = contact_table(around, rods, edges, clamp, index_c, in_motion) if around else None
    start = room(*configuration.quaternions.shape)
    start[...] = configuration.quaternions  # a copy: failed rods start from it again, whatever becomes of the caller's
    if not in_motion:  # there every instant is judged by itself
        start = projectable(start, lengths, clamp, found, up, () if contact is None else contact.surroundings.bodies, index_c)
    feasible = found != INFEASIBLE
    sound = feasible[index_c]
    all_rods = rod_rows(index_c, index_m, np.arange(rods), index_c, index_e)
    return Tables(
        start=start, rest_length=lengths, clamp=clamp, material=material_table(material, edges),
        isotropic=material.isotropic, rods=all_rods if sound.all() else all_rods[sound], feasible=feasible,
        configuration_index=index_c, material_index=index_m, external_index=index_e, external=external, up=up,
        floating=floating, contact=contact, weight_per_length=material.weight_per_length)


def _loosen(clamp: np.ndarray, kinds: np.ndarray, configuration: Configuration, clamps: Clamps) -> None:
    """Make vertex 0 an unknown where the start is free, in place: an external energy may move it."""
    loose = np.flatnonzero(kinds[:, 0] == FREE)
    held = kinds[loose, 1] != FREE
    anchor = np.asarray(configuration.start, dtype=np.float64)[loose]
    clamp[loose, of.LOOSE], clamp[loose, of.RELEASED], clamp[loose, of.CLOSED] = 1.0, 0.0, held
    clamp[loose[:, None], np.arange(of.ANCHOR, of.ANCHOR + 3)] = anchor
    line = np.where(held[:, None], np.asarray(clamps.end_position)[loose] - anchor, 0.0)
    clamp[loose[:, None], np.arange(of.TARGET, of.TARGET + 3)] = line


def under(table: Tables, material: Material, index=None) -> Tables:
    """The same rods with another material: one row for each, one for all, as many as before, each for the rods that had it, or
    the rows ``index`` (R,).

    Raises InputError where they do not match.
    """
    check_material(material, table.edges, table.floating and table.external is None)
    if index is None and material.count not in (1, table.count):
        index = table.material_index
        if material.count != len(table.material):
            raise InputError("relax", "material", f"{material.count} rows for {table.count} rods",
                             "give one, one per rod, as many as before, or material_index")
    rows = np.arange(table.count) % material.count if index is None else np.asarray(index)
    if rows.shape != (table.count,):
        raise InputError("relax", "material_index", f"shape {rows.shape}", f"give ({table.count},) row numbers")
    _, rows = paired_rows(len(table.start), material.count, table.configuration_index, rows)
    stiffness = material_table(material, table.edges)
    rods = table.rods.copy()
    rods[:, of.MATERIAL_ROW] = rows[rods[:, of.RESULT_ROW]]
    contact = None if table.contact is None else table.contact.copy()
    return replace(table, material=stiffness, isotropic=material.isotropic, material_index=rows, rods=rods, contact=contact,
                   weight_per_length=material.weight_per_length)


def material_table(material: Material, edges: int, each_edge: bool = False) -> np.ndarray:
    """(G, STIFFNESS + 1 or E · STIFFNESS_COLUMNS): see the columns' names; ``each_edge``: also of uniform rods edge by edge.
    Raises InputError where that is too large."""
    bend, twist, rest = material.bend, material.twist, material.rest_curvature
    uniform = not each_edge and bend.shape[1] == twist.shape[1] == 1 and (rest is None or rest.shape[1] == 1)
    columns = of.STIFFNESS + (1 if uniform else edges) * of.STIFFNESS_COLUMNS
    if material.count * columns > of.MOST_NUMBERS:
        raise InputError("relax", "material", f"{material.count:,} rows in one call",
                         f"give at most {of.MOST_NUMBERS // columns:,} at a time")
    table = room(material.count, columns)
    table[:] = 0.0
    along = along_rods(table)
    joints = along[:, 1:] if along.shape[1] > 1 else along  # no joint is where the first edge begins
    first, second, mixed = bend[..., 0, 0], bend[..., 1, 1], bend[..., 0, 1]
    along[..., of.BEND], along[..., of.BEND + 1], along[..., of.BEND + 2] = first, second, mixed
    along[:, 0, of.TWIST] = twist[:, 0]  # where the kernel of isotropic rods, whose stiffness is uniform, finds it
    joints[..., of.TWIST] = twist
    table[:, of.ROUND] = ((first == second) & (mixed == 0)).all(axis=1)
    if rest is not None:
        joints[..., of.REST : of.REST + 2] = rest
        table[:, of.ROUND] *= (rest == 0).all(axis=(1, 2))
    table[:, of.WEIGHT] = material.weight
    put_extremes(table)
    return table


def along_rods(table: np.ndarray) -> np.ndarray:
    """(G, 1 or E, STIFFNESS_COLUMNS) the part of a table of materials that goes along the rods, not a copy."""
    return table[:, of.STIFFNESS :].reshape(len(table), -1, of.STIFFNESS_COLUMNS)


def put_extremes(table: np.ndarray) -> None:
    """Into a table of materials the largest and smallest stiffness along the rods."""
    along = along_rods(table)
    (smallest, largest), twist = bending_range(along), along[..., of.TWIST]
    table[:, of.LARGEST_BEND] = largest.max(axis=1)
    table[:, of.STIFFEST] = np.maximum(table[:, of.LARGEST_BEND], twist.max(axis=1))
    table[:, of.SOFTEST] = np.minimum(smallest.min(axis=1), twist.min(axis=1))


def bending_range(along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The smaller and the larger eigenvalue of B, of :func:`along_rods`."""
    first, second, mixed = (along[..., of.BEND + k] for k in range(3))
    if not mixed.any():
        return np.minimum(first, second), np.maximum(first, second)
    largest = 0.5 * (first + second) + np.hypot(0.5 * (first - second), mixed)
    return (first * second - mixed**2) / largest, largest


def evened(table: Tables, most: float) -> tuple[Tables, np.ndarray]:
    """The same rods with every stiffness of uneven ones within a factor ``most`` of their smallest bending stiffness, and the
    rows of the results (-,) of the rods that this changes."""
    material, uneven = evened_materials(table.material, most)
    if not uneven.any():
        return table, np.zeros(0, dtype=np.int64)
    changed = uneven[table.material_index] & table.feasible[table.configuration_index]
    return replace(table, material=material), np.flatnonzero(changed)


def evened_materials(material: np.ndarray, most: float) -> tuple[np.ndarray, np.ndarray]:
    """The same for a table of materials: the table and which of its rows this changes."""
    stiffest, softest = material[:, of.STIFFEST], material[:, of.SOFTEST]
    uneven = stiffest > max(UNEVEN, most) * softest
    if not uneven.any():
        return material, uneven
    material = material.copy()
    rows = material[uneven]
    along = along_rods(rows)
    bend = along[..., [of.BEND, of.BEND + 2, of.BEND + 2, of.BEND + 1]].reshape(*along.shape[:2], 2, 2)
    values, axes = np.linalg.eigh(bend)
    smallest = values.min(axis=(1, 2))
    values = np.minimum(values, most * smallest[:, None, None])
    bend = np.einsum("...ik,...k,...jk->...ij", axes, values, axes)
    along[..., of.BEND], along[..., of.BEND + 1], along[..., of.BEND + 2] = bend[..., 0, 0], bend[..., 1, 1], bend[..., 0, 1]
    twist = along[..., of.TWIST]
    along[..., of.TWIST] = np.where(twist > 0, np.clip(twist, smallest[:, None] / most, smallest[:, None] * most), 0.0)
    rows[:, of.LARGEST_BEND] = values.max(axis=(1, 2))
    rows[:, of.STIFFEST] = np.minimum(rows[:, of.STIFFEST], most * smallest)
    rows[:, of.SOFTEST] = np.maximum(rows[:, of.SOFTEST], smallest / most)
    material[uneven] = rows
    return material, uneven
