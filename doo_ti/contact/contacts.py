"""Where relaxed rods touch obstacles, and what these exert (docs/contact.md). Axes: R rods, V vertices."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from doo_ti.contact.surroundings import Surroundings


@dataclass(frozen=True)
class Contacts:
    """Contacts of R rods with the obstacles around them.

    force         (R, V, 3) of obstacles on the vertices, mm (energy per mm); the force on an edge is divided between its ends
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
