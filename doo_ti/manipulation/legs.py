"""Legs of a plan: rods carried along straight motions of their grippers, kept only where they stay on their branch of certified
equilibria. Axes: N legs."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from doo_ti.contact.surroundings import Surroundings
from doo_ti.manipulation.poses import change_between, moved
from doo_ti.motion.journey import Journey
from doo_ti.motion.path import LARGEST_TURN, motion_between
from doo_ti.rod.types import Clamps, Configuration, Material

SAME = 2e-3
"""Of the rod's length, between two shapes of one equilibrium: a tenth of what branches differ by, a thousand times rounding."""
CLEAR = 2e-3
"""Of the rod's length, to obstacles: as near as equilibria are told apart."""
SHARES = (0.5, 1.0)
"""Of the way between two sub-steps, where the distance to obstacles is measured."""
PIECES = np.linspace(1.0, 0.3, 8)
"""Shares of a rod of which the shapes are by which it is unwound."""


@dataclass(frozen=True)
class Carrier:
    """What is constant on all legs: one material, what surrounds the rods, and the direction against gravity.

    touches  rods may touch obstacles on the way; else they keep CLEAR of them, which is much faster to follow
    """

    material: Material
    rest_length: np.ndarray
    up: np.ndarray
    surroundings: Surroundings
    touches: bool = False

    @property
    def length(self) -> float:
        """mm."""
        return float(self.rest_length.sum())

    def carry(self, rods: Configuration, clamps: Clamps, goal: Clamps) -> tuple[Configuration, np.ndarray]:
        """The N rods after their grippers went from ``clamps`` to ``goal``, and which of them (N,) stayed on their branch, at
        certified rest all the way, and clear of obstacles."""
        around = self.surroundings.take(np.zeros(rods.count, dtype=np.int64)) if self.touches else Surroundings()
        journey = Journey(motion_between(clamps, goal), self.material, LARGEST_TURN, self.rest_length, self.up,
                          surroundings=around)
        solution, jumps = journey.end(rods)
        sound = solution.converged & solution.stable & (jumps == 0)
        rows = np.flatnonzero(sound) if self.surroundings and not self.touches else np.zeros(0, dtype=int)
        if len(rows):
            part = Journey(journey.motion.take(rows), self.material, LARGEST_TURN, self.rest_length, self.up)
            before = rods.take(rows).vertices
            for state in part.follow(rods.take(rows)):
                here = state.configuration.vertices
                for share in SHARES:
                    sound[rows] &= self.clear(before + share * (here - before))
                before = here
        return solution.configuration, sound

    def clear(self, vertices: np.ndarray) -> np.ndarray:
        """(N,) bool: whether rods with those vertices (N, V, 3) keep clear of the obstacles."""
        around = self.surroundings.take(np.zeros(len(vertices), dtype=np.int64))
        return around.smallest_gap(vertices) > CLEAR * self.length

    def same(self, rods: Configuration, others: Configuration) -> np.ndarray:
        """(N,) bool: whether two shapes are one equilibrium."""
        return np.linalg.norm(rods.vertices - others.vertices, axis=-1).max(axis=1) < SAME * self.length


def unwound(rod: Configuration, clamps: Clamps) -> Iterator[Clamps]:
    """The grippers' poses that unwind one rod, from the middle on, to one that is nearly straight.

    A weightless rod of which a part is taken, and stretched to the whole length, is at rest again, and every part of a stable
    rod is stable (Bretl and McCarthy, IJRR 2014, §5: loads scaled so are shortened rods). Taking ever shorter parts leads from
    any equilibrium to a straight rod. Weight and obstacles may prevent it: legs are checked.
    """
    frames, lengths = rod.frames[0], rod.rest_length
    middle = np.concatenate([[0.0], np.cumsum(lengths)])
    centre = 0.5 * (middle[:-1] + middle[1:]) / lengths.sum()
    vertices = rod.vertices[0]
    quaternions = rod.quaternions[0] * _alike(rod.quaternions[0])[:, None]
    # A gripper's frame differs from that of the edge that it holds where it holds only a tangent.
    own = [np.swapaxes(frames[edge], 0, 1) @ held[0] for edge, held in ((0, clamps.start_frame), (-1, clamps.end_frame))]
    for share in PIECES[1:]:
        place = 0.5 + share * (centre - 0.5)
        part = np.stack([np.interp(place, centre, column) for column in quaternions.T], axis=-1)
        part /= np.linalg.norm(part, axis=-1, keepdims=True)
        shape = Configuration(np.zeros((1, 3)), part[None], lengths)
        points = shape.vertices[0]
        points = points + vertices.mean(axis=0) - points.mean(axis=0)
        yield Clamps(clamps.start, clamps.end, points[:1], points[-1:], (shape.frames[0, 0] @ own[0])[None],
                     (shape.frames[0, -1] @ own[1])[None])


def _alike(quaternions: np.ndarray) -> np.ndarray:
    """(E,) signs that make quaternions (E, 4) continuous."""
    steps = np.sum(quaternions[1:] * quaternions[:-1], axis=-1)
    return np.concatenate([[1.0], np.cumprod(np.where(steps < 0, -1.0, 1.0))])


def between(clamps: Clamps, goal: Clamps, share: np.ndarray) -> Clamps:
    """The N poses after ``share`` (N,) of the straight motions."""
    return moved(clamps, change_between(clamps, goal) * share[:, None])
