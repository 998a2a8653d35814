"""The distorted camera in kernels: pixels of points, and how they change with the points (§V-A).

The lens is that of :mod:`doo_ti.vision.cameras.camera`, the very same functions.
"""

from functools import partial

import numpy as np
import taichi as ti

from doo_ti.physics.tuples import applied, full, plus, times_transposed, traced, transposed
from doo_ti.vision.cameras import camera
from doo_ti.vision.cameras.rig import Rig

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
    for row, entry in zip(table, rig.cameras):
        row[FOCAL : FOCAL + 2] = entry.matrix[0, 0], entry.matrix[1, 1]
        row[CENTRE : CENTRE + 2] = entry.matrix[:2, 2]
        row[DISTORTION : DISTORTION + 5] = entry.distortion
        row[WIDEST] = _widest(entry.distortion)
        row[ROTATION : ROTATION + 9] = entry.rotation.ravel()
        row[TRANSLATION : TRANSLATION + 3] = entry.translation
    return table


def _widest(distortion: np.ndarray) -> float:
    """X² + Y² where the radial part of the lens turns back: beyond, it would show again what lies far outside the image."""
    k1, k2, _, _, k3 = distortion
    roots = np.roots([7 * k3, 5 * k2, 3 * k1, 1.0])
    turning = roots[(np.abs(roots.imag) < 1e-9) & (roots.real > 0)].real
    return float(min(turning.min(initial=WIDEST_OF_ALL), WIDEST_OF_ALL))


@traced
def _evaluated(value):
    return value


def _of_the_lens(function):
    """A function of a lens and (X, Y) for kernels."""
    return traced(partial(function, kept=_evaluated))


bent, bent_slope, bent_curvature, bent_third = (
    _of_the_lens(function) for function in (camera.bent, camera.bent_slope, camera.bent_curvature, camera.bent_third))


@ti.data_oriented
class Projection:
    """The cameras of a rig for one kind of number.

    ``numbers`` (1 or more, C, CAMERA_COLUMNS or more) starts with :func:`camera_table` in its row 0. Points and directions
    are in mm, in the world's axes or, called y and d, in the camera's.
    """

    def __init__(self, number):
        self.scalar = number.scalar
        self.constant = number.lanes().constant

    @ti.func
    def three(self, numbers: ti.template(), c, k):
        """Columns k to k + 2 of camera c."""
        return (ti.cast(numbers[0, c, k], self.scalar), ti.cast(numbers[0, c, k + 1], self.scalar),
                ti.cast(numbers[0, c, k + 2], self.scalar))

    @ti.func
    def rotation(self, numbers: ti.template(), c):
        """R of camera c."""
        return (self.three(numbers, c, ROTATION) + self.three(numbers, c, ROTATION + 3)
                + self.three(numbers, c, ROTATION + 6))

    @ti.func
    def lens(self, numbers: ti.template(), c):
        """(fx, fy, cx, cy, k1, k2, p1, p2, k3, widest) of camera c."""
        return (self.three(numbers, c, 0) + self.three(numbers, c, 3) + self.three(numbers, c, 6)
                + (ti.cast(numbers[0, c, WIDEST], self.scalar),))

    @ti.func
    def turned(self, numbers: ti.template(), c, x):
        """R x: a direction in the camera's axes."""
        return applied(self.rotation(numbers, c), x)

    @ti.func
    def entered(self, numbers: ti.template(), c, x):
        """R x + t: a point in the camera's axes."""
        return plus(self.turned(numbers, c, x), self.three(numbers, c, TRANSLATION))

    @ti.func
    def turned_back(self, numbers: ti.template(), c, y):
        """Rᵀ y: a direction in the world's axes."""
        return applied(transposed(self.rotation(numbers, c)), y)

    @ti.func
    def matrix_turned_back(self, numbers: ti.template(), c, m):
        """Rᵀ M R of a matrix in the camera's axes, nine numbers row by row."""
        back = transposed(self.rotation(numbers, c))
        return times_transposed(back, transposed(times_transposed(m, back)))

    @ti.func
    def form_turned_back(self, numbers: ti.template(), c, k):
        """Rᵀ K R of a symmetric K = (11, 12, 13, 22, 23, 33)."""
        m = self.matrix_turned_back(numbers, c, full(k))
        return (m[0], m[1], m[2], m[4], m[5], m[8])

    @ti.func
    def normalised(self, lens, y):
        """(X, Y, 1/y3, whether it is seen) of a point in the camera's axes; of one that is not, some finite numbers."""
        deep = y[2] > NEAREST
        inverse = 1.0 / ti.select(deep, y[2], self.constant(1.0))
        x0 = y[0] * inverse
        x1 = y[1] * inverse
        seen = deep & (x0 * x0 + x1 * x1 < lens[9])
        return ti.select(seen, x0, self.constant(0.0)), ti.select(seen, x1, self.constant(0.0)), inverse, seen

    @ti.func
    def speed(self, lens, slope, x0, x1, inverse, d):
        """How far the pixel moves with the point along d, px, by the ``slope`` of the lens."""
        w0 = d[0] - x0 * d[2]
        w1 = d[1] - x1 * d[2]
        v0 = lens[0] * (slope[0] * w0 + slope[1] * w1)
        v1 = lens[1] * (slope[1] * w0 + slope[2] * w1)
        return inverse * ti.sqrt(v0 * v0 + v1 * v1)
