"""Steps of BDF2 in which a rod meets something are made once more as steps of backward Euler (docs/dynamics.md).

BDF2 draws a parabola through three instants. Where an impact changes a velocity at once that parabola leaves the obstacle, and
the rod would bounce with more energy than it came with. A step of backward Euler takes what it hits to rest.
"""

import taichi as ti

from doo_ti.physics import pair
from doo_ti.physics.number import device_functions
from doo_ti.physics.quaternion import tangent
from doo_ti.physics.tuples import add, dot, minus, plus, record, scaled, variable
from doo_ti.relaxation.time_sweep import TimeSweep

LEAVING = 5.0  # tolerances of a gap: a vertex that an obstacle pushes may leave it in a step by no more
IMPACT = 1e-3  # of the kinetic energy, and more than open gaps make of the weight: a larger rise of the energy means an impact
SLIGHT = {32: 1e-5, 64: 1e-12}
"""By bits, of the kinetic energy and of the rod's weight times its radius: what counts as no rise."""


@device_functions
class TimeImpact(TimeSweep):
    """The chain in motion among obstacles."""

    def impact(self, rod, time, up):
        """A record about the step that was made: ``bounces``, the lanes in which it is one of BDF2 that would throw the rod off
        what it touches or, where neither grippers nor obstacles move, raises its energy by more than a little; and ``kept``,
        the share of their speed that vertices keep, so that no other step raises it either."""
        one = 0.0 * rod.total + 1.0
        rise = self.rise(rod, time, up)
        weight = 2.0 * ti.sqrt(dot(rod.gravity, rod.gravity)) * rod.total
        slight = ti.static(SLIGHT[self.number.bits]) * (rise.slow + rise.fast + weight * rod.contacts.radius)
        still = (rod.head.unmoved > 0.5) & (rise.mass > 0.0)
        raised = still & (rise.energy > slight)
        impact = still & (rise.energy > IMPACT * (rise.slow + rise.fast) + weight * rod.contacts.tolerance)
        kept = ti.sqrt(ti.max(rise.fast - rise.energy, 0.0 * one) / ti.max(rise.fast, 1e-30 * one))
        bounces = (impact | (self.leaves(rod, time) & (rise.mass > 0.0))) & (time.rate > 1.0)
        return record(bounces=bounces, kept=ti.select(raised, kept, one))

    def leaves(self, rod, time):
        """The lanes in which an obstacle pushes a vertex, or a place between two, that leaves it at the end of the step."""
        zero = 0.0 * rod.total
        most = zero
        last = variable((zero, zero, zero))
        for v in range(rod.edges + 1):
            at = self.contacts.vertex(rod, v)
            vertex, way_made = self.moving_vertex(rod.head, v), self.contacts.moved(rod, at)
            # By how much the way differs from that in the step before.
            change = minus(way_made, scaled(minus(vertex.place_1, vertex.place_2), 1.0 / rod.length_unit))
            bent = scaled(change, time.rate - 1.0)
            for o in range(rod.obstacles):
                contact = self.contacts.contact(at, o)
                force, between = contact.force, contact.force_between
                if self.contacts.some((force > 0.0) | (between > 0.0), zero):
                    way = variable(plus(self.contacts.slid(rod, at, o), bent))
                    away = dot(way, contact.normal)
                    most = ti.select(force > 0.0, ti.max(most, away), most)
                    if v > 0:
                        s = contact.place_between
                        before = plus(self.contacts.slid(rod, self.contacts.vertex(rod, v - 1), o), last)
                        amid = plus(scaled(before, 1.0 - s), scaled(way, s))
                        away = dot(amid, contact.normal_between)
                        most = ti.select(between > 0.0, ti.max(most, away), most)
            last = bent
        return most > LEAVING * rod.contacts.tolerance

    # --- the energy ---

    def rise(self, rod, time, up):
        """A record: by how much the step raises the rod's ``energy``, that of its springs included, its kinetic energy before,
        ``slow``, and after, ``fast``, and its ``mass``."""
        zero = 0.0 * rod.total
        found = record(energy=zero, slow=zero, fast=zero, mass=zero)
        place = variable(plus(rod.anchor, rod.head.drift))
        before = zero
        for e in range(rod.edges):
            edge = self.edge(rod.head, e)
            length = edge.length
            self.add_vertex(rod, e, place, before + length, time, up, found)
            if e > 0:
                previous = self.edge(rod.head, e - 1)
                stiffness = self.own_stiffness(rod, previous, edge)
                found.energy = found.energy + self.joint_energy(previous.frame, edge.frame, stiffness)
                found.energy = found.energy - self.joint_energy(previous.motion.frame_1, edge.motion.frame_1, stiffness)
            place = plus(place, scaled(tangent(edge.frame), length))
            before = length
        self.add_vertex(rod, rod.edges, place, before, time, up, found)
        return found

    def add_vertex(self, rod, v, place, length, time, up, found):
        """The part of vertex ``v`` at ``place``, whose edges have that ``length``."""
        vertex = self.moving_vertex(rod.head, v)
        x, last = scaled(place, rod.length_unit), vertex.place_1
        moved = variable(minus(x, last))
        found.energy = found.energy + length * dot(rod.gravity, scaled(moved, 1.0 / rod.length_unit))
        found.energy = found.energy + vertex.load * dot(up, moved)
        found.energy = found.energy - dot(vertex.force, moved)
        middle = minus(scaled(plus(x, last), 0.5), vertex.spring_point)
        found.energy = found.energy + vertex.spring * dot(middle, moved)
        mass = vertex.inertia * time.interval * time.interval
        old, new = vertex.velocity_1, self.end_velocity(vertex, x, time)
        slow, fast = 0.5 * mass * dot(old, old), 0.5 * mass * dot(new, new)
        add(found, energy=fast - slow, slow=slow, fast=fast, mass=mass)

    def joint_energy(self, left, right, stiffness):
        """Of the joint between two frames."""
        x, y, inverse, turn, r = pair.curvature(left, right)
        return self.energy_of(((x[0], x[1]), (y[0], y[1]), inverse, self.twist_angle(r), turn), stiffness)

    def own_stiffness(self, rod, previous, edge):
        """The stiffness of that joint, and its rest curvature, without damping."""
        if ti.static(self.isotropic):
            return self.stiffness(previous, edge, rod.stiffness)
        else:
            bend, twist = 1.0 - rod.head.bend_share, 1.0 - rod.head.twist_share
            given = self.stiffness(previous, edge, (bend, twist))
            rest = scaled(edge.rest, 1.0 / bend)
            return (given[0], given[1], given[2], given[3], rest, rest, 0.0 * bend)

    # --- damping in a step of backward Euler ---

    def prepare(self, rod, time, up, done):
        if ti.static(self.joints_rest):
            rod.head.stiffness = self.stiffness_shares(rod, time)
        TimeSweep.prepare(self, rod, time, up, done)

    def stiffness(self, left, right, material):
        """As :meth:`.Chain.stiffness`; that of damped rods times ``material``, of bending and of twist."""
        given = TimeSweep.stiffness(self, left, right, material)
        if ti.static(self.joints_rest):
            return (scaled(given[0], material[0]), scaled(given[1], material[0]), given[2], given[3] * material[1]) + given[4:]
        else:
            return given
