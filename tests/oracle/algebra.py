"""Hyper-dual numbers: first and second derivatives exact to rounding, by arithmetic alone.

A number is a + b ε₁ + c ε₂ + d ε₁ε₂ with ε₁² = ε₂² = 0. Seeding ε₁ along variable k and ε₂ along variable l makes
b = ∂f/∂x_k, c = ∂f/∂x_l and d = ∂²f/∂x_k∂x_l. The four parts are arrays, so one evaluation yields a whole Hessian.

Vectors and quaternions as plain sequences of numbers, so that floats, complex and hyper-dual numbers all pass.
No conjugation anywhere: with complex entries the functions are analytic, as complex-step derivatives need.
"""

import numpy as np


class HyperDual:
    """a + b ε₁ + c ε₂ + d ε₁ε₂; parts are floats or arrays that broadcast."""

    __slots__ = ("value", "first", "second", "mixed")
    __array_ufunc__ = None  # so that ndarray * HyperDual comes here instead of making an object array

    def __init__(self, value, first=0.0, second=0.0, mixed=0.0):
        self.value, self.first, self.second, self.mixed = value, first, second, mixed

    def compose(self, value, slope, curvature):
        """g(self), from g, g' and g'' at ``self.value``."""
        return HyperDual(value, slope * self.first, slope * self.second,
                         slope * self.mixed + curvature * self.first * self.second)

    def __neg__(self):
        return HyperDual(-self.value, -self.first, -self.second, -self.mixed)

    def __add__(self, other):
        o = _lift(other)
        return HyperDual(self.value + o.value, self.first + o.first, self.second + o.second, self.mixed + o.mixed)

    def __mul__(self, other):
        o = _lift(other)
        return HyperDual(
            self.value * o.value, self.value * o.first + self.first * o.value, self.value * o.second + self.second * o.value,
            self.value * o.mixed + self.first * o.second + self.second * o.first + self.mixed * o.value)

    def __sub__(self, other):
        return self + (-other)

    def __rsub__(self, other):
        return (-self) + other

    def __truediv__(self, other):
        return self * (1.0 / other)

    def __rtruediv__(self, other):
        inverse = 1.0 / self.value
        return other * self.compose(inverse, -(inverse**2), 2.0 * inverse**3)

    __radd__, __rmul__ = __add__, __mul__


def _lift(number) -> HyperDual:
    return number if isinstance(number, HyperDual) else HyperDual(number)


def seeds(variables: int) -> list[HyperDual]:
    """Zeros with ε₁ on axis −2 and ε₂ on axis −1: ``f(x + seeds)`` then holds the (..., n, n) Hessian."""
    return [HyperDual(0.0, unit[:, None], unit) for unit in np.eye(variables)]


def gradient_and_hessian(number: HyperDual, shape: tuple, variables: int) -> tuple[np.ndarray, np.ndarray]:
    """(..., n) gradient and (..., n, n) Hessian of a number that was computed from :func:`seeds`."""
    first = np.broadcast_to(number.first, (*shape, variables, variables))
    return first[..., 0].copy(), np.broadcast_to(number.mixed, (*shape, variables, variables)).copy()


def real(number):
    """The real value that decides a branch, of a float, complex or hyper-dual number."""
    return np.real(number.value if isinstance(number, HyperDual) else number)


def sqrt(number):
    """Square root of a float, complex or hyper-dual number with a positive real value."""
    if not isinstance(number, HyperDual):
        return np.sqrt(number)
    root = np.sqrt(number.value)
    return number.compose(root, 0.5 / root, -0.25 / root**3)


def arctan(number):
    """Arc tangent of a float, complex or hyper-dual number."""
    if not isinstance(number, HyperDual):
        return np.arctan(number)
    slope = 1.0 / (1.0 + number.value**2)
    return number.compose(np.arctan(number.value), slope, -2.0 * number.value * slope**2)


def choose(condition, yes, no):
    """Elementwise ``yes`` where ``condition`` holds, else ``no``."""
    if not isinstance(yes, HyperDual) and not isinstance(no, HyperDual):
        return np.where(condition, yes, no)
    yes, no = _lift(yes), _lift(no)
    return HyperDual(*(np.where(condition, getattr(yes, part), getattr(no, part)) for part in HyperDual.__slots__))


def angle(sine, cosine):
    """atan2(sine, cosine) with derivatives, in (−π, π]; any common positive factor cancels."""
    steep = abs(real(sine)) > abs(real(cosine))
    # Divide by the larger of the two; the other quotient is never used, so its divisor only has to be nonzero.
    flat_part = arctan(sine / choose(steep, 1.0, cosine))
    steep_part = -arctan(cosine / choose(steep, sine, 1.0))
    turn = np.where(real(sine) >= 0, np.pi, -np.pi)
    offset = np.where(steep, 0.5 * turn, np.where(real(cosine) < 0, turn, 0.0))
    return choose(steep, steep_part, flat_part) + offset


def dot(a, b):
    return sum(x * y for x, y in zip(a, b, strict=True))


def cross(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def scale(factor, a):
    return [factor * x for x in a]


def add(*vectors):
    return [sum(parts) for parts in zip(*vectors, strict=True)]


def normalise(a):
    return scale(1.0 / sqrt(dot(a, a)), a)


def product(a, b):
    """Hamilton product of two quaternions, scalar first."""
    vector = add(scale(a[0], b[1:]), scale(b[0], a[1:]), cross(a[1:], b[1:]))
    return [a[0] * b[0] - dot(a[1:], b[1:]), *vector]


def conjugate(q):
    return [q[0], -q[1], -q[2], -q[3]]


def directors(q):
    """t, m1, m2: the columns of the rotation R(q), by rotating the three axes one after the other."""
    axes = ([0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0])
    return [product(product(q, axis), conjugate(q))[1:] for axis in axes]


def body_rotated(q, w):
    """normalise(Q ⊗ (1, w/2)): the rotation vector w of docs/chain.md."""
    return normalise(product(q, [1.0, *scale(0.5, w)]))


def spun_and_tilted(q, w):
    """Q spun about its tangent by w_0, then tilted by (w_1, w_2), as in docs/chain.md: normalise(Q ⊗ tilt ⊗ spin)."""
    spin, *tilt = scale(0.5, w)
    return normalise(product(product(q, [1.0, 0.0, *tilt]), [1.0, spin, 0.0, 0.0]))


def transport(source, target, vector):
    """P(vector), P the smallest rotation with P(source) = target, unit vectors (§III-C)."""
    axis, cosine = cross(source, target), dot(source, target)
    return add(scale(cosine, vector), cross(axis, vector), scale(dot(axis, vector) / (1.0 + cosine), axis))
