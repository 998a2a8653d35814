"""The factors M = L D Lᵀ of symmetric 3×3 matrices, (1/d1, 1/d2, 1/d3, l21, l31, l32, …), and what is done with them."""

import taichi as ti
from taichi.lang.impl import expr_init

from doo_ti.physics.tuples import traced


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
