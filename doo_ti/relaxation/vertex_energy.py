"""Energy and gradient of a rod in vertices and material frames, and its twist angles minimised (§III-C, §III-D)."""

import taichi as ti

from doo_ti.physics import vertex_form
from doo_ti.physics.algebra import absolute, larger
from doo_ti.physics.quaternion import signed_angle_function
from doo_ti.physics.tuples import cross, dot, minus, plus, record, repeated, scaled, variable
from doo_ti.relaxation.vertex_chain import VertexChain, direction


@ti.data_oriented
class VertexEnergy(VertexChain):
    """The energy of the trial vertices and directors."""

    def __init__(self, number):
        super().__init__(number)
        self.signed_angle = signed_angle_function(number)

    @ti.func
    def edge(self, rod, index):
        """The record of an edge: e, |e|, t, m1, m2 and B."""
        at, after = self.vertex(rod.origin, index), self.vertex(rod.origin, index + 1)
        e = minus(after.trial_position, at.trial_position)
        t, m1 = direction(e), at.trial_director
        length, bend = at.length, at.bend
        return record(e=e, length=length, t=t, m1=m1, m2=cross(t, m1), bend=bend)

    @ti.func
    def joint(self, rod, e):
        """The record of the vertex between edge ``e`` and the one after it:

        left, right              the edges (:meth:`edge`)
        binormal, bottom         κb and its denominator
        omega_left, omega_right  ω as either frame sees it; moment_left, moment_right  B (ω − u̅)/l̄
        rest                     u̅ = ω̄ l̄/2
        inverse, twist           1/l̄, and the angle of twist
        stiffness                β/l̄
        """
        after = self.vertex(rod.origin, e + 1)
        left, right = self.edge(rod, e), self.edge(rod, e + 1)
        inverse = after.inverse_length
        binormal, bottom = vertex_form.curvature_binormal(left.e, right.e, left.length, right.length)
        reference = vertex_form.transported(left.t, right.t, left.m1)
        rest = after.rest
        omega_left = vertex_form.material_curvature(binormal, left.m1, left.m2)
        omega_right = vertex_form.material_curvature(binormal, right.m1, right.m2)
        return record(
            left=left, right=right, binormal=binormal, bottom=bottom, omega_left=omega_left, omega_right=omega_right,
            moment_left=vertex_form.bend_moment(left.bend, omega_left, rest, inverse),
            moment_right=vertex_form.bend_moment(right.bend, omega_right, rest, inverse), rest=rest, inverse=inverse,
            twist=self.signed_angle(dot(reference, right.m1), dot(cross(reference, right.m1), right.t)),
            stiffness=after.twist * inverse)

    @ti.func
    def spins(self, joint):
        """First and second derivatives of a joint's bend energy by the spins of its frames: ((first, second) of the left frame,
        of the right one)."""
        left = vertex_form.spin_derivatives(joint.left.bend, joint.moment_left, joint.omega_left, joint.inverse)
        right = vertex_form.spin_derivatives(joint.right.bend, joint.moment_right, joint.omega_right, joint.inverse)
        return left, right

    @ti.func
    def bend_force(self, joint):
        """Derivatives of a joint's bend energy by the edge before and the edge after."""
        left, right = joint.left, joint.right
        return vertex_form.bend_force(joint.moment_left, joint.moment_right, left.m1, left.m2, right.m1, right.m2,
                                      joint.binormal, joint.bottom, left.e, right.e)

    @ti.func
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
                joint = self.joint(rod, e)
                b2 = 2.0 * joint.stiffness
                of_left, of_right = self.spins(joint)
                g, h = g + of_left[0] - b2 * joint.twist, h + of_left[1] + b2
                gradient, curvature = of_right[0] + b2 * joint.twist, of_right[1] + b2
            free, after_free = (one, one)
            if e == 0:
                free = rod.spin[0]
            if e == rod.edges - 1:
                free = rod.spin[1]
            if e == rod.edges - 2:
                after_free = rod.spin[1]
            pivot = h - coupling * ratio
            pivot = ti.select((free > 0.5) & (pivot > 0.0), pivot, one)
            right = free * (0.0 - g - coupling * right) / pivot
            coupling = 0.0 - b2 * free * after_free
            ratio = coupling / pivot
            at.right = right
            at.ratio = ratio
        self.spin_frames(rod)

    @ti.func
    def spin_frames(self, rod):
        """Turn the trial directors by the angles of :meth:`minimise_twist`, half a radian at most."""
        angle = 0.0 * rod.spin[0]
        for back in range(rod.edges):
            e = rod.edges - 1 - back
            at, after = self.vertex(rod.origin, e), self.vertex(rod.origin, e + 1)
            angle = at.right - at.ratio * angle
            t = direction(minus(after.trial_position, at.trial_position))
            m1 = at.trial_director
            turn = ti.min(ti.max(angle, 0.0 * angle - 0.5), 0.0 * angle + 0.5)
            at.trial_director = vertex_form.spun(m1, cross(t, m1), turn)

    @ti.func
    def evaluate(self, rod):
        """The record of ``energy``, its ``magnitude`` (sum of absolute terms) and ``spin``, the largest moment of spin; the
        gradient goes to ``trial_force``.

        ∂E/∂x_v = N_{v−1} − N_v + μ l̄_v up, N_j the derivative with respect to edge j.
        """
        zero = 0.0 * rod.spin[0]
        found = record(energy=zero, magnitude=zero, spin=zero)
        potential, before, carried = (zero, zero, zero)
        n = variable(repeated(zero, 3))
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
            # Take the next edge's derivative: what the vertex before left for it, and the joint after it.
            n = repeated(zero, 3)
            if v < rod.edges:
                if v > 0:
                    n = at.trial_force
                moment = carried
                carried = zero
                if v < rod.edges - 1:
                    joint = self.joint(rod, v)
                    left, right = joint.left, joint.right
                    torque = joint.stiffness * joint.twist
                    found.energy = (found.energy + torque * joint.twist
                                    + vertex_form.bend_energy(joint.moment_left, joint.omega_left, joint.rest)
                                    + vertex_form.bend_energy(joint.moment_right, joint.omega_right, joint.rest))
                    of_left, of_right = self.bend_force(joint)
                    # Holonomy: δm = ½ κb·(δe⁻/|e⁻| + δe⁺/|e⁺|).
                    n = plus(plus(n, of_left), scaled(joint.binormal, torque / left.length))
                    after = self.vertex(rod.origin, v + 1)
                    after.trial_force = plus(of_right, scaled(joint.binormal, torque / right.length))
                    spin_left, spin_right = self.spins(joint)
                    moment = moment + spin_left[0] - 2.0 * torque
                    carried = spin_right[0] + 2.0 * torque
                if v == 0:
                    moment = moment * rod.spin[0]
                if v == rod.edges - 1:
                    moment = moment * rod.spin[1]
                found.spin = larger(found.spin, absolute(moment))
            at.trial_force = minus(f, n)
        found.magnitude = found.energy + found.magnitude
        found.energy = found.energy + potential
        return found
