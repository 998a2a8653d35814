"""Images from files as grey levels, after a look at the size that a file states, which may fill the memory; and sets of images
of one scene each with where the rod sets out: SETS.csv (§IV-A).

    name,cam0,cam1,cam2,seed_x,seed_y,seed_z,dir_x,dir_y,dir_z
    name,cam0,cam1,cam2,cam0_u,cam0_v

Images are relative to the file; the columns of images are named as the rig's cameras. A camera that did not see a scene is left
out of the whole file, not of a line: a set's score is a sum over cameras, and sets are compared. A rod sets out from a point in
the world, or from a pixel in one camera or more; the cells of the others are empty.
"""

import os
import sys
from collections.abc import Iterable
from contextlib import contextmanager
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from threading import Lock
from warnings import catch_warnings, simplefilter

import numpy as np

from doo_ti.io.arrays import CsvTable, read_csv
from doo_ti.system.errors import InputError
from doo_ti.system.files import read_content
from doo_ti.vision.cameras import MOST_SIDE, Camera, Rig

PNG = b"\x89PNG"
KNOWN = "PNG, JPEG, TIFF, BMP, PGM or PPM"
TIFF = b"II*\0", b"MM\0*"  # beginnings of files
_WIDTH, _HEIGHT, _ORIENTATION = 256, 257, 274  # tags of TIFF, and of the Exif data of other files, which are in its form
UPRIGHT = 1


def _stated(content: bytes) -> tuple[tuple[int, ...], int]:
    """What an image file of a format that is :data:`KNOWN` states: width and height, and its orientation tag, 1 to 8 as Exif
    numbers them, 1, upright, where there is none. No size of other and damaged files."""
    from PIL import BmpImagePlugin, Image, JpegImagePlugin, PngImagePlugin, PpmImagePlugin

    readers = {PNG: PngImagePlugin.PngImageFile, b"\xff\xd8": JpegImagePlugin.JpegImageFile, b"BM": BmpImagePlugin.BmpImageFile,
               b"P": PpmImagePlugin.PpmImageFile}
    tags = Image.Exif()
    try:
        with _changing, catch_warnings():  # warnings are of all threads
            simplefilter("ignore")
            if content[:4] in TIFF:  # of which OpenCV reads more kinds
                tags.load(content)
                size = tuple(tags[tag] for tag in (_WIDTH, _HEIGHT) if tag in tags)
            else:
                image = next(reader for beginning, reader in readers.items() if content.startswith(beginning))(BytesIO(content))
                size = image.size
                tags.load(image.info.get("exif"))
            orientation = tags.get(_ORIENTATION, UPRIGHT)
    except Exception:  # whatever a reader says to a damaged file
        return (), UPRIGHT
    return size, orientation if 1 < orientation <= 8 else UPRIGHT


SEED = ("seed_x", "seed_y", "seed_z", "dir_x", "dir_y", "dir_z")
SEEDS = f"{', '.join(SEED)}, or CAMERA_u, CAMERA_v of a pixel where the rod begins"
MOST_PIXELS = 100_000_000  # of an image: while it is unpacked each takes up to eight bytes
DEPTHS = (8, 10, 12, 14, 16)  # bits of cameras' levels, which files keep in 16


def read_image(path: str | os.PathLike[str], camera: Camera | None = None, colour: bool = False,
               turned: bool | None = None) -> np.ndarray:
    """(H, W) uint8 grey levels of an image file, PNG, JPEG, TIFF, BMP, PGM or PPM, or with ``colour`` (H, W, 3) in OpenCV's
    order. Deeper images are scaled by the least number of bits that holds their levels, those of fractions by 1.

    camera  that took the image
    turned  turn the image as its orientation tag says; else pixels are where the sensor has them. None: as the camera says

    Raises InputError for a file that is missing or is no image, and for another size than the camera's.
    """
    import cv2

    turned = bool(camera is not None and camera.turned) if turned is None else turned
    flags = (cv2.IMREAD_COLOR if colour else cv2.IMREAD_GRAYSCALE) | cv2.IMREAD_ANYDEPTH
    return _in_bytes(_decoded(Path(path), camera, flags if turned else flags | cv2.IMREAD_IGNORE_ORIENTATION))


def read_mask(path: str | os.PathLike[str], camera: Camera | None = None) -> np.ndarray | None:
    """(H, W) uint8: how opaque the pixels of an image file are; None where it has no alpha channel, or one that is the same
    everywhere. Raises InputError as :func:`read_image`."""
    import cv2

    path = Path(path)
    content = read_content(path, remedy="name a readable image")
    if not content.startswith(PNG):  # of the formats that are read it alone may be transparent
        return None
    if content[25:26] not in (b"\x04", b"\x06") and b"tRNS" not in content[: content.find(b"IDAT")]:
        return None  # without unpacking it
    image = _decoded(path, camera, cv2.IMREAD_UNCHANGED)
    alpha = image[..., 3] if image.ndim == 3 and image.shape[2] == 4 else None
    return None if alpha is None or (alpha == alpha.flat[0]).all() else _in_bytes(alpha)


def orientation_tags(paths: Iterable[Path]) -> int:
    """How many of these image files, which were read before, have tags that say to turn them."""
    return sum(_stated(path.read_bytes())[1] != UPRIGHT for path in paths)


def _decoded(path: Path, camera: Camera | None, flags: int) -> np.ndarray:
    """The image of a file as OpenCV decodes it. Raises InputError."""
    import cv2

    if hasattr(cv2, "setLogLevel"):
        cv2.setLogLevel(0)  # the caller reports on damaged files; OpenCV shall not do so as well
    stored = np.frombuffer(read_content(path, remedy="name a readable image"), dtype=np.uint8)
    sides, tag = _stated(stored.tobytes())
    _check_side(path, *sides)  # before it is unpacked: a few bytes may state one that fills the memory
    try:
        with _silenced():
            image = cv2.imdecode(stored, flags) if sides else None
    except cv2.error:
        image = None
    if image is None:
        raise InputError(path, "file", "cannot be read as an image", f"give a {KNOWN} file")
    _check_side(path, *image.shape[:2])
    if camera is not None and image.shape[:2] != (camera.height, camera.width):
        lying = tag != UPRIGHT and not camera.turned and image.shape[:2] == (camera.width, camera.height)
        raise InputError(path, "size", f"{image.shape[1]} x {image.shape[0]} px, but {camera.name} of {camera.source} takes "
                         f"{camera.width} x {camera.height}", "give --orientation apply, as a tag says to turn it" if lying else
                         "give the rig's own images, neither scaled nor cropped")
    return image


def _in_bytes(image: np.ndarray) -> np.ndarray:
    """Levels from 0 to 255 of an image of any depth."""
    if image.dtype == np.uint8:
        return image
    levels = np.nan_to_num(image.astype(np.float32), nan=0.0, posinf=0.0, neginf=0.0)
    most = float(levels.max(initial=0))
    whole = 1.0 if image.dtype.kind == "f" and most <= 1 else next(
        (2.0**bits - 1 for bits in DEPTHS if most < 2.0**bits), most)
    return np.clip(levels * (255 / whole), 0, 255).round().astype(np.uint8)


def _check_side(path: Path, *sides: int) -> None:
    """Raise InputError for an image that is larger than memory should hold."""
    if max(sides, default=0) > MOST_SIDE or np.prod(sides, dtype=float) > MOST_PIXELS:
        raise InputError(path, "size", f"{' x '.join(map(str, sides))} px",
                         f"give images of at most {MOST_SIDE:,} px a side and {MOST_PIXELS / 1e6:,.0f} megapixels")


_changing, _silent = Lock(), []  # one copy of the original standard error for each image that is being decoded


@contextmanager
def _silenced():
    """Discards what image libraries write to the standard error about a damaged file: the caller reports on it in one line.
    All threads share the standard error: the first one to decode an image redirects it, the last one restores it."""
    with _changing:
        if not _silent:
            sys.stderr.flush()
            kept, discarded = os.dup(2), os.open(os.devnull, os.O_WRONLY)
            os.dup2(discarded, 2)
            os.close(discarded)
        else:
            kept = _silent[0]
        _silent.append(kept)
    try:
        yield
    finally:
        with _changing:
            _silent.pop()
            if not _silent:
                os.dup2(kept, 2)
                os.close(kept)


@dataclass(frozen=True)
class ImageSets:
    """A sets of C images."""

    names: tuple[str, ...]  # A names
    paths: tuple[tuple[Path, ...], ...]  # A tuples of C files, in the order of ``rig``'s cameras
    rig: Rig  # the cameras that took them
    point: np.ndarray | None  # (A, 3) mm: v⁰; None where it is to be found in the images
    direction: np.ndarray | None  # (A, 3) unit vectors: e⁰; None where it is to be found in the images
    source: str = "sets"
    # where ``point`` is None, A times the pixels (u, v) at which the rod begins, by the numbers of their cameras
    clicks: tuple[dict[int, tuple[float, float]], ...] | None = None

    def __post_init__(self) -> None:
        for name, pixels in zip(self.names, self.clicks or (), strict=False):
            for number, (u, v) in pixels.items():
                camera = self.rig.cameras[number]
                if not (-0.5 <= u < camera.width - 0.5 and -0.5 <= v < camera.height - 0.5):
                    raise InputError(self.source, f"{name}: seed pixel", f"{u:g},{v:g} is outside the image of {camera.name}",
                                     f"give one of its {camera.width} x {camera.height} px")
        if self.point is None:
            return
        length = np.ones((self.count, 1)) if self.direction is None else np.linalg.norm(self.direction, axis=-1, keepdims=True)
        for name, seed, size in zip(self.names, self.point, length, strict=True):
            if not (np.isfinite(seed).all() and np.isfinite(size).all() and size > 0):
                raise InputError(self.source, f"{name}: seed", f"{seed.tolist()}, direction of length {size}",
                                 "give finite numbers, and a direction")
        if self.direction is not None:
            object.__setattr__(self, "direction", self.direction / length)
        self.rig.check_sight(self.point, "the seed")
        for camera in self.rig.cameras:
            behind = np.flatnonzero(camera.depth(self.point) <= 0)
            if len(behind):
                name, seed = self.names[behind[0]], self.point[behind[0]].tolist()
                raise InputError(self.source, f"{name}: seed", f"{seed} is behind {camera.name}",
                                 "give the seed in the rig's world, in mm")

    @property
    def count(self) -> int:
        return len(self.names)

    def take(self, rows: np.ndarray) -> "ImageSets":
        """The sets of those ``rows``."""
        names, paths = (tuple(values[row] for row in rows) for values in (self.names, self.paths))
        point, direction = (None if values is None else values[rows] for values in (self.point, self.direction))
        clicks = None if self.clicks is None else tuple(self.clicks[row] for row in rows)
        return ImageSets(names, paths, self.rig, point, direction, self.source, clicks)


def load_sets(path: str | os.PathLike[str], rig: Rig) -> ImageSets:
    """The sets of a CSV file. Raises InputError naming line and column for whatever is missing or not a number."""
    path, form = Path(path), f"name, one per camera, and {SEEDS}"
    table = read_csv(path, ("name",), form=form, short_lines=True)
    clicked, seed = seed_columns(table, rig, form)
    cameras = cameras_in(table, rig, ("name", *seed))
    names = table.columns["name"]
    if len(set(names)) < len(names):
        raise InputError(path, "name", f"{max(names, key=names.count)!r} occurs twice", "name the sets apart")
    for name in cameras:
        table.refuse(name, np.array(table.columns[name]) == "", "is no image", "give one, or leave the camera's column out")
    rig = rig.only(cameras) if cameras else rig
    if clicked:
        clicks = clicks_in(table, clicked, rig)
        table.refuse(f"{clicked[0]}_u", np.array([not pixels for pixels in clicks]), "and no other pixel",
                     "give a pixel where the rod begins, in one camera or more")
        return ImageSets(tuple(names), images_in(table, cameras), rig, None, None, str(path), clicks)
    seeds = np.stack([table.numbers(key) for key in SEED], axis=-1)
    return ImageSets(tuple(names), images_in(table, cameras), rig, seeds[:, :3], seeds[:, 3:], str(path))


def seed_columns(table: CsvTable, rig: Rig, form: str) -> tuple[list[str], tuple[str, ...]]:
    """The cameras in which a table says where rods begin, none where it says that in space, and the columns that do. Raises
    InputError for columns that are missing."""
    pixels = {name: (f"{name}_u", f"{name}_v") for name in rig.names}
    clicked = [name for name, pair in pixels.items() if any(one in table.columns for one in pair)]
    seed = tuple(one for name in clicked for one in pixels[name]) or SEED
    missing = next((one for one in seed if one not in table.columns), None)
    if missing is not None:
        raise InputError(table.path, missing, "the column is missing", f"give the columns {form}")
    return clicked, seed


def clicks_in(table: CsvTable, clicked: list[str], rig: Rig) -> tuple[dict[int, tuple[float, float]], ...]:
    """For each row the pixels in the columns of the cameras ``clicked``, none where these are empty."""
    found = [{} for _ in range(table.count)]
    for name in clicked:
        u, v = (table.numbers(f"{name}_{axis}", may_be_empty=True) for axis in "uv")
        for one, other, axis in ((u, v, "u"), (v, u, "v")):
            table.refuse(f"{name}_{axis}", np.isnan(one) & ~np.isnan(other), "is no pixel", "give u and v, or neither")
        if name not in rig.names:
            raise InputError(table.path, f"{name}_u", f"the file has no images of {name}", f"give the column {name}")
        for row in np.flatnonzero(~np.isnan(u)):
            found[row][rig.names.index(name)] = float(u[row]), float(v[row])
    return tuple(found)


def cameras_in(table: CsvTable, rig: Rig, others: tuple[str, ...]) -> list[str]:
    """The cameras of the rig that a table has columns for, in the rig's order. Raises InputError for a column that is neither a
    camera's nor one of the ``others``."""
    unknown = next((name for name in table.columns if name not in (*others, *rig.names)), None)
    if unknown is not None:
        raise InputError(table.path, unknown, "no camera of the rig", f"the rig has {', '.join(rig.names)}")
    return [name for name in rig.names if name in table.columns]


def images_in(table: CsvTable, cameras: list[str]) -> tuple[tuple[Path, ...], ...]:
    """For each row the images of the ``cameras``, which a table names relative to itself."""
    return tuple(tuple(table.path.parent / table.columns[name][row] for name in cameras) for row in range(table.count))
