"""The tasks of `doo-ti perceive` and `doo-ti track`: their options and files, checked before any image is read."""

import os
from argparse import Namespace
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from doo_ti.commands import image_options, loading
from doo_ti.commands import options as given
from doo_ti.commands.loading import MOST_EDGES, read_rest_length
from doo_ti.contact.surroundings import Surroundings
from doo_ti.io.arrays import read_npz
from doo_ti.io.csv_table import read_csv
from doo_ti.io.observation_files import load_observations
from doo_ti.rod.types import Clamp, Clamps, Material
from doo_ti.system.errors import InputError
from doo_ti.system.files import read_content
from doo_ti.system.terminal import in_line

MOST_HYPOTHESES = 100_000
RECORDED = 3
"""Sets in a recording."""
EDGES = 33
"""Of a rod whose edges are not given."""
GUESSED_BEND = 1e6
"""mm³, of a rod in images whose stiffness is not given: E_vis takes the rod's energy relative to its stiffness, so that only
its weight and twist against its bending depend on it."""


@dataclass(frozen=True)
class Extent:
    """How long a rod may be whose rest lengths are not given: mm, and mm of its edges, or None for EDGES of them."""

    least: float = 0.0
    most: float = np.inf
    edge: float | None = None

    def rest_length(self, thread: float) -> np.ndarray:
        """(E,) mm of a rod along a thread of that length."""
        length = float(np.clip(thread, self.least, self.most))
        edges = EDGES if self.edge is None else int(np.clip(round(length / self.edge), 4, MOST_EDGES))
        return np.full(edges, length / edges)


@dataclass(frozen=True)
class PerceptionTask:
    """The inputs of a perception, checked as far as possible before images are read."""

    sets: object  # ImageSets
    rest_length: np.ndarray | None
    extent: Extent
    material: Material
    search: object  # PerceptionOptions
    sight: object  # Sight
    up: np.ndarray
    truth: np.ndarray | None
    recorded: int
    surroundings: Surroundings
    guessed: bool  # the stiffness is not given


def perception_task(options: Namespace) -> PerceptionTask:
    """Raises InputError naming the option or file at fault."""
    guessed = options.theta is None and all(getattr(options, name) is None for name in given.MATERIAL)
    if guessed:
        options.bend = repr(GUESSED_BEND)
    grid, up = given.round_cell(options, "perceived"), given.world_up(options)
    rest_length = None if options.rest_length is None else read_rest_length(options.rest_length)
    nu = given.positive("--nu", options.nu)
    hypotheses = given.whole("--hypotheses", options.hypotheses, 1, MOST_HYPOTHESES)
    recorded = given.whole("--recorded-sets", options.recorded, 1)
    surroundings = given.surroundings(options)

    sets = _sets(options, image_options.rig(options))
    if rest_length is not None and sets.direction is not None:
        sets.rig.check_sight(sets.point + rest_length.min() * sets.direction, "the first edge")
    truth = _truth(options, sets.names)

    from doo_ti.perception.perceive import PerceptionOptions

    chosen = {"nu": nu, "hypotheses": hypotheses, "evidence": options.evidence}
    search = PerceptionOptions(**{name: value for name, value in chosen.items() if value is not None})
    return PerceptionTask(sets, rest_length, _extent(options), grid.materials(), search,
                          image_options.sight(options, sets, options.detector), up, truth,
                          0 if options.no_recording else recorded or RECORDED, surroundings, guessed)


@dataclass(frozen=True)
class TrackingTask:
    """The inputs of tracking: T frames with a seed for each, and the T − 1 motions of the far clamp between them, if known."""

    frames: object  # ImageSets
    time: np.ndarray | None
    rest_length: np.ndarray
    material: Material
    sight: object  # Sight
    up: np.ndarray
    far: list | None  # of Motion
    surroundings: Surroundings


def tracking_task(options: Namespace) -> TrackingTask:
    """Raises InputError naming the option or file at fault."""
    grid, up = given.round_cell(options, "tracked"), given.world_up(options)
    rest_length = read_rest_length(options.rest_length)
    surroundings = given.surroundings(options)
    frames, time = load_frames(Path(options.frames), image_options.rig(options))
    frames.rig.check_sight(frames.point + rest_length.min() * frames.direction, "the first edge")
    far = None if options.motion is None else _far_motions(Path(options.motion), frames.count)
    sight = image_options.sight(options, frames)
    return TrackingTask(frames, time, rest_length, grid.materials(), sight, up, far, surroundings)


def _sets(options: Namespace, rig):
    """The sets of the file, or the one that the command line spells out."""
    from doo_ti.vision.detection.images import ImageSets, load_sets

    single = {"IMAGE": options.images, "--seed-point": options.seed_point, "--seed-direction": options.seed_direction,
              "--seed-pixel": options.seed_pixel}
    if options.sets is not None:
        both = next((name for name, value in single.items() if value), None)
        if both:
            raise InputError(given.SOURCE, both, "given beside --sets", "give either")
        return load_sets(options.sets, rig)
    if not options.images:
        raise InputError(given.SOURCE, "IMAGE", "missing", "give --sets, or images with a seed")
    if bool(options.seed_point) == bool(options.seed_pixel):
        both = "given beside --seed-pixel" if options.seed_pixel else "missing"
        raise InputError(given.SOURCE, "--seed-point", both, "give --seed-point, or --seed-pixel: where the rod begins")
    if len(options.images) != len(rig.cameras):
        raise InputError(given.SOURCE, "IMAGE", f"{len(options.images)} images, but the rig has {len(rig.cameras)} cameras",
                         f"give one of each, in this order: {', '.join(rig.names)}")
    seed = {}
    for name in ("--seed-point", "--seed-direction"):
        if not single[name]:
            seed[name] = None
            continue
        numbers = given.numbers(name, single[name])
        if len(numbers) != 3:
            raise InputError(given.SOURCE, name, f"{len(numbers)} numbers", "give X,Y,Z")
        seed[name] = np.array([numbers])
    paths = tuple(Path(image) for image in options.images)
    return ImageSets((in_line(paths[0].stem),), (paths,), rig, seed["--seed-point"], seed["--seed-direction"], given.SOURCE,
                     (_clicks(options, rig),))


def _extent(options: Namespace) -> Extent:
    """What ``--edge`` and ``--length`` say."""
    edge, bounds = given.length("--edge", options.edge), (0.0, np.inf)
    if options.rest_length is not None:
        given.refuse(options, ("edge", "length"), "given beside --rest-length", "give the one or the other")
    if options.length is not None:
        low, colon, high = options.length.partition(":")
        bounds = given.length("--length", low), given.length("--length", high if colon else low)
        if bounds[0] > bounds[1]:
            raise InputError(given.SOURCE, "--length", options.length, "give MM, or LOW:HIGH")
    return Extent(*bounds, edge)


def _clicks(options: Namespace, rig) -> dict[int, tuple[float, float]]:
    """The pixels of ``--seed-pixel`` by the numbers of their cameras."""
    pixels = image_options.by_camera("--seed-pixel", options.seed_pixel, rig.names, "U,V")
    return {rig.names.index(camera): pixel for camera, pixel in pixels.items()}


def _truth(options: Namespace, names: tuple[str, ...]) -> np.ndarray | None:
    """(A, V, 3) mm: the rods of ``--truth`` by the sets' names, or in order where it has no names; None without one."""
    path = options.truth
    if path is None:
        given.refuse(options, loading.OF_FILES, "given without --truth", "give both")
        return None
    vertices = load_observations(path, None, options.unit, loading.columns(options)).vertices
    named = read_npz(Path(path), read_content(Path(path)), ("name", "names")) if Path(path).suffix == ".npz" else {}
    known = next(iter(named.values()), None)
    if known is None:
        if len(vertices) != len(names):
            raise InputError(path, "vertices_mm", f"{len(vertices)} rods for {len(names)} sets", "give one for each set")
        return vertices
    if known.shape != (len(vertices),):
        raise InputError(path, "name", f"shape {known.shape} for {len(vertices)} rods", "give one name for each")
    row = {str(name): index for index, name in enumerate(known)}
    missing = next((name for name in names if name not in row), None)
    if missing is not None:
        raise InputError(path, "name", f"no rod is called {missing!r}", "name rods as the sets")
    return vertices[[row[name] for name in names]]


def load_frames(path: Path, rig):
    """(ImageSets of the frames in their order, (T,) s or None). Frames without a seed keep the one before.

    Raises InputError naming line and column for whatever is missing or not a number, and for missing images.
    """
    from doo_ti.vision.detection.images import SEED, ImageSets, cameras_in, images_in

    table = read_csv(path, ("frame", *SEED), form=f"frame, one per camera, {', '.join(SEED)}", short_lines=True)
    cameras = cameras_in(table, rig, ("frame", "time_s", *SEED))
    paths = images_in(table, cameras)
    for camera, name in enumerate(cameras):
        table.refuse(name, np.array([not os.path.isfile(images[camera]) for images in paths]), "is not a file",
                     "name an image, relative to this file")
    seeded = np.array([row == 0 or any(table.columns[key][row] for key in SEED) for row in range(table.count)])
    seeds = np.stack([table.rows(seeded).numbers(key) for key in SEED], axis=-1)[np.cumsum(seeded) - 1]
    time = table.numbers("time_s") if "time_s" in table.columns else None
    if time is not None and not (np.diff(time) > 0).all():
        raise InputError(path, "time_s", "does not rise", "give frames in their order")
    return ImageSets(tuple(table.columns["frame"]), paths, rig.only(cameras) if cameras else rig, seeds[:, :3], seeds[:, 3:],
                     str(path)), time


def _far_motions(path: Path, frames: int) -> list:
    """The far clamp's motion from each frame to the next, tangents only."""
    from doo_ti.io.motion_file import load_path
    from doo_ti.motion.path import motion_between

    motion = load_path(path)
    if motion.moments != frames or motion.count > 1:
        raise InputError(path, "time_s", f"{motion.count} motions of {motion.moments} moments for {frames} frames",
                         "give one motion, a moment for each frame")
    origin, frame = np.zeros((1, 3)), np.eye(3)[None]
    rests = Clamps(Clamp.TANGENT, Clamp.TANGENT, origin, origin, frame, frame)
    return [motion_between(motion.at(moment, rests), motion.at(moment + 1, rests)) for moment in range(frames - 1)]
