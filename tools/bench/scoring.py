"""Benchmark of E_vis: ``python tools/bench/scoring.py [CASE ...] [--hypotheses N] [--rounds N] [--check | --write]``.

Hypotheses of 34 vertices scored against three distorted images each, NumPy in to NumPy out, rods relaxed between their
energy and the images, and the detection of a thread in a photograph of 12 Mpx. Prints one table, with ratios to a NumPy
workload timed in the same round; ``--check`` and ``--write`` are those of the benchmark of relaxations. All data come from a
fixed seed: no image is read.
"""

import sys
from functools import cached_property, partial
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from doo_ti import Camera, Detection, Newton, Reprojection, Rig, detect, distance_maps, relax, score
from doo_ti.lab.cases import Case, Outcome
from doo_ti.rod.frames import bishop_frames, quaternion_from_matrix
from doo_ti.rod.types import Clamp, Clamps, Configuration, Material
from tests.vision.scenes import looking
from tools.bench.baseline import outcome, run

BASELINE = Path(__file__).with_name("scoring.json")
SEED = 2011
EDGES, LENGTH = 33, 3.0  # mm
SETS, CAMERAS = 10, 3
MATERIAL = Material(2e5, 2e5)
NU = 100.0  # mm²/px²
SEARCH, FINE = Newton(tolerance=1e-2), Newton(tolerance=1e-7)


class Specimens:
    """Curved rods, their images in three cameras some 300 mm away, and hypotheses near them."""

    def __init__(self, count: int):
        self.count = count
        self.sets = np.arange(count) % SETS

    @cached_property
    def rig(self) -> Rig:
        cameras = []
        for index, angle in enumerate((0.3, 2.4, 4.5)):
            forward = -np.array([np.cos(angle), np.sin(angle), 0.7]) / np.hypot(1.0, 0.7)
            matrix = [[1700.0, 0, 635], [0, 1700.0, 483], [0, 0, 1]]
            cameras.append(Camera(f"cam{index}", 1280, 960, matrix, [-0.08, 0.03, 5e-4, -4e-4, 0], *looking(forward, 300.0)))
        return Rig(tuple(cameras))

    @cached_property
    def rods(self) -> np.ndarray:
        """(SETS, V, 3) mm, around the origin."""
        random = np.random.default_rng(SEED)
        swing = np.cumsum(0.02 * random.normal(size=(SETS, EDGES, 3)), axis=1) + 0.06 * random.normal(size=(SETS, 1, 3))
        tangents = np.cumsum(np.concatenate([random.normal(size=(SETS, 1, 3)), swing], axis=1), axis=1)[:, :EDGES]
        tangents /= np.linalg.norm(tangents, axis=-1, keepdims=True)
        return _vertices(LENGTH * tangents)

    @cached_property
    def images(self):
        """The distance maps of perfect detections, a point each half pixel or so."""
        between = np.linspace(0, EDGES, 40 * EDGES)
        detections = []
        for rod in self.rods:
            fine = np.stack([np.interp(between, np.arange(EDGES + 1), axis) for axis in rod.T], axis=-1)
            detections.append([_detected(camera, fine) for camera in self.rig.cameras])
        return distance_maps(detections)

    @cached_property
    def hypotheses(self) -> np.ndarray:
        """(N, V, 3) mm: the rods, bent at random."""
        return self._bent(np.random.default_rng(SEED + 1), EDGES, 0.03).vertices

    def grown(self, edges: int) -> tuple[Configuration, Clamps]:
        """Rods of so many edges at rest on their images, the last of them turned by 0.15 rad, as Alg. 1 starts them."""
        start = self._bent(np.random.default_rng(SEED + edges), edges, 0.01)
        first = start.frames[:, 0]
        held = Clamps(Clamp.TANGENT, Clamp.FREE, start.start, start.start, first, first)
        rest = relax(start, MATERIAL, held, FINE, external=self.external, external_index=self.sets).configuration
        tangents = rest.frames[..., 0]
        tangents[:, -1] += 0.15 * np.random.default_rng(SEED).normal(size=(self.count, 3))
        return _framed(rest.start, tangents), held

    @cached_property
    def external(self) -> Reprojection:
        return Reprojection(self.images, self.rig, NU)

    @cached_property
    def photograph(self) -> np.ndarray:
        """(3000, 4000, 3): a thread 40 px wide on paper of uneven brightness, with noise."""
        random = np.random.default_rng(SEED)
        image = cv2.resize(random.uniform(150, 215, (6, 8, 3)).astype(np.float32), (4000, 3000), interpolation=cv2.INTER_CUBIC)
        x = np.arange(300, 3700)
        curve = np.stack([x, 1500 + 900 * np.sin(x / 500)], axis=1)
        cv2.polylines(image, [np.rint(16 * curve).astype(int)], False, (60, 60, 60), 40, cv2.LINE_AA, 4)
        return np.clip(image + random.normal(0, 5, image.shape), 0, 255).astype(np.uint8)

    def detected(self) -> Outcome:
        found = detect(self.photograph)
        return Outcome(1e-6 * found.shape[0] * found.shape[1], float(found.count > 0))

    def _bent(self, random, edges: int, turn: float) -> Configuration:
        tangents = np.diff(self.rods, axis=1)[self.sets, :edges] / LENGTH
        return _framed(self.rods[self.sets, 0], tangents + turn * random.normal(size=tangents.shape))

    def scored(self, vertices: np.ndarray, points: int) -> Outcome:
        found = score(vertices, self.images, self.sets, self.rig, NU, MATERIAL, points=points)
        return Outcome(float(self.count), float(np.isfinite(found.total).mean()))

    def relaxed(self, start: Configuration, clamps: Clamps, solver: Newton, precision: str) -> Outcome:
        found = relax(start, MATERIAL, clamps, solver, precision=precision, external=self.external, external_index=self.sets)
        return outcome(found)


def _vertices(edges: np.ndarray) -> np.ndarray:
    """(N, V, 3) of (N, E, 3), about their mean."""
    vertices = np.cumsum(np.concatenate([np.zeros((len(edges), 1, 3)), edges], axis=1), axis=1)
    return vertices - vertices.mean(axis=1, keepdims=True)


def _framed(start: np.ndarray, tangents: np.ndarray) -> Configuration:
    tangents = tangents / np.linalg.norm(tangents, axis=-1, keepdims=True)
    frames = bishop_frames(tangents, np.cross(tangents[:, 0], [0.3, 0.5, 0.8]))
    return Configuration(start, quaternion_from_matrix(frames), np.full(tangents.shape[1], LENGTH))


def _detected(camera: Camera, points: np.ndarray) -> Detection:
    pixels = camera.project(points)
    along = np.gradient(pixels, axis=0)
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    return Detection(pixels, along, np.ones(len(pixels)), 2.0, "dark", (camera.height, camera.width), "drawn")


def cases(rods: Specimens, few: Specimens) -> list[Case]:
    """The timed cases: scores of ``rods``, relaxations of ``few``."""
    single = rods.hypotheses.astype(np.float32)
    scores = [Case(f"score, {points} points per edge", "hypotheses/s", partial(rods.scored, single, points))
              for points in (4, 8, 16)]
    scores.append(Case("score, 8 points per edge, f64 in", "hypotheses/s", lambda: rods.scored(rods.hypotheses, 8)))
    scores.append(Case("score, single edges", "hypotheses/s", lambda: rods.scored(single[:, :2], 8)))
    for edges in (17, EDGES):
        start, clamps = few.grown(edges)
        for precision, solver in (("f32", SEARCH), ("f64", FINE)):
            scores.append(Case(f"relax {precision}, {edges} edges", "rods/s",
                               partial(few.relaxed, start, clamps, solver, precision)))
    scores.append(Case("detect, 12 Mpx", "Mpx/s", few.detected))
    return scores


def main(arguments: list[str]) -> int:
    return run(arguments, __doc__.splitlines()[0], BASELINE, "hypotheses", 32_768, 8,
               lambda count: cases(Specimens(count), Specimens(count // 8)))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
