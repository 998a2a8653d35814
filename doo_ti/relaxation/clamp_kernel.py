"""The kernel that reads what holds each rod's ends: one start after another, in doubles (§III-B)."""

from functools import cache

import taichi as ti

from doo_ti.frames import FRAME_TOLERANCE
from doo_ti.physics.algebra import absolute, larger
from doo_ti.physics.quaternion import from_matrix, normalised, tangent, transported, turned_in_world
from doo_ti.physics.tuples import cross, dot
from doo_ti.relaxation.columns import (
    ANCHOR,
    CLOSED,
    ENDS,
    FRAME,
    HANGING,
    LONGEST,
    LOOSE,
    POSITION,
    RELEASED,
    SHORTEST_PAIR,
    SPIN_END,
    SPIN_START,
    TANGENT,
    TARGET,
    TILT_END,
    TILT_INNER,
    TILT_START,
    TOTAL,
)

# Columns of what the kernel finds: of a start, and of the frames that are to hold it.
OF_REACH, OF_FRAMES, FINDINGS = 0, 1, 2
# Of a start: nothing, that no rod of its length can be held so, that it may be too straight to be brought onto closure as it
# is, and that it has to be one straight line.
SOUND, INFEASIBLE, STRAIGHT, TAUT = range(4)
# Of frames: that both can hold what they are to, or which cannot.
BOTH, NOT_THE_FIRST, NOT_THE_LAST = range(3)
# Slack, over the reach, below which a rod is straight, within a hundred-thousandth of a millimetre of its clamps: f64 bows no
# rod by so little.
TAUT_SLACK = 1e-7


@ti.func
def measured(rest_length: ti.template(), row):
    """(length, longest edge, shortest two neighbours, largest moment arm of gravity seen from vertex 0, and from the far end)
    of the rod with these rest lengths, mm, and mm² the arms."""
    edges = rest_length.shape[1]
    total, longest = (ti.cast(0.0, ti.f64), ti.cast(0.0, ti.f64))
    shortest_pair = ti.cast(rest_length[row, 0] + rest_length[row, 1], ti.f64)
    for e in range(edges):
        length = rest_length[row, e]
        total += length
        longest = ti.max(longest, length)
        if e > 0:
            shortest_pair = ti.min(shortest_pair, length + rest_length[row, e - 1])
    before, hanging, standing = (ti.cast(0.0, ti.f64), ti.cast(0.0, ti.f64), ti.cast(0.0, ti.f64))
    for e in range(edges):
        length = rest_length[row, e]
        before += length
        hanging = ti.max(hanging, absolute(length * (length + 2.0 * (total - before))))
        standing = ti.max(standing, absolute(length * (length - 2.0 * before)))
    return total, longest, shortest_pair, hanging, standing


@ti.func
def vector(table: ti.template(), row):
    return (table[row, 0], table[row, 1], table[row, 2])


@ti.func
def frame_of(start: ti.template(), s, edge):
    """The frame of an edge of start s, as a unit quaternion."""
    return normalised((start[s, edge, 0], start[s, edge, 1], start[s, edge, 2], start[s, edge, 3]))


@ti.func
def can_hold(kind, frame: ti.template(), s):
    """Whether frame s has what a clamp of that kind holds: for a whole frame orthonormal, right-handed columns, for a tangent a
    unit vector. Not where anything is not a number."""
    t = (frame[s, 0, 0], frame[s, 1, 0], frame[s, 2, 0])
    m1 = (frame[s, 0, 1], frame[s, 1, 1], frame[s, 2, 1])
    m2 = (frame[s, 0, 2], frame[s, 1, 2], frame[s, 2, 2])
    off = absolute(dot(t, t) - 1.0)
    right_handed = True
    if kind == FRAME:
        off = larger(off, larger(absolute(dot(m1, m1) - 1.0), absolute(dot(m2, m2) - 1.0)))
        off = larger(off, larger(larger(absolute(dot(t, m1)), absolute(dot(m1, m2))), absolute(dot(m2, t))))
        right_handed = dot(m2, cross(t, m1)) > 0.0
    return (kind < TANGENT) | ((off <= FRAME_TOLERANCE) & right_handed)


@ti.func
def held_frame(kind, frame: ti.template(), s, own):
    """The frame of an end edge as its clamp holds it, which is ``own`` where that does not care; a tangent clamp turns the edge
    by parallel transport, keeping its spin."""
    q0, q1, q2, q3 = own
    if kind == FRAME:
        q0, q1, q2, q3 = from_matrix((
            frame[s, 0, 0], frame[s, 0, 1], frame[s, 0, 2], frame[s, 1, 0], frame[s, 1, 1], frame[s, 1, 2],
            frame[s, 2, 0], frame[s, 2, 1], frame[s, 2, 2]))
    if kind == TANGENT:
        t = (frame[s, 0, 0], frame[s, 1, 0], frame[s, 2, 0])
        unit = 1.0 / ti.sqrt(dot(t, t))
        old, new = tangent(own), (unit * t[0], unit * t[1], unit * t[2])
        q0, q1, q2, q3 = transported(own, old, new)
        if 1.0 + dot(old, new) < 1e-14:
            # From the opposite tangent there is none: half a turn about some axis across.
            far = ti.cast(1e30, ti.f64)
            x, y, z = (0.0 * far, far * old[2], 0.0 - far * old[1])
            if absolute(old[0]) > 0.9:
                x, y, z = (0.0 - far * old[2], 0.0 * far, far * old[0])
            q0, q1, q2, q3 = turned_in_world(own, (x, y, z))
    return q0, q1, q2, q3


@cache
def clamp_kernel(serial: bool, block: int):
    """The kernel, compiled on first use; ``serial``: on the caller's thread; ``block``: threads in a block, 1 on a CPU."""
    table2 = ti.types.ndarray(dtype=ti.f64, ndim=2)
    table3 = ti.types.ndarray(dtype=ti.f64, ndim=3)

    @ti.func
    def read(
        s, kind_start, kind_end, size, origin: ti.template(), start: ti.template(), rest_length: ti.template(),
        start_position: ti.template(), end_position: ti.template(), start_frame: ti.template(), end_frame: ti.template(),
        clamp: ti.template(),
    ):
        """Row s of the table of clamps; returns what is found of the start and of the frames."""
        total, longest, shortest_pair, hanging, standing = size
        edges = start.shape[1]
        row = ti.min(s, rest_length.shape[0] - 1)
        closed = (kind_start >= POSITION) & (kind_end >= POSITION)
        released = (kind_start < POSITION) & (kind_end >= POSITION)
        tilts = (ti.cast(kind_start < TANGENT, ti.f64), ti.cast(kind_end < TANGENT, ti.f64))
        clamp[s, CLOSED] = ti.cast(closed, ti.f64)
        clamp[s, SPIN_START] = ti.cast(kind_start < FRAME, ti.f64)
        clamp[s, SPIN_END] = ti.cast(kind_end < FRAME, ti.f64)
        clamp[s, TILT_START], clamp[s, TILT_END], clamp[s, TILT_INNER] = (tilts[0], tilts[1], 1.0)
        clamp[s, RELEASED] = ti.cast(released, ti.f64)
        clamp[s, LOOSE] = 0.0
        near0, near1, near2 = vector(origin, s)
        if kind_start >= POSITION:
            near0, near1, near2 = vector(start_position, s)
        far = vector(end_position, s)
        line0, line1, line2 = (ti.cast(0.0, ti.f64), ti.cast(0.0, ti.f64), ti.cast(0.0, ti.f64))
        if closed:
            line0, line1, line2 = (far[0] - near0, far[1] - near1, far[2] - near2)
        clamp[s, TARGET], clamp[s, TARGET + 1], clamp[s, TARGET + 2] = (line0, line1, line2)
        if released:
            near0, near1, near2 = far
            hanging = standing
        clamp[s, ANCHOR], clamp[s, ANCHOR + 1], clamp[s, ANCHOR + 2] = (near0, near1, near2)
        clamp[s, TOTAL], clamp[s, LONGEST], clamp[s, SHORTEST_PAIR], clamp[s, HANGING] = (
            total, longest, shortest_pair, hanging)
        first = held_frame(kind_start, start_frame, s, frame_of(start, s, 0))
        last = held_frame(kind_end, end_frame, s, frame_of(start, s, edges - 1))
        for k in ti.static(range(4)):
            clamp[s, ENDS + k] = first[k]
            clamp[s, ENDS + 4 + k] = last[k]
        found = SOUND
        if closed:
            # The line that the free edges have to bridge, and how far they reach.
            reach = total
            for end in ti.static(range(2)):
                along = tangent((first, last)[end])
                length = (1.0 - tilts[end]) * rest_length[row, (0, edges - 1)[end]]
                line0, line1, line2 = (line0 - length * along[0], line1 - length * along[1], line2 - length * along[2])
                reach -= length
            share = ti.sqrt(line0 * line0 + line1 * line1 + line2 * line2) / reach
            slack = 1.0 - share
            # Two free edges at least leave the far point three ways to go.
            if (slack >= -1e-12) & (tilts[0] + tilts[1] >= 4.0 - edges):
                # Straight rods have their inner edges in line: two of them tell most others apart.
                one = tangent(frame_of(start, s, ti.min(1, edges - 1)))
                other = tangent(frame_of(start, s, edges // 2))
                apart = (one[0] - other[0], one[1] - other[1], one[2] - other[2])
                if slack < TAUT_SLACK:
                    found = TAUT
                elif dot(apart, apart) < 1e-4:
                    found = STRAIGHT
            else:
                found = INFEASIBLE
        frames = BOTH
        if not can_hold(kind_end, end_frame, s):
            frames = NOT_THE_LAST
        if not can_hold(kind_start, start_frame, s):
            frames = NOT_THE_FIRST
        return found, frames

    @ti.kernel
    def read_clamps(
        kinds: ti.types.ndarray(dtype=ti.i32, ndim=2),  # [start, 2]
        origin: table2,  # [start, 3] mm
        start: table3,  # [start, edge, 4] of any length
        rest_length: table2,  # [1 or start, edge] mm
        start_position: table2,  # [start, 3] mm
        end_position: table2,
        start_frame: table3,  # [start, 3, 3]
        end_frame: table3,
        threads: ti.i32,
        clamp: table2,  # [start, CLAMP_COLUMNS] out
        found: ti.types.ndarray(dtype=ti.i32, ndim=2),  # [start, FINDINGS] out
    ):
        ti.loop_config(block_dim=block, serialize=serial)
        for thread in range(threads):
            share = (start.shape[0] + threads - 1) // threads
            total, longest, shortest_pair, hanging, standing = measured(rest_length, 0)
            for s in range(thread * share, ti.min((thread + 1) * share, start.shape[0])):
                if rest_length.shape[0] > 1:
                    total, longest, shortest_pair, hanging, standing = measured(rest_length, s)
                size = (total, longest, shortest_pair, hanging, standing)
                found[s, OF_REACH], found[s, OF_FRAMES] = read(
                    s, kinds[s, 0], kinds[s, 1], size, origin, start, rest_length, start_position, end_position, start_frame,
                    end_frame, clamp)

    return read_clamps
