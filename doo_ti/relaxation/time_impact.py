"""Steps of BDF2 in which a rod meets something are made once more as steps of backward Euler (docs/dynamics.md).

BDF2 draws a parabola through three instants. Where an impact changes a velocity at once that parabola leaves the obstacle, and
the rod would bounce with more energy than it came with. A step of backward Euler takes what it hits to rest.
"""

import taichi as ti

from doo_ti.physics import pair
from doo_ti.physics.quaternion import tangent
from doo_ti.physics.tuples import dot, minus, plus, record, scaled, variable
from doo_ti.relaxation.chain import FRAME, LENGTH, OF_STIFFNESS, REST
from doo_ti.relaxation.contact_layout import FORCE, FORCE_BETWEEN, NORMAL, NORMAL_BETWEEN, PLACE_BETWEEN, RADIUS, TOLERANCE
from doo_ti.relaxation.time_sweep import (
    FRAME_1,
    INERTIA,
    LOAD,
    OF_BEND_SHARE,
    OF_EULER,
    OF_STILL,
    OF_TWIST_SHARE,
    OF_VERTEX,
    PLACE_1,
    PLACE_2,
    SPRING,
    SPRING_POINT,
    VELOCITY_1,
    TimeSweep,
)

LEAVING = 5.0
"""Tolerances of a gap: a vertex that an obstacle pushes may leave it in a step by no more."""
IMPACT = 1e-3
"""Of the kinetic energy, and more than open gaps make of the weight: a larger rise of the energy means an impact."""
SLIGHT = {32: 1e-5, 64: 1e-12}
"""By bits, of the kinetic energy and of the rod's weight times its radius: what counts as no rise."""


@ti.data_oriented
class TimeImpact(TimeSweep):
    """The chain in motion among obstacles."""

    @ti.func
    def impact(self, rod, time, up):
        """A record about the step that was made: ``bounces``, the lanes in which it is one of BDF2 that would throw the rod off
        what it touches or, where neither grippers nor obstacles move, raises its energy by more than a little; and ``kept``,
        the share of their speed that vertices keep, so that no other step raises it either."""
        own = rod.head + self.time_parameters * self.stride
        one = 0.0 * rod.total + 1.0
        rise = self.rise(rod, time, up)
        weight = 2.0 * ti.sqrt(dot(rod.gravity, rod.gravity)) * rod.total
        slight = ti.static(SLIGHT[self.number.bits]) * (rise.slow + rise.fast + weight * self.contacts.item(rod, RADIUS))
        still = (rod.scratch[own + OF_STILL * self.stride] > 0.5) & (rise.mass > 0.0)
        raised = still & (rise.energy > slight)
        impact = still & (rise.energy > IMPACT * (rise.slow + rise.fast) + weight * self.contacts.item(rod, TOLERANCE))
        kept = ti.sqrt(ti.max(rise.fast - rise.energy, 0.0 * one) / ti.max(rise.fast, 1e-30 * one))
        bounces = (impact | (self.leaves(rod, time) & (rise.mass > 0.0))) & (time.rate > 1.0)
        return record(bounces=bounces, kept=ti.select(raised, kept, one))

    @ti.func
    def make_euler(self, rod, where):
        """Make the step once more as one of backward Euler in the lanes ``where``."""
        at = rod.head + (self.time_parameters + OF_EULER) * self.stride
        rod.scratch[at] = ti.select(where, 0.0 * rod.total + 1.0, rod.scratch[at])
        self.contacts.begin_rounds(rod, where)

    @ti.func
    def end_euler(self, rod, done):
        """Begin the next step as one like others in the lanes that are ``done``."""
        at = rod.head + (self.time_parameters + OF_EULER) * self.stride
        rod.scratch[at] = ti.select(done, 0.0 * rod.total, rod.scratch[at])

    @ti.func
    def leaves(self, rod, time):
        """The lanes in which an obstacle pushes a vertex, or a place between two, that leaves it at the end of the step."""
        zero = 0.0 * rod.total
        most = zero
        last = variable((zero, zero, zero))
        for v in range(rod.edges + 1):
            at = self.contacts.vertex(rod, v)
            bent = scaled(self.bend_of_way(rod, v), time.rate - 1.0)
            for o in range(rod.obstacles):
                contact = self.contacts.contact(at, o)
                force = rod.scratch[contact + FORCE * self.stride]
                between = rod.scratch[contact + FORCE_BETWEEN * self.stride]
                if self.contacts.some((force > 0.0) | (between > 0.0), zero):
                    way = variable(plus(self.contacts.slid(rod, at, o), bent))
                    away = dot(way, self.load3(rod.scratch, contact + NORMAL * self.stride))
                    most = ti.select(force > 0.0, ti.max(most, away), most)
                    if v > 0:
                        s = rod.scratch[contact + PLACE_BETWEEN * self.stride]
                        before = plus(self.contacts.slid(rod, self.contacts.vertex(rod, v - 1), o), last)
                        amid = plus(scaled(before, 1.0 - s), scaled(way, s))
                        away = dot(amid, self.load3(rod.scratch, contact + NORMAL_BETWEEN * self.stride))
                        most = ti.select(between > 0.0, ti.max(most, away), most)
            last = bent
        return most > LEAVING * self.contacts.item(rod, TOLERANCE)

    @ti.func
    def bend_of_way(self, rod, v):
        """By how much the way of vertex ``v`` in the step differs from that in the step before."""
        at = rod.head + (self.time_parameters + OF_VERTEX) * self.stride
        if v > 0:
            at = rod.origin + (v - 1) * self.edge_stride + self.motion * self.stride
        last, before = self.load3(rod.scratch, at + PLACE_1 * self.stride), self.load3(rod.scratch, at + PLACE_2 * self.stride)
        way = self.contacts.moved(rod, self.contacts.vertex(rod, v))
        return minus(way, scaled(minus(last, before), 1.0 / rod.length_unit))

    # --- the energy ---

    @ti.func
    def rise(self, rod, time, up):
        """A record: by how much the step raises the rod's ``energy``, that of its springs included, its kinetic energy before,
        ``slow``, and after, ``fast``, and its ``mass``."""
        zero = 0.0 * rod.total
        found = record(energy=zero, slow=zero, fast=zero, mass=zero)
        place = variable(plus(rod.anchor, self.drift(rod)))
        before = zero
        vertex = rod.head + (self.time_parameters + OF_VERTEX) * self.stride
        at = rod.origin
        for e in range(rod.edges):
            length = rod.scratch[at + LENGTH * self.stride]
            self.add_vertex(rod, vertex, place, before + length, time, up, found)
            if e > 0:
                previous, own = at - self.edge_stride, self.motion * self.stride
                stiffness = self.own_stiffness(rod, previous, at)
                found.energy = found.energy + self.joint_energy(rod, previous, at, FRAME * self.stride, stiffness)
                found.energy = found.energy - self.joint_energy(rod, previous, at, own + FRAME_1 * self.stride, stiffness)
            place = plus(place, scaled(tangent(self.load4(rod.scratch, at)), length))
            vertex = at + self.motion * self.stride
            before = length
            at += self.edge_stride
        self.add_vertex(rod, vertex, place, before, time, up, found)
        return found

    @ti.func
    def add_vertex(self, rod, at, place, length, time, up, found):
        """The part of the vertex at ``place``, whose items begin at ``at`` and whose edges have that ``length``."""
        s = self.stride
        x, last = scaled(place, rod.length_unit), self.load3(rod.scratch, at + PLACE_1 * s)
        moved = variable(minus(x, last))
        found.energy = found.energy + length * dot(rod.gravity, scaled(moved, 1.0 / rod.length_unit))
        found.energy = found.energy + rod.scratch[at + LOAD * s] * (up[0] * moved[0] + up[1] * moved[1] + up[2] * moved[2])
        middle = minus(scaled(plus(x, last), 0.5), self.load3(rod.scratch, at + SPRING_POINT * s))
        found.energy = found.energy + rod.scratch[at + SPRING * s] * dot(middle, moved)
        mass = rod.scratch[at + INERTIA * s] * time.interval * time.interval
        old, new = self.load3(rod.scratch, at + VELOCITY_1 * s), self.end_velocity(rod, at, x, time)
        slow, fast = 0.5 * mass * dot(old, old), 0.5 * mass * dot(new, new)
        found.energy = found.energy + (fast - slow)
        found.slow, found.fast = found.slow + slow, found.fast + fast
        found.mass = found.mass + mass

    @ti.func
    def joint_energy(self, rod, previous, at, frame, stiffness):
        """Of the joint between two edges whose frames are ``frame`` after their first items."""
        x, y, inverse, turn, r = pair.curvature(self.load4(rod.scratch, previous + frame), self.load4(rod.scratch, at + frame))
        return self.energy_of(((x[0], x[1]), (y[0], y[1]), inverse, self.twist_angle(r), turn), stiffness)

    @ti.func
    def own_stiffness(self, rod, previous, at):
        """The stiffness of that joint, and its rest curvature, without damping."""
        if ti.static(self.isotropic):
            return self.stiffness(rod.scratch, previous, at, rod.stiffness)
        else:
            share = rod.head + self.time_parameters * self.stride
            bend = 1.0 - rod.scratch[share + OF_BEND_SHARE * self.stride]
            twist = 1.0 - rod.scratch[share + OF_TWIST_SHARE * self.stride]
            given = self.stiffness(rod.scratch, previous, at, (bend, twist))
            rest = scaled((rod.scratch[at + REST * self.stride], rod.scratch[at + (REST + 1) * self.stride]), 1.0 / bend)
            return (given[0], given[1], given[2], given[3], rest, rest, 0.0 * bend)

    # --- damping in a step of backward Euler ---

    @ti.func
    def prepare(self, rod, time, up, done):
        if ti.static(self.damped):
            self.store(rod.scratch, rod.head + OF_STIFFNESS * self.stride, self.stiffness_shares(rod, time))
        TimeSweep.prepare(self, rod, time, up, done)

    @ti.func
    def stiffness(self, scratch: ti.template(), left, right, material):
        """As :meth:`.Chain.stiffness`; that of damped rods times ``material``, of bending and of twist."""
        given = TimeSweep.stiffness(self, scratch, left, right, material)
        if ti.static(self.damped):
            return (scaled(given[0], material[0]), scaled(given[1], material[0]), given[2], given[3] * material[1]) + given[4:]
        else:
            return given
