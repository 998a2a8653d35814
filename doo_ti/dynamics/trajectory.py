"""What a simulation returns. Axes: R rods, F frames, V vertices, E edges, P parameters."""

from dataclasses import dataclass

import numpy as np

from doo_ti.relaxation.time_steps import Memory
from doo_ti.rod.types import Status
from doo_ti.system.arguments import short_repr


@dataclass(frozen=True)
class Detail:
    """R rods at the start and at F frames; NaN from where a rod failed.

    quaternions  (R, F + 1, E, 4) frames
    velocities   (R, F + 1, V, 3) mm/s
    energies     (R, F + 1) by name, mm²: see :meth:`doo_ti.dynamics.energies.Account.detail`
    """

    quaternions: np.ndarray
    velocities: np.ndarray
    energies: dict[str, np.ndarray]


@dataclass(frozen=True)
class Trajectory:
    """R rods at F frames. From where a rod failed its positions are NaN, and its forces and work zero.

    positions   (R, F, V, 3) mm
    status      (R, F) Status; a rod that failed keeps its status to the end
    iterations  (R, F) Newton iterations of all steps since the frame before
    residual    (R, F) the largest residual of those steps
    end_force   (R, F, 3) force of the far clamp on the rod, mm (energy in mm² per mm), zero where an end is free, NaN where the
                rod is taut: its tension is not determined
    rate        frames per second
    memory      frames, positions and velocities at the last two instants
    substeps    (R,) time steps from one frame to the next
    error       (R,) mm, estimated error of the time steps, of the vertex and frame where it is largest; NaN where it was not
                estimated, infinite where no finer steps confirm the motion
    slopes      (R, F, P, V, 3) derivatives of positions along the ``directions`` of :func:`.simulate`, or None
    detail      frames, velocities and energies, if asked for, or None
    contact_force  (R, F, V, 3) of obstacles on vertices, friction included, mm (energy per mm), or None without obstacles
    friction_work  (R, F) energy that friction has taken since the start, mm²
    touch       (R, F, V) :class:`.Touch` of each vertex and the edge that ends there, or None without obstacles
    """

    __repr__ = short_repr

    positions: np.ndarray
    status: np.ndarray
    iterations: np.ndarray
    residual: np.ndarray
    end_force: np.ndarray
    rate: float
    memory: Memory
    substeps: np.ndarray
    error: np.ndarray
    slopes: np.ndarray | None = None
    detail: Detail | None = None
    contact_force: np.ndarray | None = None
    friction_work: np.ndarray | None = None
    touch: np.ndarray | None = None

    @property
    def converged(self) -> np.ndarray:
        """(R,) whether all steps of the rod have converged."""
        return self.status[:, -1] == Status.CONVERGED


def joined(parts: list[np.ndarray]) -> np.ndarray:
    """The frames of several launches; a copy only where there are several."""
    return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)
