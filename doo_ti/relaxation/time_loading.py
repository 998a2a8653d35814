"""A rod in motion into one lane of a pack in scratch, with its clamps at an instant, and out of it (docs/dynamics.md)."""

import taichi as ti

from doo_ti.physics.quaternion import partway, tangent, transported
from doo_ti.physics.tuples import dot, minus, plus, repeated, scaled, variable
from doo_ti.relaxation import chain
from doo_ti.relaxation import tables as of
from doo_ti.relaxation.contact_layout import WAY, WAY_MADE
from doo_ti.relaxation.time_reach import ReachLoading
from doo_ti.relaxation.time_sweep import (
    FRAME_1,
    FRAME_2,
    INERTIA,
    OF_BEND_SHARE,
    OF_EULER,
    OF_INERTIA,
    OF_STILL,
    OF_VERTEX,
    PLACE_1,
    SPRING_POINT,
    VERTEX_ITEMS,
    TimeSweep,
)

# Columns of the clamps at an instant: the point the chain hangs from, the far point from there, mm, the first and last frame,
# and one where all that is as it was at the instant before.
PATH_ANCHOR, PATH_TARGET, PATH_ENDS, PATH_STILL, PATH_COLUMNS = 0, 3, 6, 14, 15


@ti.data_oriented
class MotionLoading(ReachLoading):
    """Loading and storing of a rod's state at its last two instants, in addition to what :class:`.Loading` does for any rod.

    ``tables`` holds, besides, places (rod, V, INERTIA): positions and velocities at the last two instants; frames and
    frames_before [rod · edge · 4]; numbers (row, V, VERTEX_ITEMS − INERTIA); shares (row, 2); path (clamps, step,
    PATH_COLUMNS).
    """

    def __init__(self, sweep: TimeSweep):
        super().__init__(sweep)
        self.damped = sweep.damped

    @ti.func
    def load_motion(self, tables, scratch: ti.template(), head, slot, rod):
        """Load the state of rod ``rod`` at its last two instants, its mass, drag and springs into lane ``slot``."""
        row, numbers = tables.rods[rod, of.RESULT_ROW], tables.rods[rod, of.EXTERNAL_ROW]
        own = head + self.time_parameters * self.stride
        if ti.static(self.damped):
            for k in ti.static(range(2)):
                self.put(scratch, own + (OF_BEND_SHARE + k) * self.stride, slot, tables.shares[numbers, k])
        unit = ti.cast(self.get(scratch, head + chain.OF_ENERGY_UNIT * self.stride, slot), ti.f64)
        self.load_vertex(tables, scratch, own + OF_VERTEX * self.stride, slot, row, numbers, 0, 1.0 / unit)
        inertia = ti.cast(0.0, ti.f64)
        for vertex in range(tables.rest_length.shape[1] + 1):
            inertia += tables.numbers[numbers, vertex, 0] / unit
        self.put(scratch, own + OF_INERTIA * self.stride, slot, inertia)
        if ti.static(self.touches):
            length_unit = ti.cast(self.get(scratch, head + chain.OF_LENGTH_UNIT * self.stride, slot), ti.f64)
            share = inertia * length_unit * length_unit / (tables.rest_length.shape[1] + 1)
            self.contacts.load_motion(tables, scratch, slot, row, length_unit, share)
            if ti.static(self.moves):
                self.first_poses(tables, scratch, slot, row, length_unit)
        at = head + (self.parameters + self.motion) * self.stride
        edges = tables.rest_length.shape[1]
        for e in range(edges):
            self.load_vertex(tables, scratch, at, slot, row, numbers, e + 1, 1.0 / unit)
            place = (row * edges + e) * 4
            self.put_items(scratch, at + FRAME_1 * self.stride, slot, self.frame_from(tables.frames, place))
            self.put_items(scratch, at + FRAME_2 * self.stride, slot, self.frame_from(tables.frames_before, place))
            at += self.edge_stride
        if ti.static(self.touches):
            self.put(scratch, own + OF_EULER * self.stride, slot, 0.0)
        self.load_last_reach(tables, scratch, head, slot, tables.rods[rod, of.CLAMP_ROW])

    @ti.func
    def load_vertex(self, tables, scratch: ti.template(), at, slot, row, numbers, vertex, scale):
        """A vertex's items, energies times ``scale``."""
        for k in range(INERTIA):
            self.put(scratch, at + k * self.stride, slot, tables.places[row, vertex, k])
        for k in range(VERTEX_ITEMS - INERTIA):
            factor = ti.select(k < SPRING_POINT - INERTIA, scale, 1.0)
            self.put(scratch, at + (INERTIA + k) * self.stride, slot, tables.numbers[numbers, vertex, k] * factor)

    @ti.func
    def load_path(self, tables, scratch: ti.template(), head, slot, rod, step):
        """Load the clamps of step ``step``, and the obstacles that move, into lane ``slot``; of the end frames what they hold.
        Returns how they reach (:meth:`load_reach`)."""
        s = tables.rods[rod, of.CLAMP_ROW]
        unit = ti.cast(self.get(scratch, head + chain.OF_LENGTH_UNIT * self.stride, slot), ti.f64)
        origin, edges = head + self.parameters * self.stride, tables.rest_length.shape[1]
        share = self.share_of_way(tables, scratch, slot)
        anchor = variable([tables.path[s, step, PATH_ANCHOR + k] for k in ti.static(range(3))])
        line = variable([tables.path[s, step, PATH_TARGET + k] for k in ti.static(range(3))])
        if share < 1.0:
            # From where the clamps were at the last instant; a free vertex 0 is measured from a fixed place.
            first = head + (self.time_parameters + OF_VERTEX + PLACE_1) * self.stride
            start = self.lane_place(scratch, first, slot)
            last = origin + (edges - 1) * self.edge_stride + (self.motion + PLACE_1) * self.stride
            end = variable(self.lane_place(scratch, last, slot))
            end = plus(end, scaled(minus(plus(anchor, line), end), share))
            anchor = plus(anchor, scaled(minus(start, anchor), (1.0 - share) * (1.0 - tables.clamp[s, of.LOOSE])))
            line = minus(end, anchor)
        self.put_items(scratch, head + chain.OF_ANCHOR * self.stride, slot, scaled(anchor, 1.0 / unit))
        self.put_items(scratch, head + chain.OF_TARGET * self.stride, slot, scaled(line, 1.0 / unit))
        first = self.load_path_end(tables, s, step, share, 0, scratch, origin, slot)
        last = self.load_path_end(tables, s, step, share, 1, scratch, origin + (edges - 1) * self.edge_stride, slot)
        if ti.static(self.touches):
            still = tables.path[s, step, PATH_STILL]
            if ti.static(self.moves):
                row = tables.rods[rod, of.RESULT_ROW]
                self.next_poses(tables, scratch, slot, row, step, share, unit)
                still *= self.rest_of_poses(tables, row, step)
            self.put(scratch, head + (self.time_parameters + OF_STILL) * self.stride, slot, still)
        return self.load_reach(tables, scratch, head, slot, s, line, first, last)

    @ti.func
    def share_of_way(self, tables, scratch: ti.template(), slot):
        """Of the clamps' way that is left to the next instant, the share that the rod in lane ``slot`` makes at once."""
        share = ti.cast(1.0, ti.f64)
        if ti.static(self.touches):
            made = ti.cast(self.get(scratch, tables.contacts + WAY_MADE * self.stride, slot), ti.f64)
            share = ti.min(share, self.get(scratch, tables.contacts + WAY * self.stride, slot) / ti.max(1.0 - made, 1e-9))
        return share

    @ti.func
    def load_path_end(self, tables, s, step, share, end: ti.template(), scratch: ti.template(), at, slot):
        """The frame of an end edge, whose items begin at ``at``, after that share of its way; returns its tangent, zero where
        it is not held."""
        along = variable(repeated(ti.cast(0.0, ti.f64), 3))
        if tables.clamp[s, of.TILT_START + end] == 0.0:
            column = ti.static(PATH_ENDS + 4 * end)
            held = variable((tables.path[s, step, column], tables.path[s, step, column + 1],
                             tables.path[s, step, column + 2], tables.path[s, step, column + 3]))
            along = tangent(held)
            last = self.lane_frame(scratch, at + (self.motion + FRAME_1) * self.stride, slot)
            if tables.clamp[s, of.SPIN_START + end] > 0.0:
                # A tangent alone: the frame goes with it, by parallel transport from where it was.
                old, new = tangent(last), tangent(held)
                if 1.0 + dot(old, new) > 1e-14:
                    held = transported(last, old, new)
                else:
                    held = last
            if share < 1.0:
                held = partway(last, held, share)
                along = tangent(held)
            self.put_items(scratch, at, slot, held)
        return along

    @ti.func
    def store_motion(self, tables, scratch: ti.template(), head, slot, row):
        """Store the state of the lane's rod at its last two instants in row ``row``."""
        edges = tables.rest_length.shape[1]
        self.store_vertices(tables.places, row, INERTIA, scratch, head, slot, edges)
        at = head + (self.parameters + self.motion) * self.stride
        for e in range(edges):
            for k in ti.static(range(4)):
                place = (row * edges + e) * 4 + k
                tables.frames[place] = self.get(scratch, at + (FRAME_1 + k) * self.stride, slot)
                tables.frames_before[place] = self.get(scratch, at + (FRAME_2 + k) * self.stride, slot)
            at += self.edge_stride
        if ti.static(self.moves_start):
            unit = ti.cast(self.get(scratch, head + chain.OF_LENGTH_UNIT * self.stride, slot), ti.f64)
            for k in ti.static(range(3)):
                tables.results[row, of.DRIFT + k] = unit * self.get(scratch, head + (chain.OF_DRIFT + k) * self.stride, slot)

    @ti.func
    def store_vertices(self, target: ti.template(), row, count: ti.template(), scratch: ti.template(), head, slot, edges):
        """The first ``count`` items of every vertex into row ``row`` of ``target`` (-, V, count)."""
        own = head + (self.time_parameters + OF_VERTEX) * self.stride
        for k in ti.static(range(count)):
            target[row, 0, k] = self.get(scratch, own + k * self.stride, slot)
        at = head + (self.parameters + self.motion) * self.stride
        for e in range(edges):
            for k in ti.static(range(count)):
                target[row, e + 1, k] = self.get(scratch, at + k * self.stride, slot)
            at += self.edge_stride
