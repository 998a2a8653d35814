"""A rod through a video (§III-D, §IV-A)."""

import os
from argparse import Namespace
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from doo_ti.commands import image_options
from doo_ti.commands import options as given
from doo_ti.commands.perceive import LEAST_SIGMA_MM
from doo_ti.commands.results import RODS, report, save_arrays
from doo_ti.commands.seen_rods import TrackingTask, tracking_task
from doo_ti.system.errors import InputError, InterruptedRunError
from doo_ti.system.terminal import can_record, in_line, progress

AHEAD = 16
"""Frames whose thread is detected while one is tracked."""
MOST_LISTED = 30
LEAST_SHOWN = 0.01
"""px: smaller errors are less than the noise of the smoothed images."""


def declare(add) -> None:
    parser = given.command(add, "track", run, "follow a rod through a video")
    image_options.add_seen_rod(parser)
    parser.add_argument("--frames", required=True, metavar="FRAMES.csv",
                        help="columns frame, one of images per camera, time_s (optional), and the seed: seed_x … dir_z")
    parser.add_argument("--out", required=True, metavar="F.npz|F.csv", help="file to write; F.rrd is written beside it")
    given.add_material(parser, "one number each; tracked rods are round", round_rod=True)
    parser.add_argument("--motion", metavar="PATH", help="poses of the far clamp, one moment for each frame: .npz or .csv")
    image_options.add_thread(parser)
    given.add_obstacles(parser, "without friction; the first run compiles for minutes")
    parser.add_argument("--no-recording", action="store_true", help="do not write F.rrd")


def run(options: Namespace, words: list[str]) -> int:
    """Track the rod from frame to frame; writes it, and prints where it was lost and found again."""
    out = given.output_file(options.out, RODS)
    for source in filter(None, (options.frames, options.motion, options.rest_length)):
        given.refuse_overwriting(out, source)
    task = tracking_task(options)
    found, problem = _tracked(task)
    result = _arrays(task, found)
    save_arrays(out, result)
    if problem is not None:
        raise InterruptedRunError(f"{problem}; {len(found)} of {task.frames.count} frames are kept in {out}; the same command "
                                  "starts from the first frame; or track the other frames as a video of their own, with the "
                                  "seed in its first line")
    written = [out]
    if not options.no_recording and can_record():
        from doo_ti.record import record_track

        written.append(out.with_suffix(".rrd"))
        record_track(written[-1], run_id=f"track {out.name}", name=out.stem, rig=task.frames.rig, paths=task.frames.paths,
                     vertices=result["vertices_mm"], error=result["camera_error_px"], how=result["how"], up=task.up)
    summary = _summary(task, result, written)
    report(options, summary, lambda: _lines(summary))
    return 0 if np.isfinite(result["energy_vis"]).any() else 1


def _tracked(task: TrackingTask) -> tuple[list, str | None]:
    """(Tracked frames, the error that ended tracking, or None). An error before the first frame is raised."""
    from doo_ti.perception.tracking import Tracker

    frames, found = task.frames, []
    tracker = Tracker(frames.rig, task.rest_length, task.material, up=task.up, surroundings=task.surroundings)
    try:
        with progress() as bar:
            shown = bar.add_task("tracking", total=frames.count, unit="frames")
            for row, detected in enumerate(_detected(task)):
                far = None if task.far is None or row == 0 else task.far[row - 1]
                found.append(tracker.see(detected, frames.point[row], frames.direction[row], far))
                bar.advance(shown)
    except (InputError, OSError, KeyboardInterrupt) as problem:
        if not found:
            raise
        return found, str(problem) or "interrupted"
    return found, None


def _detected(task: TrackingTask) -> Iterator[list]:
    """C detections of each frame, found while others are tracked."""
    cameras = task.frames.rig.cameras
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        def detections_of(row: int) -> list:
            return [threads.submit(task.sight.detected, path, camera)
                    for path, camera in zip(task.frames.paths[row], cameras, strict=True)]

        waiting = [detections_of(row) for row in range(min(AHEAD, task.frames.count))]
        try:
            for row in range(task.frames.count):
                yield [image.result() for image in waiting.pop(0)]
                if row + AHEAD < task.frames.count:
                    waiting.append(detections_of(row + AHEAD))
        finally:
            threads.shutdown(cancel_futures=True)


def _arrays(task: TrackingTask, found: list) -> dict[str, np.ndarray]:
    """The arrays of the file; docs/commands/track.md."""
    fields = {"vertices_mm": "vertices", "energy_vis": "energy_vis", "camera_error_px": "camera_error", "status": "status",
            "stable": "stable", "how": "how"}
    time = {} if task.time is None else {"time_s": task.time[: len(found)]}
    return {
        "name": np.array(task.frames.names[: len(found)]), **time, "rest_length_mm": task.rest_length, "up": task.up,
        **{key: np.array([getattr(frame, name) for frame in found]) for key, name in fields.items()},
        "sigma_mm": np.maximum([frame.sigma for frame in found], LEAST_SIGMA_MM),
    }


def _summary(task: TrackingTask, result: dict, written: list[Path]) -> dict:
    from doo_ti.perception.tracking import How

    how, error = result["how"], result["camera_error_px"]
    return {
        "frames": len(how), "cameras": task.frames.rig.names, "edges": len(task.rest_length),
        **{each.name.lower(): result["name"][how == each] for each in How},
        "stable": result["stable"].sum(),
        "camera_error_px": error[np.isfinite(error)].mean() if (how < How.LOST).any() else None,
        "orientation": image_options.orientation_note(
            (path for line in task.frames.paths for path in line), task.frames.rig.cameras[0].turned),
        "written": [str(path) for path in written],
    }


def _lines(summary: dict) -> list[str]:
    lines = [f"{summary['frames']} frames of {len(summary['cameras'])} images, a rod of {summary['edges']} edges",
             f"  tracked     {len(summary['tracked'])} frames, each from the one before"]
    for key, words in (("seeded", "by Algorithm 1"), ("lost", "in which the rod is lost")):
        names = summary[key]
        listed = ", ".join(names[:MOST_LISTED]) + f" and {len(names) - MOST_LISTED} more" * (len(names) > MOST_LISTED)
        lines.append(f"  {key:<11} {len(names)} frame{'s' * (len(names) != 1)} {words}{': ' * bool(len(names))}{listed}")
    if summary["camera_error_px"] is not None:
        off = summary["camera_error_px"]
        lines.append(f"  images      {f'{off:.2f}' if off >= LEAST_SHOWN else f'less than {LEAST_SHOWN}'} px off on average; "
                     f"{summary['stable']} rods certified stable")
    if summary["orientation"]:
        lines.append(f"  orientation {summary['orientation']}")
    return lines + [f"  written to  {in_line(path)}" for path in summary["written"]]
