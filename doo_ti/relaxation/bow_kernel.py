"""Which bow of a straight rod passes through no obstacle: the kernel behind :mod:`doo_ti.relaxation.bows`."""

from functools import cache

import taichi as ti

from doo_ti.contact.distance import COLUMNS, Distance
from doo_ti.contact.obstacles import OBSTACLE_COLUMNS, PLANE
from doo_ti.physics.number import Number
from doo_ti.physics.tuples import cross, dot, minus, plus, record, scaled, variable
from doo_ti.physics.view import Scratch, read
from doo_ti.relaxation.kernel_factory import INDEX1, TABLE1, loop_kernel

# Columns of a try: the number of half waves; whether it lies aside; to which side; the largest slope, rad; and one where the
# way from the straight line is followed.
HALF_WAVES, ASIDE, SIGN, SLOPE, FOLLOWED, TRY_COLUMNS = 0, 1, 2, 3, 4, 5
MIDWAY = 0.4
"""Of a bow's slope: the shape through which its way from the straight line is followed."""
PLACES = 8
"""Of an edge, and of the way of a vertex, that are to be outside all obstacles."""
FROM_THERE = 0.9
"""A vertex may always come as near to an obstacle as that share of its distance at the start of its way."""
NONE = -1


@ti.data_oriented
class BowSearch:
    """The search, one rod at a time, among obstacles of some ``kinds``. Its functions take the record ``tables`` of the
    kernel's arguments, and a rod's row ``r`` in them."""

    def __init__(self, kinds: frozenset[int]):
        number = Number(1, 32)
        self.distance, self.scalar = Distance(number, kinds), number.scalar
        self.memory = Scratch(number, 1)

    @ti.func
    def work(self, tables, thread):
        """A thread's share of the rods."""
        for k in range((tables.chosen.shape[0] - thread + tables.threads - 1) // tables.threads):
            tables.chosen[thread + k * tables.threads] = self.search(tables, thread + k * tables.threads)

    @ti.func
    def value(self, tables, r, o, x):
        """φ of obstacle ``o`` at ``x``."""
        row = ti.min(r, tables.obstacles.shape[0] // (tables.kinds.shape[0] * OBSTACLE_COLUMNS) - 1)
        own = self.memory.view(tables.obstacles, (row * tables.kinds.shape[0] + o) * OBSTACLE_COLUMNS, COLUMNS)
        return self.distance.measure(own, tables.grids, tables.kinds[o], x).value

    @ti.func
    def nears(self, tables, r, o, start, end, both, least):
        """Whether the straight line between two places, whose φ is ``both`` together, comes nearer to an obstacle than
        ``least``."""
        along, room, nearer = minus(end, start), both - 2.0 * least, False
        # φ grows no faster than the place: a short line stays away.
        if room < 0.0 or dot(along, along) > room * room:
            for k in range(1, PLACES):
                if not nearer:
                    nearer = self.value(tables, r, o, plus(start, scaled(along, k / PLACES))) < least
        return nearer

    @ti.func
    def passes(self, tables, r, o, start, end, length):
        """Whether a vertex on its way comes so near to an obstacle that an edge of that ``length`` may pass through it."""
        first, last = self.value(tables, r, o, start), self.value(tables, r, o, end)
        least = ti.min(0.5 * length, FROM_THERE * first)
        return last < least or self.nears(tables, r, o, start, end, first + last, least)

    @ti.func
    def bent(self, tables, r, e, half_waves, slope, across):
        """An edge of a bow, whose edges turn in the plane of the line and of ``across``."""
        angle = slope * ti.cos(ti.math.pi * half_waves * tables.place[r, e]) * tables.free[r, e]
        t, length = read(tables.tangents, r, e, 0), tables.lengths[r, e]
        flat = minus(across, scaled(t, dot(across, t)))
        return plus(scaled(t, length * ti.cos(angle)), scaled(flat, length * ti.sin(angle)))

    @ti.func
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
                fine = self.is_outside(tables, r, o, way.last, way.end, length)
                if fine and followed:
                    fine = self.is_outside(tables, r, o, way.last_midway, way.midway, length)
                    if fine and v > 0 and tables.kinds[o] != ti.static(PLANE):
                        fine = not (self.passes(tables, r, o, way.line, way.midway, length)
                                    or self.passes(tables, r, o, way.midway, way.end, length))
                o += 1
            v += 1
        return fine

    @ti.func
    def is_outside(self, tables, r, o, last, x, length):
        """Whether vertex ``x`` and the edge of that ``length`` from the ``last`` one are."""
        value = self.value(tables, r, o, x)
        outside = value >= 0.0
        if outside and value < length and tables.kinds[o] != ti.static(PLANE):
            outside = not self.nears(tables, r, o, last, x, value + self.value(tables, r, o, last), 0.0)
        return outside

    @ti.func
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
    "anchor": SINGLE2,  # [rod, 3] mm
    "tangents": SINGLE3,  # [rod, edge, 3] of the straight lines
    "axis": SINGLE2,  # [rod, 3] about which the edges of the first bow turn
    "lengths": SINGLE2,  # [rod, edge] mm
    "place": SINGLE2,  # [rod, edge] of the free edges along the rod
    "free": SINGLE2,  # [rod, edge] one where it may tilt
    "slope": SINGLE1,  # [rod] that closes it, rad
    "tries": SINGLE2,  # [try, TRY_COLUMNS]
    "obstacles": SINGLE1,  # [1 or rod · obstacle · column]
    "kinds": INDEX1, "grids": TABLE1,
    "threads": ti.i32,
    "chosen": INDEX1,  # [rod] out: a try, or NONE
}
"""What the kernel is given, in this order."""


@cache
def bow_kernel(kinds: frozenset[int], block: int):
    """The kernel for obstacles of some kinds; ``block`` as of :func:`.loop_kernel`."""
    return loop_kernel("choose_bows", Number(1, 32), ARGUMENTS, BowSearch(kinds).work, block)
