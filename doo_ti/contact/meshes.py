"""Obstacles as triangles, for pictures and recordings. Axes: N vertices, M triangles."""

import numpy as np

from doo_ti.contact.distance_grid import DistanceGrid
from doo_ti.contact.obstacles import BOX, CAPSULE, CYLINDER, PLANE, Obstacle

AROUND, ALONG = 48, 24  # vertices around an axis, and along a round profile
CORNERS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])  # of a box, over half its size
WIDER = 0.6  # of the size of the scene: half the side of the square that stands for a plane


def mesh(obstacle: Obstacle, row: int, centre: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (N, 3) in mm and triangles (M, 3) of one obstacle's surface.

    row           of the rod, where each has its own obstacle
    centre, size  (3,) and mm, of the scene, near which a plane is shown
    """
    point, axes, sizes, _ = (part[min(row, len(part) - 1)] for part in obstacle.placed)
    if obstacle.kind == PLANE:
        middle = (centre - point) @ axes * [1.0, 1.0, 0.0]
        local = middle + WIDER * size * np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)])
        triangles = np.array([(0, 1, 2), (0, 2, 3)])
    elif obstacle.kind == BOX:
        local = sizes * CORNERS
        quads = np.array([(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)])
        triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    elif isinstance(obstacle, DistanceGrid):
        local, triangles = _surface(obstacle.values)
        local = sizes[0] * local
    else:
        local, triangles = _revolved(_profile(obstacle.kind, sizes))
    return point + local @ axes.T, triangles


def _profile(kind: int, sizes: np.ndarray) -> np.ndarray:
    """(P, 2) distance from the axis and place along it of the profile of a body of revolution."""
    a, b = sizes[:2]
    if kind == CYLINDER:
        return np.array([(0.0, -b), (a, -b), (a, b), (0.0, b)])
    if kind == CAPSULE:
        angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, ALONG)
        return np.stack([a * np.cos(angle), a * np.sin(angle) + b * np.sign(angle)], axis=-1)
    angle = np.linspace(0.0, 2 * np.pi, ALONG)
    return np.stack([a + b * np.cos(angle), b * np.sin(angle)], axis=-1)


def _revolved(profile: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The surface that a profile (P, 2) makes around the third axis."""
    angle = 2 * np.pi * np.arange(AROUND) / AROUND
    radial = profile[:, :1] * np.stack([np.cos(angle), np.sin(angle)])[:, None]  # (2, P, AROUND)
    vertices = np.concatenate([radial, np.broadcast_to(profile[:, 1:], radial.shape[1:])[None]]).transpose(2, 1, 0)
    count = len(profile)
    here = (np.arange(AROUND)[:, None] * count + np.arange(count - 1)).ravel()
    beside = (here + count) % (AROUND * count)
    return vertices.reshape(-1, 3), np.concatenate([np.stack([here, beside, here + 1], -1),
                                                    np.stack([beside, beside + 1, here + 1], -1)])


def _surface(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The surface where distances on a grid are zero, in steps of the grid: in each cell that it crosses a vertex, at the mean
    of where it crosses the cell's edges, and a quad across each edge of the grid that it crosses."""
    inside = values < 0
    total, count, quads = np.zeros((*values.shape, 3)), np.zeros(values.shape), []
    for axis in range(3):
        here, beside = (np.take(values, np.arange(values.shape[axis] - 1) + step, axis=axis) for step in (0, 1))
        place = np.stack(np.nonzero((here < 0) != (beside < 0)), axis=-1)
        first, second = here[tuple(place.T)], beside[tuple(place.T)]
        crossing = place + (first / (first - second))[:, None] * np.eye(3)[axis]
        around = [-np.eye(3, dtype=int)[(axis + 1) % 3] * a - np.eye(3, dtype=int)[(axis + 2) % 3] * b
                  for a, b in ((0, 0), (0, 1), (1, 1), (1, 0))]
        cells = place[:, None] + around  # (N, 4, 3) the cells that share the edge; the border is outside, so that all exist
        np.add.at(total, tuple(np.moveaxis(cells, -1, 0)), crossing[:, None])
        np.add.at(count, tuple(np.moveaxis(cells, -1, 0)), 1.0)
        cells[inside[tuple(place.T)]] = cells[inside[tuple(place.T)], ::-1]
        quads.append(cells)
    crossed = count > 0
    number = np.cumsum(crossed).reshape(count.shape) - 1
    corners = number[tuple(np.moveaxis(np.concatenate(quads), -1, 0))]
    return total[crossed] / count[crossed][:, None], np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]])
