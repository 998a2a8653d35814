"""A whole rod as a chain of frames: energy, and dense gradient and Hessian in body rotations (docs/chain.md)."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from doo_ti import Configuration, Material
from tests.oracle.algebra import add, body_rotated, directors, scale
from tests.oracle.pair import linear_gradient_hessian, pair_gradient_hessian, pair_parts


@dataclass(frozen=True)
class Rod:
    """What stays fixed while one rod moves.

    rest_length (E,), bend (E, 2, 2), twist (E−1,), weight a number, rest_curvature (E−1, 2), up (3,); turned: how the unknowns
    turn a frame, in which second derivatives away from an equilibrium differ.
    """

    rest_length: np.ndarray
    bend: np.ndarray
    twist: np.ndarray
    weight: float
    rest_curvature: np.ndarray
    up: np.ndarray
    turned: Callable = body_rotated

    @property
    def edges(self) -> int:
        return len(self.rest_length)

    @property
    def vertex_length(self) -> np.ndarray:
        """l̄_i of all V vertices, the ends with their one edge (§III-A)."""
        return np.append(self.rest_length, 0.0) + np.append(0.0, self.rest_length)


def rod_of(configuration: Configuration, material: Material, index=0, up=(0.0, 0.0, 1.0)) -> Rod:
    """Row ``index`` of a configuration table with the same row of the materials, or the only one."""
    row = index if material.count > 1 else 0
    edges, lengths = configuration.edges, configuration.rest_length
    rest = np.zeros((1, 2)) if material.rest_curvature is None else material.rest_curvature[row]
    return Rod(
        np.array(lengths if lengths.ndim == 1 else lengths[index]), np.broadcast_to(material.bend[row], (edges, 2, 2)),
        np.broadcast_to(material.twist[row], (edges - 1,)), float(material.weight[row]),
        np.broadcast_to(rest, (edges - 1, 2)), np.asarray(up, dtype=np.float64) / np.linalg.norm(up))


def chain_energy(rod: Rod, start, quaternions):
    """Bend, twist and gravity energy; start (3,) and quaternions (E, 4) as sequences of numbers of any kind."""
    bending = twisting = 0.0
    for i in range(1, rod.edges):
        parts = pair_parts(quaternions[i - 1], quaternions[i], rod.rest_length[i - 1], rod.rest_length[i], rod.bend[i - 1],
                           rod.bend[i], rod.twist[i - 1], rod.rest_curvature[i - 1])
        bending, twisting = bending + parts[0], twisting + parts[1]
    gravity, vertex = 0.0, list(start)
    for i, length in enumerate(rod.vertex_length):
        gravity = gravity + rod.weight * length * sum(up * x for up, x in zip(rod.up, vertex, strict=True))
        if i < rod.edges:
            vertex = add(vertex, scale(rod.rest_length[i], directors(quaternions[i])[0]))
    return bending, twisting, gravity


def chain_derivatives(rod: Rod, quaternions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(3E,) gradient and (3E, 3E) Hessian of E in the body rotations of all edges, start held."""
    gradient, hessian = assembled(*pair_gradient_hessian(
        quaternions[:-1], quaternions[1:], rod.rest_length[:-1], rod.rest_length[1:], rod.bend[:-1], rod.bend[1:], rod.twist,
        rod.rest_curvature, rod.turned))
    above = np.cumsum(rod.vertex_length[::-1])[::-1][1:]
    # Gravity is Σ_j c_j·t_j l_j + μ up·x_0 Σ l̄_i with c_j = μ up Σ_{i>j} l̄_i.
    weight = linear_derivatives(rod, quaternions, rod.weight * above[:, None] * rod.up)
    return gradient + weight[0], hessian + weight[1]


def assembled(gradients: np.ndarray, hessians: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(3E,) and (3E, 3E) sums over the joints of their (E − 1, 6) gradients and (E − 1, 6, 6) Hessians."""
    size = 3 * len(gradients) + 3
    gradient, hessian = np.zeros(size), np.zeros((size, size))
    for i in range(len(gradients)):
        block = slice(3 * i, 3 * i + 6)
        gradient[block] += gradients[i]
        hessian[block, block] += hessians[i]
    return gradient, hessian


def linear_derivatives(rod: Rod, quaternions: np.ndarray, force: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(3E,) gradient and (3E, 3E) block-diagonal Hessian of Σ l c·t, force c (3,) or per edge (E, 3)."""
    gradient, blocks = linear_gradient_hessian(force, quaternions, rod.rest_length, rod.turned)
    return gradient.ravel(), block_diag(*blocks)
