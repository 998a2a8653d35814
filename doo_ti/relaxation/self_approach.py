"""Which rods may have touched themselves on the way from one shape to another (docs/contact.md).

On the straight way of every vertex from one shape to the other all distances along the rod stay at most as long as the arc
between them. A rod is divided into blocks of edges, on which two bounds show that most rods stay far from themselves:

- the tangents of neighbouring blocks, before and after, are all within a cone about their mean: two places are then as far
  apart as the cosine of its angle times the arc between them;
- places of other blocks are as far apart as the middles of the two blocks less half their lengths.

Rods whose edges all point along the line through their ends after every step of the relaxation, and enough so at its start and
its end, are not searched: on the straight way between two such shapes their places stay in the same order along that line.

The way of rods for which they do not is followed edge by edge (:class:`.ClosestApproach`).

A rod may also have passed through itself and come back. Where both its ends are held its linking number shows it: the twist of
its frames after the straight way, each transported from its old tangent to the new one, differs from that of the result by
whole turns.
"""

from functools import cache
from types import SimpleNamespace

import numpy as np
import taichi as ti

from doo_ti.contact.surroundings import LEAST_ARC
from doo_ti.physics.algebra import largest_of
from doo_ti.physics.number import Number, Scratch, device_functions
from doo_ti.physics.quaternion import passed_half_turn, tangent, turned_about_own_tangent
from doo_ti.physics.tuples import dot, itemwise, minus, picked, plus, record, repeated, scaled, variable
from doo_ti.relaxation import tables as of
from doo_ti.relaxation.batch import laid_out, layout_for
from doo_ti.relaxation.kernel_factory import INDEX1, INDEX2, SCRATCH, TABLE1, loop_kernel
from doo_ti.relaxation.pair_distance import ENOUGH, WAY, ClosestApproach, least_distance
from doo_ti.relaxation.tables import Tables
from doo_ti.system import runtime

APART, TOUCHING, TURNED = 0, 1, 2  # flags: a rod stays apart from itself, may touch itself, or does not but its link changes
START, ROD = 0, 1  # columns of a rod's rows: among starts, and among rods
RADIUS, NEAR, ARC_BETWEEN, LIMITS = 0, 1, 2, 3
"""Of a rod, mm: its radius, the distance at which two places touch, and the rod between any two edges that count."""
BLOCKS = 8
ROUNDING = 1e-5  # of a rod's length, by which f32 may be off
BENT = 0.25  # of the largest way of a vertex from frame to frame, by which places may be off the straight way


@device_functions
class SelfApproach:
    """The bounds for one kind of number, on packs of rods whose vertices are in scratch."""

    def __init__(self, number: Number, stride: int, by_frames: bool):
        lanes = number.lanes()
        self.memory, self.width, self.by_frames = Scratch(number, stride), number.width, by_frames
        self.lane, self.constant, self.gather = lanes.lane, lanes.constant, lanes.gather
        self.ways = ClosestApproach()
        self.vertex = self.ways.vertex

    @picked
    def items(self, given):
        """As :meth:`.Chain.items`."""
        return (given.edges + 1) * WAY.size

    def work(self, tables, thread):
        """A thread's share of the rods, pack after pack."""
        rods = tables.flags.shape[0]
        head = self.memory.of_thread(tables.scratch, thread, WAY, self.items(tables))
        for pack in range((rods + self.width - 1) // self.width):
            if pack % tables.threads == thread:
                # The last pack has its last rod several times.
                place = [ti.min(pack * self.width + slot, rods - 1) for slot in ti.static(range(self.width))]
                starts = variable([tables.rows[place[slot], START] for slot in ti.static(range(self.width))])
                own = variable([tables.rows[place[slot], ROD] for slot in ti.static(range(self.width))])
                turns = self.constant(0.0)
                if ti.static(self.by_frames):
                    turns = self.load_frames(tables, starts, own, head)
                else:
                    self.load_places(tables, starts, own, head)
                room = self.room(tables, own, head)
                for slot in range(self.width):
                    rod = pack * self.width + slot
                    if rod < rods:
                        flag = ti.select(ti.abs(self.lane(turns, slot)) < 0.5, APART, TURNED)
                        if not self.lane(room, slot) > 0.0:
                            if self.touches(tables, head.lane(slot), tables.rows[rod, ROD]):
                                flag = TOUCHING
                        tables.flags[rod] = flag

    def touches(self, tables, head, row):
        """Whether the rod in a lane, whose vertex 0 is ``head``, touches itself on its way, edge by edge."""
        at = ti.min(row, tables.limits.shape[0] // LIMITS - 1) * LIMITS
        radius = tables.limits[at + RADIUS]
        return self.ways.touches(record(head=head, edges=tables.edges, near=tables.limits[at + NEAR],
                                        enough=ENOUGH * radius, least_arc=LEAST_ARC * radius))

    # --- from tables into scratch ---

    def numbers(self, table: ti.template(), rows, size, at, count: ti.template()):
        """``count`` numbers from ``at`` on of the rows of all lanes, in a table with rows of that ``size``."""
        return itemwise(*[
            self.gather(table, [rows[slot] * size + at + k for slot in ti.static(range(self.width))])
            for k in ti.static(range(count))])

    def limit(self, tables, own, column: ti.template()):
        """A column of the limits of the rods in all lanes."""
        last = tables.limits.shape[0] // LIMITS - 1
        rows = [ti.min(own[slot], last) for slot in ti.static(range(self.width))]
        return self.numbers(tables.limits, rows, LIMITS, column, 1)[0]

    def length(self, tables, starts, e):
        """That of an edge."""
        length = self.constant(tables.lengths[e])
        if tables.lengths.shape[0] > tables.edges:
            length = self.numbers(tables.lengths, starts, tables.edges, e, 1)[0]
        return length

    def load_frames(self, tables, starts, own, head):
        """The vertices of rods that are given by frames; returns by how many turns the link changes."""
        zero = self.constant(0.0)
        rod = record(old=repeated(zero, 3), new=repeated(zero, 3), arc=zero, turns=zero, last=repeated(zero, 2))
        head.before, head.after, head.arc = rod.old, rod.new, rod.arc
        for e in range(tables.edges):
            before = self.numbers(tables.before, starts, tables.edges * 4, e * 4, 4)
            after = self.numbers(tables.after, own, tables.edges * 4, e * 4, 4)
            length = self.length(tables, starts, e)
            rod.old, rod.new = plus(rod.old, scaled(tangent(before), length)), plus(rod.new, scaled(tangent(after), length))
            rod.arc = rod.arc + length
            vertex = self.vertex(head, e + 1)
            vertex.before, vertex.after, vertex.arc = rod.old, rod.new, rod.arc
            turned = turned_about_own_tangent(before, after)
            if e > 0:
                rod.turns = rod.turns + passed_half_turn(rod.last, turned)
            rod.last = turned
        return rod.turns

    def load_places(self, tables, starts, own, head):
        """The vertices of rods that are given by places."""
        size, arc = (tables.edges + 1) * 3, self.constant(0.0)
        for v in range(tables.edges + 1):
            old, new = self.numbers(tables.before, own, size, v * 3, 3), self.numbers(tables.after, own, size, v * 3, 3)
            if v > 0:
                arc = arc + self.length(tables, starts, v - 1)
            vertex = self.vertex(head, v)
            vertex.before, vertex.after, vertex.arc = old, new, arc

    # --- bounds ---

    def before(self, head, first, last):
        """From one vertex to another, before."""
        return minus(self.vertex(head, last).before, self.vertex(head, first).before)

    def after(self, head, first, last):
        """The same after."""
        return minus(self.vertex(head, last).after, self.vertex(head, first).after)

    def arc(self, head, first, last):
        """The length of rod between two vertices."""
        return self.vertex(head, last).arc - self.vertex(head, first).arc

    def room(self, tables, own, head):
        """By how much two parts of the rods stay further apart on the way than they may, at least; negative where they may
        come nearer."""
        edges = tables.edges
        size = (edges + BLOCKS - 1) // BLOCKS
        count = (edges + size - 1) // size
        near, radius = self.limit(tables, own, NEAR), self.limit(tables, own, RADIUS)
        least_arc = self.limit(tables, own, ARC_BETWEEN)
        # Stricter than the search edge by edge: a rod's result is the same whether or not that follows, which depends on the
        # lengths of all rods of the call.
        near = near + ENOUGH * radius + ROUNDING * self.arc(head, 0, edges)
        room = self.constant(1e30)
        for block in range(ti.max(count - 1, 1)):
            cosine = self.cosine(head, block * size, ti.min((block + 2) * size, edges))
            room = ti.min(room, cosine * least_arc - near)
        for i in range(count):
            for j in range(i + 2, count):
                room = ti.min(room, self.room_of_blocks(head, i * size, j * size, size, edges) - near)
        # A minimum ignores NaN: whether places are finite is checked at the end of the rod.
        reach, end = self.vertex(head, edges).before, self.vertex(head, edges).after
        return ti.select(dot(reach, reach) + dot(end, end) < 1e30, room, 0.0 * near - 1.0)

    def cosine(self, head, first, last):
        """That of the largest angle, before or after, of an edge between two vertices to the mean direction of all of them."""
        mean = plus(self.before(head, first, last), self.after(head, first, last))
        least, longest = self.constant(1e30), self.constant(0.0)
        for e in range(first, last):
            least = ti.min(least, dot(mean, self.before(head, e, e + 1)))
            least = ti.min(least, dot(mean, self.after(head, e, e + 1)))
            longest = largest_of(longest, self.arc(head, e, e + 1))
        return least / (longest * ti.sqrt(dot(mean, mean) + 1e-30))

    def room_of_blocks(self, head, i, j, size, edges):
        """The least distance on the way between the ``size`` edges from i on and those from j on."""
        end = ti.min(j + size, edges)
        before = plus(self.before(head, i, j), self.before(head, i + size, end))
        after = plus(self.after(head, i, j), self.after(head, i + size, end))
        apart = least_distance(before, minus(after, before))  # twice that of the middles
        return 0.5 * (apart - self.arc(head, i, i + size) - self.arc(head, j, end))


ARGUMENTS = {
    "before": TABLE1,  # [start · edge · 4] frames, or [rod · vertex · 3] mm from the first vertex before
    "after": TABLE1,  # [rod · edge · 4] or [rod · vertex · 3]
    "rows": INDEX2,  # [place, (START, ROD)]: START is also that of lengths that differ
    "lengths": TABLE1,  # [1 or row · edge] mm
    "limits": TABLE1,  # [1 or rod · LIMITS] mm
    "edges": ti.i32, "threads": ti.i32, "scratch": SCRATCH,
    "flags": INDEX1,  # [place] out, APART, TOUCHING or TURNED
}


@cache
def _kernel(number: Number, stride: int, block: int, by_frames: bool):
    """As :func:`.newton_kernel`, of rods that are given by frames, or by places."""
    approach = SelfApproach(number, stride, by_frames)
    return loop_kernel("approach", number, ARGUMENTS, approach.work, block), approach.items


def _approach(by_frames: bool, before, after, rows, rest_length, radius, more) -> np.ndarray:
    """(N,) APART, TOUCHING or TURNED, of the N rods of ``rows``, that touch where they come nearer to themselves than two radii
    and ``more``."""
    edges = rest_length.shape[1]
    kernel, threads, scratch, _ = laid_out(
        layout_for(len(rows), 32), lambda *layout: _kernel(*layout, by_frames), SimpleNamespace(edges=edges))
    near = 2.0 * radius + more
    limits = np.empty((len(near), LIMITS))
    limits[:, RADIUS], limits[:, NEAR] = radius, near
    limits[:, ARC_BETWEEN] = _arc_between(radius, rest_length.min(), rest_length.max())
    flags = np.zeros(len(rows), dtype=np.int32)
    kernel(
        before.reshape(-1), after.reshape(-1), rows, rest_length.reshape(-1), limits.reshape(-1), edges, threads, scratch,
        flags)
    return flags


def _arc_between(radius, shortest, longest):
    """mm of a rod with edges of these lengths that is between any two of them that count."""
    # Between them lie whole edges: the fewest that are longer than LEAST_ARC.
    fewest = np.floor(LEAST_ARC * radius / longest) + 1.0
    return np.maximum(LEAST_ARC * radius, fewest * shortest)


def stays_in_order(table: Tables, results: np.ndarray) -> np.ndarray:
    """(R,) rods whose edges all point along the line through their ends from the start to the end of their relaxation, at both
    so much that on the straight way between two places are as far apart along the line as the smallest cosine times the arc
    between them, or more. No step leads from one such shape to another through itself."""
    lengths, radius, index = table.rest_length, table.contact.radius, table.configuration_index
    shortest, longest, total = lengths.min(axis=1), lengths.max(axis=1), lengths.sum(axis=1)
    if len(lengths) > 1:
        shortest, longest, total = shortest[index], longest[index], total[index]
    least = ((2.0 + ENOUGH) * radius + ROUNDING * total) / _arc_between(radius, shortest, longest)
    return results[:, of.ALONG] > least


@runtime.exclusive
def approach_in_relaxation(start: np.ndarray, frames: np.ndarray, rest_length: np.ndarray, radius: np.ndarray,
                           rods: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which of the rows ``rods`` (N,) may touch themselves between their ``start`` (N, E, 4), unit quaternions held by the
    clamps, and their ``frames`` (R, E, 4), also those whose frames are not finite; and which others have turned by whole turns,
    which only rods with an end that may turn do without passing through themselves. rest_length (1 or N, E) mm."""
    if not len(rods):
        return rods, rods
    rows = np.empty((len(rods), 2), dtype=np.int32)
    rows[:, START], rows[:, ROD] = np.arange(len(rods)), rods
    flags = _approach(True, start, frames, rows, rest_length, radius, 0.0)
    found = np.flatnonzero(flags)
    touching = flags[found] == TOUCHING
    return rods[found[touching]], rods[found[~touching]]


@runtime.exclusive
def approach_in_motion(before: np.ndarray, after: np.ndarray, length_row: np.ndarray, rest_length: np.ndarray,
                       radius: np.ndarray) -> np.ndarray:
    """(R,) whether rods may touch themselves between two instants of a motion, places (R, V, 3); not where these are not
    finite.

    The way between is not straight there: rods are found too that come as near to touching as a quarter of the largest way of a
    vertex.
    """
    if not len(after):
        return np.zeros(0, dtype=bool)
    rows = np.stack([length_row, np.arange(len(after))], axis=1).astype(np.int32)
    origin = before[:, :1]  # from there, since kernels count in f32
    before, after = np.ascontiguousarray(before - origin), np.ascontiguousarray(after - origin)
    more = BENT * np.sqrt(((after - before) ** 2).sum(axis=-1).max(axis=1))
    flags = _approach(False, before, after, rows, rest_length, radius, more)
    return (flags == TOUCHING) & np.isfinite(after[:, 0, 0]) & np.isfinite(before[:, 0, 0])
