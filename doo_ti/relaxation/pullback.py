"""Gradients of a scalar function of rods at rest by their parameters: the adjoint of :mod:`doo_ti.relaxation.sensitivity`.

    loss = Σ |x − x̂|²
    pulled = pullback(solution, 2 (x − x̂), ("bend", "rest_curvature_per_joint"))
    pulled["rest_curvature_per_joint"]      # (R, E−1, 2) ∂loss/∂ω̄

One solve for each rod, whatever the number of parameters: what automatic differentiation needs for its reverse mode. The matrix
K of the bordered system is symmetric, so that a scalar s with the derivatives b by the frames changes along θ by

    ds/dθ = bᵀ dω/dθ = −pᵀ ∂g/∂θ − qᵀ ∂c/∂θ,    K (p, q) = (b, 0):

one right-hand side more for the factors. As forces on the vertices have ∂g/∂θ = −b, p is how the rod turns, and dx how it
moves, under the cotangent as a load.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import taichi as ti

from doo_ti.physics import pair
from doo_ti.physics.number import device_functions, read, write
from doo_ti.physics.pair import linear_gradient
from doo_ti.physics.quaternion import first_director, second_director
from doo_ti.physics.tuples import dot, minus, negated, plus, record, repeated, scaled, variable
from doo_ti.relaxation import sensitivity
from doo_ti.relaxation import tables as of
from doo_ti.relaxation.contact_sensitivity import ContactSensitivity
from doo_ti.relaxation.kernel_factory import TABLE2, TABLE3
from doo_ti.relaxation.sensitivity_columns import SensitivityColumns
from doo_ti.relaxation.sensitivity_kernel import SensitivitySweep, kernels_at_rest, run_at_rest
from doo_ti.rod.types import Solution
from doo_ti.system import runtime
from doo_ti.system.arguments import short_repr, typed
from doo_ti.system.errors import InputError, real_array


@device_functions
class Adjoint(SensitivityColumns):
    """The adjoint solve in place of the columns. ``tables`` holds, besides: pulls and twists, the cotangents; displaced and
    turned, dx and p; gradient, by each direction; curvature, by ω̄ of every joint.

    A class that derives from this one and from one that solves columns where rods touch obstacles adds ``pushed_work``.
    """

    def differentiate(self, tables, rod, index, known):
        """The gradients of a rod at rest, as :meth:`.SensitivityColumns.differentiate` has its columns."""
        row = tables.rods[index, of.RESULT_ROW]
        tables.sound[row] = ti.cast(self.is_minimum(rod, known.multiplier), ti.i32)
        unit = rod.head.energy_unit
        total = variable(repeated(0.0 * rod.total, 3))
        for v in range(rod.edges + 1):
            total = plus(total, read(tables.pulls, row, v, 0))
        change = self.solve_adjoint(tables, rod, row, total)
        for joint in range(rod.edges - 1):
            self.put_curvature(tables, rod, row, joint, unit)
        for p in range(tables.columns):
            column = self.column(tables, rod, p, known)
            if ti.static(self.touches):
                self.hold_start(rod, column)
            closure = self.assemble_column(rod, column)
            along, work = self.along_column(tables, rod, row, column, total)
            tables.gradient[row, p] = along - dot(change, closure) - unit * work

    def solve_adjoint(self, tables, rod, row, total):
        """p and dx into their tables; returns q. ``total`` is the sum of the forces."""
        none = repeated(0.0 * rod.total, 3)
        # A rod that hangs from its far end moves against the sum.
        beyond = variable(scaled(total, 1.0 - rod.released))
        for e in range(rod.edges):
            edge = self.edge(rod.head, e)
            q = edge.frame
            beyond = minus(beyond, read(tables.pulls, row, e, 0))
            r1, r2 = linear_gradient(beyond, edge.length, first_director(q), second_director(q))
            m = read(tables.twists, row, e, 0)
            edge.rotation = negated((m[0], m[1] + r1, m[2] + r2))
        column = record(local=rod.total < 0.0, move=none, stretch=0.0 * rod.total, turn_start=none, turn_end=none,
                        whole=negated(total))
        change = self.solve_column(rod, column, self.schur_complement(rod), none)
        x = variable(self.started(rod, column))
        factor = 1.0 / rod.head.energy_unit
        for e in range(rod.edges):
            edge = self.edge(rod.head, e)
            write(tables.displaced, row, e, 0, values=scaled(x, factor))
            write(tables.turned, row, e, 0, values=scaled(edge.rotation, factor))
            x = self.end_of_turned(edge, x, edge.rotation, column.stretch)
        write(tables.displaced, row, rod.edges, 0, values=scaled(x, factor))
        return change

    def put_curvature(self, tables, rod, row, joint, unit):
        """−pᵀ ∂g/∂ω̄ of a joint: ½ B δω of both frames, since its energy is that of ω − ω̄ l̄/2 over 2 l̄."""
        bent, s = self.kept_pair(rod, joint)
        x, y, inverse, m, turn = bent
        before, after = read(tables.turned, row, joint, 0), read(tables.turned, row, joint + 1, 0)
        change = pair.curvature_variation(x, y, inverse, turn, before, after)
        none = repeated(0.0 * unit, 2)
        left = pair.moment(s[0], pair.strain((change[0], change[1]), none), 0.25)
        right = pair.moment(s[1], pair.strain((change[2], change[3]), none), 0.25)
        # As the complex numbers i/2 B δω.
        write(tables.curvature, row, joint, 0, values=(unit * (left[1] + right[1]), 0.0 - unit * (left[0] + right[0])))

    def along_column(self, tables, rod, row, column, total):
        """Two numbers: what the cotangents make of the displacements and turns that the column itself prescribes; and pᵀ ∂g/∂θ,
        ∂g/∂θ being in the place of the step, with what obstacles and the weight do to vertices."""
        moved, x = variable(column.move), variable(read(tables.displaced, row, 0, 0))
        along, work = dot(read(tables.pulls, row, 0, 0), moved), rod.loose * dot(x, column.whole)
        for e in range(rod.edges):
            edge, w = self.edge(rod.head, e), self.held_turn_of(rod, e, column)
            after, before = read(tables.displaced, row, e + 1, 0), variable(moved)
            moved = self.end_of_turned(edge, moved, w, column.stretch)
            along += dot(read(tables.pulls, row, e + 1, 0), moved) + dot(read(tables.twists, row, e, 0), w)
            own = dot(read(tables.turned, row, e, 0), edge.rotation)
            if ti.static(self.touches):
                own += self.pushed_work(edge, before, moved, x, after)
            work += own
            x = after
        return along - rod.released * dot(total, moved), work


@device_functions
class AdjointSweep(Adjoint, SensitivitySweep):
    """Of rods that touch nothing."""


@device_functions
class ContactAdjoint(Adjoint, ContactSensitivity):
    """Of rods that touch obstacles, or whose vertex 0 is free among them."""

    def pushed_work(self, edge, before, after, start, end):
        """Of obstacles that an edge touches, whose ends a column moves by ``before`` and ``after``: what the change of their
        forces does along the displacements ``start`` and ``end``."""
        whole, own = self.pushes(edge, before, after)
        return dot(start, whole) + dot(minus(end, start), own)


COTANGENTS = {
    "pulls": TABLE3, "twists": TABLE3,  # [row, vertex or edge, 3] the cotangents; those of edges in the axes of their frames
    "displaced": TABLE3, "turned": TABLE3,  # [row, vertex or edge, 3] out: dx and p
    "gradient": TABLE2,  # [row, column] out
    "curvature": TABLE3,  # [row, joint, 2] out
}


KERNELS = kernels_at_rest("pull_back", COTANGENTS, AdjointSweep, ContactAdjoint)
FORCES = "forces"


@dataclass(frozen=True)
class Pullback:
    """Gradients of R scalars, one for each rod; NaN in rods that are not usable.

    gradient  by the name of the parameter, which ``pulled[name]`` gives as well: (R,) of a number, (R, k) of k numbers in the
              order of their columns; "rest_curvature_per_joint" is (R, E−1, 2), "forces" (R, V, 3)
    usable    (R,) bool: the rod is at a stable equilibrium
    """

    __repr__ = short_repr

    gradient: dict[str, np.ndarray]
    usable: np.ndarray

    def __getitem__(self, name: str) -> np.ndarray:
        return self.gradient[name]


@typed
@runtime.exclusive
def pullback(solution: Solution, cotangent: np.ndarray | None, parameters: Sequence[str] = ("bend", "twist", "weight"),
             modes: np.ndarray | None = None, frames: np.ndarray | None = None) -> Pullback:
    """The gradient of Σ cotangent · vertices + Σ frames · material frames of every rod of ``solution``, cotangents held fixed.

    solution    of :func:`doo_ti.relaxation.relax.relax` in f64
    cotangent   (R, V, 3) derivatives of the scalar by ``solution.configuration.vertices``, per mm; None: zero
    parameters  those of :func:`doo_ti.relaxation.sensitivity.sensitivity`, and "forces": by a force on every vertex, in the
                package's unit (energy in mm² per mm), see :class:`.PointLoads`
    modes       (M, E−1, 2) where "modes" is among the parameters
    frames      (R, E, 3, 3) derivatives of the scalar by ``solution.configuration.frames``; None: zero

    Σ over the rows is the gradient by a parameter that rods share. Rods without derivatives, see :func:`.sensitivity`, come out
    as NaN, whatever their cotangents.

    Raises InputError for cotangents of another shape, or that are not finite in a rod that has derivatives, and where
    :func:`.sensitivity` does.
    """
    solution = sensitivity.alone("pullback", solution)
    table = solution.tables
    sensitivity.check_parameters("pullback", parameters, (*sensitivity.PARAMETERS, FORCES), {"modes": modes}, table)
    usable = sensitivity.at_minima(solution)
    count, edges = table.count, table.edges
    pulls = _cotangent("cotangent", cotangent, (count, edges + 1, 3), usable)
    twists = np.zeros((count, edges, 3))
    if frames is not None:  # by turns of the frames about their own axes
        own = solution.configuration.frames
        moment = np.cross(own, _cotangent("frames", frames, (count, edges, 3, 3), usable), axis=2).sum(axis=-1)
        twists = np.ascontiguousarray(np.einsum("reki,rek->rei", own, moment))
    others = [name for name in parameters if name not in (*sensitivity.CURVATURES, FORCES)]
    directions = [sensitivity.parameter_directions([name], edges, table.up, {})[1] for name in others]
    ends = np.cumsum([0, *map(len, directions)])
    gradient, curvature = np.empty((count, max(1, ends[-1]))), of.room(count, edges - 1, 2)
    displaced, turned = of.room(count, edges + 1, 3), of.room(count, edges, 3)
    rows = np.concatenate(directions) if directions else np.zeros((0, 0))
    sound = run_at_rest(solution, usable, KERNELS, rows, np.zeros((1, edges - 1, 3)), {
        "pulls": pulls, "twists": twists, "displaced": displaced, "turned": turned, "gradient": gradient,
        "curvature": curvature}, 0, count)
    for array in (gradient, curvature, displaced):
        array[~sound] = np.nan
    parts = {name: gradient[:, first] if last == first + 1 else gradient[:, first:last]
             for name, first, last in zip(others, ends, ends[1:], strict=False)}
    hanging, taut = table.released[table.configuration_index], sensitivity.taut_rods(table)
    if "end_shift" in parts:
        parts["end_shift"][hanging] += pulls[hanging].sum(axis=1)  # held at the far end alone they go where it goes
    for name in set(parts) & set(sensitivity.OF_CLAMPS):
        parts[name][taut] = np.nan
    parts |= {FORCES: displaced, "rest_curvature_per_joint": curvature, "rest_curvature": curvature.sum(axis=1)}
    if modes is not None:
        parts["modes"] = np.einsum("rjk,mjk->rm", curvature, modes)
    return Pullback({name: parts[name] for name in parameters}, sound)


def _cotangent(name: str, value: np.ndarray | None, shape: tuple[int, ...], usable: np.ndarray) -> np.ndarray:
    """``value`` in an array of its own, zero in rods that are not usable."""
    if value is None:
        return np.zeros(shape)
    array = real_array("pullback", name, value, "give real numbers")
    if array.shape != shape:
        raise InputError("pullback", name, f"shape {array.shape}", f"give {shape}")
    array = np.where(usable.reshape(-1, *[1] * (len(shape) - 1)), array, 0.0)
    if not np.isfinite(array).all():
        raise InputError("pullback", name, "not finite in a rod that has derivatives", "give finite numbers")
    return np.ascontiguousarray(array, dtype=np.float64)
