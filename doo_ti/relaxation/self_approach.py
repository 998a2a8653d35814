"""Which rods may have touched themselves on the way from one shape to another (docs/contact.md).

On the straight way of every vertex from one shape to the other all distances along the rod stay at most as long as the arc
between them. The way is followed for every pair of edges that may come near to each other, from one instant to the first at
which the two could touch: their distance then, less that at which they touch, over the largest change of any distance between
them.

Rods whose edges all point along the line through their ends after every step of the relaxation, and enough so at its start and
its end, are not searched: on the straight way between two such shapes their places stay in the same order along that line.

A rod may also have passed through itself and come back. Where both its ends are held its linking number shows it: the twist of
its frames after the straight way, each transported from its old tangent to the new one, differs from that of the result by
whole turns.
"""

from functools import cache, partial

import numpy as np
import taichi as ti

from doo_ti.contact.surroundings import LEAST_ARC
from doo_ti.physics.number import Layout, Number, Scratch, device_functions, read
from doo_ti.physics.quaternion import passed_half_turn, tangent, turned_about_own_tangent
from doo_ti.physics.tuples import dot, minus, picked, plus, record, repeated, scaled
from doo_ti.relaxation import tables as of
from doo_ti.relaxation.batch import launch, layout_for
from doo_ti.relaxation.kernel_factory import INDEX1, INDEX2, SCRATCH, TABLE1, loop_kernel
from doo_ti.relaxation.pair_distance import nearest_places, within
from doo_ti.relaxation.tables import Tables
from doo_ti.system import runtime

APART, TOUCHING, TURNED = 0, 1, 2  # flags: a rod stays apart from itself, may touch itself, or does not but its link changes
START, ROD = 0, 1  # columns of a rod's rows: among starts, and among rods
WAY = Layout(before=3, after=3, arc=1)  # of a vertex: its place before and after, and the length of rod up to it
ENOUGH = 1e-3  # radii, nearer than which two edges touch
ROUNDING = 1e-5  # of a rod's length
BENT = 0.25  # of the largest way of a vertex from frame to frame, by which places may be off the straight way


@ti.func
def least_distance(before, change):
    """The least distance of two places on straight ways: ``before`` from one to the other at first, and by its ``change``."""
    share = within((0.0 - dot(before, change)) / (dot(change, change) + 1e-30))
    nearest = plus(before, scaled(change, share))
    return ti.sqrt(dot(nearest, nearest))


@device_functions
class ClosestApproach:
    """The ways of rods, whose vertices are in scratch.

    A ``rod`` is a record of ``head``, the view of its vertex 0, its ``edges``, the distance ``near`` at which two of them
    touch, to within ``enough``, and the length ``least_arc`` of rod that is between any two that count, mm.
    """

    def __init__(self, number: Number, stride: int, by_frames: bool):
        self.memory, self.by_frames = Scratch(number, stride), by_frames

    @picked
    def items(self, given):
        """As :meth:`.Chain.items`."""
        return (given.edges + 1) * WAY.size

    @picked
    def vertex(self, head, v):
        return head.part(WAY, v * len(WAY))

    def work(self, tables, thread):
        """A thread's share of the rods."""
        head = self.memory.of_thread(tables.scratch, thread, WAY, self.items(tables))
        place = thread
        while place < tables.flags.shape[0]:
            row, flag = tables.rows[place, ROD], APART
            if ti.static(self.by_frames):
                if not ti.abs(self.load_frames(tables, tables.rows[place, START], row, head)) < 0.5:
                    flag = TURNED
            else:
                self.load_places(tables, tables.rows[place, START], row, head)
            radius = tables.radius[ti.min(row, tables.radius.shape[0] - 1)]
            rod = record(head=head, edges=tables.edges, near=tables.near[ti.min(row, tables.near.shape[0] - 1)],
                         enough=ENOUGH * radius, least_arc=LEAST_ARC * radius)
            if self.touches(rod):
                flag = TOUCHING
            tables.flags[place] = flag
            place += tables.threads

    # --- from tables into scratch ---

    def length(self, tables, start, e):
        """That of an edge."""
        return tables.lengths[ti.min(start, tables.lengths.shape[0] // tables.edges - 1) * tables.edges + e]

    def load_frames(self, tables, start, row, head):
        """The vertices of a rod that is given by frames; returns by how many turns its link changes."""
        zero = ti.cast(0.0, ti.f64)
        rod = record(old=repeated(zero, 3), new=repeated(zero, 3), arc=zero, turns=zero, last=repeated(zero, 2))
        head.before, head.after, head.arc = rod.old, rod.new, rod.arc
        for e in range(tables.edges):
            before = read(tables.before, (start * tables.edges + e) * 4, count=4)
            after = read(tables.after, (row * tables.edges + e) * 4, count=4)
            length = self.length(tables, start, e)
            rod.old, rod.new = plus(rod.old, scaled(tangent(before), length)), plus(rod.new, scaled(tangent(after), length))
            rod.arc = rod.arc + length
            vertex = self.vertex(head, e + 1)
            vertex.before, vertex.after, vertex.arc = rod.old, rod.new, rod.arc
            turned = turned_about_own_tangent(before, after)
            if e > 0:
                rod.turns = rod.turns + passed_half_turn(rod.last, turned)
            rod.last = turned
        return rod.turns

    def load_places(self, tables, start, row, head):
        """The vertices of a rod that is given by places."""
        arc = ti.cast(0.0, ti.f64)
        for v in range(tables.edges + 1):
            if v > 0:
                arc = arc + self.length(tables, start, v - 1)
            vertex, place = self.vertex(head, v), (row * (tables.edges + 1) + v) * 3
            vertex.before, vertex.after, vertex.arc = read(tables.before, place), read(tables.after, place), arc

    # --- the search ---

    def arc(self, rod, first, last):
        """The length of rod between two vertices."""
        return self.vertex(rod.head, last).arc - self.vertex(rod.head, first).arc

    def apart(self, rod, first, last, share):
        """From one vertex to another when both have gone that ``share`` of their ways."""
        old = minus(self.vertex(rod.head, last).before, self.vertex(rod.head, first).before)
        return plus(old, scaled(self.moved(rod, first, last), share))

    def moved(self, rod, first, last):
        """The displacement of a vertex against another."""
        one, other = self.vertex(rod.head, first), self.vertex(rod.head, last)
        return minus(minus(other.after, other.before), minus(one.after, one.before))

    def touches(self, rod):
        """Whether any two edges touch on their way, or are not finite."""
        longest = ti.cast(0.0, ti.f64)
        for e in range(rod.edges):
            longest = ti.max(longest, self.arc(rod, e, e + 1))
        touching, i = False, 0
        while i < rod.edges - 2 and not touching:
            j = i + 2
            while j < rod.edges and not touching:
                ahead = 1
                if self.arc(rod, i + 1, j) > rod.least_arc:
                    # By how much the middles of two edges stay too far apart on the way for the edges to touch.
                    before = scaled(plus(self.apart(rod, i, j, 0.0), self.apart(rod, i + 1, j + 1, 0.0)), 0.5)
                    change = scaled(plus(self.moved(rod, i, j), self.moved(rod, i + 1, j + 1)), 0.5)
                    halves = 0.5 * (self.arc(rod, i, i + 1) + self.arc(rod, j, j + 1))
                    room = least_distance(before, change) - halves - rod.near
                    if room > 0.0:
                        # A place further along the rod is nearer by no more than it is further along.
                        ahead += ti.cast(ti.min(room / longest, 1e6), ti.i32)
                    else:
                        touching = self.edges_touch(rod, i, j)
                j += ahead
            i += 1
        return touching

    def edges_touch(self, rod, i, j):
        """Whether edges i and j touch on their way, or are not finite."""
        fastest = ti.cast(0.0, ti.f64)
        for a in ti.static(range(2)):
            for b in ti.static(range(2)):
                change = self.moved(rod, i + a, j + b)
                fastest = ti.max(fastest, ti.sqrt(dot(change, change)))
        share, touching = ti.cast(0.0, ti.f64), False
        while share < 1.0 and not touching:
            w, p, q = self.apart(rod, i, j, share), self.apart(rod, i, i + 1, share), self.apart(rod, j, j + 1, share)
            found = nearest_places(w, p, q, 0.0 * share)
            across = plus(minus(w, scaled(p, found.s)), scaled(q, found.t))
            room = ti.sqrt(dot(across, across)) - rod.near
            if room > rod.enough:
                share += room / (fastest + 1e-30)
            else:
                # Edges shorten on the way where they turn far. Enough of the rod has to be between two that touch.
                missing, change = self.missing_arc(rod, i + 1, j, share)
                touching = not missing > rod.enough
                share += missing / (change + 1e-30)
        return touching

    def missing_arc(self, rod, first, last, share):
        """How much too little of the rod is between two vertices at that ``share`` of the way; by how much it may change."""
        missing, most = rod.least_arc, ti.cast(0.0, ti.f64)
        for e in range(first, last):
            edge, change = self.apart(rod, e, e + 1, share), self.moved(rod, e, e + 1)
            missing, most = missing - ti.sqrt(dot(edge, edge)), most + ti.sqrt(dot(change, change))
        return missing, most


ARGUMENTS = {
    "before": TABLE1,  # [start · edge · 4] frames, or [rod · vertex · 3] mm before
    "after": TABLE1,  # [rod · edge · 4] or [rod · vertex · 3]
    "rows": INDEX2,  # [place, (START, ROD)]: START is also that of lengths that differ
    "lengths": TABLE1,  # [1 or row · edge] mm
    "radius": TABLE1, "near": TABLE1,  # [1 or rod] mm, and the distance at which two places touch
    "edges": ti.i32, "threads": ti.i32, "scratch": SCRATCH,
    "flags": INDEX1,  # [place] out, APART, TOUCHING or TURNED
}


@cache
def _kernel(number: Number, stride: int, block: int, by_frames: bool):
    """As :func:`.newton_kernel`, of rods that are given by frames, or by places."""
    return loop_kernel("approach", number, ARGUMENTS, ClosestApproach(number, stride, by_frames), block)


def _approach(by_frames: bool, before, after, rows, rest_length, radius, more) -> np.ndarray:
    """(N,) APART, TOUCHING or TURNED, of the N rods of ``rows``, that touch where they come nearer to themselves than two radii
    and ``more``."""
    flags = np.zeros(len(rows), dtype=np.int32)
    launch(layout_for(len(rows), 64, width=1), partial(_kernel, by_frames=by_frames), before=before.reshape(-1),
           after=after.reshape(-1), rows=rows, lengths=rest_length.reshape(-1), radius=radius, near=2.0 * radius + more,
           edges=rest_length.shape[1], flags=flags)
    return flags


def stays_in_order(table: Tables, results: np.ndarray) -> np.ndarray:
    """(R,) rods whose edges all point along the line through their ends from the start to the end of their relaxation, at both
    so much that on the straight way between two places are as far apart along the line as the smallest cosine times the arc
    between them, or more. No step leads from one such shape to another through itself."""
    lengths, radius, index = table.rest_length, table.contact.radius, table.configuration_index
    shortest, longest, total = lengths.min(axis=1), lengths.max(axis=1), lengths.sum(axis=1)
    if len(lengths) > 1:
        shortest, longest, total = shortest[index], longest[index], total[index]
    # Between two edges that count lie whole edges: the fewest that are longer than LEAST_ARC.
    fewest = np.floor(LEAST_ARC * radius / longest) + 1.0
    between = np.maximum(LEAST_ARC * radius, fewest * shortest)
    least = ((2.0 + ENOUGH) * radius + ROUNDING * total) / between
    return results[:, of.ALONG] > least


@runtime.exclusive
def approach_in_relaxation(start: np.ndarray, frames: np.ndarray, rest_length: np.ndarray, radius: np.ndarray,
                           rods: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which of the rows ``rods`` (N,) may touch themselves between their ``start`` (N, E, 4), unit quaternions held by the
    clamps, and their ``frames`` (R, E, 4), also those whose frames are not finite; and which others have turned by whole turns,
    which only rods with an end that may turn do without passing through themselves. rest_length (1 or N, E) mm."""
    if not len(rods):
        return rods, rods
    rows = np.stack([np.arange(len(rods)), rods], axis=1).astype(np.int32)
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
    before, after = np.ascontiguousarray(before), np.ascontiguousarray(after)
    more = BENT * np.sqrt(((after - before) ** 2).sum(axis=-1).max(axis=1))
    flags = _approach(False, before, after, rows, rest_length, radius, more)
    return (flags == TOUCHING) & np.isfinite(after[:, 0, 0]) & np.isfinite(before[:, 0, 0])
