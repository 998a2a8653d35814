"""Where obstacles that move are during a motion, as the kernels read it (docs/contact.md).

Axes: R rods, T instants, M obstacles.
"""

import numpy as np

from doo_ti.contact.meshes import CORNERS
from doo_ti.contact.moving import Moving, about, since_first
from doo_ti.contact.obstacles import BOX, GRID, PLANE, Obstacle
from doo_ti.contact.surroundings import SHALLOW, Surroundings
from doo_ti.dynamics.grippers import cubic, turning
from doo_ti.dynamics.parameters import Stepping
from doo_ti.relaxation.time_loading import POSE_COLUMNS, POSE_SHIFT
from doo_ti.rod.frames import quaternion_from_matrix
from doo_ti.rod.types import Configuration
from doo_ti.system.errors import InputError


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
            _check_speed(body.obstacle, _largest_move(body.obstacle, rotation, shift, start), surroundings, stepping)
            turned, moved = since_first(rotation, shift)
            poses[:, :, number, :POSE_SHIFT], poses[:, :, number, POSE_SHIFT:] = quaternion_from_matrix(turned), moved
    return poses


def _refined(body: Moving, parts: int) -> tuple[np.ndarray, np.ndarray]:
    """(1 or R, T, 3, 3) rotation and (1 or R, T, 3) shift of places at ``parts`` instants for each."""
    if parts == 1:
        return body.path
    share = np.arange(parts) / parts
    rotation = turning(body.rotation, share)
    return rotation, about(body.pivot[:, None], rotation, cubic(body.shift, share))


def needed_substeps(surroundings: Surroundings, least_way: float, start: Configuration) -> int:
    """How many time steps the moving obstacles need from one instant to the next, where a time step may be divided into parts
    of ``least_way``."""
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


def _check_speed(obstacle: Obstacle, move: float, surroundings: Surroundings, stepping: Stepping) -> None:
    """Raise InputError where an obstacle moves too far in one step."""
    most = _most_move(surroundings, stepping.least_way)
    if move > most:
        raise InputError("simulate", "obstacles", f"a {type(obstacle).__name__} moves by {move:.3g} mm in a time step; "
                         f"rods of radius {np.min(surroundings.radius):g} mm allow {most:.3g} mm",
                         f"give {int(np.ceil(stepping.substeps * move / most))} `substeps`")


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
