"""The virtual lab before cameras (§V-A, §VI): its rods for images, with their true shapes; and a moving rod as cameras see it:
rendered, detected, and tracked, moment by moment.

    cameras = VirtualCameras(rig, rest_length, material)
    servo = Servo(rods, material, clamps, targets)
    while …:
        moment = cameras.see(simulation.state.configuration.vertices[0], servo.clamps)
        simulation.step(servo.step(moment.seen[None]))

The grippers' poses are known, as a robot knows them: the rod is sought from the near one on. Nothing else of the rod is.

Axes: S observations, C cameras, V marks or vertices, n vertices of the fine mesh.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from doo_ti.io.scene import Synthesis
from doo_ti.lab.synthesis import fine_vertices
from doo_ti.motion.path import motion_between
from doo_ti.perception.tracking import TrackedFrame, Tracker, seen_vertices
from doo_ti.rod.frames import unit_vectors
from doo_ti.rod.types import Clamps, Material
from doo_ti.system.errors import InputError
from doo_ti.system.files import write_whole
from doo_ti.vision.cameras import Rig
from doo_ti.vision.detect import detect
from doo_ti.vision.detection import DetectionOptions
from doo_ti.vision.render import RenderOptions, render_set


@dataclass(frozen=True)
class LabRods:
    """The rods of a scene, free of any noise."""

    names: tuple[str, ...]  # S of them: rod, end distance and end rotation
    curve: np.ndarray  # (S, n, 3) mm: the fine mesh, with its rest curvature and its clips
    vertices: np.ndarray  # (S, V, 3) mm: its marks
    rest_length: np.ndarray  # (V − 1,) mm between them

    @property
    def point(self) -> np.ndarray:
        """(S, 3) mm: v⁰."""
        return self.vertices[:, 0]

    @property
    def direction(self) -> np.ndarray:
        """(S, 3) unit vectors along e⁰, which the clip holds if it is at least as long."""
        return unit_vectors(self.vertices[:, 1] - self.vertices[:, 0])

    def take(self, rows) -> "LabRods":
        rows = np.asarray(rows)
        return LabRods(tuple(np.array(self.names)[rows].tolist()), self.curve[rows], self.vertices[rows], self.rest_length)


def lab_rods(synthesis: Synthesis) -> LabRods:
    """The rods behind :func:`doo_ti.lab.synthesis.synthesise`, in its order.

    Raises InputError for rods that are not round, and InterruptedRunError where a rod cannot be carried to a stable
    equilibrium.
    """
    if not synthesis.material().is_isotropic or synthesis.frames:
        raise InputError(synthesis.source, "synthesis.bend", f"{synthesis.name} is not round",
                         "images are of threads: give one number, and no frames")
    curve = fine_vertices(synthesis)
    spacing = synthesis.length_mm / (synthesis.marks - 1)
    names = tuple(f"{synthesis.name}_{distance:g}mm_{rotation:03g}deg" for rotation in synthesis.end_rotations_deg
                  for distance in synthesis.end_distances_mm)
    return LabRods(names, curve, curve[:, :: round(spacing / synthesis.fine_edge_mm)], np.full(synthesis.marks - 1, spacing))


def save_truth(path: Path, rods: LabRods, diameter_mm: float) -> None:
    """Write the true shapes as npz: ``names``, ``vertices_mm``, ``curve_mm``, ``rest_length_mm``, ``thread_diameter_mm``."""
    write_whole(path, lambda file: np.savez_compressed(
        file, names=np.array(rods.names), vertices_mm=rods.vertices, curve_mm=rods.curve, rest_length_mm=rods.rest_length,
        thread_diameter_mm=diameter_mm))


DIAMETER_MM = 2.0  # of the thread, unless given
TRACKED_NOISE = 0.003
"""Of the rod's length, standard deviation of a coordinate that a servo should assume. Rods are tracked to a fifth of that by
three cameras and to a half by two, root mean square, but their errors are common to neighbouring vertices and to moments."""


@dataclass(frozen=True)
class SeenMoment:
    """What the cameras saw at one moment."""

    rod: np.ndarray  # (n, 3) mm, the true one
    images: list[np.ndarray]  # C images (H, W) uint8
    covered: tuple[str, ...]  # names of the cameras that saw nothing
    frame: TrackedFrame  # the rod that was tracked
    seen: np.ndarray  # (V, 3) mm, its vertices that images show, NaN at the others


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
