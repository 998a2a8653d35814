"""Accuracy of rods recovered from images (§V-E, Fig. 6): the virtual lab's 180 sets, loops, and two cameras only.

    python tools/studies/perception_study.py [lab loops camera ...] [--sets N]
"""

import argparse
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

if not __package__:
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from doo_ti.commands.results import counted  # noqa: E402
from doo_ti.io.scene import Synthesis, load_scene  # noqa: E402
from doo_ti.learning.landscape import status_counts  # noqa: E402
from doo_ti.perception.perceive import Perception, PerceptionVerdict, perceive  # noqa: E402
from doo_ti.perception.search import PerceptionOptions, Search  # noqa: E402
from doo_ti.perception.virtual_lab import LabRods, lab_rods  # noqa: E402
from doo_ti.rod.types import Material  # noqa: E402
from doo_ti.vision.cameras.rig import Rig, load_rig  # noqa: E402
from doo_ti.vision.detection.line import Detection  # noqa: E402
from doo_ti.vision.detection.options import DetectionOptions  # noqa: E402
from doo_ti.vision.rendering.render import Photographs, RenderOptions  # noqa: E402
from doo_ti.vision.rendering.tubes import smooth_curve  # noqa: E402
from doo_ti.vision.reprojection.distance_map import DistanceMaps, distance_maps  # noqa: E402
from tools.studies.trials.perception import (  # noqa: E402
    Trial,
    crossings,
    detected,
    filled,
    judged,
    sets_of,
    taken,
    truth_energy,
    unseen,
    usual_width,
    with_energy,
    without_camera,
)

SCENES = Path(__file__).resolve().parents[2] / "scenes"
THREADS = ("nylon", "vicryl", "silk")
DIAMETER_MM, MARGIN_PX, SEED, MOST_NAMED = 0.5, 60, 2011, 6
SHARES = (1.0, 1e-2, 1e-4)
OPTIONS, UP = PerceptionOptions(), np.array([0.0, 0.0, 1.0])
HEAD = ("| row | sets | correct | search lost it | score prefers another | of the correct, vertex mm: mean, worst "
        "| curve mm: mean, worst | thread unseen | clear | likely | ambiguous | not found | status | s |")


@dataclass(frozen=True)
class Case:
    """Sets of images of one thread, detected."""

    rods: LabRods
    material: Material
    rig: Rig
    detections: list[list[Detection]]
    maps: DistanceMaps
    pixels: np.ndarray
    curve: np.ndarray


def main() -> None:
    rows = {"lab": lab, "loops": loops, "camera": camera}
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("rows", nargs="*", metavar="ROW", help=f"of {', '.join(rows)} (default: all)")
    parser.add_argument("--sets", type=int, default=60, metavar="N", help="of each thread (default 60)")
    options = parser.parse_args()
    unknown = [name for name in options.rows if name not in rows]
    if unknown:
        parser.error(f"no row {unknown[0]}: give some of {', '.join(rows)}")
    print(f"seed {SEED}; correct: mean vertex error below 1 mm; clear, likely, ambiguous, not found: the correct ones of each\n"
          f"{HEAD}\n" + "|---" * (HEAD.count("|") - 1) + "|")
    for name in options.rows or rows:
        rows[name](options.sets)


def lab(sets: int) -> None:
    """§V-E: the paper's 180 sets, all options at their defaults."""
    began = time.perf_counter()
    for name in THREADS:
        case, seconds = photographed(name, sets)
        report(f"lab: {name}", case, case.rods.point, case.rods.direction, before=seconds)
    print(f"lab: {time.perf_counter() - began:.0f} s in all, rods made, photographed and recovered", flush=True)


def loops(sets: int) -> None:
    """Fig. 6: threads that cross themselves in every view, with the rod's energy and with little of it; and others."""
    for name in THREADS:
        case, _ = photographed(f"loops_{name}", None, crossing=True)
        again = mapped(case, filled(case.detections, case.maps, case.pixels))
        for seen, these in (("as detected", case), ("gaps filled", again)):
            shares(f"loops: {name}, {seen}", these)
    for name in THREADS:
        shares(f"no loops: {name}", photographed(name, min(sets, 20))[0])


def shares(what: str, case: Case) -> None:
    for share in SHARES:
        report(f"{what}, energy x {share:g}", case, case.rods.point, case.rods.direction, with_energy(OPTIONS, share))


def camera(sets: int) -> None:
    """Two cameras: each of the three is left out of a third of the sets, drawn at random."""
    for name in THREADS:
        case, _ = photographed(name, sets)
        lot = np.random.default_rng(SEED).permutation(len(case.rods.names))
        for index, left_out in enumerate(case.rig.names):
            maps, rig = without_camera(case.maps, case.rig, index)
            less = Case(case.rods, case.material, rig, case.detections, maps, np.delete(case.pixels, index, axis=0), case.curve)
            rows = np.sort(lot[index :: len(case.rig.names)])
            report(f"without {left_out}: {name}", of(less, rows), case.rods.point[rows], case.rods.direction[rows])


def photographed(scene: str | Synthesis, sets: int | list[int] | None, look: RenderOptions = RenderOptions(),
                 crossing: bool = False, detection: DetectionOptions = DetectionOptions()) -> tuple[Case, float]:
    """Images of a scene's rods, detected; and the seconds from images to distance maps.

    scene     name of a shipped one, or a recipe
    sets      how many rods, evenly chosen, or the rows of the rods
    crossing  instead all rods that cross themselves in every image
    """
    rig = load_rig(SCENES / "rig.yaml")
    recipe = load_scene(SCENES / f"{scene}.toml").observations if isinstance(scene, str) else scene
    rods = lab_rods(recipe)
    if crossing:
        rods = rods.take(np.flatnonzero((crossings(rig.project(rods.curve)) > 0).all(axis=0)))
    elif isinstance(sets, list):
        rods = rods.take(sets)
    elif sets is not None and sets < len(rods.names):
        rods = rods.take(np.linspace(0, len(rods.names) - 1, sets).round().astype(int))
    images = taken(Photographs(rods.names, rods.curve, rods.point, rods.direction, DIAMETER_MM, rig, look, SEED))
    began = time.perf_counter()
    found = detected(images, detection)
    if crossing:
        found = detected(images, replace(detection, width_px=usual_width(found)))
    curve = smooth_curve(rods.curve, 8)
    maps = distance_maps(found, MARGIN_PX)
    return Case(rods, recipe.material(), rig, found, maps, rig.project(curve), curve), time.perf_counter() - began


def mapped(case: Case, detections: list[list[Detection]]) -> Case:
    maps = distance_maps(detections, MARGIN_PX)
    return Case(case.rods, case.material, case.rig, detections, maps, case.pixels, case.curve)


def of(case: Case, rows: np.ndarray) -> Case:
    """Some of the sets."""
    return Case(case.rods.take(rows), case.material, case.rig, [case.detections[row] for row in rows],
                sets_of(case.maps, rows), case.pixels[:, rows], case.curve[rows])


def recovered(case: Case, point, direction, options: PerceptionOptions = OPTIONS) -> tuple[Perception, Trial, float]:
    """The rods from seeds ``point``, ``direction`` (A, 3); beside the truth; and the seconds that it took to find them."""
    began = time.perf_counter()
    found = perceive(case.maps, case.rig, point, direction, case.rods.rest_length, case.material, options=options)
    seconds = time.perf_counter() - began
    search = Search(case.maps, case.rig, point, direction, case.rods.rest_length, case.material, UP, options)
    return found, judged(found, case.rods.vertices, case.curve, truth_energy(search, case.rods.vertices)), seconds


def report(what: str, case: Case, point, direction, options: PerceptionOptions = OPTIONS, before: float = 0.0) -> None:
    """One row of the table, and a line for each of the first sets that are not correct; ``before``: seconds to add."""
    found, trial, seconds = recovered(case, point, direction, options)
    good, missing = trial.correct, unseen(case.maps, case.pixels).mean(axis=(1, 2))
    status = counted(status_counts(trial.status))
    errors = [f"{error[good].mean():.3f}, {error[good].max():.3f}" if good.any() else "none"
              for error in (trial.vertex_error, trial.curve_error)]
    verdicts = " | ".join(f"{(good & these).sum()} of {these.sum()}"
                          for these in (found.verdict == kind for kind in PerceptionVerdict))
    print(f"| {what} | {len(good)} | {good.sum()} | {trial.overlooked.sum()} | {(~good & ~trial.overlooked).sum()} "
          f"| {errors[0]} | {errors[1]} | {missing.mean():.3f} | {verdicts} | {status} | {before + seconds:.1f} |", flush=True)
    for row in np.flatnonzero(~good)[:MOST_NAMED]:
        print(f"    {case.rods.names[row]}: {trial.vertex_error[row]:.2f} mm off, E_vis {trial.energy_vis[row]:.3f} beside "
              f"{trial.truth_energy[row]:.3f} of the truth, camera error {np.round(found.camera_error[row], 1).tolist()} px, "
              f"unseen {missing[row]:.2f}", file=sys.stderr)


if __name__ == "__main__":
    main()
