"""Which edges of a group may touch, and how near they are (docs/groups.md). Axes: N groups, E edges, breaks included."""

import numpy as np

from doo_ti.contact.itself import LEAST_ARC, PAIRS_AT_ONCE, edge_distance
from doo_ti.groups.group import Group


def connected(count: int, pairs: np.ndarray) -> np.ndarray:
    """(count,) the least number that each is connected with by ``pairs`` (K, 2)."""
    part = np.arange(count)
    for first, second in pairs:
        least, other = sorted((part[first], part[second]))
        part[part == other] = least
    return part


def edges_apart(group: Group, lengths: np.ndarray, begins: np.ndarray, radius: np.ndarray, touch: bool) -> np.ndarray:
    """(1 or N, pairs) int32: one where two edges may touch. Edges of one rod may with :data:`LEAST_ARC` radii of it between
    them, those of two unless both are within as much of points that are tied to each other."""
    edges = lengths.shape[1]
    late, early = np.tril_indices(edges, -1)
    rows = max(len(lengths), len(radius)) if touch else 1
    if not touch:
        return np.zeros((rows, len(late)), dtype=np.int32)
    least = np.broadcast_to(LEAST_ARC * radius[:, None], (rows, 1))
    arc = np.broadcast_to(np.pad(np.cumsum(lengths, axis=1), ((0, 0), (1, 0))), (rows, edges + 1))
    rod_of = np.repeat(np.arange(len(group.rods)), np.diff(group.first_vertices))  # of vertices
    of_edge = np.where(begins > 0, -1, rod_of[:-1])
    apart = np.where(of_edge[late] == of_edge[early], arc[:, late] - arc[:, early + 1] > least, True)
    apart &= (of_edge[late] >= 0) & (of_edge[early] >= 0)
    place = connected(edges + 1, group.tied)
    for first in np.unique(place[group.tied]):
        tied = np.flatnonzero(place == first)
        near = np.zeros((len(tied), rows, edges), dtype=bool)
        for number, vertex in enumerate(tied):
            away = np.maximum(arc[:, :-1] - arc[:, [vertex]], arc[:, [vertex]] - arc[:, 1:])
            near[number] = (away <= least) & (of_edge == rod_of[vertex])
        for a in range(len(tied)):
            for b in range(len(tied)):
                if a != b:
                    apart &= ~(near[a][:, late] & near[b][:, early])
    return np.ascontiguousarray(apart, dtype=np.int32)


def smallest_gap(vertices: np.ndarray, apart: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """(N,) mm between the surfaces of edges of the groups (N, V, 3) that may touch, see :func:`edges_apart`, with that
    ``radius`` (1 or N,); infinite where there are none."""
    count = len(vertices)
    gap = np.full(count, np.inf)
    late, early = np.tril_indices(vertices.shape[1] - 1, -1)
    used = apart.any(axis=0)
    late, early = late[used], early[used]
    if not len(late):
        return gap
    counts = np.broadcast_to(apart[:, used], (count, len(late)))
    rows = max(1, PAIRS_AT_ONCE // len(late))
    for first in range(0, count, rows):
        here = slice(first, first + rows)
        x, edges = vertices[here], np.diff(vertices[here], axis=1)
        distance = edge_distance(x[:, late] - x[:, early], edges[:, early], edges[:, late])
        gap[here] = np.where(counts[here] > 0, distance, np.inf).min(axis=1)
    return gap - 2.0 * radius
