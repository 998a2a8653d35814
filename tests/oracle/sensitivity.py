"""dΓ*/dΘ of one rod by dense linear algebra: the bordered system of the implicit function theorem, written out.

Unknowns are (dx_0, dω_0, …, dω_{E−1}) as in :mod:`tests.oracle.equilibrium`. The gradient is linear in B, β and the gravity
vector and affine in ω̄, so its derivative by a parameter is the gradient of a rod that has one of that parameter and nothing
else; for ω̄ it is a difference, exact as well.
"""

from dataclasses import replace

import numpy as np

from tests.oracle.chain_form import Rod, linear_derivatives
from tests.oracle.equilibrium import State
from tests.oracle.external import Springs, total_derivatives, vertex_jacobian

ENTRIES = {"bend": [[1, 0], [0, 1]], "bend_1": [[1, 0], [0, 0]], "bend_2": [[0, 0], [0, 1]], "bend_12": [[0, 1], [1, 0]]}


def _derivatives(rod: Rod, quaternions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gradient and Hessian of a rod without springs, which do not depend on where it begins."""
    return total_derivatives(rod, Springs.none(rod), State(np.zeros(3), quaternions))


def changed_gradient(rod: Rod, quaternions: np.ndarray, name: str) -> np.ndarray:
    """(3 + 3E, columns) ∂g/∂θ for the parameters of the package's names but ``up``, gravity on x_0 included."""
    alone = {entry: [{"bend": np.broadcast_to(np.array(matrix, float), rod.bend.shape)}] for entry, matrix in ENTRIES.items()}
    alone |= {"twist": [{"twist": np.ones_like(rod.twist)}], "weight": [{"weight": 1.0}],
              "gravity": [{"weight": 1.0, "up": axis} for axis in np.eye(3)]}
    if name in alone:
        nothing = replace(rod, bend=0 * rod.bend, twist=0 * rod.twist, weight=0.0)
        return np.stack([_derivatives(replace(nothing, **one), quaternions)[0] for one in alone[name]], axis=1)
    joints = [np.arange(rod.edges - 1)] if name == "rest_curvature" else np.arange(rod.edges - 1)[:, None]
    columns, before = [], _derivatives(rod, quaternions)[0]
    for where in joints:
        for component in range(2):
            more = rod.rest_curvature.copy()
            more[where, component] += 1.0
            columns.append(_derivatives(replace(rod, rest_curvature=more), quaternions)[0] - before)
    return np.stack(columns, axis=1)


def dense_sensitivity(rod: Rod, quaternions: np.ndarray, free: np.ndarray, closed: bool, names) -> tuple:
    """(V, 3, P) dx and (E, 3, P) dω of a rod at rest, of which the variables ``free`` may move and, where ``closed``, the
    far end may not."""
    gradient, hessian = _derivatives(rod, quaternions)
    jacobian = vertex_jacobian(rod, quaternions)
    border = jacobian[-1][:, free] if closed else np.zeros((0, len(free)))
    force = -np.linalg.lstsq(border.T, gradient[free], rcond=None)[0] if closed else np.zeros(3)
    hessian[3:, 3:] += linear_derivatives(rod, quaternions, force)[1]
    bordered = np.block([[hessian[np.ix_(free, free)], border.T], [border, np.zeros((len(border), len(border)))]])
    change = np.concatenate([changed_gradient(rod, quaternions, name) for name in names], axis=1)
    right = np.concatenate([-change[free], np.zeros((len(border), change.shape[1]))])
    moved = np.zeros((len(gradient), change.shape[1]))
    moved[free] = np.linalg.lstsq(bordered, right, rcond=1e-12)[0][: len(free)]
    return jacobian @ moved, moved[3:].reshape(rod.edges, 3, -1)
