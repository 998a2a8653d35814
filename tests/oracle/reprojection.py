"""E_proj of edges, slow and direct: point by point, derivatives by a complex step.

    E_proj = (1/n) Σ_k D_c(p(x_k)) |∂p/∂x Δ|,   x_k = a + (k − ½)/n Δ,   D_c = D/√(1 + D²/cap²)

with D the quadratic B-spline over the map's pixels, continued outside its window by the way to the border.
"""

from dataclasses import dataclass

import numpy as np

STEP = 1e-30


@dataclass(frozen=True)
class Map:
    """One distance map: distances (height, width) px, and the pixel of its upper left corner."""

    distances: np.ndarray
    left: int
    top: int

    def at(self, pixel):
        """D at a pixel (2,), complex or real."""
        height, width = self.distances.shape
        column, beyond_x, share_x = _inside(pixel[0] - self.left, width)
        line, beyond_y, share_y = _inside(pixel[1] - self.top, height)
        patch = self.distances[line - 1 : line + 2, column - 1 : column + 2].astype(np.float64)
        outside = 0.0 if beyond_x == 0 and beyond_y == 0 else np.sqrt(beyond_x**2 + beyond_y**2)
        return _spline(share_y) @ patch @ _spline(share_x) + outside


def _inside(place, size):
    """(middle pixel of three, way outside, place beside that pixel)."""
    held = place if 0.5 < place.real < size - 1.5 else min(max(place.real, 0.5), size - 1.5)
    middle = min(int(np.floor(held.real + 0.5)), size - 2)
    return middle, place - held, held - middle


def _spline(t):
    """The quadratic B-spline at −1 − t, −t and 1 − t, from its definition by cases."""
    distances = (u if u.real >= 0 else -u for u in (t + 1, t, t - 1))
    return np.array([(1.5 - u) ** 2 / 2 if u.real >= 0.5 else 0.75 - u * u for u in distances])


def projected(camera, point):
    """(2,) px of a point (3,), complex or real, with radial and tangential distortion as OpenCV has them; and its (2, 3)
    derivative, px/mm: analytic, so that a complex step may go through it."""
    seen = camera.rotation @ point + camera.translation
    x, y = seen[:2] / seen[2]
    k1, k2, p1, p2, k3 = camera.distortion
    square, focal = x * x + y * y, np.diag(camera.matrix)[:2]
    radial, growth = 1 + k1 * square + k2 * square**2 + k3 * square**3, 2 * k1 + 4 * k2 * square + 6 * k3 * square**2
    pixel = focal * [x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x),
                     y * radial + p1 * (square + 2 * y * y) + 2 * p2 * x * y] + camera.matrix[:2, 2]
    lens = np.array([[radial + growth * x * x + 2 * p1 * y + 6 * p2 * x, growth * x * y + 2 * p1 * x + 2 * p2 * y],
                     [growth * x * y + 2 * p1 * x + 2 * p2 * y, radial + growth * y * y + 6 * p1 * y + 2 * p2 * x]])
    plane = np.array([[1, 0, -x], [0, 1, -y]]) / seen[2]
    return pixel, np.diag(focal) @ lens @ plane @ camera.rotation


def edge_error(camera, distances: Map, start, end, points: int, cap: float):
    """E_proj of an edge in one camera, px²; complex vertices pass."""
    start, end = np.asarray(start), np.asarray(end)
    total = 0.0
    for k in range(points):
        point = start + (k + 0.5) / points * (end - start)
        pixel, slopes = projected(camera, point)
        far = distances.at(pixel) - 13 / 32  # the mean of |x| over three uniform spreads of a pixel's width
        motion = slopes @ (end - start)
        total = total + far / np.sqrt(1 + (far / cap) ** 2) * np.sqrt(motion @ motion)
    return total / points


def edge_gradient(camera, distances: Map, start, end, points: int, cap: float) -> np.ndarray:
    """(6,) ∂E/∂(start, end), exact."""
    places = np.concatenate([start, end]) + 1j * STEP * np.eye(6)
    return np.array([edge_error(camera, distances, place[:3], place[3:], points, cap).imag for place in places]) / STEP


def edge_hessian(camera, distances: Map, start, end, points: int, cap: float, step: float = 1e-5) -> np.ndarray:
    """(6, 6) second derivatives: central differences of the exact gradient."""
    ahead, behind = ([edge_gradient(camera, distances, place[:3], place[3:], points, cap)
                      for place in np.concatenate([start, end]) + way * np.eye(6)] for way in (step, -step))
    return np.transpose(np.subtract(ahead, behind)) / (2 * step)


def rod_energy(vertices: np.ndarray, alpha: float, mu: float, up: np.ndarray) -> float:
    """Bend and gravity of a rod without twist, §III-C at the vertices."""
    edges = np.diff(vertices, axis=0)
    lengths = np.linalg.norm(edges, axis=1)
    around = np.concatenate([lengths[:1], lengths[:-1] + lengths[1:], lengths[-1:]])
    scale = lengths[:-1] * lengths[1:] + np.sum(edges[:-1] * edges[1:], axis=1)
    binormals = 2 * np.cross(edges[:-1], edges[1:]) / scale[:, None]
    return alpha * float(np.sum(binormals**2, axis=1) @ (1 / around[1:-1])) + mu * float(around @ (vertices @ up))


def polyline_distance(pixels: np.ndarray, line: np.ndarray) -> np.ndarray:
    """(...) px from pixels (..., 2) to a polyline (P, 2), by trying all its segments."""
    best = np.full(pixels.shape[:-1], np.inf)
    for start, end in zip(line[:-1], line[1:]):
        along = end - start
        share = np.clip((pixels - start) @ along / (along @ along), 0, 1)
        best = np.minimum(best, np.linalg.norm(pixels - start - share[..., None] * along, axis=-1))
    return best
