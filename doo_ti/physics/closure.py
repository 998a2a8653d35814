"""Linear potentials c·t·l of an edge: gravity, and the multiplier λ that holds the far end (§III-B).

The one constraint a chain of frames does not keep by itself is closure, Σ_j l_j t_j = d: three numbers per rod.
"""

import taichi as ti

from doo_ti.physics.tuples import cross, dot, minus, negated, repeated, scaled


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
