"""Groups whose clamps move: one relaxation after the other, each from where the one before ended (docs/groups.md)."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from doo_ti.contact.obstacles import Obstacle
from doo_ti.groups.group import Group
from doo_ti.groups.relax_group import GroupSolution, relax_group
from doo_ti.relaxation.newton import Newton
from doo_ti.types import Clamps, Configuration


def follow_group(group: Group, clamps: Sequence[Sequence[Clamps]], solver: Newton | None = None, *, up: ArrayLike | None = None,
                 obstacles: Sequence[Obstacle] = (), radius: ArrayLike | None = None, contact: bool = True
                 ) -> Iterator[GroupSolution]:
    """The solutions of groups at every moment of a motion without inertia, as they are found.

    clamps  of every moment those of G rods, with N rows each
    the others as :func:`.relax_group` has them

    Friction acts from the first moment on, at which there is none. The rods of a group are drawn from one moment to the next
    and pass through nothing on the way, but frames of clamps turn at once: give moments between which they turn by less than
    the rods bend. A group that has no place at a moment, being INFEASIBLE or not finite there, goes on from the last one at
    which it had.
    """
    before = None
    for held in clamps:
        group = replace(group, clamps=held)
        before = relax_group(group, solver, up=up, obstacles=obstacles, radius=radius, contact=contact, before=before)
        yield before
        group = replace(group, rods=[_placed(*rods) for rods in zip(group.rods, before.rods, strict=True)])


def _placed(old: Configuration, new: Configuration) -> Configuration:
    """The rods where they are now, or where they were if they have no place."""
    lost = np.isnan(new.start).any(axis=1)
    return replace(new, start=np.where(lost[:, None], old.start, new.start),
                   quaternions=np.where(lost[:, None, None], old.quaternions, new.quaternions))
