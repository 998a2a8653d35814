"""Recordings of rods that nobody has seen: markers on curves that move smoothly, and motions simulated from a known Θ."""

import numpy as np
from scipy.spatial.transform import Rotation

from doo_ti import Clamp, Grippers, MotionTheta, Stepping, simulate
from doo_ti.dynamics.theta import simulated
from doo_ti.rod.frames import edge_frames
from tests.references.rods import chain, stacked

RATE = 100.0
SETTLING = 60  # instants for which the grippers rest before a simulated recording begins


def carried(rng, count: int, frames: int, markers: int, speed: float = 600.0) -> np.ndarray:
    """(count, frames, markers, 3) mm an arc with edges of 40 mm that is carried and turned, at about ``speed`` mm/s."""
    bend = np.linspace(-0.7, 0.7, markers - 1)
    tangents = np.stack([np.cos(bend), np.sin(bend), np.zeros(markers - 1)], axis=-1)
    arc = np.concatenate([np.zeros((1, 3)), np.cumsum(40.0 * tangents, axis=0)])
    times = np.arange(frames) / RATE
    positions = np.empty((count, frames, markers, 3))
    for r in range(count):
        direction = rng.normal(size=3)
        way = np.outer(times, speed * direction / np.linalg.norm(direction))
        way += 5.0 * np.sin(np.outer(times, rng.uniform(2, 6, 3)))
        turn = Rotation.from_rotvec(np.outer(np.sin(2.0 * times), rng.normal(size=3) * 0.3))
        positions[r] = np.stack([one.apply(arc) for one in turn]) + way[:, None]
    return positions


def gripper_paths(rng, count: int, frames: int, last: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(start positions, first edges, end positions, last edges), all (count, frames, 3): at rest along x for SETTLING
    instants, at the origin and at ``last``; then swinging ever more, mostly together."""
    times = np.maximum(np.arange(frames) - SETTLING, 0) / RATE
    ramp = (times / 0.3) ** 2 / (1.0 + (times / 0.3) ** 2)

    def swing(size):
        rates, phases = rng.uniform(6.0, 14.0, (2, count, 1, 3)), rng.uniform(0, 2 * np.pi, (2, count, 1, 3))
        return size * ramp[:, None] * np.sum(np.sin(rates * times[:, None] + phases), axis=0)

    together, ends = swing(40.0), []
    for place in (np.zeros(3), last):
        turn = Rotation.from_rotvec(swing(0.25).reshape(-1, 3)).as_matrix().reshape(count, frames, 3, 3)
        ends += [place + together + swing(8.0), turn[..., 0]]
    return tuple(ends)


def recorded(rng, theta: MotionTheta, count: int, frames: int, noise: float) -> np.ndarray:
    """(count, frames, V, 3) mm what markers show of rods under ``theta``, held by both end frames, planar at first."""
    lengths, total = theta.rest_length, SETTLING + frames
    slopes = np.linspace(-1.0, 1.0, len(lengths)) * 1.6
    slopes[[0, -1]] = 0.0
    rods = stacked([chain(np.stack([np.cos(slopes), 0 * slopes, np.sin(slopes)], axis=-1), theta.reference, lengths)] * count)
    rods = type(rods)(rods.start, rods.quaternions, lengths)
    first, first_edge, last, last_edge = gripper_paths(rng, count, total, rods.vertices[0, -1])
    held = (edge_frames(edge, np.broadcast_to(theta.reference, (count, 3))) for edge in (first_edge, last_edge))
    material, dynamics = simulated([theta])
    found = simulate(rods, material, Grippers(Clamp.FRAME, Clamp.FRAME, first, last, *held), dynamics, Stepping(RATE))
    assert found.converged.all()
    return found.positions[:, SETTLING - 1 :] + noise * rng.normal(size=(count, frames, len(lengths) + 1, 3))
