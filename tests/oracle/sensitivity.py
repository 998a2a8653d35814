"""dΓ*/dΘ of one rod by dense linear algebra: the bordered system of the implicit function theorem, written out.

Unknowns are (dx_0, dω_0, …, dω_{E−1}) as in :mod:`tests.oracle.equilibrium`. The gradient is linear in B, β and the gravity
vector and affine in ω̄, so its derivative by a parameter is the gradient of a rod that has one of that parameter and nothing
else; for ω̄ it is a difference, exact as well.
"""

from dataclasses import replace

import numpy as np

from tests.oracle.algebra import cross, directors
from tests.oracle.chain_form import Rod, chain_derivatives, closure_gradient, linear_derivatives

ENTRIES = {"bend": [[1, 0], [0, 1]], "bend_1": [[1, 0], [0, 0]], "bend_2": [[0, 0], [0, 1]], "bend_12": [[0, 1], [1, 0]]}


def changed_gradient(rod: Rod, quaternions: np.ndarray, name: str) -> np.ndarray:
    """(3 + 3E, columns) ∂g/∂θ for the parameters of the package's names but ``up``, gravity on x_0 included."""
    nothing = replace(rod, bend=0 * rod.bend, twist=0 * rod.twist, weight=0.0)
    if name in ENTRIES:
        one = replace(nothing, bend=np.broadcast_to(np.array(ENTRIES[name], float), rod.bend.shape))
        return _gradient(one, quaternions)[:, None]
    if name == "twist":
        return _gradient(replace(nothing, twist=np.ones_like(rod.twist)), quaternions)[:, None]
    if name == "weight":
        return _gradient(replace(nothing, weight=1.0), quaternions)[:, None]
    if name == "gravity":
        return np.stack([_gradient(replace(nothing, weight=1.0, up=axis), quaternions) for axis in np.eye(3)], axis=1)
    joints = [np.arange(rod.edges - 1)] if name == "rest_curvature" else np.arange(rod.edges - 1)[:, None]
    columns, before = [], _gradient(rod, quaternions)
    for where in joints:
        for component in range(2):
            more = rod.rest_curvature.copy()
            more[where, component] += 1.0
            columns.append(_gradient(replace(rod, rest_curvature=more), quaternions) - before)
    return np.stack(columns, axis=1)


def dense_sensitivity(rod: Rod, quaternions: np.ndarray, free: np.ndarray, closed: bool, names) -> tuple:
    """(V, 3, P) dx and (E, 3, P) dω of a rod at rest, of which the variables ``free`` may move and, where ``closed``, the
    far end may not."""
    gradient, hessian = chain_derivatives(rod, quaternions)
    full = np.append(rod.weight * rod.vertex_length.sum() * rod.up, gradient)
    border = np.hstack([np.eye(3), closure_gradient(rod, quaternions)]) if closed else np.zeros((0, len(full)))
    force = -np.linalg.lstsq(border[:, free].T, full[free], rcond=None)[0] if closed else np.zeros(3)
    matrix = np.zeros((len(full), len(full)))
    matrix[3:, 3:] = hessian + linear_derivatives(rod, quaternions, force)[1]
    bordered = np.block([[matrix[np.ix_(free, free)], border[:, free].T],
                         [border[:, free], np.zeros((len(border), len(border)))]])
    change = np.concatenate([changed_gradient(rod, quaternions, name) for name in names], axis=1)
    right = np.concatenate([-change[free], np.zeros((len(border), change.shape[1]))])
    moved = np.zeros((len(full), change.shape[1]))
    moved[free] = np.linalg.lstsq(bordered, right, rcond=1e-12)[0][: len(free)]
    rotations = moved[3:].reshape(rod.edges, 3, -1)
    return _vertices(rod, quaternions, moved[:3], rotations), rotations


def _gradient(rod: Rod, quaternions: np.ndarray) -> np.ndarray:
    return np.append(rod.weight * rod.vertex_length.sum() * rod.up, chain_derivatives(rod, quaternions)[0])


def _vertices(rod: Rod, quaternions: np.ndarray, start: np.ndarray, rotations: np.ndarray) -> np.ndarray:
    """x_{i+1} = x_i + l_i t_i, varied: dt = dω × t with dω in the world."""
    frames = np.stack([np.array(axis) for axis in directors(quaternions.T)])  # (director, coordinate, edge)
    vertices = [start]
    for edge in range(rod.edges):
        world = np.einsum("dk,dp->kp", frames[:, :, edge], rotations[edge])
        turned = np.array(cross(list(world), list(np.broadcast_to(frames[0, :, edge, None], world.shape))))
        vertices.append(vertices[-1] + rod.rest_length[edge] * turned)
    return np.array(vertices)
