"""F, the relaxation operator Γ̃ = F(Γ, E_Θ, C) of §III-D: many rods at once, each from its start down to a minimum.

    solution = relax(start, Material(bend=6e5, twist=8e5), clamps)
    solution.configuration.vertices    # (R, V, 3) mm

A rod that fails raises no exception: every rod has its own status, and none affects the others.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from doo_ti.contact.distance_grid import DistanceGrid
from doo_ti.contact.obstacles import Obstacle, Ring
from doo_ti.contact.surroundings import Surroundings
from doo_ti.relaxation import batch
from doo_ti.relaxation import tables as of
from doo_ti.relaxation.clear_start import move_out
from doo_ti.relaxation.descent import Descent
from doo_ti.relaxation.external import External
from doo_ti.relaxation.input_tables import RATIOS, evened, tables, under
from doo_ti.relaxation.newton import MOST_IN_CONTACT, Newton
from doo_ti.relaxation.self_approach import approach_in_relaxation, stays_in_order
from doo_ti.relaxation.tables import Tables, whole_start
from doo_ti.rod import shapes
from doo_ti.rod.types import Clamp, Clamps, Configuration, Material, Solution, Status, unit_up
from doo_ti.system import runtime
from doo_ti.system.arguments import typed
from doo_ti.system.errors import InputError

# Plain integers: NumPy compares them ten times faster than members of an enumeration.
CONVERGED, STALLED, LIMIT, INFEASIBLE = (
    int(status) for status in (Status.CONVERGED, Status.STALLED, Status.ITERATION_LIMIT, Status.INFEASIBLE))
PRECISIONS = ("f32", "f64", "mixed")
F32_ONLY = "f32 only"
ITERATIONS_32 = 300  # after which f64 takes over from f32, which can repeat the same few steps without end
INSIDE, CLOSE_PLACES = 1e-2, 29
"""Radii by which an edge of a converged rod may be inside a body that is not convex, and places of it that are measured."""


@typed
@runtime.exclusive
def relax(
    x0: Configuration | Solution,
    material: Material,
    clamps: Clamps | None = None,
    solver: Newton | Descent | None = None,
    *,
    up: ArrayLike | None = None,
    precision: str = "f64",
    configuration_index: ArrayLike | None = None,
    material_index: ArrayLike | None = None,
    external: External | None = None,
    external_index: ArrayLike | None = None,
    obstacles: Sequence[Obstacle] = (),
    radius: ArrayLike | None = None,
) -> Solution:
    """Γ̃ = F(Γ, E_Θ, C): relax R rods from their starts down to constrained minima of E_Θ (§III-D).

    x0                     Γ: S starts; or the Solution of an earlier call, whose rods begin where they have ended and, among
                           the same obstacles, with the contact forces that they have there
    material               Θ: G materials
    clamps                 C: S of them, one for each start. None with a Solution: the same rods again, from the end of
                           that call or, where they failed, from their first start; clamps, gravity, lengths and the external
                           energy stay the same and only the material changes, which takes half the iterations
    solver                 ``Newton()`` (default, with obstacles that of 1000 iterations), ``Newton.careful()`` or the paper's
                           ``Descent()``. Without clamps only Newton, by default without a first shift, which stays closest to
                           the branch
    up                     (3,) direction against gravity, (0, 0, 1) unless given
    precision              "f64"; "f32": f64 finishes the rods that f32 cannot; "f32 only": these stay unfinished; or "mixed":
                           f32 first, then f64 continues all rods to the f64 tolerance.
                           ``Solution.precision`` is the arithmetic that finished a rod
    external               an energy at the vertices besides the rod's own, with Newton only; it also moves vertex 0 where the
                           start is free
    configuration_index,   (R,) start (with its clamps), material and external energy of each rod, as row numbers. A table
    material_index,        without them has a row for each rod, or a single one for all. Where clamps are None, only
    external_index         ``material_index``: by default one row for each rod, one for all, or as many rows as before, paired
                           as before
    obstacles, radius      what the rods may touch but not enter, and their radius in mm, one or (R,): the rod, edges of that
                           thickness, ends outside all of them to 1e-5 of its radius, beside Itself to 2e-4 (in f32 to 2e-6 of
                           its length, if that is more), outside itself to 1e-3. Every obstacle has one row, or R. A start
                           inside one is moved out of it first; a rod whose clamps are inside, or whose start cannot be moved
                           out, is INFEASIBLE. Friction acts only in motions. See ``Solution.contact``

    Clamped frames replace the first and last frame of the start. Results are float64; energies include the constant
    μ z_0 Σ l̄_i. Raises InputError for inputs that do not match; infeasible rods have the status INFEASIBLE, else NaN.
    """
    once_more = isinstance(x0, Solution) and clamps is None
    solver = _default_solver(x0, obstacles, once_more) if solver is None else solver
    _check_options(solver, precision, external, obstacles, once_more, clamps)
    with np.errstate(all="ignore"):  # a rod that is not finite has a status; NumPy need not warn
        if once_more:
            _check_same_rods(x0, up, external, configuration_index, external_index, obstacles or None, radius)
            table = under(x0.tables, material, material_index)
        else:
            table = tables(x0.configuration if isinstance(x0, Solution) else x0, material, clamps,
                           unit_up((0.0, 0.0, 1.0) if up is None else up, "relax"), (configuration_index, material_index),
                           external, external_index, obstacles, radius)
            if isinstance(x0, Solution) and table.contact is not None and configuration_index is None:
                table.contact.begin_with(None if x0.tables is None else x0.tables.contact, x0.converged)
        return _solved(table, solver, precision, x0 if once_more else None)


def _default_solver(x0: Configuration | Solution, obstacles: Sequence[Obstacle], once_more: bool) -> Newton:
    """Newton with the options of :func:`relax`."""
    touches = len(obstacles) > 0 or once_more and x0.tables is not None and x0.tables.contact is not None
    solver = Newton(max_iterations=MOST_IN_CONTACT) if touches else Newton()
    return replace(solver, first_shift=0.0) if once_more else solver


def _solved(table: Tables, solver: Newton | Descent, precision: str, begin: Solution | None) -> Solution:
    """The rods of the tables at rest, from their starts or from where they have ended."""
    if isinstance(solver, Descent):
        if (table.rest_length == 0).any():
            raise InputError("relax", "solver", "Descent cannot use edges without length", "give Newton()")
        bits = 32 if precision.startswith("f32") else 64
        frames, results = batch.run_descent(table, solver, bits)
        bits = np.full(table.count, bits)
    else:
        frames, results, bits = _newton(table, solver, precision, begin)
        if table.contact is not None and len(rows := move_out(table, frames, results)):
            batch.continue_newton(table, solver, 64, frames, results, rows, np.ones(table.count, dtype=bool))
            bits[rows] = 64
        table = _touch_themselves(table, solver, frames, results, bits)
    return _solution(table, frames, results, bits)


def _check_options(solver, precision: str, external, obstacles, once_more: bool, clamps) -> None:
    """Raise InputError for an unknown precision, and for a solver that cannot be used with the other arguments."""
    for given, what in ((once_more, f"{solver!r} from a Solution"), (len(obstacles), "Descent cannot use obstacles"),
                        (external is not None, "Descent cannot use an external energy")):
        if isinstance(solver, Descent) and given:
            raise InputError("relax", "solver", what, "give Newton() or Newton.careful()")
    if precision not in (*PRECISIONS, F32_ONLY):
        raise InputError("relax", "precision", f"{precision!r}", f"give one of {', '.join((*PRECISIONS, F32_ONLY))}")
    if clamps is None and not once_more:
        raise InputError("relax", "clamps", "missing", "give Clamps; a Solution alone keeps those that it has")


def _check_same_rods(solution: Solution, *given) -> None:
    """Raise InputError where a solution cannot be relaxed again, or where more than the material is given."""
    if any(value is not None for value in given):
        raise InputError("relax", "clamps", "missing, though more than the material changes",
                         "give the clamps, or only material and material_index")
    if solution.tables is None:
        raise InputError("relax", "x0", "joins several calls", "give clamps, and its configuration as x0")


def _newton(table: Tables, solver: Newton, precision: str, begin: Solution | None):
    """(frames, results, bits per rod) of one precision after the other, from the starts or from the end of ``begin``."""
    evener, uneven = (table, np.zeros(0, dtype=np.int64)) if begin is not None else evened(table, RATIOS[0])
    first, last = 64 if precision == "f64" else 32, 32 if precision == F32_ONLY else 64
    coarse = solver if first == last else replace(
        solver, max_iterations=min(solver.max_iterations, ITERATIONS_32),
        tolerance=None if precision == "mixed" else solver.tolerance)
    frames, results = batch.run_newton(evener, coarse, first, begin)
    _with_ratios(table, solver, last, frames, results, uneven)
    bits = np.full(len(results), first)
    bits[uneven] = last
    if first == last:
        return frames, results, bits
    feasible = results[:, of.STATUS] != INFEASIBLE
    short = (results[:, of.STATUS] != CONVERGED) | (results[:, of.STABLE] == 0)
    rows = np.flatnonzero(feasible & (short | (precision == "mixed")) & (bits == 32))
    if len(rows):
        usable = (results[:, of.STATUS] == CONVERGED) | (results[:, of.STATUS] == STALLED)
        finer, before = replace(solver, first_shift=0.0), results[:, of.ITERATIONS].copy()
        _continue(table, finer, 64, frames, results, rows, usable)
        # Where f32 has stalled inside an obstacle f64 cannot begin there.
        inside = rows[usable[rows] & (results[rows, of.STATUS] == INFEASIBLE)]
        if len(inside):
            usable[inside] = False
            batch.continue_newton(table, finer, 64, frames, results, inside, usable)
            results[inside, of.ITERATIONS] += before[inside]
        bits[rows] = 64
    return frames, results, bits


def _continue(table: Tables, solver: Newton, bits: int, frames, results, rows: np.ndarray, usable: np.ndarray) -> None:
    """Relax the rods ``rows`` further, in place, those that are ``usable`` (R,) from where they are: their iterations are those
    of both relaxations, and ALONG that of both ways."""
    before, along = results[rows, of.ITERATIONS], results[rows, of.ALONG]
    batch.continue_newton(table, solver, bits, frames, results, rows, usable)
    results[rows, of.ITERATIONS] += before
    results[rows, of.ALONG] = np.where(usable[rows], np.minimum(results[rows, of.ALONG], along), results[rows, of.ALONG])


def _with_ratios(table: Tables, solver: Newton, bits: int, frames: np.ndarray, results: np.ndarray, rows: np.ndarray) -> None:
    """Relax the rods ``rows`` further, in place, which have relaxed with stiffness made even to RATIOS[0]: with one ratio after
    the other, up to their own.

    Bent and twisted the soft way a rod that is stiff the other way follows a narrow, curved valley of its energy in small
    steps; from its minimum under a smaller ratio the next one is a few steps away.
    """
    for ratio in (*RATIOS[1:], np.inf):
        if not len(rows):
            return
        evener, later = evened(table, ratio)
        usable = np.isin(results[:, of.STATUS], (CONVERGED, STALLED, LIMIT))
        _continue(evener, solver, bits, frames, results, rows, usable)
        rows = later


def _touch_themselves(table: Tables, solver: Newton, frames, results, bits) -> Tables:
    """Where rods are their own obstacles, relax those once more, in place, that may have touched themselves on their way.
    Returns the tables with their forces."""
    contact = table.contact
    if contact is None or contact.surroundings.itself is None:
        return table
    if contact.forces.flags.writeable:  # of an earlier call with these tables
        contact.forces[~contact.near] = 0.0
    index = table.configuration_index
    rods = np.flatnonzero(~stays_in_order(table, results))
    of_start = index[rods]
    start, lengths = whole_start(table.start[of_start], table.clamp[of_start]), table.rest_length
    lengths = lengths if len(lengths) == 1 else lengths[of_start]
    rows, turned = approach_in_relaxation(start, frames, lengths, contact.radius, rods)
    if len(turned):
        rows = np.sort(np.append(rows, turned[table.spins_held[index[turned]]]))
    rows = rows[results[rows, of.STATUS] != INFEASIBLE]
    if len(rows):
        table = replace(table, contact=contact.touching(rows))
        batch.continue_newton(table, solver, 64, frames, results, rows, np.zeros(table.count, dtype=bool))
        table = replace(table, contact=replace(table.contact, itself=False))
        bits[rows] = 64
    return table


def _cut(table: Tables, configuration: Configuration, status: np.ndarray) -> np.ndarray:
    """Rows of the converged rods that are inside a body between two vertices: an edge that spans a hole or a hollow of it is
    near to it more than once, and only one place of an edge touches."""
    contact = table.contact
    hollow = [body for body in contact.surroundings.bodies if isinstance(body, Ring | DistanceGrid)]
    rows = np.flatnonzero(contact.near & (status == CONVERGED)) if hollow else np.zeros(0, dtype=np.int64)
    around, places = Surroundings(hollow, contact.radius).take(rows), configuration.take(rows).vertices
    cut = np.zeros(len(rows), dtype=bool)
    for body in around.obstacles:
        distance, lengths = body.distance(places)[0], np.linalg.norm(np.diff(places, axis=1), axis=-1)
        # The distance changes no faster than the place.
        own, edge = np.nonzero(distance[:, :-1] + distance[:, 1:] < lengths + 2.0 * np.reshape(around.radius, (-1, 1)))
        close = Surroundings([body], around.radius).take(own)
        ends = np.stack([places[own, edge], places[own, edge + 1]], axis=1)
        cut[own[close.smallest_gap(ends, CLOSE_PLACES) < -INSIDE * close.radius]] = True
    return rows[cut]


def _solution(table: Tables, frames: np.ndarray, results: np.ndarray, bits: np.ndarray) -> Solution:
    index, up = table.configuration_index, table.up
    anchor = table.anchor
    # Not a matrix product, whose rounding depends on how many rods there are.
    height = anchor[:, 0] * up[0] + anchor[:, 1] * up[1] + anchor[:, 2] * up[2]
    lifted = 2 * height * table.clamp[:, of.TOTAL]
    energy = results[:, of.ENERGY] + table.material[table.material_index, of.WEIGHT] * lifted[index]
    start = anchor[index]
    if table.loaded:
        if table.external is not None:
            held = table.clamp[index, of.LOOSE] == 0
            energy += np.where(held, table.external.energy_at_start(start, table.external_index), 0.0)
        if (table.clamp[:, of.LOOSE] > 0).any():
            start += results[:, of.DRIFT:]
    rest_length = table.rest_length[0].copy() if len(table.rest_length) == 1 else table.rest_length[index]
    configuration = Configuration(start, frames, rest_length)
    status, stable = results[:, of.STATUS].astype(np.int8), results[:, of.STABLE] == 1
    infeasible = status == INFEASIBLE
    if infeasible.any():
        frames[infeasible], start[infeasible] = np.nan, np.nan
    # The kernels compute relative to the anchor and do not read its place.
    lost = ~np.isfinite(anchor).all(axis=1)
    if lost.any():
        rods = lost[index] & ~infeasible
        frames[rods], results[rods, : of.ITERATIONS], results[rods, of.FORCE : of.RESULTS] = np.nan, np.nan, np.nan
        status[rods], stable[rods], energy[rods] = Status.NOT_FINITE, False, np.nan
    taut = np.flatnonzero((table.clamp[:, of.TILT_INNER] == 0)[index])
    if len(taut):  # computed without closure: how far they miss is measured here, and the pull along them is undetermined
        clamp = table.clamp[index[taut]]
        reached = configuration.take(taut).vertices[:, -1] - clamp[:, of.ANCHOR : of.ANCHOR + 3]
        missed = reached - clamp[:, of.TARGET : of.TARGET + 3]
        results[taut, of.CLOSURE] = np.linalg.norm(missed, axis=1) / clamp[:, of.TOTAL]
        results[taut, of.FORCE : of.ALONG] = np.nan
    hanging = np.flatnonzero(table.released[index])
    if len(hanging):
        ends = configuration.take(hanging).vertices[:, -1]
        start[hanging] = 2 * start[hanging] - ends
        weight = table.material[table.material_index[hanging], of.WEIGHT] * table.clamp[index[hanging], of.TOTAL]
        results[hanging, of.FORCE : of.ALONG] += 2 * weight[:, None] * up  # the kernels close nothing there, and have zero
    if table.contact is not None:
        cut = _cut(table, configuration, status)
        status[cut], stable[cut] = Status.STALLED, False
    return Solution(
        configuration=configuration, energy=energy, residual=results[:, of.RESIDUAL], closure=results[:, of.CLOSURE],
        iterations=results[:, of.ITERATIONS].astype(np.int32), status=status, stable=stable,
        end_force=results[:, of.FORCE : of.ALONG], precision=bits.astype(np.int8), tables=table)


# --- the error of the mesh -------------------------------------------------------------------------------------------------

def mesh_change(rods: Configuration, material: Material, clamps: Clamps, up: ArrayLike, surroundings: Surroundings
                ) -> np.ndarray:
    """(R, V, 3) mm by which rods of many edges rest elsewhere than ``rods``, of rest lengths (E,), at rest under ``clamps``, of
    one kind for all: 4/3 of what edges half as long change, since the error of a mesh falls as the square of its edges
    (Richardson). NaN for rods that do not come to certified rest then."""
    held = _held_edges(clamps)
    first, last = held[0] * rods.rest_length[0] / 4, held[1] * rods.rest_length[-1] / 4
    finer = replace(clamps, start_position=clamps.start_position + first * clamps.start_frame[..., 0],
                    end_position=clamps.end_position - last * clamps.end_frame[..., 0])
    found = _at_rest(shapes.with_half_edges(rods, held), shapes.material_of_half_edges(material, held), finer, up, surroundings)
    return 4 / 3 * (shapes.vertices_before_halving(found, rods.rest_length, held) - rods.vertices)


def clamp_change(rods: Configuration, material: Material, clamps: Clamps, up: ArrayLike, surroundings: Surroundings
                 ) -> np.ndarray:
    """(R, V, 3) mm by which ``rods``, as for :func:`mesh_change`, rest elsewhere where clamps that hold the outer edges, up to
    their middles, end at the end vertices instead. NaN for rods that do not come to certified rest then."""
    held = tuple(bool(one and length) for one, length in zip(_held_edges(clamps), rods.rest_length[[0, -1]], strict=True))
    if not any(held):
        return np.zeros_like(rods.vertices)
    found = _at_rest(shapes.with_end_edges(rods, held), shapes.material_of_end_edges(material, held), clamps, up, surroundings)
    return found.vertices[:, held[0] : rods.edges + 1 + held[0]] - rods.vertices


def _at_rest(rods: Configuration, material: Material, clamps: Clamps, up: ArrayLike, surroundings: Surroundings
             ) -> Configuration:
    solver = None if surroundings else Newton.careful()  # without one relax allows more iterations among obstacles
    solution = relax(rods, material, clamps, solver, up=up, **surroundings.arguments)
    sound, found = solution.converged & solution.stable, solution.configuration
    return replace(found, start=np.where(sound[:, None], found.start, np.nan))


def _held_edges(clamps: Clamps) -> tuple[bool, bool]:
    return bool(np.min(clamps.start) >= Clamp.TANGENT), bool(np.min(clamps.end) >= Clamp.TANGENT)
