"""Rods from images (§IV-A, Alg. 1)."""

import json
import os
from argparse import Namespace
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from doo_ti import options as given
from doo_ti.commands.arguments import add_json, add_material, add_seen_rod, add_thread
from doo_ti.commands.perceive_task import RECORDED, Task, checked_task
from doo_ti.commands.perceive_text import summary_of, tell, verdict_text
from doo_ti.commands.printing import plain
from doo_ti.errors import InputError
from doo_ti.progress import progress
from doo_ti.whole_file import write_whole

MARGIN_PX = 60
"""Of the distance maps around what was detected."""
MOST_MAP_BYTES = 1 << 29
"""Of the distance maps held at once."""
LEAST_SIGMA_MM = 1e-3
"""Told of vertices that the seed gives: no observation is exact."""


def declare(add) -> None:
    parser = add("perceive", allow_abbrev=False, help="recover rods from images")
    parser.add_argument("images", nargs="*", metavar="IMAGE", help="one image per camera of the rig, for a single set")
    add_seen_rod(parser)
    parser.add_argument("--sets", metavar="SETS.csv", help="sets of images with their seeds, instead of IMAGEs")
    parser.add_argument("--seed-point", metavar="X,Y,Z", help="v⁰ of a single set, mm")
    parser.add_argument("--seed-direction", metavar="X,Y,Z", help="e⁰ of a single set")
    parser.add_argument("--out", required=True, metavar="F.npz", help="file to write; F.png and F.rrd lie beside it")
    add_material(parser, "one number each; perceived rods are round")
    search = parser.add_argument_group("search")
    search.add_argument("--nu", metavar="NU", help="ν, 1/(mm px²): weight of the images (default 0.005)")
    search.add_argument("--hypotheses", metavar="H", help="kept for each set and step (default 40)")
    search.add_argument("--detector", choices=("ridge", "canny"), default="ridge", help="default ridge; canny is the paper's")
    add_thread(search)
    shown = parser.add_argument_group("what is shown")
    shown.add_argument("--truth", metavar="OBS", help="the true rods, to compare with: observations, by name or in order")
    shown.add_argument("--no-picture", action="store_true", help="leave out F.png")
    shown.add_argument("--no-recording", action="store_true", help="leave out F.rrd")
    shown.add_argument("--recorded", metavar="N", help=f"sets in F.rrd, the first ones (default {RECORDED})")
    add_json(parser)
    parser.set_defaults(run=run)


def run(options: Namespace, words: list[str]) -> int:
    """Alg. 1 on every set of images; writes rods and runners-up, and prints how sure each set is."""
    out = given.output_file(options.out, ".npz")
    task = checked_task(options)
    sources = [options.rig, options.sets, options.truth, *(path for line in task.sets.paths for path in line)]
    for path in (out, *(given.output_file(out.with_suffix(suffix), suffix) for suffix in (".png", ".rrd"))):
        for source in filter(None, sources):
            given.refuse_overwriting(path, source)
    with progress() as bar:
        detected = _detected(task, bar)
        found, growth = _perceived(task, detected, bar)
    result = _arrays(task, found)
    out.parent.mkdir(parents=True, exist_ok=True)
    write_whole(out, lambda file: np.savez_compressed(file, **result))
    written = [out, *_shown(options, task, detected, found, growth, out)]
    summary = summary_of(task, detected, found, written)
    if options.json:
        print(json.dumps(plain(summary)))
    else:
        tell(summary)
    return 0 if summary["status"].get("converged") else 1


def _detected(task: Task, bar) -> list[list]:
    """A lists of C detections. Raises InputError for the first image that is none of the rig's or shows no thread."""
    from doo_ti.vision.detection.detect import detect
    from doo_ti.vision.detection.images import read_image

    def found(path: Path, camera):
        detection = detect(read_image(path, camera), task.detection)
        if not detection.count:
            raise InputError(path, "image", "no thread was found in it", "leave the set out, or give --polarity and --width")
        return detection

    cameras = task.sets.rig.cameras
    images = [(path, camera) for line in task.sets.paths for path, camera in zip(line, cameras, strict=True)]
    shown = bar.add_task("detection", total=len(images), unit="images")
    detections = []
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        waiting = [threads.submit(found, *image) for image in images]
        try:
            for one in waiting:
                detections.append(one.result())
                bar.advance(shown, 1)
        finally:
            threads.shutdown(cancel_futures=True)
    return [detections[row : row + len(cameras)] for row in range(0, len(images), len(cameras))]


def _perceived(task: Task, detected: list[list], bar):
    """(Perception of all sets, GrowthSteps of those that are recorded): in groups whose maps fit into memory."""
    from doo_ti.perception.growth import GrowthSteps
    from doo_ti.perception.perceive import Perception, perceive
    from doo_ti.vision.reprojection.distance_map import distance_maps

    sets, edges = task.sets, len(task.rest_length)
    pixels = max(camera.width * camera.height for camera in sets.rig.cameras)
    together = max(1, MOST_MAP_BYTES // (4 * pixels * len(sets.rig.cameras)))
    shown = bar.add_task("growth", total=sets.count * (edges - 1), unit="edges")
    growth, found = GrowthSteps(task.recorded), []

    def told(first: int, count: int):
        def step(_, kept, pruned) -> None:
            growth.add(first, kept, pruned)
            bar.advance(shown, count)
        return step

    for first in range(0, sets.count, together):
        rows = slice(first, first + together)
        maps = distance_maps(detected[rows], MARGIN_PX)
        found.append(perceive(maps, sets.rig, sets.point[rows], sets.direction[rows], task.rest_length, task.material,
                              up=task.up, options=task.search, on_step=told(first, len(maps.window))))
    return Perception.joined(found), growth


def _arrays(task: Task, found) -> dict[str, np.ndarray]:
    """What the file holds; docs/perception.md."""
    sound = found.sound[:, None]
    return {
        "name": np.array(task.sets.names), "vertices_mm": found.vertices, "rest_length_mm": task.rest_length, "up": task.up,
        "valid": sound & np.isfinite(found.vertices).all(axis=-1),
        "sigma_mm": np.where(sound, np.maximum(found.sigma, LEAST_SIGMA_MM), np.nan),
        "energy_vis": found.energy_vis, "status": found.status, "stable": found.stable,
        "camera_error_px": found.camera_error, "verdict": found.verdict, "gap_px": found.gap, "unsupported": found.unsupported,
        "runner_up_mm": found.runner_up, "runner_up_energy_vis": found.runner_up_energy,
    }


def _shown(options: Namespace, task: Task, detected: list[list], found, growth, out: Path) -> list[Path]:
    """Draw and record what was found, beside ``out``; returns the files."""
    from doo_ti.vision.detection.images import read_image

    rig, written = task.sets.rig, []
    there = np.flatnonzero(np.isfinite(found.vertices).all(axis=(1, 2)))

    def seen(row: int):
        from doo_ti.report import SeenRod

        images = [read_image(path, camera) for path, camera in zip(task.sets.paths[row], rig.cameras, strict=True)]
        marks = [detection.points for detection in detected[row]]
        rival = found.runner_up[row, 0] if np.isfinite(found.gap[row]) else None
        truth = None if task.truth is None else task.truth[row]
        return SeenRod(task.sets.names[row], images, marks, found.configuration.vertices[row], rival, truth,
                       verdict_text(found, row))

    if len(there) and not options.no_picture:
        from doo_ti.report import reprojections_picture
        from doo_ti.report.reprojections import MOST_SETS

        picture = out.with_suffix(".png")
        rods = [seen(row) for row in there[:MOST_SETS]]
        left_out = task.sets.count - len(rods)
        write_whole(picture, lambda file: reprojections_picture(file, rig, rods, up=task.up, left_out=left_out))
        written.append(picture)
    if (there < task.recorded).any():
        from doo_ti.record import record_perception

        recording = out.with_suffix(".rrd")
        rows = there[there < task.recorded]
        rods = [seen(row) for row in rows]
        record_perception(recording, run_id=f"perceive {out.name}", name=out.stem, rig=rig, rods=rods,
                          growth=[growth.of(row, task.sets.point[row], task.rest_length) for row in rows],
                          up=task.up)
        written.append(recording)
    return written
