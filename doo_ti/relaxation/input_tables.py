"""The input of ``relax`` as tables: materials row by row, and starts that can be projected onto closure (§III-B)."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from doo_ti.contact.obstacles import Obstacle
from doo_ti.relaxation import tables as of
from doo_ti.relaxation.bows import bowed_among, straight_rods
from doo_ti.relaxation.checked_input import (
    check_material,
    check_shapes,
    clamp_kinds,
    external_rows,
    loads_along,
    paired_rows,
    rest_lengths,
)
from doo_ti.relaxation.clamp_table import INFEASIBLE, STRAIGHT, TAUT, TAUT_SLACK, clamp_table
from doo_ti.relaxation.contact_table import contact_table
from doo_ti.relaxation.external import External
from doo_ti.relaxation.newton_policy import MOST_SHIFT
from doo_ti.relaxation.point_loads import PointLoads
from doo_ti.relaxation.tables import FREE, Tables, outer_edges, rod_rows, room, whole_start
from doo_ti.rod.frames import quaternion_product, smallest_rotation, tangent_from_quaternion
from doo_ti.rod.types import Clamps, Configuration, Material
from doo_ti.system.errors import InputError

UNEVEN = MOST_SHIFT
"""Of the largest stiffness of a rod to its smallest, above which it is relaxed with evener ones first (:func:`evened`): up to
there no shift is limited (:meth:`.Loading.shift_share`)."""
RATIOS = (1e2, 1e4, 1e6, 1e8)
"""Of their stiffness then, one after the other."""


def tables(
    configuration: Configuration, material: Material, clamps: Clamps, up: np.ndarray,
    configuration_index=None, material_index=None, external: External | None = None, external_index=None,
    obstacles: Sequence[Obstacle] = (), radius=None, in_motion: bool = False,
) -> Tables:
    """Check the input of F and lay it out for the kernels.

    Raises InputError where shapes do not match, an index is out of range, or both ends of a rod with weight are free that no
    external energy holds.
    """
    check_shapes(configuration, clamps)
    count, edges = configuration.count, configuration.edges
    lengths = rest_lengths(configuration)
    index_c, index_m = paired_rows(count, material.count, configuration_index, material_index)
    rods = len(index_c)
    if max(count, rods) * edges * 4 > of.MOST_NUMBERS:
        raise InputError("relax", "configuration", f"{max(count, rods):,} rods of {edges} edges in one call",
                         f"give at most {of.MOST_NUMBERS // (4 * edges):,} at a time")
    index_e = external_rows(external, external_index, rods, edges)
    kinds = clamp_kinds(clamps, count)
    floating = not kinds.any(axis=1).all()
    if isinstance(external, PointLoads):
        external = loads_along(external, up, floating)
    check_material(material, edges, floating and external is None)
    clamp, found = clamp_table(configuration, lengths, kinds, clamps)
    if (external is not None or obstacles) and (kinds[:, 0] == FREE).any():
        _loosen(clamp, kinds, configuration, clamps)
    contact = contact_table(obstacles, radius, rods, edges, clamp, index_c, in_motion) if obstacles else None
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


def material_table(material: Material, edges: int) -> np.ndarray:
    """(G, STIFFNESS + 1 or E · STIFFNESS_COLUMNS): see the columns' names. Raises InputError where that is too large."""
    bend, twist, rest = material.bend, material.twist, material.rest_curvature
    uniform = bend.shape[1] == twist.shape[1] == 1 and (rest is None or rest.shape[1] == 1)
    columns = of.STIFFNESS + (1 if uniform else edges) * of.STIFFNESS_COLUMNS
    if material.count * columns > of.MOST_NUMBERS:
        raise InputError("relax", "material", f"{material.count:,} rows in one call",
                         f"give at most {of.MOST_NUMBERS // columns:,} at a time")
    table = room(material.count, columns)
    table[:] = 0.0
    along = table[:, of.STIFFNESS :].reshape(material.count, -1, of.STIFFNESS_COLUMNS)
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
    put_extremes(table, bending_range(first, second, mixed), twist)
    return table


def put_extremes(table: np.ndarray, bend: tuple[np.ndarray, np.ndarray], twist: np.ndarray) -> None:
    """Into a table of materials the largest and smallest stiffness along the rods, which have the range ``bend`` (G, 1 or E)
    each and ``twist`` (G, 1 or joints)."""
    smallest, largest = bend
    table[:, of.LARGEST_BEND] = _along(np.maximum, largest)
    table[:, of.STIFFEST] = np.maximum(table[:, of.LARGEST_BEND], _along(np.maximum, twist))
    table[:, of.SOFTEST] = np.minimum(_along(np.minimum, smallest), _along(np.minimum, twist))


def _along(chosen: np.ufunc, values: np.ndarray) -> np.ndarray:
    """(R,) the one of ``values`` (R, 1 or joints) along each rod that is ``chosen``."""
    return values[:, 0] if values.shape[1] == 1 else chosen.reduce(values, axis=1)


def bending_range(first: np.ndarray, second: np.ndarray, mixed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The smaller and the larger eigenvalue of B."""
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
    along = rows[:, of.STIFFNESS :].reshape(len(rows), -1, of.STIFFNESS_COLUMNS)
    bend = along[..., [of.BEND, of.BEND + 2, of.BEND + 2, of.BEND + 1]].reshape(*along.shape[:2], 2, 2)
    values, axes = np.linalg.eigh(bend)
    smallest = values.min(axis=(1, 2))
    values = np.minimum(values, most * smallest[:, None, None])
    bend = np.einsum("...ik,...k,...jk->...ij", axes, values, axes)
    along[..., of.BEND], along[..., of.BEND + 1], along[..., of.BEND + 2] = bend[..., 0, 0], bend[..., 1, 1], bend[..., 0, 1]
    twist = along[..., of.TWIST]
    along[..., of.TWIST] = np.where(twist > 0, np.clip(twist, smallest[:, None] / most, smallest[:, None] * most), 0.0)
    rows[:, of.STIFFNESS :] = along.reshape(len(rows), -1)
    rows[:, of.LARGEST_BEND] = values.max(axis=(1, 2))
    rows[:, of.STIFFEST] = np.minimum(rows[:, of.STIFFEST], most * smallest)
    rows[:, of.SOFTEST] = np.maximum(rows[:, of.SOFTEST], smallest / most)
    material[uneven] = rows
    return material, uneven


def projectable(start: np.ndarray, lengths: np.ndarray, clamp: np.ndarray, found: np.ndarray, up: np.ndarray,
                obstacles: Sequence[Obstacle], index: np.ndarray, beside_others: bool = False) -> np.ndarray:
    """Starts that can be projected: those ``found`` (S,) STRAIGHT are bowed (:mod:`doo_ti.relaxation.bows`), those found TAUT
    made straight. ``index`` (R,) is the start of each rod: obstacles may belong to single rods; ``beside_others``: they are
    rods of groups. Where starts are changed ``clamp`` is, too, in place.
    """
    slack, taut = np.flatnonzero(found == STRAIGHT), np.flatnonzero(found == TAUT)
    if len(slack):
        start = _bowed(start, lengths, clamp, slack, up, obstacles, index, beside_others)
    if len(taut):
        start = _stretched(start, lengths, clamp, taut)
    return start


def _free_part(lengths: np.ndarray, clamp: np.ndarray):
    """Of N rods with these lengths (N, E) and clamps (N, CLAMP_COLUMNS): which of the end edges may tilt (N, 2), as all inner
    ones may, the line (N, 3) that the free edges have to bridge and its length (N,), and how far they reach (N,), mm."""
    tangents = tangent_from_quaternion(clamp[:, of.ENDS:].reshape(-1, 2, 4))
    tilting = clamp[:, of.TILT_START : of.TILT_END + 1]
    held = lengths[:, outer_edges(lengths.shape[1])] * (1 - tilting)
    line = clamp[:, of.TARGET : of.TARGET + 3] - (held[..., None] * tangents).sum(axis=1)
    return tilting, line, np.linalg.norm(line, axis=1), clamp[:, of.TOTAL] - held.sum(axis=1)


def _rows(lengths: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """(N, E) the lengths of some starts."""
    return lengths[np.zeros_like(rows) if len(lengths) == 1 else rows]


def _bowed(start, lengths, clamp, rows, up, obstacles: Sequence[Obstacle], index: np.ndarray, beside_others) -> np.ndarray:
    """Starts of which the slack rods ``rows`` are bowed where their free edges are in one straight line."""
    edges, own = start.shape[1], _rows(lengths, rows)
    ends, _, span, reach = _free_part(own, clamp[rows])
    tilting = np.ones((len(rows), edges))
    tilting[:, outer_edges(edges)] = ends
    whole = whole_start(start[rows], clamp[rows])
    chord = np.linalg.norm(((own * tilting)[..., None] * tangent_from_quaternion(whole)).sum(axis=1), axis=-1)
    straight = chord > reach * (1 - TAUT_SLACK)
    if not straight.any():
        return start
    # Of rods that share a start but not their obstacles the first decides; starts without rods are left.
    used, firsts = np.unique(index, return_index=True)
    straight &= np.isin(rows, used)
    rows, share = rows[straight], (span / reach)[straight]
    anchor = clamp[rows, of.ANCHOR : of.ANCHOR + 3]
    rods = straight_rods(whole[straight], own[straight], anchor, tilting[straight], share, up)
    first = firsts[np.searchsorted(used, rows)]
    frames = bowed_among(rods, [obstacle.take(first) for obstacle in obstacles], beside_others)
    return _changed(start, clamp, rows, frames)


def _stretched(start, lengths, clamp, rows) -> np.ndarray:
    """Starts of which the rods ``rows``, as long as their span, are the one straight line they can be, with nothing left to
    relax but the spins.

    Their clamps are changed to say so; the turns of their frames are kept by parallel transport.
    """
    tilting, line, span, _ = _free_part(_rows(lengths, rows), clamp[rows])
    whole = whole_start(start[rows], clamp[rows])
    turn = smallest_rotation(tangent_from_quaternion(whole), (line / span[:, None])[:, None])
    straight = quaternion_product(turn, whole)
    outer = outer_edges(start.shape[1])
    straight[:, outer] = np.where((tilting == 0)[..., None], whole[:, outer], straight[:, outer])
    clamp[rows[:, None], [of.CLOSED, of.TILT_START, of.TILT_END, of.TILT_INNER]] = 0.0
    return _changed(start, clamp, rows, straight)


def _changed(start, clamp, rows, quaternions) -> np.ndarray:
    """``start`` with other frames in some rows, as given left as it is; ``clamp`` takes their ends in place."""
    start = start.copy()
    start[rows] = quaternions
    clamp[rows, of.ENDS:] = quaternions[:, outer_edges(start.shape[1])].reshape(-1, 8)
    return start
