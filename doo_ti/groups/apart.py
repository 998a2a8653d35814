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


def edges_apart(group: Group, lengths: np.ndarray, begins: np.ndarray, radii: np.ndarray, touch: bool) -> np.ndarray:
    """(1 or N, pairs) int32: one where two edges may touch. Edges of one rod may with :data:`LEAST_ARC` radii of it between
    them, those of two unless both are within as much, of the mean of their ``radii`` (1 or N, G), of points that are tied to
    each other."""
    edges = lengths.shape[1]
    late, early = np.tril_indices(edges, -1)
    rows = max(len(lengths), len(radii)) if touch else 1
    if not touch:
        return np.zeros((rows, len(late)), dtype=np.int32)
    least = LEAST_ARC * np.broadcast_to(radii, (rows, len(group.rods)))
    arc = np.broadcast_to(np.pad(np.cumsum(lengths, axis=1), ((0, 0), (1, 0))), (rows, edges + 1))
    rod_of = np.repeat(np.arange(len(group.rods)), np.diff(group.first_vertices))  # of vertices
    of_edge = np.where(begins > 0, -1, rod_of[:-1])
    apart = np.where(of_edge[late] == of_edge[early], arc[:, late] - arc[:, early + 1] > least[:, of_edge[late]], True)
    apart &= (of_edge[late] >= 0) & (of_edge[early] >= 0)
    place = connected(edges + 1, group.tied)
    for first in np.unique(place[group.tied]):
        tied = np.flatnonzero(place == first)
        away = np.full((len(tied), rows, edges), np.inf)  # along the tied rod
        for number, vertex in enumerate(tied):
            own = of_edge == rod_of[vertex]
            away[number][:, own] = np.maximum(arc[:, :-1] - arc[:, [vertex]], arc[:, [vertex]] - arc[:, 1:])[:, own]
        for a in range(len(tied)):
            for b in range(len(tied)):
                if a != b:
                    mean = 0.5 * (least[:, rod_of[tied[[a]]]] + least[:, rod_of[tied[[b]]]])
                    apart &= ~((away[a][:, late] <= mean) & (away[b][:, early] <= mean))
    return np.ascontiguousarray(apart, dtype=np.int32)


def smallest_gap(vertices: np.ndarray, apart: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """(N,) mm between the surfaces of edges of the groups (N, V, 3) that may touch, see :func:`edges_apart`, with the
    ``radius`` (1 or N, V) of the rod at each vertex; infinite where there are none."""
    count = len(vertices)
    gap = np.full(count, np.inf)
    late, early = np.tril_indices(vertices.shape[1] - 1, -1)
    used = apart.any(axis=0)
    late, early = late[used], early[used]
    if not len(late):
        return gap
    counts, radius = (np.broadcast_to(values, (count, values.shape[1])) for values in (apart[:, used], radius))
    rows = max(1, PAIRS_AT_ONCE // len(late))
    for first in range(0, count, rows):
        here = slice(first, first + rows)
        x, edges = vertices[here], np.diff(vertices[here], axis=1)
        distance = edge_distance(x[:, late] - x[:, early], edges[:, early], edges[:, late])
        surfaces = distance - radius[here][:, late] - radius[here][:, early]
        gap[here] = np.where(counts[here] > 0, surfaces, np.inf).min(axis=1)
    return gap
