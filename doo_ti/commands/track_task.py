"""What `doo-ti track` is given, checked before any image is looked at; FRAMES.csv."""

from argparse import Namespace
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from doo_ti import options as given
from doo_ti.commands.perceive_task import read_rest_length
from doo_ti.errors import InputError
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
    from doo_ti.vision.detection.images import SEED, ImageSets, header_and_lines, number_in

    header, lines = header_and_lines(path)
    missing = next((name for name in ("frame", *SEED) if name not in header), None)
    if missing or not lines:
        raise InputError(path, missing or "frame", "the column is missing" if missing else "no line",
                         f"give frame, a column per camera, and {', '.join(SEED)}, a line for each frame")
    unknown = next((name for name in header if name not in ("frame", "time_s", *SEED, *rig.names)), None)
    if unknown is not None:
        raise InputError(path, unknown, "no camera of the rig", f"the rig has {', '.join(rig.names)}")
    cameras, seeds, paths = [name for name in rig.names if name in header], [], []
    for number, line in enumerate(lines, 2):
        if not seeds or any(line[key] for key in SEED):
            seeds.append([number_in(path, number, line, key) for key in SEED])
        else:
            seeds.append(seeds[-1])
        paths.append(tuple(path.parent / line[name] for name in cameras))
        absent = next((name for name, image in zip(cameras, paths[-1], strict=True) if not image.is_file()), None)
        if absent is not None:
            raise InputError(path, f"line {number}, {absent}", f"{line[absent]!r} is no file", "name an image beside the file")
    time = None
    if "time_s" in header:
        time = np.array([number_in(path, number, line, "time_s") for number, line in enumerate(lines, 2)])
        if not (np.diff(time) > 0).all():
            raise InputError(path, "time_s", "does not rise", "give frames in their order")
    seeds = np.array(seeds)
    return ImageSets(tuple(line["frame"] for line in lines), tuple(paths), rig.only(cameras) if cameras else rig, seeds[:, :3],
                     seeds[:, 3:], str(path)), time


def _far_motions(path: Path, frames: int) -> list:
    """What the far clamp does from each frame to the next, tangents only."""
    from doo_ti.motion.path import motion_between
    from doo_ti.prediction.motion_file import load_path

    motion = load_path(path)
    if motion.moments != frames or motion.count > 1:
        raise InputError(path, "time_s", f"{motion.count} motions of {motion.moments} moments for {frames} frames",
                         "give one motion, a moment for each frame")
    origin, frame = np.zeros((1, 3)), np.eye(3)[None]
    rests = Clamps(Clamp.TANGENT, Clamp.TANGENT, origin, origin, frame, frame)
    return [motion_between(motion.at(moment, rests), motion.at(moment + 1, rests)) for moment in range(frames - 1)]
