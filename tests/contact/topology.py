"""How rods are knotted and linked, computed apart from the package: from nothing but their vertices and frames."""

import numpy as np

from doo_ti.rod.frames import total_twist

FAR = 50.0  # rod lengths to the points by which a rod is closed


def closed(vertices: np.ndarray) -> np.ndarray:
    """(N, 3) the rod (V, 3), both ends of which point away from it along its end edges, closed far away from it."""
    before, after = vertices[0] - vertices[1], vertices[-1] - vertices[-2]
    reach = FAR * np.linalg.norm(np.diff(vertices, axis=0), axis=1).sum()
    ends = [vertices[0] + reach * before / np.linalg.norm(before), vertices[-1] + reach * after / np.linalg.norm(after)]
    aside = np.array([0.0, 0.31, -0.95]) * reach
    return np.concatenate([ends[:1], vertices, ends[1:], ends[1:] + aside, ends[:1] + aside])


def solid_angles(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
    """(...) the solid angle in which the edges a b and c d (..., 3) are seen to cross, with the sense of the crossing."""
    corners = [np.cross(c - a, d - a), np.cross(d - a, d - b), np.cross(d - b, c - b), np.cross(c - b, c - a)]
    sizes = [np.linalg.norm(corner, axis=-1, keepdims=True) for corner in corners]
    normals = [corner / np.maximum(size, 1e-300) for corner, size in zip(corners, sizes, strict=True)]
    angle = sum(np.arcsin(np.clip((normals[k] * normals[(k + 1) % 4]).sum(axis=-1), -1.0, 1.0)) for k in range(4))
    return np.sign(np.einsum("...j,...j->...", np.cross(d - c, b - a), c - a)) * angle


def pairs(count: int) -> tuple[np.ndarray, np.ndarray]:
    """The pairs of edges of a closed polygon that do not meet at a vertex."""
    i, j = np.triu_indices(count, 2)
    keep = (i > 0) | (j < count - 1)
    return i[keep], j[keep]


def writhe(points: np.ndarray) -> float:
    """Of a closed polygon (N, 3), in turns: the sum over pairs of edges of the solid angle in which they cross."""
    (i, j), end = pairs(len(points)), np.roll(points, -1, axis=0)
    return float(solid_angles(points[i], end[i], points[j], end[j]).sum() / (2.0 * np.pi))


def linking(first: np.ndarray, second: np.ndarray) -> float:
    """How often two closed polygons (N, 3) and (M, 3) wind round each other, by Gauss's integral."""
    ends = (first[:, None], np.roll(first, -1, axis=0)[:, None], second[None], np.roll(second, -1, axis=0)[None])
    return float(solid_angles(*(np.broadcast_to(part, (len(first), len(second), 3)) for part in ends)).sum() / (4.0 * np.pi))


def link(vertices: np.ndarray, quaternions: np.ndarray) -> float:
    """Turns by which the frames of a rod (V, 3), (E, 4) are linked with it: twist and writhe. With both ends held it changes
    only where the rod passes through itself, by two."""
    return float(total_twist(quaternions) / (2.0 * np.pi)) + writhe(closed(vertices))


def determinant(vertices: np.ndarray) -> int:
    """The determinant of the knot that a rod (V, 3) makes: 1 of an unknotted one, 3 of an overhand knot.

    Of a diagram of the closed rod every crossing gives an equation between the arcs that meet there, twice the upper one less
    both lower ones; the determinant is that of all equations but one, of all arcs but one.
    """
    points = closed(vertices) @ np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    side, (i, j) = np.roll(points, -1, axis=0) - points, pairs(len(points))
    away = points[j] - points[i]
    across, *along = (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
                      for first, second in ((side[i], side[j]), (away, side[j]), (away, side[i])))
    s, t = np.divide(along, across, out=np.zeros((2, len(i))), where=across != 0.0)
    meet = (0 < s) & (s < 1) & (0 < t) & (t < 1)
    i, j, s, t = (values[meet] for values in (i, j, s, t))
    first_below = points[i, 2] + s * side[i, 2] < points[j, 2] + t * side[j, 2]
    # The places along the rod where it runs below, and where it runs above.
    under, over = np.where(first_below, (i + s, j + t), (j + t, i + s))
    if len(under) < 3:
        return 1
    below, arcs = np.sort(under), np.eye(len(under))
    ends = np.searchsorted(below, under)
    matrix = 2.0 * arcs[np.searchsorted(below, over) % len(under)] - arcs[ends] - arcs[(ends + 1) % len(under)]
    return round(abs(np.linalg.det(matrix[1:, 1:])))
