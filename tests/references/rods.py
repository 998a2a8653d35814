"""Rods to start from, the clamps that hold them, and orders of convergence."""

from dataclasses import replace

import numpy as np
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from doo_ti import Clamp, Clamps, Configuration, Material, Observations, relax
from doo_ti.rod.frames import bishop_frames, quaternion_from_matrix, total_twist


def chain(tangents, m1, rest_length, start=(0.0, 0.0, 0.0), spin=None) -> Configuration:
    """One rod along tangents (E, 3): Bishop frames from ``m1``, each turned about its tangent by ``spin`` (E,), rad."""
    tangents = np.asarray(tangents, dtype=float)
    tangents = tangents / np.linalg.norm(tangents, axis=1, keepdims=True)
    frames = bishop_frames(tangents, np.asarray(m1, dtype=float))
    if spin is not None:
        frames = frames @ Rotation.from_rotvec(np.outer(spin, [1.0, 0.0, 0.0])).as_matrix()
    lengths = np.broadcast_to(np.asarray(rest_length, dtype=float), (len(tangents),)).copy()
    return Configuration(np.array([start], dtype=float), quaternion_from_matrix(frames)[None], lengths)


def stacked(rods: list[Configuration]) -> Configuration:
    """Single rods of equal edge count as one table."""
    return Configuration(
        np.concatenate([rod.start for rod in rods]), np.concatenate([rod.quaternions for rod in rods]),
        np.stack([np.broadcast_to(rod.rest_length, (rod.edges,)) for rod in rods]))


def planar(slope, length, span: float) -> Configuration:
    """A rod in the vertical plane whose tangents dip by a·slope (E,), a such that it spans ``span``."""
    size = brentq(lambda a: np.sum(length * np.cos(a * slope)) - span, 1e-6, 2.0)
    return chain(np.stack([np.cos(size * slope), 0 * slope, -np.sin(size * slope)], axis=1), [0, 1, 0], length)


def bows(*sizes: float, edges: int = 33, rest_length: float = 3.0, twist=0.0) -> Configuration:
    """Bows between clamps that are not on one line, each twisted by so much."""
    angles = [np.linspace(-size, size, edges) for size in sizes]
    spins = np.outer(np.broadcast_to(twist, len(sizes)), np.linspace(0.0, 1.0, edges))
    rods = stacked([chain(np.stack([np.cos(angle), 0.5 * np.sin(2 * angle), np.sin(angle)], axis=1), [0, 1, 0], rest_length,
                          spin=spin) for angle, spin in zip(angles, spins, strict=True)])
    return replace(rods, rest_length=rods.rest_length[0])


def certified(solution):
    """A solution, of rods or of groups, all of which has converged to certified minima."""
    assert solution.converged.all() and solution.stable.all(), solution
    return solution


def at_rest(rods: Configuration, material: Material) -> Configuration:
    """Relaxed between their own clamps."""
    return certified(relax(rods, material, clamps_at(rods))).configuration


def observed(rods: Configuration) -> Observations:
    """Of them all, without noise; they have the same rest lengths."""
    return Observations(rods.vertices, rest_length=np.atleast_2d(rods.rest_length)[0], start_frame=rods.frames[:, 0],
                        end_frame=rods.frames[:, -1], total_twist=total_twist(rods.quaternions))


def clamps_at(configuration: Configuration, start=Clamp.FRAME, end=Clamp.FRAME) -> Clamps:
    """Clamps that hold the ends where they are."""
    vertices, frames = configuration.vertices, configuration.frames
    return Clamps(start, end, vertices[:, 0], vertices[:, -1], frames[:, 0], frames[:, -1])


def jiggled(configuration: Configuration, rng: np.random.Generator, size: float) -> Configuration:
    """Every frame rotated at random by about ``size`` rad: a start away from the solution."""
    turns = Rotation.from_rotvec(size * rng.normal(size=(configuration.count * configuration.edges, 3)))
    old = Rotation.from_quat(configuration.quaternions.reshape(-1, 4), scalar_first=True)
    quaternions = (old * turns).as_quat(scalar_first=True).reshape(configuration.quaternions.shape)
    return replace(configuration, quaternions=quaternions)


def orders(edges, errors) -> np.ndarray:
    """Orders p of errors ~ edges^−p between successive refinements."""
    return -np.diff(np.log(np.asarray(errors))) / np.diff(np.log(np.asarray(edges, dtype=float)))
