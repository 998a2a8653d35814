"""The minimum of a group by dense linear algebra: Newton's method on all rods with their ties and held ends as constraints."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from doo_ti import Clamp, Group
from tests.oracle.chain_form import rod_of
from tests.oracle.equilibrium import State, clamped_start, free_variables, moved, vertices_of
from tests.oracle.external import Springs, total_derivatives, vertex_jacobian

STEPS = 60
NEUTRAL = 1e-9
"""Of the largest eigenvalue: a motion at constant energy."""


@dataclass(frozen=True)
class Reference:
    """vertices (V, 3) of each rod; tie_force (K, 3) on the first vertex of each tie; end_force (G, 3), zero of free ends;
    least, the smallest eigenvalue of the projected Hessian over the largest; residual, the largest of a force or moment that
    is left."""

    vertices: list[np.ndarray]
    tie_force: np.ndarray
    end_force: np.ndarray
    least: float
    residual: float


def reference(group: Group, row: int = 0, pushed: float = 1e-3, seed: int = 3) -> Reference:
    """The equilibrium near the shapes of ``group``, from where these are turned at random by ``pushed`` rad."""
    rng = np.random.default_rng(seed)
    rods, states, ends, free = [], [], [], []
    for start, material, clamps in zip(group.rods, group.each_material, group.clamps, strict=True):
        rods.append(rod_of(start, material, row))
        state, held = clamped_start(start, clamps, row)
        states.append(state)
        ends.append(held)
        free.append(free_variables(rods[-1], held))
    states = [moved(state, own, pushed * rng.normal(size=len(own))) for state, own in zip(states, free, strict=True)]
    for _ in range(STEPS):
        at = _system(group, rods, states, ends, free)
        step = np.linalg.lstsq(at["matrix"], at["right"], rcond=1e-13)[0]
        size = sum(len(own) for own in free)
        parts = np.split(step[:size], np.cumsum([len(own) for own in free])[:-1])
        states = [moved(state, own, part) for state, own, part in zip(states, free, parts, strict=True)]
        if np.abs(step[:size]).max() < 1e-12:
            break
    at = _system(group, rods, states, ends, free)
    _, singular, right = np.linalg.svd(at["border"])
    basis = right[int((singular > 1e-9 * singular[0]).sum()):].T
    eigenvalues = np.linalg.eigvalsh(basis.T @ at["hessian"] @ basis)
    multiplier, tied = at["multiplier"].reshape(-1, 3), len(group.ties)
    end_force = np.zeros((len(rods), 3))
    held = [number for number, end in enumerate(ends) if end.end_position is not None]
    end_force[held] = -multiplier[tied:]
    return Reference([vertices_of(rod, state) for rod, state in zip(rods, states, strict=True)], -multiplier[:tied], end_force,
                     float(eigenvalues[0] / eigenvalues[-1]), at["residual"])


def _system(group: Group, rods, states, ends, free) -> dict:
    """The Newton system at some states, and the multipliers that fit its gradient best."""
    places = [vertices_of(rod, state) for rod, state in zip(rods, states, strict=True)]
    jacobians = [vertex_jacobian(rod, state.quaternions) for rod, state in zip(rods, states, strict=True)]
    sizes = [len(own) for own in free]
    first = np.cumsum([0, *sizes])
    rows, miss = [], []

    def add(entries, value):
        row = np.zeros((3, first[-1]))
        for sign, rod, vertex in entries:
            row[:, first[rod] : first[rod + 1]] += sign * jacobians[rod][vertex][:, free[rod]]
        rows.append(row)
        miss.append(value)

    ties = [[(sign, rod, vertex % len(places[rod])) for sign, (rod, vertex) in ((1.0, tie.first), (-1.0, tie.second))]
            for tie in group.ties]
    for (_, a, v), (_, b, w) in ties:
        add([(1.0, a, v), (-1.0, b, w)], places[a][v] - places[b][w])
    for rod, end in enumerate(ends):
        if end.end is not Clamp.FREE:
            add([(1.0, rod, -1)], places[rod][-1] - end.end_position)
    border = np.concatenate(rows) if rows else np.zeros((0, first[-1]))
    miss = np.concatenate(miss) if miss else np.zeros(0)
    up = np.array([0.0, 0.0, 1.0])
    burden = [np.zeros_like(place) for place in places]
    for tie, ((_, a, v), _) in zip(group.ties, ties, strict=True):
        burden[a][v] += tie.weight * up
    plain = [_derivatives(rod, state, pull) for rod, state, pull in zip(rods, states, burden, strict=True)]
    gradient = np.concatenate([part[0][own] for part, own in zip(plain, free, strict=True)])
    multiplier = -np.linalg.lstsq(border.T, gradient, rcond=1e-12)[0]
    # The multipliers pull at vertices, and thereby bend the paths of these.
    for number, entries in enumerate(ties):
        for sign, rod, vertex in entries:
            burden[rod][vertex] += sign * multiplier[3 * number : 3 * number + 3]
    number = len(ties)
    for rod, end in enumerate(ends):
        if end.end is not Clamp.FREE:
            burden[rod][-1] += multiplier[3 * number : 3 * number + 3]
            number += 1
    hessian = block_diag(*(_derivatives(rod, state, pull)[1][np.ix_(own, own)]
                           for rod, state, pull, own in zip(rods, states, burden, free, strict=True)))
    matrix = np.block([[hessian, border.T], [border, np.zeros((len(border),) * 2)]])
    residual = gradient + border.T @ multiplier
    return {"matrix": matrix, "right": -np.concatenate([residual, miss]), "border": border, "hessian": hessian,
            "multiplier": multiplier, "residual": float(np.abs(residual).max())}


def _derivatives(rod, state: State, pull: np.ndarray):
    """Gradient and Hessian of a rod whose vertices bear a constant gradient ``pull`` (V, 3)."""
    count = rod.edges + 1
    springs = Springs(np.eye(count), np.zeros((count, 3, 3)), np.zeros((count, 3)))
    object.__setattr__(springs, "vertex_gradient", lambda vertices: pull)
    return total_derivatives(rod, springs, state)
