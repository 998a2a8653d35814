"""A chain of frames that remembers its last two instants, and the energy whose minimum is the next (docs/dynamics.md).

With time derivatives by D u = (a/h) (u − y), y = u₁ + b (u₁ − u₂), of the values u₁ and u₂ at the last two instants, h apart
(a = 1, b = 0 for backward Euler; a = 3/2, b = 1/3 for BDF2), the equations of motion M D²x + C D x + ∇E(x) = 0 are those of a
minimum of

    E(x) + Σ_i ½ κ_i |x_i − x̂_i|² + ½ d_i |x_i − y(x_i)|²,    x̂ = y(x) + (h/a) y(v),

a spring at every vertex. Damping of bending and twisting, moments τ B Dω, likewise makes a joint stiffer, by 1 + τ a/h, and
draws it towards y(ω): a rest curvature of its own for each step.
"""

import taichi as ti

from doo_ti.physics import pair
from doo_ti.physics.angle import passed_half_turn, turned_about_own_tangent
from doo_ti.physics.quaternion import normalised, product, relative_rotation, tangent
from doo_ti.physics.tuples import chosen, dot, minus, plus, record, repeated, scaled, variable
from doo_ti.relaxation.chain import FRAME, LENGTH, LOADED_PARAMETERS, OF_DRIFT, REST
from doo_ti.relaxation.contact_layout import VISCOSITY
from doo_ti.relaxation.contacts import Contacts
from doo_ti.relaxation.external import Springs
from doo_ti.relaxation.loaded_elimination import LoadedElimination

# Items of a vertex: positions and velocities at the last two instants, mm and mm/s; then, in energy over mm² but LOAD, in
# energy over mm: inertia κ, drag d, its growth with speed per mm/s, the weight of a point mass there, and a spring's stiffness
# with its point.
PLACE_1, PLACE_2, VELOCITY_1, VELOCITY_2, INERTIA, DRAG, DRAG_BY_SPEED, LOAD, SPRING, SPRING_POINT, VERTEX_ITEMS = (
    0, 3, 6, 9, 12, 13, 14, 15, 16, 17, 20)
# Items of an edge, after those of the vertex where it ends: its frames at the last two instants, and of the joint where it
# begins the rest curvature of its left and its right frame and its rest twist, for the step being made.
FRAME_1, FRAME_2, REST_LEFT, REST_RIGHT, REST_TWIST, EDGE_ITEMS = 20, 24, 28, 30, 32, 33
# Parameters of a rod: shares of the rest curvature and twist that damping makes, the sum of the inertia κ of all vertices, by
# how much its link has changed, how its clamps reach (:mod:`.clamp_table`), one where the step is one of backward Euler though
# others are not, and where neither clamps nor obstacles move in it, and the items of vertex 0.
OF_BEND_SHARE, OF_TWIST_SHARE, OF_INERTIA, OF_RELINKED, OF_REACH, OF_EULER, OF_STILL, OF_VERTEX = 0, 1, 2, 3, 4, 5, 6, 7
PARAMETERS = OF_VERTEX + VERTEX_ITEMS

# What a launch is given after the policy of Newton: the step h in s, a and b above, and the least share of the clamps' way
# from one instant to the next that a rod in contact makes at once where more fails; and one where changes of link are noted.
STEP, RATE, EXTRAPOLATION, LEAST_WAY, WATCHED, TIME_COLUMNS = 0, 1, 2, 3, 4, 5


@ti.data_oriented
class TimeSweep(LoadedElimination):
    """The chain under the springs of a time step, whose points it sets itself.

    damped: joints have rest curvatures and twists of their own; ``isotropic`` rods are undamped. ``contacts`` with obstacles.

    Its functions take a record ``time`` of the lanes' steps (:meth:`steps_of`).
    """

    def __init__(self, number, isotropic: bool, stride: int, contacts: Contacts | None = None):
        super().__init__(number, isotropic, stride, Springs, any_ends=True, contacts=contacts)
        self.damped = not isotropic
        self.springs = self.force_columns - Springs.items
        self.motion = self.items
        self.items += EDGE_ITEMS
        self.edge_stride = self.items * stride
        self.spring_start = LOADED_PARAMETERS
        self.time_parameters = self.parameters
        self.parameters += PARAMETERS

    @ti.func
    def steps_of(self, tables, scratch: ti.template(), head):
        """The record of the lanes' steps: h, ``step``, in s; a, ``rate``; b, ``extrapolation``; a over that of the launch,
        ``share``, below one where a step is one of backward Euler though others are not; h over the launch's a, ``interval``;
        and the share of their speed that vertices keep at its end, ``kept``."""
        one = 0.0 * scratch[head] + 1.0
        step, rate = ti.cast(tables.time[STEP], self.number.scalar), ti.cast(tables.time[RATE], self.number.scalar)
        euler = 0.0 * one
        if ti.static(self.touches):
            euler = scratch[head + (self.time_parameters + OF_EULER) * self.stride]
        own = rate * one - (rate - 1.0) * euler
        return record(kept=one, step=step * one, rate=own, share=own / rate, interval=step / rate * one,
                      extrapolation=ti.cast(tables.time[EXTRAPOLATION], self.number.scalar) * (one - euler))

    @ti.func
    def rest(self, scratch: ti.template(), at):
        """u̅ of the left frame and of the right one, and m̅."""
        own = at + self.motion * self.stride
        return (
            (scratch[own + REST_LEFT * self.stride], scratch[own + (REST_LEFT + 1) * self.stride]),
            (scratch[own + REST_RIGHT * self.stride], scratch[own + (REST_RIGHT + 1) * self.stride]),
            scratch[own + REST_TWIST * self.stride])

    # --- the step that was made ---

    @ti.func
    def remember(self, rod, time, done):
        """Make the present shape the last instant, and the last instant the one before it, in the lanes that are ``done``.
        After a step of backward Euler among others the velocities and frames before it do not count any more: they are as if
        they had not changed in it."""
        place = variable(plus(rod.anchor, self.drift(rod)))
        vertex = rod.head + (self.time_parameters + OF_VERTEX) * self.stride
        self.remember_vertex(rod, vertex, place, time, done)
        if ti.static(self.touches):
            self.contacts.remember(rod, 0, place, done)
        at = rod.origin
        for e in range(rod.edges):
            q = self.load4(rod.scratch, at + FRAME * self.stride)
            place = plus(place, scaled(tangent(q), rod.scratch[at + LENGTH * self.stride]))
            own = at + self.motion * self.stride
            self.remember_vertex(rod, own, place, time, done)
            if ti.static(self.touches):
                self.contacts.remember(rod, e + 1, place, done)
            last = self.load4(rod.scratch, own + FRAME_1 * self.stride)
            before = self.load4(rod.scratch, own + FRAME_2 * self.stride)
            last_but_one = chosen(time.share < 1.0, q, last)
            self.store(rod.scratch, own + FRAME_2 * self.stride, chosen(done, last_but_one, before))
            self.store(rod.scratch, own + FRAME_1 * self.stride, chosen(done, q, last))
            at += self.edge_stride

    @ti.func
    def watch(self, rod):
        """Note by how many turns the rod's link has changed in the step that was made: so often the angles of the frames
        against those before it, each transported to its new tangent, go around along the rod."""
        zero = 0.0 * rod.total
        change = zero
        last = variable(repeated(zero, 2))
        at = rod.origin
        for e in range(rod.edges):
            before = self.load4(rod.scratch, at + (self.motion + FRAME_1) * self.stride)
            turned = turned_about_own_tangent(before, self.load4(rod.scratch, at + FRAME * self.stride))
            if e > 0:
                change = change + passed_half_turn(last, turned)
            last = turned
            at += self.edge_stride
        rod.scratch[rod.head + (self.time_parameters + OF_RELINKED) * self.stride] = change

    @ti.func
    def remember_vertex(self, rod, at, place, time, done):
        """The same for the vertex at ``place``, whose items begin at ``at``."""
        x = scaled(place, rod.length_unit)
        last, before = self.load3(rod.scratch, at + PLACE_1 * self.stride), self.load3(rod.scratch, at + PLACE_2 * self.stride)
        velocity = self.load3(rod.scratch, at + VELOCITY_1 * self.stride)
        older = self.load3(rod.scratch, at + VELOCITY_2 * self.stride)
        new = variable(scaled(self.end_velocity(rod, at, x, time), time.kept))
        self.store(rod.scratch, at + PLACE_2 * self.stride, chosen(done, last, before))
        self.store(rod.scratch, at + PLACE_1 * self.stride, chosen(done, x, last))
        self.store(rod.scratch, at + VELOCITY_2 * self.stride, chosen(done, chosen(time.share < 1.0, new, velocity), older))
        self.store(rod.scratch, at + VELOCITY_1 * self.stride, chosen(done, new, velocity))

    @ti.func
    def end_velocity(self, rod, at, x, time):
        """mm/s at the end of a step that takes the vertex whose items begin at ``at`` to ``x``, mm."""
        last, before = self.load3(rod.scratch, at + PLACE_1 * self.stride), self.load3(rod.scratch, at + PLACE_2 * self.stride)
        # By differences, which f32 rounds less.
        change = minus(scaled(minus(x, last), time.rate), scaled(minus(last, before), time.rate - 1.0))
        return scaled(change, 1.0 / time.step)

    # --- the step to be made ---

    @ti.func
    def prepare(self, rod, time, up, done):
        """Set the springs and rest curvatures of the next step. In the lanes that are ``done`` also set where its Newton
        iterations start: every frame turned once more as in the last step, and a free vertex 0 in free flight."""
        vertex = rod.head + (self.time_parameters + OF_VERTEX) * self.stride
        first, first_stiffness, free_flight = self.spring(rod, vertex, time, up)
        self.store(rod.scratch, rod.head + self.spring_start * self.stride, first + (first_stiffness,))
        drift = variable(minus(scaled(free_flight, 1.0 / rod.length_unit), rod.anchor))
        going = done & (rod.loose > 0.5)
        if ti.static(self.touches):
            # Rods that may touch something start from where they were.
            drift = minus(scaled(self.load3(rod.scratch, vertex + PLACE_1 * self.stride), 1.0 / rod.length_unit), rod.anchor)
        self.store(rod.scratch, rod.head + OF_DRIFT * self.stride, chosen(going, drift, self.drift(rod)))
        at = rod.origin
        for e in range(rod.edges):
            own = at + self.motion * self.stride
            x, k, ahead = self.spring(rod, own, time, up)
            self.store(rod.scratch, at + self.springs * self.stride, x + (k,))
            last = self.load4(rod.scratch, own + FRAME_1 * self.stride)
            before = self.load4(rod.scratch, own + FRAME_2 * self.stride)
            q = variable(last)
            if ti.static(not self.touches):
                q = normalised(product(last, relative_rotation(before, last)))
            self.store(rod.scratch, at + FRAME * self.stride, chosen(done, q, self.load4(rod.scratch, at)))
            if ti.static(self.damped):
                if e > 0:
                    self.set_rest(rod, at, time)
            at += self.edge_stride

    @ti.func
    def spring(self, rod, at, time, up):
        """(point, stiffness) of the spring of a step at the vertex whose items begin at ``at``, and x̂, mm."""
        s = self.stride
        y, ahead, fast = self.extrapolated(rod, at, time)
        drag = time.share * (rod.scratch[at + DRAG * s] + rod.scratch[at + DRAG_BY_SPEED * s] * ti.sqrt(dot(fast, fast)))
        inertia, stiffness = time.share * time.share * rod.scratch[at + INERTIA * s], rod.scratch[at + SPRING * s]
        k = inertia + drag + stiffness
        pull = variable(plus(plus(scaled(ahead, inertia), scaled(y, drag)),
                             scaled(self.load3(rod.scratch, at + SPRING_POINT * s), stiffness)))
        if ti.static(self.touches):
            # What eases a step draws every vertex to where it was.
            viscosity = self.contacts.item(rod, VISCOSITY)
            k = k + viscosity
            pull = plus(pull, scaled(self.load3(rod.scratch, at + PLACE_1 * s), viscosity))
        load = rod.scratch[at + LOAD * s]
        point = scaled((pull[0] - load * up[0], pull[1] - load * up[1], pull[2] - load * up[2]), 1.0 / (k + 1e-30))
        return point, k, ahead

    @ti.func
    def extrapolated(self, rod, at, time):
        """(y, x̂, the velocity at the step's end) of the vertex whose items begin at ``at``, mm and mm/s."""
        s = self.stride
        p1, p2 = self.load3(rod.scratch, at + PLACE_1 * s), self.load3(rod.scratch, at + PLACE_2 * s)
        v1, v2 = self.load3(rod.scratch, at + VELOCITY_1 * s), self.load3(rod.scratch, at + VELOCITY_2 * s)
        y = plus(p1, scaled(minus(p1, p2), time.extrapolation))
        w = plus(v1, scaled(minus(v1, v2), time.extrapolation))
        return y, plus(y, scaled(w, time.step / time.rate)), minus(plus(v1, v1), v2)

    @ti.func
    def set_rest(self, rod, at, time):
        """Set u̅ and m̅ of the joint where the edge at ``at`` begins: the sum of the material's part and that of damping."""
        s = self.stride
        own = at + self.motion * s
        curved = self.extrapolated_curvature(rod, at, time)
        stiff, stiff_twist = self.stiffness_shares(rod, time)
        bend = time.share / stiff * rod.scratch[rod.head + (self.time_parameters + OF_BEND_SHARE) * s]
        twist = time.share / stiff_twist * rod.scratch[rod.head + (self.time_parameters + OF_TWIST_SHARE) * s]
        rest1, rest2 = rod.scratch[at + REST * s] / stiff, rod.scratch[at + (REST + 1) * s] / stiff
        self.store(rod.scratch, own + REST_LEFT * s, (rest1 + bend * curved[0], rest2 + bend * curved[1]))
        self.store(rod.scratch, own + REST_RIGHT * s, (rest1 + bend * curved[2], rest2 + bend * curved[3]))
        rod.scratch[own + REST_TWIST * s] = twist * curved[4]

    @ti.func
    def stiffness_shares(self, rod, time):
        """Of the stiffness of bending and of twist that the launch is given, with what damping adds in its steps, what those of
        the lanes have."""
        own = rod.head + self.time_parameters * self.stride
        bend, twist = rod.scratch[own + OF_BEND_SHARE * self.stride], rod.scratch[own + OF_TWIST_SHARE * self.stride]
        return 1.0 - bend * (1.0 - time.share), 1.0 - twist * (1.0 - time.share)

    @ti.func
    def extrapolated_curvature(self, rod, at, time):
        """y(ω) as the left frame sees it and the right one, and of the twist: of the joint where the edge at ``at`` begins."""
        s = self.stride
        own, previous = at + self.motion * s, at - self.edge_stride + self.motion * s
        last = pair.curvature(self.load4(rod.scratch, previous + FRAME_1 * s), self.load4(rod.scratch, own + FRAME_1 * s))
        before = pair.curvature(self.load4(rod.scratch, previous + FRAME_2 * s), self.load4(rod.scratch, own + FRAME_2 * s))
        m1, m2 = self.twist_angle(last[4]), self.twist_angle(before[4])
        x = plus(last[0], scaled(minus(last[0], before[0]), time.extrapolation))
        y = plus(last[1], scaled(minus(last[1], before[1]), time.extrapolation))
        return (2.0 * x[1], 0.0 - 2.0 * x[0], 2.0 * y[1], 0.0 - 2.0 * y[0], m1 + time.extrapolation * (m1 - m2))
