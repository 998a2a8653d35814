"""A rod through a video (§III-D, §IV-A)."""

import os
from argparse import Namespace
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import doo_ti
from doo_ti.commands import doubts, given, image_options, results
from doo_ti.commands.image_options import SeenRods
from doo_ti.commands.perceive import LEAST_SIGMA_MM, sigma_with_length
from doo_ti.io.arrays import read_csv
from doo_ti.io.motion_file import load_path
from doo_ti.rod.types import Clamp, Clamps
from doo_ti.system.arguments import counted
from doo_ti.system.errors import InputError, InterruptedRunError, require
from doo_ti.system.terminal import can_record, in_line, progress, warn
from doo_ti.vision.images import SEED, SEEDS, ImageSets, cameras_in, clicks_in, images_in, seed_columns

if TYPE_CHECKING:
    from doo_ti.perception.seeds import WholeThreads

MOST_LISTED = 30
VIDEOS = (".avi", ".mkv", ".mov", ".mp4", ".mpg", ".webm")
LEAST_SHOWN = 0.01  # px: smaller errors are less than the noise of the smoothed images


def declare(add) -> None:
    parser = given.command(add, "track", run, "follow a rod through a video")
    image_options.add_seen_rod(parser)
    given.add(parser, "--frames", "FRAMES.csv", str, "columns frame, one of images per camera, time_s (optional), and where "
              "the rod begins: seed_x … dir_z, or CAMERA_u, CAMERA_v of a pixel, in the first frame and where it changes; or "
              "--seed-pixel", required=True)
    given.add_out(parser, "F.npz|F.csv", "file to write; F.rrd is written beside it")
    given.add_material(parser, image_options.ROUND, round_rod=True)
    given.add(parser, "--motion", "PATH", str, "poses of the far clamp, one moment for each frame: .npz or .csv")
    image_options.add_thread(parser)
    given.add_obstacles(parser, "without friction; the first run compiles for minutes")
    parser.add_argument("--no-recording", action="store_true", help="do not write F.rrd")


def run(options: Namespace) -> int:
    out = options.out
    results.refuse_overwriting(out, options.frames, options.motion, options.rest_length)
    task, time = image_options.seen_rods(options, "tracked", lambda rig: load_frames(
        Path(options.frames), rig, lambda rig: image_options.clicked(options, rig)))
    motions = None if options.motion is None else _far_motions(Path(options.motion), task.sets.count)
    rest_length, length_range, found, problem = _tracked(options, task, motions)
    doubts.warn_of_axes(options, task.sets.rig)
    image_options.warn_of_length(options, rest_length.sum())
    result = _arrays(task, time, rest_length, length_range, found)
    results.save_arrays(out, result)
    if problem is not None:
        raise InterruptedRunError(f"{problem}; {len(found)} of {task.sets.count} frames are kept in {out}; the same command "
                                  "starts from the first frame; or track the other frames as a video of their own, with the "
                                  "seed in its first line")
    written = [out]
    if not options.no_recording and can_record():
        from doo_ti.record.images import record_track

        written.append(out.with_suffix(".rrd"))
        record_track(written[-1], run_id=f"track {out.name}", name=out.stem, rig=task.sets.rig, paths=task.sets.paths,
                     vertices=result["vertices_mm"], error=result["camera_error_px"], how=result["how"], up=task.up)
    summary = _summary(task, found, result, written)
    results.report(options, summary, lambda: _lines(summary))
    return 0 if np.isfinite(result["energy_vis"]).any() else 1


def load_frames(path: Path, rig, clicks_of=lambda rig: {}):
    """(ImageSets of the frames in their order, (T,) s or None). Frames without a seed keep the one before; ``clicks_of`` a rig
    are pixels in the first frame by the numbers of its cameras. Raises InputError naming line and column for whatever is
    missing or not a number, and for missing images."""
    if path.suffix.lower() in VIDEOS:
        raise InputError(path, "file", "a video", "save its frames as images, and give a table that names them")
    form = f"frame, one per camera, and {SEEDS}"
    table = read_csv(path, ("frame",), form=form, short_lines=True)
    given_clicks = bool(clicks_of(rig))
    places = [*SEED, *(f"{name}_{axis}" for name in rig.names for axis in "uv")]
    if given_clicks and (beside := [name for name in places if name in table.columns]):
        raise InputError(given.SOURCE, "--seed-pixel", f"given, but {path} has the column {beside[0]}", "give either")
    clicked, seed = ([], ()) if given_clicks else seed_columns(table, rig, form)
    cameras = cameras_in(table, rig, ("frame", "time_s", *seed))
    paths = images_in(table, cameras)
    for camera, name in enumerate(cameras):
        table.refuse(name, np.array([not os.path.isfile(images[camera]) for images in paths]), "is not a file",
                     "name an image, relative to this file")
    time = table.numbers("time_s") if "time_s" in table.columns else None
    require(time is None or (np.diff(time) > 0).all(), path, "time_s", "does not rise", "give frames in their order")
    names, rig = tuple(table.columns["frame"]), rig.only(cameras) if cameras else rig
    if seed == SEED:
        seeded = np.array([row == 0 or any(table.columns[key][row] for key in SEED) for row in range(table.count)])
        seeds = np.stack([table.rows(seeded).numbers(key) for key in SEED], axis=-1)[np.cumsum(seeded) - 1]
        return ImageSets(names, paths, rig, seeds[:, :3], seeds[:, 3:], str(path)), time
    clicks = clicks_in(table, clicked, rig) if clicked else (clicks_of(rig), *({} for _ in names[1:]))
    if not clicks[0]:
        raise InputError(path, seed[0], "no pixel in the first frame", "give one where the rod begins")
    return ImageSets(names, paths, rig, None, None, str(path), clicks), time


def _far_motions(path: Path, frames: int) -> list:
    """The far clamp's motion from each frame to the next, tangents only."""
    from doo_ti.motion.path import motion_between

    motion = load_path(path)
    require(motion.moments == frames and motion.count == 1, path, "time_s", f"{motion.count} motions of {motion.moments} "
            f"moments for {frames} frames", "give one motion, a moment for each frame")
    origin, frame = np.zeros((1, 3)), np.eye(3)[None]
    rests = Clamps(Clamp.TANGENT, Clamp.TANGENT, origin, origin, frame, frame)
    return [motion_between(motion.at(moment, rests), motion.at(moment + 1, rests)) for moment in range(frames - 1)]


@dataclass(frozen=True)
class _Start:
    """Where the rod begins in a frame, mm, how uncertain that is, and in which direction."""

    point: np.ndarray
    covariance: np.ndarray  # (3, 3) mm²
    direction: np.ndarray


def _tracked(options: Namespace, task: SeenRods, motions: list | None) -> tuple[np.ndarray, np.ndarray, list, str | None]:
    """(E,) mm, (2,) mm between which their sum is, NaN where it is given, the tracked frames, and the error that ended
    tracking, or None. An error before the first frame is raised. ``motions`` are those of :func:`_far_motions`, if known."""
    from doo_ti.vision.synchronisation import epipolar_extremes

    frames, rest_length, known, problem = task.sets, task.rest_length, None, None
    found, starts, covariances, seen, extremes, length_range = [], [], [], [], [], np.full(2, np.nan)
    try:
        with progress() as bar:
            shown = bar.add_task("tracking", total=frames.count, unit="frames")
            for row, detected in enumerate(image_options.detections(task.sight, frames.paths, frames.rig.cameras)):
                extremes.append(epipolar_extremes(frames.rig, detected))
                start = starts[-1] if starts else None
                if frames.point is not None or frames.clicks[row]:
                    start, thread = _begun(task, row, detected, start, known)
                if row == 0:
                    if rest_length is None:
                        rest_length = task.length_bounds.rest_length(float(thread.length[0]))
                        length_range = task.length_bounds.range(float(thread.length[0]), thread.range[0])
                    tracker = doo_ti.Tracker(frames.rig, rest_length, task.material, up=task.up, surroundings=task.surroundings,
                                             length_range=length_range)
                far = None if motions is None or row == 0 else motions[row - 1]
                covariances.append(np.zeros((3, 3)) if frames.point is not None else
                                   start.covariance + _off_thread(frames.rig, detected, start.point) ** 2 * np.eye(3))
                frame = tracker.see(detected, start.point, start.direction, far, covariances[-1])
                if row == 0 and frame.verdict == doo_ti.PerceptionVerdict.NOT_FOUND:
                    image_options.warn_of_rig(options, frames, rest_length.sum(), np.array([frame.verdict]),
                                              frame.camera_error[None], [detected])
                known = start.point if frame.verdict <= doo_ti.PerceptionVerdict.LIKELY else known
                found.append(frame)
                starts.append(start)
                seen.append(None if frame.verdict == doo_ti.PerceptionVerdict.CLEAR else detected)
                bar.advance(shown)
            _look_back(tracker, found, seen, starts, covariances)
    except (InputError, OSError, KeyboardInterrupt) as error:
        if not found:
            raise
        problem = str(error) or "interrupted"
    _warn_of_instants(frames, np.array(extremes))
    return rest_length, length_range, found, problem


def _warn_of_instants(frames: ImageSets, extremes: np.ndarray) -> None:
    """Print a warning for each pair of cameras whose images were taken at different instants, by their
    :func:`epipolar_extremes`."""
    from doo_ti.vision.synchronisation import frames_apart

    for apart in frames_apart(extremes):
        (first, second), (same, shifted) = (frames.rig.names[camera] for camera in apart.cameras), apart.off
        shift = f"{abs(apart.frames):g} row{'s' * (abs(apart.frames) != 1)}"
        side = "later" if apart.frames > 0 else "earlier"
        warn(f"{frames.source}: images of {second} fit those of {first} better {shift} {side}, "
             f"{shifted:.2g} px off rather than {same:.2g}; give images of the same instant")


def _look_back(tracker, found: list, seen: list, starts: list[_Start], covariances: list[np.ndarray]) -> None:
    """Follow rods back into earlier frames in which they were not found, or fit worse than in the next: the first frames of a
    video, and those in which a rod was hidden. ``seen``: the detections of frames that are not clear; ``covariances``,
    (3, 3) mm², how uncertain their starts are."""
    for row in range(len(found) - 2, -1, -1):
        now, after = found[row], found[row + 1]
        likely = after.verdict <= doo_ti.PerceptionVerdict.LIKELY
        worse = likely if now.how == doo_ti.How.LOST else now.verdict > after.verdict or now.energy_vis > after.energy_vis
        if worse and seen[row] is not None:
            found[row] = tracker.revised(now, after, seen[row], starts[row].point, starts[row].direction,
                                         covariances[row])


def _off_thread(rig, detected: list, point: np.ndarray) -> float:
    """mm by which ``point`` (3,) is off the detected thread in two cameras or more; zero where these show none."""
    off = [np.linalg.norm(found.points - camera.project(point), axis=1).min(initial=np.inf) * camera.depth(point)
           / camera.lens[:2].mean() for camera, found in zip(rig.cameras, detected, strict=True)]
    second = float(np.sort(off)[min(2, len(off)) - 1])
    return second if np.isfinite(second) else 0.0


def _begun(task: SeenRods, row: int, detected: list, before: _Start | None, known: np.ndarray | None
           ) -> tuple[_Start, "WholeThreads | None"]:
    """The start of a frame, and the thread from there on; None where that need not be known. Where nothing was
    detected at a click it is that of the frame ``before``; else it is near the last one ``known`` to be right. Raises
    InputError where no thread can be followed."""
    from doo_ti.perception.seeds import seed_from_pixels, whole_threads

    frames, direction, covariance = task.sets, None, np.zeros((3, 3))
    source = f"{frames.source}: {in_line(frames.names[row])}"
    if frames.point is None:
        try:
            seed = seed_from_pixels(frames.rig, detected, frames.clicks[row], source, known)
        except InputError as error:
            if before is None:
                raise
            warn(f"{source}: {error.problem}; the start of the frame before is taken")
            return before, None
        point, covariance = seed.point, seed.covariance
    else:
        point, direction = frames.point[row], frames.direction[row : row + 1]
        if row or task.rest_length is not None:
            return _Start(point, covariance, direction[0]), None
    thread = whole_threads(frames.rig, [detected], point[None], direction, task.material, task.up)
    if np.isnan(thread.length[0]):
        if before is not None:
            return before, None
        raise InputError(source, "seed", "no thread can be followed from it", "give another, or --rest-length")
    return _Start(point, covariance, thread.direction[0]), thread


def _arrays(task: SeenRods, time: np.ndarray | None, rest_length: np.ndarray, length_range: np.ndarray, found: list
            ) -> dict[str, np.ndarray]:
    """The arrays of the file; docs/commands/track.md. ``time`` (T,) s of the frames, if known."""
    fields = {"vertices_mm": "vertices", "energy_vis": "energy_vis", "camera_error_px": "camera_error", "status": "status",
            "stable": "stable", "how": "how", "verdict": "verdict"}
    time = {} if time is None else {"time_s": time[: len(found)]}
    sigma = sigma_with_length(np.array([frame.sigma for frame in found]), length_range[None], task.sets.point is None)
    return {
        "name": np.array(task.sets.names[: len(found)]), **time, "rest_length_mm": rest_length,
        "length_range_mm": length_range, "up": task.up,
        **{key: np.array([getattr(frame, name) for frame in found]) for key, name in fields.items()},
        "sigma_mm": np.maximum(sigma, LEAST_SIGMA_MM), "doubts": np.array([", ".join(frame.doubts) for frame in found]),
    }


def _summary(task: SeenRods, found: list, result: dict, written: list[Path]) -> dict:
    from doo_ti.perception.perceive import CERTAIN_MM

    start = np.array([frame.sigma[0] for frame in found])
    how, error, lengths = (result[name] for name in ("how", "camera_error_px", "rest_length_mm"))
    return {
        "frames": len(how), "cameras": task.sets.rig.names, "edges": len(lengths), "length_mm": lengths.sum(),
        "length_range_mm": result["length_range_mm"],
        **{each.name.lower(): result["name"][how == each] for each in doo_ti.How},
        "verdicts": {each.name.lower(): result["name"][(how < doo_ti.How.LOST) & (result["verdict"] == each)]
                     for each in doo_ti.PerceptionVerdict if each != doo_ti.PerceptionVerdict.NOT_FOUND},
        "doubts": dict(Counter(doubt for frame in found for doubt in frame.doubts)),
        "start_sigma_mm": np.nanmax(start, initial=0.0),
        "stable": result["stable"].sum(), "uncertain": result["name"][start > CERTAIN_MM],
        "camera_error_px": error[np.isfinite(error)].mean() if (how < doo_ti.How.LOST).any() else None,
        "orientation": image_options.orientation_note(
            (path for line in task.sets.paths for path in line), task.sets.rig.cameras[0].turned),
        "written": [str(path) for path in written],
    }


def _lines(summary: dict) -> list[str]:
    from doo_ti.perception.perceive import CERTAIN_MM

    def frames(names: np.ndarray, words: str, every: bool = False) -> str:
        """How many frames, and their ``names``, or "all" where they are ``every`` frame of the video."""
        named = f": {'all' if every else results.listed(names, MOST_LISTED)}" * bool(len(names))
        return f"{counted(len(names), 'frame')} {words}{named}"

    verdicts, reasons, uncertain, off = (summary[name] for name in ("verdicts", "doubts", "uncertain", "camera_error_px"))
    of_others = ", ".join(f"{doubt} in {count}" for doubt, count in sorted(reasons.items(), key=lambda one: -one[1]))
    return [
        f"{summary['frames']} frames of {len(summary['cameras'])} images, a rod of {summary['edges']} edges, "
        f"{summary['length_mm']:.4g} mm long" + ", found in the first frame, {:.4g} to {:.4g} mm".format(
            *summary["length_range_mm"]) * bool(np.isfinite(summary["length_range_mm"]).all()),
        *results.rows(
            ("tracked", f"{len(summary['tracked'])} frames, each from the one before or after"),
            ("seeded", frames(summary["seeded"], "by Algorithm 1")),
            ("lost", frames(summary["lost"], "in which the rod is lost")),
            ("uncertain", len(uncertain) and frames(
                uncertain, f"whose start is uncertain by {CERTAIN_MM:g} to {summary['start_sigma_mm']:.2g} mm, or off the "
                "thread; click there, in two cameras", every=len(uncertain) == summary["frames"])),
            ("ambiguous", len(verdicts["ambiguous"]) and frames(verdicts["ambiguous"], "whose rod may well be another one")),
            ("doubts", reasons and f"{len(verdicts['clear'])} frames are clear; of others: {of_others}"),
            ("images", off is not None and f"{f'{off:.2f}' if off >= LEAST_SHOWN else f'less than {LEAST_SHOWN}'} px off on "
                                           f"average; {summary['stable']} rods at certified minima of E_vis"),
            ("orientation", summary["orientation"]))]
