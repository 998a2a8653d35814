"""A rod under E_Θ and springs that pull at its vertices, dense: energy, derivatives, one Newton step, what is left of forces.

    E = E_Θ + Σ_i ½ (x_i − target_i)·K_i (x_i − target_i)

K_i is a number k or a symmetric matrix (a camera sees two directions only).
Unknowns are (dx_0, w_0, …, w_{E−1}): the translation of the first vertex in mm and the body rotations of all frames in rad,
x_i = x_0 + Σ_{j<i} l_j t_j. What the clamps hold is left out of them, and a held far end adds Σ l_j t_j = d.
"""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
from scipy.linalg import null_space

from doo_ti import Clamps, Configuration, Material
from tests.oracle.chain_form import Rod, chain_derivatives, chain_energy, linear_derivatives, rod_of
from tests.oracle.equilibrium import Ends, State, clamped_start, free_variables, moved, vertices_of
from tests.oracle.pair import linear_gradient_hessian


@dataclass(frozen=True)
class Springs:
    """One on each of V vertices: ``stiffness`` (V, 3, 3) K_i, symmetric, weight/mm; ``target`` (V, 3), mm; a dead ``force``."""

    stiffness: np.ndarray
    target: np.ndarray
    force: np.ndarray | float = 0.0

    @classmethod
    def at_vertices(cls, stiffness, target) -> "Springs":
        """With a stiffness (V,) in all directions, or (V, 3, 3), zero where there is none."""
        return cls(stiffness[:, None, None] * np.eye(3) if stiffness.ndim == 1 else stiffness, target)

    @classmethod
    def none(cls, rod: Rod, force: np.ndarray | float = 0.0) -> "Springs":
        """None on any vertex, beside forces."""
        return cls(np.zeros((rod.edges + 1, 3, 3)), np.zeros((rod.edges + 1, 3)), force)


def total_energy(rod: Rod, springs: Springs, state: State):
    vertices = vertices_of(rod, state)
    off = vertices - springs.target
    pulled = 0.5 * np.einsum("ia,iab,ib", off, springs.stiffness, off) - (springs.force * vertices).sum()
    return sum(chain_energy(rod, state.start, state.quaternions)) + pulled


def vertex_jacobian(rod: Rod, quaternions: np.ndarray) -> np.ndarray:
    """(V, 3, 3 + 3E) derivative of the vertices in (dx_0, w_0, …): frame j moves all vertices behind it."""
    # Row k of Σ l t from the linear potential with force e_k.
    per_edge = linear_gradient_hessian(np.eye(3)[:, None], quaternions, rod.rest_length)[0].reshape(3, -1)
    jacobian = np.zeros((rod.edges + 1, 3, 3 + 3 * rod.edges))
    jacobian[:, :, :3] = np.eye(3)
    for i in range(1, rod.edges + 1):
        jacobian[i, :, 3 : 3 + 3 * i] = per_edge[:, : 3 * i]
    return jacobian


def total_derivatives(rod: Rod, springs: Springs, state: State) -> tuple[np.ndarray, np.ndarray]:
    """(3 + 3E,) gradient and (3 + 3E, 3 + 3E) Hessian of :func:`total_energy` in all of (dx_0, w_0, …, w_{E−1})."""
    vertices, jacobian = vertices_of(rod, state), vertex_jacobian(rod, state.quaternions)
    pull = np.einsum("iab,ib->ia", springs.stiffness, vertices - springs.target) - springs.force  # γ_i
    gradient = np.einsum("ia,iak->k", pull, jacobian)
    hessian = np.einsum("iak,iab,ibl->kl", jacobian, springs.stiffness, jacobian, optimize=True)
    # The rotation of an edge moves the rod beyond it along an arc: p_j = Σ_{i>j} γ_i, a linear potential on edge j.
    behind = np.cumsum(pull[::-1], axis=0)[::-1][1:]
    hessian[3:, 3:] += linear_derivatives(rod, state.quaternions, behind)[1]
    own_gradient, own_hessian = chain_derivatives(rod, state.quaternions)
    gradient[:3] += rod.weight * rod.vertex_length.sum() * rod.up
    gradient[3:] += own_gradient
    hessian[3:, 3:] += own_hessian
    return gradient, hessian


def _local(rod: Rod, springs: Springs, state: State, ends: Ends, free: np.ndarray) -> SimpleNamespace:
    """The quadratic model over the F free unknowns: residual g + Aλ (F,), Hessian with λ in it (F, F), closure's rows
    A (0 or 3, F) and miss c (0 or 3,), λ as force (3,), zero of a free end, and the ascending eigenvalues of the Hessian on
    what closure leaves free."""
    gradient, hessian = total_derivatives(rod, springs, state)
    rows, miss, force, basis = np.zeros((0, len(free))), np.zeros(0), np.zeros(3), np.eye(len(free))
    if ends.end_position is not None:
        rows = vertex_jacobian(rod, state.quaternions)[-1][:, free]
        miss = vertices_of(rod, state)[-1] - ends.end_position
        force = -np.linalg.lstsq(rows.T, gradient[free], rcond=1e-9)[0]
        hessian[3:, 3:] += linear_derivatives(rod, state.quaternions, force)[1]
        basis = null_space(rows, rcond=1e-9)
    hessian = hessian[np.ix_(free, free)]
    return SimpleNamespace(residual=gradient[free] + rows.T @ force[: len(miss)], hessian=hessian, rows=rows, miss=miss,
                           force=force, eigenvalues=np.linalg.eigvalsh(basis.T @ hessian @ basis))


def newton_step(rod: Rod, springs: Springs, state: State, ends: Ends, free: np.ndarray) -> State | None:
    """The state after the dense solution of H w = −g over the ``free`` unknowns (F,); with a held far end that of

        H w + A δλ = −(g + Aλ),   Aᵀ w = −c,   λ the least-squares multiplier, H with its linear potential.

    None where that does not go downhill, H not being positive definite on what closure leaves free. Raises LinAlgError where a
    motion costs nothing.
    """
    at = _local(rod, springs, state, ends, free)
    matrix = np.block([[at.hessian, at.rows.T], [at.rows, np.zeros((len(at.miss),) * 2)]])
    step = np.linalg.solve(matrix, -np.append(at.residual, at.miss))[: len(free)]
    return moved(state, free, step, rod.turned) if at.eigenvalues[0] > 0 else None


def where_found(rods: Configuration, material: Material, clamps: Clamps, row: int, up=(0.0, 0.0, 1.0),
                springs: Springs | None = None, force: np.ndarray | float = 0.0) -> SimpleNamespace:
    """Of a row of the package's tables as it is, under springs and dead forces (V, 3): energy with springs; residual, the
    largest moment left on a free degree of freedom over B's largest eigenvalue, 1/mm; closure relative to the length;
    force (3,) λ; eigenvalues of H on what closure leaves free, ascending."""
    rod, ends = rod_of(rods, material, row, up), clamped_start(rods, clamps, row)[1]
    springs = replace(Springs.none(rod) if springs is None else springs, force=force)
    state = State(rods.start[row], rods.quaternions[row].astype(np.float64))
    at = _local(rod, springs, state, ends, free_variables(rod, ends))
    return SimpleNamespace(
        energy=total_energy(rod, springs, state), force=at.force, eigenvalues=at.eigenvalues,
        residual=np.abs(at.residual).max() / np.linalg.eigvalsh(rod.bend).max(),
        closure=np.linalg.norm(at.miss) / rod.rest_length.sum())
