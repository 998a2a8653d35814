"""Distance maps between their pixels, in kernels: values, gradients and second derivatives.

A map is sampled as a quadratic B-spline with the pixels' distances as coefficients, nine of them at a time: its gradient is
continuous, and the crease along a detected line becomes a parabola about a pixel wide. (Bilinear sampling has kinks of its
own between all pixels, where a Newton iteration never settles.)
"""

import taichi as ti

from doo_ti.physics.tuples import applied, dot, itemwise, repeated, traced, variable
from doo_ti.physics.tuples import row as row_of

# Columns of a window: where its distances start in the values, and the pixels it covers.
OFFSET, LEFT, TOP, WIDTH, HEIGHT, WINDOW_COLUMNS = 0, 1, 2, 3, 4, 5
SMALLEST = 3
"""Pixels across a window that can be sampled."""


@traced
def _spline(t) -> tuple:
    """The weights of three neighbours, at −½ ≤ t ≤ ½ from the middle one."""
    return (0.5 * (0.5 - t) * (0.5 - t), 0.75 - t * t, 0.5 * (0.5 + t) * (0.5 + t))


@traced
def _spline_slope(t) -> tuple:
    """How they change with t."""
    return (t - 0.5, 0.0 - 2.0 * t, t + 0.5)


@traced
def _bend(a):
    """Second derivative of a spline with the coefficients a."""
    return a[0] - 2.0 * a[1] + a[2]


@ti.data_oriented
class MapSampling:
    """Sampling for one kind of number.

    ``values`` are the distances of all maps in px, one after the other; ``numbers`` (A, C, …) says from column ``first`` on
    where that of a set and a camera lies. The set ``row`` is a number per rod: each may be compared with other images.
    """

    def __init__(self, number, first: int):
        lanes = number.lanes()
        self.lane, self.with_lane, self.constant = lanes.lane, lanes.with_lane, lanes.constant
        self.width = number.width
        self.first = first

    @ti.func
    def window(self, numbers: ti.template(), row, c):
        """(left, top, width, height) of each rod's map, px."""
        frame = variable(repeated(0.0 * row, 4))
        for slot in ti.static(range(self.width)):
            r = ti.cast(self.lane(row, slot), ti.i32)
            frame = itemwise(
                self.with_lane(frame[0], slot, numbers[r, c, self.first + LEFT]),
                self.with_lane(frame[1], slot, numbers[r, c, self.first + TOP]),
                self.with_lane(frame[2], slot, numbers[r, c, self.first + WIDTH]),
                self.with_lane(frame[3], slot, numbers[r, c, self.first + HEIGHT]),
            )
        return frame

    @ti.func
    def clamped(self, place, size):
        """(place inside, how far outside, pixel in the middle of the three, place beside it) along one axis."""
        low = ti.select(place > 0.5, place, 0.0 * size + 0.5)
        inside = ti.select(low < size - 1.5, low, size - 1.5)
        middle = ti.floor(inside + 0.5)
        middle = ti.select(middle < size - 2.0, middle, size - 2.0)
        return place - inside, middle, inside - middle

    @ti.func
    def taps(self, values: ti.template(), numbers: ti.template(), row, c, column, line):
        """The nine distances around pixel (column, line) of each rod's window, line by line."""
        found = variable(repeated(0.0 * row, 9))
        for slot in ti.static(range(self.width)):
            r = ti.cast(self.lane(row, slot), ti.i32)
            step = ti.cast(numbers[r, c, self.first + WIDTH], ti.i32)
            at = ti.cast(numbers[r, c, self.first + OFFSET], ti.i32)
            at += ti.cast(self.lane(line, slot), ti.i32) * step + ti.cast(self.lane(column, slot), ti.i32)
            found = itemwise(
                self.with_lane(found[0], slot, values[at - step - 1]),
                self.with_lane(found[1], slot, values[at - step]),
                self.with_lane(found[2], slot, values[at - step + 1]),
                self.with_lane(found[3], slot, values[at - 1]),
                self.with_lane(found[4], slot, values[at]),
                self.with_lane(found[5], slot, values[at + 1]),
                self.with_lane(found[6], slot, values[at + step - 1]),
                self.with_lane(found[7], slot, values[at + step]),
                self.with_lane(found[8], slot, values[at + step + 1]),
            )
        return found

    @ti.func
    def value(self, values: ti.template(), numbers: ti.template(), row, c, frame, pixel):
        """The distance at ``pixel``; outside the window ``frame``, the way to its border more than there."""
        ox, column, s = self.clamped(pixel[0] - frame[0], frame[2])
        oy, line, t = self.clamped(pixel[1] - frame[1], frame[3])
        taps = self.taps(values, numbers, row, c, column, line)
        return dot(_spline(t), applied(taps, _spline(s))) + ti.sqrt(ox * ox + oy * oy)

    @ti.func
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
