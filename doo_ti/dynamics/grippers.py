"""Grippers: what holds the ends of rods at every instant of a motion (§III-B, moving). And where they and obstacles are then,
as the kernels read it (docs/dynamics.md).

Axes: S starts, R rods, T instants, M obstacles.
"""

from copy import copy
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from doo_ti.contact.distance_grid import CORNERS
from doo_ti.contact.obstacles import BOX, GRID, PLANE, Obstacle
from doo_ti.contact.surroundings import SHALLOW, Moving, Surroundings, about, since_first
from doo_ti.dynamics.parameters import Stepping
from doo_ti.relaxation import time_loading
from doo_ti.relaxation.time_loading import PATH_ANCHOR, PATH_COLUMNS, PATH_ENDS, PATH_TARGET, POSE_COLUMNS, POSE_SHIFT
from doo_ti.rod.frames import matrix_from_quaternion, of_like_signs, quaternion_from_matrix, smallest_rotation, unit_vectors
from doo_ti.rod.start import require_frames
from doo_ti.rod.types import POSES, Clamp, Clamps, Configuration, Rows, require_kinds
from doo_ti.system.arguments import short_repr, typed
from doo_ti.system.errors import InputError, real_array, require_whole


@typed
@dataclass(frozen=True)
class Grippers:
    """The clamps of S rods at T instants, the first of which is where the motion starts.

    start, end                    Clamp, one for all rods or (S,) of them; they hold the same throughout
    start_position, end_position  (S, T, 3) mm; unused where the end is free
    start_frame, end_frame        (S, T, 3, 3) columns t, m1, m2; of a tangent clamp t only
    """

    __repr__ = short_repr

    start: Annotated[np.ndarray, "() | 1S"]
    end: Annotated[np.ndarray, "() | 1S"]
    start_position: Annotated[np.ndarray, "S T 3"]
    end_position: Annotated[np.ndarray, "S T 3"]
    start_frame: Annotated[np.ndarray, "S T 3 3"]
    end_frame: Annotated[np.ndarray, "S T 3 3"]

    def __post_init__(self) -> None:
        require_kinds("Grippers", self.start, self.end)
        if self.instants < 2:
            raise InputError("Grippers", "start_position", f"{self.instants} instants", "give two or more")
        for name in POSES:
            value = real_array("Grippers", name, getattr(self, name), "give real numbers").astype(np.float64)
            self._check(name, value)
            object.__setattr__(self, name, value)
        for name in ("start", "end"):
            object.__setattr__(self, name, copy(getattr(self, name)))

    def _check(self, name: str, value: np.ndarray) -> None:
        """Raise InputError where a position or frame that is held is not finite, or a frame no rotation."""
        kind = np.broadcast_to(np.asarray(getattr(self, name.split("_")[0])), (len(value),))
        if not np.isfinite(value[kind >= (Clamp.TANGENT if name.endswith("frame") else Clamp.POSITION)]).all():
            raise InputError("Grippers", name, "not finite", "give finite numbers where the end is held")
        if name.endswith("frame"):
            require_frames("Grippers", name, kind, value)

    @property
    def count(self) -> int:
        """S, the number of rods."""
        return len(self.start_position)

    @property
    def kinds(self) -> np.ndarray:
        """(2, S) Clamp of the starts and of the ends."""
        return np.stack([np.broadcast_to(np.asarray(kind), (self.count,)) for kind in (self.start, self.end)])

    @property
    def instants(self) -> int:
        """T, the number of instants."""
        return self.start_position.shape[1]

    @classmethod
    @typed
    def resting(cls, clamps: Clamps, instants: int) -> "Grippers":
        """Clamps that do not move, at two instants or more."""
        require_whole("Grippers.resting", "instants", instants, 2)
        poses = (np.asarray(getattr(clamps, name))[:, None] for name in POSES)
        return cls(clamps.start, clamps.end, *(np.repeat(pose, instants, axis=1) for pose in poses))

    def take(self, rows: Rows) -> "Grippers":
        """The grippers of the rods named by ``rows``."""
        held = [kind if np.ndim(kind) == 0 else np.asarray(kind)[rows] for kind in (self.start, self.end)]
        return Grippers(*held, *(getattr(self, name)[rows] for name in POSES))

    @typed
    def at(self, instant: int) -> Clamps:
        """The clamps at one instant."""
        return Clamps(self.start, self.end, *(np.ascontiguousarray(getattr(self, name)[:, instant]) for name in POSES))

    @typed
    def until(self, instant: int) -> "Grippers":
        """The motion up to ``instant``, which is the last."""
        return Grippers(self.start, self.end, *(getattr(self, name)[:, : instant + 1] for name in POSES))

    @typed
    def refined(self, parts: int) -> "Grippers":
        """With ``parts`` equal steps between neighbouring instants: positions and frames on cubics through their neighbours."""
        if parts == 1:
            return self
        return Grippers(self.start, self.end, cubic(self.start_position, parts), cubic(self.end_position, parts),
                        turning(self.start_frame, parts), turning(self.end_frame, parts))


def cubic(points: np.ndarray, parts: int) -> np.ndarray:
    """(S, (T − 1) parts + 1, n) Catmull–Rom cubics through (S, T, n) points."""
    outer = np.concatenate([2 * points[:, :1] - points[:, 1:2], points, 2 * points[:, -1:] - points[:, -2:-1]], axis=1)
    before, here, there, after = (outer[:, k : k + points.shape[1] - 1, None] for k in range(4))
    u = np.arange(parts)[:, None] / parts
    curve = here + 0.5 * u * (there - before + u * (2 * before - 5 * here + 4 * there - after
                                                    + u * (3 * (here - there) + after - before)))
    return np.concatenate([curve.reshape(len(points), -1, points.shape[2]), points[:, -1:]], axis=1)


def turning(frames: np.ndarray, parts: int) -> np.ndarray:
    """(S, (T − 1) parts + 1, 3, 3) frames between (S, T, 3, 3): cubics through their quaternions, the shorter way from each to
    the next, normalised. A speed of turning that jumps would be a blow to the rod at every instant, however small the steps."""
    return matrix_from_quaternion(unit_vectors(cubic(of_like_signs(quaternion_from_matrix(frames)), parts)))


def clamp_path(grippers: Grippers, start: Configuration, steps: slice) -> np.ndarray:
    """(S, steps, PATH_COLUMNS) where the clamps are at the end of these steps."""
    after = slice(steps.start + 1, steps.stop + 1)
    kinds = grippers.kinds
    path = np.zeros((start.count, steps.stop - steps.start, PATH_COLUMNS))
    # A free vertex 0 is measured from where it starts.
    first = np.asarray(start.start, dtype=np.float64)[:, None]
    path[..., PATH_ANCHOR : PATH_ANCHOR + 3] = np.where((kinds[0] == Clamp.FREE)[:, None, None], first,
                                                        grippers.start_position[:, after])
    path[..., PATH_TARGET : PATH_TARGET + 3] = np.where(
        (kinds[1] != Clamp.FREE)[:, None, None],
        grippers.end_position[:, after] - path[..., PATH_ANCHOR : PATH_ANCHOR + 3], 0.0)
    path[..., PATH_ENDS] = path[..., PATH_ENDS + 4] = 1.0
    for column, kind, frames in ((PATH_ENDS, kinds[0], grippers.start_frame), (PATH_ENDS + 4, kinds[1], grippers.end_frame)):
        if (kind >= Clamp.TANGENT).any():
            path[..., column : column + 4] = _frames(frames[:, after], kind)
    path[..., time_loading.PATH_STILL] = _still(grippers, steps)
    return path


def _still(grippers: Grippers, steps: slice) -> np.ndarray:
    """(S, steps) whether what the grippers hold is where it was at the step's beginning."""
    still = np.ones((grippers.count, steps.stop - steps.start), dtype=bool)
    for kind, position, frame in zip(grippers.kinds, (grippers.start_position, grippers.end_position),
                                     (grippers.start_frame, grippers.end_frame), strict=True):
        for least, poses in ((Clamp.POSITION, position), (Clamp.TANGENT, frame.reshape(*frame.shape[:2], 9))):
            moves = (poses[:, steps.start : steps.stop] != poses[:, steps.start + 1 : steps.stop + 1]).any(axis=-1)
            still &= ~moves | (kind < least)[:, None]
    return still


def refined_within_reach(grippers: Grippers, parts: int, rest_length: np.ndarray) -> Grippers:
    """:meth:`.Grippers.refined` for rods of ``rest_length`` (E,) or (S, E) mm. Where a rod reaches from one gripper to the
    other at two neighbouring instants it does so between them: the far gripper does not go as far as a cubic would that is bent
    by a gripper which stops where the rod is taut."""
    if grippers.count == 1 and rest_length.ndim == 2:
        grippers = grippers.take(np.zeros(len(rest_length), dtype=np.int64))
    fine = grippers.refined(parts)
    held = grippers.kinds
    closed = (held[0] != Clamp.FREE) & (held[1] != Clamp.FREE)
    if parts == 1 or not closed.any():
        return fine
    line = fine.end_position - fine.start_position
    reach = np.broadcast_to(rest_length.sum(axis=-1), (fine.count,))[:, None]
    for kind, frames, edge in ((held[0], fine.start_frame, 0), (held[1], fine.end_frame, -1)):
        length = np.where(kind >= Clamp.TANGENT, rest_length[..., edge], 0.0)[:, None]
        line = line - np.where(length[..., None] > 0, length[..., None] * frames[..., 0], 0.0)
        reach = reach - length
    excess = 1.0 - reach / np.maximum(np.linalg.norm(line, axis=-1), reach)
    beyond = excess[:, ::parts] > 0
    between = np.repeat(beyond[:, :-1] | beyond[:, 1:], parts, axis=1)
    excess[:, :-1][between | ~closed[:, None]] = 0.0
    excess[:, ::parts] = 0.0
    return replace(fine, end_position=np.where(excess[..., None] > 0, fine.end_position - excess[..., None] * line,
                                               fine.end_position))


def _frames(frames: np.ndarray, kinds: np.ndarray) -> np.ndarray:
    """(S, T, 4) quaternions of (S, T, 3, 3) frames; of tangent clamps of any frame with that tangent."""
    tangent, found = kinds == Clamp.TANGENT, np.empty((*frames.shape[:2], 4))
    found[~tangent] = quaternion_from_matrix(frames[~tangent])
    found[tangent] = smallest_rotation(np.array([1.0, 0.0, 0.0]), unit_vectors(frames[tangent][..., 0]))
    return found


def obstacle_path(surroundings: Surroundings, stepping: Stepping, instants: int, start: Configuration) -> np.ndarray:
    """(1 or R, T, M, POSE_COLUMNS) how the obstacles turn and shift from where they are at the first of the T instants of all
    steps, on cubics between those of the motion.

    Raises InputError where an obstacle has not ``instants`` instants, or moves in one step by more than the rods allow.
    """
    bodies = surroundings.bodies
    rows = max([1] + [body.count for body in bodies if isinstance(body, Moving)])
    poses = np.zeros((rows, (instants - 1) * stepping.substeps + 1, len(bodies), POSE_COLUMNS))
    poses[..., 0] = 1.0
    for number, body in enumerate(bodies):
        if isinstance(body, Moving):
            if body.instants != instants:
                name = type(body.obstacle).__name__
                raise InputError("simulate", "obstacles", f"a {name} moves at {body.instants} instants, the grippers at "
                                 f"{instants}", "give the same instants")
            rotation, shift = _refined(body, stepping.substeps)
            move, most = _largest_move(body.obstacle, rotation, shift, start), _most_move(surroundings, stepping.least_way)
            if move > most:
                raise InputError("simulate", "obstacles", f"a {type(body.obstacle).__name__} moves by {move:.3g} mm in a time "
                                 f"step; rods of radius {np.min(surroundings.radius):g} mm allow {most:.3g} mm",
                                 f"give {int(np.ceil(stepping.substeps * move / most))} `substeps`")
            turned, moved = since_first(rotation, shift)
            poses[:, :, number, :POSE_SHIFT], poses[:, :, number, POSE_SHIFT:] = quaternion_from_matrix(turned), moved
    return poses


def _refined(body: Moving, parts: int) -> tuple[np.ndarray, np.ndarray]:
    """(1 or R, T, 3, 3) rotation and (1 or R, T, 3) shift of places at ``parts`` instants for each."""
    if parts == 1:
        return body.path
    rotation = turning(body.rotation, parts)
    return rotation, about(body.pivot[:, None], rotation, cubic(body.shift, parts))


def needed_substeps(surroundings: Surroundings, least_way: float, start: Configuration) -> int:
    """How many time steps moving obstacles need between instants, where a step may be divided into parts of ``least_way``."""
    moves = [_largest_move(body.obstacle, *body.path, start) for body in surroundings.bodies if isinstance(body, Moving)]
    return max([1] + [int(np.ceil(move / _most_move(surroundings, least_way))) for move in moves])


def _most_move(surroundings: Surroundings, least_way: float) -> float:
    """mm by which an obstacle may move in a time step: no rod that it touches is deep inside then."""
    return SHALLOW * float(np.min(surroundings.radius)) / least_way


def _largest_move(obstacle: Obstacle, rotation: np.ndarray, shift: np.ndarray, start: Configuration) -> float:
    """mm by which the surface of an obstacle moves at most from one instant to the next, along its outward normal."""
    if obstacle.kind == PLANE:
        # What counts is how far the plane moves where the rods are.
        own, axes, _, _ = obstacle.placed
        normal = (rotation @ axes[:, None, :, 2, None])[..., 0]
        point = (rotation @ own[:, None, :, None])[..., 0] + shift
        # A plane of each rod counts where that rod is.
        level = (normal * point).sum(axis=-1)
        places = start.vertices if len(level) == start.count else start.vertices.reshape(1, -1, 3)
        height = normal @ np.swapaxes(places, -1, -2) - level[..., None]
        moved = np.abs(np.diff(height, axis=1))
    else:
        places = (rotation[:, :, None] @ _outline(obstacle)[:, None, :, :, None])[..., 0] + shift[:, :, None]
        moved = np.linalg.norm(np.diff(places, axis=1), axis=-1)
    return float(moved.max())


def _outline(obstacle: Obstacle) -> np.ndarray:
    """(rows, P, 3) mm: no place of an obstacle's surface moves farther, out of the surface, than one of these places."""
    point, axes, sizes, _ = obstacle.placed
    if obstacle.kind == GRID:
        local = (np.array(obstacle.values.shape) - 1.0) * sizes[:, :1, None] * (0.5 * CORNERS + 0.5)
    elif obstacle.kind == BOX:
        local = sizes[:, None] * CORNERS
    else:  # bodies of revolution: what turns about their own axis stays where it is
        reach = np.where(sizes[:, 1:2] > 0, np.maximum(sizes[:, 1:2], sizes[:, :1]), 0.0)[..., None]
        local = reach * np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]])
    return point[:, None] + local @ np.swapaxes(axes, -1, -2)
