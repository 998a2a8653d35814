"""Which rods may have touched themselves on the way from one shape to another (docs/contact.md).

On the straight way of every vertex from one shape to the other, the distance of two places changes along the rod by no more
than the arc. From the distance of one pair of edges follows how many edges further along need not be looked at, so that of a
rod far from itself only a few are.

A rod may also have passed through itself and come back. Where both its ends are held its linking number tells: the twist of its
frames after the straight way, each transported from its old tangent to the new one, differs from that of the result by whole
turns.
"""

from functools import cache

import numpy as np
import taichi as ti

from doo_ti import runtime
from doo_ti.contact.itself import LEAST_ARC
from doo_ti.physics.algebra import largest_of
from doo_ti.physics.angle import passed_half_turn, turned_about_own_tangent
from doo_ti.physics.number import Number
from doo_ti.physics.quaternion import tangent
from doo_ti.physics.tuples import dot, minus, plus, record, repeated, scaled, variable
from doo_ti.relaxation.batch import layout_for, scratch_for

# Items of an edge: its middle before and after, its frame before and after, and its length.
BEFORE, AFTER, FRAME_BEFORE, FRAME_AFTER, LENGTH, ITEMS = 0, 3, 6, 10, 14, 15
ROUNDING = 1e-5
"""Of a rod's length, by which f32 may be off."""


@ti.data_oriented
class SelfApproach:
    """The search for one kind of number, on packs of rods whose edges' items are in scratch."""

    def __init__(self, number: Number, stride: int):
        lanes = number.lanes()
        self.stride, self.width, self.scalar = stride, number.width, number.scalar
        self.put, self.lane, self.largest = lanes.put, lanes.lane, lanes.largest

    @ti.func
    def load3(self, scratch: ti.template(), at):
        return (scratch[at], scratch[at + self.stride], scratch[at + 2 * self.stride])

    @ti.func
    def load4(self, scratch: ti.template(), at):
        return self.load3(scratch, at) + (scratch[at + 3 * self.stride],)

    @ti.func
    def edge(self, head, e):
        return head + e * ITEMS * self.stride

    @ti.func
    def work(self, tables, scratch: ti.template(), threads, thread, by_frames: ti.template()):
        """A thread's share of the rods, pack after pack."""
        edges, rods = tables.rest_length.shape[1], tables.flags.shape[0]
        head = thread
        if ti.static(self.stride == 1):
            head = thread * (edges * ITEMS + 1)
        thick = self.edge(head, edges)
        for pack in range((rods + self.width - 1) // self.width):
            if pack % threads == thread:
                for slot in range(self.width):
                    rod = ti.min(pack * self.width + slot, rods - 1)
                    if ti.static(by_frames):
                        self.load_frames(tables, rod, scratch, head, slot)
                    else:
                        self.load_places(tables, rod, scratch, head, slot)
                    self.put(scratch, thick, slot, tables.radius[ti.min(rod, tables.radius.shape[0] - 1)])
                turns = 0.0 * scratch[thick]
                if ti.static(by_frames):
                    turns = self.place_middles(scratch, head, edges)
                least = self.search(scratch, head, edges, scratch[thick])
                for slot in range(self.width):
                    rod = pack * self.width + slot
                    if rod < rods:
                        found = ti.select(self.lane(least, slot) > 0.0, 0, 1)
                        if ti.static(by_frames):
                            if tables.held[rod] == 1 and not ti.abs(self.lane(turns, slot)) < 0.5:
                                found = 1
                        tables.flags[rod] = found

    @ti.func
    def load_frames(self, tables, rod, scratch: ti.template(), head, slot):
        """The frames and lengths of a rod into lane ``slot``."""
        edges, first = tables.rest_length.shape[1], tables.rows[rod]
        for e in range(edges):
            at = self.edge(head, e)
            for k in ti.static(range(4)):
                self.put(scratch, at + (FRAME_BEFORE + k) * self.stride, slot, tables.before[(first * edges + e) * 4 + k])
                self.put(scratch, at + (FRAME_AFTER + k) * self.stride, slot, tables.after[(rod * edges + e) * 4 + k])
            self.load_length(tables, rod, e, scratch, at, slot)

    @ti.func
    def load_places(self, tables, rod, scratch: ti.template(), head, slot):
        """The middles and lengths of a rod, from its first vertex, into lane ``slot``."""
        for e in range(tables.rest_length.shape[1]):
            at = self.edge(head, e)
            for k in ti.static(range(3)):
                old = 0.5 * (tables.before[rod, e, k] + tables.before[rod, e + 1, k]) - tables.before[rod, 0, k]
                new = 0.5 * (tables.after[rod, e, k] + tables.after[rod, e + 1, k]) - tables.before[rod, 0, k]
                self.put(scratch, at + (BEFORE + k) * self.stride, slot, old)
                self.put(scratch, at + (AFTER + k) * self.stride, slot, new)
            self.load_length(tables, rod, e, scratch, at, slot)

    @ti.func
    def load_length(self, tables, rod, e, scratch: ti.template(), at, slot):
        """The length of an edge, whose items begin at ``at``, into lane ``slot``."""
        row = ti.min(tables.rows[rod], tables.rest_length.shape[0] - 1)
        self.put(scratch, at + LENGTH * self.stride, slot, tables.rest_length[row, e])

    @ti.func
    def place_middles(self, scratch: ti.template(), head, edges):
        """The middles of all edges from their frames; returns by how many turns the link changes."""
        zero = 0.0 * scratch[head + LENGTH * self.stride]
        before, after = variable(repeated(zero, 3)), variable(repeated(zero, 3))
        last, turns = variable(repeated(zero, 2)), zero
        for e in range(edges):
            at = self.edge(head, e)
            old, new = self.load4(scratch, at + FRAME_BEFORE * self.stride), self.load4(scratch, at + FRAME_AFTER * self.stride)
            half = 0.5 * scratch[at + LENGTH * self.stride]
            old_half, new_half = scaled(tangent(old), half), scaled(tangent(new), half)
            before, after = plus(before, old_half), plus(after, new_half)
            for k in ti.static(range(3)):
                scratch[at + (BEFORE + k) * self.stride] = before[k]
                scratch[at + (AFTER + k) * self.stride] = after[k]
            before, after = plus(before, old_half), plus(after, new_half)
            turned = turned_about_own_tangent(old, new)
            if e > 0:
                turns = turns + passed_half_turn(last, turned)
            last = turned
        return turns

    @ti.func
    def nearest(self, scratch: ti.template(), head, i, j):
        """The least distance of the middles of two edges on the way."""
        first, second = self.edge(head, i), self.edge(head, j)
        before = minus(self.load3(scratch, second), self.load3(scratch, first))
        after = minus(self.load3(scratch, second + AFTER * self.stride), self.load3(scratch, first + AFTER * self.stride))
        change = minus(after, before)
        share = (0.0 - dot(before, change)) / (dot(change, change) + 1e-30)
        zero = 0.0 * share
        place = plus(before, scaled(change, ti.min(ti.max(share, zero), zero + 1.0)))
        return ti.sqrt(dot(place, place))

    @ti.func
    def search(self, scratch: ti.template(), head, edges, radius):
        """By how much two parts of the rods stay apart on the way at least; negative where they may touch."""
        longest, total = 0.0 * radius, 0.0 * radius
        for e in range(edges):
            length = scratch[self.edge(head, e) + LENGTH * self.stride]
            longest, total = largest_of(longest, length), total + length
        # Two places of edges are no nearer than their middles less an edge's length.
        near = longest + 2.0 * radius + ROUNDING * total
        # Edges i and i + apart are the first that may have enough of the rod between them.
        fewest = 0.0 - self.largest(0.0 - LEAST_ARC * radius / longest)
        apart = ti.max(2, ti.cast(ti.floor(fewest), ti.i32) + 2)
        least = 0.0 * radius + 1e30
        for i in range(edges):
            j = i + apart
            while j < edges:
                room = self.nearest(scratch, head, i, j) - near
                counts = ti.cast(j - i - 1, self.scalar) * longest > LEAST_ARC * radius
                least = ti.min(least, ti.select(counts, room, least))
                further = 0.0 - self.largest(0.0 - room / longest)
                j += 1 + ti.cast(ti.min(ti.max(further, ti.cast(0.0, self.scalar)), ti.cast(1e6, self.scalar)), ti.i32)
        return least


@cache
def _kernels(number: Number, stride: int, block: int):
    """The kernels of rods that are given by frames, and by places."""
    search = SelfApproach(number, stride)
    table1, table2, table3 = (ti.types.ndarray(dtype=ti.f64, ndim=size) for size in (1, 2, 3))
    index1 = ti.types.ndarray(dtype=ti.i32, ndim=1)
    packs = ti.types.ndarray(dtype=number.type, ndim=1)

    @ti.kernel
    def by_frames(start: table1, rows: index1, frames: table1, rest_length: table2, radius: table1, held: index1,
                  threads: ti.i32, scratch: packs, flags: index1):
        ti.loop_config(block_dim=block)
        for thread in range(threads):
            tables = record(before=start, after=frames, rows=rows, rest_length=rest_length, radius=radius, held=held,
                            flags=flags)
            search.work(tables, scratch, threads, thread, True)

    @ti.kernel
    def by_places(before: table3, after: table3, rows: index1, rest_length: table2, radius: table1, threads: ti.i32,
                  scratch: packs, flags: index1):
        ti.loop_config(block_dim=block)
        for thread in range(threads):
            tables = record(before=before, after=after, rows=rows, rest_length=rest_length, radius=radius, flags=flags)
            search.work(tables, scratch, threads, thread, False)

    return by_frames, by_places


def _launch(kernel: int, count: int, edges: int, *arguments) -> np.ndarray:
    number, threads, stride, block = layout_for(count, 32)
    scratch = scratch_for(number, threads * (edges * ITEMS + 1))
    flags = np.zeros(count, dtype=np.int32)
    _kernels(number, stride, block)[kernel](*arguments, threads, scratch, flags)
    return flags > 0


@runtime.exclusive
def approach_in_relaxation(start: np.ndarray, start_row: np.ndarray, frames: np.ndarray, rest_length: np.ndarray,
                           radius: np.ndarray, held: np.ndarray) -> np.ndarray:
    """(R,) whether a rod may touch itself between its start, row ``start_row`` (R,) of ``start`` (S, E, 4), and its ``frames``
    (R, E, 4); also where these are not finite. ``held`` (R,): no end may turn."""
    rows = np.ascontiguousarray(start_row, dtype=np.int32)
    return _launch(0, len(frames), rest_length.shape[1], start.reshape(-1), rows, frames.reshape(-1), rest_length, radius,
                   np.ascontiguousarray(held, dtype=np.int32))


@runtime.exclusive
def approach_in_motion(before: np.ndarray, after: np.ndarray, length_row: np.ndarray, rest_length: np.ndarray,
                       radius: np.ndarray) -> np.ndarray:
    """(R,) the same between two instants of a motion, places (R, V, 3); not where these are not finite."""
    rows = np.ascontiguousarray(length_row, dtype=np.int32)
    found = _launch(1, len(before), rest_length.shape[1], np.ascontiguousarray(before), np.ascontiguousarray(after), rows,
                    rest_length, radius)
    return found & np.isfinite(after[:, 0, 0]) & np.isfinite(before[:, 0, 0])
