"""Which rods may have touched themselves on the way from one shape to another (docs/contact.md).

On the straight way of every vertex from one shape to the other, the distance of two places changes along the rod by no more
than the arc. From the distance of one pair of edges follows how many edges further along need not be looked at, so that of a
rod far from itself only a few are.

A rod may also have passed through itself and come back. Where both its ends are held its linking number tells: the twist of its
frames after the straight way, each transported from its old tangent to the new one, differs from that of the result by whole
turns.
"""

from functools import cache

import numpy as np
import taichi as ti

from doo_ti import runtime
from doo_ti.contact.itself import LEAST_ARC
from doo_ti.physics.quaternion import relative_rotation, tangent, transported
from doo_ti.physics.tuples import dot, minus, plus, scaled, variable


@cache
def _kernels():
    """The two kernels, of rods given by frames and by places."""
    table1, table2, table3 = (ti.types.ndarray(dtype=ti.f64, ndim=size) for size in (1, 2, 3))
    index1 = ti.types.ndarray(dtype=ti.i32, ndim=1)

    @ti.func
    def frame(frames: ti.template(), at):
        return (frames[at], frames[at + 1], frames[at + 2], frames[at + 3])

    @ti.func
    def middle(middles: ti.template(), rod, edge, way: ti.template()):
        return (middles[rod, edge, 3 * way], middles[rod, edge, 3 * way + 1], middles[rod, edge, 3 * way + 2])

    @ti.func
    def nearest(middles: ti.template(), rod, i, j):
        """The least distance of the middles of two edges on the way."""
        before = minus(middle(middles, rod, j, 0), middle(middles, rod, i, 0))
        after = minus(middle(middles, rod, j, 1), middle(middles, rod, i, 1))
        change = minus(after, before)
        share = 0.0 - dot(before, change) / (dot(change, change) + 1e-300)
        place = plus(before, scaled(change, ti.min(ti.max(share, 0.0), 1.0)))
        return ti.sqrt(dot(place, place))

    @ti.func
    def approaches(middles: ti.template(), rod, edges, longest, radius):
        """One where two parts of the rod may touch on the way."""
        # Edges i and i + apart are the first that may have enough of the rod between them.
        apart = ti.max(2, ti.cast(ti.floor(LEAST_ARC * radius / longest), ti.i32) + 2)
        found = 0
        for i in range(edges):
            j = i + apart
            while j < edges and found == 0:
                room = nearest(middles, rod, i, j) - longest - 2.0 * radius
                if not room > 0.0:
                    found = 1
                j += 1 + ti.cast(ti.min(ti.max(room, 0.0) / longest, 1e6), ti.i32)
        return found

    @ti.func
    def longest_edge(rest_length: ti.template(), row):
        longest = rest_length[row, 0]
        for e in range(rest_length.shape[1]):
            longest = ti.max(longest, rest_length[row, e])
        return longest

    @ti.func
    def twist(p, q):
        """The angle between neighbouring frames about their tangents."""
        r = relative_rotation(p, q)
        return 2.0 * ti.atan2(ti.select(r[0] < 0.0, 0.0 - r[1], r[1]), ti.abs(r[0]))

    @ti.func
    def relinked(start: ti.template(), first, frames: ti.template(), rod, edges):
        """One where the twist on the straight way is another one than in the result."""
        difference = 0.0
        kept, reached = variable((1.0, 0.0, 0.0, 0.0)), variable((1.0, 0.0, 0.0, 0.0))
        for e in range(edges):
            old, new = frame(start, (first + e) * 4), frame(frames, (rod * edges + e) * 4)
            own = transported(old, tangent(old), tangent(new))
            if e > 0:
                difference += twist(reached, new) - twist(kept, own)
            kept, reached = own, new
        return ti.select(ti.abs(difference) < 3.0, 0, 1)

    @ti.kernel
    def by_frames(start: table1, start_row: index1, frames: table1, rest_length: table2, radius: table1, held: index1,
                  middles: table3, flags: index1):
        for rod in range(flags.shape[0]):
            edges = rest_length.shape[1]
            row = ti.min(start_row[rod], rest_length.shape[0] - 1)
            before, after = variable((0.0, 0.0, 0.0)), variable((0.0, 0.0, 0.0))
            for e in range(edges):
                old = scaled(tangent(frame(start, (start_row[rod] * edges + e) * 4)), 0.5 * rest_length[row, e])
                new = scaled(tangent(frame(frames, (rod * edges + e) * 4)), 0.5 * rest_length[row, e])
                before, after = plus(before, old), plus(after, new)
                for k in ti.static(range(3)):
                    middles[rod, e, k] = before[k]
                    middles[rod, e, 3 + k] = after[k]
                before, after = plus(before, old), plus(after, new)
            longest = longest_edge(rest_length, row)
            found = approaches(middles, rod, edges, longest, radius[ti.min(rod, radius.shape[0] - 1)])
            if held[rod] == 1 and found == 0:
                found = relinked(start, start_row[rod] * edges, frames, rod, edges)
            flags[rod] = found

    @ti.kernel
    def by_places(before: table3, after: table3, length_row: index1, rest_length: table2, radius: table1, middles: table3,
                  flags: index1):
        for rod in range(flags.shape[0]):
            edges = rest_length.shape[1]
            for e in range(edges):
                for k in ti.static(range(3)):
                    middles[rod, e, k] = 0.5 * (before[rod, e, k] + before[rod, e + 1, k])
                    middles[rod, e, 3 + k] = 0.5 * (after[rod, e, k] + after[rod, e + 1, k])
            longest = longest_edge(rest_length, ti.min(length_row[rod], rest_length.shape[0] - 1))
            flags[rod] = approaches(middles, rod, edges, longest, radius[ti.min(rod, radius.shape[0] - 1)])

    return by_frames, by_places


def _launch(kernel: int, count: int, edges: int, *arguments) -> np.ndarray:
    runtime.start()
    flags = np.zeros(count, dtype=np.int32)
    _kernels()[kernel](*arguments, np.empty((count, edges, 6)), flags)
    return flags > 0


@runtime.exclusive
def approach_in_relaxation(start: np.ndarray, start_row: np.ndarray, frames: np.ndarray, rest_length: np.ndarray,
                           radius: np.ndarray, held: np.ndarray) -> np.ndarray:
    """(R,) whether a rod may touch itself between its start, row ``start_row`` (R,) of ``start`` (S, E, 4), and its ``frames``
    (R, E, 4); also where these are not finite. ``held`` (R,): no end may turn."""
    rows = np.ascontiguousarray(start_row, dtype=np.int32)
    return _launch(0, len(frames), rest_length.shape[1], start.reshape(-1), rows, frames.reshape(-1), rest_length, radius,
                   np.ascontiguousarray(held, dtype=np.int32))


@runtime.exclusive
def approach_in_motion(before: np.ndarray, after: np.ndarray, length_row: np.ndarray, rest_length: np.ndarray,
                       radius: np.ndarray) -> np.ndarray:
    """(R,) the same between two instants of a motion, places (R, V, 3); not where these are not finite."""
    rows = np.ascontiguousarray(length_row, dtype=np.int32)
    found = _launch(1, len(before), rest_length.shape[1], np.ascontiguousarray(before), np.ascontiguousarray(after), rows,
                    rest_length, radius)
    return found & np.isfinite(after[:, 0, 0]) & np.isfinite(before[:, 0, 0])
