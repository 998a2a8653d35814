"""Bundle adjustment: lenses and poses of all cameras and the poses of the board in all views at once.

Minimises the squared pixel distances between seen and projected corners. One pose is held, the one that the world's axes lie
in, so that the normal matrix is regular and its inverse the covariance.

Axes: C cameras, V views, N corners of the board, P unknowns.
"""

from dataclasses import dataclass, replace

import numpy as np

from doo_ti.frames import rotation_matrix
from doo_ti.vision.cameras.camera import LENS, Camera
from doo_ti.vision.cameras.least_squares import least_squares

POSE = 6
MOST_STEPS = 100
LITTLE = 1e-10
"""Done when a step lowers the sum of squares by less than this share."""
SINGULAR = 1e-13
"""Smallest eigenvalue of the normal matrix, its diagonal scaled to ones, that still determines all unknowns."""


@dataclass(frozen=True)
class Sighting:
    """The corners ``found`` (n,) of the board in the image that ``camera`` took of ``view``, at ``pixels`` (n, 2)."""

    view: int
    camera: int
    found: np.ndarray
    pixels: np.ndarray


@dataclass(frozen=True)
class Bundle:
    """C cameras and the poses x = R p + t of the board in V views: rotations (V, 3, 3), translations (V, 3) mm."""

    cameras: tuple[Camera, ...]
    rotations: np.ndarray
    translations: np.ndarray

    def residual(self, points: np.ndarray, sighting: Sighting) -> np.ndarray:
        """(n, 2) px that the corners ``points`` (N, 3) of the board project away from where they were seen."""
        return self.cameras[sighting.camera].project(self.corners(points, sighting)) - sighting.pixels

    def corners(self, points: np.ndarray, sighting: Sighting) -> np.ndarray:
        """(n, 3) mm, in the world."""
        return points[sighting.found] @ self.rotations[sighting.view].T + self.translations[sighting.view]

    def moved(self, step: np.ndarray) -> "Bundle | None":
        """The bundle after a step (P,): rotations turn by it about the axes of what they lead to; None for no camera."""
        count, cameras = len(self.cameras), []
        for camera, change in zip(self.cameras, step[: count * (LENS + POSE)].reshape(count, -1)):
            matrix = camera.matrix.copy()
            matrix[[0, 1, 0, 1], [0, 1, 2, 2]] += change[:4]
            if not (matrix[0, 0] > 0 and matrix[1, 1] > 0):
                return None
            cameras.append(replace(camera, matrix=matrix, distortion=camera.distortion + change[4:LENS],
                                   rotation=rotation_matrix(change[LENS:-3]) @ camera.rotation,
                                   translation=camera.translation + change[-3:]))
        poses = step[count * (LENS + POSE):].reshape(-1, POSE)
        return Bundle(tuple(cameras), rotation_matrix(poses[:, :3]) @ self.rotations, self.translations + poses[:, 3:])


def adjusted(bundle: Bundle, points: np.ndarray, sightings: list[Sighting], free: np.ndarray) -> tuple[Bundle, np.ndarray]:
    """The bundle that fits the ``sightings`` of the board's corners ``points`` (N, 3) best, and the covariance (P, P) of its
    unknowns for corners seen with a standard deviation of one pixel, in the order that :func:`places` gives.

    free  (P,) bool: unknowns that are fitted; the others stay, with zero covariance. One pose must be among these.

    Raises LinAlgError where the sightings do not determine what is free.
    """
    def moved(bundle, steps):
        step = np.zeros(len(free))
        step[free] = steps[0]
        return bundle.moved(step)

    bundle, _, normal = least_squares(
        bundle, lambda trial: _normal_equations(trial, points, sightings, free), moved,
        lambda better, trial, before: trial if better[0] else before,
        lambda step, gain, cost: (gain >= 0) & (gain <= LITTLE * cost), 1e-3, MOST_STEPS)
    covariance = np.zeros((len(free), len(free)))
    covariance[np.ix_(free, free)] = _inverse(normal[0])
    return bundle, covariance


def places(cameras: int, views: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where in P unknowns stand the lenses (C, 9), the cameras' poses (C, 6) and the board's (V, 6): turn first, then t."""
    of_cameras = np.arange(cameras * (LENS + POSE)).reshape(cameras, -1)
    of_views = cameras * (LENS + POSE) + np.arange(views * POSE).reshape(views, POSE)
    return of_cameras[:, :LENS], of_cameras[:, LENS:], of_views


def _normal_equations(bundle: Bundle | None, points: np.ndarray, sightings: list[Sighting], free: np.ndarray):
    """(1,) px² the sum of squares, infinite for corners that are not in front of their camera and for no bundle, (1, F, F) JᵀJ
    and (1, F) Jᵀr of the F unknowns that are free."""
    normal, slope, cost = np.zeros((len(free), len(free))), np.zeros(len(free)), np.inf if bundle is None else 0.0
    for sighting in [] if bundle is None else sightings:
        lenses, of_cameras, of_views = places(len(bundle.cameras), len(bundle.rotations))
        camera = bundle.cameras[sighting.camera]
        world = bundle.corners(points, sighting)
        pixel, by_point, by_lens = camera.project_with_jacobian(world)
        residual = (pixel - sighting.pixels).ravel()
        by_world = by_point @ camera.rotation
        jacobian = np.concatenate([
            by_lens, -by_point @ cross_matrix(world @ camera.rotation.T), by_point,
            -by_world @ cross_matrix(world - bundle.translations[sighting.view]), by_world], axis=-1)
        jacobian = jacobian.reshape(-1, jacobian.shape[-1])
        at = np.concatenate([lenses[sighting.camera], of_cameras[sighting.camera], of_views[sighting.view]])
        normal[np.ix_(at, at)] += jacobian.T @ jacobian
        slope[at] += jacobian.T @ residual
        cost += residual @ residual
    cost = cost if np.isfinite(cost) else np.inf
    return np.array([cost]), normal[np.ix_(free, free)][None], slope[free][None]


def _inverse(normal: np.ndarray) -> np.ndarray:
    """The inverse, after scaling the diagonal to ones: pixels, millimetres and coefficients differ by many powers of ten."""
    scale = 1 / np.sqrt(np.maximum(np.diag(normal), np.finfo(float).tiny))
    scaled = normal * scale * scale[:, None]
    if not np.linalg.eigvalsh(scaled)[0] > SINGULAR:
        raise np.linalg.LinAlgError("the normal matrix is singular")
    return np.linalg.inv(scaled) * scale * scale[:, None]


def cross_matrix(vector: np.ndarray) -> np.ndarray:
    """(..., 3, 3) that turns u into ``vector`` × u."""
    result = np.zeros((*vector.shape, 3))
    x, y, z = (vector[..., k] for k in range(3))
    result[..., 0, 1], result[..., 0, 2], result[..., 1, 2] = -z, y, -x
    result[..., 1, 0], result[..., 2, 0], result[..., 2, 1] = z, -y, x
    return result
