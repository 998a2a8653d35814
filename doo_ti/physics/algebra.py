"""Functions of single numbers, of 3×3 matrices (:mod:`.tuples`), and of their factors M = L D Lᵀ."""

import taichi as ti
from taichi.lang.impl import expr_init

from doo_ti.physics.tuples import picked, traced


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
def _same_sign(a, b):
    one = 0.0 * a + 1.0
    return ti.select(((a > 0.0) & (b > 0.0)) | ((a < 0.0) & (b < 0.0)), one, 0.0 * a)


@ti.func
def positive_eigenvalues(minors):
    """How many eigenvalues of a symmetric 3×3 are positive: equal signs of neighbours among 1 and the leading minors."""
    one = 0.0 * minors[0] + 1.0
    return _same_sign(one, minors[0]) + _same_sign(minors[0], minors[1]) + _same_sign(minors[1], minors[2])


# --- matrices: nine numbers row by row, symmetric ones six (11, 12, 13, 22, 23, 33) -----------------------------------


@picked
def row(m, index: int) -> tuple:
    """Row ``index`` of a matrix."""
    return tuple(m[3 * index : 3 * index + 3])


@picked
def transposed(m) -> tuple:
    """Mᵀ."""
    return (m[0], m[3], m[6], m[1], m[4], m[7], m[2], m[5], m[8])


@traced
def identity(zero) -> tuple:
    """I, of numbers like ``zero``."""
    return tuple(zero + (1.0 if k % 4 == 0 else 0.0) for k in range(9))


@traced
def on_diagonal(m, s) -> tuple:
    """M + s I of a symmetric M."""
    return (m[0] + s, m[1], m[2], m[3] + s, m[4], m[5] + s)


@traced
def shifted(m, spin, tilt) -> tuple:
    """M + diag(spin, tilt, tilt) of a symmetric M."""
    return (m[0] + spin, m[1], m[2], m[3] + tilt, m[4], m[5] + tilt)


@picked
def full(s) -> tuple:
    """A symmetric matrix row by row."""
    return (s[0], s[1], s[2], s[1], s[3], s[4], s[2], s[4], s[5])


@traced
def applied(m, b) -> tuple:
    """M b."""
    return tuple(m[k] * b[0] + m[k + 1] * b[1] + m[k + 2] * b[2] for k in (0, 3, 6))


@traced
def times_transposed(a, b) -> tuple:
    """A Bᵀ of two matrices."""
    return tuple(a[i] * b[j] + a[i + 1] * b[j + 1] + a[i + 2] * b[j + 2] for i in (0, 3, 6) for j in (0, 3, 6))


@traced
def quadratic(s, a, b):
    """aᵀ S b of a symmetric S."""
    return (
        a[0] * (s[0] * b[0] + s[1] * b[1] + s[2] * b[2])
        + a[1] * (s[1] * b[0] + s[3] * b[1] + s[4] * b[2])
        + a[2] * (s[2] * b[0] + s[4] * b[1] + s[5] * b[2])
    )


@traced
def row_scaled(m, s) -> tuple:
    """diag(s) M."""
    return tuple(s[k // 3] * m[k] for k in range(9))


@traced
def scaled_both(s, m, t) -> tuple:
    """diag(s) M diag(t)."""
    return tuple(s[k // 3] * m[k] * t[k % 3] for k in range(9))


@traced
def column_scaled(m, s) -> tuple:
    """M diag(s)."""
    return tuple(m[k] * s[k % 3] for k in range(9))


# --- of welds, which keep the rotation between two edges ---


@traced
def against_columns(m, columns) -> tuple:
    """M R, where R has three ``columns``."""
    return tuple(m[3 * r] * c[0] + m[3 * r + 1] * c[1] + m[3 * r + 2] * c[2] for r in range(3) for c in columns)


@traced
def seen_from(columns, m) -> tuple:
    """Rᵀ M R of a symmetric M, six numbers, where R has three ``columns``."""
    turned = [(m[0] * c[0] + m[1] * c[1] + m[2] * c[2], m[1] * c[0] + m[3] * c[1] + m[4] * c[2],
               m[2] * c[0] + m[4] * c[1] + m[5] * c[2]) for c in columns]
    return tuple(columns[r][0] * turned[c][0] + columns[r][1] * turned[c][1] + columns[r][2] * turned[c][2]
                 for r in range(3) for c in range(r, 3))


@traced
def own_block(v, stiffness, bent) -> tuple:
    """κ (I − v vᵀ) + ``bent`` I, six numbers."""
    return tuple((stiffness + bent if r == c else 0.0 * bent) - stiffness * v[r] * v[c] for r in range(3) for c in range(r, 3))


@traced
def mixed_block(s, v, p, stiffness) -> tuple:
    """−κ (s + [v]×)² + (v pᵀ + p vᵀ + s [p]× − (p·v) I)/2, nine numbers: of the second derivatives by both edges what stands
    before the rest rotation, r = (s, v)."""
    across = {(0, 1): (2, -1.0), (0, 2): (1, 1.0), (1, 0): (2, 1.0), (1, 2): (0, -1.0), (2, 0): (1, -1.0), (2, 1): (0, 1.0)}
    inner = v[0] * p[0] + v[1] * p[1] + v[2] * p[2]
    square = s * s - v[0] * v[0] - v[1] * v[1] - v[2] * v[2]
    block = []
    for r in range(3):
        for c in range(3):
            value = 0.5 * (v[r] * p[c] + p[r] * v[c]) - stiffness * v[r] * v[c]
            if r == c:
                value = value - 0.5 * inner - stiffness * square
            else:
                k, sign = across[r, c]
                value = value + (0.5 * sign) * s * p[k] - (2.0 * sign) * stiffness * s * v[k]
            block.append(value)
    return tuple(block)


# --- factors of symmetric matrices, (1/d1, 1/d2, 1/d3, l21, l31, l32, …), and what is done with them ---


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


@traced
def minus_combination(y, m, x) -> tuple:
    """y − Mᵀ x: ``y`` less the rows of M, each times its item of x."""
    return tuple(y[k] - m[k] * x[0] - m[3 + k] * x[1] - m[6 + k] * x[2] for k in range(3))


@traced
def forward(f, b) -> tuple:
    """L⁻¹ b."""
    y1 = expr_init(b[1] - f[3] * b[0])
    return (b[0], y1, b[2] - f[4] * b[0] - f[5] * y1)


@traced
def forward_rows(f, m) -> tuple:
    """L⁻¹ of each row of a matrix, as rows."""
    return forward(f, m[0:3]) + forward(f, m[3:6]) + forward(f, m[6:9])


@traced
def backward(f, y) -> tuple:
    """L⁻ᵀ D⁻¹ y."""
    x2 = expr_init(y[2] * f[2])
    x1 = expr_init(y[1] * f[1] - f[5] * x2)
    return (y[0] * f[0] - f[3] * x1 - f[4] * x2, x1, x2)


def _weighted(f, a, b):
    """aᵀ D⁻¹ b."""
    return a[0] * f[0] * b[0] + a[1] * f[1] * b[1] + a[2] * f[2] * b[2]


@traced
def gram(f, a, b) -> tuple:
    """A D⁻¹ Bᵀ of two matrices."""
    return tuple(_weighted(f, a[i : i + 3], b[j : j + 3]) for i in (0, 3, 6) for j in (0, 3, 6))


@traced
def symmetric_gram(f, a) -> tuple:
    """A D⁻¹ Aᵀ, symmetric."""
    return tuple(_weighted(f, a[i : i + 3], a[j : j + 3]) for i in (0, 3, 6) for j in (0, 3, 6) if i <= j)


@traced
def squared(f, a):
    """aᵀ D⁻¹ a."""
    return _weighted(f, a, a)


@traced
def against(f, a, b) -> tuple:
    """A D⁻¹ b."""
    return tuple(_weighted(f, a[i : i + 3], b) for i in (0, 3, 6))
