"""From points to pixels to distances, in kernels: the distorted camera and the distance maps, with derivatives (§IV-A, §V-A).

The functions of the lens are those of :mod:`doo_ti.vision.cameras`. A map is sampled as a quadratic B-spline,

    D(p) = Σ_ij b_i(u) b_j(v) d_ij      over the nine pixels around p = (u, v), d_ij their distances,

so that its gradient is continuous, and the crease along a detected line becomes a parabola about a pixel wide. (Bilinear
sampling has a kink between any two pixels, and Newton's iteration does not converge on kinks.)
"""

from functools import partial

import numpy as np
import taichi as ti

from doo_ti.physics.algebra import applied, full, times_transposed, transposed
from doo_ti.physics.algebra import row as row_of
from doo_ti.physics.number import device_functions
from doo_ti.physics.tuples import dot, plus, put_lane, record, repeated, traced
from doo_ti.vision import cameras as camera
from doo_ti.vision.cameras import Rig

# Columns of a camera: the lens, the square X² + Y² up to which it maps outwards, R by rows and t in mm.
WIDEST = camera.LENS
ROTATION, TRANSLATION, CAMERA_COLUMNS = WIDEST + 1, WIDEST + 10, WIDEST + 13
NEAREST = 1.0  # mm: points at less depth are not seen
WIDEST_OF_ALL = 100.0  # bound of X² + Y² for any lens: 84° off the axis


def camera_table(rig: Rig) -> np.ndarray:
    """(C, CAMERA_COLUMNS) float64, in the columns above."""
    return np.array([[*entry.lens, _widest(entry.lens), *entry.rotation.ravel(), *entry.translation] for entry in rig.cameras])


def _widest(lens: np.ndarray) -> float:
    """X² + Y² where the radial part of the lens turns back: points beyond it would appear in the image a second time."""
    k1, k2, _, _, k3, k4, k5, k6 = lens[4:camera.LENS]
    above, below = np.poly1d([k3, k2, k1, 1.0]), np.poly1d([k6, k5, k4, 1.0])
    square = np.poly1d([1.0, 0.0])
    turning = above * below + 2 * square * (above.deriv() * below - above * below.deriv())
    roots = np.concatenate([turning.roots, below.roots])
    bounds = roots[(np.abs(roots.imag) < 1e-9) & (roots.real > 0)].real
    return float(min(bounds.min(initial=WIDEST_OF_ALL), WIDEST_OF_ALL))


@traced
def _evaluated(value):
    return value


bent, bent_slope, bent_curvature, bent_third = (
    traced(partial(function, kept=_evaluated))
    for function in (camera.bent, camera.bent_slope, camera.bent_curvature, camera.bent_third))


@device_functions
class Projection:
    """The cameras of a rig for one kind of number.

    ``numbers`` (1 or more, C, CAMERA_COLUMNS or more) starts with :func:`camera_table` in its row 0. Points and directions
    are in mm, in the world's axes or, called y and d, in the camera's.
    """

    def __init__(self, number):
        self.scalar = number.scalar
        self.constant = number.constant

    def three(self, numbers: ti.template(), c, k):
        """Columns k to k + 2 of camera c."""
        return (ti.cast(numbers[0, c, k], self.scalar), ti.cast(numbers[0, c, k + 1], self.scalar),
                ti.cast(numbers[0, c, k + 2], self.scalar))

    def rotation(self, numbers: ti.template(), c):
        """R of camera c."""
        return (self.three(numbers, c, ROTATION) + self.three(numbers, c, ROTATION + 3) + self.three(numbers, c, ROTATION + 6))

    def lens(self, numbers: ti.template(), c):
        """(fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6, widest) of camera c."""
        return (self.three(numbers, c, 0) + self.three(numbers, c, 3) + self.three(numbers, c, 6) + self.three(numbers, c, 9)
                + (ti.cast(numbers[0, c, WIDEST], self.scalar),))

    def turned(self, numbers: ti.template(), c, x):
        """R x: a direction in the camera's axes."""
        return applied(self.rotation(numbers, c), x)

    def entered(self, numbers: ti.template(), c, x):
        """R x + t: a point in the camera's axes."""
        return plus(self.turned(numbers, c, x), self.three(numbers, c, TRANSLATION))

    def turned_back(self, numbers: ti.template(), c, y):
        """Rᵀ y: a direction in the world's axes."""
        return applied(transposed(self.rotation(numbers, c)), y)

    def matrix_turned_back(self, numbers: ti.template(), c, m):
        """Rᵀ M R of a matrix in the camera's axes, nine numbers row by row."""
        back = transposed(self.rotation(numbers, c))
        return times_transposed(back, transposed(times_transposed(m, back)))

    def form_turned_back(self, numbers: ti.template(), c, k):
        """Rᵀ K R of a symmetric K = (11, 12, 13, 22, 23, 33)."""
        m = self.matrix_turned_back(numbers, c, full(k))
        return (m[0], m[1], m[2], m[4], m[5], m[8])

    def normalised(self, lens, y):
        """(X, Y, 1/y3, whether it is seen) of a point in the camera's axes; finite numbers also for one that is not seen."""
        deep = y[2] > NEAREST
        inverse = 1.0 / ti.select(deep, y[2], self.constant(1.0))
        x0 = y[0] * inverse
        x1 = y[1] * inverse
        seen = deep & (x0 * x0 + x1 * x1 < lens[WIDEST])
        return ti.select(seen, x0, self.constant(0.0)), ti.select(seen, x1, self.constant(0.0)), inverse, seen

    def speed(self, lens, slope, x0, x1, inverse, d):
        """px that the pixel moves as the point moves by d, from the ``slope`` of the lens."""
        w0 = d[0] - x0 * d[2]
        w1 = d[1] - x1 * d[2]
        v0 = lens[0] * (slope[0] * w0 + slope[1] * w1)
        v1 = lens[1] * (slope[1] * w0 + slope[2] * w1)
        return inverse * ti.sqrt(v0 * v0 + v1 * v1)


# --- distance maps ---------------------------------------------------------------------------------------------------------

# Columns of a window: where its distances start in the values, and the pixels it covers.
OFFSET, LEFT, TOP, WIDTH, HEIGHT, WINDOW_COLUMNS = 0, 1, 2, 3, 4, 5
SMALLEST = 3  # pixels across a window that can be sampled


@traced
def _spline(t) -> tuple:
    """The weights of three neighbours, at −½ ≤ t ≤ ½ from the middle one."""
    return (0.5 * (0.5 - t) * (0.5 - t), 0.75 - t * t, 0.5 * (0.5 + t) * (0.5 + t))


@traced
def _spline_slope(t) -> tuple:
    """Their derivatives by t."""
    return (t - 0.5, 0.0 - 2.0 * t, t + 0.5)


@traced
def _bend(a):
    """Second derivative of a spline with the coefficients a."""
    return a[0] - 2.0 * a[1] + a[2]


@device_functions
class MapSampling:
    """Sampling for one kind of number.

    ``values`` are the distances of all maps in px, one after the other; ``numbers`` (A, C, …) holds from column ``first`` on
    the window of each set and camera. The set ``row`` is a number per rod: each rod may be compared with other images.
    """

    def __init__(self, number, first: int):
        self.lane, self.with_lane, self.constant = number.lane, number.with_lane, number.constant
        self.width = number.width
        self.first = first

    def window(self, numbers: ti.template(), row, c):
        """(left, top, width, height) of each rod's map, px."""
        seen = record(window=repeated(0.0 * row, 4))
        for slot in ti.static(range(self.width)):
            r = ti.cast(self.lane(row, slot), ti.i32)
            put_lane(seen, self.with_lane, slot, window=(
                numbers[r, c, self.first + LEFT], numbers[r, c, self.first + TOP], numbers[r, c, self.first + WIDTH],
                numbers[r, c, self.first + HEIGHT]))
        return seen.window

    def clamped(self, place, size):
        """(place inside, distance outside, middle one of the three pixels, distance from it) along one axis."""
        low = ti.select(place > 0.5, place, 0.0 * size + 0.5)
        inside = ti.select(low < size - 1.5, low, size - 1.5)
        middle = ti.floor(inside + 0.5)
        middle = ti.select(middle < size - 2.0, middle, size - 2.0)
        return place - inside, middle, inside - middle

    def taps(self, values: ti.template(), numbers: ti.template(), row, c, column, line):
        """The nine distances around pixel (column, line) of each rod's window, line by line."""
        seen = record(taps=repeated(0.0 * row, 9))
        for slot in ti.static(range(self.width)):
            r = ti.cast(self.lane(row, slot), ti.i32)
            step = ti.cast(numbers[r, c, self.first + WIDTH], ti.i32)
            at = ti.cast(numbers[r, c, self.first + OFFSET], ti.i32)
            at += ti.cast(self.lane(line, slot), ti.i32) * step + ti.cast(self.lane(column, slot), ti.i32)
            put_lane(seen, self.with_lane, slot, taps=(
                values[at - step - 1], values[at - step], values[at - step + 1], values[at - 1], values[at], values[at + 1],
                values[at + step - 1], values[at + step], values[at + step + 1]))
        return seen.taps

    def value(self, values: ti.template(), numbers: ti.template(), row, c, frame, pixel):
        """The distance at ``pixel``; outside the window ``frame``, that at its border plus the distance to the border."""
        ox, column, s = self.clamped(pixel[0] - frame[0], frame[2])
        oy, line, t = self.clamped(pixel[1] - frame[1], frame[3])
        taps = self.taps(values, numbers, row, c, column, line)
        return dot(_spline(t), applied(taps, _spline(s))) + ti.sqrt(ox * ox + oy * oy)

    def derivatives(self, values: ti.template(), numbers: ti.template(), row, c, frame, pixel):
        """The distance at ``pixel``, its gradient (u, v) and its second derivatives (uu, uv, vv)."""
        ox, column, s = self.clamped(pixel[0] - frame[0], frame[2])
        oy, line, t = self.clamped(pixel[1] - frame[1], frame[3])
        taps = self.taps(values, numbers, row, c, column, line)
        down, fall = _spline(t), _spline_slope(t)
        rows, slopes = applied(taps, _spline(s)), applied(taps, _spline_slope(s))
        bends = (_bend(row_of(taps, 0)), _bend(row_of(taps, 1)), _bend(row_of(taps, 2)))
        # Outside, the map's own derivatives count along the border only; beyond a corner the distances are round.
        within_x = ti.select(ox == 0.0, self.constant(1.0), self.constant(0.0))
        within_y = ti.select(oy == 0.0, self.constant(1.0), self.constant(0.0))
        far = ti.sqrt(ox * ox + oy * oy)
        inverse = ti.select(far > 0.0, 1.0 / ti.select(far > 0.0, far, self.constant(1.0)), self.constant(0.0))
        along, over = (ox * inverse, oy * inverse)
        corner = (1.0 - within_x) * (1.0 - within_y) * inverse
        gradient = (within_x * dot(down, slopes) + along, within_y * dot(fall, rows) + over)
        second = (
            within_x * dot(down, bends) + corner * over * over,
            within_x * within_y * dot(fall, slopes) - corner * along * over,
            within_y * _bend(rows) + corner * along * along,
        )
        return dot(down, rows) + far, gradient, second
