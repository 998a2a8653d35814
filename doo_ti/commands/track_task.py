"""What `doo-ti track` is given, checked before any image is looked at; FRAMES.csv."""

from argparse import Namespace
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from doo_ti.commands import options as given
from doo_ti.commands.perceive_task import read_rest_length
from doo_ti.errors import InputError
from doo_ti.io.csv_table import read_csv
from doo_ti.types import Clamp, Clamps, Material


@dataclass(frozen=True)
class Task:
    """What to track: T frames with a seed for each, and the T − 1 motions of the far clamp between them, if they are known."""

    frames: object  # ImageSets
    time: np.ndarray | None
    rest_length: np.ndarray
    material: Material
    detection: object  # DetectionOptions
    up: np.ndarray
    far: list | None  # of Motion


def checked_task(options: Namespace) -> Task:
    """Raises InputError naming the option or file at fault."""
    grid, up = given.round_cell(options, "tracked"), given.world_up(options)
    rest_length = read_rest_length(options.rest_length)
    width = given.positive("--width", options.width, "px")

    from doo_ti.vision.cameras.rig import load_rig
    from doo_ti.vision.detection.detect import DetectionOptions

    frames, time = load_frames(Path(options.frames), load_rig(options.rig))
    far = None if options.motion is None else _far_motions(Path(options.motion), frames.count)
    return Task(frames, time, rest_length, grid.materials(), DetectionOptions(polarity=options.polarity, width_px=width),
                up, far)


def load_frames(path: Path, rig):
    """(ImageSets of the frames in their order, (T,) s or None). Frames without a seed keep the one before.

    Raises InputError naming line and column for whatever is missing or no number, and for images that are not there.
    """
    from doo_ti.vision.detection.images import SEED, ImageSets, cameras_in, images_in

    table = read_csv(path, ("frame", *SEED), form=f"frame, one per camera, {', '.join(SEED)}", short_lines=True)
    cameras = cameras_in(table, rig, ("frame", "time_s", *SEED))
    paths = images_in(table, cameras)
    for camera, name in enumerate(cameras):
        table.refuse(name, np.array([not images[camera].is_file() for images in paths]), "is not a file",
                     "name an image, relative to this file")
    seeded = np.array([row == 0 or any(table.columns[key][row] for key in SEED) for row in range(table.count)])
    seeds = np.stack([table.rows(seeded).numbers(key) for key in SEED], axis=-1)[np.cumsum(seeded) - 1]
    time = table.numbers("time_s") if "time_s" in table.columns else None
    if time is not None and not (np.diff(time) > 0).all():
        raise InputError(path, "time_s", "does not rise", "give frames in their order")
    return ImageSets(tuple(table.columns["frame"]), paths, rig.only(cameras) if cameras else rig, seeds[:, :3], seeds[:, 3:],
                     str(path)), time


def _far_motions(path: Path, frames: int) -> list:
    """What the far clamp does from each frame to the next, tangents only."""
    from doo_ti.io.motion_file import load_path
    from doo_ti.motion.path import motion_between

    motion = load_path(path)
    if motion.moments != frames or motion.count > 1:
        raise InputError(path, "time_s", f"{motion.count} motions of {motion.moments} moments for {frames} frames",
                         "give one motion, a moment for each frame")
    origin, frame = np.zeros((1, 3)), np.eye(3)[None]
    rests = Clamps(Clamp.TANGENT, Clamp.TANGENT, origin, origin, frame, frame)
    return [motion_between(motion.at(moment, rests), motion.at(moment + 1, rests)) for moment in range(frames - 1)]
