"""A moving rod as cameras of the virtual lab see it (§V-A, §VI): rendered, detected, and tracked, moment by moment.

    cameras = VirtualCameras(rig, rest_length, material)
    servo = Servo(rods, material, clamps, targets)
    while …:
        moment = cameras.see(simulation.state.configuration.vertices[0], servo.clamps)
        simulation.step(servo.step(moment.seen[None]))

The grippers' poses are known, as a robot knows them: the rod is sought from the near one on. Nothing else of the rod is.

Axes: C cameras, V vertices.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from doo_ti.motion.path import motion_between
from doo_ti.perception.tracking import TrackedFrame, Tracker, seen_vertices
from doo_ti.rod.types import Clamps, Material
from doo_ti.vision.cameras.rig import Rig
from doo_ti.vision.detection.detect import detect
from doo_ti.vision.detection.options import DetectionOptions
from doo_ti.vision.rendering.render import RenderOptions, render_set

DIAMETER_MM = 2.0
"""Of the thread, unless given."""
TRACKED_NOISE = 0.003
"""Of the rod's length, standard deviation of a coordinate that a servo should assume. Rods are tracked to a fifth of that by
three cameras and to a half by two, root mean square, but their errors are common to neighbouring vertices and to moments."""


@dataclass(frozen=True)
class SeenMoment:
    """What the cameras saw at one moment.

    rod      (n, 3) mm, the true one
    images   C images (H, W) uint8
    covered  names of the cameras that saw nothing
    frame    the rod that was tracked
    seen     (V, 3) mm, its vertices that images show, NaN at the others
    """

    rod: np.ndarray
    images: list[np.ndarray]
    covered: tuple[str, ...]
    frame: TrackedFrame
    seen: np.ndarray


class VirtualCameras:
    """Cameras that look at one rod.

    rig          the cameras
    rest_length  (E,) mm, of the edges of the rod that is sought; the one that is drawn may be finer
    material     with which it is sought, one row
    up           direction against gravity
    diameter_mm  of the thread
    look         of the images
    covered      by names of cameras, the share of moments at which something hides everything from them
    seed         of everything random
    """

    def __init__(self, rig: Rig, rest_length: np.ndarray, material: Material, *, up=(0.0, 0.0, 1.0),
                 diameter_mm: float = DIAMETER_MM, look: RenderOptions = RenderOptions(), covered: Mapping[str, float] = {},
                 seed: int = 0):
        self._rig, self._diameter, self._look, self._covered, self._seed = rig, diameter_mm, look, covered, seed
        self._tracker = Tracker(rig, rest_length, material, up=up)
        self._sight = DetectionOptions(polarity="dark" if look.thread < look.background else "light")
        self._random, self._moment = np.random.default_rng(seed), 0
        self._before: Clamps | None = None

    def see(self, rod: np.ndarray, clamps: Clamps) -> SeenMoment:
        """The next moment of the true rod (n, 3) mm, held by ``clamps``, one row."""
        hidden = tuple(name for name in self._rig.names if self._random.uniform() < self._covered.get(name, 0.0))
        images = render_set(self._rig, rod, self._diameter, self._look, (self._seed, self._moment), hidden)
        detected = [detect(image, self._sight) for image in images]
        far = None if self._before is None else motion_between(self._before, clamps)
        frame = self._tracker.see(detected, clamps.start_position[0], clamps.start_frame[0, :, 0], far)
        self._before, self._moment = clamps, self._moment + 1
        return SeenMoment(rod, images, hidden, frame, seen_vertices(frame, self._rig, detected))
