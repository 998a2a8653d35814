"""Recordings as they are predicted under any Θ of one rod: each from its first two frames on, open loop (docs/dynamics.md).

Axes: R recordings, G values of Θ, T frames, V markers, P directions.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from doo_ti.contact.surroundings import Surroundings
from doo_ti.contact.touch import GAP_TOLERANCE
from doo_ti.dynamics.layout import Layout, lay_out
from doo_ti.dynamics.parameters import Direction, MovingStart, Stepping
from doo_ti.dynamics.recorded import RecordedMotion
from doo_ti.dynamics.simulate import simulate
from doo_ti.dynamics.theta import MotionTheta, simulated
from doo_ti.dynamics.trajectory import Trajectory
from doo_ti.rod.types import Clamp

SMOOTHED = 0.09
"""s, over which recordings among obstacles are smoothed."""
NUMBERS_AT_ONCE = 16_000_000
"""Numbers of positions that a simulation returns."""


@dataclass(frozen=True)
class Nearby:
    """Two values of Θ along a direction, and how far they are from each other in it."""

    before: MotionTheta
    after: MotionTheta
    distance: float


@dataclass(frozen=True)
class Rollouts:
    """How the recordings of a motion are rolled out.

    motion        R recordings
    layout        where their simulations begin, and their grippers
    stepping      time steps, at the rate of the recordings
    surroundings  what the rods may touch, with one row for all recordings or R; a Θ with friction has that against all of it
                  but the rod itself
    """

    motion: RecordedMotion
    layout: Layout
    stepping: Stepping
    surroundings: Surroundings = Surroundings()

    @classmethod
    def of(cls, motion: RecordedMotion, theta: MotionTheta, stepping: Stepping, end: Clamp,
           surroundings: Surroundings = Surroundings(), smoothing: int | None = None) -> "Rollouts":
        """The rollouts of a motion.

        theta      of the rod; only its lengths and its roll reference are read
        end        what the far gripper holds, if there is one
        smoothing  as of :func:`.lay_out`; None: 1, but among obstacles the frames of :data:`SMOOTHED`: noise of a gripper
                   shakes the rod, which then slips where it would have stuck
        """
        if smoothing is None:
            smoothing = 2 * int(0.5 * SMOOTHED * motion.rate) + 1 if surroundings else 1
        return cls(motion, lay_out(motion, theta.rest_length, theta.reference, end, smoothing), stepping, surroundings)

    @property
    def depth(self) -> np.ndarray:
        """(R,) mm by which the rods, as their grippers hold them, are inside an obstacle at some step; zero where they are not.
        Such a recording cannot be rolled out."""
        radius = np.asarray(self.surroundings.radius, dtype=np.float64) if self.surroundings else np.zeros(())
        deepest = np.full(self.motion.count, -np.inf)
        for obstacle in self.surroundings.bodies:
            deepest = np.maximum(deepest, radius - obstacle.distance(self.layout.held)[0].min(axis=1))
        return np.where(deepest > GAP_TOLERANCE * radius, deepest, 0.0)

    @property
    def through_steps(self) -> bool:
        """Whether derivatives go through the time steps. Among obstacles they are differences of rollouts: where a contact
        begins, or begins to slip, no derivative says how much further away that would happen."""
        return not self.surroundings

    def predicted(self, thetas: Sequence[MotionTheta]) -> tuple[np.ndarray, np.ndarray]:
        """((R, G, T, V, 3) positions of the recordings under each Θ, (R, G, T) status): frames 0 and 1 and the grippers'
        vertices as given, the rest predicted; NaN where a rod failed."""
        at_once = max(1, NUMBERS_AT_ONCE // self.motion.positions.size)
        parts = [self._shown(self._rolled_out(some), len(some))
                 for some in (thetas[k : k + at_once] for k in range(0, len(thetas), at_once))]
        return tuple(np.concatenate(arrays, axis=1) for arrays in zip(*parts, strict=True))

    def simulated(self, theta: MotionTheta, progress=None) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray], Trajectory]:
        """(positions (R, T, V, 3), status (R, T), energies (R, T) by name, the simulation itself) under one Θ, as
        :meth:`predicted`. Energies are NaN in frame 0: the simulation begins at frame 1. Contact forces (R, T, V, 3),
        :class:`.Touch` (R, T, V) and work of friction (R, T) in the simulation are those at the recordings' frames, and zero in
        frames 0 and 1; ``end_force`` (R, T − 2, 3) has no values there."""
        found = replace(self, stepping=replace(self.stepping, detailed=True))._rolled_out([theta], progress=progress)
        positions, status = (value[:, 0] for value in self._shown(found, 1))
        rods = np.arange(self.motion.count)[:, None]
        energies = {name: np.concatenate([np.full((self.motion.count, 1), np.nan), value[rods, self.layout.steps]], axis=1)
                    for name, value in ({} if found.detail is None else found.detail.energies).items()}
        found = replace(found, end_force=found.end_force[rods, self._at])
        if self.surroundings:
            for name in ("contact_force", "friction_work", "touch"):
                value = getattr(found, name)[rods, self._at]
                found = replace(found, **{name: np.concatenate([np.zeros_like(value[:, :1])] * 2 + [value], axis=1)})
        return positions, status, energies, found

    def differentiated(self, theta: MotionTheta, directions: Sequence[Nearby]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(positions (R, T − 2, W, 3), their derivatives along P directions (R, P, T − 2, W, 3), status (R, T − 2)) of the W
        vertices that :meth:`predicted` predicts."""
        if not self.through_steps:
            return self._differences(theta, directions)
        along = [Direction(simulated([one.before]), simulated([one.after]), one.distance) for one in directions]
        found = self._rolled_out([theta], directions=along)
        rods, at, vertices = np.arange(self.motion.count)[:, None], self._at, self.motion.predicted
        slopes = np.moveaxis(found.slopes[rods, at, :, vertices], 2, 1)
        return found.positions[rods, at, vertices], slopes, found.status[rods, at]

    def _differences(self, theta: MotionTheta, directions: Sequence[Nearby]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The same by differences; the status is the worst of all rollouts."""
        positions, status = self.predicted([theta, *(one.before for one in directions), *(one.after for one in directions)])
        positions, count = positions[:, :, 2:, self.motion.predicted], len(directions)
        distance = np.array([one.distance for one in directions]).reshape(-1, 1, 1, 1)
        slopes = (positions[:, 1 + count :] - positions[:, 1 : 1 + count]) / distance
        return positions[:, 0], slopes, status[:, :, 2:].max(axis=1)

    @property
    def _at(self) -> np.ndarray:
        """(R, T − 2) frame of the simulation for each that is predicted."""
        return self.layout.steps[:, 1:] - 1

    def _rolled_out(self, thetas: Sequence[MotionTheta], **more) -> Trajectory:
        """The simulation of every recording under every Θ."""
        count, each, layout = self.motion.count, len(thetas), self.layout
        pairs = np.repeat(np.arange(count), each), np.tile(np.arange(each), count)
        material, dynamics = simulated(thetas)
        start = MovingStart(layout.start, layout.velocity, layout.velocity_age)
        surroundings = self.surroundings.take(pairs[0])
        if thetas[0].friction is not None:
            surroundings = surroundings.rubbing(np.array([theta.friction for theta in thetas])[pairs[1]])
        return simulate(start, material, layout.grippers, dynamics, self.stepping, up=thetas[0].up, pairs=pairs,
                        **surroundings.arguments, **more)

    def _shown(self, found: Trajectory, each: int) -> tuple[np.ndarray, np.ndarray]:
        """What :meth:`predicted` returns, of a simulation under G = ``each`` Θ."""
        motion, at = self.motion, self._at
        rods = np.arange(motion.count)[:, None]
        positions = np.repeat(motion.positions[:, None], each, axis=1)
        inner = found.positions.reshape(motion.count, each, -1, *motion.positions.shape[2:])
        for g in range(each):
            positions[:, g, 2:, motion.predicted] = inner[rods, g, at][:, :, motion.predicted]
        status = np.zeros(positions.shape[:3], dtype=np.int8)
        status[:, :, 2:] = np.moveaxis(found.status.reshape(motion.count, each, -1)[rods, :, at], 2, 1)
        return positions, status


def mean_error(positions: np.ndarray, recorded: np.ndarray) -> np.ndarray:
    """(R, T) mm: mean of |difference| over all markers and coordinates (L1), positions (R, T, V, 3)."""
    return np.abs(positions - recorded).mean(axis=(-1, -2))
