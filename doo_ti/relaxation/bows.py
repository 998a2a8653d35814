"""Straight starts between clamps that need slack are bowed: free edges in one straight line have no first-order way to bring
the far end closer (§III-B).

Among obstacles they are bowed only as far as they pass through none on their way from the straight line. Their relaxation, in
which they pass through none either, brings them the rest of the way.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from doo_ti.contact.distance_grid import grid_table
from doo_ti.contact.obstacles import GRID, Obstacle, obstacle_table
from doo_ti.relaxation.bow_kernel import ASIDE, HALF_WAVES, NONE, SIGN, SLOPE, bow_kernel
from doo_ti.rod.frames import matrix_from_quaternion, quaternion_about, quaternion_product, tangent_from_quaternion
from doo_ti.system import runtime

DOWN, SIDEWAYS, UPRIGHT = (False, 1.0), ((True, 1.0), (True, -1.0)), (False, -1.0)
"""Directions of a bow: whether it lies aside, perpendicular to the plane of the first, and to which side. An upright arch would
have to fall over."""
NUMBERS = (1, 2, 3, 4, 6, 8, 12, 16)
"""Of half waves."""
EDGES_OF_A_HALF_WAVE = 3
"""At least."""
SLIGHT = 0.2
"""rad: the slope of a bow where there is no room for a wide one."""
STEEPEST = 2.2
"""rad: the slope of a bow at its ends; steeper ones cross themselves."""
STEEP = 1e-3
"""The sine of the angle between a rod and the vertical, below which its first bow goes along a director."""
SERIES, NEWTON_ROUNDS = 9, 6
MOST_THREADS = 4096


def slope_of_chord(share: np.ndarray) -> np.ndarray:
    """(N,) a such that the chord of a rod of slope a cos(π n s/L) is that ``share`` of its length, at most STEEPEST.

    The chord is L J0(a) for any n, J0(2 √u) = Σ (−u)ᵏ/k!².
    """
    u = 1 - share
    for _ in range(NEWTON_ROUNDS):
        value, slope, term = np.ones_like(u), np.zeros_like(u), np.ones_like(u)
        for k in range(1, SERIES + 1):
            slope = slope - term / k
            term = -term * u / k**2
            value = value + term
        u = u - (value - share) / slope
    return np.minimum(2 * np.sqrt(np.maximum(u, 0.0)), STEEPEST)


@dataclass(frozen=True)
class Straight:
    """N straight rods that need slack.

    whole    (N, E, 4) frames
    lengths  (N, E) mm
    anchor   (N, 3) vertex 0
    axis     (N, 3) about which the edges of the first bow turn
    slope    (N,) of the bows at their ends, rad
    place    (N, E) of the free edges along the rod, from 0 to 1
    free     (N, E) one where an edge may tilt
    """

    whole: np.ndarray
    lengths: np.ndarray
    anchor: np.ndarray
    axis: np.ndarray
    slope: np.ndarray
    place: np.ndarray
    free: np.ndarray

    @cached_property
    def tangents(self) -> np.ndarray:
        """(N, E, 3)."""
        return tangent_from_quaternion(self.whole)

    def bowed(self, bows: np.ndarray) -> np.ndarray:
        """(N, E, 4) frames of a bow each (N, TRY_COLUMNS), its slope the one that closes the rod, or less."""
        half_waves, aside, sign, slope = (bows[:, k, None] for k in (HALF_WAVES, ASIDE, SIGN, SLOPE))
        middle = self.tangents[:, self.whole.shape[1] // 2]
        axis = sign * np.where(aside > 0, np.cross(middle, self.axis), self.axis)
        slope = np.minimum(self.slope[:, None], slope)
        angle = slope * np.cos(np.pi * half_waves * self.place) * self.free
        turn = quaternion_about(np.broadcast_to(axis[:, None], (*angle.shape, 3)), angle)
        return quaternion_product(turn, self.whole)


def straight_rods(whole, lengths, anchor, tilting, share, up) -> Straight:
    """Those with these frames (N, E, 4), whose edges may tilt where ``tilting`` (N, E) is one, and whose chord is to become
    that ``share`` (N,) of what it is. Their first bow is against ``up``, or towards m1 where the line is upright."""
    middle = matrix_from_quaternion(whole[:, whole.shape[1] // 2])
    axis = np.cross(-up, middle[..., 0])
    upright = np.linalg.norm(axis, axis=-1, keepdims=True) < STEEP
    axis = np.where(upright, middle[..., 2], axis)
    axis /= np.linalg.norm(axis, axis=-1, keepdims=True)
    place = (np.cumsum(tilting, axis=1) - 0.5) / tilting.sum(axis=1, keepdims=True)
    return Straight(whole, lengths, anchor, -axis, slope_of_chord(share), place, tilting)


@runtime.exclusive
def bowed_among(rods: Straight, obstacles: Sequence[Obstacle], beside_others: bool) -> np.ndarray:
    """(N, E, 4) frames of bows that pass through no obstacle, of one row or N, on their way from the straight line: wide ones,
    where there is no room slight ones. Where the line is inside an obstacle, or no bow has room, of one that only ends inside
    none; where there is none either, of the first. Rods ``beside_others`` make an upright arch before they go aside, where
    these may be.
    """
    directions = (DOWN, UPRIGHT, *SIDEWAYS) if beside_others else (DOWN, *SIDEWAYS, UPRIGHT)
    wide = directions if beside_others else directions[:-1]
    tries = np.array([
        *((1, *direction, STEEPEST, True) for direction in wide),
        *((1, *direction, SLIGHT, followed) for followed in (True, False) for direction in directions),
        *((number, *direction, STEEPEST, False) for number in NUMBERS for direction in directions
          if EDGES_OF_A_HALF_WAVE * number <= rods.whole.shape[1])])
    chosen = np.full(len(rods.whole), NONE)
    if obstacles:
        chosen = _chosen(rods, obstacles, tries)
    return rods.bowed(tries[np.where(chosen == NONE, 0, chosen)])


def _chosen(rods: Straight, obstacles: Sequence[Obstacle], tries: np.ndarray) -> np.ndarray:
    """(N,) the first of the ``tries`` (K, TRY_COLUMNS) that fits, or NONE."""
    on_cpu = runtime.start() == "cpu"
    kinds, grids = grid_table(obstacles)
    chosen = np.empty(len(rods.whole), dtype=np.int32)
    known = frozenset(np.minimum(kinds, GRID).tolist())
    single = (np.ascontiguousarray(value, dtype=np.float32) for value in (
        rods.anchor, rods.tangents, rods.axis, rods.lengths, rods.place, rods.free, rods.slope, tries,
        obstacle_table(obstacles).reshape(-1)))
    bow_kernel(known, 1 if on_cpu else 64)(*single, kinds, grids, min(len(chosen), MOST_THREADS), chosen)
    return chosen
