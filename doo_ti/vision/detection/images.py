"""Images from files as grey levels, and sets of images of one scene each with where the rod sets out: SETS.csv (§IV-A).

    name,cam0,cam1,cam2,seed_x,seed_y,seed_z,dir_x,dir_y,dir_z

Images are relative to the file; the columns of images are named as the rig's cameras. A camera that did not see a scene is left
out of the whole file, not of a line: a set's score is a sum over cameras, and sets are compared.
"""

import csv
import os
import struct
import sys
from contextlib import contextmanager
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from threading import Lock

import numpy as np

from doo_ti.errors import InputError
from doo_ti.file_content import MOST_TEXT_BYTES, read_content
from doo_ti.vision.cameras.camera import MOST_SIDE, Camera
from doo_ti.vision.cameras.rig import Rig

SEED = ("seed_x", "seed_y", "seed_z", "dir_x", "dir_y", "dir_z")
FEWEST_CAMERAS = 2
PNG = b"\x89PNG"
_changing, _silent = Lock(), []
"""One copy of the original standard error for each image that is being decoded."""


def read_image(path: str | os.PathLike, camera: Camera | None = None) -> np.ndarray:
    """(H, W) uint8 grey levels of any image file that OpenCV reads, turned as its orientation tag says.

    camera  that took the image

    Raises InputError for a file that is missing or is no image, and for another size than the camera's.
    """
    import cv2

    if hasattr(cv2, "setLogLevel"):
        cv2.setLogLevel(0)  # the caller reports on damaged files; OpenCV shall not do so as well
    path = Path(path)
    stored = np.frombuffer(read_content(path, remedy="name a readable image"), dtype=np.uint8)
    _check_side(path, *_png_size(stored[:24].tobytes()))  # before it is unpacked
    try:
        with _silenced():
            image = cv2.imdecode(stored, cv2.IMREAD_GRAYSCALE) if stored.size else None
    except cv2.error:
        image = None
    if image is None:
        raise InputError(path, "file", "cannot be read as an image", "give a PNG, JPEG or TIFF file")
    _check_side(path, *image.shape)
    if camera is not None and image.shape != (camera.height, camera.width):
        raise InputError(path, "size", f"{image.shape[1]} x {image.shape[0]} px, but {camera.name} of {camera.source} takes "
                         f"{camera.width} x {camera.height}", "give the rig's own images, neither scaled nor cropped")
    return image


def _png_size(head: bytes) -> tuple[int, ...]:
    """Width and height of a PNG, from its first bytes; nothing for other files."""
    return struct.unpack(">II", head[16:24]) if head.startswith(PNG) and len(head) == 24 else ()


def _check_side(path: Path, *sides: int) -> None:
    if max(sides, default=0) > MOST_SIDE:
        raise InputError(path, "size", f"{' x '.join(map(str, sides))} px", f"give images of at most {MOST_SIDE:,} px a side")


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
    """A sets of C images.

    names      A names
    paths      A tuples of C files, in the order of ``rig``'s cameras
    rig        the cameras that took them
    point      (A, 3) mm: v⁰
    direction  (A, 3) unit vectors: e⁰
    """

    names: tuple[str, ...]
    paths: tuple[tuple[Path, ...], ...]
    rig: Rig
    point: np.ndarray
    direction: np.ndarray
    source: str = "sets"

    def __post_init__(self):
        if len(self.rig.cameras) < FEWEST_CAMERAS:
            raise InputError(self.source, "cameras", f"{len(self.rig.cameras)} camera", "give images of two cameras or more")
        length = np.linalg.norm(self.direction, axis=-1, keepdims=True)
        for name, seed, size in zip(self.names, self.point, length, strict=True):
            if not (np.isfinite(seed).all() and np.isfinite(size).all() and size > 0):
                raise InputError(self.source, f"{name}: seed", f"{seed.tolist()}, direction of length {size}",
                                 "give finite numbers, and a direction")
        object.__setattr__(self, "direction", self.direction / length)
        for camera in self.rig.cameras:
            behind = np.flatnonzero(camera.depth(self.point) <= 0)
            if len(behind):
                name, seed = self.names[behind[0]], self.point[behind[0]].tolist()
                raise InputError(self.source, f"{name}: seed", f"{seed} is behind {camera.name}",
                                 "give the seed in the rig's world, in mm")

    @property
    def count(self) -> int:
        """A."""
        return len(self.names)


def load_sets(path: str | os.PathLike, rig: Rig) -> ImageSets:
    """The sets of a CSV file. Raises InputError naming line and column for whatever is missing or no number."""
    path = Path(path)
    header, lines = header_and_lines(path)
    missing = [name for name in ("name", *SEED) if name not in header]
    if missing:
        raise InputError(path, missing[0], "the column is missing", f"give name, a column per camera, and {', '.join(SEED)}")
    unknown = [name for name in header if name not in ("name", *SEED, *rig.names)]
    if unknown:
        raise InputError(path, unknown[0], "no camera of the rig", f"the rig has {', '.join(rig.names)}")
    if not lines:
        raise InputError(path, "name", "no line", "give a line for each set of images")
    cameras = [name for name in rig.names if name in header]
    names = [line["name"] for line in lines]
    if len(set(names)) < len(names):
        raise InputError(path, "name", f"{max(names, key=names.count)!r} occurs twice", "name the sets apart")
    seeds = np.array([[number_in(path, number, line, key) for key in SEED] for number, line in enumerate(lines, 2)])
    paths = tuple(tuple(_image(path, number, line, name) for name in cameras) for number, line in enumerate(lines, 2))
    return ImageSets(tuple(names), paths, rig.only(cameras) if cameras else rig, seeds[:, :3], seeds[:, 3:], str(path))


def header_and_lines(path: Path) -> tuple[list[str], list[dict[str, str]]]:
    """Columns and lines of a CSV file, with empty text where a line is short. Raises InputError for what is no such file,
    for a column that is there twice, for lines that are longer, and for cells that hold a line break, as after a quote that is
    not closed."""
    content = read_content(path, MOST_TEXT_BYTES, "name a readable CSV file")
    try:
        reader = csv.DictReader(StringIO(content.decode(), newline=""), restval="")
        header, lines = list(reader.fieldnames or []), list(reader)
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(path, "file", str(error), "name a readable CSV file") from None
    if len(set(header)) < len(header):
        raise InputError(path, max(header, key=header.count), "the column is there twice", "keep one of them")
    for number, line in enumerate(lines, 2):
        if None in line:
            raise InputError(path, f"line {number}", f"{len(header) + len(line[None])} cells under {len(header)} columns",
                             "give one for each")
        broken = next((key for key in header if "\n" in line[key]), None)
        if broken is not None:
            raise InputError(path, f"line {number}, {broken}", "a line break within a cell", "close the quote")
    return header, lines


def number_in(path: Path, number: int, line: dict, key: str) -> float:
    """What column ``key`` of a line holds. Raises InputError naming both for what is no number."""
    try:
        return float(line[key])
    except ValueError:
        raise InputError(path, f"line {number}, {key}", f"{line[key]!r} is no number", "give a decimal number") from None


def _image(path: Path, number: int, line: dict, camera: str) -> Path:
    if not line[camera]:
        raise InputError(path, f"line {number}, {camera}", "no image", "give one, or leave the camera's column out")
    return path.parent / line[camera]
