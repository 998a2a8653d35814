"""Bend and twist energy of two neighbouring edges, with gradient and Hessian (§III-C E_bend, E_twist); then linear potentials.

It depends on the relative rotation q = conj(Q_left) Q_right = (q0, q1, q2, q3) of the two material frames. With
z = q0 + i q1, ζ = q2 + i q3 and s = |z|² two complex numbers X = ζ/z̄, Y = ζ/z hold the curvature as each frame sees it,

    ω^left = −2i X,   ω^right = −2i Y   (real part: κb·m2, imaginary part: −κb·m1),

and m = 2 atan2(q1, q0) is the twist. With l̄ = l_left + l_right and u = ω − ω̄ l̄/2,

    E = (½/l̄) Σ_{left, right} uᵀ B u + β m²/l̄.

Derivatives are by the spin a of each frame about its tangent and its tilt Ω = w2 + i w3, the spin made first
(:func:`.turned_in_body`); c = e^{im}/s. The twist enters the variations through X Ω̄ and Y Ω̄, because a frame that tilts
carries its twist along. Spins change nothing but the twist of an isotropic rod: their second derivatives are 2b ∇m ∇mᵀ.

Two variants of the same energy: isotropic (B = αI, ω̄ = 0), and any symmetric positive definite B per edge with rest
curvature. Stiffness is passed as a tuple: isotropic (α/l̄, β/l̄), general (B_left, B_right, 1/l̄, β/l̄, u̅_left, u̅_right, m̅) with
B = (11, 22, 12) and the rest curvature, of each frame, u̅ = ω̄ l̄/2 as (real, imaginary), and twist of the joint: E is that of
ω^left − u̅_left, ω^right − u̅_right and m − m̅. The derivatives come as (g_left, g_right, H_left, H_right, H_across): two
3-tuples, two symmetric 6-tuples and a 9-tuple [left row, right column].
"""

import taichi as ti

from doo_ti.physics.number import device_functions
from doo_ti.physics.quaternion import relative_rotation
from doo_ti.physics.tuples import cross, dot, minus, negated, repeated, scaled, traced


@ti.func
def curvature(p, q):
    """(X, Y, 1/s, e^{im}, relative rotation) of neighbouring frames p and q."""
    r = relative_rotation(p, q)
    s = r[0] * r[0] + r[1] * r[1]
    inverse = 1.0 / s
    x = ((r[0] * r[2] - r[1] * r[3]) * inverse, (r[0] * r[3] + r[1] * r[2]) * inverse)
    y = ((r[0] * r[2] + r[1] * r[3]) * inverse, (r[0] * r[3] - r[1] * r[2]) * inverse)
    turn = ((r[0] * r[0] - r[1] * r[1]) * inverse, 2.0 * r[0] * r[1] * inverse)
    return x, y, inverse, turn, r


# --- isotropic: E = 4 α̂ |X|² + b m² with α̂ = α/l̄, b = β/l̄ -----------------------------------------------------------


@ti.func
def isotropic_energy(x, m, stiffness):
    return 4.0 * stiffness[0] * (x[0] * x[0] + x[1] * x[1]) + stiffness[1] * m * m


@ti.func
def isotropic_gradient(x, y, inverse, m, stiffness):
    """(g_left, g_right): N = 4 α̂/s, M = 2 b m."""
    n = 4.0 * stiffness[0] * inverse
    t = 2.0 * stiffness[1] * m
    left = (0.0 - t, 0.0 - n * x[0] - t * x[1], t * x[0] - n * x[1])
    right = (t, n * y[0] - t * y[1], n * y[1] + t * y[0])
    return left, right


@ti.func
def isotropic_hessian(x, y, inverse, turn, m, stiffness):
    """(H_left, H_right, H_across): K = 2b − N/2, N = 4 α̂/s, M = 2 b m."""
    n = 4.0 * stiffness[0] * inverse
    b2 = 2.0 * stiffness[1]
    t = b2 * m
    k = b2 - 0.5 * n
    h = 1.5 * n
    ht = 0.5 * t
    hn = 0.5 * n
    xrr, xri, xii = x[0] * x[0], x[0] * x[1], x[1] * x[1]
    yrr, yri, yii = y[0] * y[0], y[0] * y[1], y[1] * y[1]
    left = (b2, b2 * x[1], 0.0 - b2 * x[0],
            h * xrr + t * xri + k * xii + hn, (h - k) * xri - ht * (xrr - xii), h * xii - t * xri + k * xrr + hn)
    right = (b2, 0.0 - b2 * y[1], b2 * y[0],
             h * yrr - t * yri + k * yii + hn, (h - k) * yri + ht * (yrr - yii), h * yii + t * yri + k * yrr + hn)
    p = hn * turn[0] + ht * turn[1]
    v = hn * turn[1] - ht * turn[0]
    rr, ri, ir, ii = x[0] * y[0], x[0] * y[1], x[1] * y[0], x[1] * y[1]
    across = (
        0.0 - b2, b2 * y[1], 0.0 - b2 * y[0],
        0.0 - b2 * x[1], ht * (ri - ir) + k * ii - h * rr - p, v - h * ri - ht * (rr + ii) - k * ir,
        b2 * x[0], ht * (rr + ii) - h * ir - k * ri - v, k * rr - h * ii - ht * (ir - ri) - p)
    return left, right, across


# --- general: any symmetric positive definite B per edge, rest curvature ---------------------------------------------


@ti.func
def _applied(b, u):
    """B u for B = (11, 22, 12)."""
    return (b[0] * u[0] + b[2] * u[1], b[2] * u[0] + b[1] * u[1])


@ti.func
def strain(x, rest):
    """u = ω − u̅ with ω = −2i X."""
    return (2.0 * x[1] - rest[0], 0.0 - 2.0 * x[0] - rest[1])


@ti.func
def general_energy(x, y, m, stiffness):
    left = strain(x, stiffness[4])
    right = strain(y, stiffness[5])
    f = _applied(stiffness[0], left)
    g = _applied(stiffness[1], right)
    bend = left[0] * f[0] + left[1] * f[1] + right[0] * g[0] + right[1] * g[1]
    twist = m - stiffness[6]
    return 0.5 * stiffness[2] * bend + stiffness[3] * twist * twist


@ti.func
def _times(a, b):
    """Complex product."""
    return (a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0])


@ti.func
def _inner(a, b):
    """⟨a, b⟩ = Re(ā b)."""
    return a[0] * b[0] + a[1] * b[1]


@ti.func
def _inner_i(a, b):
    """⟨a, i b⟩."""
    return a[1] * b[0] - a[0] * b[1]


@ti.func
def moment(b, u, inverse_length):
    """μ = 2i (B u)/l̄, so that the energy varies by ⟨μ, δX⟩."""
    f = _applied(b, u)
    return (0.0 - 2.0 * inverse_length * f[1], 2.0 * inverse_length * f[0])


@ti.func
def _bend_form(b, factor, p, q):
    """(B δu)·δu'/l̄ for δu = −2i p, δu' = −2i q, with factor = 4/l̄."""
    return factor * (b[1] * p[0] * q[0] - b[2] * (p[0] * q[1] + p[1] * q[0]) + b[0] * p[1] * q[1])


@ti.func
def first_variation(x, y, inverse, turn):
    """Columns of δX over (a_left, r_left, s_left, r_right, s_right) and of δY over (r_left, s_left, a_right, r_right,
    s_right), Ω = r + i s; the missing columns are zero. And X², Y², c."""
    xx, yy = _times(x, x), _times(y, y)
    c = (turn[0] * inverse, turn[1] * inverse)
    of_x = ((x[1], 0.0 - x[0]), (0.0 - 0.5 - 0.5 * xx[0], 0.0 - 0.5 * xx[1]), (0.0 - 0.5 * xx[1], 0.5 * xx[0] - 0.5),
            (0.5 * c[0], 0.5 * c[1]), (0.0 - 0.5 * c[1], 0.5 * c[0]))
    of_y = ((0.0 - 0.5 * c[0], 0.5 * c[1]), (0.0 - 0.5 * c[1], 0.0 - 0.5 * c[0]),
            (y[1], 0.0 - y[0]), (0.5 + 0.5 * yy[0], 0.5 * yy[1]), (0.5 * yy[1], 0.5 - 0.5 * yy[0]))
    return of_x, of_y, xx, yy, c


@ti.func
def general_gradient(x, y, inverse, turn, m, stiffness):
    """⟨μ, δX⟩ + ⟨ν, δY⟩ + M δm with μ, ν the moments of the left and right frame and M = 2 b m."""
    mu = moment(stiffness[0], strain(x, stiffness[4]), stiffness[2])
    nu = moment(stiffness[1], strain(y, stiffness[5]), stiffness[2])
    t = 2.0 * stiffness[3] * (m - stiffness[6])
    return gradient_of_moments(mu, nu, t, x, y, inverse, turn)


@traced
def _combined(columns, weights, part: int):
    """Σ w_k c_k of the real (0) or imaginary (1) parts of some complex numbers."""
    return sum(weight * column[part] for weight, column in zip(weights, columns, strict=True))


@ti.func
def gradient_of_moments(mu, nu, t, x, y, inverse, turn):
    """(g_left, g_right), linear in the moments μ and ν of the left and right frame and in M."""
    dx, dy, xx, yy, c = first_variation(x, y, inverse, turn)
    left = (_inner(mu, dx[0]) - t, _inner(mu, dx[1]) + _inner(nu, dy[0]) - t * x[1],
            _inner(mu, dx[2]) + _inner(nu, dy[1]) + t * x[0])
    right = (_inner(nu, dy[2]) + t, _inner(mu, dx[3]) + _inner(nu, dy[3]) - t * y[1],
             _inner(mu, dx[4]) + _inner(nu, dy[4]) + t * y[0])
    return left, right


@ti.func
def curvature_variation(x, y, inverse, turn, left, right):
    """(δX, δY, δm), five numbers, of body rotations ``left`` and ``right`` of the two frames."""
    dx, dy, xx, yy, c = first_variation(x, y, inverse, turn)
    of_x = (left[0], left[1], left[2], right[1], right[2])
    of_y = (left[1], left[2], right[0], right[1], right[2])
    twist = right[0] - left[0] + x[0] * left[2] - x[1] * left[1] + y[0] * right[2] - y[1] * right[1]
    return (_combined(dx, of_x, 0), _combined(dx, of_x, 1), _combined(dy, of_y, 0), _combined(dy, of_y, 1), twist)


@ti.func
def general_hessian(x, y, inverse, turn, m, stiffness):
    """Σ (δu)ᵀB(δu)/l̄ + 2b δm² + ⟨μ, δ²X⟩ + ⟨ν, δ²Y⟩ + M δ²m."""
    b_left, b_right = stiffness[0], stiffness[1]
    mu = moment(b_left, strain(x, stiffness[4]), stiffness[2])
    nu = moment(b_right, strain(y, stiffness[5]), stiffness[2])
    f = 4.0 * stiffness[2]
    b2 = 2.0 * stiffness[3]
    h = 0.5 * b2 * (m - stiffness[6])  # M/2
    dx, dy, xx, yy, c = first_variation(x, y, inverse, turn)
    xxx, yyy = _times(xx, x), _times(yy, y)
    c_bar = (c[0], 0.0 - c[1])
    cx_bar = _times(c_bar, (x[0], 0.0 - x[1]))
    cy_bar = _times(c, (y[0], 0.0 - y[1]))
    cx, cy = _times(c, x), _times(c_bar, y)
    left = (
        _bend_form(b_left, f, dx[0], dx[0]) + b2 - _inner(mu, x),
        _bend_form(b_left, f, dx[0], dx[1]) + b2 * x[1] + 0.5 * (mu[1] + _inner_i(mu, xx)),
        _bend_form(b_left, f, dx[0], dx[2]) - b2 * x[0] - 0.5 * (mu[0] - _inner(mu, xx)),
        _bend_form(b_left, f, dx[1], dx[1]) + _bend_form(b_right, f, dy[0], dy[0]) + b2 * x[1] * x[1]
        + 0.5 * (_inner(mu, x) + _inner(mu, xxx) + _inner(nu, cx_bar)) + h * xx[1],
        _bend_form(b_left, f, dx[1], dx[2]) + _bend_form(b_right, f, dy[0], dy[1]) - b2 * x[0] * x[1]
        + 0.5 * (_inner_i(nu, cx_bar) - _inner_i(mu, xxx)) - h * xx[0],
        _bend_form(b_left, f, dx[2], dx[2]) + _bend_form(b_right, f, dy[1], dy[1]) + b2 * x[0] * x[0]
        + 0.5 * (_inner(mu, x) - _inner(mu, xxx) - _inner(nu, cx_bar)) - h * xx[1])
    right = (
        _bend_form(b_right, f, dy[2], dy[2]) + b2 - _inner(nu, y),
        _bend_form(b_right, f, dy[2], dy[3]) - b2 * y[1] - 0.5 * (nu[1] + _inner_i(nu, yy)),
        _bend_form(b_right, f, dy[2], dy[4]) + b2 * y[0] + 0.5 * (nu[0] - _inner(nu, yy)),
        _bend_form(b_left, f, dx[3], dx[3]) + _bend_form(b_right, f, dy[3], dy[3]) + b2 * y[1] * y[1]
        + 0.5 * (_inner(nu, y) + _inner(nu, yyy) + _inner(mu, cy_bar)) - h * yy[1],
        _bend_form(b_left, f, dx[3], dx[4]) + _bend_form(b_right, f, dy[3], dy[4]) - b2 * y[0] * y[1]
        + 0.5 * (_inner_i(mu, cy_bar) - _inner_i(nu, yyy)) + h * yy[0],
        _bend_form(b_left, f, dx[4], dx[4]) + _bend_form(b_right, f, dy[4], dy[4]) + b2 * y[0] * y[0]
        + 0.5 * (_inner(nu, y) - _inner(nu, yyy) - _inner(mu, cy_bar)) + h * yy[1])
    across = (
        0.0 - b2,
        _bend_form(b_left, f, dx[0], dx[3]) + b2 * y[1] - 0.5 * _inner_i(mu, c),
        _bend_form(b_left, f, dx[0], dx[4]) - b2 * y[0] + 0.5 * _inner(mu, c),
        _bend_form(b_right, f, dy[0], dy[2]) - b2 * x[1] + 0.5 * _inner_i(nu, c_bar),
        _bend_form(b_left, f, dx[1], dx[3]) + _bend_form(b_right, f, dy[0], dy[3]) + b2 * x[1] * y[1]
        - 0.5 * (_inner(mu, cx) + _inner(nu, cy)) - h * c[1],
        _bend_form(b_left, f, dx[1], dx[4]) + _bend_form(b_right, f, dy[0], dy[4]) - b2 * x[1] * y[0]
        + 0.5 * (_inner_i(nu, cy) - _inner_i(mu, cx)) - h * c[0],
        _bend_form(b_right, f, dy[1], dy[2]) + b2 * x[0] - 0.5 * _inner(nu, c_bar),
        _bend_form(b_left, f, dx[2], dx[3]) + _bend_form(b_right, f, dy[1], dy[3]) - b2 * x[0] * y[1]
        + 0.5 * (_inner_i(mu, cx) - _inner_i(nu, cy)) + h * c[0],
        _bend_form(b_left, f, dx[2], dx[4]) + _bend_form(b_right, f, dy[1], dy[4]) + b2 * x[0] * y[0]
        - 0.5 * (_inner(mu, cx) + _inner(nu, cy)) - h * c[1])
    return left, right, across


# --- linear potentials c·t·l of an edge: gravity, and the multiplier λ that holds the far end (§III-B). The one constraint that
# a chain of frames does not keep by itself is closure, Σ_j l_j t_j = d: three numbers per rod -------------------------


@ti.func
def linear_gradient(c, length, m1, m2):
    """∂(l c·t)/∂w: (0, −l c·m2, l c·m1), given as its last two numbers. Its Jacobian rows in c are A = l (0; −m2ᵀ; m1ᵀ)."""
    return (0.0 - length * dot(c, m2), length * dot(c, m1))


@ti.func
def linear_hessian(c, length, t):
    """∂²(l c·t)/∂w²: −l c·t for both tilts, and zero for all else, spin included."""
    return 0.0 - length * dot(c, t)


@ti.func
def closure_rows(length, m1, m2):
    """A = l (0; −m2ᵀ; m1ᵀ), by which the far end follows the edge's rotation: nine numbers."""
    return repeated(0.0 * length, 3) + negated(scaled(m2, length)) + scaled(m1, length)


@ti.func
def shift_of_end(length, m1, m2, w):
    """Aᵀw, by which the rotation w of an edge moves its end."""
    return scaled(minus(scaled(m1, w[2]), scaled(m2, w[1])), length)


@ti.func
def normal_matrix(length, t):
    """AᵀA = l² (I − t tᵀ), symmetric 6-tuple."""
    s = length * length
    return (s - s * t[0] * t[0], 0.0 - s * t[0] * t[1], 0.0 - s * t[0] * t[2],
            s - s * t[1] * t[1], 0.0 - s * t[1] * t[2], s - s * t[2] * t[2])


@ti.func
def closing_rotation(length, t, x):
    """World rotation −l t × x that moves the end of the edge by −AᵀA x: the minimum norm for a shift of the far end."""
    return negated(scaled(cross(t, x), length))


@device_functions
class PairEnergy:
    """The variant for the material of a chain's rods: ``isotropic``, or general. Its functions take views of edges in scratch
    (:mod:`doo_ti.relaxation.chain`), and the stiffness as ``s``."""

    isotropic: bool

    def stiffness(self, left, right, material):
        """The stiffness tuple of the vertex between two neighbouring edges."""
        inverse = right.inverse_length
        if ti.static(self.isotropic):
            return (material[0] * inverse, material[1] * inverse)
        else:
            return (left.bend, right.bend, inverse, right.twist * inverse) + self.rest(right)

    def rest(self, edge):
        """What stiffness ends with, of the vertex where an edge begins: u̅, here the same for both frames, and m̅."""
        return (edge.rest, edge.rest, 0.0)

    def bent(self, b):
        """(X, Y, 1/s, m, e^{im}) of the numbers ``bent`` of an edge."""
        return ((b[0], b[1]), (b[2], b[3]), b[4], b[5], (b[6], b[7]))

    def energy_of(self, bent, s):
        if ti.static(self.isotropic):
            return isotropic_energy(bent[0], bent[3], s)
        else:
            return general_energy(bent[0], bent[1], bent[3], s)

    def gradient_of(self, bent, s):
        x, y, inverse, m, turn = bent
        if ti.static(self.isotropic):
            return isotropic_gradient(x, y, inverse, m, s)
        else:
            return general_gradient(x, y, inverse, turn, m, s)

    def derivatives(self, bent, s):
        """(g_left, g_right, H_left, H_right, H_across) of a pair."""
        x, y, inverse, m, turn = bent
        if ti.static(self.isotropic):
            return self.gradient_of(bent, s) + isotropic_hessian(x, y, inverse, turn, m, s)
        else:
            return self.gradient_of(bent, s) + general_hessian(x, y, inverse, turn, m, s)

    def keep_pair(self, rod, joint, derivatives):
        """Called with the :meth:`derivatives` of each pair during elimination; here it keeps nothing."""
