"""How a point's pixel changes with the point and with the lens: derivatives of :meth:`Camera.project`, in closed form."""

import numpy as np

from doo_ti.vision.rig import COEFFICIENTS, Camera

LENS = 4 + COEFFICIENTS
"""Numbers of a lens: fx, fy, cx, cy, k1, k2, p1, p2, k3."""


def projection_jacobian(camera: Camera, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(..., 2, 3) px per mm that (..., 3) points move along the **camera's** axes, and (..., 2, 9) px by the lens.

    The points are in the world, as for ``camera.project``; by a move in the world it is the first times ``camera.rotation``.
    """
    seen = np.asarray(points, dtype=np.float64) @ camera.rotation.T + camera.translation
    x, y, near = seen[..., 0] / seen[..., 2], seen[..., 1] / seen[..., 2], 1 / seen[..., 2]
    k1, k2, p1, p2, k3 = camera.distortion
    square = x * x + y * y
    radial = 1 + square * (k1 + square * (k2 + square * k3))
    steep = 2 * (k1 + square * (2 * k2 + square * 3 * k3))
    focal = np.array([camera.matrix[0, 0], camera.matrix[1, 1]])
    cross = x * y * steep + 2 * (p1 * x + p2 * y)
    by_ray = np.stack([
        np.stack([radial + x * x * steep + 2 * p1 * y + 6 * p2 * x, cross], axis=-1),
        np.stack([cross, radial + y * y * steep + 6 * p1 * y + 2 * p2 * x], axis=-1)], axis=-2)
    zero = np.zeros_like(x)
    ray_by_point = np.stack([np.stack([near, zero, -x * near], axis=-1), np.stack([zero, near, -y * near], axis=-1)], axis=-2)
    by_point = focal[:, None] * (by_ray @ ray_by_point)
    bent = (camera.project(points) - camera.matrix[:2, 2]) / focal
    by_lens = np.zeros((*x.shape, 2, LENS))
    for axis, along in enumerate((x, y)):
        by_lens[..., axis, axis] = bent[..., axis]
        by_lens[..., axis, 2 + axis] = 1
        by_lens[..., axis, 4], by_lens[..., axis, 5], by_lens[..., axis, 8] = (
            focal[axis] * along * square**power for power in (1, 2, 3))
        by_lens[..., axis, 6 + axis] = focal[axis] * 2 * x * y
        by_lens[..., axis, 7 - axis] = focal[axis] * (square + 2 * along * along)
    return by_point, by_lens
