"""Signed distance of a point to an obstacle inside kernels, with its gradient n and second derivatives (docs/contact.md); and
of many points to a closed surface of triangles.

Cylinders and rings are bodies of revolution. In the half plane of a point, with e_r away from the axis and e_z along it,
n = n_r e_r + n_z e_z, and with k the curvature of the profile's parallel curve through the point

    ∇∇φ = k (e_r e_rᵀ + e_z e_zᵀ − n nᵀ) + (n_r/ρ) (I − e_r e_rᵀ − e_z e_zᵀ).

Of a grid n is the gradient of a spline, of about unit length.
"""

import numpy as np
import taichi as ti

from doo_ti.contact.distance_grid import HEADER
from doo_ti.contact.obstacles import BOX, CAPSULE, CYLINDER, GRID, PLANE, RING
from doo_ti.physics.algebra import absolute, applied, largest_of, seen_from, transposed
from doo_ti.physics.number import Layout, device_functions, read
from doo_ti.physics.tuples import chosen, cross, dot, minus, plus, products, put_lane, record, repeated, scaled, traced
from doo_ti.system import runtime

COLUMNS = Layout(point=3, axis_1=3, axis_2=3, axis_3=3, axes=("axis_1", 9), sizes=3, depth=1, friction=1)
"""Of an obstacle, in the order of :mod:`doo_ti.contact.obstacles`."""
SIXTH = 1.0 / 6.0
TINY = 1e-20  # below all squares of distances, against division by zero on an axis


@traced
def outer(a) -> tuple:
    """The matrix a aᵀ."""
    return (a[0] * a[0], a[0] * a[1], a[0] * a[2], a[1] * a[1], a[1] * a[2], a[2] * a[2])


@traced
def clipped(a, most) -> tuple:
    """The items of a, from zero to at most those of ``most``."""
    return tuple(ti.min(ti.max(x, 0.0 * x), y) for x, y in zip(a, most, strict=True))


@traced
def diagonal(a) -> tuple:
    """The symmetric matrix of that diagonal."""
    return (a[0], 0.0 * a[0], 0.0 * a[0], a[1], 0.0 * a[1], a[2])


@traced
def weights(t) -> tuple:
    """The four B-splines of a cell at the place t in it, their first derivatives and their second."""
    u = 1.0 - t
    return ((u * u * u) * SIXTH, (3.0 * t * t * t - 6.0 * t * t + 4.0) * SIXTH, (3.0 * u * u * u - 6.0 * u * u + 4.0) * SIXTH,
            (t * t * t) * SIXTH,
            -0.5 * u * u, 1.5 * t * t - 2.0 * t, 2.0 * u - 1.5 * u * u, 0.5 * t * t,
            u, 3.0 * t - 2.0, 3.0 * u - 2.0, t)


@device_functions
class Distance:
    """φ, n and ∇∇φ for one kind of number, of obstacles of all kinds, of grids only where ``has_grid``: kernels with them take
    longer to compile."""

    def __init__(self, number, has_grid: bool):
        self.tiny, self.has_grid = TINY, has_grid
        self.lane, self.with_lane, self.width, self.scalar = number.lane, number.with_lane, number.width, number.scalar

    def unit(self, normal):
        """A normal over its length, which only of a grid is not one."""
        if ti.static(self.has_grid):
            return scaled(normal, 1.0 / ti.sqrt(dot(normal, normal) + self.tiny))
        else:
            return normal

    def measure(self, own, grids: ti.template(), kind, x):
        """Of an obstacle of that kind with the view ``own`` of its :data:`COLUMNS`: a record of ``value`` φ, ``normal`` n and
        ``curvature`` ∇∇φ (6,) at ``x``. ``grids`` holds the numbers of those that are grids."""
        away = minus(x, own.point)
        zero = 0.0 * away[0]
        seen = record(value=zero, normal=repeated(zero, 3), curvature=repeated(zero, 6))
        if kind == ti.static(BOX):
            self.box(own, away, seen)
        if kind == ti.static(PLANE):
            seen.normal = own.axis_3
            seen.value = dot(away, seen.normal)
        if ti.static(self.has_grid):
            if kind >= ti.static(GRID):
                self.grid(own, grids, kind - GRID, away, seen)
        if kind == ti.static(CAPSULE):
            self.capsule(own, away, seen)
        if kind == ti.static(RING) or kind == ti.static(CYLINDER):
            self.revolved(own, kind, away, seen)
        return seen

    def revolved(self, own, kind, away, seen):
        """A cylinder or a ring."""
        axis = own.axis_3
        z = dot(away, axis)
        zero, one = 0.0 * z, 0.0 * z + 1.0
        flat = minus(away, scaled(axis, z))
        radial = ti.sqrt(dot(flat, flat) + self.tiny)
        outward = scaled(flat, 1.0 / radial)
        a, b = own.sizes[0], own.sizes[1]
        profile = record(value=z, r=zero, z=one, bend=zero, around=zero)
        if kind == ti.static(RING):
            self.rim(profile, radial - a, z, radial)
            profile.value = profile.value - b
        if kind == ti.static(CYLINDER):
            upward = ti.select(z < 0.0, 0.0 - one, one)
            side, cap = radial - a, upward * z - b
            self.rim(profile, side, cap, radial)
            beyond = (side > 0.0) & (cap > 0.0)
            lateral = side >= cap
            r = ti.select(lateral, one, zero)
            profile.value = ti.select(beyond, profile.value, ti.max(side, cap))
            profile.r = ti.select(beyond, profile.r, r)
            profile.z = upward * ti.select(beyond, profile.z, 1.0 - r)
            profile.bend = ti.select(beyond, profile.bend, zero)
            profile.around = profile.r / radial
        seen.value = profile.value
        seen.normal = plus(scaled(outward, profile.r), scaled(axis, profile.z))
        meridian = plus(outer(outward), outer(axis))
        bent = minus(scaled(meridian, profile.bend - profile.around), scaled(outer(seen.normal), profile.bend))
        seen.curvature = (bent[0] + profile.around, bent[1], bent[2], bent[3] + profile.around, bent[4],
                          bent[5] + profile.around)

    def capsule(self, own, away, seen):
        """A capsule: all around the nearest point of its axis. Between its ends that point moves along the axis."""
        axis = own.axis_3
        a, b = own.sizes[0], own.sizes[1]
        z = dot(away, axis)
        from_axis = minus(away, scaled(axis, ti.min(ti.max(z, 0.0 - b), b)))
        length = ti.sqrt(dot(from_axis, from_axis) + self.tiny)
        bend = 1.0 / length
        seen.value, seen.normal = length - a, scaled(from_axis, bend)
        along = ti.select(absolute(z) < b, bend, 0.0 * bend)
        bent = plus(scaled(outer(seen.normal), bend), scaled(outer(axis), along))
        seen.curvature = (bend - bent[0], 0.0 - bent[1], 0.0 - bent[2], bend - bent[3], 0.0 - bent[4], bend - bent[5])

    def rim(self, profile, beside, above, radial):
        """The distance to a circle about the axis, ``beside`` and ``above`` which the point lies."""
        length = ti.sqrt(beside * beside + above * above + self.tiny)
        profile.value, profile.r, profile.z = length, beside / length, above / length
        profile.bend, profile.around = 1.0 / length, beside / (length * radial)

    def box(self, own, away, seen):
        """Signed distance of a box."""
        zero, one = 0.0 * away[0], 0.0 * away[0] + 1.0
        square, most = zero, zero - 1e30
        axes = (own.axis_1, own.axis_2, own.axis_3)
        for k in ti.static(range(3)):
            z = dot(away, axes[k])
            beyond = absolute(z) - own.sizes[k]
            most = largest_of(most, beyond)
            square = square + ti.select(beyond > 0.0, beyond * beyond, zero)
        outside = square > 0.0
        length = ti.sqrt(square + self.tiny)
        seen.value = ti.select(outside, length, most)
        for k in ti.static(range(3)):
            axis = axes[k]
            z = dot(away, axis)
            beyond = absolute(z) - own.sizes[k]
            share = ti.select(outside, ti.max(beyond, zero) / length, ti.select(beyond >= most, one, zero))
            seen.normal = plus(seen.normal, scaled(axis, share * ti.select(z < 0.0, 0.0 - one, one)))
            # The nearest point of the box moves along the faces that the point does not look past.
            seen.curvature = plus(seen.curvature, scaled(outer(axis), ti.select(outside & (beyond > 0.0), 1.0 / length, zero)))
        bent = ti.select(outside, 1.0 / length, zero)
        seen.curvature = minus(seen.curvature, scaled(outer(seen.normal), bent))

    def last(self, grids: ti.template(), index, k: ti.template()):
        """The largest place along an axis of a grid."""
        return ti.cast(grids[HEADER * index + 1 + k] - 3.0, self.scalar)

    def grid(self, own, grids: ti.template(), index, away, seen):
        """A grid, by its spline at the nearest point of its box, which lies ``beyond`` that."""
        spacing = own.sizes[0]
        zero, one = 0.0 * spacing, 0.0 * spacing + 1.0
        axes = own.axes
        exact = scaled(applied(axes, away), 1.0 / spacing)
        last = (zero + self.last(grids, index, 0), zero + self.last(grids, index, 1), zero + self.last(grids, index, 2))
        place = clipped(exact, last)
        beyond = scaled(minus(exact, place), spacing)
        inside = (ti.select(beyond[0] == zero, one, zero), ti.select(beyond[1] == zero, one, zero),
                  ti.select(beyond[2] == zero, one, zero))
        found = self.look_up(grids, index, place)
        value, square = spacing * found.value, dot(beyond, beyond)
        outside = square > 0.0
        whole = ti.sqrt(value * value + square + self.tiny)
        flat = products(found.slope, inside)
        slant = scaled(plus(scaled(flat, value), beyond), 1.0 / whole)
        bend = scaled(found.bend, 1.0 / spacing)
        # Of φ² half the second derivatives, along the box's faces and away from them.
        half = plus(plus(outer(flat), scaled(products(bend, outer(inside)), value)), diagonal(minus(repeated(one, 3), inside)))
        slanting = scaled(minus(half, outer(slant)), 1.0 / whole)
        seen.value = ti.select(outside, whole, value)
        seen.normal = applied(transposed(axes), chosen(outside, slant, found.slope))
        seen.curvature = seen_from((axes[0::3], axes[1::3], axes[2::3]), chosen(outside, slanting, bend))

    def look_up(self, grids: ti.template(), index, place):
        """The spline of grid ``index`` at ``place``, which is inside it, in its axes and in spacings from its first point: a
        record of ``value``, over the spacing, ``slope`` (3,) and ``bend`` (6,), first and second derivatives by ``place``."""
        zero = 0.0 * place[0]
        found = record(value=zero, slope=repeated(zero, 3), bend=repeated(zero, 6))
        first = ti.cast(grids[HEADER * index], ti.i32)
        counts = record(x=ti.cast(grids[HEADER * index + 1], ti.i32), y=ti.cast(grids[HEADER * index + 2], ti.i32),
                        z=ti.cast(grids[HEADER * index + 3], ti.i32))
        for slot in range(self.width):
            x, y, z = self.lane(place[0], slot), self.lane(place[1], slot), self.lane(place[2], slot)
            # A lane without a rod may hold any number.
            i = ti.max(ti.min(ti.cast(x, ti.i32), counts.x - 4), 0)
            j = ti.max(ti.min(ti.cast(y, ti.i32), counts.y - 4), 0)
            k = ti.max(ti.min(ti.cast(z, ti.i32), counts.z - 4), 0)
            corner = first + (i * counts.y + j) * counts.z + k
            whole = self.sums(grids, corner, counts, (x - i, y - j, z - k))
            put_lane(found, self.with_lane, slot, value=whole.value, slope=whole.slope, bend=whole.bend)
        return found

    def sums(self, grids: ti.template(), corner, counts, t):
        """The sums over the 64 B-splines that are not zero at the place ``t`` of a cell, in one lane."""
        zero = 0.0 * t[0]
        x, y, wz = weights(t[0]), weights(t[1]), weights(t[2])
        # As vectors and by loops, which compile in half the time and are as fast.
        wx, wy = ti.Vector([x[k] for k in range(12)]), ti.Vector([y[k] for k in range(12)])
        whole = record(value=zero, slope=repeated(zero, 3), bend=repeated(zero, 6))
        for i in range(4):
            plane = record(v=zero, y=zero, z=zero, yy=zero, yz=zero, zz=zero)
            for j in range(4):
                line = corner + (i * counts.y + j) * counts.z
                c = (ti.cast(grids[line], self.scalar), ti.cast(grids[line + 1], self.scalar),
                     ti.cast(grids[line + 2], self.scalar), ti.cast(grids[line + 3], self.scalar))
                v = wz[0] * c[0] + wz[1] * c[1] + wz[2] * c[2] + wz[3] * c[3]
                z = wz[4] * c[0] + wz[5] * c[1] + wz[6] * c[2] + wz[7] * c[3]
                zz = wz[8] * c[0] + wz[9] * c[1] + wz[10] * c[2] + wz[11] * c[3]
                plane.v = plane.v + wy[j] * v
                plane.y = plane.y + wy[4 + j] * v
                plane.z = plane.z + wy[j] * z
                plane.yy = plane.yy + wy[8 + j] * v
                plane.yz = plane.yz + wy[4 + j] * z
                plane.zz = plane.zz + wy[j] * zz
            w, d, b = wx[i], wx[4 + i], wx[8 + i]
            whole.value = whole.value + w * plane.v
            whole.slope = plus(whole.slope, (d * plane.v, w * plane.y, w * plane.z))
            whole.bend = plus(whole.bend, (b * plane.v, d * plane.y, d * plane.z, w * plane.yy, w * plane.yz, w * plane.zz))
        return whole


# --- a closed surface of triangles ------------------------------------------------------------------------------------------


@runtime.exclusive
def signed_distances(corners: np.ndarray, first: np.ndarray, spacing: float, counts: np.ndarray) -> np.ndarray:
    """(X, Y, Z) mm, negative inside, of a grid's points from the closed surface of triangles with ``corners`` (M, 3, 3).

    Points next to each other are on one side where their distances add to more than the spacing. Of each set of points on one
    side the winding number of one is computed (van Oosterom and Strackee, 1983).
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    runtime.start()
    points = first + spacing * np.indices(counts).reshape(3, -1).T
    corners, middles = np.ascontiguousarray(corners), corners.mean(axis=1)
    radii = np.linalg.norm(corners - middles[:, None], axis=-1).max(axis=1)
    distance, number = np.empty(len(points)), np.arange(len(points)).reshape(counts)
    _unsigned(points, corners, middles, radii, distance)
    pairs = [np.stack([np.delete(number, end, axis).ravel() for end in (-1, 0)], axis=1) for axis in range(3)]
    pairs = np.concatenate(pairs)
    pairs = pairs[distance[pairs].sum(axis=1) > spacing]
    graph = coo_array((np.ones(len(pairs), dtype=bool), pairs.T), shape=(len(points), len(points)))
    side = connected_components(graph, directed=False)[1]
    _, one = np.unique(side, return_index=True)
    winding = np.empty(len(one))
    _winding(points[one], corners, winding)
    return np.where(np.abs(winding) > 0.5, -1.0, 1.0)[side].reshape(counts) * distance.reshape(counts)


@runtime.kernel
def _unsigned(
    points: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [point, 3]
    corners: ti.types.ndarray(dtype=ti.f64, ndim=3),  # [triangle, 3, 3]
    middles: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [triangle, 3]
    radii: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [triangle] of the sphere about its middle
    distance: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [point] out
):
    for i in range(points.shape[0]):
        p = read(points, i, 0)
        least = ti.cast(1e300, ti.f64)
        for m in range(corners.shape[0]):
            if ti.sqrt(_square(p, read(middles, m, 0))) - radii[m] < least:
                a, b, c = read(corners, m, 0, 0), read(corners, m, 1, 0), read(corners, m, 2, 0)
                least = ti.min(least, ti.sqrt(_square_to_triangle(p, a, b, c)))
        distance[i] = least


@ti.func
def _square(a, b):
    d = minus(a, b)
    return dot(d, d)


@ti.func
def _square_to_triangle(p, a, b, c):
    """mm², the square of the distance of p from a triangle: from its plane where p is above its inside, else from its edges."""
    n = cross(minus(b, a), minus(c, a))
    area = dot(n, n)
    inside, square = area > 0.0, ti.cast(1e300, ti.f64)
    for k in ti.static(range(3)):
        start, end = ((a, b), (b, c), (c, a))[k]
        along, off = minus(end, start), minus(p, start)
        inside = inside and dot(cross(n, along), off) >= 0.0
        share = ti.min(ti.max(dot(off, along) / ti.max(dot(along, along), TINY), 0.0), 1.0)
        square = ti.min(square, _square(off, scaled(along, share)))
    height = dot(minus(p, a), n)
    return ti.select(inside, height * height / ti.max(area, TINY), square)


@runtime.kernel
def _winding(
    points: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [point, 3]
    corners: ti.types.ndarray(dtype=ti.f64, ndim=3),  # [triangle, 3, 3]
    winding: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [point] out
):
    for i in range(points.shape[0]):
        p = read(points, i, 0)
        total = ti.cast(0.0, ti.f64)
        for m in range(corners.shape[0]):
            a, b, c = minus(read(corners, m, 0, 0), p), minus(read(corners, m, 1, 0), p), minus(read(corners, m, 2, 0), p)
            la, lb, lc = ti.sqrt(dot(a, a)), ti.sqrt(dot(b, b)), ti.sqrt(dot(c, c))
            total += ti.atan2(dot(a, cross(b, c)), la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb)
        winding[i] = total / (2.0 * np.pi)
