"""Gradients of a scalar function of rods at rest by their parameters: the adjoint of :mod:`doo_ti.relaxation.sensitivity`.

    loss = Σ |x − x̂|²
    pulled = pullback(solution, 2 (x − x̂), ("bend", "rest_curvature_per_joint"))
    pulled["rest_curvature_per_joint"]      # (R, E−1, 2) ∂loss/∂ω̄

One solve for each rod, whatever the number of parameters: what automatic differentiation needs for its reverse mode.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from doo_ti.relaxation.end_loads import alone
from doo_ti.relaxation.pullback_kernel import run_pullback
from doo_ti.relaxation.sensitivity import (
    CURVATURES,
    OF_CLAMPS,
    PARAMETERS,
    at_minima,
    check_parameters,
    parameter_directions,
    taut_rods,
)
from doo_ti.rod.types import Solution
from doo_ti.system import runtime
from doo_ti.system.arguments import typed
from doo_ti.system.errors import InputError, real_array
from doo_ti.system.short_repr import short_repr

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
    solution = alone("pullback", solution)
    table = solution.tables
    check_parameters("pullback", parameters, (*PARAMETERS, FORCES), modes, table)
    usable = at_minima(solution)
    count, edges = table.count, table.edges
    pulls = _cotangent("cotangent", cotangent, (count, edges + 1, 3), usable)
    twists = np.zeros((count, edges, 3)) if frames is None else _in_own_axes(
        solution.configuration.frames, _cotangent("frames", frames, (count, edges, 3, 3), usable))
    others = [name for name in parameters if name not in (*CURVATURES, FORCES)]
    directions = [parameter_directions([name], edges, table.up)[1] for name in others]
    runtime.start()
    rows = np.concatenate(directions) if directions else np.zeros((0, 0))
    gradient, curvature, displaced, sound = run_pullback(solution, usable, rows, pulls, twists)
    ends = np.cumsum([0, *map(len, directions)])
    parts = {name: gradient[:, first] if last == first + 1 else gradient[:, first:last]
             for name, first, last in zip(others, ends, ends[1:], strict=False)}
    hanging, taut = table.released[table.configuration_index], taut_rods(table)
    if "end_shift" in parts:
        parts["end_shift"][hanging] += pulls[hanging].sum(axis=1)  # held at the far end alone they go where it goes
    for name in set(parts) & set(OF_CLAMPS):
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


def _in_own_axes(frames: np.ndarray, cotangent: np.ndarray) -> np.ndarray:
    """(R, E, 3) derivatives by turns of the ``frames`` about their own axes, of those by the frames (R, E, 3, 3) themselves."""
    moment = np.cross(frames, cotangent, axis=2).sum(axis=-1)
    return np.ascontiguousarray(np.einsum("reki,rek->rei", frames, moment))
