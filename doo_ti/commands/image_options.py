"""Options on cameras, their images, and how the rod looks in them, shared by commands."""

from argparse import ArgumentParser, Namespace
from collections.abc import Iterable
from pathlib import Path

from doo_ti.commands import options as given
from doo_ti.io.toml_file import scene_file
from doo_ti.rod.physical_units import UNITS_IN_MM
from doo_ti.system.errors import InputError
from doo_ti.system.terminal import in_line
from doo_ti.vision.cameras.foreign import LENSES, POSES, RigReading
from doo_ti.vision.cameras.rig import Rig, load_rig


def add_rig(parser: ArgumentParser) -> None:
    """The cameras, and what their file leaves open; :func:`rig` reads them."""
    parser.add_argument("--rig", required=True, metavar="RIG", type=scene_file, help="the calibrated cameras "
                        "(docs/cameras.md): OpenCV FileStorage YAML, OpenCV's stereo file, or COLMAP's cameras.txt")
    parser.add_argument("--rig-unit", choices=tuple(UNITS_IN_MM), help="unit of lengths in RIG (default mm)")
    parser.add_argument("--rig-poses", choices=tuple(POSES), help="what R and t in RIG are: world to camera, camera to world, "
                        "or R and the camera's centre; axes of OpenCV (z forward) or OpenGL (y up) (default opencv)")
    parser.add_argument("--rig-lens", choices=LENSES, default="opencv", help="model of the lenses in RIG (default opencv)")
    parser.add_argument("--image-size", metavar="WIDTH,HEIGHT", help="size of the images, where RIG does not state it")
    add_orientation(parser, "RIG's, else ignore")


def add_orientation(parser: ArgumentParser, default: str) -> None:
    parser.add_argument("--orientation", choices=("ignore", "apply"), help="whether images are turned as their orientation "
                        f"tags say, or pixels are where the sensor has them (default: {default})")


def rig(options: Namespace) -> Rig:
    """The Rig of ``--rig``, as the other options say."""
    size = None
    if options.image_size is not None:
        size = tuple(int(side) for side in given.numbers("--image-size", options.image_size))
        if len(size) != 2:
            raise InputError(given.SOURCE, "--image-size", f"{len(size)} numbers", "give WIDTH,HEIGHT")
    turned = None if options.orientation is None else options.orientation == "apply"
    return load_rig(options.rig, RigReading(options.rig_unit, options.rig_poses, options.rig_lens, turned, size))


def add_seen_rod(parser: ArgumentParser, length_known: bool = True) -> None:
    """The cameras, and the known properties of the rod."""
    add_rig(parser)
    parser.add_argument("--rest-length", required=length_known, metavar="MM:COUNT|FILE",
                        help="lengths of the rod's edges: COUNT edges of MM each, a .npz with rest_length_mm, or a text file"
                        + ("" if length_known else " (default: the rod ends where the thread ends in the images)"))
    given.add_up(parser, "0,0,1 in the rig's world")


def add_thread(parser: ArgumentParser) -> None:
    """How the rod looks in images; ``parser`` may be a group of arguments."""
    parser.add_argument("--polarity", choices=("dark", "light"), help="whether the thread is darker or lighter than the "
                        "background (default: decided per image)")
    parser.add_argument("--width", metavar="PX", help="width of the thread in the images (default: measured)")
    parser.add_argument("--colour", metavar="R,G,B", help="colour of the thread, 0 to 255 each, instead of --polarity")
    parser.add_argument("--masks", nargs="+", metavar="MASK|FOLDER", help="segmented images, instead of detection: one for "
                        "each camera, or a folder with masks named as the images are (default: alpha channels of the images)")
    parser.add_argument("--region", action="append", metavar="CAMERA:X,Y,W,H",
                        help="part of a camera's images where the thread is; once for each camera")


def by_camera(option: str, texts: Iterable[str] | None, names: tuple[str, ...], form: str) -> dict[str, tuple[float, ...]]:
    """The numbers of an option that is given once for each camera, as ``CAMERA:`` and ``form``, by the camera's name."""
    found = {}
    for text in texts or ():
        camera, _, numbers = text.rpartition(":")
        values = given.numbers(option, numbers)
        if camera not in names or len(values) != form.count(",") + 1:
            raise InputError(given.SOURCE, option, f"{text!r}",
                             f"give CAMERA:{form}; the rig has {', '.join(map(in_line, names))}")
        found[camera] = values
    return found


def sight(options: Namespace, sets, method: str = "ridge"):
    """The Sight that :func:`add_thread` describes, of the images in ``sets``."""
    from doo_ti.vision.detection.detect import Sight
    from doo_ti.vision.detection.options import DetectionOptions

    colour = None if options.colour is None else tuple(given.numbers("--colour", options.colour))
    regions = {camera: tuple(map(int, box))
               for camera, box in by_camera("--region", options.region, sets.rig.names, "X,Y,W,H").items()}
    for region in regions.values():
        DetectionOptions(region=region)
    masks = None if options.masks is None else [Path(mask) for mask in options.masks]
    if masks is not None and len(masks) == 1 and masks[0].is_dir():
        masks = masks[0]
    elif masks is not None:
        if sets.count > 1 or len(masks) != len(sets.rig.cameras):
            raise InputError(given.SOURCE, "--masks", f"{len(masks)} for {sets.count} sets of {len(sets.rig.cameras)} images",
                             "give one for each camera of a single set, or a folder")
        masks = dict(zip(sets.paths[0], masks))
    width = given.positive("--width", options.width, "px")
    return Sight(DetectionOptions(method, options.polarity, width, colour=colour), regions, masks)


def orientation_note(paths: Iterable[Path], turned: bool) -> str | None:
    """What to say of images with orientation tags; None where there are none."""
    from doo_ti.vision.detection.images import orientation_tags

    count = orientation_tags(paths)
    did, other = ("applied", "ignore") if turned else ("ignored", "apply")
    return f"{count} images have tags, which are {did}; else --orientation {other}" if count else None
