"""Distance maps between their pixels, on the device: values, gradients and second derivatives.

A map is sampled as a quadratic B-spline with the pixels' distances as coefficients, nine of them at a time: its gradient is
continuous, and the crease along a detected line becomes a parabola about a pixel wide. (Bilinear sampling has kinks of its
own between all pixels, where a Newton iteration never settles.)
"""

from types import SimpleNamespace

import taichi as ti

# Columns of a window: where its distances start in the values, and the pixels it covers.
OFFSET, LEFT, TOP, WIDTH, HEIGHT, WINDOW_COLUMNS = 0, 1, 2, 3, 4, 5
SMALLEST = 3
"""Pixels across a window that can be sampled."""


def map_sampling(number, first: int) -> SimpleNamespace:
    """Sampling as Taichi functions: ``window``, ``value`` and ``derivatives``.

    ``values`` are the distances of all maps in px, one after the other; ``numbers`` (A, C, …) says from column ``first`` on
    where that of a set and a camera lies. The set ``row`` is a number per rod: each may be compared with other images.
    """
    lanes = number.lanes()
    lane, with_lane, constant = lanes.lane, lanes.with_lane, lanes.constant
    width = number.width

    @ti.func
    def window(numbers: ti.template(), row, c):
        """(left, top, width, height) of each rod's map, px."""
        left, top, across, down = (0.0 * row, 0.0 * row, 0.0 * row, 0.0 * row)
        for slot in ti.static(range(width)):
            r = ti.cast(lane(row, slot), ti.i32)
            left = with_lane(left, slot, numbers[r, c, first + LEFT])
            top = with_lane(top, slot, numbers[r, c, first + TOP])
            across = with_lane(across, slot, numbers[r, c, first + WIDTH])
            down = with_lane(down, slot, numbers[r, c, first + HEIGHT])
        return left, top, across, down

    @ti.func
    def clamped(place, size):
        """(place inside, how far outside, pixel in the middle of the three, place beside it) along one axis."""
        low = ti.select(place > 0.5, place, 0.0 * size + 0.5)
        inside = ti.select(low < size - 1.5, low, size - 1.5)
        middle = ti.floor(inside + 0.5)
        middle = ti.select(middle < size - 2.0, middle, size - 2.0)
        return place - inside, middle, inside - middle

    @ti.func
    def taps(values: ti.template(), numbers: ti.template(), row, c, column, line):
        """The nine distances around pixel (column, line) of each rod's window, line by line."""
        zero = 0.0 * row
        a0, a1, a2, b0, b1, b2, c0, c1, c2 = (zero, zero, zero, zero, zero, zero, zero, zero, zero)
        for slot in ti.static(range(width)):
            r = ti.cast(lane(row, slot), ti.i32)
            step = ti.cast(numbers[r, c, first + WIDTH], ti.i32)
            at = ti.cast(numbers[r, c, first + OFFSET], ti.i32)
            at += ti.cast(lane(line, slot), ti.i32) * step + ti.cast(lane(column, slot), ti.i32)
            a0 = with_lane(a0, slot, values[at - step - 1])
            a1 = with_lane(a1, slot, values[at - step])
            a2 = with_lane(a2, slot, values[at - step + 1])
            b0 = with_lane(b0, slot, values[at - 1])
            b1 = with_lane(b1, slot, values[at])
            b2 = with_lane(b2, slot, values[at + 1])
            c0 = with_lane(c0, slot, values[at + step - 1])
            c1 = with_lane(c1, slot, values[at + step])
            c2 = with_lane(c2, slot, values[at + step + 1])
        return (a0, a1, a2), (b0, b1, b2), (c0, c1, c2)

    @ti.func
    def weights(t):
        """Of the three neighbours, at −½ ≤ t ≤ ½ from the middle one."""
        return (0.5 * (0.5 - t) * (0.5 - t), 0.75 - t * t, 0.5 * (0.5 + t) * (0.5 + t))

    @ti.func
    def blend(w, a):
        return w[0] * a[0] + w[1] * a[1] + w[2] * a[2]

    @ti.func
    def bend(a):
        return a[0] - 2.0 * a[1] + a[2]

    @ti.func
    def value(values: ti.template(), numbers: ti.template(), row, c, frame, pixel):
        """The distance at ``pixel``; outside the window ``frame``, the way to its border more than there."""
        ox, column, s = clamped(pixel[0] - frame[0], frame[2])
        oy, line, t = clamped(pixel[1] - frame[1], frame[3])
        upper, middle, lower = taps(values, numbers, row, c, column, line)
        w = weights(s)
        return blend(weights(t), (blend(w, upper), blend(w, middle), blend(w, lower))) + ti.sqrt(ox * ox + oy * oy)

    @ti.func
    def derivatives(values: ti.template(), numbers: ti.template(), row, c, frame, pixel):
        """The distance at ``pixel``, its gradient (u, v) and its second derivatives (uu, uv, vv)."""
        ox, column, s = clamped(pixel[0] - frame[0], frame[2])
        oy, line, t = clamped(pixel[1] - frame[1], frame[3])
        upper, middle, lower = taps(values, numbers, row, c, column, line)
        across, down = (weights(s), weights(t))
        slope = (s - 0.5, 0.0 - 2.0 * s, s + 0.5)
        rows = (blend(across, upper), blend(across, middle), blend(across, lower))
        slopes = (blend(slope, upper), blend(slope, middle), blend(slope, lower))
        fall = (t - 0.5, 0.0 - 2.0 * t, t + 0.5)
        bends = (bend(upper), bend(middle), bend(lower))
        # Outside, the map's own derivatives count along the border only; beyond a corner the distances are round.
        within_x = ti.select(ox == 0.0, constant(1.0), constant(0.0))
        within_y = ti.select(oy == 0.0, constant(1.0), constant(0.0))
        far = ti.sqrt(ox * ox + oy * oy)
        inverse = ti.select(far > 0.0, 1.0 / ti.select(far > 0.0, far, constant(1.0)), constant(0.0))
        along, over = (ox * inverse, oy * inverse)
        corner = (1.0 - within_x) * (1.0 - within_y) * inverse
        gradient = (within_x * blend(down, slopes) + along, within_y * blend(fall, rows) + over)
        second = (
            within_x * blend(down, bends) + corner * over * over,
            within_x * within_y * blend(fall, slopes) - corner * along * over,
            within_y * bend(rows) + corner * along * along,
        )
        return blend(down, rows) + far, gradient, second

    return SimpleNamespace(window=window, value=value, derivatives=derivatives)
