"""The distorted camera on the device: pixels of points, and how they change with the points (§V-A).

A point y = R x + t in a camera's axes has the normalised image (X, Y) = (y1, y2)/y3, which the lens bends to b(X, Y). The
Jacobian of b is symmetric, and so is its second derivative in all three places: both are derivatives of one potential.
"""

from types import SimpleNamespace

import numpy as np
import taichi as ti

from doo_ti.physics.tuples import dot
from doo_ti.vision.rig import Rig

# Columns of a camera: focal lengths and principal point in px, the distortion, the square X² + Y² up to which the lens maps
# outwards, R by rows and t in mm.
FOCAL, CENTRE, DISTORTION, WIDEST, ROTATION, TRANSLATION, CAMERA_COLUMNS = 0, 2, 4, 9, 10, 19, 22
NEAREST = 1.0
"""mm: what is less deep is not seen."""
WIDEST_OF_ALL = 100.0
"""X² + Y² of no lens is more: 84° off the axis."""


def camera_table(rig: Rig) -> np.ndarray:
    """(C, CAMERA_COLUMNS) float64: see the columns' names."""
    table = np.empty((len(rig.cameras), CAMERA_COLUMNS))
    for row, camera in zip(table, rig.cameras):
        row[FOCAL : FOCAL + 2] = camera.matrix[0, 0], camera.matrix[1, 1]
        row[CENTRE : CENTRE + 2] = camera.matrix[:2, 2]
        row[DISTORTION : DISTORTION + 5] = camera.distortion
        row[WIDEST] = _widest(camera.distortion)
        row[ROTATION : ROTATION + 9] = camera.rotation.ravel()
        row[TRANSLATION : TRANSLATION + 3] = camera.translation
    return table


def _widest(distortion: np.ndarray) -> float:
    """X² + Y² where the radial part of the lens turns back: beyond, it would show again what lies far outside the image."""
    k1, k2, _, _, k3 = distortion
    roots = np.roots([7 * k3, 5 * k2, 3 * k1, 1.0])
    turning = roots[(np.abs(roots.imag) < 1e-9) & (roots.real > 0)].real
    return float(min(turning.min(initial=WIDEST_OF_ALL), WIDEST_OF_ALL))


def camera_functions(number) -> SimpleNamespace:
    """The camera as Taichi functions for one kind of number.

    ``numbers`` (1 or more, C, CAMERA_COLUMNS or more) starts with :func:`camera_table` in its row 0. Points and directions
    are in mm, in the world's axes or, called y and d, in the camera's.
    """
    scalar, constant = number.scalar, number.lanes().constant

    @ti.func
    def three(numbers: ti.template(), c, k):
        """Columns k to k + 2 of camera c."""
        return (ti.cast(numbers[0, c, k], scalar), ti.cast(numbers[0, c, k + 1], scalar), ti.cast(numbers[0, c, k + 2], scalar))

    @ti.func
    def turned(numbers: ti.template(), c, x):
        """R x: a direction in the camera's axes."""
        a = three(numbers, c, ROTATION)
        b = three(numbers, c, ROTATION + 3)
        d = three(numbers, c, ROTATION + 6)
        return (dot(a, x), dot(b, x), dot(d, x))

    @ti.func
    def turned_back(numbers: ti.template(), c, y):
        """Rᵀ y: a direction in the world's axes."""
        a = three(numbers, c, ROTATION)
        b = three(numbers, c, ROTATION + 3)
        d = three(numbers, c, ROTATION + 6)
        return (dot((a[0], b[0], d[0]), y), dot((a[1], b[1], d[1]), y), dot((a[2], b[2], d[2]), y))

    @ti.func
    def matrix_turned_back(numbers: ti.template(), c, m):
        """Rᵀ M R of a matrix in the camera's axes, nine numbers row by row."""
        a = turned_back(numbers, c, (m[0], m[1], m[2]))
        b = turned_back(numbers, c, (m[3], m[4], m[5]))
        d = turned_back(numbers, c, (m[6], m[7], m[8]))
        x = turned_back(numbers, c, (a[0], b[0], d[0]))
        y = turned_back(numbers, c, (a[1], b[1], d[1]))
        z = turned_back(numbers, c, (a[2], b[2], d[2]))
        return (x[0], y[0], z[0], x[1], y[1], z[1], x[2], y[2], z[2])

    @ti.func
    def form_turned_back(numbers: ti.template(), c, k):
        """Rᵀ K R of a symmetric K = (11, 12, 13, 22, 23, 33)."""
        m = matrix_turned_back(numbers, c, (k[0], k[1], k[2], k[1], k[3], k[4], k[2], k[4], k[5]))
        return (m[0], m[1], m[2], m[4], m[5], m[8])

    @ti.func
    def entered(numbers: ti.template(), c, x):
        """R x + t: a point in the camera's axes."""
        y = turned(numbers, c, x)
        t = three(numbers, c, TRANSLATION)
        return (y[0] + t[0], y[1] + t[1], y[2] + t[2])

    @ti.func
    def lens(numbers: ti.template(), c):
        """(fx, fy, cx, cy, k1, k2, p1, p2, k3, widest) of camera c."""
        return (
            three(numbers, c, 0) + three(numbers, c, 3) + three(numbers, c, 6) + (ti.cast(numbers[0, c, WIDEST], scalar),))

    @ti.func
    def normalised(lens, y):
        """(X, Y, 1/y3, whether it is seen) of a point in the camera's axes; of one that is not, some finite numbers."""
        deep = y[2] > NEAREST
        inverse = 1.0 / ti.select(deep, y[2], constant(1.0))
        x0 = y[0] * inverse
        x1 = y[1] * inverse
        seen = deep & (x0 * x0 + x1 * x1 < lens[9])
        return ti.select(seen, x0, constant(0.0)), ti.select(seen, x1, constant(0.0)), inverse, seen

    @ti.func
    def bent(lens, x0, x1):
        """The pixel of (X, Y), and the lens' Jacobian (11, 12, 22)."""
        fx, fy, cx, cy, k1, k2, p1, p2, k3, widest = lens
        square = x0 * x0 + x1 * x1
        radial = 1.0 + square * (k1 + square * (k2 + square * k3))
        growth = 2.0 * (k1 + square * (2.0 * k2 + square * (3.0 * k3)))
        u = x0 * radial + 2.0 * p1 * x0 * x1 + p2 * (square + 2.0 * x0 * x0)
        v = x1 * radial + p1 * (square + 2.0 * x1 * x1) + 2.0 * p2 * x0 * x1
        j11 = radial + growth * x0 * x0 + 2.0 * p1 * x1 + 6.0 * p2 * x0
        j12 = growth * x0 * x1 + 2.0 * p1 * x0 + 2.0 * p2 * x1
        j22 = radial + growth * x1 * x1 + 6.0 * p1 * x1 + 2.0 * p2 * x0
        return (fx * u + cx, fy * v + cy), (j11, j12, j22)

    @ti.func
    def bending(lens, x0, x1):
        """Second derivatives of b: (111, 112, 122, 222), the same in all orders."""
        fx, fy, cx, cy, k1, k2, p1, p2, k3, widest = lens
        square = x0 * x0 + x1 * x1
        growth = 2.0 * (k1 + square * (2.0 * k2 + square * (3.0 * k3)))
        more = 4.0 * (2.0 * k2 + 6.0 * k3 * square)
        return (
            3.0 * growth * x0 + more * x0 * x0 * x0 + 6.0 * p2,
            growth * x1 + more * x0 * x0 * x1 + 2.0 * p1,
            growth * x0 + more * x0 * x1 * x1 + 2.0 * p2,
            3.0 * growth * x1 + more * x1 * x1 * x1 + 6.0 * p1,
        )

    @ti.func
    def curling(lens, x0, x1):
        """Third derivatives of b: (1111, 1112, 1122, 1222, 2222), the same in all orders."""
        fx, fy, cx, cy, k1, k2, p1, p2, k3, widest = lens
        square = x0 * x0 + x1 * x1
        first = k1 + square * (2.0 * k2 + square * (3.0 * k3))
        second = 2.0 * k2 + 6.0 * k3 * square
        third = 48.0 * k3
        a, b, c = (x0 * x0, x0 * x1, x1 * x1)
        return (
            6.0 * first + 24.0 * second * a + third * a * a,
            b * (12.0 * second + third * a),
            2.0 * first + 4.0 * second * square + third * b * b,
            b * (12.0 * second + third * c),
            6.0 * first + 24.0 * second * c + third * c * c,
        )

    @ti.func
    def speed(lens, jacobian, x0, x1, inverse, d):
        """How far the pixel moves with the point along d, px."""
        w0 = d[0] - x0 * d[2]
        w1 = d[1] - x1 * d[2]
        v0 = lens[0] * (jacobian[0] * w0 + jacobian[1] * w1)
        v1 = lens[1] * (jacobian[1] * w0 + jacobian[2] * w1)
        return inverse * ti.sqrt(v0 * v0 + v1 * v1)

    return SimpleNamespace(turned=turned, turned_back=turned_back, matrix_turned_back=matrix_turned_back,
                           form_turned_back=form_turned_back, entered=entered, lens=lens, normalised=normalised,
                           bent=bent, bending=bending, curling=curling, speed=speed)
