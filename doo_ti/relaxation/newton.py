"""Newton's method on the chain of frames for all rods at once: its options and its kernel (§III-D, docs/chain.md).

A trip through the kernel's loop gives every lane one step and one factorisation. A lane whose rod is finished stores it and
takes the next from a queue, so that all lanes stay busy. The result of a rod does not depend on the others: it is the same
alone and in any batch, in any place.
"""

from dataclasses import dataclass
from functools import cache

import taichi as ti

from doo_ti.contact.touch import require_gap_tolerance
from doo_ti.physics.number import Number
from doo_ti.relaxation.contacts import Contacts
from doo_ti.relaxation.dense_elimination import DenseElimination
from doo_ti.relaxation.elimination import Elimination
from doo_ti.relaxation.kernel_factory import (
    FIELD,
    INDEX1,
    INDEX2,
    SCRATCH,
    TABLE1,
    TABLE2,
    TABLE3,
    TABLE4,
    loop_kernel,
)
from doo_ti.relaxation.loaded_elimination import LoadedElimination
from doo_ti.relaxation.newton_loop import NewtonLoop
from doo_ti.relaxation.self_contacts import SelfContacts
from doo_ti.system.arguments import typed
from doo_ti.system.errors import InputError, require_number, require_whole

MOST_IN_CONTACT = 1000
"""Iterations allowed per rod where no solver is given and rods may touch something: on a slope they slide far."""


@typed
@dataclass(frozen=True)
class Newton:
    """Options of the Newton solver.

    tolerance       residual to reach: moment times length over stiffness, without a unit; None: TOLERANCES
    max_iterations  factorisations allowed per rod
    first_shift     shift δ of the first factorisation over the largest diagonal entry of H. Zero follows the path of
                    descent more closely and takes more iterations (``careful``).
    max_rotation    largest turn of any edge in one step, rad; in contact also the largest share of a gap, and of the way to the
                    middle of an obstacle, that a step may take
    max_escapes     how often a rod may leave a saddle it has converged to; then it has converged there, not stable
    gap_tolerance   of a rod's radius: how far the gap at a contact may be off; in f32 at least 2e-6 of the length. A smaller
                    value makes the forces of single contacts more exact, above all those of stiff rods with short edges.
                    None: 1e-5, and 2e-4 for rods that may touch themselves or each other
    """

    tolerance: float | None = None
    max_iterations: int = 300
    first_shift: float = 0.05
    max_rotation: float = 0.6
    max_escapes: int = 3
    gap_tolerance: float | None = None

    def __post_init__(self) -> None:
        for name in ("first_shift", "max_rotation", *(() if self.tolerance is None else ("tolerance",))):
            require_number("Newton", name, getattr(self, name))
        if self.tolerance is not None and not self.tolerance > 0:
            raise InputError("Newton", "tolerance", f"{self.tolerance} is not positive", "give a positive number")
        for name, least in (("max_iterations", 1), ("max_escapes", 0)):
            require_whole("Newton", name, getattr(self, name), least)
        if not 0 < self.max_rotation <= 1:
            raise InputError("Newton", "max_rotation", f"{self.max_rotation}", "give radians above 0, at most 1")
        if self.gap_tolerance is not None:
            require_gap_tolerance("Newton", self.gap_tolerance)
        if not 0 <= self.first_shift < float("inf"):
            raise InputError("Newton", "first_shift", f"{self.first_shift}", "give a finite number from zero up")

    @classmethod
    def careful(cls, tolerance: float | None = None, max_iterations: int = 300) -> "Newton":
        """The options that stay closest to descent: use them where the basin matters (ribbons)."""
        return cls(tolerance, max_iterations, first_shift=0.0)


class DenseLoadedElimination(DenseElimination, LoadedElimination):
    """The Newton system of rods that may touch themselves."""


TOLERANCES = {32: 9.9e-5, 64: 9.9e-8}
"""The residual that counts as converged, by bits: of a rod of 99 mm a moment over stiffness of 1e-6 and 1e-9 1/mm."""


# What kernels are given, in this order.
NEWTON = {
    "start": TABLE1,  # [start · edge · 4]
    "rest_length": TABLE2,  # [1 or configuration, edge] mm
    "clamp": TABLE2,  # [configuration, CLAMP_COLUMNS]
    "material": TABLE2,  # [material, STIFFNESS + 1 or edge · STIFFNESS_COLUMNS]
    "rods": INDEX2,  # [rod, ROD_COLUMNS]
    "policy": TABLE1,  # [POLICY_COLUMNS] of :mod:`doo_ti.relaxation.newton_policy`
    "threads": ti.i32,
    "scratch": SCRATCH,
    "queue": INDEX1,  # [NEXT, TRIPS, LANES + thread · lane] zero
    "frames": TABLE1,  # [row · edge · 4] in where a rod starts from there, and out
    "results": TABLE2,  # [row, RESULTS] out
}
OUTER = {
    "numbers": TABLE3,  # of the external energy
    "field": FIELD,  # what it looks up in space
}
OBSTACLES = {
    "obstacles": TABLE3,  # [1 or row, obstacle, OBSTACLE_COLUMNS]
    "kinds": INDEX1,  # [obstacle] and, of a grid, its number
    "grids": TABLE1,  # of the grids, see :func:`doo_ti.contact.distance_grid.grid_table`
    "radius": TABLE1,  # [1 or row] mm
    "tolerance": ti.f64,  # of gaps, over the radius
    "memory": TABLE4,  # [row, vertex, obstacle, REMEMBERED] in and out
    "forces": TABLE3,  # [row, vertex, 3] out
    "self_friction": TABLE1,  # [1 or row] coefficient of the rod on itself
}


@cache
def newton_kernel(number: Number, stride: int, block: int, isotropic: bool, external: type | None = None,
                  any_ends: bool = False):
    """(The compiled-on-first-use kernel for one kind of number, of material and of external energy, and a function of its
    arrays, :meth:`.Chain.items`.)

    stride: distance between the numbers of a thread in scratch, 1 on a CPU, at least the number of threads on a GPU.
    block: see :func:`.loop_kernel`.
    external: the class of the external energy, whose numbers and field the kernel then takes as two more arrays.
    any_ends: not all rods under the external energy have vertex 0 held and the far end free, which is faster.
    """
    if external is None:
        sweep = Elimination(number, isotropic, stride)
        return loop_kernel("newton", number, NEWTON, NewtonLoop(sweep).work, block), sweep.items
    sweep = LoadedElimination(number, isotropic, stride, external, any_ends)
    loop = NewtonLoop(sweep, sweep.functions, external.has_coarse)
    return loop_kernel("newton_under_load", number, NEWTON | OUTER, loop.work, block), sweep.items


@cache
def contact_kernel(number: Number, stride: int, block: int, isotropic: bool, external: type, obstacles: frozenset[int],
                   itself: bool):
    """The same for rods that may touch obstacles of those kinds, or ``itself``, under an external energy."""
    if itself:
        sweep = DenseLoadedElimination(number, isotropic, stride, external, True, SelfContacts(number, obstacles))
    else:
        sweep = LoadedElimination(number, isotropic, stride, external, True, Contacts(number, obstacles, expects=True))
    loop = NewtonLoop(sweep, sweep.functions, external.has_coarse)
    kernel = loop_kernel("newton_in_contact", number, NEWTON | OUTER | OBSTACLES, loop.work, block, brief=True)
    return kernel, sweep.items
