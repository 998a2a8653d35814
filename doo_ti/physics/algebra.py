"""Functions of single numbers and of symmetric 3×3 matrices whose steps build on each other (others: :mod:`.tuples`)."""

import taichi as ti


@ti.func
def absolute(a):
    """|a|. Not by ``ti.max``, which on packs also tests for NaN: three instructions."""
    return ti.select(a < 0.0, 0.0 - a, a)


@ti.func
def larger(a, b):
    """The larger of two numbers, NaN where either is NaN (``ti.max`` would return the other one).

    NaN is found by ~(a == a): Taichi's ``a != a`` is false for it, as every comparison is.
    """
    return ti.select((b <= a) | ~(a == a), a, b)


@ti.func
def largest_of(a, b):
    """The larger of two numbers, neither of which is NaN."""
    return ti.select(a < b, b, a)


@ti.func
def solve_symmetric(m, b):
    """x with M x = b for a symmetric 3×3 M = (11, 12, 13, 22, 23, 33), by Cramer's rule, and M's leading minors."""
    c11 = m[3] * m[5] - m[4] * m[4]
    c12 = m[2] * m[4] - m[1] * m[5]
    c13 = m[1] * m[4] - m[2] * m[3]
    c22 = m[0] * m[5] - m[2] * m[2]
    c23 = m[1] * m[2] - m[0] * m[4]
    second = m[0] * m[3] - m[1] * m[1]
    third = m[0] * c11 + m[1] * c12 + m[2] * c13
    scale = 1.0 / third
    x = (
        (c11 * b[0] + c12 * b[1] + c13 * b[2]) * scale,
        (c12 * b[0] + c22 * b[1] + c23 * b[2]) * scale,
        (c13 * b[0] + c23 * b[1] + second * b[2]) * scale,
    )
    return x, (m[0], second, third)


@ti.func
def factor(m, tiny):
    """M = L D Lᵀ of a symmetric 3×3: (1/d1, 1/d2, 1/d3, l21, l31, l32, negative pivots).

    Products first, d2 = p2/d1 and d3 = p3/(d1 p2), so that the three divisions do not wait for each other: every edge of a
    chain waits for the factors of the edge before. ``tiny``, against a pivot that is exactly zero, is less than the fourth
    power of what is small in M.
    """
    d1 = m[0] + tiny
    p2 = m[0] * m[3] - m[1] * m[1] + tiny
    below = m[0] * m[4] - m[1] * m[2]
    p3 = (m[0] * m[5] - m[2] * m[2]) * p2 - below * below + tiny
    i1 = 1.0 / d1
    ip2 = 1.0 / p2
    both = d1 * p2
    one = 0.0 * m[0] + 1.0
    none = 0.0 * m[0]
    negative = (
        ti.select(d1 < 0.0, one, none) + ti.select(both < 0.0, one, none)
        + ti.select(ti.select(both < 0.0, 0.0 - p3, p3) < 0.0, one, none)
    )
    return (i1, d1 * ip2, both / p3, m[1] * i1, m[2] * i1, below * ip2, negative)


@ti.func
def factor_in_turn(m):
    """The same of a matrix whose entries may differ by many powers of ten, pivot by pivot: products of small ones would be lost
    in what :func:`factor` adds to them."""
    tiny = 1e-30
    i1 = 1.0 / (m[0] + tiny)
    l21, l31 = m[1] * i1, m[2] * i1
    d2 = m[3] - l21 * m[1] + tiny
    below = m[4] - l31 * m[1]
    i2 = 1.0 / d2
    l32 = below * i2
    d3 = m[5] - l31 * m[2] - l32 * below + tiny
    one = 0.0 * m[0] + 1.0
    none = 0.0 * m[0]
    negative = ti.select(i1 < 0.0, one, none) + ti.select(d2 < 0.0, one, none) + ti.select(d3 < 0.0, one, none)
    return (i1, i2, 1.0 / d3, l21, l31, l32, negative)


@ti.func
def _same_sign(a, b):
    one = 0.0 * a + 1.0
    return ti.select(((a > 0.0) & (b > 0.0)) | ((a < 0.0) & (b < 0.0)), one, 0.0 * a)


@ti.func
def positive_eigenvalues(minors):
    """How many eigenvalues of a symmetric 3×3 are positive: equal signs of neighbours among 1 and the leading minors."""
    one = 0.0 * minors[0] + 1.0
    return _same_sign(one, minors[0]) + _same_sign(minors[0], minors[1]) + _same_sign(minors[1], minors[2])
