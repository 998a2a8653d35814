"""Rods amid obstacles of all kinds, drawn at random."""

import numpy as np

from doo_ti import Box, Capsule, Clamp, Clamps, Configuration, Cylinder, Material, Plane, Ring, Sphere, relax, straight_rod

LENGTH, EDGES, RADIUS = 100.0, 33, 0.5

OBSTACLES = (
    Cylinder((20, -50, -10), (20, 50, -14), 2.0), Capsule((60, -30, -15), (50, 50, -15), 3.0), Plane((0, 0, -30), (0, 0.2, 1)),
    Sphere((40, 10, -20), 6.0), Box((70, 15, -20), (10, 20, 10)), Ring((35, 15, -10), (1, 0.3, 0), 12, 2.0))
SLOPE_AND_BALL = {"obstacles": [Plane((0, 0, 0), (0.05, 0.02, 1)), Sphere((60, 3, -8), 12.0)], "radius": 2.0}
LEANING = straight_rod(LENGTH, 24, (0.0, 0.0, 12.0), (1.0, 0.2, -0.1))  # above these


def sagging(rng, count: int) -> tuple[Configuration, Material, Clamps]:
    """Rods between two frames that look along x, as they sag sideways: gravity then pulls them down onto the obstacles."""
    rods = straight_rod(LENGTH, EDGES).take(np.zeros(count, dtype=int))
    frames = rods.frames[:, 0]
    span, height = rng.uniform(30, 95, count), rng.uniform(-20, 20, count)
    clamps = Clamps(Clamp.FRAME, Clamp.FRAME, np.zeros((count, 3)), np.stack([span, 0 * span, height], -1), frames, frames)
    material = Material(10 ** rng.uniform(3.5, 6.5, count), 10 ** rng.uniform(4, 6, count))
    return relax(rods, material, clamps, up=(0.0, -1.0, -0.3)).configuration, material, clamps


def gaps(obstacles, vertices: np.ndarray, radius: float, along: int = 24) -> np.ndarray:
    """(R,) the smallest gap of rods (R, V, 3), at so many places along every edge."""
    s = np.linspace(0.0, 1.0, along + 1)[:, None]
    places = vertices[:, :-1, None] * (1.0 - s) + vertices[:, 1:, None] * s
    places = places.reshape(len(vertices), -1, 3)
    return np.min([obstacle.distance(places)[0].min(axis=1) for obstacle in obstacles], axis=0) - radius


def differences(obstacle, points: np.ndarray) -> np.ndarray:
    """(R, N, 3) derivatives of the distance at ``points`` (R, N, 3), by central differences."""
    h = 1e-6
    return np.stack([(obstacle.distance(points + h * axis)[0] - obstacle.distance(points - h * axis)[0]) / (2 * h)
                     for axis in np.eye(3)], axis=-1)
