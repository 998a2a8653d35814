"""A rod in the paper's own variables, vertices and material frames, in scratch: the step and the fast projection (§III-D), its
energy and gradient, and its twist angles minimised (§III-C).

The counterpart of :mod:`doo_ti.relaxation.chain` for :mod:`doo_ti.relaxation.descent`. Where a vertex moves while the twist
angles are held, a frame follows its edge e by parallel transport, that is by a tilt alone: with ∂E/∂w = g of the frame, of all
its joints (:mod:`doo_ti.physics.pair`), ∂E/∂e = (g_3 m1 − g_2 m2)/|e|. Along the edge ∂E/∂e may be anything: the projection
removes that part.
"""

import taichi as ti

from doo_ti.physics import pair, quaternion
from doo_ti.physics.algebra import absolute, larger
from doo_ti.physics.number import Layout, device_functions, read
from doo_ti.physics.tuples import choose, dot, minus, picked, plus, record, repeated, scaled, variable
from doo_ti.relaxation.loading import load_stiffness

VERTEX = Layout(position=3, frame=4, force=3, state=("position", 10), trial_position=3, trial_frame=4, trial_force=3,
                trial=("trial_position", 10), ratio=1, right=1, length=1, inverse_length=1, bend=3, twist=1, rest=2)
"""What scratch has of a vertex and the edge that leaves it; ``force``: the projected gradient; ``ratio``, ``right``: factor and
right-hand side of the tridiagonal systems."""
PROJECTION_ROUNDS = 2


@device_functions
class VertexChain(pair.PairEnergy):
    """The sweeps over vertices, for one kind of number; materials are always general.

    Its functions take a record ``rod`` of the rods in one pack:

    origin   the view of vertex 0 in scratch (:data:`VERTEX`)
    edges    number of edges
    held     (vertex 0, vertex 1, vertex E−1, vertex E, all): one where the vertex is held, else zero
    spin     (first frame, last frame): one where it may spin, else zero
    gravity  μ times the unit vector up
    """

    def __init__(self, number):
        self.isotropic, self.twist_angle = False, quaternion.twist_angle_function(number)

    @picked
    def vertex(self, origin, v):
        """The view of vertex ``v``."""
        return origin.part(VERTEX, v * len(VERTEX))

    @picked
    def projected(self, vertex, of_gradient: bool):
        """What the fast projection changes of a vertex."""
        return vertex.of("trial_force" if of_gradient else "trial_position")

    def mobility(self, rod, vertex):
        """One where the vertex may move."""
        free = 1.0 - rod.held[4]
        if vertex == 0:
            free = free * (1.0 - rod.held[0])
        if vertex == 1:
            free = free * (1.0 - rod.held[1])
        if vertex == rod.edges - 1:
            free = free * (1.0 - rod.held[2])
        if vertex == rod.edges:
            free = free * (1.0 - rod.held[3])
        return free

    def spins(self, rod, e):
        """One where the frame of edge ``e`` may spin."""
        free = 0.0 * rod.spin[0] + 1.0
        if e == 0:
            free = rod.spin[0]
        if e == rod.edges - 1:
            free = rod.spin[1]
        return free

    # --- sweeps ---

    def move(self, rod, step):
        """Trial vertices: the step down the gradient, the projection, and the frames carried along."""
        for v in range(rod.edges + 1):
            at = self.vertex(rod.origin, v)
            at.trial_position = minus(at.position, scaled(at.force, step))
        for _ in ti.static(range(PROJECTION_ROUNDS)):
            self.eliminate_lengths(rod, False)
            self.apply_lengths(rod, False)
        for v in range(rod.edges):
            at, after = self.vertex(rod.origin, v), self.vertex(rod.origin, v + 1)
            along, frame = minus(after.trial_position, at.trial_position), at.frame
            new = scaled(along, 1.0 / ti.sqrt(dot(along, along)))
            at.trial_frame = quaternion.transported(frame, quaternion.tangent(frame), new)

    def eliminate_lengths(self, rod, of_gradient: ti.template()):
        """Fast projection, the forward half (§III-D; Goldenthal 2007):

            c_j(x) = (|e_j|² − l_j²)/(2 l_j) = 0,    (J Jᵀ) y = c(x),    x ← x − Jᵀ y,

        J the Jacobian of c at the trial vertices, its columns zero at held vertices. J Jᵀ is tridiagonal. Of the gradient g
        the part that would change lengths is removed likewise: c(x) is replaced by J g, and g ← g − Jᵀ y.
        """
        one = 0.0 * rod.held[0] + 1.0
        zero = 0.0 * one
        before = variable(repeated(one, 3))  # e/l of the edge before
        ratio, right = (zero, zero)
        for e in range(rod.edges):
            at, after = self.vertex(rod.origin, e), self.vertex(rod.origin, e + 1)
            length = at.length
            v = minus(after.trial_position, at.trial_position)
            u = (v[0] / length, v[1] / length, v[2] / length)
            here, there = self.mobility(rod, e), self.mobility(rod, e + 1)
            value = 0.5 * (dot(u, v) - length)
            if ti.static(of_gradient):
                g0, g1 = at.trial_force, after.trial_force
                value = there * dot(u, g1) - here * dot(u, g0)
            off = zero
            if e > 0:
                off = 0.0 - here * dot(before, u)
            movable = here + there > 0.5
            pivot = ti.select(movable, (here + there) * dot(u, u) - off * ratio, one)
            right = ti.select(movable, (value - off * right) / pivot, zero)
            at.right = right
            # Coupling to the next edge, needed here so that the ratio is known going back.
            ratio = zero
            if e < rod.edges - 1:
                far = self.vertex(rod.origin, e + 2)
                coupling = 0.0 - there * dot(u, minus(far.trial_position, after.trial_position)) / after.length
                ratio = ti.select(movable, coupling / pivot, zero)
            at.ratio = ratio
            before = u

    def apply_lengths(self, rod, of_gradient: ti.template()):
        """Fast projection, the backward half: subtract Jᵀ y from the trial vertices, or from the trial gradient, which is also
        set to zero at held vertices. Returns Σ |gradient| over the vertices (zero for positions)."""
        zero = 0.0 * rod.held[0]
        y, total = (zero, zero)
        beyond = variable(repeated(zero, 3))  # y e/l of the edge after
        for back in range(rod.edges + 1):
            v = rod.edges - back
            at, free = self.vertex(rod.origin, v), self.mobility(rod, v)
            n = variable(repeated(zero, 3))
            if v > 0:
                before = self.vertex(rod.origin, v - 1)
                along = minus(at.trial_position, before.trial_position)
                y = before.right - before.ratio * y
                n = (along[0] * y / before.length, along[1] * y / before.length, along[2] * y / before.length)
            moved = self.projected(at, of_gradient)
            x = variable(moved.value)
            if ti.static(of_gradient):
                x = scaled(x, free)
            x = minus(x, scaled(minus(n, beyond), free))
            if ti.static(of_gradient):
                total = total + ti.sqrt(dot(x, x))
            moved.value = x
            beyond = n
        return total

    def adopt(self, rod, accepted):
        """Make the trial the state where accepted. Returns a record: ``ss``, ``sy``, ``yy`` of the change s of the vertices and
        y of the gradient, and ``top``, the largest gradient of any vertex."""
        zero = 0.0 * accepted
        change = record(ss=zero, sy=zero, yy=zero, top=zero)
        for v in range(rod.edges + 1):
            at = self.vertex(rod.origin, v)
            for k in ti.static(range(3)):
                dx = at.trial_position[k] - at.position[k]
                dg = at.trial_force[k] - at.force[k]
                change.ss = change.ss + dx * dx
                change.sy = change.sy + dx * dg
                change.yy = change.yy + dg * dg
            choose(at, accepted > 0.5, state=at.trial)
            f = at.force
            change.top = ti.max(change.top, dot(f, f))
        change.top = ti.sqrt(change.top)
        return change

    def load_rod(self, tables, origin, start, s, g):
        """Row ``start`` of the starts, with clamps s and material g, into a lane whose vertex 0 is ``origin``. Returns (longest
        edge, shortest edge)."""
        edges = tables.start.shape[1]
        row = ti.min(s, tables.rest_length.shape[0] - 1)
        longest, shortest = (ti.cast(0.0, ti.f64), ti.cast(1e30, ti.f64))
        for v in range(edges + 1):
            at = self.vertex(origin, v)
            at.position, at.force = read(tables.vertices, start, v, 0), repeated(ti.cast(0.0, ti.f64), 3)
            if v < edges:
                longest = ti.max(longest, tables.rest_length[row, v])
                shortest = ti.min(shortest, tables.rest_length[row, v])
                at.length = tables.rest_length[row, v]
                at.frame = read(tables.start, start, v, 0, count=4)
                load_stiffness(at, tables.material, g, tables.rest_length, row, v, 1.0)
                if v > 0:
                    at.inverse_length = 1.0 / (tables.rest_length[row, v - 1] + tables.rest_length[row, v])
        return longest, shortest

    # --- the energy of the trial vertices and frames ---

    def joint(self, left, right):
        """(X, Y, 1/s, m, e^{im}) and the stiffness of the joint between two neighbouring edges."""
        x, y, inverse, turn, relative = pair.curvature(left.trial_frame, right.trial_frame)
        return (x, y, inverse, self.twist_angle(relative), turn), self.stiffness(left, right, 0)

    def minimise_twist(self, rod):
        """One Newton round on the twist angles, the vertices held: a scalar tridiagonal system."""
        one = 0.0 * rod.spin[0] + 1.0
        zero = 0.0 * one
        gradient, curvature = (zero, zero)  # of the joint before
        ratio, right, coupling = (zero, zero, zero)
        for e in range(rod.edges):
            at = self.vertex(rod.origin, e)
            g, h = gradient, curvature
            gradient, curvature = (zero, zero)
            b2 = zero
            if e < rod.edges - 1:
                bent, stiffness = self.joint(at, self.vertex(rod.origin, e + 1))
                of_left, of_right, h_left, h_right, h_across = self.derivatives(bent, stiffness)
                # Of bending without its negative part, so that a step never climbs.
                b2 = 2.0 * stiffness[3]
                g, h = g + of_left[0], h + ti.max(h_left[0], b2)
                gradient, curvature = of_right[0], ti.max(h_right[0], b2)
            free = self.spins(rod, e)
            pivot = h - coupling * ratio
            pivot = ti.select((free > 0.5) & (pivot > 0.0), pivot, one)
            right = free * (0.0 - g - coupling * right) / pivot
            coupling = 0.0 - b2 * free * self.spins(rod, e + 1)
            ratio = coupling / pivot
            at.right = right
            at.ratio = ratio
        angle = zero
        for back in range(rod.edges):  # turn the trial frames about their tangents, by half a radian at most
            at = self.vertex(rod.origin, rod.edges - 1 - back)
            angle = at.right - at.ratio * angle
            turn = ti.min(ti.max(angle, zero - 0.5), zero + 0.5)
            at.trial_frame = quaternion.turned_in_body(at.trial_frame, (turn, zero, zero), zero)

    def evaluate(self, rod):
        """The record of ``energy``, its ``magnitude`` (sum of absolute terms) and ``spin``, the largest moment of spin; the
        gradient goes to ``trial_force``.

        ∂E/∂x_v = N_{v−1} − N_v + μ l̄_v up, N_j the derivative with respect to edge j.
        """
        zero = 0.0 * rod.spin[0]
        found = record(energy=zero, magnitude=zero, spin=zero)
        potential, before = (zero, zero)
        n, carried = variable(repeated(zero, 3)), variable(repeated(zero, 3))  # of the edge before, and of the joint with it
        for v in range(rod.edges + 1):
            at = self.vertex(rod.origin, v)
            length = zero
            if v < rod.edges:
                length = at.length
            weight = before + length
            before = length
            height = weight * dot(rod.gravity, at.trial_position)
            potential = potential + height
            found.magnitude = found.magnitude + absolute(height)
            f = plus(n, scaled(rod.gravity, weight))
            n = repeated(zero, 3)
            if v < rod.edges:
                gradient = variable(carried)
                if v < rod.edges - 1:
                    bent, stiffness = self.joint(at, self.vertex(rod.origin, v + 1))
                    found.energy = found.energy + self.energy_of(bent, stiffness)
                    of_left, of_right = self.gradient_of(bent, stiffness)
                    gradient, carried = plus(gradient, of_left), of_right
                found.spin = larger(found.spin, absolute(gradient[0] * self.spins(rod, v)))
                t, m1, m2 = quaternion.directors(at.trial_frame)
                n = minus(scaled(m1, gradient[2] / at.length), scaled(m2, gradient[1] / at.length))
            at.trial_force = minus(f, n)
        found.magnitude = found.energy + found.magnitude
        found.energy = found.energy + potential
        return found
