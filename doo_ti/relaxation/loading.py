"""Rods into lanes of scratch and out of them, one at a time, for the Newton kernel.

Scratch of a thread holds first what is asked of the rods in its lanes, then the items of their edges (:mod:`.chain`).
"""

from types import SimpleNamespace

import taichi as ti

from doo_ti.physics.algebra import dot
from doo_ti.physics.quaternion import normalised, tangent, transported
from doo_ti.relaxation import chain
from doo_ti.relaxation.columns import (
    ANCHOR,
    BEND,
    CLOSED,
    ENDS,
    FROM_RESULTS,
    HANGING,
    LARGEST_BEND,
    LONGEST,
    OF_CLAMP,
    OF_EXTERNAL,
    OF_MATERIAL,
    OF_RESULT,
    OF_START,
    RELEASED,
    REST,
    ROUND,
    SHORTEST_PAIR,
    SPIN_END,
    SPIN_START,
    STIFFEST,
    STIFFNESS,
    STIFFNESS_COLUMNS,
    TARGET,
    TILT_END,
    TILT_INNER,
    TILT_START,
    TOTAL,
    TWIST,
    WEIGHT,
)

# Entries of a launch's queue: the next rod that nobody has taken, the trips of all packs, and from LANES on every lane's rod.
NEXT, TRIPS, LANES = 0, 1, 2

# What is asked of a lane's rod. It lies in scratch, not in variables of the kernel's loop, because there a lane is set without
# touching the others.
ASKED_TARGET, ASKED_CLOSED, ASKED_FREE, ASKED_RELEASED, ASKED_TOTAL, ASKED_LONGEST = 0, 3, 4, 9, 10, 11
ASKED_UNIT, ASKED_STIFFNESS, ASKED_GRAVITY, ASKED_ANCHOR, ASKED_SCALE, ASKED_ITEMS = 12, 13, 15, 18, 21, 22


@ti.func
def residual_divisor(material: ti.template(), clamp: ti.template(), g, s):
    """Divisor of the scaled residual of the rod (configuration s, material g): the largest eigenvalue of B, or the largest
    gravity moment where that is more."""
    return ti.max(material[g, LARGEST_BEND], material[g, WEIGHT] * clamp[s, HANGING])


def lane_loading(number, isotropic: bool, stride: int, items: int, outside=None) -> SimpleNamespace:
    """``load`` and ``store_frames`` as Taichi functions; ``outside`` are the functions of the external energy, if any."""
    lanes = number.lanes()
    put, get = lanes.put, lanes.get
    under_load = outside is not None

    @ti.func
    def frame_from(source: ti.template(), place):
        """The frame at ``place`` of ``source``, of any length."""
        return (source[place], source[place + 1], source[place + 2], source[place + 3])

    @ti.func
    def put_frame(scratch: ti.template(), at, slot, frame):
        for k in ti.static(range(4)):
            put(scratch, at + (chain.FRAME + k) * stride, slot, frame[k])

    @ti.func
    def load_frames(scratch: ti.template(), origin, edges, slot, source: ti.template(), row, clamp: ti.template(), s):
        """The frames of ``source``'s row into lane ``slot``, those at the ends as clamp s holds them. The first step, of no
        length, makes unit quaternions of them."""
        last = origin + (edges - 1) * ti.static(items * stride)
        at = origin
        place = row * edges * 4
        for e in range(edges):
            put_frame(scratch, at, slot, frame_from(source, place))
            place += 4
            at += ti.static(items * stride)
        load_end(scratch, origin, slot, source, row * edges * 4, clamp, s, 0)
        load_end(scratch, last, slot, source, place - 4, clamp, s, 1)

    @ti.func
    def load_end(scratch: ti.template(), at, slot, source: ti.template(), place, clamp: ti.template(), s, end: ti.template()):
        """What clamp s holds of the first frame or the last, which is at ``place`` of ``source``, into lane ``slot``."""
        if clamp[s, TILT_START + end] == 0.0:
            column = ti.static(ENDS + 4 * end)
            held = (clamp[s, column], clamp[s, column + 1], clamp[s, column + 2], clamp[s, column + 3])
            put_frame(scratch, at, slot, held)
            if clamp[s, SPIN_START + end] > 0.0:
                # A tangent alone: by parallel transport, which there is not from the opposite one.
                frame = normalised(frame_from(source, place))
                old, new = tangent(frame), tangent(held)
                if 1.0 + dot(old, new) > 1e-14:
                    put_frame(scratch, at, slot, transported(frame, old, new))

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
                       material: ti.template()):
        at = origin
        for e in range(edges):
            column = ti.min(STIFFNESS + e * STIFFNESS_COLUMNS, material.shape[1] - STIFFNESS_COLUMNS)
            for k in ti.static(range(3)):
                put(scratch, at + (chain.BEND + k) * stride, slot, material[g, column + (BEND + k)] * unit)
            if e > 0:
                put(scratch, at + chain.TWIST * stride, slot, material[g, column + TWIST] * unit)
                both = rest_length[row, e - 1] + rest_length[row, e]
                for k in ti.static(range(2)):
                    put(scratch, at + (chain.REST + k) * stride, slot, 0.5 * both * material[g, column + (REST + k)])
            at += ti.static(items * stride)

    @ti.func
    def load_asked(scratch: ti.template(), head, slot, s, g, divisor, up, clamp: ti.template(), material: ti.template()):
        """What is asked of the rod (configuration s, material g) into lane ``slot``, energies over ``divisor``."""
        for k in ti.static(range(3)):
            put(scratch, head + (ASKED_TARGET + k) * stride, slot, clamp[s, TARGET + k])
            put(scratch, head + (ASKED_GRAVITY + k) * stride, slot, material[g, WEIGHT] * up[k] / divisor)
            put(scratch, head + (ASKED_ANCHOR + k) * stride, slot, clamp[s, ANCHOR + k])
        put(scratch, head + ASKED_CLOSED * stride, slot, clamp[s, CLOSED])
        # A round rod with both spins free turns about itself at no cost: hold its first spin.
        put(scratch, head + ASKED_FREE * stride, slot, clamp[s, SPIN_START] * (1.0 - material[g, ROUND] * clamp[s, SPIN_END]))
        put(scratch, head + (ASKED_FREE + 1) * stride, slot, clamp[s, TILT_START])
        put(scratch, head + (ASKED_FREE + 2) * stride, slot, clamp[s, SPIN_END])
        put(scratch, head + (ASKED_FREE + 3) * stride, slot, clamp[s, TILT_END])
        put(scratch, head + (ASKED_FREE + 4) * stride, slot, clamp[s, TILT_INNER])
        put(scratch, head + ASKED_RELEASED * stride, slot, clamp[s, RELEASED])
        put(scratch, head + ASKED_TOTAL * stride, slot, clamp[s, TOTAL])
        put(scratch, head + ASKED_LONGEST * stride, slot, clamp[s, LONGEST])
        put(scratch, head + ASKED_UNIT * stride, slot, divisor)
        put(scratch, head + ASKED_STIFFNESS * stride, slot, material[g, STIFFNESS + BEND] / divisor)
        put(scratch, head + (ASKED_STIFFNESS + 1) * stride, slot, material[g, STIFFNESS + TWIST] / divisor)
        # A first guess of H's largest diagonal entry.
        put(scratch, head + ASKED_SCALE * stride, slot, 4.0 * material[g, STIFFEST] / divisor / clamp[s, SHORTEST_PAIR])

    @ti.func
    def load(
        scratch: ti.template(), head, edges, slot, rod, lengths_known, up, rods: ti.template(), start: ti.template(),
        frames: ti.template(), rest_length: ti.template(), clamp: ti.template(), material: ti.template(), outer: ti.template(),
    ):
        """Row ``rod`` of ``rods`` into lane ``slot``. Lengths are left where the lane has them and all rods share them."""
        origin = head + ti.static(ASKED_ITEMS * stride)
        s = rods[rod, OF_CLAMP]
        g = rods[rod, OF_MATERIAL]
        divisor = residual_divisor(material, clamp, g, s)  # the unit of the rod's energies, too
        if rods[rod, OF_START] == FROM_RESULTS:
            load_frames(scratch, origin, edges, slot, frames, rods[rod, OF_RESULT], clamp, s)
        else:
            load_frames(scratch, origin, edges, slot, start, rods[rod, OF_START], clamp, s)
        row = ti.min(s, rest_length.shape[0] - 1)
        if lengths_known < 0.5 or rest_length.shape[0] > 1:
            load_lengths(scratch, origin, edges, slot, row, rest_length)
        if ti.static(not isotropic):
            load_stiffness(scratch, origin, edges, slot, row, g, 1.0 / divisor, rest_length, material)
        if ti.static(under_load):
            at = origin
            for e in range(edges):
                outside.load(scratch, at, slot, outer, rods[rod, OF_EXTERNAL], e, 1.0 / divisor)
                at += ti.static(items * stride)
        load_asked(scratch, head, slot, s, g, divisor, up, clamp, material)

    return SimpleNamespace(load=load, store_frames=store_frames)
