"""Accuracy of rods recovered from images (§V-E, Fig. 6): the virtual lab's 180 sets, loops, and two cameras only.

    python tools/studies/perception_study.py [lab loops camera ...] [--sets N]

Axes: A sets, C cameras, V vertices, n points of a curve.
"""

import argparse
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from doo_ti import Detection, DetectionOptions, DistanceMaps, Material, Rig, detect, distance_maps, load_rig
from doo_ti.commands.results import status_text
from doo_ti.io.scene import Synthesis
from doo_ti.learning.landscape import status_counts
from doo_ti.perception.perceive import Perception, PerceptionVerdict, perceive
from doo_ti.perception.search import PerceptionOptions
from doo_ti.perception.virtual_lab import LabRods, lab_rods
from doo_ti.vision.render import Photographs, RenderOptions
from doo_ti.vision.tubes import smooth_curve
from tools.studies.replication.specimens import SCENES, scene

THREADS = ("nylon", "vicryl", "silk")
DIAMETER_MM, MARGIN_PX, SEED, MOST_NAMED = 0.5, 60, 2011, 6
SHARES = (1.0, 1e-2, 1e-4)
OPTIONS = PerceptionOptions()
CORRECT_MM = 1.0  # a rod with a smaller mean error of its vertices counts as recovered correctly
UNSEEN_PX = 2.0
"""The thread is not detected where the next detected point is further away: an error of the line itself is far less."""
HEAD = ("| row | sets | correct | of the correct, vertex mm: mean, worst | thread unseen | clear | likely | ambiguous "
        "| not found | status | s |")


@dataclass(frozen=True)
class Case:
    """Sets of images of one thread, detected, and the images (C, A, n, 2) of the true curve."""

    rods: LabRods
    material: Material
    rig: Rig
    detections: list[list[Detection]]
    maps: DistanceMaps
    pixels: np.ndarray

    def unseen(self) -> np.ndarray:
        """(A, C, n) bool: where the true curve has no detected point near."""
        offset, left, top, width, height = (self.maps.window[..., index, None] for index in range(5))
        column, line = np.moveaxis(np.rint(np.swapaxes(self.pixels, 0, 1)).astype(np.int64), -1, 0)
        column, line = np.clip(column - left, 0, width - 1), np.clip(line - top, 0, height - 1)
        return self.maps.values[offset + line * width + column] > UNSEEN_PX

    def filled(self) -> "Case":
        """With the true curve put into the detections where nothing was seen, as in §V-E."""
        missing, run = self.unseen(), np.gradient(self.pixels, axis=2)
        run /= np.linalg.norm(run, axis=-1, keepdims=True)
        detections = [[with_points(*one) for one in zip(views, missing[row], self.pixels[:, row], run[:, row], strict=True)]
                      for row, views in enumerate(self.detections)]
        return replace(self, detections=detections, maps=distance_maps(detections, MARGIN_PX))

    def without(self, camera: int, rows: np.ndarray) -> "Case":
        """Some of the sets, without one of the cameras."""
        kept = np.delete(np.arange(len(self.rig.cameras)), camera)
        rig = self.rig.take(kept)
        detections, pixels = [[self.detections[row][one] for one in kept] for row in rows], self.pixels[kept][:, rows]
        return Case(self.rods.take(rows), self.material, rig, detections, self.maps.take(rows, kept), pixels)


def with_points(found: Detection, missing: np.ndarray, curve: np.ndarray, direction: np.ndarray) -> Detection:
    """``found``, and besides the ``missing`` points of a curve (n, 2)."""
    strength = np.full(missing.sum(), np.median(found.strength))
    return replace(found, points=np.concatenate([found.points, curve[missing]]), strength=np.append(found.strength, strength),
                   direction=np.concatenate([found.direction, direction[missing]]), width=None)


def main() -> None:
    rows = {"lab": lab, "loops": loops, "camera": camera}
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("rows", nargs="*", choices=[*rows, []], help="default: all")
    parser.add_argument("--sets", type=int, default=60, metavar="N", help="of each thread (default 60)")
    options = parser.parse_args()
    print(f"seed {SEED}; correct: mean vertex error below 1 mm; clear, likely, ambiguous, not found: the correct ones of each\n"
          f"{HEAD}\n" + "|---" * (HEAD.count("|") - 1) + "|")
    for name in options.rows or rows:
        rows[name](options.sets)


def lab(sets: int) -> None:
    """§V-E: the paper's 180 sets, all options at their defaults."""
    began = time.perf_counter()
    for name in THREADS:
        case, seconds = photographed(scene(name).observations, sets)
        report(f"lab: {name}", case, before=seconds)
    print(f"lab: {time.perf_counter() - began:.0f} s in all, rods made, photographed and recovered", flush=True)


def loops(sets: int) -> None:
    """Fig. 6: threads that cross themselves in every view, with the rod's energy and with little of it."""
    for name in THREADS:
        case, _ = photographed(scene(f"loops_{name}").observations, crossing=True)
        for seen, these in (("as detected", case), ("gaps filled", case.filled())):
            for share in SHARES:
                report(f"loops: {name}, {seen}, energy x {share:g}", these, with_energy(OPTIONS, share))


def camera(sets: int) -> None:
    """Two cameras: each of the three is left out of a third of the sets, drawn at random."""
    for name in THREADS:
        case, _ = photographed(scene(name).observations, sets)
        lot = np.random.default_rng(SEED).permutation(len(case.rods.names))
        for index, left_out in enumerate(case.rig.names):
            report(f"without {left_out}: {name}", case.without(index, np.sort(lot[index :: len(case.rig.names)])))


def in_threads(make, items) -> list:
    with ThreadPoolExecutor(2) as executor:
        return list(executor.map(make, items))


def photographed(recipe: Synthesis, sets: int | list[int] | None = None, look: RenderOptions = RenderOptions(),
                 crossing: bool = False, detection: DetectionOptions = DetectionOptions()) -> tuple[Case, float]:
    """Images of a scene's rods, detected; and the seconds from images to distance maps.

    sets      how many rods, evenly chosen, or the rows of the rods; None: all
    crossing  instead all rods that cross themselves in every image; the width of their line is taken from all images, so that
              views where strands touch do not mislead
    """
    rig, rods = load_rig(SCENES / "rig.yaml"), lab_rods(recipe)
    if crossing:
        rods = rods.take(np.flatnonzero((crossings(rig.project(rods.curve)) > 0).all(axis=0)))
    elif isinstance(sets, list):
        rods = rods.take(sets)
    elif sets is not None and sets < len(rods.names):
        rods = rods.take(np.linspace(0, len(rods.names) - 1, sets).round().astype(int))
    photographs = Photographs(rods.names, rods.curve, rods.point, rods.direction, DIAMETER_MM, rig, look, SEED)
    images = in_threads(photographs.images, range(len(rods.names)))
    began = time.perf_counter()
    found = in_threads(lambda views: [detect(image, detection) for image in views], images)
    if crossing:
        usual = replace(detection, width_px=float(np.nanmedian([one.width_px for views in found for one in views])))
        found = in_threads(lambda views: [detect(image, usual) for image in views], images)
    maps, pixels = distance_maps(found, MARGIN_PX), rig.project(smooth_curve(rods.curve, 8))
    return Case(rods, recipe.material(), rig, found, maps, pixels), time.perf_counter() - began


def with_energy(options: PerceptionOptions, share: float) -> PerceptionOptions:
    """The same search with the rod's energy multiplied by ``share``, which must not be zero: ν is divided by it."""
    return replace(options, nu=options.nu / share, growing_nu=options.growing_nu / share)


def recovered(case: Case, options: PerceptionOptions = OPTIONS) -> tuple[Perception, np.ndarray, float]:
    """The rods; (A,) mm, mean distance of their vertices to the true ones; and the seconds that it took to find them."""
    rods, began = case.rods, time.perf_counter()
    found = perceive(case.maps, case.rig, rods.point, rods.direction, rods.rest_length, case.material, options=options)
    seconds = time.perf_counter() - began
    return found, np.linalg.norm(found.vertices - rods.vertices, axis=-1).mean(axis=1), seconds


def crossings(pixels: np.ndarray) -> np.ndarray:
    """(...) how often polygons (..., n, 2) in an image cross themselves."""
    begin, along = pixels[..., :-1, :], np.diff(pixels, axis=-2)
    between = begin[..., None, :, :] - begin[..., :, None, :]
    first, second = along[..., :, None, :], along[..., None, :, :]
    area = _cross(first, second)
    with np.errstate(divide="ignore", invalid="ignore"):
        place, other = _cross(between, second) / area, _cross(between, first) / area
    apart = np.subtract.outer(np.arange(along.shape[-2]), np.arange(along.shape[-2])) < -1
    hit = (place >= 0) & (place < 1) & (other >= 0) & (other < 1) & apart
    return hit.sum(axis=(-1, -2))


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def report(what: str, case: Case, options: PerceptionOptions = OPTIONS, before: float = 0.0) -> None:
    """One row of the table, and a line for each of the first sets that are not correct; ``before``: seconds to add."""
    found, off, seconds = recovered(case, options)
    good, missing = off < CORRECT_MM, case.unseen().mean(axis=(1, 2))
    status = status_text(status_counts(found.status))
    errors = f"{off[good].mean():.3f}, {off[good].max():.3f}" if good.any() else "none"
    verdicts = " | ".join(f"{(good & these).sum()} of {these.sum()}"
                          for these in (found.verdict == kind for kind in PerceptionVerdict))
    print(f"| {what} | {len(good)} | {good.sum()} | {errors} | {missing.mean():.3f} | {verdicts} | {status} "
          f"| {before + seconds:.1f} |", flush=True)
    for row in np.flatnonzero(~good)[:MOST_NAMED]:
        print(f"    {case.rods.names[row]}: {off[row]:.2f} mm off, E_vis {found.energy_vis[row]:.3f}, "
              f"camera error {np.round(found.camera_error[row], 1).tolist()} px, unseen {missing[row]:.2f}", file=sys.stderr)


if __name__ == "__main__":
    main()
