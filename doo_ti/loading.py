"""Rods into lanes of scratch and out of them, one at a time, for the Newton kernel.

Scratch of a thread holds first what is asked of the rods in its lanes, then the items of their edges (:mod:`doo_ti.chain`).
"""

from types import SimpleNamespace

import taichi as ti

from doo_ti import chain
from doo_ti.tables import (
    ANCHOR,
    CLOSED,
    HANGING,
    LARGEST_BEND,
    LIFT,
    LONGEST,
    RELEASED,
    ROUND,
    SHORTEST_PAIR,
    SPIN_END,
    SPIN_START,
    STIFFEST,
    TARGET,
    TILT_END,
    TILT_INNER,
    TILT_START,
    TOTAL,
    WEIGHT,
)

# What is asked of a lane's rod. It lies in scratch, not in variables of the kernel's loop, because there a lane is set without
# touching the others.
ASKED_TARGET, ASKED_CLOSED, ASKED_FREE, ASKED_RELEASED, ASKED_TOTAL, ASKED_LONGEST = 0, 3, 4, 9, 10, 11
ASKED_UNIT, ASKED_STIFFNESS, ASKED_GRAVITY, ASKED_ANCHOR, ASKED_SCALE, ASKED_ITEMS = 12, 13, 15, 18, 21, 22


@ti.func
def residual_divisor(section: ti.template(), clamp: ti.template(), g, s):
    """Divisor of the scaled residual of the rod (configuration s, material g): the largest eigenvalue of B, or the largest
    gravity moment where that is more."""
    return ti.max(section[g, LARGEST_BEND], section[g, WEIGHT] * clamp[s, HANGING])


def lane_loading(number, isotropic: bool, stride: int, items: int, outside=None) -> SimpleNamespace:
    """``load_rod`` and ``store_frames`` as Taichi functions; ``outside`` are the functions of the external energy, if any."""
    lanes = number.lanes()
    put, get = lanes.put, lanes.get
    under_load = outside is not None

    @ti.func
    def load_frame(scratch: ti.template(), at, slot, source: ti.template(), number):
        for k in ti.static(range(4)):
            put(scratch, at + (chain.FRAME + k) * stride, slot, source[4 * number + k])

    @ti.func
    def load_frames(scratch: ti.template(), origin, edges, slot, source: ti.template(), row):
        """The frames of ``source``'s row, normalised, into lane ``slot``."""
        at = origin
        place = row * edges * 4
        for e in range(edges):
            a, b, c, d = (source[place], source[place + 1], source[place + 2], source[place + 3])
            size = 1.0 / ti.sqrt(a * a + b * b + c * c + d * d)
            put(scratch, at + chain.FRAME * stride, slot, a * size)
            put(scratch, at + (chain.FRAME + 1) * stride, slot, b * size)
            put(scratch, at + (chain.FRAME + 2) * stride, slot, c * size)
            put(scratch, at + (chain.FRAME + 3) * stride, slot, d * size)
            place += 4
            at += ti.static(items * stride)

    @ti.func
    def store_frames(scratch: ti.template(), origin, edges, slot, target: ti.template(), row):
        at = origin
        place = row * edges * 4
        for e in range(edges):
            for k in ti.static(range(4)):
                target[place + k] = get(scratch, at + (chain.FRAME + k) * stride, slot)
            place += 4
            at += ti.static(items * stride)

    @ti.func
    def load_lengths(scratch: ti.template(), origin, edges, slot, row, rest_length: ti.template()):
        at = origin
        for e in range(edges):
            put(scratch, at + chain.LENGTH * stride, slot, rest_length[row, e])
            if e > 0:
                put(scratch, at + chain.INVERSE_LENGTH * stride, slot, 1.0 / (rest_length[row, e - 1] + rest_length[row, e]))
            at += ti.static(items * stride)

    @ti.func
    def load_stiffness(scratch: ti.template(), origin, edges, slot, row, g, unit, rest_length: ti.template(),
                       bend: ti.template(), twist: ti.template(), rest: ti.template()):
        at = origin
        for e in range(edges):
            for k in ti.static(range(3)):
                put(scratch, at + (chain.BEND + k) * stride, slot, bend[g, ti.min(e, bend.shape[1] - 1), k] * unit)
            if e > 0:
                put(scratch, at + chain.TWIST * stride, slot, twist[g, ti.min(e, twist.shape[1]) - 1] * unit)
                both = rest_length[row, e - 1] + rest_length[row, e]
                for k in ti.static(range(2)):
                    put(scratch, at + (chain.REST + k) * stride, slot,
                        0.5 * both * rest[g, ti.min(e, rest.shape[1]) - 1, k])
            at += ti.static(items * stride)

    @ti.func
    def load_asked(scratch: ti.template(), head, slot, s, g, divisor, clamp: ti.template(), bend: ti.template(),
                   twist: ti.template(), section: ti.template()):
        """What is asked of the rod (configuration s, material g) into lane ``slot``, energies over ``divisor``."""
        for k in ti.static(range(3)):
            put(scratch, head + (ASKED_TARGET + k) * stride, slot, clamp[s, TARGET + k])
            put(scratch, head + (ASKED_GRAVITY + k) * stride, slot, section[g, LIFT + k] / divisor)
            put(scratch, head + (ASKED_ANCHOR + k) * stride, slot, clamp[s, ANCHOR + k])
        put(scratch, head + ASKED_CLOSED * stride, slot, clamp[s, CLOSED])
        # A round rod with both spins free turns about itself at no cost: hold its first spin.
        put(scratch, head + ASKED_FREE * stride, slot, clamp[s, SPIN_START] * (1.0 - section[g, ROUND] * clamp[s, SPIN_END]))
        put(scratch, head + (ASKED_FREE + 1) * stride, slot, clamp[s, TILT_START])
        put(scratch, head + (ASKED_FREE + 2) * stride, slot, clamp[s, SPIN_END])
        put(scratch, head + (ASKED_FREE + 3) * stride, slot, clamp[s, TILT_END])
        put(scratch, head + (ASKED_FREE + 4) * stride, slot, clamp[s, TILT_INNER])
        put(scratch, head + ASKED_RELEASED * stride, slot, clamp[s, RELEASED])
        put(scratch, head + ASKED_TOTAL * stride, slot, clamp[s, TOTAL])
        put(scratch, head + ASKED_LONGEST * stride, slot, clamp[s, LONGEST])
        put(scratch, head + ASKED_UNIT * stride, slot, divisor)
        put(scratch, head + ASKED_STIFFNESS * stride, slot, bend[g, 0, 0] / divisor)
        put(scratch, head + (ASKED_STIFFNESS + 1) * stride, slot, twist[g, 0] / divisor)
        # A first guess of H's largest diagonal entry.
        put(scratch, head + ASKED_SCALE * stride, slot, 4.0 * section[g, STIFFEST] / divisor / clamp[s, SHORTEST_PAIR])

    @ti.func
    def load_rod(
        scratch: ti.template(), head, edges, slot, rod, lengths_known, rods: ti.template(), start: ti.template(),
        ends: ti.template(), frames: ti.template(), rest_length: ti.template(), clamp: ti.template(), bend: ti.template(),
        twist: ti.template(), rest: ti.template(), section: ti.template(), outer: ti.template(),
    ):
        """Row ``rod`` of ``rods`` into lane ``slot``. Lengths are left where the lane has them and all rods share them."""
        origin = head + ti.static(ASKED_ITEMS * stride)
        last = origin + (edges - 1) * ti.static(items * stride)
        s = rods[rod, 0]
        g = rods[rod, 1]
        divisor = residual_divisor(section, clamp, g, s)  # the unit of the rod's energies, too
        if rods[rod, 3] == 0:
            load_frames(scratch, origin, edges, slot, start, s)
            load_frame(scratch, origin, slot, ends, 2 * s)
            load_frame(scratch, last, slot, ends, 2 * s + 1)
        else:
            # From where it was, but clamped frames as given, not as they were rounded.
            load_frames(scratch, origin, edges, slot, frames, rods[rod, 2])
            if clamp[s, SPIN_START] == 0.0:
                load_frame(scratch, origin, slot, ends, 2 * s)
            if clamp[s, SPIN_END] == 0.0:
                load_frame(scratch, last, slot, ends, 2 * s + 1)
        row = ti.min(s, rest_length.shape[0] - 1)
        if lengths_known < 0.5 or rest_length.shape[0] > 1:
            load_lengths(scratch, origin, edges, slot, row, rest_length)
        if ti.static(not isotropic):
            load_stiffness(scratch, origin, edges, slot, row, g, 1.0 / divisor, rest_length, bend, twist, rest)
        if ti.static(under_load):
            at = origin
            for e in range(edges):
                outside.load(scratch, at, slot, outer, rods[rod, 4], e, 1.0 / divisor)
                at += ti.static(items * stride)
        load_asked(scratch, head, slot, s, g, divisor, clamp, bend, twist, section)

    return SimpleNamespace(load_rod=load_rod, store_frames=store_frames)
