"""Poses of cameras around a scene, for tests and tools that draw their own images."""

import numpy as np


def looking(forward: np.ndarray, distance: float, middle=(0.0, 0.0, 0.0)) -> tuple[np.ndarray, np.ndarray]:
    """(R, t) of an upright camera that looks along the unit vector ``forward`` at ``middle``, mm, from ``distance`` mm away."""
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    return rotation, -rotation @ (middle - distance * forward)
