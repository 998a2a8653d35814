"""A rod in motion into one lane of a pack in scratch, with its clamps at an instant, and out of it (docs/dynamics.md)."""

import taichi as ti

from doo_ti.physics.quaternion import partway, tangent, transported
from doo_ti.physics.tuples import dot, minus, plus, repeated, scaled, variable
from doo_ti.physics.view import exact, read, write
from doo_ti.relaxation import tables as of
from doo_ti.relaxation.time_layout import INERTIA, SPRING_POINT, VERTEX_ITEMS
from doo_ti.relaxation.time_reach import ReachLoading
from doo_ti.relaxation.time_sweep import TimeSweep

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
        self.joints_rest, self.moving_vertex = sweep.joints_rest, sweep.moving_vertex

    @ti.func
    def load_motion(self, tables, head, slot, rod):
        """Load the state of rod ``rod`` at its last two instants, its mass, drag and springs into lane ``slot``."""
        row, numbers = tables.rods[rod, of.RESULT_ROW], tables.rods[rod, of.EXTERNAL_ROW]
        own = head.lane(slot)
        if ti.static(self.joints_rest):
            own.bend_share, own.twist_share = tables.shares[numbers, 0], tables.shares[numbers, 1]
        unit = exact(own.energy_unit)
        inertia = ti.cast(0.0, ti.f64)
        for v in range(tables.rest_length.shape[1] + 1):
            self.load_vertex(tables, self.moving_vertex(own, v), row, numbers, v, 1.0 / unit)
            inertia += tables.numbers[numbers, v, 0] / unit
        own.inertia = inertia
        if ti.static(self.touches):
            length_unit = exact(own.length_unit)
            share = inertia * length_unit * length_unit / (tables.rest_length.shape[1] + 1)
            self.contacts.load_motion(tables, slot, row, length_unit, share)
            if ti.static(self.moves):
                self.first_poses(tables, slot, row, length_unit)
        edges = tables.rest_length.shape[1]
        for e in range(edges):
            motion, place = self.edge(own, e).motion, (row * edges + e) * 4
            motion.frame_1 = read(tables.frames, place, count=4)
            motion.frame_2 = read(tables.frames_before, place, count=4)
        if ti.static(self.touches):
            own.euler = 0.0
        self.load_last_reach(tables, own, tables.rods[rod, of.CLAMP_ROW])

    @ti.func
    def load_vertex(self, tables, vertex, row, numbers, v, scale):
        """Vertex ``v`` into its view in a lane, energies times ``scale``."""
        for k in range(INERTIA):
            vertex[k] = tables.places[row, v, k]
        for k in range(VERTEX_ITEMS - INERTIA):
            factor = ti.select(k < SPRING_POINT - INERTIA, scale, 1.0)
            vertex[INERTIA + k] = tables.numbers[numbers, v, k] * factor

    @ti.func
    def load_path(self, tables, head, slot, rod, step):
        """Load the clamps of step ``step``, and the obstacles that move, into lane ``slot``; of the end frames what they hold.
        Returns how they reach (:meth:`load_reach`)."""
        s = tables.rods[rod, of.CLAMP_ROW]
        own, edges = head.lane(slot), tables.rest_length.shape[1]
        unit = exact(own.length_unit)
        share = self.share_of_way(tables, slot)
        anchor = variable(read(tables.path, s, step, PATH_ANCHOR))
        line = variable(read(tables.path, s, step, PATH_TARGET))
        if share < 1.0:
            # From where the clamps were at the last instant; a free vertex 0 is measured from a fixed place.
            start = exact(own.vertex.place_1)
            end = variable(exact(self.edge(own, edges - 1).motion.place_1))
            end = plus(end, scaled(minus(plus(anchor, line), end), share))
            anchor = plus(anchor, scaled(minus(start, anchor), (1.0 - share) * (1.0 - tables.clamp[s, of.LOOSE])))
            line = minus(end, anchor)
        own.anchor = scaled(anchor, 1.0 / unit)
        own.target = scaled(line, 1.0 / unit)
        first = self.load_path_end(tables, s, step, share, 0, self.edge(own, 0))
        last = self.load_path_end(tables, s, step, share, 1, self.edge(own, edges - 1))
        if ti.static(self.touches):
            still = tables.path[s, step, PATH_STILL]
            if ti.static(self.moves):
                row = tables.rods[rod, of.RESULT_ROW]
                self.next_poses(tables, slot, row, step, share, unit)
                still *= self.rest_of_poses(tables, row, step)
            own.still = still
        return self.load_reach(tables, own, slot, s, line, first, last)

    @ti.func
    def share_of_way(self, tables, slot):
        """Of the clamps' way that is left to the next instant, the share that the rod in lane ``slot`` makes at once."""
        share = ti.cast(1.0, ti.f64)
        if ti.static(self.touches):
            own = tables.contacts.lane(slot)
            made = exact(own.way_made)
            share = ti.min(share, own.way / ti.max(1.0 - made, 1e-9))
        return share

    @ti.func
    def load_path_end(self, tables, s, step, share, end: ti.template(), edge):
        """The frame of an end ``edge`` after that share of its way; returns its tangent, zero where it is not held."""
        along = variable(repeated(ti.cast(0.0, ti.f64), 3))
        if tables.clamp[s, of.TILT_START + end] == 0.0:
            held = variable(read(tables.path, s, step, PATH_ENDS + 4 * end, count=4))
            along = tangent(held)
            last = exact(edge.motion.frame_1)
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
            edge.frame = held
        return along

    @ti.func
    def store_motion(self, tables, head, slot, row):
        """Store the state of the lane's rod at its last two instants in row ``row``."""
        own, edges = head.lane(slot), tables.rest_length.shape[1]
        self.store_vertices(tables.places, row, INERTIA, own, edges)
        for e in range(edges):
            motion, place = self.edge(own, e).motion, (row * edges + e) * 4
            write(tables.frames, place, values=motion.frame_1)
            write(tables.frames_before, place, values=motion.frame_2)
        if ti.static(self.moves_start):
            write(tables.results, row, of.DRIFT, values=scaled(exact(own.drift), exact(own.length_unit)))

    @ti.func
    def store_vertices(self, target: ti.template(), row, count: ti.template(), own, edges):
        """The first ``count`` items of every vertex into row ``row`` of ``target`` (-, V, count)."""
        for v in range(edges + 1):
            vertex = self.moving_vertex(own, v)
            for k in ti.static(range(count)):
                target[row, v, k] = vertex[k]
