"""Quasi-static motion: the clamps are carried in sub-steps and every rod follows its branch of equilibria (§III-D)."""

from collections.abc import Iterator

import numpy as np

from doo_ti.frames import matrix_from_quaternion, quaternion_about, quaternion_from_matrix, quaternion_product
from doo_ti.newton import Newton
from doo_ti.relaxation import relax
from doo_ti.types import Clamps, Configuration, Material, Solution

LARGEST_TURN = np.radians(5.0)


def carried_clamps(clamps: Clamps, end_position: np.ndarray, turn: np.ndarray, steps: int) -> Iterator[Clamps]:
    """The far clamp on its way: positions on a line, frames about one axis.

    end_position  (R, 3) mm where it goes
    turn          (R, 3) rotation vector in the world, rad, whole turns included, that the end frame makes on the way
    """
    angle = np.linalg.norm(turn, axis=-1)
    axis = turn / np.maximum(angle, 1e-300)[:, None]
    first = quaternion_from_matrix(clamps.end_frame)
    for k in range(1, steps + 1):
        share = k / steps
        position = clamps.end_position + share * (end_position - clamps.end_position)
        frame = matrix_from_quaternion(quaternion_product(quaternion_about(axis, share * angle), first))
        yield Clamps(clamps.start, clamps.end, clamps.start_position, position, clamps.start_frame, frame)


def carry(configuration: Configuration, material: Material, path: Iterator[Clamps], **options) -> tuple[Solution, Clamps]:
    """Relax along the path, each sub-step from the one before; returns the last solution and its clamps.

    ``options`` go to :func:`doo_ti.relaxation.relax`; the solver is the careful one, which keeps to the branch.
    """
    solution = clamps = None
    for clamps in path:
        solution = relax(configuration, material, clamps, Newton.careful(), **options)
        configuration = solution.configuration
    return solution, clamps
