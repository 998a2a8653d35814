"""Rods from images (§IV-A, Alg. 1)."""

from argparse import Namespace
from dataclasses import replace
from pathlib import Path

import numpy as np

import doo_ti
from doo_ti.commands import doubts, given, image_options, loading, results
from doo_ti.commands.image_options import GUESSED_BEND, MOST_HYPOTHESES, RECORDED, SeenRods
from doo_ti.learning.landscape import status_counts
from doo_ti.perception.growth import GrowthSteps
from doo_ti.rod.types import Status
from doo_ti.system.arguments import counted
from doo_ti.system.errors import InputError
from doo_ti.system.terminal import can_record, in_line, progress, warn
from doo_ti.vision.images import read_image

MARGIN_PX = 60  # of the distance maps around what was detected
MOST_MAP_BYTES = 1 << 29  # of the distance maps held at once
LEAST_SIGMA_MM = 1e-3  # stated for vertices that the seed gives: no observation is exact
LEFT_OVER = 0.02  # share of the rod's length by which the thread has another; less is not mentioned
OUTSIDE = 0.01  # share of the thread outside the other images that is worth saying
MOST_LISTED = 60
MISREAD = {"skipped": "leaves out a piece {:.0f} widths long", "twice": "runs along itself for {:.0f} widths",
           "wider": "goes on {:.0f} widths along something wider"}


def declare(add) -> None:
    parser = given.command(add, "perceive", run, "recover rods from images (§IV-A, Algorithm 1)")
    parser.add_argument("images", nargs="*", metavar="IMAGE", help="for a single set: one image per camera of the rig")
    image_options.add_seen_rod(parser)
    given.add(parser, "--sets", "SETS.csv", str, "many sets of images with their seeds, instead of IMAGEs")
    given.add(parser, "--seed-point", "X,Y,Z", given.numbers("X,Y,Z"), "start v⁰ of the rod in a single set, mm")
    given.add(parser, "--seed-direction", "X,Y,Z", given.numbers("X,Y,Z"), "direction e⁰ of the rod at its start in a single "
              "set (default: as the thread goes on in the images)")
    given.add_out(parser, "F.npz|F.csv", "file to write; F.png and F.rrd are written beside it")
    given.add_material(parser, image_options.ROUND, round_rod=True)
    search = parser.add_argument_group("search")
    given.add(search, "--nu", "NU", given.positive(), "weight ν of the images against the rod's energy, in 1/(mm px²) (default "
              "0.005)")
    given.add(search, "--hypotheses", "H", given.whole(1, MOST_HYPOTHESES), "hypotheses kept per set and step (default 40)")
    search.add_argument("--evidence", choices=("both", "rod"), default="both", help="both: from the rod to the images and "
                        "back, with rods traced along the detected lines (default); rod: the paper's E_proj alone")
    search.add_argument("--detector", choices=("ridge", "canny"), default="ridge",
                        help="detector of the thread (default ridge; canny is the paper's)")
    image_options.add_thread(search)
    given.add_obstacles(parser, "without friction; the first run compiles for minutes")
    shown = parser.add_argument_group("pictures and recording")
    given.add(shown, "--truth", "OBS", str, "true rods to draw, and to compare with where they have as many marks: "
              "observations, matched by the names in an .npz, else in the order of the sets")
    loading.add_files(shown, "--truth")
    shown.add_argument("--no-picture", action="store_true", help="do not write F.png")
    shown.add_argument("--no-recording", action="store_true", help="do not write F.rrd")
    given.add(shown, "--recorded-sets", "N", given.COUNT, "record the first N sets in F.rrd", RECORDED, dest="recorded")
    given.add_old_name(parser, "--recorded", "recorded")


def run(options: Namespace) -> int:
    out, (task, truth) = options.out, image_options.rods_of_sets(options)

    from doo_ti.vision.paths import thread_beyond

    chosen = {"nu": options.nu, "hypotheses": options.hypotheses, "evidence": options.evidence}
    search = doo_ti.PerceptionOptions(**{name: value for name, value in chosen.items() if value is not None})
    sources = [options.rig, options.sets, options.truth, *(path for line in task.sets.paths for path in line)]
    beside = [suffix for suffix, left_out in ((".png", options.no_picture), (".rrd", options.no_recording)) if not left_out]
    for path in (out, *(given.output_file("--out", out.with_suffix(suffix), (suffix,)) for suffix in beside)):
        results.refuse_overwriting(path, *sources)
    with progress() as bar:
        detected, failed = _detected(task, bar)
        begun, rows, length_range, covariance = _begun(task, search, detected, failed)
        detected = [detected[row] for row in rows]
        growth = GrowthSteps(0 if options.no_recording else options.recorded)
        found = _perceived(begun, search, detected, covariance, growth, bar)
        found = replace(found, length_range=np.broadcast_to(length_range, found.length_range.shape))
        if np.ptp(length_range) > 0:  # a stated length may be that of a part
            cameras, views = task.sets.rig.cameras, zip(detected, begun.sets.paths, strict=True)
            lines = [task.sight.with_opposite(*view, cameras) for view in views]
            found = replace(found, beyond=thread_beyond(task.sets.rig, found.configuration, lines, covariance.any(axis=(1, 2))))
    doubts.warn_of_axes(options, task.sets.rig)
    image_options.warn_of_rig(options, begun.sets, begun.rest_length.sum(), found.verdict, found.camera_error, detected)
    task, every = replace(task, rest_length=begun.rest_length), found.among(rows, task.sets.count)
    results.save_arrays(out, _arrays(task, every))
    written = [out, *_shown(options, begun, None if truth is None else truth[rows], detected, found, growth, out)]
    summary = _summary(task, truth, detected, every, failed, written)
    results.report(options, summary, lambda: _lines(summary))
    return 0 if summary["found"] else 1


def _detected(task: SeenRods, bar) -> tuple[list[list], dict[int, InputError]]:
    """A lists of C detections, and by their rows the sets in which an image or a click shows no thread. Raises InputError for
    the first image that does not fit the rig."""
    paths, cameras, detected, failed = task.sets.paths, task.sets.rig.cameras, [], {}
    shown = bar.add_task("detection", total=len(paths) * len(cameras), unit="images")
    seen = image_options.detections(task.sight, paths, cameras, failed)
    for row, (images, found) in enumerate(zip(paths, seen, strict=True)):
        empty = next((k for k, detection in enumerate(found) if not detection.count), None)
        if empty is not None and row not in failed:
            mask = found[empty].method == "mask"  # of a file, or the image's own
            failed[row] = InputError(task.sight.file(images[empty], cameras[empty]), "mask" if mask else "image",
                                     "no thread was found in it", "leave the set out, or "
                                     + ("mark the thread in it" if mask else task.sight.remedy()))
        detected.append(found)
        bar.advance(shown, len(found))
    return detected, failed


def _begun(task: SeenRods, search, detected: list[list], failed: dict[int, InputError]
           ) -> tuple[SeenRods, np.ndarray, np.ndarray, np.ndarray]:
    """The sets in which a rod can begin, with seeds and rest lengths that are not given found in the images; their rows; (2,)
    mm between which the length is, NaN where it is given; and (R, 3, 3) mm² how uncertain seeds are, zero where they are given.

    failed  why other sets have no rod, by their rows; those are added here in which nothing can be followed

    Raises InputError where no set is left.
    """
    length_range, rest_length = np.full(2, np.nan), task.rest_length
    points, covariance = task.sets.point, np.zeros((task.sets.count, 3, 3))
    if points is None:
        points, covariance = _clicked_points(task.sets, task.sight.remedy(), detected, failed)
    rows = _left(task.sets, failed)
    sets = replace(task.sets.take(rows), point=points[rows])
    if rest_length is None or sets.direction is None:
        from doo_ti.perception.seeds import whole_threads

        threads = whole_threads(sets.rig, [detected[row] for row in rows], sets.point, sets.direction, task.material, task.up,
                                search)
        lost = np.isnan(threads.direction).any(axis=1)
        lost |= rest_length is None and np.isnan(threads.length).all()
        for row in rows[lost]:
            failed[int(row)] = InputError(_source(task.sets, row), "seed", "no thread can be followed from it",
                                          "give another, or --rest-length and a seed with a direction")
        rows = _left(task.sets, failed)
        sets = replace(sets, direction=threads.direction).take(np.flatnonzero(~lost))
    if rest_length is None:  # one rod in all sets
        like = task.length_bounds.agreeing(threads.length)
        middle = float(np.median(threads.length[like]))
        rest_length = task.length_bounds.rest_length(middle, float(threads.turn[like].max()))
        # Several sets are no more certain than one: lines end before or behind the thread's end in the same way in all.
        length_range = task.length_bounds.range(middle, np.median(threads.range[like], axis=0))
    return replace(task, sets=sets, rest_length=rest_length), rows, length_range, covariance[rows]


def _clicked_points(sets, remedy: str, detected: list[list], failed: dict[int, InputError]) -> tuple[np.ndarray, np.ndarray]:
    """(A, 3) mm where the rods of the clicks begin, and (A, 3, 3) mm² how uncertain that is; NaN where none does: why, and the
    ``remedy`` where nothing was detected, is then in ``failed``."""
    from doo_ti.perception.seeds import seed_from_pixels

    points, covariance = np.full((sets.count, 3), np.nan), np.full((sets.count, 3, 3), np.nan)
    for row in range(sets.count):
        try:
            if row not in failed:
                seed = seed_from_pixels(sets.rig, detected[row], sets.clicks[row], _source(sets, row), remedy=remedy)
                points[row], covariance[row] = seed.point, seed.covariance
                if seed.inside:
                    warn(f"{_source(sets, row)}: no end of the thread is near the pixel: the rod begins within the thread")
        except InputError as error:
            failed[row] = error
    return points, covariance


def _source(sets, row: int) -> str:
    """How messages name a set."""
    return f"{sets.source}: {in_line(sets.names[row])}" if sets.count > 1 else sets.source


def _left(sets, failed: dict[int, InputError]) -> np.ndarray:
    """The rows of the sets that have not ``failed``. Raises the first of these errors where there are none."""
    if len(failed) == sets.count:
        raise failed[min(failed)]
    return np.setdiff1d(np.arange(sets.count), list(failed)).astype(int)


def _perceived(task: SeenRods, search, detected: list[list], covariance: np.ndarray, growth: GrowthSteps, bar):
    """The Perception of all sets, in groups whose maps fit into memory; its steps are added to ``growth``."""
    sets, edges = task.sets, len(task.rest_length)
    pixels = max(camera.width * camera.height for camera in sets.rig.cameras)
    together = max(1, MOST_MAP_BYTES // (4 * pixels * len(sets.rig.cameras)))
    shown = bar.add_task("growth", total=sets.count * (edges - 1), unit="edges")
    found = []

    def advance(first: int, count: int):
        def step(_, kept, pruned) -> None:
            growth.add(first, kept, pruned)
            bar.advance(shown, count)
        return step

    for first in range(0, sets.count, together):
        rows = slice(first, first + together)
        maps = doo_ti.distance_maps(detected[rows], MARGIN_PX)
        found.append(doo_ti.perceive(maps, sets.rig, sets.point[rows], sets.direction[rows], task.rest_length, task.material,
                                     up=task.up, options=search, on_step=advance(first, len(maps.window)),
                                     surroundings=task.surroundings, start_covariance=covariance[rows]))
    return doo_ti.Perception.joined(found)


def _arrays(task: SeenRods, found) -> dict[str, np.ndarray]:
    """The arrays of the file; docs/commands/perceive.md."""
    sound, sigma = _found(found)[:, None], sigma_with_length(found.sigma, found.length_range, task.sets.point is None)
    return {
        "name": np.array(task.sets.names), "vertices_mm": found.vertices, "rest_length_mm": task.rest_length, "up": task.up,
        "valid": sound & np.isfinite(found.vertices).all(axis=-1),
        "sigma_mm": np.where(sound, np.maximum(sigma, LEAST_SIGMA_MM), np.nan),
        **{name: getattr(found, name) for name in ("energy_vis", "status", "stable", "coverage", "outside", "hidden", *MISREAD,
                                                   "verdict", "unsupported")},
        "camera_error_px": found.camera_error, "thread_length_mm": found.thread_length, "left_over_mm": found.left_over,
        "length_range_mm": found.length_range, "beyond_mm": found.beyond, "gap_px": found.gap, "runner_up_mm": found.runner_up,
        "runner_up_energy_vis": found.runner_up_energy,
    }


def sigma_with_length(sigma: np.ndarray, length_range: np.ndarray, clicked: bool) -> np.ndarray:
    """``sigma`` (S, V) mm of the vertices, where the last one, and a ``clicked`` first one, is as uncertain along the rod as
    its length between ``length_range`` (S, 2) mm, a range of 4 σ. Those between them slide by a share of that, all together: as
    noise of each it would hide the shape, which is known."""
    sigma, along = sigma.copy(), np.nan_to_num(np.ptp(length_range, axis=1, keepdims=True)) / 4 / np.sqrt(3)
    ends = [0, -1] if clicked else [-1]
    sigma[:, ends] = np.hypot(sigma[:, ends], along)
    return sigma


def _found(found) -> np.ndarray:
    """(S,) bool: the rod is a certified minimum, and the thread in the images."""
    return found.sound & (found.verdict != doo_ti.PerceptionVerdict.NOT_FOUND)


def _shown(options: Namespace, task: SeenRods, truth: np.ndarray | None, detected: list[list], found, growth: GrowthSteps,
           out: Path) -> list[Path]:
    """Draw and record the result beside ``out``; returns the files."""
    from doo_ti.report.figures import MOST_SETS, SeenRod, reprojections_picture

    rig, written = task.sets.rig, []
    there = np.flatnonzero(np.isfinite(found.vertices).all(axis=(1, 2)))

    def seen(row: int):
        images = [read_image(path, camera) for path, camera in zip(task.sets.paths[row], rig.cameras, strict=True)]
        marks = [detection.points for detection in detected[row]]
        rival, next_best = None, "no other rod"
        if np.isfinite(found.gap[row]):
            rival, next_best = found.runner_up[row, 0], f"next best {found.gap[row]:.2g} px worse"
        return SeenRod(task.sets.names[row], images, marks, found.configuration.vertices[row], rival,
                       None if truth is None else truth[row], f"{_word(found.verdict[row])}, {next_best}")

    if len(there) and not options.no_picture:
        picture = out.with_suffix(".png")
        rods = [seen(row) for row in there[:MOST_SETS]]
        reprojections_picture(picture, rig, rods, up=task.up, left_out=task.sets.count - len(rods))
        written.append(picture)
    rows = [] if options.no_recording else there[there < options.recorded]
    if len(rows) and can_record():
        from doo_ti.record.images import record_perception

        recording = out.with_suffix(".rrd")
        record_perception(recording, run_id=f"perceive {out.name}", name=out.stem, rig=rig, rods=[seen(row) for row in rows],
                          growth=[growth.of(row, task.sets.point[row], task.rest_length) for row in rows], up=task.up)
        written.append(recording)
    return written


def _summary(task: SeenRods, truth: np.ndarray | None, detected: list[list], found, failed: dict[int, InputError],
             written: list[Path]) -> dict:
    """The content of ``--json``, from which the lines of text are made."""
    error = None
    if truth is not None and truth.shape[1] == found.vertices.shape[1]:  # distances to the true rods' marks
        error = np.linalg.norm(found.vertices - truth, axis=-1)
    sets = [{
        "name": name, "length_mm": task.rest_length.sum(), "status": Status(found.status[row]).name.lower(),
        **{name: getattr(found, name)[row] for name in ("stable", "energy_vis", "coverage", "outside", "hidden", *MISREAD)},
        "camera_error_px": found.camera_error[row], "gap_px": found.gap[row], "verdict": _word(found.verdict[row]),
        "doubts": [doubt for doubt, rows in found.doubts.items() if rows[row]],
        "thread_length_mm": found.thread_length[row], "left_over_mm": found.left_over[row], "beyond_mm": found.beyond[row],
        "length_range_mm": found.length_range[row], "bounded": task.length_bounds.limits(task.rest_length),
        "unsupported_edges": found.unsupported[row].sum(), "unsupported_mm": task.rest_length[found.unsupported[row]].sum(),
        "mean_sigma_mm": found.sigma[row].mean() if found.sound[row] else None,
        **({} if error is None else {"mean_error_mm": error[row].mean(), "largest_error_mm": error[row].max()}),
        "failed": str(failed[row]) if row in failed else None,
    } for row, name in enumerate(task.sets.names)]
    return {
        "sets": sets, "cameras": task.sets.rig.names, "edges": len(task.rest_length),
        "detected_width_px": np.median([detection.width_px for line in detected for detection in line]),
        "status": status_counts(found.status), "stable": found.stable.sum(),
        "not_certified": (~found.sound).sum(), "found": _found(found).sum(),
        "verdicts": {_word(verdict): (found.verdict == verdict).sum() for verdict in doo_ti.PerceptionVerdict},
        "guessed_bend_mm3": GUESSED_BEND if task.guessed else None,
        "orientation": image_options.orientation_note(
            (path for line in task.sets.paths for path in line), task.sets.rig.cameras[0].turned),
        "written": [str(path) for path in written],
    }


def _word(verdict: int) -> str:
    return doo_ti.PerceptionVerdict(verdict).name.lower().replace("_", " ")


def _lines(summary: dict) -> list[str]:
    sets = summary["sets"]
    width = max(len(entry["name"]) for entry in sets[:MOST_LISTED])
    guess = summary["guessed_bend_mm3"]
    listed = [f"  {entry['name']:<{width}}  {_set_text(entry, summary['cameras'])}" for entry in sets]
    return [
        f"{counted(len(sets), 'set')} of {len(summary['cameras'])} images, rods of {summary['edges']} edges, "
        f"{sets[0]['length_mm']:.4g} mm long; thread {summary['detected_width_px']:.1f} px wide",
        *results.shortened(listed, MOST_LISTED, "  and {} more, which --json lists"), *results.rows(
            ("status", f"{results.status_text(summary['status'])}; {summary['stable']} certified stable"),
            ("verdicts", f"{results.status_text(summary['verdicts'])} (docs/commands/perceive.md)"),
            ("one camera", len(summary["cameras"]) == 1 and "it shows no depth: only the rod's length and stiffness say it"),
            ("stiffness", guess and f"none given: bend {guess:g} mm³ (docs/commands/perceive.md)"),
            ("orientation", summary["orientation"]))]


def _set_text(entry: dict, cameras: tuple[str, ...]) -> str:
    """One set of images of the ``cameras`` as text."""
    if entry["failed"] is not None:
        return f"no rod: {entry['failed']}"
    seen, length = np.isfinite(entry["camera_error_px"]), entry["length_mm"]
    pixels = " ".join(f"{value:.2f}" if one else "unseen" for value, one in zip(entry["camera_error_px"], seen, strict=True))
    rival = f"gap {entry['gap_px']:.2g} px" if np.isfinite(entry["gap_px"]) else "no rival"
    parts = [f"E_vis {entry['energy_vis']:.3g}/mm", pixels + " px off" * bool(seen.any()), f"{entry['verdict']} ({rival})",
             "σ unknown" if entry["mean_sigma_mm"] is None else f"σ {entry['mean_sigma_mm']:.2g} mm"]
    if np.isfinite(entry["coverage"]).all():
        parts.append(f"explains {100 * min(entry['coverage']):.0f} % of the thread")
    parts += [f"not clear: {', '.join(entry['doubts'])}"] * (entry["verdict"] in ("likely", "ambiguous"))
    parts += [words.format(max(entry[name])) for name, words in MISREAD.items() if max(entry[name]) > 1]
    if max(entry["outside"]) > OUTSIDE:
        parts.append(f"{100 * max(entry['outside']):.0f} % of the thread outside the other images, not seen there")
    parts += [f"{100 * share:.0f} % of the rod hidden from {name}" for name, share in zip(cameras, entry["hidden"], strict=True)
              if share > OUTSIDE]
    if np.isfinite(entry["length_range_mm"]).all():
        parts.append("length found, {:.4g} to {:.4g} mm".format(*entry["length_range_mm"]) + " at a bound" * entry["bounded"])
    if abs(entry["thread_length_mm"] / length - 1) > LEFT_OVER:
        parts.append(f"the thread is {entry['thread_length_mm']:.4g} mm long")
    if entry["left_over_mm"] > LEFT_OVER * length:
        parts.append(f"{entry['left_over_mm']:.3g} mm of thread left over")
    parts += [f"the thread may go on beyond the rod's {end} by {more:.3g} mm, {100 * more / (more + length):.0f} % of it"
              for more, end in zip(entry["beyond_mm"], ("start", "end"), strict=True) if more > LEFT_OVER * length]
    if entry["unsupported_edges"]:
        parts.append(f"{entry['unsupported_mm']:.3g} mm of rod unseen")
    if entry["status"] != "converged" or not entry["stable"]:
        parts.append(f"{entry['status'].replace('_', ' ')}{', not certified' * (not entry['stable'])}")
    if "mean_error_mm" in entry:
        parts.append(f"error {entry['mean_error_mm']:.3f} mm, at most {entry['largest_error_mm']:.2f}")
    return "; ".join(parts)
