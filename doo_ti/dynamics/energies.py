"""Energies of round rods that move, from their positions. Axes: R rods, T frames, V vertices."""

import numpy as np

from doo_ti.dynamics.parameters import GRAVITY, Dynamics, vertex_lengths
from doo_ti.types import Material


def energies(positions: np.ndarray, rest_length: np.ndarray, material: Material, dynamics: Dynamics, rate: float,
             up: np.ndarray) -> dict[str, np.ndarray]:
    """(R, T) kinetic energy, by central differences, gravity, bending, and their sum, mm², of (R, T, V, 3) positions in mm.

    material, dynamics  one row for each rod, straight at rest; bending is Σ α |κb|²/l̄ (§III-C E_bend). What the sum loses is
                        dissipated, or was done at the grippers.
    """
    share = vertex_lengths(rest_length)
    weight = material.weight[:, None, None]
    density = weight if dynamics.density is None else dynamics.column("density", len(positions))[:, None, None]
    point = dynamics.point_masses(len(positions), positions.shape[2])[:, None]
    velocity = np.gradient(positions, 1.0 / rate, axis=1)
    kinetic = (density / GRAVITY * (share + point) * (velocity**2).sum(axis=-1)).sum(axis=-1)
    gravity = (2.0 * weight * (share + point) * (positions @ up)).sum(axis=-1)
    edges = np.diff(positions, axis=2)
    t = edges / np.linalg.norm(edges, axis=-1, keepdims=True)
    before, after = t[:, :, :-1], t[:, :, 1:]
    curvature = 2.0 * np.cross(before, after) / (1.0 + np.sum(before * after, axis=-1, keepdims=True))
    both = rest_length[:-1] + rest_length[1:]
    bend = (material.bend[:, :1, 0, 0][:, :, None] * (curvature**2).sum(axis=-1) / both).sum(axis=-1)
    gravity = gravity - gravity[:, :1]
    return {"kinetic": kinetic, "gravity": gravity, "bending": bend, "sum": kinetic + gravity + bend}
