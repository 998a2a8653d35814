"""Newton's method on the chain of frames for all rods at once: its options and its kernel (§III-D, docs/chain.md).

A trip through the kernel's loop gives every lane one step and one factorisation. A lane whose rod is finished stores it and
takes the next from a queue, so that all lanes stay busy. The result of a rod does not depend on the others: it is the same
alone and in any batch, in any place.
"""

from dataclasses import dataclass
from functools import cache

import taichi as ti

from doo_ti import runtime
from doo_ti.arguments import typed
from doo_ti.contact.gap_tolerance import require_gap_tolerance
from doo_ti.errors import InputError, require_number, require_whole
from doo_ti.physics.number import Number
from doo_ti.physics.tuples import record
from doo_ti.relaxation.contact_layout import CONTACTS, contact_items
from doo_ti.relaxation.contacts import Contacts
from doo_ti.relaxation.dense_elimination import DenseElimination
from doo_ti.relaxation.elimination import Elimination
from doo_ti.relaxation.loaded_elimination import LoadedElimination
from doo_ti.relaxation.newton_loop import NewtonLoop
from doo_ti.relaxation.newton_policy import UP
from doo_ti.relaxation.pair_layout import self_contact_items
from doo_ti.relaxation.self_contacts import SelfContacts

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
    max_rotation    largest turn of any edge in one step, rad
    max_escapes     how often a rod may leave a saddle it has converged to
    gap_tolerance   of a rod's radius: how far the gap at a contact may be off; in f32 at least 2e-6 of the length. A smaller
                    value makes the forces of single contacts more exact, above all those of stiff rods with short edges.
                    None: 1e-5, and 2e-4 for rods that may touch themselves or each other and where there is friction
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


@cache
def newton_kernel(number: Number, isotropic: bool, stride: int, block: int, serial: bool, external: type | None = None,
                  any_ends: bool = False):
    """The compiled-on-first-use kernel for one kind of number, of material and of external energy.

    stride: distance between the items of an edge in scratch, 1 on a CPU, the number of threads on a GPU.
    block: threads in a block, 1 on a CPU.
    serial: on a CPU, work on the caller's thread: to wake another takes as long as to relax a few rods.
    external: the class of the external energy, whose numbers and field the kernel then takes as two more arrays.
    any_ends: not all rods under the external energy have vertex 0 held and the far end free, which is faster.
    """
    if external is None:
        loop = NewtonLoop(Elimination(number, isotropic, stride))
    else:
        sweep = LoadedElimination(number, isotropic, stride, external, any_ends)
        loop = NewtonLoop(sweep, sweep.functions, external.has_coarse)
    table1, table2, table3 = (ti.types.ndarray(dtype=ti.f64, ndim=size) for size in (1, 2, 3))
    index1, index2 = (ti.types.ndarray(dtype=ti.i32, ndim=size) for size in (1, 2))
    field = ti.types.ndarray(dtype=ti.f32, ndim=1)

    @runtime.kernel
    def newton(
        start: table1,  # [start · edge · 4]
        rest_length: table2,  # [1 or configuration, edge] mm
        clamp: table2,  # [configuration, CLAMP_COLUMNS]
        material: table2,  # [material, STIFFNESS + 1 or edge · STIFFNESS_COLUMNS]
        rods: index2,  # [rod, ROD_COLUMNS]
        policy: table1,  # [POLICY_COLUMNS] of :mod:`doo_ti.relaxation.newton_policy`
        threads: ti.i32,
        scratch: ti.types.ndarray(dtype=number.type, ndim=1),
        queue: index1,  # [NEXT, TRIPS, LANES + thread · lane] zero
        frames: table1,  # [row · edge · 4] in where a rod starts from there, and out
        results: table2,  # [row, RESULTS] out
    ):
        ti.loop_config(block_dim=block, serialize=serial)
        for thread in range(threads):
            up = (policy[UP], policy[UP + 1], policy[UP + 2])
            tables = record(start=start, rest_length=rest_length, clamp=clamp, material=material, up=up, rods=rods,
                            policy=policy, queue=queue, frames=frames, results=results, numbers=material, field=material,
                            contacts=0, kinds=queue, grids=material)
            loop.work(tables, scratch, threads, thread)

    @runtime.kernel
    def newton_under_load(
        start: table1, rest_length: table2, clamp: table2, material: table2, rods: index2, policy: table1, threads: ti.i32,
        scratch: ti.types.ndarray(dtype=number.type, ndim=1), queue: index1, frames: table1, results: table2,
        outer: table3,  # of the external energy
        space: field,  # what it looks up in space
    ):
        ti.loop_config(block_dim=block, serialize=serial)
        for thread in range(threads):
            up = (policy[UP], policy[UP + 1], policy[UP + 2])
            tables = record(start=start, rest_length=rest_length, clamp=clamp, material=material, up=up, rods=rods,
                            policy=policy, queue=queue, frames=frames, results=results, numbers=outer, field=space,
                            contacts=0, kinds=queue, grids=material)
            loop.work(tables, scratch, threads, thread)

    return newton if external is None else newton_under_load


@cache
def contact_kernel(number: Number, isotropic: bool, stride: int, block: int, external: type, obstacles: frozenset[int],
                   itself: bool):
    """The same for rods that may touch obstacles of those kinds, or ``itself``, under an external energy."""
    if itself:
        sweep = DenseLoadedElimination(number, isotropic, stride, external, True, SelfContacts(number, obstacles))
    else:
        sweep = LoadedElimination(number, isotropic, stride, external, True, Contacts(number, obstacles, expects=True))
    size = self_contact_items if itself else contact_items
    loop = NewtonLoop(sweep, sweep.functions, external.has_coarse)
    table1, table2, table3, table4 = (ti.types.ndarray(dtype=ti.f64, ndim=size) for size in (1, 2, 3, 4))
    index1, index2 = (ti.types.ndarray(dtype=ti.i32, ndim=size) for size in (1, 2))
    field = ti.types.ndarray(dtype=ti.f32, ndim=1)

    @runtime.kernel
    def newton_in_contact(
        start: table1, rest_length: table2, clamp: table2, material: table2, rods: index2, policy: table1, threads: ti.i32,
        scratch: ti.types.ndarray(dtype=number.type, ndim=1), queue: index1, frames: table1, results: table2,
        outer: table3, space: field,  # as :func:`newton_kernel` has them
        obstacles: table3,  # [1 or row, obstacle, OBSTACLE_COLUMNS]
        kinds: index1,  # [obstacle] and, of a grid, its number
        grids: table1,  # of the grids, see :func:`doo_ti.contact.distance_grid.grid_table`
        radius: table1,  # [1 or row] mm
        gap_tolerance: ti.f64,  # over the radius
        memory: table4,  # [row, vertex, obstacle, REMEMBERED] in and out
        forces: table3,  # [row, vertex, 3] out
        self_friction: table1,  # [1 or row] coefficient of the rod on itself
    ):
        ti.loop_config(block_dim=block)
        for thread in range(threads):
            up = (policy[UP], policy[UP + 1], policy[UP + 2])
            edges = rest_length.shape[1]
            contacts = sweep.behind(scratch, threads, thread, edges, size(edges, kinds.shape[0]), CONTACTS)
            tables = record(start=start, rest_length=rest_length, clamp=clamp, material=material, up=up, rods=rods,
                            policy=policy, queue=queue, frames=frames, results=results, numbers=outer, field=space,
                            contacts=contacts, obstacles=obstacles, kinds=kinds, grids=grids, radius=radius,
                            tolerance=gap_tolerance, memory=memory, forces=forces, self_friction=self_friction)
            loop.work(tables, scratch, threads, thread)

    return runtime.compiled_briefly(newton_in_contact)
