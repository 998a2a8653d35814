"""F for one rod by dense linear algebra, slow and careful: every iterate is feasible and lower than the one before.

Full matrices, null space of the closure from an SVD, every eigenvalue of the projected Hessian. Steps are capped, a
shift is added only where the inertia is wrong, and a saddle is left along its most negative mode.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from doo_ti.rod.types import Clamp, Clamps, Configuration
from tests.oracle.algebra import body_rotated, directors, transport
from tests.oracle.chain_form import Rod, chain_derivatives, closure_gradient, linear_derivatives, rod_of
from tests.oracle.pair import pair_parts


@dataclass(frozen=True)
class Ends:
    """Clamps of one rod: Clamp kinds, and the positions that are held (None where the end is free)."""

    start: Clamp
    end: Clamp
    start_position: np.ndarray | None
    end_position: np.ndarray | None


@dataclass(frozen=True)
class Equilibrium:
    """Where the descent ended.

    start (3,), quaternions (E, 4), vertices (V, 3); energy E(Γ); residual in 1/mm (largest moment on a free degree of
    freedom over B's largest eigenvalue); closure (relative to the length); force (3,) λ of the closure; eigenvalues of
    the projected Hessian, ascending; stable: the smallest is positive; saddles: how many were left on the way.
    """

    start: np.ndarray
    quaternions: np.ndarray
    vertices: np.ndarray
    energy: float
    residual: float
    closure: float
    force: np.ndarray
    eigenvalues: np.ndarray
    converged: bool
    iterations: int
    saddles: int

    @property
    def smallest_eigenvalue(self) -> float:
        return float(self.eigenvalues[0]) if len(self.eigenvalues) else np.inf

    @property
    def stable(self) -> bool:
        """A strict minimum: no neutral mode either, to rounding."""
        return len(self.eigenvalues) == 0 or self.eigenvalues[0] > 1e-11 * self.eigenvalues[-1]


@dataclass(frozen=True)
class State:
    start: np.ndarray
    quaternions: np.ndarray


def vertices_of(rod: Rod, state: State) -> np.ndarray:
    """(V, 3): x_{i+1} = x_i + l_i t_i."""
    steps = rod.rest_length[:, None] * np.array(directors(state.quaternions.T)[0]).T
    return np.vstack([state.start, state.start + np.cumsum(steps, axis=0)])


def clamped_start(configuration: Configuration, clamps: Clamps, index: int) -> tuple[State, Ends]:
    """Row ``index`` of both tables, with the clamped frames and the start position set as the clamps hold them."""
    kinds = [Clamp(int(np.broadcast_to(kind, configuration.count)[index])) for kind in (clamps.start, clamps.end)]
    quaternions = np.array(configuration.quaternions[index], dtype=np.float64)
    for edge, kind, frames in ((0, kinds[0], clamps.start_frame), (-1, kinds[1], clamps.end_frame)):
        if kind == Clamp.FREE or kind == Clamp.POSITION:
            continue
        frame = np.array(frames[index], dtype=np.float64)
        if kind == Clamp.TANGENT:
            old = directors(quaternions[edge])
            m1 = np.array(transport(old[0], frame[:, 0], old[1]))
            frame = np.stack([frame[:, 0], m1, np.cross(frame[:, 0], m1)], axis=-1)
        quaternions[edge] = Rotation.from_matrix(frame).as_quat(scalar_first=True)
    start = configuration.start if kinds[0] == Clamp.FREE else clamps.start_position
    held = [None if kind == Clamp.FREE else np.array(position[index], dtype=np.float64)
            for kind, position in zip(kinds, (clamps.start_position, clamps.end_position), strict=True)]
    return State(np.array(start[index], dtype=np.float64), quaternions), Ends(*kinds, *held)


def free_variables(rod: Rod, ends: Ends) -> np.ndarray:
    """Indices into (dx_0, w_0, …, w_{E−1}), length 3 + 3E, that may move."""
    free = np.ones(3 + 3 * rod.edges, dtype=bool)
    free[:3] = ends.start == Clamp.FREE
    for first, kind in ((3, ends.start), (3 * rod.edges, ends.end)):
        if kind == Clamp.TANGENT:
            free[first + 1 : first + 3] = False
        elif kind == Clamp.FRAME:
            free[first : first + 3] = False
    return np.flatnonzero(free)


def moved(state: State, free: np.ndarray, step: np.ndarray, turned=body_rotated) -> State:
    """The state after a step in its free variables, of which rotations are made by ``turned``."""
    full = np.zeros(3 + state.quaternions.size // 4 * 3)
    full[free] = step
    rotated = turned(list(state.quaternions.T), list(full[3:].reshape(-1, 3).T))
    return State(state.start + full[:3], np.array(rotated).T)


def _largest_rotation(free: np.ndarray, step: np.ndarray) -> float:
    """rad; a free start's translation is not limited. Never zero, so that it can divide."""
    return max(np.abs(step[free >= 3]).max(initial=0.0), 1e-300)


def _closure(rod: Rod, ends: Ends, state: State, free: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Miss of the end position (0 or 3,) and its Jacobian (0 or 3, free)."""
    if ends.end_position is None:
        return np.zeros(0), np.zeros((0, len(free)))
    jacobian = np.hstack([np.eye(3), closure_gradient(rod, state.quaternions)])[:, free]
    return vertices_of(rod, state)[-1] - ends.end_position, jacobian


def closed(rod: Rod, ends: Ends, state: State, free: np.ndarray) -> State:
    """The state brought onto the closure by minimum-norm rotations of at most 0.1 rad each."""
    for _ in range(60):
        miss, jacobian = _closure(rod, ends, state, free)
        if np.linalg.norm(miss) <= 2e-15 * rod.rest_length.sum():
            break
        step = -np.linalg.lstsq(jacobian, miss, rcond=1e-9)[0]
        state = moved(state, free, step * min(1.0, 0.1 / _largest_rotation(free, step)))
    return state


def _null_space(jacobian: np.ndarray) -> np.ndarray:
    """Orthonormal basis (free, k) of the motions that keep the closure; a dependent row is no constraint."""
    if not len(jacobian):
        return np.eye(jacobian.shape[1])
    _, singular, right = np.linalg.svd(jacobian)
    return right[int(np.sum(singular > 1e-9 * singular[0])) :].T


@dataclass(frozen=True)
class _Local:
    """The rod at one state: force λ, residual over the free variables, and the projected problem."""

    force: np.ndarray
    residual: np.ndarray
    miss: np.ndarray
    basis: np.ndarray
    slope: np.ndarray
    eigenvalues: np.ndarray
    modes: np.ndarray


def _local(rod: Rod, ends: Ends, state: State, free: np.ndarray) -> _Local:
    miss, jacobian = _closure(rod, ends, state, free)
    gravity = rod.weight * rod.vertex_length.sum() * rod.up
    chain_gradient, chain_hessian = chain_derivatives(rod, state.quaternions)
    gradient = np.append(gravity, chain_gradient)[free]
    force = -np.linalg.lstsq(jacobian.T, gradient, rcond=1e-9)[0] if len(miss) else np.zeros(3)
    hessian = np.zeros((3 + 3 * rod.edges,) * 2)
    hessian[3:, 3:] = chain_hessian + linear_derivatives(rod, state.quaternions, force)[1]
    basis = _null_space(jacobian)
    eigenvalues, modes = np.linalg.eigh(basis.T @ hessian[np.ix_(free, free)] @ basis)
    residual = gradient + (jacobian.T @ force if len(miss) else 0.0)
    return _Local(force, residual, miss, basis, basis.T @ gradient, eigenvalues, modes)


def energy_of(rod: Rod, state: State) -> tuple[float, float]:
    """E(Γ), all pairs at once, and the sum of its terms' sizes, the scale of its rounding."""
    q, lengths = state.quaternions, rod.rest_length
    terms = pair_parts(
        list(q[:-1].T), list(q[1:].T), lengths[:-1], lengths[1:], rod.bend[:-1], rod.bend[1:], rod.twist,
        rod.rest_curvature,
    )
    gravity = rod.weight * rod.vertex_length * (vertices_of(rod, state) @ rod.up)
    parts = [float(np.sum(part)) for part in (*terms, gravity)]
    return sum(parts), sum(abs(part) for part in parts)


def _descended(rod, ends, state, free, direction, longest) -> State | None:
    """The first of the halved steps along ``direction`` that is closed again and not higher; None if there is none."""
    energy, size = energy_of(rod, state)
    factor = min(1.0, longest / _largest_rotation(free, direction))
    for _ in range(30):
        trial = closed(rod, ends, moved(state, free, factor * direction), free)
        if energy_of(rod, trial)[0] <= energy + 1e-13 * size:
            return trial
        factor /= 2.0
    return None


def equilibrium(
    rod: Rod, state: State, ends: Ends, *, tolerance=1e-12, max_iterations=500, longest_step=0.1, leave_saddles=True
) -> Equilibrium:
    """Descend from ``state`` to an equilibrium, never uphill.

    tolerance        on the residual, 1/mm
    longest_step     rad, largest rotation component of one step
    leave_saddles    go on along the most negative mode where an equilibrium is a saddle; else stop there
    """
    free = free_variables(rod, ends)
    scale = np.linalg.eigvalsh(rod.bend).max()
    state = closed(rod, ends, state, free)
    saddles, converged = 0, False
    for iteration in range(max_iterations + 1):
        at = _local(rod, ends, state, free)
        rate = at.modes.T @ at.slope
        floor = 1e-11 * at.eigenvalues[-1]
        converged = bool(np.abs(at.residual).max() <= tolerance * scale)
        unstable = at.eigenvalues[0] < -floor
        if iteration == max_iterations or (converged and not (unstable and leave_saddles)):
            break
        if converged:
            saddles += 1
            direction = at.basis @ at.modes[:, 0]
            leap = 0.05 * direction / _largest_rotation(free, direction)
            trials = [_descended(rod, ends, state, free, sign * leap, 0.05) for sign in (1.0, -1.0)]
            lower = [trial for trial in trials if trial is not None]
            following = min(lower, key=lambda trial: energy_of(rod, trial)[0], default=None)
        else:
            shifted = at.eigenvalues + (2.0 * abs(at.eigenvalues[0]) if unstable else 0.0)
            # A neutral mode (spin of a rod that nothing holds) gets no step: there is nothing to gain along it.
            weight = np.where(shifted > floor, 1.0 / np.maximum(shifted, floor), 0.0)
            following = _descended(rod, ends, state, free, -at.basis @ (at.modes @ (weight * rate)), longest_step)
        if following is None:
            break
        state = following
    return Equilibrium(
        start=state.start, quaternions=state.quaternions, vertices=vertices_of(rod, state),
        energy=energy_of(rod, state)[0], residual=float(np.abs(at.residual).max() / scale),
        closure=float(np.linalg.norm(at.miss) / rod.rest_length.sum()), force=at.force, eigenvalues=at.eigenvalues,
        converged=converged, iterations=iteration, saddles=saddles,
    )


def relaxed(
    configuration, material, clamps, index=0, material_index=None, *, up=(0.0, 0.0, 1.0), **options
) -> Equilibrium:
    """:func:`equilibrium` of one row of the package's tables; no clamp kind or length is checked."""
    rod = rod_of(configuration, material, index, material_index, up)
    return equilibrium(rod, *clamped_start(configuration, clamps, index), **options)
