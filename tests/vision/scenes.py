"""A rig and rods to render, and the errors of a detection against the drawn curve."""

import cv2
import numpy as np

from doo_ti import Camera, Detection, Rig


def small_rig(count: int = 2) -> Rig:
    """Distorted cameras 250 mm from the origin, 480 × 360 px."""
    cameras = []
    for index in range(count):
        rotation = cv2.Rodrigues(np.array([0.3 - 0.5 * index, 0.4 * index, 0.1]))[0]
        matrix = [[600.0, 0, 240 + index], [0, 600.0, 180], [0, 0, 1]]
        distortion = [-0.08, 0.03, 5e-4, -4e-4, 0]
        cameras.append(Camera(f"cam{index}", 480, 360, matrix, distortion, rotation, np.array([0.0, 0, 250])))
    return Rig(tuple(cameras))


def bow(vertices: int = 34) -> np.ndarray:
    """(V, 3) mm: a bent and twisted rod some 110 mm long around the origin."""
    s = np.linspace(-1, 1, vertices)[:, None]
    return np.concatenate([45 * s, 18 * np.cos(2.2 * s) - 8, 9 * np.sin(3 * s)], axis=1)


def normals(line: np.ndarray) -> np.ndarray:
    """(n, 2) unit normals of a dense line (n, 2) px."""
    along = np.gradient(line, axis=0)
    return np.stack([-along[:, 1], along[:, 0]], axis=1) / np.linalg.norm(along, axis=1)[:, None]


def against(found: Detection, line: np.ndarray) -> tuple[np.ndarray, float, float]:
    """(n,) px signed errors of the points beside the line, share of the line that is covered, share of false points."""
    distance = np.linalg.norm(found.points[:, None] - line, axis=-1)
    nearest = distance.argmin(axis=1)
    error = ((found.points - line[nearest]) * normals(line)[nearest]).sum(axis=1)
    real = distance.min(axis=1) < max(3, 0.75 * found.width_px)  # the ends are round
    beside = real & (nearest > 0) & (nearest < len(line) - 1)
    return error[beside], float((distance.min(axis=0) < 1).mean()), float(1 - real.mean())
