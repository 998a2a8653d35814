"""Planar rods to move, what theory and independent integrators say of them, and frequencies of recorded oscillations."""

import numpy as np
from scipy.integrate import solve_ivp

from doo_ti import Clamp, Configuration, Grippers
from tests.references.rods import chain, clamps_at

GRAVITY = 9806.65  # mm/s²
MASS_PER_LENGTH = 2.0 / GRAVITY  # of a rod of density 1


def planar(angles, length: float, start=(0.0, 0.0, 0.0)) -> Configuration:
    """A rod in the plane of x and z whose edges, of ``length``, rise from x by ``angles`` (E,)."""
    return chain(np.stack([np.cos(angles), 0 * angles, np.sin(angles)], axis=-1), [0.0, 1.0, 0.0], length, start)


def resting(rods: Configuration, start: Clamp, end: Clamp, instants: int) -> Grippers:
    return Grippers.resting(clamps_at(rods, start, end), instants)


def shares(edges: int, length: float) -> np.ndarray:
    """(V,) mm of rod that each vertex carries."""
    return length * np.array([0.5, *[1.0] * (edges - 1), 0.5])


def joint_moments(angles: np.ndarray, bend: float, length: float) -> np.ndarray:
    """(E,) the slopes of a planar chain's bending energy: ω = 2 tan(θ/2) of both edges, ½ B ω²/l̄ each, l̄ = 2 ``length``."""
    half = np.diff(angles) / 2
    moment = 4.0 * bend * np.tan(half) / np.cos(half) ** 2 / (2.0 * length)
    return np.append(0.0, moment) - np.append(moment, 0.0)


def swinging_chain(angles, length: float, bend: float, times) -> np.ndarray:
    """(T, V, 3) a planar chain of point masses that hangs from vertex 0, let go at rest, by an integrator of order eight.

    In the angles a_j: Σ_k M_jk (cos(a_j − a_k) ä_k + sin(a_j − a_k) ȧ_k²) = −g W_j cos a_j − moments, M_jk = l² Σ m_i over the
    vertices beyond both edges.
    """
    edges = len(angles)
    mass = MASS_PER_LENGTH * shares(edges, length)[1:]
    beyond = np.cumsum(mass[::-1])[::-1]
    coupling = length**2 * beyond[np.maximum.outer(np.arange(edges), np.arange(edges))]

    def rates(_, state):
        a, speed = state[:edges], state[edges:]
        apart = a[:, None] - a[None]
        force = -GRAVITY * length * beyond * np.cos(a) - joint_moments(a, bend, length) - (coupling * np.sin(apart)) @ speed**2
        return np.concatenate([speed, np.linalg.solve(coupling * np.cos(apart), force)])

    found = solve_ivp(rates, (0.0, times[-1]), np.concatenate([angles, np.zeros(edges)]), "DOP853", times, rtol=1e-12,
                      atol=1e-13)
    a = found.y[:edges].T
    places = np.cumsum(length * np.stack([np.cos(a), 0 * a, np.sin(a)], axis=-1), axis=1)
    return np.pad(places, ((0, 0), (1, 0), (0, 0)))


def oscillation(values: np.ndarray, interval: float) -> float:
    """rad/s of values (T,) that oscillate at one frequency, ``interval`` s apart: by linear prediction from the two before."""
    before = np.stack([values[1:-1], values[:-2]], axis=1)
    first, second = np.linalg.lstsq(before, values[2:], rcond=None)[0]
    return float(np.abs(np.angle(np.roots([1.0, -first, -second]))).max() / interval)


def clamped_mode(k: int, places: np.ndarray) -> tuple[float, np.ndarray]:
    """(βL, slopes at ``places`` in [0, 1]) of mode ``k`` of a cantilever, of unit length."""
    root = (1.87510407, 4.69409113, 7.85475744)[k]
    at, ratio = root * places, (np.sinh(root) - np.sin(root)) / (np.cosh(root) + np.cos(root))
    return root, root * (np.sinh(at) + np.sin(at) - ratio * (np.cosh(at) - np.cos(at))) / 2.0


def pinned_mode(k: int, places: np.ndarray) -> tuple[float, np.ndarray]:
    """The same of a rod with both ends pinned."""
    root = (k + 1) * np.pi
    return root, root * np.cos(root * places)
