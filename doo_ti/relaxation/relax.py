"""F, the relaxation operator Γ̃ = F(Γ, E_Θ, C) of §III-D: many rods at once, each to the minimum it falls to.

    solution = relax(start, Material(bend=6e5, twist=8e5), clamps)
    solution.configuration.vertices    # (R, V, 3) mm

Numerical trouble is data, not an exception: every rod carries its own status, and one bad rod never spoils its neighbours.
"""

from dataclasses import replace

import numpy as np

from doo_ti import runtime
from doo_ti.errors import InputError
from doo_ti.relaxation import batch
from doo_ti.relaxation.columns import (
    ANCHOR,
    CLOSURE,
    DRIFT,
    ENERGY,
    FORCE,
    ITERATIONS,
    LOOSE,
    RESIDUAL,
    RESULTS,
    STABLE,
    STATUS,
    TARGET,
    TILT_INNER,
    TOTAL,
)
from doo_ti.relaxation.descent import Descent
from doo_ti.relaxation.external import External
from doo_ti.relaxation.newton import Newton
from doo_ti.relaxation.tables import Tables, tables
from doo_ti.types import Clamps, Configuration, Material, Solution, Status, unit_up

# As plain numbers, which NumPy compares ten times faster than members of an enumeration.
CONVERGED, STALLED, INFEASIBLE = (int(status) for status in (Status.CONVERGED, Status.STALLED, Status.INFEASIBLE))
PRECISIONS = ("f32", "f64", "mixed")


@runtime.exclusive
def relax(
    configuration: Configuration,
    material: Material,
    clamps: Clamps,
    solver: Newton | Descent = Newton(),
    *,
    up=(0.0, 0.0, 1.0),
    precision: str = "f64",
    configuration_index=None,
    material_index=None,
    external: External | None = None,
    external_index=None,
) -> Solution:
    """Relax rods from their starts to the constrained minimum of E_Θ they fall to (§III-D).

    configuration, clamps  tables with S rows each: where rods start and what holds their ends
    material               table with G rows
    solver                 ``Newton()`` (default), ``Newton.careful()`` or the paper's ``Descent()``
    up                     (3,) direction against gravity
    precision              "f64"; "f32", where f64 takes over only rods that f32 could not finish; or "mixed": f32 first,
                           then f64 from there to the f64 tolerance for all. ``Solution.precision`` says which ended a rod
    external               an energy at the vertices besides the rod's own, with Newton only. Where the start is
                           free it moves vertex 0, too
    configuration_index,   (R,) rows of the tables that make up each rod; without them rows are paired one to one and a
    material_index,        single row goes with every row of the other table
    external_index

    Clamped frames overwrite the first and last frame of the start. Inputs are never modified, results are float64.
    Energies include the constant μ z_0 Σ l̄_i. Raises InputError for inputs that do not match; infeasible rods get that
    status and NaN.
    """
    up = unit_up(up, "relax")
    if not isinstance(solver, Newton | Descent):
        raise InputError("relax", "solver", f"{solver!r}", "give Newton(), Newton.careful() or Descent()")
    if external is not None and isinstance(solver, Descent):
        raise InputError("relax", "solver", "Descent knows no external energy", "give Newton() or Newton.careful()")
    _check_precision("relax", precision)
    with np.errstate(all="ignore"):  # a rod that is not finite is data: it gets a status, not a warning
        table = tables(
            configuration, material, clamps, up, configuration_index, material_index, external, external_index)
        if isinstance(solver, Descent):
            frames, results, bits = _descent(table, solver, precision)
        else:
            frames, results, bits = _newton(table, solver, precision)
        return _solution(table, frames, results, bits)


@runtime.exclusive
def relax_again(
    solution: Solution, material: Material, solver: Newton = Newton(first_shift=0.0), *, precision: str = "f64",
    material_index=None,
) -> Solution:
    """F once more, from where rods ended, under another material: what follows a parameter takes half the iterations.

    solution        of :func:`relax` or of this function; clamps, gravity, lengths and an external energy stay as they were
    material        table with G rows
    solver          Newton; without a first shift, which keeps closest to the branch
    material_index  (R,) rows of ``material``; without it one for each rod, the one row for all, or as many rows as before, each
                    for the rods that had that row

    Raises InputError for inputs that do not match. Rods that had come to nothing start where they first did.
    """
    if not isinstance(solver, Newton):
        raise InputError("relax_again", "solver", f"{solver!r}", "give Newton() or Newton.careful()")
    _check_precision("relax_again", precision)
    if solution.tables is None:
        raise InputError("relax_again", "solution", "was put together of several calls", "relax where its rods ended")
    with np.errstate(all="ignore"):
        table = solution.tables.under(material, material_index)
        frames, results, bits = _newton(table, solver, precision, solution)
        return _solution(table, frames, results, bits)


def _check_precision(function: str, precision: str) -> None:
    if precision not in PRECISIONS:
        raise InputError(function, "precision", f"{precision!r}", f"give one of {', '.join(PRECISIONS)}")


def _descent(table: Tables, solver: Descent, precision: str):
    """(frames, results, bits per rod)."""
    bits = 32 if precision == "f32" else 64
    frames, results = batch.run_descent(table, solver, bits)
    return frames, results, np.full(table.count, bits)


def _newton(table: Tables, solver: Newton, precision: str, begin: Solution | None = None):
    """The precision ladder, from the starts or where another solution ended: (frames, results, bits per rod)."""
    if precision == "f64":
        frames, results = batch.run_newton(table, solver, 64, begin)
        return frames, results, np.full(len(results), 64)
    coarse = solver if precision == "f32" else replace(solver, tolerance=None)
    frames, results = batch.run_newton(table, coarse, 32, begin)
    bits = np.full(len(results), 32)
    feasible = results[:, STATUS] != INFEASIBLE
    short = (results[:, STATUS] != CONVERGED) | (results[:, STABLE] == 0)
    rows = np.flatnonzero(feasible & (short | (precision == "mixed")))
    if len(rows):
        usable = (results[:, STATUS] == CONVERGED) | (results[:, STATUS] == STALLED)
        before = results[rows, ITERATIONS]
        batch.continue_newton(table, replace(solver, first_shift=0.0), 64, frames, results, rows, usable)
        results[rows, ITERATIONS] += before
        bits[rows] = 64
    return frames, results, bits


def _solution(table: Tables, frames: np.ndarray, results: np.ndarray, bits: np.ndarray) -> Solution:
    index, up = table.configuration_index, table.up
    anchor = table.anchor
    # Not a matrix product, whose rounding depends on how many rods there are.
    height = anchor[:, 0] * up[0] + anchor[:, 1] * up[1] + anchor[:, 2] * up[2]
    lifted = 2 * height * table.clamp[:, TOTAL]
    energy = results[:, ENERGY] + table.weight[table.material_index] * lifted[index]
    start = anchor[index]
    if table.external is not None:
        held = table.clamp[index, LOOSE] == 0
        energy += np.where(held, table.external.energy_at_start(start, table.external_index), 0.0)
        start = start + results[:, DRIFT:]
    rest_length = table.rest_length[0].copy() if len(table.rest_length) == 1 else table.rest_length[index]
    configuration = Configuration(start, frames, rest_length)
    status, stable = results[:, STATUS].astype(np.int8), results[:, STABLE] == 1
    # The kernels reckon from the anchor and never see where that is.
    nowhere = ~np.isfinite(anchor).all(axis=1)
    if nowhere.any():
        rods = nowhere[index] & (status != INFEASIBLE)
        frames[rods], results[rods, :ITERATIONS], results[rods, FORCE:RESULTS] = np.nan, np.nan, np.nan
        status[rods], stable[rods], energy[rods] = Status.NOT_FINITE, False, np.nan
    taut = np.flatnonzero((table.clamp[:, TILT_INNER] == 0)[index])
    if len(taut):  # straight, they end where they end
        asked = table.clamp[index[taut]]
        missed = configuration.take(taut).vertices[:, -1] - asked[:, ANCHOR : ANCHOR + 3] - asked[:, TARGET : TARGET + 3]
        results[taut, CLOSURE] = np.linalg.norm(missed, axis=1) / asked[:, TOTAL]
    hanging = np.flatnonzero(table.released[index])
    if len(hanging):
        ends = configuration.take(hanging).vertices[:, -1]
        start[hanging] = 2 * start[hanging] - ends
    return Solution(
        configuration=configuration,
        energy=energy,
        residual=results[:, RESIDUAL],
        closure=results[:, CLOSURE],
        iterations=results[:, ITERATIONS].astype(np.int32),
        status=status,
        stable=stable,
        end_force=results[:, FORCE:RESULTS],
        precision=bits.astype(np.int8),
        tables=table,
    )
