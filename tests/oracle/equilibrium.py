"""One rod with its ends: its state, what may move, and its energy, one by one and dense."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from doo_ti import Clamp, Clamps, Configuration
from tests.oracle.algebra import body_rotated, directors, transport
from tests.oracle.chain_form import Rod, chain_energy


@dataclass(frozen=True)
class Ends:
    """Clamps of one rod: Clamp kinds, and the positions that are held (None where the end is free)."""

    start: Clamp
    end: Clamp
    start_position: np.ndarray | None
    end_position: np.ndarray | None


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
        frame = np.array(frames[index], dtype=np.float64)
        if kind == Clamp.TANGENT:
            old = directors(quaternions[edge])
            m1 = np.array(transport(old[0], frame[:, 0], old[1]))
            frame = np.stack([frame[:, 0], m1, np.cross(frame[:, 0], m1)], axis=-1)
        if kind in (Clamp.TANGENT, Clamp.FRAME):
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


def energy_of(rod: Rod, state: State) -> tuple[float, float]:
    """E(Γ), and the sum of its terms' sizes, the scale of its rounding."""
    parts = chain_energy(rod, state.start, state.quaternions)
    return sum(parts), sum(abs(part) for part in parts)
