"""The minimum of a group, whose joints may differ in stiffness by many powers of ten, by dense linear algebra in the rotations
of joints instead of edges, with ties and held ends as constraints: what is stiff then does not hide what is soft."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from doo_ti import Clamp, Group
from tests.oracle.chain_form import rod_of
from tests.oracle.equilibrium import clamped_start, free_variables, moved, vertices_of
from tests.oracle.external import Springs, total_derivatives, vertex_jacobian

STEPS, LONGEST, ENOUGH = 60, 0.3, 1e-9  # of Newton's method, and rad: of a step at most, and at its end
BALANCINGS, NEUTRAL = 30, 1e-11
"""Of the scales of a system's rows; and the share of its largest singular value below which a motion costs nothing."""


@dataclass(frozen=True)
class Reference:
    """vertices (V, 3) of each rod; step, rad of the last; tie_force (K, 3) on the first vertex of each tie; end_force (G, 3),
    zero of free ends; least, the smallest eigenvalue of the projected Hessian over the largest."""

    vertices: list[np.ndarray]
    step: float
    tie_force: np.ndarray
    end_force: np.ndarray
    least: float


def nearest_equilibrium(group: Group, row: int = 0) -> Reference:
    """The equilibrium near the shapes of ``group``, whose welds hold."""
    rods, states, ends = [], [], []
    for start, material, clamps in zip(group.rods, group.each_material, group.clamps, strict=True):
        rods.append(rod_of(start, material, row))
        state, held = clamped_start(start, clamps, row)
        states.append(state)
        ends.append(held)
    weights = [np.zeros((rod.edges + 1, 3)) for rod in rods]
    for tie in group.ties:
        weights[tie.first[0]][tie.first[1]] += [0.0, 0.0, tie.weight]
    sizes = [3 + 3 * rod.edges for rod in rods]
    first = np.cumsum([0, *sizes])
    free = np.concatenate([offset + free_variables(rod, end) for offset, rod, end in zip(first, rods, ends, strict=False)])
    pulls = weights
    for _ in range(STEPS):
        places = [vertices_of(rod, state) for rod, state in zip(rods, states, strict=True)]
        rows, miss, at = _constraints(group, rods, states, places, ends, first)
        slopes, curvatures = ([total_derivatives(rod, Springs.none(rod, -pull), state)[order]
                               for rod, state, pull in zip(rods, states, under, strict=True)]
                              for order, under in enumerate((weights, pulls)))
        gradient, hessian = np.concatenate(slopes), block_diag(*curvatures)
        turn = block_diag(*(_from_joints(state.quaternions) for state in states))
        held = np.delete(np.eye(first[-1]), free, axis=0)
        border, wrong = np.concatenate([rows, held]) @ turn, np.concatenate([miss, np.zeros(len(held))])
        hessian = turn.T @ hessian @ turn
        step, multiplier = _solved(hessian, turn.T @ gradient, border, wrong)
        step = turn @ step
        parts = np.split(step, first[1:-1])
        size = max(np.abs(own[3:]).max() for own in parts)
        states = [moved(state, np.arange(len(own)), min(1.0, LONGEST / size) * own)
                  for state, own in zip(states, parts, strict=True)]
        pulls = [weight.copy() for weight in weights]
        for number, entries in enumerate(at):
            for sign, rod, vertex in entries:
                pulls[rod][vertex] += sign * multiplier[3 * number : 3 * number + 3]
        if size < ENOUGH:
            break
    _, singular, right = np.linalg.svd(border)
    basis = right[int((singular > 1e-9 * singular[0]).sum()):].T
    eigenvalues = np.linalg.eigvalsh(basis.T @ hessian @ basis)
    forces, end_force = -multiplier[: 3 * len(at)].reshape(-1, 3), np.zeros((len(rods), 3))
    end_force[[rod for rod, end in enumerate(ends) if end.end is not Clamp.FREE]] = forces[len(group.ties) :]
    return Reference([vertices_of(rod, state) for rod, state in zip(rods, states, strict=True)], float(size),
                     forces[: len(group.ties)], end_force, float(eigenvalues[0] / eigenvalues[-1]))


def _from_joints(quaternions: np.ndarray) -> np.ndarray:
    """(3 + 3 E)²: (displacement, rotations of edges in their own axes) from (the same, rotations of joints in the world's),
    each of which turns all edges behind it, the first all."""
    frames = Rotation.from_quat(quaternions, scalar_first=True).as_matrix()
    turn = np.eye(3 + 3 * len(frames))
    for edge, frame in enumerate(frames):
        turn[3 + 3 * edge : 6 + 3 * edge, 3 : 6 + 3 * edge] = np.tile(frame.T, edge + 1)
    return turn


def _constraints(group: Group, rods, states, places, ends, first):
    """Rows and misses of ties, of held places and, last, of welds; and of all but welds the vertices at which they pull."""
    at = [[(sign, rod, vertex % len(places[rod])) for sign, (rod, vertex) in ((1.0, tie.first), (-1.0, tie.second))]
          for tie in group.ties]
    miss = [places[a][v] - places[b][w] for (_, a, v), (_, b, w) in at]
    for rod, end in enumerate(ends):
        if end.end is not Clamp.FREE:
            at.append([(1.0, rod, len(places[rod]) - 1)])
            miss.append(places[rod][-1] - end.end_position)
    jacobians = [vertex_jacobian(rod, state.quaternions) for rod, state in zip(rods, states, strict=True)]
    rows = np.zeros((3 * (len(at) + len(group.welded)), first[-1]))
    for number, entries in enumerate(at):
        for sign, rod, vertex in entries:
            rows[3 * number : 3 * number + 3, first[rod] : first[rod + 1]] += sign * jacobians[rod][vertex]
    # Both edges of a weld turn alike in the world's axes, which keeps their rotation to each other exactly.
    for number, edges in enumerate(group.welded.values(), start=len(at)):
        for sign, edge in zip((1.0, -1.0), edges, strict=True):
            rod = int(np.searchsorted(group.first_vertices, edge, side="right")) - 1
            own = edge - group.first_vertices[rod]
            frame = Rotation.from_quat(states[rod].quaternions[own], scalar_first=True).as_matrix()
            column = first[rod] + 3 + 3 * own
            rows[3 * number : 3 * number + 3, column : column + 3] += sign * frame
    return rows, np.concatenate([*miss, np.zeros(3 * len(group.welded))]) if miss else np.zeros(len(rows)), at


def _solved(hessian, gradient, rows, miss):
    """The step and the multipliers of a bordered system, of which every row and column is scaled to the same size."""
    size = len(hessian)
    matrix, right = np.block([[hessian, rows.T], [rows, np.zeros((len(rows),) * 2)]]), -np.concatenate([gradient, miss])
    scale = np.ones(len(matrix))
    for _ in range(BALANCINGS):
        largest = np.abs(scale[:, None] * matrix * scale).max(axis=1)
        scale /= np.sqrt(np.where(largest > 0.0, largest, 1.0))
    found = scale * np.linalg.lstsq(scale[:, None] * matrix * scale, scale * right, rcond=NEUTRAL)[0]
    return found[:size], found[size:]
