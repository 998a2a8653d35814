"""Starts that cannot be projected onto closure: free edges in one straight line have no first-order way to bring the far end
closer (§III-B). Rods that need slack are bowed, taut ones made the straight line that they can only be.

Among obstacles they are bowed only as far as they pass through none on their way from the straight line. Their relaxation, in
which they pass through none either, brings them the rest of the way.
"""

from collections.abc import Sequence
from functools import cache

import numpy as np
import taichi as ti

from doo_ti.contact.distance import COLUMNS, Distance
from doo_ti.contact.distance_grid import grid_table
from doo_ti.contact.obstacles import GRID, OBSTACLE_COLUMNS, PLANE, Obstacle, obstacle_table
from doo_ti.physics.number import Number, Scratch, device_functions, read
from doo_ti.physics.tuples import cross, dot, minus, plus, record, scaled, variable
from doo_ti.relaxation import tables as of
from doo_ti.relaxation.clamp_table import STRAIGHT, TAUT, TAUT_SLACK
from doo_ti.relaxation.kernel_factory import INDEX1, TABLE1, loop_kernel
from doo_ti.relaxation.tables import outer_edges, whole_start
from doo_ti.rod.frames import (
    matrix_from_quaternion,
    quaternion_about,
    quaternion_product,
    smallest_rotation,
    tangent_from_quaternion,
)
from doo_ti.system import runtime

# Columns of a try: the number of half waves; whether it lies aside; to which side; the largest slope, rad; and one where the
# way from the straight line is followed.
HALF_WAVES, ASIDE, SIGN, SLOPE, FOLLOWED, TRY_COLUMNS = 0, 1, 2, 3, 4, 5
MIDWAY = 0.4  # of a bow's slope: the shape through which its way from the straight line is followed
PLACES = 8  # of an edge, and of the way of a vertex, that are to be outside all obstacles
FROM_THERE = 0.9  # a vertex may always come as near to an obstacle as that share of its distance at the start of its way
NONE = -1


@device_functions
class BowSearch:
    """The search, one rod at a time. Its functions take the record ``tables`` of the kernel's arguments, and a rod's row ``r``
    in them."""

    def __init__(self, has_grid: bool):
        number = Number(1, 32)
        self.distance, self.scalar = Distance(number, has_grid), number.scalar
        self.memory = Scratch(number, 1)

    def work(self, tables, thread):
        """A thread's share of the rods."""
        for k in range((tables.chosen.shape[0] - thread + tables.threads - 1) // tables.threads):
            tables.chosen[thread + k * tables.threads] = self.search(tables, thread + k * tables.threads)

    def value(self, tables, r, o, x):
        """φ of obstacle ``o`` at ``x``."""
        row = ti.min(r, tables.obstacles.shape[0] // (tables.kinds.shape[0] * OBSTACLE_COLUMNS) - 1)
        own = self.memory.view(tables.obstacles, (row * tables.kinds.shape[0] + o) * OBSTACLE_COLUMNS, COLUMNS)
        return self.distance.measure(own, tables.grids, tables.kinds[o], x).value

    def passes(self, tables, r, o, start, end, length, share):
        """Whether the line between two places comes nearer to an obstacle than half of ``length`` and than that ``share`` of
        the distance at its start. To a plane no line does whose ends do not."""
        last = self.value(tables, r, o, end)
        nearer = last < 0.0
        # φ grows no faster than the place: a short line stays away.
        if tables.kinds[o] != ti.static(PLANE) and (share > 0.0 or last < length):
            first, along = self.value(tables, r, o, start), minus(end, start)
            least = ti.min(0.5 * length, share * first)
            room = first + last - 2.0 * least
            nearer = last < least
            if room < 0.0 or dot(along, along) > room * room:
                for k in range(1, PLACES):
                    if not nearer:
                        nearer = self.value(tables, r, o, plus(start, scaled(along, k / PLACES))) < least
        return nearer

    def bent(self, tables, r, e, half_waves, slope, across):
        """An edge of a bow, whose edges turn in the plane of the line and of ``across``."""
        angle = slope * ti.cos(ti.math.pi * half_waves * tables.place[r, e]) * tables.free[r, e]
        t, length = read(tables.tangents, r, e, 0), tables.lengths[r, e]
        flat = minus(across, scaled(t, dot(across, t)))
        return plus(scaled(t, length * ti.cos(angle)), scaled(flat, length * ti.sin(angle)))

    def fits(self, tables, r, number, slope, followed):
        """Whether a try of that slope is outside all obstacles and, where it is ``followed``, passes through none."""
        edges, fine = tables.lengths.shape[1], True
        half_waves = tables.tries[number, HALF_WAVES]
        t = read(tables.tangents, r, edges // 2, 0)
        axis = variable(read(tables.axis, r, 0))
        if tables.tries[number, ASIDE] > 0.5:
            axis = cross(t, axis)
        across = scaled(cross(axis, t), tables.tries[number, SIGN])
        begin = read(tables.anchor, r, 0)
        way = record(line=begin, midway=begin, end=begin, last=begin, last_midway=begin)
        v = 0
        while v <= edges and fine:
            length = ti.cast(0.0, self.scalar)
            if v > 0:
                e = v - 1
                length = tables.lengths[r, e]
                way.last, way.last_midway = way.end, way.midway
                way.end = plus(way.end, self.bent(tables, r, e, half_waves, slope, across))
                if followed:
                    way.line = plus(way.line, scaled(read(tables.tangents, r, e, 0), length))
                    way.midway = plus(way.midway, self.bent(tables, r, e, half_waves, MIDWAY * slope, across))
            o = 0
            while o < tables.kinds.shape[0] and fine:
                fine = not self.passes(tables, r, o, way.last, way.end, length, 0.0)
                if fine and followed:
                    fine = not (self.passes(tables, r, o, way.last_midway, way.midway, length, 0.0)
                                or self.passes(tables, r, o, way.line, way.midway, length, FROM_THERE)
                                or self.passes(tables, r, o, way.midway, way.end, length, FROM_THERE))
                o += 1
            v += 1
        return fine

    def search(self, tables, r):
        """The first try that fits, or NONE."""
        # Of no slope a try is the straight line, the way from which can be followed only if it is outside.
        clear = self.fits(tables, r, 0, 0.0 * tables.slope[r], False)
        found, number = NONE, 0
        while found == NONE and number < tables.tries.shape[0]:
            followed = tables.tries[number, FOLLOWED] > 0.5
            slope = ti.min(tables.slope[r], tables.tries[number, SLOPE])
            if clear or not followed:
                if self.fits(tables, r, number, slope, followed):
                    found = number
            number += 1
        return found


SINGLE1, SINGLE2, SINGLE3 = (ti.types.ndarray(dtype=ti.f32, ndim=ndim) for ndim in (1, 2, 3))
ARGUMENTS = {
    "anchor": SINGLE2,  # [rod, 3] vertex 0, mm
    "tangents": SINGLE3,  # [rod, edge, 3] of the straight lines
    "axis": SINGLE2,  # [rod, 3] about which the edges of the first bow turn
    "lengths": SINGLE2,  # [rod, edge] mm
    "place": SINGLE2,  # [rod, edge] of the free edges along the rod, from 0 to 1
    "free": SINGLE2,  # [rod, edge] one where it may tilt
    "slope": SINGLE1,  # [rod] of a bow at its ends that closes it, rad
    "tries": SINGLE2,  # [try, TRY_COLUMNS]
    "obstacles": SINGLE1,  # [1 or rod · obstacle · column]
    "kinds": INDEX1, "grids": TABLE1,
    "threads": ti.i32,
    "chosen": INDEX1,  # [rod] out: a try, or NONE
}


@cache
def bow_kernel(has_grid: bool, block: int):
    """The kernel, for grids where ``has_grid``; ``block`` as of :func:`.loop_kernel`."""
    return loop_kernel("choose_bows", Number(1, 32), ARGUMENTS, BowSearch(has_grid), block)


DOWN, SIDEWAYS, UPRIGHT = (False, 1.0), ((True, 1.0), (True, -1.0)), (False, -1.0)
"""Directions of a bow: whether it lies aside, perpendicular to the plane of the first, and to which side. An upright arch would
have to fall over."""
NUMBERS = (1, 2, 3, 4, 6, 8, 12, 16)  # of half waves
EDGES_OF_A_HALF_WAVE = 3  # at least
SLIGHT = 0.2  # rad: the slope of a bow where there is no room for a wide one
STEEPEST = 2.2  # rad: the slope of a bow at its ends; steeper ones cross themselves
STEEP = 1e-3  # the sine of the angle between a rod and the vertical, below which its first bow goes along a director
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


class Straight:
    """N straight rods that need slack: their frames ``whole`` (N, E, 4), and what the kernel is given of them (ARGUMENTS).

    Edges may tilt where ``free`` (N, E) is one, and the chord is to become that ``share`` (N,) of what it is. The first bow is
    against ``up``, or towards m1 where the line is upright.
    """

    def __init__(self, whole, lengths, anchor, free, share, up):
        self.whole, self.lengths, self.anchor, self.free = whole, lengths, anchor, free
        self.tangents, self.slope = tangent_from_quaternion(whole), slope_of_chord(share)
        middle = matrix_from_quaternion(whole[:, whole.shape[1] // 2])
        axis = np.cross(-up, middle[..., 0])
        upright = np.linalg.norm(axis, axis=-1, keepdims=True) < STEEP
        axis = np.where(upright, middle[..., 2], axis)
        self.axis = -axis / np.linalg.norm(axis, axis=-1, keepdims=True)
        self.place = (np.cumsum(free, axis=1) - 0.5) / free.sum(axis=1, keepdims=True)

    def bowed(self, bows: np.ndarray) -> np.ndarray:
        """(N, E, 4) frames of a bow each (N, TRY_COLUMNS), its slope the one that closes the rod, or less."""
        half_waves, aside, sign, slope = (bows[:, k, None] for k in (HALF_WAVES, ASIDE, SIGN, SLOPE))
        middle = self.tangents[:, self.whole.shape[1] // 2]
        axis = sign * np.where(aside > 0, np.cross(middle, self.axis), self.axis)
        slope = np.minimum(self.slope[:, None], slope)
        angle = slope * np.cos(np.pi * half_waves * self.place) * self.free
        turn = quaternion_about(np.broadcast_to(axis[:, None], (*angle.shape, 3)), angle)
        return quaternion_product(turn, self.whole)


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
    chosen = np.full(len(rods.whole), NONE, dtype=np.int32)
    if obstacles:
        kinds, grids = grid_table(obstacles)
        given = {name: getattr(rods, name) for name in ("anchor", "tangents", "axis", "lengths", "place", "free", "slope")}
        given |= {"tries": tries, "obstacles": obstacle_table(obstacles).reshape(-1)}
        single = {name: np.ascontiguousarray(value, dtype=np.float32) for name, value in given.items()}
        kernel = bow_kernel(bool((kinds >= GRID).any()), 1 if runtime.start() == "cpu" else 64)
        kernel(**single, kinds=kinds, grids=grids, threads=min(len(chosen), MOST_THREADS), chosen=chosen)
    return rods.bowed(tries[np.where(chosen == NONE, 0, chosen)])


def projectable(start: np.ndarray, lengths: np.ndarray, clamp: np.ndarray, found: np.ndarray, up: np.ndarray,
                obstacles: Sequence[Obstacle], index: np.ndarray, beside_others: bool = False) -> np.ndarray:
    """Starts that can be projected: those ``found`` (S,) STRAIGHT are bowed, those found TAUT made straight. ``index`` (R,) is
    the start of each rod: obstacles may belong to single rods; ``beside_others``: they are rods of groups. Where starts are
    changed ``clamp`` is, too, in place.
    """
    slack, taut = np.flatnonzero(found == STRAIGHT), np.flatnonzero(found == TAUT)
    if len(slack):
        start = _bowed(start, lengths, clamp, slack, up, obstacles, index, beside_others)
    if len(taut):
        start = _stretched(start, lengths, clamp, taut)
    return start


def _free_part(lengths: np.ndarray, clamp: np.ndarray):
    """Of N rods with these lengths (N, E) and clamps (N, CLAMP_COLUMNS): which of the end edges may tilt (N, 2), as all inner
    ones may, the line (N, 3) that the free edges have to bridge and its length (N,), and how far they reach (N,), mm."""
    tangents = tangent_from_quaternion(clamp[:, of.ENDS:].reshape(-1, 2, 4))
    tilting = clamp[:, of.TILT_START : of.TILT_END + 1]
    held = lengths[:, outer_edges(lengths.shape[1])] * (1 - tilting)
    line = clamp[:, of.TARGET : of.TARGET + 3] - (held[..., None] * tangents).sum(axis=1)
    return tilting, line, np.linalg.norm(line, axis=1), clamp[:, of.TOTAL] - held.sum(axis=1)


def _bowed(start, lengths, clamp, rows, up, obstacles: Sequence[Obstacle], index: np.ndarray, beside_others) -> np.ndarray:
    """Starts of which the slack rods ``rows`` are bowed where their free edges are in one straight line."""
    edges, own = start.shape[1], lengths[rows % len(lengths)]  # of all starts, or one for all
    ends, _, span, reach = _free_part(own, clamp[rows])
    tilting = np.ones((len(rows), edges))
    tilting[:, outer_edges(edges)] = ends
    whole = whole_start(start[rows], clamp[rows])
    chord = np.linalg.norm(((own * tilting)[..., None] * tangent_from_quaternion(whole)).sum(axis=1), axis=-1)
    straight = chord > reach * (1 - TAUT_SLACK)
    if not straight.any():
        return start
    # Of rods that share a start but not their obstacles the first decides; starts without rods are left.
    used, firsts = np.unique(index, return_index=True)
    straight &= np.isin(rows, used)
    rows, share = rows[straight], (span / reach)[straight]
    anchor = clamp[rows, of.ANCHOR : of.ANCHOR + 3]
    rods = Straight(whole[straight], own[straight], anchor, tilting[straight], share, up)
    first = firsts[np.searchsorted(used, rows)]
    frames = bowed_among(rods, [obstacle.take(first) for obstacle in obstacles], beside_others)
    return _changed(start, clamp, rows, frames)


def _stretched(start, lengths, clamp, rows) -> np.ndarray:
    """Starts of which the rods ``rows``, as long as their span, are the one straight line they can be, with nothing left to
    relax but the spins.

    Their clamps are changed to say so; the turns of their frames are kept by parallel transport.
    """
    tilting, line, span, _ = _free_part(lengths[rows % len(lengths)], clamp[rows])
    whole = whole_start(start[rows], clamp[rows])
    turn = smallest_rotation(tangent_from_quaternion(whole), (line / span[:, None])[:, None])
    straight = quaternion_product(turn, whole)
    outer = outer_edges(start.shape[1])
    straight[:, outer] = np.where((tilting == 0)[..., None], whole[:, outer], straight[:, outer])
    clamp[rows[:, None], [of.CLOSED, of.TILT_START, of.TILT_END, of.TILT_INNER]] = 0.0
    return _changed(start, clamp, rows, straight)


def _changed(start, clamp, rows, quaternions) -> np.ndarray:
    """``start`` with other frames in some rows, as given left as it is; ``clamp`` takes their ends in place."""
    start = start.copy()
    start[rows] = quaternions
    clamp[rows, of.ENDS:] = quaternions[:, outer_edges(start.shape[1])].reshape(-1, 8)
    return start
