"""The rod in the paper's own variables: vertices, and material frames measured against Bishop frames (§III-A, §III-C).

A Bishop frame is carried from edge to edge by parallel transport, so the twist θ^i − θ^{i−1} at a vertex is the angle from
the transported m1 of the edge before to m1 of the edge after. When vertices move while the twist angles are held, every
material frame follows its own tangent by parallel transport in time, and the twist at a vertex changes by the holonomy
½ κb·(δe^{i−1}/|e^{i−1}| + δe^i/|e^i|). Stiffness at a vertex is (B_left, B_right, 1/l̄, β/l̄, u̅), as in
:mod:`doo_ti.physics.pair`. Edges are 3-tuples e = x_{j+1} − x_j; |e| is taken from the rest length.
"""

import taichi as ti

from doo_ti.physics.tuples import cross, dot, minus, negated, plus, scaled


@ti.func
def curvature_binormal(before, after, length_before, length_after):
    """κb = 2 e⁻ × e⁺ / (|e⁻||e⁺| + e⁻·e⁺) and the denominator (§III-A)."""
    bottom = length_before * length_after + dot(before, after)
    return scaled(cross(before, after), 2.0 / bottom), bottom


@ti.func
def transported_vector(source, target, vector):
    """P(vector), P the smallest rotation with P(source) = target for unit vectors (§III-C)."""
    axis = cross(source, target)
    once = cross(axis, vector)
    return plus(plus(vector, once), scaled(cross(axis, once), 1.0 / (1.0 + dot(source, target))))


@ti.func
def across(vector, tangent):
    """The unit vector along the part of ``vector`` that is perpendicular to ``tangent``."""
    rest = minus(vector, scaled(tangent, dot(vector, tangent)))
    return scaled(rest, 1.0 / ti.sqrt(dot(rest, rest)))


@ti.func
def spun(m1, m2, angle):
    """m1 turned about the tangent by an angle, to second order, exactly of unit length."""
    half = 0.5 * angle
    scale = 1.0 / (1.0 + half * half)
    c = (1.0 - half * half) * scale
    s = 2.0 * half * scale
    return plus(scaled(m1, c), scaled(m2, s))


@ti.func
def material_curvature(kb, m1, m2):
    """ω = (κb·m2, −κb·m1) (§III-C)."""
    return (dot(kb, m2), 0.0 - dot(kb, m1))


@ti.func
def bend_moment(b, omega, rest, inverse_length):
    """B (ω − u̅)/l̄."""
    u0, u1 = omega[0] - rest[0], omega[1] - rest[1]
    return (inverse_length * (b[0] * u0 + b[2] * u1), inverse_length * (b[2] * u0 + b[1] * u1))


@ti.func
def bend_energy(moment, omega, rest):
    """½ (ω − u̅)ᵀ B (ω − u̅)/l̄ from the moment."""
    return 0.5 * (moment[0] * (omega[0] - rest[0]) + moment[1] * (omega[1] - rest[1]))


@ti.func
def spin_derivatives(b, moment, omega, inverse_length):
    """First and second derivative of one frame's bend energy with respect to its angle θ: dω/dθ = (ω2, −ω1).

    The second is without its negative part, so that minimising over θ never climbs.
    """
    s0, s1 = omega[1], 0.0 - omega[0]
    first = moment[0] * s0 + moment[1] * s1
    form = inverse_length * (b[0] * s0 * s0 + 2.0 * b[2] * s0 * s1 + b[1] * s1 * s1)
    return first, ti.max(form - moment[0] * omega[0] - moment[1] * omega[1], 0.0 * first)


@ti.func
def _pull(moment, m1, m2):
    """moment_1 m2 − moment_2 m1: the derivative of one frame's bend energy with respect to κb."""
    return minus(scaled(m2, moment[0]), scaled(m1, moment[1]))


@ti.func
def bend_force(moment_left, moment_right, m1_left, m2_left, m1_right, m2_right, kb, bottom, before, after):
    """Derivatives of a vertex' bend energy with respect to the edge before and the edge after, twist angles held.

    With P = Σ_frames (moment_1 m2 − moment_2 m1), δE = P·δκb; the frames' own motion adds nothing, κb being
    perpendicular to both tangents.
    """
    p = plus(_pull(moment_left, m1_left, m2_left), _pull(moment_right, m1_right, m2_right))
    scale = 1.0 / bottom
    along = dot(kb, p) * scale
    of_before = minus(scaled(cross(after, p), 2.0 * scale), scaled(after, along))
    of_after = minus(negated(scaled(cross(before, p), 2.0 * scale)), scaled(before, along))
    return of_before, of_after
