"""Image sets of rods that are known, written as a camera rig would have left them: images, SETS.csv and the rig (§V-A)."""

import csv
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from io import StringIO
from pathlib import Path

import numpy as np

from doo_ti.errors import InputError
from doo_ti.io.files import write_whole
from doo_ti.vision.cameras.rig import Rig, save_rig
from doo_ti.vision.detection.images import SEED
from doo_ti.vision.rendering.render import RenderOptions, render_set

SETS_FILE, RIG_FILE = "sets.csv", "rig.yaml"


@dataclass(frozen=True)
class Photographs:
    """A sets of C images to take.

    names        A names, which files are called after
    curves       (A, n, 3) mm: the threads' centre lines
    point        (A, 3) mm: v⁰
    direction    (A, 3) of e⁰
    diameter_mm  of all threads
    rig          the cameras
    options      what the images look like
    seed         of everything random in them; set a has the seed (``seed``, a), whatever the others are

    Raises InputError for names that occur twice or are none for a file, and for threads that a camera does not see whole.
    """

    names: tuple[str, ...]
    curves: np.ndarray
    point: np.ndarray
    direction: np.ndarray
    diameter_mm: float
    rig: Rig
    options: RenderOptions = RenderOptions()
    seed: int = 0

    def __post_init__(self):
        if len(set(self.names)) < len(self.names) or any(not name or set(name) & set('/\\\0') for name in self.names):
            raise InputError("image synthesis", "names", "one occurs twice, or is none for a file", "name the sets apart")
        for camera in self.rig.cameras:
            pixels = camera.project(self.curves)
            inside = ((pixels > 0) & (pixels < (camera.width - 1, camera.height - 1))).all(axis=(1, 2))
            if not inside.all():
                name = self.names[int(np.argmin(inside))]
                raise InputError(self.rig.source, f"cameras.{camera.name}", f"does not see all of {name}",
                                 "move the camera, or give it a wider view")

    def images(self, index: int) -> list[np.ndarray]:
        """C images (H, W) uint8 of set ``index``."""
        return render_set(self.rig, self.curves[index], self.diameter_mm, self.options, (self.seed, index))


def save_photographs(folder: Path, photographs: Photographs, threads: int = 2,
                     on_set: Callable[[], None] | None = None) -> None:
    """Write all images, ``sets.csv`` and ``rig.yaml`` to ``folder``, which exists; ``on_set`` is called after each set.

    Images are JPEG of the options' quality, or PNG without one. ``sets.csv`` comes last: where it is, all is.
    """
    with ThreadPoolExecutor(threads) as executor:  # OpenCV and NumPy leave the interpreter to the other threads meanwhile
        for _ in executor.map(partial(_save_set, folder, photographs), range(len(photographs.names))):
            if on_set is not None:
                on_set()
    save_rig(folder / RIG_FILE, photographs.rig)
    text = StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("name", *photographs.rig.names, *SEED))
    for index, name in enumerate(photographs.names):
        seed = np.concatenate([photographs.point[index], photographs.direction[index]]).round(12) + 0.0
        writer.writerow((name, *_files(photographs, index), *seed.tolist()))
    write_whole(folder / SETS_FILE, lambda file: file.write(text.getvalue().encode()))


def _files(photographs: Photographs, index: int) -> list[str]:
    suffix = ".png" if photographs.options.jpeg_quality is None else ".jpg"
    return [f"{photographs.names[index]}_{camera}{suffix}" for camera in photographs.rig.names]


def _save_set(folder: Path, photographs: Photographs, index: int) -> None:
    """The images of one set; the file's compression is the only one."""
    import cv2

    quality = photographs.options.jpeg_quality
    raw = replace(photographs, options=replace(photographs.options, jpeg_quality=None))
    how = [] if quality is None else [cv2.IMWRITE_JPEG_QUALITY, int(quality)]
    for file, image in zip(_files(photographs, index), raw.images(index), strict=True):
        content = cv2.imencode(Path(file).suffix, image, how)[1].tobytes()
        write_whole(folder / file, lambda opened, content=content: opened.write(content))
