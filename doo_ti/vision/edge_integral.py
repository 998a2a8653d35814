"""E_proj of an edge in kernels: the distance to the nearest detected point, integrated along its image (§IV-A).

With p(x) the distorted image of a point, v = ∂p/∂x Δ its motion along the edge Δ and D the distance map,

    E_proj = ∫ D(p) |v| ds ≈ (1/n) Σ_k D(p_k) |v_k|   at n places s_k = (k − ½)/n along the edge:

the mean distance in px times the length of the image in px. D is capped smoothly, D/√(1 + D²/cap²), so that a gap in the
detection costs a limited energy.

At a place y in the camera's axes the integrand is F m/y3, with F(X, Y) the capped distance at the image of y and m = |A w| the
length of the edge's image there, A the lens' Jacobian in px and w = (d1 − X d3, d2 − Y d3). All derivatives are taken by
(X, Y, 1/y3) and by w first. Derivatives in the image plane are totally symmetric: those of order k are k + 1 numbers, (1…11,
1…12, …, 2…22).
"""

import taichi as ti

from doo_ti.physics import tuples
from doo_ti.physics.algebra import full, largest_of
from doo_ti.physics.number import device_functions
from doo_ti.physics.tuples import itemwise, picked, record, repeated, unevaluated
from doo_ti.vision.sampling import (
    CAMERA_COLUMNS,
    WINDOW_COLUMNS,
    MapSampling,
    Projection,
    bent,
    bent_curvature,
    bent_slope,
    bent_third,
)

# Columns of the numbers of a set and a camera: the camera's, the window's, then how to integrate.
WINDOW = CAMERA_COLUMNS
POINTS = WINDOW + WINDOW_COLUMNS
INVERSE_CAP = POINTS + 1  # 1/cap², px⁻²
REACH = POINTS + 2  # px: see :meth:`EdgeIntegral.moments`
COLUMNS = POINTS + 3
CREASE = 13 / 32
"""px: the spline's value of |x| at x = 0, on average over places between pixels. It is subtracted; otherwise a perfect image
would cost in proportion to its length, and rods would gain by making their images shorter."""
UNSEEN = 1e5  # px²: constant cost of an edge behind a camera
SLOWEST = 1e-6  # px: least length of an edge's image, for edges that point at the camera


# Here most numbers are used once: they are evaluated where they get a name.
plus, minus, scaled, products, chosen = (
    unevaluated(function) for function in (tuples.plus, tuples.minus, tuples.scaled, tuples.products, tuples.chosen))


@picked
def added(total, terms) -> tuple:
    """``total`` + ``terms``, for ``total`` itself."""
    return itemwise(*plus(total, terms))


# --- in the image plane -----------------------------------------------------------------------------------------------

@picked
def contracted(t, v) -> tuple:
    """Σ_i t_i… v_i: a derivative along v, of one order less."""
    return tuple(v[0] * t[k] + v[1] * t[k + 1] for k in range(len(t) - 1))


@picked
def square_of(v, s) -> tuple:
    """s v vᵀ, symmetric."""
    return (s * v[0] * v[0], s * v[0] * v[1], s * v[1] * v[1])


@picked
def twice_symmetric(a, b) -> tuple:
    """a bᵀ + b aᵀ."""
    return (2.0 * a[0] * b[0], a[0] * b[1] + a[1] * b[0], 2.0 * a[1] * b[1])


@picked
def dyad(a, b) -> tuple:
    """a bᵀ, row by row."""
    return (a[0] * b[0], a[0] * b[1], a[1] * b[0], a[1] * b[1])


@picked
def square(s) -> tuple:
    """A symmetric matrix row by row."""
    return (s[0], s[1], s[1], s[2])


@picked
def congruent(c, j) -> tuple:
    """J C J of symmetric matrices."""
    return (
        j[0] * (c[0] * j[0] + 2.0 * c[1] * j[1]) + c[2] * j[1] * j[1],
        j[0] * (c[0] * j[1] + c[1] * j[2]) + j[1] * (c[1] * j[1] + c[2] * j[2]),
        j[1] * (c[0] * j[1] + 2.0 * c[1] * j[2]) + c[2] * j[2] * j[2],
    )


@ti.func
def convex(second):
    """The positive semidefinite part of a symmetric matrix."""
    middle = 0.5 * (second[0] + second[2])
    half = 0.5 * (second[0] - second[2])
    root = ti.sqrt(half * half + second[1] * second[1])
    none = 0.0 * middle
    high = largest_of(middle + root, none)
    low = largest_of(middle - root, none)
    share = ti.select(root > 0.0, 0.5 * (high - low) / ti.select(root > 0.0, root, none + 1.0), none)
    mean = 0.5 * (high + low)
    return (mean + share * half, share * second[1], mean - share * half)


# --- from the image plane to points in space: X = y1/y3, Y = y2/y3, and w = (d1 − X d3, d2 − Y d3) ----------------------------

@picked
def by_point(e, rest, x, inverse) -> tuple:
    """A first derivative by y of one by (X, Y), ``rest`` that by 1/y3 times 1/y3."""
    return (inverse * e[0], inverse * e[1], 0.0 - inverse * (x[0] * e[0] + x[1] * e[1] + rest))


@ti.func
def twice_by_point(form, mixed, slope, x, inverse):
    """A second derivative by (X, Y, 1/y3) as one by the point y, six numbers.

    ``form`` (11, 12, 22) in (X, Y), ``mixed`` (13, 23) with 1/y3, where it has no curvature of its own; ``slope`` the
    first derivatives.
    """
    scale = inverse * inverse
    a = x[0] * form[0] + x[1] * form[1] + inverse * mixed[0]
    b = x[0] * form[1] + x[1] * form[2] + inverse * mixed[1]
    c = x[0] * a + x[1] * b + inverse * (x[0] * mixed[0] + x[1] * mixed[1])
    d = 2.0 * (x[0] * slope[0] + x[1] * slope[1] + inverse * slope[2])
    return (scale * form[0], scale * form[1], 0.0 - scale * (a + slope[0]),
            scale * form[2], 0.0 - scale * (b + slope[1]), scale * (c + d))


@picked
def twice_by_direction(b, x) -> tuple:
    """A second derivative by w as one by d, six numbers."""
    b02 = 0.0 - x[0] * b[0] - x[1] * b[1]
    b12 = 0.0 - x[0] * b[1] - x[1] * b[2]
    return (b[0], b[1], b02, b[2], b12, 0.0 - x[0] * b02 - x[1] * b12)


@ti.func
def by_point_and_direction(a, steady, along, x, inverse):
    """The derivative by y and d, nine numbers, of one by (X, Y) and w, ``a``; ``steady`` along is that by w alone."""
    a00, a01, a10, a11 = a
    a02 = 0.0 - x[0] * a00 - x[1] * a01 - steady * along[0]
    a12 = 0.0 - x[0] * a10 - x[1] * a11 - steady * along[1]
    return (inverse * a00, inverse * a01, inverse * a02, inverse * a10, inverse * a11, inverse * a12,
            0.0 - inverse * (x[0] * a00 + x[1] * a10 + steady * along[0]),
            0.0 - inverse * (x[0] * a01 + x[1] * a11 + steady * along[1]),
            0.0 - inverse * (x[0] * a02 + x[1] * a12 - steady * (x[0] * along[0] + x[1] * along[1])))


@picked
def mixed_moments(k, n, s) -> tuple:
    """s K + N: of the edge's start by its direction, nine numbers."""
    return tuple(s * a + b for a, b in zip(full(k), n, strict=True))


@picked
def direction_moments(k, n, m, s) -> tuple:
    """s² K + s (N + Nᵀ) + M: of the edge's direction, symmetric."""
    return (
        s * (s * k[0] + 2.0 * n[0]) + m[0],
        s * (s * k[1] + n[1] + n[3]) + m[1],
        s * (s * k[2] + n[2] + n[6]) + m[2],
        s * (s * k[3] + 2.0 * n[4]) + m[3],
        s * (s * k[4] + n[5] + n[7]) + m[4],
        s * (s * k[5] + 2.0 * n[8]) + m[5],
    )


@device_functions
class EdgeIntegral:
    """E_proj of edges for one kind of number, and its derivatives.

    Its functions take a record ``view`` (:meth:`view`) of what camera c sees in the images of each rod's set:

    numbers, values  the table (A, C, COLUMNS) and the maps' distances
    row, c           each rod's set, and the camera
    lens, frame      the camera's, and the window of each rod's map
    inverse_cap, reach

    and the edge's start a and direction d in the camera's axes.
    """

    def __init__(self, number):
        self.projection = Projection(number)
        self.sampling = MapSampling(number, WINDOW)
        self.scalar = number.scalar

    def view(self, numbers: ti.template(), values: ti.template(), row, c):
        return record(
            numbers=numbers, values=values, row=row, c=c, lens=self.projection.lens(numbers, c),
            frame=self.sampling.window(numbers, row, c), inverse_cap=ti.cast(numbers[0, 0, INVERSE_CAP], self.scalar),
            reach=ti.cast(numbers[0, 0, REACH], self.scalar))

    def places(self, view):
        """(n, 1/n)."""
        points = view.numbers[0, 0, POINTS]
        return ti.cast(points, ti.i32), ti.cast(1.0 / points, self.scalar)

    def error(self, view, a, d):
        """(E_proj, share of the edge that is not seen)."""
        zero = 0.0 * view.row
        total, hidden = (zero, zero)
        points, step = self.places(view)
        s = 0.5 * step
        for _ in range(points):
            x0, x1, inverse, seen = self.projection.normalised(view.lens, plus(a, scaled(d, s)))
            pixel, slope = bent(view.lens, x0, x1), bent_slope(view.lens, x0, x1)
            far = self.sampling.value(view.values, view.numbers, view.row, view.c, view.frame, pixel) - CREASE
            speed = self.projection.speed(view.lens, slope, x0, x1, inverse, d)
            cost = far * speed / ti.sqrt(1.0 + view.inverse_cap * far * far)
            total = total + ti.select(seen, cost, zero + UNSEEN)
            hidden = hidden + ti.select(seen, zero, zero + 1.0)
            s += step
        return step * total, step * hidden

    def length(self, view, x, j, t, d):
        """The record of m = |A w| under the lens' first and second derivatives j and t at x.

        Its value and 1/m, its slope and curvature by (X, Y), its derivative by w, ``along``, of which those by (X, Y) are
        1/m swing acrossᵀ + turn, and ``across``, of which the second derivative by w is 1/m across acrossᵀ.
        """
        focal = (view.lens[0], view.lens[1])
        w = (d[0] - x[0] * d[2], d[1] - x[1] * d[2])
        v = products(focal, contracted(j, w))
        m = largest_of(ti.sqrt(v[0] * v[0] + v[1] * v[1]), 0.0 * v[0] + SLOWEST)
        slower = 1.0 / m
        # The image's direction and the one across it, in px of the lens' bent coordinates.
        u = (focal[0] * v[0] * slower, focal[1] * v[1] * slower)
        n = (0.0 - focal[0] * v[1] * slower, focal[1] * v[0] * slower)
        along, across = contracted(j, u), contracted(j, n)
        turn, turn_across = contracted(t, u), contracted(t, n)
        swing = minus(contracted(turn_across, w), scaled(across, d[2]))
        third = contracted(bent_third(view.lens, x[0], x[1]), u)
        return record(
            value=m, slower=slower, slope=minus(contracted(turn, w), scaled(along, d[2])),
            curvature=plus(minus(contracted(third, w), scaled(turn, 2.0 * d[2])), square_of(swing, slower)),
            along=along, across=across, turn=turn, swing=swing)

    def distance(self, view, x, j, t, coarse):
        """The record of F, the capped distance at x = (X, Y), with its first and second derivatives; j and t as above."""
        focal = (view.lens[0], view.lens[1])
        smoothed, slope, second = self.sampling.derivatives(
            view.values, view.numbers, view.row, view.c, view.frame, bent(view.lens, x[0], x[1]))
        far = smoothed - CREASE
        shrink = 1.0 / (1.0 + view.inverse_cap * far * far)
        root = ti.sqrt(shrink)
        steep = shrink * root
        fade = 0.0 - 3.0 * view.inverse_cap * far * shrink * steep
        s = (focal[0] * steep * slope[0], focal[1] * steep * slope[1])
        part = convex(second)
        grade = slope[0] * slope[0] + slope[1] * slope[1] + 1e-12
        own = slope[0] * slope[0] * part[0] + slope[1] * slope[1] * part[2]
        own = (own + 2.0 * slope[0] * slope[1] * part[1]) / grade
        more = largest_of(1.0 / largest_of(far, 0.0 * far + view.reach) - own, 0.0 * far) * steep / grade
        rank = ti.select(coarse > 0.5, more, fade)
        c = products((focal[0] * focal[0], focal[0] * focal[1], focal[1] * focal[1]),
                     plus(scaled(chosen(coarse > 0.5, part, second), steep), square_of(slope, rank)))
        return record(value=far * root, slope=contracted(j, s),
                      curvature=plus(congruent(c, j), scaled(contracted(t, s), 1.0 - coarse)))

    def place(self, view, y, d, coarse):
        """F m/y3 with its derivatives by y and d: (E, ∂y, ∂d, ∂yy, ∂yd, ∂dd, whether it is seen)."""
        x0, x1, inverse, seen = self.projection.normalised(view.lens, y)
        x = (x0, x1)
        j, t = bent_slope(view.lens, x0, x1), bent_curvature(view.lens, x0, x1)
        m, f = self.length(view, x, j, t, d), self.distance(view, x, j, t, coarse)
        fine = 1.0 - coarse
        rise = fine * inverse
        # F m by (X, Y), and with 1/y3.
        i = plus(scaled(f.slope, m.value), scaled(m.slope, f.value))
        e = scaled(i, inverse)
        form = scaled(plus(scaled(f.curvature, m.value), scaled(
            plus(twice_symmetric(f.slope, m.slope), scaled(m.curvature, f.value)), fine)), inverse)
        gradient_y = by_point(e, inverse * f.value * m.value, x, inverse)
        curvature_yy = twice_by_point(form, scaled(i, fine), scaled(e, fine) + (fine * f.value * m.value,), x, inverse)
        g = inverse * f.value
        gradient_d = (g * m.along[0], g * m.along[1], 0.0 - g * (x0 * m.along[0] + x1 * m.along[1]))
        swing = scaled(m.swing, m.slower)
        turning = plus(dyad(swing, m.across), square(m.turn))
        a = scaled(plus(dyad(f.slope, m.along), scaled(turning, f.value)), rise)
        curvature_yd = by_point_and_direction(a, rise * f.value, m.along, x, inverse)
        curvature_dd = twice_by_direction(square_of(m.across, g * m.slower), x)
        return g * m.value, gradient_y, gradient_d, curvature_yy, curvature_yd, curvature_dd, seen

    def moments(self, view, a, d, coarse):
        """The record of E_proj and the moments (Σ γ, Σ s γ, Σ K, Σ s K, Σ s² K) of its derivatives, in the camera's axes.

        Where ``coarse`` is zero all are exact, of the B-spline; Σ s K, by the edge's start and direction, is not symmetric.
        Where it is one, K is positive semidefinite: the convex part of D, and of the length by the edge's direction. Off its
        crease D grows linearly and has no curvature along its gradient: there K has 1/D instead, from ``REACH`` px up, whose
        Newton step ends on the crease.
        """
        zero = 0.0 * view.row
        found = no_moments(zero)
        points, step = self.places(view)
        s = 0.5 * step
        for _ in range(points):
            e, y, z, k, n, m, seen = self.place(view, plus(a, scaled(d, s)), d, coarse)
            weight = ti.select(seen, zero + step, zero)
            found.energy = found.energy + ti.select(seen, step * e, zero + step * UNSEEN)
            found.gradient = added(found.gradient, scaled(y, weight))
            found.gradient_s = added(found.gradient_s, scaled(plus(scaled(y, s), z), weight))
            found.curvature = added(found.curvature, scaled(k, weight))
            found.curvature_s = added(found.curvature_s, scaled(mixed_moments(k, n, s), weight))
            found.curvature_ss = added(found.curvature_ss, scaled(direction_moments(k, n, m, s), weight))
            s += step
        return found


@ti.func
def add_turned_back(total, seen, camera: ti.template(), numbers: ti.template(), c):
    """Add the record ``seen`` of an energy and its moments in the axes of camera c to ``total``, in the world's."""
    total.energy = total.energy + seen.energy
    total.gradient = added(total.gradient, camera.turned_back(numbers, c, seen.gradient))
    total.gradient_s = added(total.gradient_s, camera.turned_back(numbers, c, seen.gradient_s))
    total.curvature = added(total.curvature, camera.form_turned_back(numbers, c, seen.curvature))
    total.curvature_s = added(total.curvature_s, camera.matrix_turned_back(numbers, c, seen.curvature_s))
    total.curvature_ss = added(total.curvature_ss, camera.form_turned_back(numbers, c, seen.curvature_ss))


@picked
def weighted(total, nu) -> tuple:
    """An energy and its moments times ν, as :class:`doo_ti.relaxation.external.ExternalFunctions` wants them."""
    return (nu * total.energy, scaled(total.gradient, nu), scaled(total.gradient_s, nu), scaled(total.curvature, nu),
            scaled(total.curvature_s, nu), scaled(total.curvature_ss, nu))


@picked
def no_moments(zero):
    """The record of an energy and the moments of its derivatives, all zero."""
    return record(energy=zero, gradient=repeated(zero, 3), gradient_s=repeated(zero, 3), curvature=repeated(zero, 6),
                  curvature_s=repeated(zero, 9), curvature_ss=repeated(zero, 6))
