"""A video of a known rod: its start is held, its far end is led along a way, and three cameras look on."""

from functools import cache

import numpy as np

from doo_ti import Clamp, Clamps, Configuration, Material, Motion, Newton, relax
from doo_ti.rod.frames import across, bishop_frames, quaternion_from_matrix
from doo_ti.vision.render import render_set
from doo_ti.vision.tubes import smooth_curve
from tests.vision.scenes import curves, three_cameras

EDGES, LENGTH, FRAMES = 20, 3.0, 16
MATERIAL = Material(2e5, 2e5)
REST_LENGTH = np.full(EDGES, LENGTH)
DIAMETER = 1.0


@cache
def _begin() -> Configuration:
    """Near the first frame's rod."""
    rod = curves(np.random.default_rng(8), 1, EDGES, turn=0.09)
    tangents = np.diff(rod, axis=1) / LENGTH
    return Configuration(rod[:, 0], quaternion_from_matrix(bishop_frames(tangents, across(tangents[:, 0]))), REST_LENGTH)


@cache
def far_motion() -> Motion:
    """From the first frame to the last: the far end is led 40 mm and turned by 68°."""
    rod = _begin()
    frames, first, last = rod.frames, rod.vertices[:, 0], rod.vertices[:, -1]
    along = (last - first) / np.linalg.norm(last - first)
    return Motion(Clamps(Clamp.TANGENT, Clamp.TANGENT, first, last, frames[:, 0], frames[:, -1]),
                  end_shift=-30 * along + 26 * across(along), end_turn=np.array([[0.4, -0.6, 0.95]]))


@cache
def rods() -> np.ndarray:
    """(T, V, 3) mm: at rest without any image, each from the one before."""
    rod, shapes = _begin(), []
    for frame in range(FRAMES):
        solution = relax(rod, MATERIAL, far_motion().at(frame / (FRAMES - 1)), Newton.careful())
        assert solution.converged.all()
        rod = solution.configuration
        shapes.append(rod.vertices[0])
    return np.array(shapes)


def photographed(vertices: np.ndarray, first: int = 0) -> list[list[np.ndarray]]:
    """T lists of C images of rods (T, V, 3), the first of which is that of frame ``first``."""
    return [render_set(three_cameras(), smooth_curve(rod, 8), DIAMETER, seed=(4, frame))
            for frame, rod in enumerate(vertices, first)]


@cache
def image(frame: int) -> list[np.ndarray]:
    """C images."""
    return photographed(rods()[frame : frame + 1], frame)[0]


def images() -> list[list[np.ndarray]]:
    """T lists of C images."""
    return [image(frame) for frame in range(FRAMES)]
