"""The spline of a :class:`doo_ti.contact.distance_grid.DistanceGrid` inside kernels, each lane at its own place."""

import taichi as ti

from doo_ti.contact.distance_grid import HEADER, SIXTH
from doo_ti.physics.tuples import plus, put_lane, record, repeated, traced


@traced
def weights(t) -> tuple:
    """The four B-splines of a cell at the place t in it, their first derivatives and their second."""
    u = 1.0 - t
    return ((u * u * u) * SIXTH, (3.0 * t * t * t - 6.0 * t * t + 4.0) * SIXTH, (3.0 * u * u * u - 6.0 * u * u + 4.0) * SIXTH,
            (t * t * t) * SIXTH,
            -0.5 * u * u, 1.5 * t * t - 2.0 * t, 2.0 * u - 1.5 * u * u, 0.5 * t * t,
            u, 3.0 * t - 2.0, 3.0 * u - 2.0, t)


@ti.data_oriented
class GridLookup:
    """The spline and its derivatives in the axes of a grid, for one kind of number."""

    def __init__(self, number):
        lanes = number.lanes()
        self.lane, self.with_lane, self.width, self.scalar = lanes.lane, lanes.with_lane, number.width, number.scalar

    @ti.func
    def look_up(self, grids: ti.template(), index, place):
        """Of grid ``index`` at ``place``, which is inside it, in spacings from its first point: a record of ``value``, over the
        spacing, ``slope`` (3,) and ``bend`` (6,), first and second derivatives by ``place``."""
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

    @ti.func
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
