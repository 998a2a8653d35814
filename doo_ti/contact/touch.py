"""When a rod touches: how far the gap at a contact may be off, whether it sticks or slips, and what obstacles exert
(docs/contact.md). Axes: R rods, V vertices."""

from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property

import numpy as np

from doo_ti.contact.surroundings import Surroundings
from doo_ti.system.errors import InputError

GAP_TOLERANCE = 2e-4
"""Of a rod's radius, unless another is given: a gap may be off by that, or a force by that times the stiffness κ."""
GAP_TOLERANCE_OF_OBSTACLES = 1e-5
"""The same in ``relax`` of rods that may touch obstacles only, whose forces settle with the steps and so at little cost."""
GAP_TOLERANCE_IN_MOTION = 4e-5
"""The same of rods in motion that may touch obstacles only: a gap that closes lifts the rod, which costs energy."""
LEAST, MOST = 1e-10, 0.1  # what may be given; smaller ones are below rounding
HELD = 0.999  # a contact is said to stick while its friction is below that share of the coefficient times its force


def gap_tolerance(given: float | None, itself: bool, in_motion: bool) -> float:
    """``given``, or the usual one of rods that may touch themselves or each other, or obstacles alone, in a motion or not."""
    usual = GAP_TOLERANCE if itself else GAP_TOLERANCE_IN_MOTION if in_motion else GAP_TOLERANCE_OF_OBSTACLES
    return usual if given is None else given


def require_gap_tolerance(source: str, value: float) -> None:
    """Raise InputError, naming ``source``, unless ``value`` may be given."""
    if not LEAST <= value <= MOST:
        raise InputError(source, "gap_tolerance", f"{value:g} of the radius is not allowed", f"give {LEAST:g} to {MOST:g}")


class Touch(IntEnum):
    """What a vertex, with the edge that ends there, does at an instant of a motion: touch nothing, stick or slip."""

    NONE = 0
    """They touch nothing."""
    STICKS = 1
    """Friction holds every place where they touch."""
    SLIPS = 2
    """In some place friction is as large as its coefficient allows, or there is none."""


@dataclass(frozen=True)
class Contacts:
    """Contacts of R rods with the obstacles around them.

    force         (R, V, 3) of obstacles on the vertices, mm (energy per mm): times ``material.newton`` N. That on an edge is
                  divided between its ends
    vertices      (R, V, 3) mm
    surroundings  the obstacles and the rods' radius
    """

    force: np.ndarray
    vertices: np.ndarray
    surroundings: Surroundings

    @property
    def touching(self) -> np.ndarray:
        """(R, V) bool: vertices that an obstacle pushes, at the vertex or at an edge beside it."""
        return (self.force != 0.0).any(axis=-1)

    @cached_property
    def gap(self) -> np.ndarray:
        """(R,) mm, see :meth:`.Surroundings.smallest_gap`."""
        return self.surroundings.smallest_gap(self.vertices)
