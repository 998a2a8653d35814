"""What a time step adds to the energy of rods: a spring at every vertex, and rest curvature and twist (docs/dynamics.md).

Axes: G materials, R rods, V vertices.
"""

import numpy as np

from doo_ti.dynamics.parameters import GRAVITY, Dynamics, vertex_lengths
from doo_ti.relaxation.point_loads import PointLoads
from doo_ti.relaxation.time_sweep import (
    DRAG,
    DRAG_BY_SPEED,
    FORCE,
    INERTIA,
    LOAD,
    SPRING,
    SPRING_POINT,
    VERTEX_ITEMS,
)
from doo_ti.rod.types import Material
from doo_ti.system.errors import InputError


def damping_shares(dynamics: Dynamics, count: int, rate: float) -> np.ndarray:
    """(count, 2) shares of rest curvature and twist that damping adds, r = τ a/h / (1 + τ a/h), of materials at the ``rate``
    a/h of a step."""
    tau = np.stack([dynamics.column(name, count) for name in ("bend_damping", "twist_damping")], axis=1)
    return tau * rate / (1.0 + tau * rate)


def stiffened(material: Material, dynamics: Dynamics, rate: float) -> Material:
    """The material with the stiffness that damping adds, and its rest curvature in that."""
    if not dynamics.is_damped:
        return material
    shares = damping_shares(dynamics, material.count, rate)
    stiffer = 1.0 / (1.0 - shares)
    rest = np.zeros((1, 1, 2)) if material.rest_curvature is None else material.rest_curvature
    return Material(material.bend * stiffer[:, :1, None, None], material.twist * stiffer[:, 1:], material.weight,
                    rest * (1.0 - shares[:, :1, None]), material.weight_per_length)


def vertex_numbers(source: str, material: Material, dynamics: Dynamics, lengths: np.ndarray, rows: np.ndarray,
                   rate: float) -> np.ndarray:
    """(R, V, VERTEX_ITEMS − INERTIA) of rods with edges of ``lengths`` (1 or R, E) mm and the materials ``rows`` (R,), at the
    ``rate`` a/h of a step: what :mod:`doo_ti.relaxation.time_sweep` has of a vertex from INERTIA on, without loads.

    Raises InputError, naming ``source``, for rods without mass.
    """
    share, count = vertex_lengths(lengths), material.count
    weight = material.weight[rows]
    density = weight if dynamics.density is None else dynamics.column("density", count)[rows]
    if not (density > 0).all():
        raise InputError(source, "density", "zero, since the material has no weight", "give Dynamics(density=...)")
    point = dynamics.point_masses(count, share.shape[1])[rows]
    mass = 2.0 * density[:, None] / GRAVITY * share
    numbers = np.zeros((len(rows), share.shape[1], VERTEX_ITEMS - INERTIA))
    numbers[..., 0] = (mass + 2.0 * density[:, None] / GRAVITY * point) * rate**2
    numbers[..., DRAG - INERTIA] = mass * dynamics.column("drag", count)[rows, None] * rate
    numbers[..., DRAG_BY_SPEED - INERTIA] = mass * dynamics.column("quadratic_drag", count)[rows, None] * rate
    numbers[..., LOAD - INERTIA] = 2.0 * weight[:, None] * point
    return numbers


def add_loads(numbers: np.ndarray, loads: PointLoads, rate: float) -> None:
    """Add the masses, forces and springs of ``loads``, of R rows or one, to :func:`vertex_numbers`, in place."""
    numbers[..., 0] += loads.mass / GRAVITY * rate**2
    numbers[..., LOAD - INERTIA] += loads.mass
    numbers[..., FORCE - INERTIA : SPRING - INERTIA] = loads.force
    if loads.springs is not None:
        numbers[..., SPRING - INERTIA] = loads.springs.stiffness
        numbers[..., SPRING_POINT - INERTIA :] = loads.springs.points
