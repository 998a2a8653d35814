"""Shapes of rods as the pose of one edge, the anchor, and the rotation from each edge to the next: numbers that may be
interpolated, averaged and drawn at random. Axes: R rods, N others, E edges."""

from dataclasses import dataclass

import numpy as np

from doo_ti.rod.frames import quaternion_of_turn, quaternion_product, rotation_vector
from doo_ti.rod.types import Configuration

BENDING, WAVES = 1.5, 3
"""rad, standard deviation of what each cosine along the rod adds to each component of a random rod's rotations."""


@dataclass(frozen=True)
class Shapes:
    """R rods.

    place        (R, 3) mm, the middle of the anchor
    frame        (R, 4) its frame
    joints       (R, E−1, 3) rad, rotation vectors from each edge to the next, in the axes of the edge
    rest_length  (E,) mm
    anchor       number of an edge
    """

    place: np.ndarray
    frame: np.ndarray
    joints: np.ndarray
    rest_length: np.ndarray
    anchor: int

    @classmethod
    def of(cls, rods: Configuration, anchor: int) -> "Shapes":
        """Those of ``rods``, which turn by less than half a turn from each edge to the next."""
        frames = rods.quaternions
        joints = rotation_vector(quaternion_product(_inverse(frames[:, :-1]), frames[:, 1:]))
        place = rods.vertices[:, anchor : anchor + 2].mean(axis=1)
        return cls(place, frames[:, anchor], joints, rods.rest_length, anchor)

    @classmethod
    def at_random(cls, count: int, low: np.ndarray, high: np.ndarray, rest_length: np.ndarray, anchor: int,
                  random: np.random.Generator) -> "Shapes":
        """``count`` of them between the corners ``low`` and ``high`` (3,) mm, in all directions, bent and twisted by
        cosines."""
        joints = len(rest_length) - 1
        waves = np.cos(np.pi * np.arange(WAVES)[:, None] * np.linspace(0.0, 1.0, joints)) / joints
        frame = random.normal(size=(count, 4))
        return cls(random.uniform(low, high, (count, 3)), frame / np.linalg.norm(frame, axis=1, keepdims=True),
                   np.einsum("rkc,kj->rjc", BENDING * random.normal(size=(count, WAVES, 3)), waves), rest_length, anchor)

    @property
    def rods(self) -> Configuration:
        """(R) configurations."""
        turns, edges = quaternion_of_turn(self.joints), len(self.rest_length)
        frames = np.empty((len(turns), edges, 4))
        frames[:, self.anchor] = self.frame
        for edge in range(self.anchor + 1, edges):
            frames[:, edge] = quaternion_product(frames[:, edge - 1], turns[:, edge - 1])
        for edge in range(self.anchor - 1, -1, -1):
            frames[:, edge] = quaternion_product(frames[:, edge + 1], _inverse(turns[:, edge]))
        rods = Configuration(np.zeros((len(turns), 3)), frames / np.linalg.norm(frames, axis=-1, keepdims=True),
                             self.rest_length)
        middle = rods.vertices[:, self.anchor : self.anchor + 2].mean(axis=1)
        return Configuration(self.place - middle, rods.quaternions, self.rest_length)

    def take(self, rows: np.ndarray) -> "Shapes":
        """Those named by ``rows``."""
        return Shapes(self.place[rows], self.frame[rows], self.joints[rows], self.rest_length, self.anchor)

    def towards(self, other: "Shapes", share: np.ndarray) -> "Shapes":
        """After ``share`` (R,) of the way to the R others, all numbers uniformly, the anchor turning the shortest way."""
        share = share[:, None]
        turn = rotation_vector(quaternion_product(_inverse(self.frame), other.frame))
        return Shapes(self.place + share * (other.place - self.place),
                      quaternion_product(self.frame, quaternion_of_turn(share * turn)),
                      self.joints + share[..., None] * (other.joints - self.joints), self.rest_length, self.anchor)

    def apart(self, other: "Shapes", lever: float) -> np.ndarray:
        """(R,) mm: shift and turn of the anchor and the turns of all joints on the way to the R others, added; a radian counts
        as much as ``lever`` mm."""
        shift = np.linalg.norm(self.place - other.place, axis=-1)
        turn = 2 * np.arccos(np.minimum(np.abs(np.sum(self.frame * other.frame, axis=-1)), 1.0))
        return shift + lever * (turn + np.linalg.norm(self.joints - other.joints, axis=-1).sum(axis=-1))


def _inverse(quaternions: np.ndarray) -> np.ndarray:
    return quaternions * [1.0, -1.0, -1.0, -1.0]
