"""Groups whose clamps move: one relaxation after the other, each from where the one before ended (docs/groups.md)."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from doo_ti.contact.obstacles import Obstacle
from doo_ti.dynamics.parameters import Dynamics, Stepping
from doo_ti.groups.group import Group
from doo_ti.groups.inertia import MovingGroups
from doo_ti.groups.relax_group import GroupSolution, relaxed
from doo_ti.relaxation.newton import Newton
from doo_ti.rod.types import Clamps, Configuration
from doo_ti.system.arguments import typed
from doo_ti.system.errors import InputError


@typed
def follow_group(group: Group, clamps: Sequence[Sequence[Clamps]], solver: Newton | None = None, *, up: ArrayLike | None = None,
                 obstacles: Sequence[Obstacle] = (), radius: ArrayLike | None = None, contact: bool = True,
                 dynamics: Dynamics | Sequence[Dynamics] | None = None, rate: float | None = None, scheme: str = "bdf2"
                 ) -> Iterator[GroupSolution]:
    """The solutions of groups at every moment of a motion, as they are found.

    clamps    of every moment those of G rods, with N rows each; how they hold an end may change, too
    dynamics  mass, damping and drag of the rods, one for all or one for each: they have inertia then, and begin at rest at
              their minimum at the first moment. None: every moment is a minimum
    rate      moments per second, where the rods have inertia. The way from each to the next is one time step
    scheme    "bdf2", of second order, or "euler"
    the others as :func:`.relax_group` has them

    Friction acts from the first moment on, at which there is none. The rods of a group are drawn from one moment to the next
    and pass through nothing on the way, but frames of clamps turn at once: give moments between which they turn by less than
    the rods bend. A group that has no place at a moment, being INFEASIBLE or not finite there, goes on from the last one at
    which it had, at rest.

    Raises InputError as :func:`.relax_group` does, and for ``dynamics`` that do not match.
    """
    if (dynamics is None) != (rate is None):
        missing, other = ("rate", "dynamics") if rate is None else ("dynamics", "rate")
        raise InputError("follow_group", missing, f"missing beside {other}", "give both, or neither")
    motion = None if dynamics is None else MovingGroups(group, dynamics, Stepping(rate, scheme=scheme).step, scheme)
    before = None
    for held in clamps:
        group = replace(group, clamps=held)
        before = relaxed(group, solver, up, obstacles, radius, contact, before, motion)
        yield before
        group = replace(group, rods=[_placed(*rods) for rods in zip(group.rods, before.rods, strict=True)])


def _placed(old: Configuration, new: Configuration) -> Configuration:
    """The rods where they are now, or where they were if they have no place."""
    lost = np.isnan(new.start).any(axis=1)
    return replace(new, start=np.where(lost[:, None], old.start, new.start),
                   quaternions=np.where(lost[:, None, None], old.quaternions, new.quaternions))
