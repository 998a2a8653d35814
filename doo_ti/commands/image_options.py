"""Options on cameras, their images, and how the rod looks in them, shared by commands; and the inputs of ``doo-ti perceive``,
checked before any image is read."""

import os
from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import permutations
from pathlib import Path

import numpy as np

import doo_ti
from doo_ti.commands import doubts, given, loading
from doo_ti.commands.loading import MOST_EDGES, read_rest_length
from doo_ti.contact.surroundings import Surroundings
from doo_ti.io.observation_files import load_observations
from doo_ti.io.toml_file import scene_file
from doo_ti.rod.material import UNITS_IN_MM, likely_unit
from doo_ti.rod.types import Material
from doo_ti.system.errors import InputError, require
from doo_ti.system.terminal import in_line, warn
from doo_ti.vision.cameras import LENSES, POSES, Rig, RigReading
from doo_ti.vision.images import ImageSets, load_sets, orientation_tags
from doo_ti.vision.rig_files import load_rig

MOST_HYPOTHESES = 100_000
FITTING_PX = 0.5  # the rig is taken to be right where a rod is this near to the line in every camera
MOST_ORDERED = 4  # cameras, of which all orders are tried
AHEAD = 16  # lines of images in which threads are detected while one is used
RECORDED = 3  # sets in a recording
EDGES, MOST_GUESSED, BOW = 33, 100, 1 / 2000
"""Of a rod whose edges are not given: the least and the largest number of them, and how far they may lie off the rod's bends,
over its length."""
ALIKE = 0.02  # lengths of one rod in several sets that agree differ by this share at least
CLICKED = "clicked"  # of --colour: that of the thread at the pixel where it begins
GUESSED_BEND = 1e6
"""mm³, of a rod in images whose stiffness is not given: E_vis takes the rod's energy relative to its stiffness, so that only
its weight and twist against its bending depend on it."""
ROUND = f"one number each; rods are round; without any, --bend {GUESSED_BEND:g}, which is near enough for most shapes"


def add_rig(parser: ArgumentParser) -> None:
    """The cameras, and what their file leaves open; :func:`rig` reads them."""
    given.add(parser, "--rig", "RIG", scene_file, "the calibrated cameras (docs/cameras.md): OpenCV FileStorage YAML, OpenCV's "
              "stereo file, or COLMAP's cameras.txt", required=True)
    units = ", ".join(UNITS_IN_MM)
    unit = given.either({name: name for name in UNITS_IN_MM}, given.positive(f"mm, or {units}"))
    given.add(parser, "--rig-unit", "UNIT", unit, f"unit of lengths in RIG, {units}, or how many mm it has: that of COLMAP is "
              "arbitrary (default mm)")
    parser.add_argument("--rig-poses", choices=tuple(POSES), help="what R and t in RIG are: world to camera, camera to world, "
                        "or R and the camera's centre; axes of OpenCV (z forward) or OpenGL (y up) (default opencv)")
    given.add(parser, "--rig-lens", None, LENSES, "model of the lenses in RIG", "opencv")
    given.add(parser, "--image-size", "WIDTH,HEIGHT", given.numbers("WIDTH,HEIGHT", given.FROM_ZERO), "size of the images, "
              "where RIG does not state it")
    add_orientation(parser, "RIG's, else ignore")


def add_orientation(parser: ArgumentParser, default: str) -> None:
    parser.add_argument("--orientation", choices=("ignore", "apply"), help="whether images are turned as their orientation "
                        f"tags say, or pixels are where the sensor has them (default: {default})")


def rig(options: Namespace) -> Rig:
    """The Rig of ``--rig``, as the other options say."""
    turned = None if options.orientation is None else options.orientation == "apply"
    return load_rig(options.rig, RigReading(options.rig_unit, options.rig_poses, options.rig_lens, turned, options.image_size))


def add_seen_rod(parser: ArgumentParser) -> None:
    """The cameras, and the known properties of the rod."""
    add_rig(parser)
    given.add(parser, "--rest-length", "MM:COUNT|FILE", str, "lengths of the rod's edges: COUNT edges of MM each, a .npz with "
              "rest_length_mm, or a text file (default: the rod ends where the thread ends in the images)")
    given.add(parser, "--edge", "MM", given.LENGTH, "without --rest-length: length of the rod's edges; without it, a 33rd of "
              "the rod")
    given.add(parser, "--length", "MM|LOW:HIGH", _bounds, "without --rest-length: bounds of the rod's length")
    parser.add_argument("--seed-pixel", action="append", metavar="CAMERA:U,V", help="where the rod begins, instead of "
                        "a point in space: a pixel in one camera or, once for each, in several; the thread's end near it")
    given.add_up(parser, "0,0,1 in the rig's world")


def add_thread(parser: ArgumentParser) -> None:
    """How the rod looks in images; ``parser`` may be a group of arguments."""
    parser.add_argument("--polarity", choices=("dark", "light"), help="whether the thread is darker or lighter than the "
                        "background (default: decided per image)")
    given.add(parser, "--width", "PX", given.positive("px"), "width of the thread in the images (default: measured)")
    given.add(parser, "--colour", "R,G,B|clicked", given.either({CLICKED: CLICKED}, given.NUMBERS), "colour of the thread, "
              "0 to 255 each, instead of --polarity; clicked: that of the thread at the pixel where it begins")
    parser.add_argument("--masks", nargs="+", metavar="MASK|FOLDER", help="segmented images, instead of detection: one for "
                        "each camera, or a folder with masks named as the images are (default: alpha channels of the images)")
    parser.add_argument("--region", action="append", metavar="CAMERA:X,Y,W,H",
                        help="part of a camera's images where the thread is; once for each camera")


def by_camera(option: str, texts: Iterable[str] | None, names: tuple[str, ...], form: str, each: given.Reader = given.NUMBERS
              ) -> dict[str, tuple]:
    """The numbers of an option that is given once for each camera, as ``CAMERA:`` and ``form``, by the camera's name."""
    found = {}
    for text in texts or ():
        camera, _, numbers = text.rpartition(":")
        values = each(option, numbers)
        require(camera in names and len(values) == form.count(",") + 1, given.SOURCE, option, f"{text!r}",
                f"give CAMERA:{form}; the rig has {', '.join(map(in_line, names))}")
        require(camera not in found, given.SOURCE, option, f"given twice for {in_line(camera)}", "give it once for each camera")
        found[camera] = values
    return found


def sight(options: Namespace, sets, method: str = "ridge"):
    """The Sight that :func:`add_thread` describes, of the images in ``sets``."""
    from doo_ti.vision.sight import Sight, mask_of

    regions = by_camera("--region", options.region, sets.rig.names, "X,Y,W,H", given.numbers(None, given.FROM_ZERO))
    for region in regions.values():
        doo_ti.DetectionOptions(region=region)
    masks = None if options.masks is None else [Path(mask) for mask in options.masks]
    if masks is not None and len(masks) == 1 and masks[0].is_dir():
        masks = masks[0]
        for images in sets.paths:
            files = [mask_of(masks, image) for image in images]
            if twice := next((file for file in files if files.count(file) > 1), None):
                raise InputError(masks, twice.stem, "the mask of several cameras' images of this name",
                                 "put masks into folders that are named as those of the images are")
    elif masks is not None:
        require(sets.count == 1 and len(masks) == len(sets.rig.cameras), given.SOURCE, "--masks", f"{len(masks)} for "
                f"{sets.count} sets of {len(sets.rig.cameras)} images", "give one for each camera of a single set, or a folder")
        masks = dict(zip(sets.rig.names, masks, strict=True))
    clicked = options.colour == CLICKED
    if clicked and sets.clicks is None:
        raise InputError(given.SOURCE, "--colour", "clicked, and no pixel is", "give --seed-pixel, or a colour")
    colour, stated = None if clicked else options.colour, [options.polarity, options.width, options.colour, masks]
    return Sight(doo_ti.DetectionOptions(method, options.polarity, options.width, colour=colour), regions, masks,
                 sets.clicks if clicked or stated == [None] * 4 else None, clicked)


def detections(sight, every_path: Sequence[Sequence[Path]], cameras: Sequence, failed: dict | None = None) -> Iterator[list]:
    """Of each line of one image per camera its detections by the Sight ``sight``, found while others are used. Lines without a
    click are sought as the last one that had any. Errors of clicks are raised, or added to ``failed`` by the line's number."""
    latest = sight
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        def begun(row: int) -> tuple:
            nonlocal latest
            known = {}
            if sight.clicks is not None and sight.clicks[row]:
                try:
                    latest, known = sight.of_set(row, every_path[row], cameras)
                except InputError as error:  # images that are wrong themselves are refused below
                    if failed is None:
                        raise
                    failed[row] = error
            return latest, [threads.submit(known.get, k) if k in known else threads.submit(latest.detected, path, camera)
                            for k, (path, camera) in enumerate(zip(every_path[row], cameras, strict=True))]

        waiting = [begun(row) for row in range(min(AHEAD, len(every_path)))]
        try:
            for row in range(len(every_path)):
                own, images = waiting.pop(0)
                found = [image.result() for image in images]
                # Images that show nothing that looks as where it was clicked are searched as others.
                found = [one if one.count or own is sight else sight.detected(path, camera)
                         for one, path, camera in zip(found, every_path[row], cameras, strict=True)]
                yield own.agreed(found, row, every_path[row], cameras)
                if row + AHEAD < len(every_path):
                    waiting.append(begun(row + AHEAD))
        finally:
            threads.shutdown(cancel_futures=True)


def warn_of_length(options: Namespace, length: float) -> None:
    """Print a warning where rods of ``length`` mm are so short or long that the rig's unit must be another one."""
    doubts.say(options.rig, doubts.unit_doubt(length, "rig", "--rig-unit", "--rig-unit and --rig-poses"))


def warn_of_rig(options: Namespace, sets, length: float, verdicts: np.ndarray, camera_error: np.ndarray,
                detected: Sequence[list]) -> None:
    """Print a warning where found rods of ``length`` mm are in another unit, and, where none is clear nor near to the line in
    every camera, by its ``camera_error`` (A, C) px, if the lines ``detected`` in the first clicked set fit together much better
    with the rig's file read otherwise, by options that were not given, or as images of the cameras in another order."""
    from doo_ti.perception.seeds import fit_better

    verdict = doo_ti.PerceptionVerdict
    if likely_unit(length) or (verdicts != verdict.NOT_FOUND).any():  # of what is not found a unit explains some
        warn_of_length(options, length)
    fitting = (verdicts == verdict.CLEAR) | (camera_error <= FITTING_PX).all(axis=1)
    if sets.clicks is None or fitting.any():
        return
    others = {f"with {option}": other for other, _, option in sets.rig.read_otherwise() if other.reading.unit is None}
    orders = permutations(range(len(sets.rig.cameras))) if len(sets.rig.cameras) <= MOST_ORDERED else ()
    others |= {f"as those of {', '.join(sets.rig.names[k] for k in order)}": sets.rig.take(order)
               for order in orders if list(order) != sorted(order)}
    try:
        fisheye = load_rig(options.rig, replace(sets.rig.reading, lens="fisheye"))
        others["with --rig-lens fisheye"] = fisheye.only(sets.rig.names)
    except InputError:
        pass  # a file that states another lens
    better = fit_better(sets.rig, others, detected[0], sets.clicks[0])
    if better:
        warn(f"{in_line(options.rig)}: the images fit together better {' or '.join(better)}; change that if it is so")


def orientation_note(paths: Iterable[Path], turned: bool) -> str | None:
    """What to say of images with orientation tags; None where there are none."""
    count = orientation_tags(paths)
    did, other = ("applied", "ignore") if turned else ("ignored", "apply")
    return f"{count} images have tags, which are {did}; else --orientation {other}" if count else None


# --- perceive ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class LengthBounds:
    """How long a rod may be whose rest lengths are not given: mm, and mm of its edges, or None for as many as it needs."""

    least: float = 0.0
    most: float = np.inf
    edge: float | None = None

    def rest_length(self, thread: float, turn: float = 0.0) -> np.ndarray:
        """(E,) mm of a rod along a thread of that length, whose direction turns by ``turn`` rad along it."""
        length = float(np.clip(thread, self.least, self.most))
        if self.edge is None:  # arcs of the angle a lie off their chords by a/8 of these
            edges = int(np.clip(np.ceil(np.sqrt(turn / (8 * BOW))), EDGES, MOST_GUESSED))
        else:
            edges = int(np.clip(round(length / self.edge), 4, MOST_EDGES))
        return np.full(edges, length / edges)

    def range(self, thread: float, found: np.ndarray) -> np.ndarray:
        """(2,) mm between which a rod along a thread of a length between ``found`` (2,) is: at a bound as uncertain."""
        return np.clip(np.clip(thread, self.least, self.most) + found - thread, self.least, self.most)

    def agreeing(self, lengths: np.ndarray) -> np.ndarray:
        """(A,) bool: which of the lengths (A,) mm of one rod in several sets, NaN where none was found, are like most others.
        Lines that go on along a clip, or end where something hides the thread, have any length: the closest half of those
        within the bounds, if any are, counts, and what is not three times as far from its middle."""
        seen, within = np.isfinite(lengths), (self.least <= lengths) & (lengths <= self.most)
        seen = within if within.any() else seen
        order = np.sort(lengths[seen])
        half = min(len(order), max(2, (len(order) + 1) // 2))
        first = int(np.argmin(order[half - 1 :] - order[: len(order) - half + 1]))
        least, most = order[[first, first + half - 1]]
        return seen & (np.abs(lengths - 0.5 * (least + most)) <= max(1.5 * (most - least), ALIKE * most))

    def limits(self, rest_length: np.ndarray) -> bool:
        """Whether rods are as long as one of the bounds."""
        return bool(np.isclose(rest_length.sum(), [self.least, self.most]).any())


@dataclass(frozen=True)
class SeenRods:
    """Rods in images, the options of :func:`add_seen_rod` and :func:`add_thread`, checked as far as possible before images are
    read."""

    sets: object  # ImageSets, of a video its frames
    rest_length: np.ndarray | None  # None: that of the thread in the images, within ``length_bounds``
    length_bounds: LengthBounds
    material: Material
    sight: object  # Sight
    up: np.ndarray
    surroundings: Surroundings
    guessed: bool  # the stiffness is not given: it is GUESSED_BEND


def seen_rods(options: Namespace, which: str, load: Callable[[Rig], tuple[ImageSets, object]], method: str = "ridge"
              ) -> tuple[SeenRods, object]:
    """The rods in the images that ``load`` finds, and what it finds beside them; ``which`` names the rods in messages. Raises
    InputError naming the option or file at fault."""
    guessed = options.theta is None and all(getattr(options, name) is None for name in given.MATERIAL)
    if guessed:
        options.bend = repr(GUESSED_BEND)
    grid, up = given.round_cell(options, which), given.world_up(options)
    rest_length = None if options.rest_length is None else read_rest_length(options.rest_length)
    surroundings = given.surroundings(options)
    sets, beside = load(rig(options))
    if rest_length is not None:
        given.refuse(options, ("edge", "length"), "given beside --rest-length", "give the one or the other")
        if sets.direction is not None:
            sets.rig.check_sight(sets.point + rest_length.min() * sets.direction, "the first edge")
    bounds = LengthBounds(*options.length or (0.0, np.inf), options.edge)
    seen = SeenRods(sets, rest_length, bounds, grid.materials(), sight(options, sets, method), up, surroundings, guessed)
    return seen, beside


def rods_of_sets(options: Namespace) -> tuple[SeenRods, np.ndarray | None]:
    """The rods of ``perceive``, and (A, V, 3) mm where they truly are, if ``--truth`` says so."""
    def load(rig: Rig) -> tuple[ImageSets, np.ndarray | None]:
        sets = _sets(options, rig)
        return sets, _truth(options, sets.names)

    return seen_rods(options, "perceived", load, options.detector)


def _sets(options: Namespace, rig):
    """The sets of the file, or the one that the command line spells out."""
    single = {"IMAGE": options.images, "--seed-point": options.seed_point, "--seed-direction": options.seed_direction,
              "--seed-pixel": options.seed_pixel}
    if options.sets is not None:
        both = next((name for name, value in single.items() if value), None)
        require(not both, given.SOURCE, both, "given beside --sets", "give either")
        return load_sets(options.sets, rig)
    require(options.images, given.SOURCE, "IMAGE", "missing", "give --sets, or images with a seed")
    if bool(options.seed_point) == bool(options.seed_pixel):
        both = "given beside --seed-pixel" if options.seed_pixel else "missing"
        raise InputError(given.SOURCE, "--seed-point", both, "give --seed-point, or --seed-pixel: where the rod begins")
    require(len(options.images) == len(rig.cameras), given.SOURCE, "IMAGE", f"{len(options.images)} images, but the rig has "
            f"{len(rig.cameras)} cameras", f"give one of each, in this order: {', '.join(rig.names)}")
    stems = tuple(Path(image).stem for image in options.images)
    if stems != rig.names and sorted(stems) == sorted(rig.names):
        raise InputError(given.SOURCE, "IMAGE", f"{', '.join(map(in_line, stems))} in another order than the rig's cameras",
                         f"give them in this order: {', '.join(rig.names)}")
    point, direction = (None if value is None else np.array([value])
                        for value in (options.seed_point, options.seed_direction))
    paths = tuple(Path(image) for image in options.images)
    clicks = clicked(options, rig)
    name = paths[0].absolute().parent.name if stems == rig.names else stems[0]  # a camera's name is none of a set
    return ImageSets((in_line(name),), (paths,), rig, point, direction, given.SOURCE, (clicks,) if clicks else None)


def clicked(options: Namespace, rig: Rig) -> dict[int, tuple[float, float]]:
    """The pixels of ``--seed-pixel`` by the numbers of their cameras in ``rig``."""
    return {rig.names.index(camera): pixel
            for camera, pixel in by_camera("--seed-pixel", options.seed_pixel, rig.names, "U,V").items()}


def _bounds(option: str, text: str) -> tuple[float, float]:
    """``300``, or ``250:350``, in mm."""
    low, colon, high = text.partition(":")
    bounds = given.LENGTH(option, low), given.LENGTH(option, high if colon else low)
    require(bounds[0] <= bounds[1], given.SOURCE, option, text, "give MM, or LOW:HIGH")
    return bounds


def _truth(options: Namespace, names: tuple[str, ...]) -> np.ndarray | None:
    """(A, V, 3) mm: the rods of ``--truth`` by the sets' names, or in order where it has no names; None without one."""
    path = options.truth
    if path is None:
        given.refuse(options, loading.OF_FILES, "given without --truth", "give both")
        return None
    true = load_observations(path, None, options.unit, options.columns)
    vertices = true.vertices
    if true.labels.dtype.kind != "U":
        if len(vertices) != len(names):
            raise InputError(path, "vertices_mm", f"{len(vertices)} rods for {len(names)} sets", "give one for each set")
        return vertices
    row = {str(name): index for index, name in enumerate(true.labels)}
    missing = next((name for name in names if name not in row), None)
    require(missing is None, path, "name", f"no rod is called {missing!r}", "name rods as the sets")
    return vertices[[row[name] for name in names]]
