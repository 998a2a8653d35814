"""Rods that fall on obstacles and swing into them, drawn at random."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from doo_ti import Box, Capsule, Clamp, Configuration, Cylinder, Dynamics, Grippers, Material, Plane, Sphere, Stepping, simulate
from doo_ti.rod.frames import across, bishop_frames, quaternion_from_matrix, unit_vectors
from tests.references.rods import clamps_at

EDGES, FRAMES = 15, 100
SCENES = ("flat", "table", "slope", "ball", "box", "drum", "wall", "peg")
"""Rods fall level or at an angle on a table, on a slope, on a ball, on a turned box and on an upright cylinder; held at one end
they swing into a wall and a peg."""


def along(tangents: np.ndarray, length: np.ndarray) -> Configuration:
    """Rods (R) of that ``length`` (R,) mm from the origin along ``tangents`` (R, E, 3)."""
    frames = quaternion_from_matrix(bishop_frames(tangents, across(tangents[:, 0])))
    return Configuration(np.zeros((len(length), 3)), frames, np.repeat(length[:, None] / EDGES, EDGES, axis=1))


def falling(rng, scene: str, length: np.ndarray, radius: np.ndarray):
    """Free rods and what they fall on."""
    count = len(length)
    t = unit_vectors(rng.normal(size=(count, 3)) * [1.0, 1.0, scene != "flat"])
    bent = 0.1 * np.cumsum(rng.normal(size=(count, EDGES, 3)), axis=1) * rng.uniform(0, 1, (count, 1, 1)) * (scene != "flat")
    rods = along(unit_vectors(t[:, None] + bent), length)
    x = rods.vertices
    zero, fall = np.zeros(count), rng.uniform(0.05, 0.5, count) * length + radius
    normal = unit_vectors(np.stack([rng.uniform(-0.5, 0.5, count) * (scene == "slope"), zero, zero + 1.0], axis=-1))
    below = np.einsum("rvi,ri->rv", x, normal).min(axis=1) - fall
    obstacles = [Plane(normal * below[:, None], normal)]
    if scene == "ball":
        size = rng.uniform(0.1, 0.3, count) * length
        top = below + 0.9 * (fall - radius)
        obstacles.append(Sphere(x.mean(axis=1) * [1.0, 1.0, 0.0] + np.stack([zero, zero, top - size], axis=-1), size))
    if scene == "drum":
        size, high = rng.uniform(0.05, 0.2, count) * length, below + 0.9 * (fall - radius)
        foot, top = (x.mean(axis=1) * [1.0, 1.0, 0.0] + np.stack([zero, zero, z], axis=-1) for z in (high - 2.0 * size, high))
        obstacles.append(Cylinder(foot, top, size))
    if scene == "box":
        size = rng.uniform(0.1, 0.4, (count, 3)) * length[:, None]
        turn = Rotation.from_rotvec(np.stack([zero, zero, rng.uniform(0.0, 1.5, count)], axis=-1)).as_matrix()
        top = below + 0.9 * (fall - radius)
        middle = x.mean(axis=1) * [1.0, 1.0, 0.0] + np.stack([zero, zero, top - 0.5 * size[:, 2]], axis=-1)
        obstacles.append(Box(middle, size, turn))
    return rods, Clamp.FREE, obstacles


def swinging(rng, scene: str, length: np.ndarray, radius: np.ndarray):
    """Straight rods held at one end, and what they meet on their way down."""
    angle = rng.uniform(0.3, 1.5, len(length))
    zero = np.zeros(len(length))
    rods = along(np.repeat(np.stack([np.sin(angle), zero, -np.cos(angle)], axis=-1)[:, None], EDGES, axis=1), length)
    if scene == "wall":
        apart = radius + rng.uniform(0, 0.4, len(length)) * length
        held = rng.choice([Clamp.POSITION, Clamp.FRAME])
        return rods, held, [Plane(np.stack([-apart, zero, zero], axis=-1), (1.0, 0.0, 0.0))]
    depth = rng.uniform(0.2, 0.9, len(length)) * length
    ends = (np.stack([-0.05 * length, side * length, -depth], axis=-1) for side in (-1.0, 1.0))
    return rods, Clamp.POSITION, [Capsule(*ends, 0.03 * length)]


def moved(rng, scene: str, count: int, friction: float = 0.0, damping: float = 0.0, rate: float = 100.0, **stepping):
    """(R, frames) motions of ``count`` rods in that scene, from limp to stiff, with energies."""
    length = rng.uniform(100.0, 400.0, count)
    radius = 0.01 * length
    rods, held, obstacles = (swinging if scene in ("wall", "peg") else falling)(rng, scene, length, radius)
    bend = 10.0 ** rng.uniform(-4.0, 1.0, count) * length**3
    obstacles = [replace(obstacle, friction=friction) for obstacle in obstacles]
    grippers = Grippers.resting(clamps_at(rods, held, Clamp.FREE), FRAMES + 1)
    dynamics = Dynamics(bend_damping=damping, twist_damping=damping, drag=damping)
    return simulate(rods, Material(bend, bend * rng.uniform(0.5, 1.0, count)), grippers, dynamics,
                    Stepping(rate, **stepping), obstacles=obstacles, radius=radius)
