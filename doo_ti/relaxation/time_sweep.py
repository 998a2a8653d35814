"""A chain of frames that remembers its last two instants, and the energy whose minimum is the next (docs/dynamics.md).

With time derivatives by D u = (a/h) (u − y), y = u₁ + b (u₁ − u₂), of the values u₁ and u₂ at the last two instants, h apart
(a = 1, b = 0 for backward Euler; a = 3/2, b = 1/3 for BDF2), the equations of motion M D²x + C D x + ∇E(x) = 0 are those of a
minimum of

    E(x) + Σ_i ½ κ_i |x_i − x̂_i|² + ½ d_i |x_i − y(x_i)|²,    x̂ = y(x) + (h/a) y(v),

a spring at every vertex. Damping of bending and twisting, moments τ B Dω, likewise makes a joint stiffer, by 1 + τ a/h, and
draws it towards y(ω): a rest curvature of its own for each step.
"""

import taichi as ti

from doo_ti.physics import pair, quaternion
from doo_ti.physics.number import Layout, device_functions
from doo_ti.physics.quaternion import normalised, passed_half_turn, relative_rotation, tangent, turned_about_own_tangent
from doo_ti.physics.tuples import choose, chosen, dot, minus, plus, record, repeated, scaled, variable
from doo_ti.relaxation.contacts import RodContacts
from doo_ti.relaxation.external import PointLoads
from doo_ti.relaxation.loaded_elimination import LoadedElimination

VERTEX = Layout(place_1=3, place_2=3, velocity_1=3, velocity_2=3, inertia=1, drag=1, drag_by_speed=1, load=1, force=3, spring=1,
                spring_point=3)
"""place, velocity                at the last two instants, mm and mm/s
inertia, drag, drag_by_speed   κ, d, and its growth with speed per mm/s, energy over mm²
load, force                    the weight of a point mass there and a dead force, energy over mm
spring, spring_point           its stiffness, energy over mm², and where it pulls to"""
PLACE_2, VELOCITY_1, INERTIA, DRAG, DRAG_BY_SPEED, LOAD, FORCE, SPRING, SPRING_POINT = map(VERTEX.at, (
    "place_2", "velocity_1", "inertia", "drag", "drag_by_speed", "load", "force", "spring", "spring_point"))
VERTEX_ITEMS = len(VERTEX)
MOTION = VERTEX + Layout(frame_1=4, frame_2=4, rest_left=2, rest_right=2, rest_twist=1)
"""Of an edge, with the vertex where it ends: its frames at the last two instants; for the step being made, of the joint where
it begins, the rest curvature of its left and its right frame and its rest twist."""
ROD = Layout(bend_share=1, twist_share=1, inertia=1, relinked=1, reach=1, euler=1, unmoved=1, vertex=VERTEX)
"""bend_share, twist_share  of the rest curvature and twist, what damping makes
inertia                  the sum of κ of all vertices
relinked                 by how much the rod's link has changed
reach                    how its clamps reach (:mod:`.clamp_table`)
euler, unmoved           one where the step is one of backward Euler though others are not; where no clamp or obstacle moves
vertex                   vertex 0"""

STEP, RATE, EXTRAPOLATION, LEAST_WAY, WATCHED, TIME_COLUMNS = 0, 1, 2, 3, 4, 5
"""Of a launch: the step h in s, a and b above; the least share of the clamps' way from one instant to the next that a rod in
contact makes at once where more fails; and one where changes of link are noted."""


@device_functions
class TimeSweep(LoadedElimination):
    """The chain under the springs of a time step, whose points it sets itself, and dead forces.

    joints_rest: joints have rest curvatures and twists of their own, as damping needs; ``isotropic`` rods are undamped.
    ``contacts`` with obstacles.

    Its functions take a record ``time`` of the lanes' steps (:meth:`steps_of`).
    """

    def __init__(self, number, isotropic: bool, stride: int, contacts: RodContacts | None = None):
        super().__init__(number, isotropic, stride, PointLoads, any_ends=True, contacts=contacts)
        self.joints_rest = not isotropic
        self.edge_layout, self.rod_layout = self.edge_layout + Layout(motion=MOTION), self.rod_layout + ROD

    def moving_vertex(self, head, v):
        """The view of vertex ``v`` of the rods at ``head``: those after the first lie with the edge that ends there."""
        later = self.rod_layout.size + self.edge_layout.at("motion") + (v - 1) * self.edge_layout.size
        return head.part(VERTEX, ti.select(v > 0, later, self.rod_layout.at("vertex")))

    def steps_of(self, tables, head):
        """The record of the lanes' steps: h, ``step``, in s; a, ``rate``; b, ``extrapolation``; a over that of the launch,
        ``share``, below one where a step is one of backward Euler though others are not; h over the launch's a, ``interval``;
        and the share of their speed that vertices keep at its end, ``kept``."""
        one = 0.0 * head.closed + 1.0
        step, rate = ti.cast(tables.time[STEP], self.number.scalar), ti.cast(tables.time[RATE], self.number.scalar)
        euler = 0.0 * one
        if ti.static(self.touches):
            euler = head.euler
        own = rate * one - (rate - 1.0) * euler
        return record(kept=one, step=step * one, rate=own, share=own / rate, interval=step / rate * one,
                      extrapolation=ti.cast(tables.time[EXTRAPOLATION], self.number.scalar) * (one - euler))

    def rest(self, edge):
        """u̅ of the left frame and of the right one, and m̅."""
        return (edge.motion.rest_left, edge.motion.rest_right, edge.motion.rest_twist)

    # --- the step that was made ---

    def remember(self, rod, time, done):
        """Make the present shape the last instant, and the last instant the one before it, in the lanes that are ``done``.
        After a step of backward Euler among others the velocities and frames before it do not count any more: they are as if
        they had not changed in it."""
        place = variable(plus(rod.anchor, rod.head.drift))
        self.remember_vertex(rod, rod.head.vertex, place, time, done)
        if ti.static(self.touches):
            choose(self.contacts.vertex(rod, 0), done, previous=place)
        for e in range(rod.edges):
            edge = self.edge(rod.head, e)
            q = edge.frame
            place = plus(place, scaled(tangent(q), edge.length))
            own = edge.motion
            self.remember_vertex(rod, own, place, time, done)
            if ti.static(self.touches):
                choose(self.contacts.vertex(rod, e + 1), done, previous=place)
            choose(own, done, frame_2=chosen(time.share < 1.0, q, own.frame_1))
            choose(own, done, frame_1=q)

    def watch(self, rod):
        """Note by how many turns the rod's link has changed in the step that was made: so often the angles of the frames
        against those before it, each transported to its new tangent, go around along the rod."""
        zero = 0.0 * rod.total
        change = zero
        last = variable(repeated(zero, 2))
        for e in range(rod.edges):
            edge = self.edge(rod.head, e)
            turned = turned_about_own_tangent(edge.motion.frame_1, edge.frame)
            if e > 0:
                change = change + passed_half_turn(last, turned)
            last = turned
        rod.head.relinked = change

    def remember_vertex(self, rod, vertex, place, time, done):
        """The same for a ``vertex`` at ``place``."""
        x = scaled(place, rod.length_unit)
        new = variable(scaled(self.end_velocity(vertex, x, time), time.kept))
        choose(vertex, done, place_2=vertex.place_1)
        choose(vertex, done, place_1=x, velocity_2=chosen(time.share < 1.0, new, vertex.velocity_1))
        choose(vertex, done, velocity_1=new)

    def end_velocity(self, vertex, x, time):
        """mm/s at the end of a step that takes a ``vertex`` to ``x``, mm."""
        last, before = vertex.place_1, vertex.place_2
        # By differences, which f32 rounds less.
        change = minus(scaled(minus(x, last), time.rate), scaled(minus(last, before), time.rate - 1.0))
        return scaled(change, 1.0 / time.step)

    # --- the step to be made ---

    def prepare(self, rod, time, up, done):
        """Set the springs and rest curvatures of the next step. In the lanes that are ``done`` also set where its Newton
        iterations start: every frame turned once more as in the last step, and a free vertex 0 in free flight."""
        free_flight = self.set_spring(rod, rod.head.external, rod.head.vertex, time, up)
        drift = variable(minus(scaled(free_flight, 1.0 / rod.length_unit), rod.anchor))
        going = done & (rod.loose > 0.5)
        if ti.static(self.touches):
            # Rods that may touch something start from where they were.
            drift = minus(scaled(rod.head.vertex.place_1, 1.0 / rod.length_unit), rod.anchor)
        choose(rod.head, going, drift=drift)
        for e in range(rod.edges):
            edge = self.edge(rod.head, e)
            self.set_spring(rod, edge.external, edge.motion, time, up)
            last = edge.motion.frame_1
            q = variable(last)
            if ti.static(not self.touches):
                q = normalised(quaternion.product(last, relative_rotation(edge.motion.frame_2, last)))
            choose(edge, done, frame=q)
            if ti.static(self.joints_rest):
                if e > 0:
                    self.set_rest(rod, self.edge(rod.head, e - 1), edge, time)

    def set_spring(self, rod, external, vertex, time, up):
        """Set the spring of a step at a ``vertex``, and the force there, in ``external``; returns x̂, mm."""
        y, ahead, fast = self.extrapolated(vertex, time)
        drag = time.share * (vertex.drag + vertex.drag_by_speed * ti.sqrt(dot(fast, fast)))
        inertia, stiffness = time.share * time.share * vertex.inertia, vertex.spring
        k = inertia + drag + stiffness
        pull = variable(plus(plus(scaled(ahead, inertia), scaled(y, drag)), scaled(vertex.spring_point, stiffness)))
        if ti.static(self.touches):
            # What eases a step draws every vertex to where it was.
            viscosity = rod.contacts.viscosity
            k = k + viscosity
            pull = plus(pull, scaled(vertex.place_1, viscosity))
        external.point, external.stiffness = scaled(pull, 1.0 / (k + 1e-30)), k
        external.force = minus(vertex.force, scaled(up, vertex.load))
        return ahead

    def extrapolated(self, vertex, time):
        """(y, x̂, the velocity at the step's end) of a ``vertex``, mm and mm/s."""
        p1, p2 = vertex.place_1, vertex.place_2
        v1, v2 = vertex.velocity_1, vertex.velocity_2
        y = plus(p1, scaled(minus(p1, p2), time.extrapolation))
        w = plus(v1, scaled(minus(v1, v2), time.extrapolation))
        return y, plus(y, scaled(w, time.step / time.rate)), minus(plus(v1, v1), v2)

    def set_rest(self, rod, previous, edge, time):
        """Set u̅ and m̅ of the joint where an ``edge`` begins: the sum of the material's part and that of damping."""
        own = edge.motion
        curved = self.extrapolated_curvature(previous.motion, own, time)
        stiff, stiff_twist = self.stiffness_shares(rod, time)
        bend = time.share / stiff * rod.head.bend_share
        twist = time.share / stiff_twist * rod.head.twist_share
        rest1, rest2 = edge.rest[0] / stiff, edge.rest[1] / stiff
        own.rest_left = (rest1 + bend * curved[0], rest2 + bend * curved[1])
        own.rest_right = (rest1 + bend * curved[2], rest2 + bend * curved[3])
        own.rest_twist = twist * curved[4]

    def stiffness_shares(self, rod, time):
        """Of the stiffness of bending and of twist that the launch is given, with what damping adds in its steps, what those of
        the lanes have."""
        bend, twist = rod.head.bend_share, rod.head.twist_share
        return 1.0 - bend * (1.0 - time.share), 1.0 - twist * (1.0 - time.share)

    def extrapolated_curvature(self, previous, own, time):
        """y(ω) as the left frame sees it and the right one, and of the twist: of the joint of two edges in ``motion``."""
        last = pair.curvature(previous.frame_1, own.frame_1)
        before = pair.curvature(previous.frame_2, own.frame_2)
        m1, m2 = self.twist_angle(last[4]), self.twist_angle(before[4])
        x = plus(last[0], scaled(minus(last[0], before[0]), time.extrapolation))
        y = plus(last[1], scaled(minus(last[1], before[1]), time.extrapolation))
        return (2.0 * x[1], 0.0 - 2.0 * x[0], 2.0 * y[1], 0.0 - 2.0 * y[0], m1 + time.extrapolation * (m1 - m2))
