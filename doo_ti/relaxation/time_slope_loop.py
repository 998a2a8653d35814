"""Time steps with their derivatives: the loop of :mod:`.time_loop`, in which the lanes of a pack make their steps together."""

import taichi as ti

from doo_ti.physics.view import exact
from doo_ti.relaxation import tables as of
from doo_ti.relaxation.loading import load_stiffness
from doo_ti.relaxation.time_loop import TimeLoop
from doo_ti.relaxation.time_slopes import NUMBERS, REMEMBERED


@ti.data_oriented
class TimeSlopeLoop(TimeLoop):
    """The loop with derivatives by P parameters. ``tables`` holds, besides, blocks, the view of this thread's in scratch, and

    material_slopes, number_slopes, share_slopes  (P · material, -), (P, numbers, V, NUMBERS) and (P, numbers, 2) derivatives of
                                                  what a rod is given
    slopes                                        (row, P, V, REMEMBERED) those that it remembers, in and out
    position_slopes                               (rod · frame, P, V, 3) those of positions, out

    A parameter costs the same for one lane as for all: lanes that have converged wait for the others of their pack.
    """

    differentiates = True

    @ti.func
    def exchanges(self, lane):
        """Once all lanes with a rod have finished."""
        return self.largest(lane.active * (1.0 - lane.finished)) < 0.5

    @ti.func
    def advance(self, tables, head, lane):
        """A trip, in which lanes that wait keep their frames and repeat the elimination."""
        zero, one = self.constant(0.0), self.constant(1.0)
        waits = lane.finished > 0.5
        lane.trying = ti.select(waits, zero, lane.trying)
        lane.closing = ti.select(waits, zero, lane.closing)
        lane.escaping = ti.select(waits, zero, lane.escaping)
        lane.step_scale = ti.select(waits, zero, lane.step_scale)
        waited = ti.select(waits, one, zero)
        status, trips = lane.status + zero, lane.trips + zero
        self.trip(tables, head, lane)
        self.refuse(head, lane)
        lane.finished = ti.max(lane.finished, waited)
        lane.status = ti.select(waited > 0.5, status, lane.status)
        lane.trips = ti.select(waited > 0.5, trips, lane.trips)

    @ti.func
    def differentiate(self, tables, rod, time, up, done):
        """The derivatives of the steps that have converged, in the lanes where ``done`` is one."""
        if self.largest(done) > 0.5:
            self.sweep.differentiate(rod, tables.blocks, tables.number_slopes.shape[0], time, up)

    @ti.func
    def own_block(self, tables, slot, parameter, vertex):
        """The view of the block of a vertex for a parameter, in a lane."""
        return self.sweep.block(tables.blocks.lane(slot), tables.rest_length.shape[1], parameter, vertex)

    @ti.func
    def load_slopes(self, tables, head, slot, rod):
        """The derivatives that rod ``rod`` remembers, and its parameters, into lane ``slot``."""
        row, g, numbers = tables.rods[rod, of.RESULT_ROW], tables.rods[rod, of.MATERIAL_ROW], tables.rods[rod, of.EXTERNAL_ROW]
        own = head.lane(slot)
        unit, length_unit = exact(own.energy_unit), exact(own.length_unit)
        lengths = ti.min(tables.rods[rod, of.CLAMP_ROW], tables.rest_length.shape[0] - 1)
        for p in range(tables.number_slopes.shape[0]):
            material = p * tables.material.shape[0] + g
            for v in range(tables.rest_length.shape[1] + 1):
                block = self.own_block(tables, slot, p, v)
                for k in range(REMEMBERED):
                    block[k] = tables.slopes[row, p, v, k]
                for k in range(NUMBERS):
                    block[REMEMBERED + k] = tables.number_slopes[p, numbers, v, k] / unit
                if v > 0:
                    load_stiffness(block, tables.material_slopes, material, tables.rest_length, lengths, v - 1,
                                   1.0 / (unit * length_unit))
            first = self.own_block(tables, slot, p, 0)
            for k in ti.static(range(2)):
                first.of_rod[k] = tables.share_slopes[p, numbers, k]
            first.of_rod[2] = tables.material_slopes[material, of.WEIGHT]

    @ti.func
    def store_slopes(self, tables, slot, row):
        """The derivatives that the lane's rod remembers into row ``row``."""
        for p in range(tables.number_slopes.shape[0]):
            for v in range(tables.rest_length.shape[1] + 1):
                block = self.own_block(tables, slot, p, v)
                for k in range(REMEMBERED):
                    tables.slopes[row, p, v, k] = block[k]

    @ti.func
    def write_slopes(self, tables, slot, place):
        """The derivatives of the lane's positions, for row ``place`` of the positions."""
        for p in range(tables.number_slopes.shape[0]):
            for v in range(tables.rest_length.shape[1] + 1):
                block = self.own_block(tables, slot, p, v)
                for k in ti.static(range(3)):
                    tables.position_slopes[place, p, v, k] = block[k]
