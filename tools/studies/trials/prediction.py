"""Errors of predicted motions (§III-D), compared with baselines without a rod model.

Axes: N observations, P pairs of them, T moments, V vertices.
"""

from dataclasses import dataclass

import numpy as np

from doo_ti.io.motion_file import ClampPath
from doo_ti.motion.path import LARGEST_TURN
from doo_ti.prediction.predict import Prediction, predict
from doo_ti.relaxation.relax import relax
from doo_ti.rod.metric import distance
from doo_ti.rod.observations import Observations
from doo_ti.rod.start import observation_clamps, start_configuration
from doo_ti.rod.types import Material

SAME_BRANCH = 1.0
"""mm: largest distance of vertices between two shapes on one branch."""


@dataclass(frozen=True)
class ObservedSteps:
    """P predictions from one observation to another.

    from_index, to_index  (P,) rows of the observations
    error        (P,) mm, Eq. 1 to the observation, NaN where the rod could not follow
    start_error  (P,) mm, error of the model before the motion
    own_error    (P,) mm, error of the model relaxed from the observation itself, which no prediction can avoid
    jumps        (P,) predicted jumps
    same_branch  (P,) bool: the prediction is the minimum next to the observation; else one of the two jumped and the other not
    """

    from_index: np.ndarray
    to_index: np.ndarray
    error: np.ndarray
    start_error: np.ndarray
    own_error: np.ndarray
    jumps: np.ndarray
    same_branch: np.ndarray


def rotation_steps(observations: Observations) -> tuple[np.ndarray, np.ndarray]:
    """(P,) rows and (P,) rows of the observations with the same end distance and the next larger end rotation."""
    order = np.lexsort((observations.end_rotation, observations.end_distance))
    along = np.diff(observations.end_distance[order]) == 0
    return order[:-1][along], order[1:][along]


def predict_steps(observations: Observations, from_index: np.ndarray, to_index: np.ndarray, material: Material, *,
                  sub_step: float = LARGEST_TURN) -> ObservedSteps:
    """From each observation to another, the far end rotated by the difference of their labels ``end_rotation``."""
    before, after = observations.take(from_index), observations.take(to_index)
    held, goal = observation_clamps(before), observation_clamps(after)
    turn = np.radians(after.end_rotation - before.end_rotation)
    poses = {name: np.stack([getattr(held, name), getattr(goal, name)])
             for name in ("start_position", "end_position", "start_frame", "end_frame")}
    path = ClampPath(np.array([0.0, 1.0]), end_rotation=np.stack([0 * turn, turn]), source=observations.source, **poses)
    carried = predict(start_configuration(before, held), material, held, path, sub_step=sub_step, up=observations.up)
    own = relax(start_configuration(after, goal), material, goal, up=observations.up)
    apart = np.linalg.norm(carried.vertices[-1] - own.configuration.vertices, axis=-1).max(axis=1)
    error = np.where(carried.followed[-1], distance(carried.at(-1), after), np.nan)
    return ObservedSteps(from_index, to_index, error, distance(carried.at(0), before), distance(own.configuration, after),
                         carried.jumps.sum(axis=0), apart <= SAME_BRANCH)


def predict_marks(observations: Observations, material: Material, path: ClampPath, *,
                  sub_step: float = LARGEST_TURN) -> Prediction:
    """Rods that start from their first marks and follow the grippers that hold their first and last edges."""
    clamps = observation_clamps(observations)
    return predict(start_configuration(observations, clamps), material, clamps, path, sub_step=sub_step, up=observations.up)


def moved_as_one(vertices: np.ndarray, start_shift: np.ndarray, end_shift: np.ndarray) -> np.ndarray:
    """(N, V, 3) mm: the first shape, moved by the mean displacement of its ends (N, 3)."""
    return vertices + 0.5 * (start_shift + end_shift)[:, None]


def moved_by_blend(vertices: np.ndarray, start_shift: np.ndarray, end_shift: np.ndarray, rest_length: np.ndarray) -> np.ndarray:
    """(N, V, 3) mm: each vertex moved by the displacements of the ends (N, 3), interpolated linearly along the rod (E,) mm."""
    share = np.concatenate([[0.0], np.cumsum(rest_length)]) / rest_length.sum()
    return vertices + (1 - share[:, None]) * start_shift[:, None] + share[:, None] * end_shift[:, None]
