"""The table of clamps: how each rod's ends are held, and its lengths, filled by a kernel in f64 (§III-B)."""

from functools import cache

import numpy as np
import taichi as ti

from doo_ti.physics.algebra import absolute, larger, row, transposed
from doo_ti.physics.number import Number, device_functions, in_f64, read, write
from doo_ti.physics.quaternion import from_matrix, normalised, tangent, turned_to
from doo_ti.physics.tuples import cross, dot, minus, record, repeated, scaled, variable
from doo_ti.relaxation import tables as of
from doo_ti.relaxation.kernel_factory import INDEX2, TABLE2, TABLE3, loop_kernel
from doo_ti.relaxation.tables import FRAME, POSITION, TANGENT
from doo_ti.rod.frames import FRAME_TOLERANCE
from doo_ti.rod.types import Clamps, Configuration
from doo_ti.system import runtime
from doo_ti.system.errors import InputError

# Columns of whole numbers about a start: in, the kinds of its clamps; out, the findings about its reach and its clamped frames.
KIND_START, KIND_END, OF_REACH, OF_FRAMES, STATES = 0, 1, 2, 3, 4
# Columns of what is given about a start: vertex 0, and of the clamps the positions and the frames, row by row. In one table,
# because passing an array to a kernel takes as long as several rods.
ORIGIN, START_POSITION, END_POSITION, START_FRAME, END_FRAME = 0, 3, 6, 9, 18
# About a start: it is sound; no rod of its length can be held so; it may be too straight to be projected onto closure; it is
# taut, so that it can only be one straight line.
SOUND, INFEASIBLE, STRAIGHT, TAUT = range(4)
# About the frames: both are valid, or which one is not.
BOTH, NOT_THE_FIRST, NOT_THE_LAST = range(3)
# Slack over the reach below which a rod is taut: its straight line misses a clamp by 1e-5 mm at most if it is 99 mm long. f64
# cannot resolve the bow of a smaller slack.
TAUT_SLACK = 1e-7
# By so much of the reach a span may exceed it.
ROUNDING = 1e-12
# The square of the difference of two tangents, below which a rod may be straight.
ALIKE = 1e-4
FEW = 512  # up to so many starts are read on the caller's thread: to wake another takes as long


@ti.func
def frame_of(start: ti.template(), s, edge):
    """The frame of an edge of start s, as a unit quaternion."""
    return normalised(read(start, s, edge, 0, count=4))


@ti.func
def can_hold(kind, frame):
    """Whether a frame, row by row, has what a clamp of that kind holds: for a whole frame orthonormal, right-handed columns,
    for a tangent a unit vector. False where anything is NaN."""
    columns = transposed(frame)
    t, m1, m2 = row(columns, 0), row(columns, 1), row(columns, 2)
    off = absolute(dot(t, t) - 1.0)
    right_handed = True
    if kind == FRAME:
        off = larger(off, larger(absolute(dot(m1, m1) - 1.0), absolute(dot(m2, m2) - 1.0)))
        off = larger(off, larger(larger(absolute(dot(t, m1)), absolute(dot(m1, m2))), absolute(dot(m2, t))))
        right_handed = dot(m2, cross(t, m1)) > 0.0
    return (kind < TANGENT) | ((off <= FRAME_TOLERANCE) & right_handed)


@ti.func
def held_frame(kind, frame, own):
    """The frame of an end edge as its clamp holds it, ``frame`` row by row, or ``own`` where the clamp holds no direction."""
    q = variable(own)
    if kind == FRAME:
        q = from_matrix(frame)
    if kind == TANGENT:
        t = row(transposed(frame), 0)
        q = turned_to(own, scaled(t, 1.0 / ti.sqrt(dot(t, t))))
    return q


@device_functions
class ClampReader:
    """Fills the table of clamps. ``tables`` is the record of the kernel's arrays."""

    def work(self, tables, thread):
        """Rows of one thread."""
        zero = ti.cast(0.0, ti.f64)
        size = record(total=zero, longest=zero, shortest_pair=zero, hanging=zero, standing=zero)
        self.measure(tables.rest_length, 0, size)
        share = (tables.start.shape[0] + tables.threads - 1) // tables.threads
        for s in range(thread * share, ti.min((thread + 1) * share, tables.start.shape[0])):
            if tables.rest_length.shape[0] > 1:
                self.measure(tables.rest_length, s, size)
            self.fill(tables, size, s)

    def measure(self, rest_length: ti.template(), s, size):
        """Into the record ``size`` from the rest lengths s: the ``total``, the ``longest`` edge, the ``shortest_pair`` of
        neighbours, mm, and the largest moment arm of gravity seen from vertex 0, ``hanging``, and from the far end,
        ``standing``, mm²."""
        zero = ti.cast(0.0, ti.f64)
        size.total, size.longest, size.hanging, size.standing = zero, zero, zero, zero
        size.shortest_pair = rest_length[s, 0] + rest_length[s, 1]
        for e in range(rest_length.shape[1]):
            length = rest_length[s, e]
            size.total += length
            size.longest = ti.max(size.longest, length)
            if e > 0:
                size.shortest_pair = ti.min(size.shortest_pair, length + rest_length[s, e - 1])
        before = zero
        for e in range(rest_length.shape[1]):
            length = rest_length[s, e]
            before += length
            size.hanging = ti.max(size.hanging, absolute(length * (length + 2.0 * (size.total - before))))
            size.standing = ti.max(size.standing, absolute(length * (length - 2.0 * before)))

    def fill(self, tables, size, s):
        """Fill row s of the table of clamps, and of the findings."""
        kind_start, kind_end = tables.states[s, KIND_START], tables.states[s, KIND_END]
        closed = (kind_start >= POSITION) & (kind_end >= POSITION)
        released = (kind_start < POSITION) & (kind_end >= POSITION)
        flags = (closed, kind_start < FRAME, kind_end < FRAME, kind_start < TANGENT, kind_end < TANGENT, True, released)
        write(tables.clamp, s, of.CLOSED, values=in_f64(flags))  # and SPIN_START … RELEASED
        tables.clamp[s, of.LOOSE] = 0.0
        anchor = variable(read(tables.given, s, ORIGIN))
        if kind_start >= POSITION:
            anchor = read(tables.given, s, START_POSITION)
        far = read(tables.given, s, END_POSITION)
        line = variable(repeated(ti.cast(0.0, ti.f64), 3))
        if closed:
            line = minus(far, anchor)
        hanging = size.hanging
        if released:
            anchor = far
            hanging = size.standing
        write(tables.clamp, s, of.TARGET, values=line)
        write(tables.clamp, s, of.ANCHOR, values=anchor)
        write(tables.clamp, s, of.TOTAL, values=(size.total, size.longest, size.shortest_pair, hanging))
        frame_start, frame_end = (read(tables.given, s, START_FRAME, count=9), read(tables.given, s, END_FRAME, count=9))
        first = held_frame(kind_start, frame_start, frame_of(tables.start, s, 0))
        last = held_frame(kind_end, frame_end, frame_of(tables.start, s, tables.start.shape[1] - 1))
        write(tables.clamp, s, of.ENDS, values=first)
        write(tables.clamp, s, of.ENDS + 4, values=last)
        tables.states[s, OF_REACH] = SOUND
        if closed:
            tables.states[s, OF_REACH] = self.reached(tables, size, s, line, first, last)
        frames = BOTH
        if not can_hold(kind_end, frame_end):
            frames = NOT_THE_LAST
        if not can_hold(kind_start, frame_start):
            frames = NOT_THE_FIRST
        tables.states[s, OF_FRAMES] = frames

    def reached(self, tables, size, s, line, first, last):
        """The finding about a start whose vertex 0 and far end are held, ``line`` apart, with these frames at its ends."""
        edges = tables.start.shape[1]
        length = ti.min(s, tables.rest_length.shape[0] - 1)
        tilts = (tables.clamp[s, of.TILT_START], tables.clamp[s, of.TILT_END])
        # The line that the free edges have to bridge, and how far they reach.
        held_first = (1.0 - tilts[0]) * tables.rest_length[length, 0]
        held_last = (1.0 - tilts[1]) * tables.rest_length[length, edges - 1]
        free = minus(minus(line, scaled(tangent(first), held_first)), scaled(tangent(last), held_last))
        span, reach = ti.sqrt(dot(free, free)), size.total - held_first - held_last
        slack = 1.0 - span / reach
        found = SOUND
        # With at least two free edges the far point can move in three directions; an edge without length moves nothing.
        tilting = ti.cast(edges - 2, ti.f64)
        if tables.rest_length[length, 0] > 0.0:
            tilting += tilts[0]
        if tables.rest_length[length, edges - 1] > 0.0:
            tilting += tilts[1]
        longest = size.longest
        if 2.0 * longest > reach + span:  # as of few rods: it may be an edge that a clamp holds
            longest = 0.0
            for e in range(edges):
                if ((e > 0) | (tilts[0] > 0.0)) & ((e < edges - 1) | (tilts[1] > 0.0)):
                    longest = ti.max(longest, tables.rest_length[length, e])
        # Nor does one free edge reach back over all others and the line.
        if (slack >= -ROUNDING) & (tilting >= 2.0) & (2.0 * longest <= (1.0 + ROUNDING) * (reach + span)):
            # Straight rods have their inner edges in line: comparing two of them excludes most other rods.
            inner, middle = frame_of(tables.start, s, ti.min(1, edges - 1)), frame_of(tables.start, s, edges // 2)
            apart = minus(tangent(inner), tangent(middle))
            if slack < TAUT_SLACK:
                found = TAUT
            elif dot(apart, apart) < ALIKE:
                found = STRAIGHT
        else:
            found = INFEASIBLE
        return found


ARGUMENTS = {
    "states": INDEX2,  # [start, STATES] in and out
    "given": TABLE2,  # [start, ORIGIN …] mm
    "start": TABLE3,  # [start, edge, 4] of any length
    "rest_length": TABLE2,  # [1 or start, edge] mm
    "threads": ti.i32,
    "clamp": TABLE2,  # [start, CLAMP_COLUMNS] out
}


@cache
def clamp_kernel(serial: bool, block: int):
    """The kernel, compiled on first use; ``serial`` and ``block`` as of :func:`.loop_kernel`."""
    return loop_kernel("read_clamps", Number(1, 64), ARGUMENTS, ClampReader(), block, serial)


@runtime.exclusive
def clamp_table(configuration: Configuration, lengths: np.ndarray, kinds: np.ndarray, clamps: Clamps):
    """((S, CLAMP_COLUMNS) table, see the columns' names, and (S,) whether each start can be relaxed as it is, one of SOUND,
    INFEASIBLE, STRAIGHT and TAUT).

    lengths  (1 or S, E) mm
    kinds    (S, 2) Clamp numbers

    Raises InputError where a clamped frame is not a rotation, or a clamped tangent not a unit vector.
    """
    count = len(kinds)
    table, states = np.empty((count, of.CLAMP_COLUMNS)), np.empty((count, STATES), dtype=np.int32)
    states[:, : OF_REACH] = kinds
    on_cpu = runtime.start() == "cpu"
    serial = on_cpu and count <= FEW
    threads = 1 if serial else runtime.thread_count() if on_cpu else max(1, count)
    if not count:
        return table, states[:, OF_REACH]
    given = np.concatenate([
        configuration.start, clamps.start_position, clamps.end_position, clamps.start_frame.reshape(count, 9),
        clamps.end_frame.reshape(count, 9)], axis=1, dtype=np.float64)
    start, lengths = (np.ascontiguousarray(array, dtype=np.float64) for array in (configuration.quaternions, lengths))
    clamp_kernel(serial, 1 if on_cpu else 64)(
        states=states, given=given, start=start, rest_length=lengths, threads=threads, clamp=table)
    _check_frames(states[:, OF_FRAMES], clamps)
    return table, states[:, OF_REACH]


def _check_frames(found: np.ndarray, clamps: Clamps) -> None:
    """Raise InputError where a frame was found not to be a rotation, or its tangent not a unit vector. A rod whose frame is not
    finite gets a status instead."""
    if (found == BOTH).all():
        return
    for name, which in (("start_frame", NOT_THE_FIRST), ("end_frame", NOT_THE_LAST)):
        frames = getattr(clamps, name)[found == which]
        wrong = frames[np.isfinite(frames).all(axis=(1, 2))]
        if len(wrong):
            raise InputError("clamps", name, f"{np.round(wrong[0], 4).tolist()} is no frame that can be held",
                             "give unit, orthogonal columns t, m1, m2 with m2 = t x m1; of a tangent t at least")
