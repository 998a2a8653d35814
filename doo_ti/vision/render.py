"""Images of rods through a rig, for tests without cameras (§V-A).

A scene is the thread, objects that hide it, and objects that look like it; all cameras of a set see the same scene. An image
is the scene, blurred by the lens, with the sensor's noise, and the losses of JPEG. Sets of images are written as a camera rig
would have left them: images, SETS.csv and the rig.

Axes: A sets, C cameras, V vertices of a rod, n points of a curve.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from doo_ti.rod.frames import arc_lengths, placed
from doo_ti.rod.types import LARGEST
from doo_ti.system.errors import InputError
from doo_ti.system.files import csv_text, write_text, write_whole
from doo_ti.vision.cameras import Camera, Rig
from doo_ti.vision.images import SEED
from doo_ti.vision.rig_files import save_rig
from doo_ti.vision.tubes import DRAWN_BLUR_PX, Tube, draw, smooth_curve

PIXEL_BLUR_PX = 12**-0.5  # standard deviation of a pixel's square, over which the sensor integrates the light
MOST_THINGS = 1000  # largest number of objects of each kind beside the thread; the memory for an image grows with them
MOST_GREY = 1e4
MOST_BLUR_PX = 100.0
LEAST_MM, MOST_MM = 1e-3, 1e3  # bounds of diameters
BLOB_PX = 120  # size of the background's uneven patches


@dataclass(frozen=True)
class RenderOptions:
    """The look of the images; brightness is in grey levels, 0 to 255.

    Raises InputError for what cannot be drawn.
    """

    thread: float = 45.0  # brightness of the thread away from the light; above ``background`` for a light thread on dark
    background: float = 200.0  # mean brightness of the background
    unevenness: float = 9.0  # standard deviation of the background's soft patches
    gradient: float = 0.0  # brightness of the background at the right border less that at the left one
    shading: float = 15.0  # additional brightness of a surface that faces the light
    light: tuple[float, float, float] = (-0.5, -0.3, 1.0)  # direction towards the light, in the world; any length
    blur_px: float = 0.9  # standard deviation of the lens's blur, at least 0.3
    noise: float = 3.0  # standard deviation of the sensor's noise
    jpeg_quality: int | None = 95  # 1 to 100, or None: not compressed
    occluders: int = 0  # number of balls and bars, alternating, in front of the thread as seen from the middle of the cameras
    # approximate share of the thread's length that they hide together; it differs from camera to camera
    occluded_share: float = 0.2
    occluder: float = 120.0  # their brightness
    clutter: int = 0  # number of other lines, of 0.3 to 3 thread diameters, as bright as the thread or less distinct

    def __post_init__(self) -> None:
        for name in (field.name for field in fields(self) if field.name != "light"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value >= 0):
                raise InputError("rendering", name, f"{value}", "give a number that is not negative")
            most = MOST.get(name, MOST_GREY)
            if value is not None and value > most:
                raise InputError("rendering", name, f"{value:g}", f"give at most {most:g}")
        if self.jpeg_quality is not None and not 1 <= self.jpeg_quality <= 100:
            raise InputError("rendering", "jpeg_quality", f"{self.jpeg_quality}", "give 1 to 100, or none")
        if np.shape(self.light) != (3,) or not (np.abs(self.light) <= LARGEST).all() or not np.linalg.norm(self.light) > 0:
            raise InputError("rendering", "light", f"{self.light}", "give a direction of three numbers, not all zero")


# Largest values of options; MOST_GREY for all others.
MOST = {"occluders": MOST_THINGS, "clutter": MOST_THINGS, "blur_px": MOST_BLUR_PX, "occluded_share": 1}


def render_set(rig: Rig, rod: np.ndarray, diameter_mm: float, options: RenderOptions = RenderOptions(),
               seed: int | Sequence[int] = 0, covered: Sequence[str] = ()) -> list[np.ndarray]:
    """C images (H, W) uint8 of one rod (V, 3) mm of the given diameter.

    seed     of everything random: the same seed gives the same images
    covered  names of cameras that something out of focus hides everything from, as bright as the occluders

    Raises InputError for a rod that is not (V, 3) finite numbers with V ≥ 2, coinciding neighbours, and diameters out of
    range.
    """
    rod = np.asarray(rod, dtype=np.float64)
    if rod.ndim != 2 or rod.shape[1] != 3 or len(rod) < 2 or not np.isfinite(rod).all():
        raise InputError("rendering", "rods", f"shape {rod.shape}, or not finite", "give two or more vertices of a rod in mm")
    if not np.linalg.norm(np.diff(rod, axis=0), axis=1).all():
        raise InputError("rendering", "rods", "neighbouring vertices coincide", "give edges of some length")
    check_diameter(diameter_mm)
    curve = smooth_curve(rod, _samples(rig, rod))
    scene = _scene(rig, curve, diameter_mm, options, np.random.default_rng([*np.atleast_1d(seed), 0]))
    hidden = replace(options, background=options.occluder)
    return [_photograph(camera, *(([], hidden) if camera.name in covered else (scene, options)),
                        np.random.default_rng([*np.atleast_1d(seed), 1 + index]))
            for index, camera in enumerate(rig.cameras)]


def check_diameter(diameter_mm: float, source: str = "rendering", field: str = "diameter_mm") -> None:
    """Raise InputError for a diameter out of range."""
    if not LEAST_MM <= diameter_mm <= MOST_MM:
        raise InputError(source, field, f"{diameter_mm:g} mm", f"give {LEAST_MM:g} to {MOST_MM:g} mm")


def _samples(rig: Rig, rod: np.ndarray) -> int:
    """Number of points per edge for which they are about a pixel apart."""
    steps = np.linalg.norm(np.diff(rig.project(rod), axis=-2), axis=-1)
    return int(np.clip(np.ceil(np.nanmax(steps, initial=1.0)), 4, 64))


def _scene(rig: Rig, curve: np.ndarray, diameter: float, options: RenderOptions, random: np.random.Generator) -> list[Tube]:
    """The thread and all other objects."""
    place = arc_lengths(curve)
    toward = np.mean([camera.centre for camera in rig.cameras], axis=0) - curve.mean(axis=0)
    toward /= np.linalg.norm(toward)
    return [Tube(curve, diameter / 2, options.thread)] + _occluders(curve, place, toward, diameter, options, random) \
        + _clutter(curve, place[-1], diameter, options, random)


def _occluders(curve, place, toward, diameter: float, options: RenderOptions, random: np.random.Generator) -> list[Tube]:
    """Balls and bars close in front of the thread, one in each of ``occluders`` equal parts of its length."""
    found = []
    radius = max(options.occluded_share * place[-1] / (2 * max(options.occluders, 1)), 1e-3)
    for index in range(options.occluders):
        at = (index + random.uniform(0.3, 0.7)) / options.occluders * place[-1]
        before, middle, after = placed(at + np.array([-1e-3, 0, 1e-3]), place, curve)
        middle = middle + (radius + diameter) * toward
        # A bar lies across the thread, so that it hides as much of it as a ball does.
        sideways = np.cross(toward, after - before) + 1e-9 * _perpendicular(toward, random)
        sideways /= np.linalg.norm(sideways)
        reach = (1e-3 if index % 2 == 0 else 3.0) * radius
        found.append(Tube(middle + np.linspace(-reach, reach, 9)[:, None] * sideways, radius, options.occluder))
    return found


def _clutter(curve, length: float, diameter: float, options: RenderOptions, random: np.random.Generator) -> list[Tube]:
    """Bent lines in a ball around the thread's middle."""
    found = []
    for _ in range(options.clutter):
        direction = random.normal(size=3)
        middle = curve.mean(axis=0) + 0.6 * length * random.uniform() ** (1 / 3) * direction / np.linalg.norm(direction)
        run = random.normal(size=3)
        run /= np.linalg.norm(run)
        reach = random.uniform(0.1, 0.3) * length
        step = np.linspace(-1, 1, 65)[:, None]
        bend = random.uniform(-0.4, 0.4) * _perpendicular(run, random)
        radius = diameter * np.exp(random.uniform(np.log(0.15), np.log(1.5)))
        brightness = options.background + random.uniform(0.3, 1.0) * (options.thread - options.background)
        found.append(Tube(middle + reach * (step * run + step**2 * bend), radius, brightness))
    return found


def _perpendicular(direction: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """A random unit vector across ``direction``."""
    across = np.cross(direction, random.normal(size=3))
    return across / np.linalg.norm(across)


def _photograph(camera: Camera, scene: list[Tube], options: RenderOptions, random: np.random.Generator) -> np.ndarray:
    """(H, W) uint8: the scene through lens, sensor and compression."""
    light = np.array(options.light) / np.linalg.norm(options.light)
    image = draw(camera, scene, _background(camera, options, random), light, options.shading)
    rest = options.blur_px**2 + PIXEL_BLUR_PX**2 - DRAWN_BLUR_PX**2
    if rest > 0:
        image = cv2.GaussianBlur(image, (0, 0), np.sqrt(rest), borderType=cv2.BORDER_REPLICATE)
    if options.noise > 0:
        image += options.noise * random.standard_normal(image.shape, dtype=np.float32)
    image = np.clip(np.rint(image), 0, 255).astype(np.uint8)
    if options.jpeg_quality is not None:
        stored = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, int(options.jpeg_quality)])[1]
        image = cv2.imdecode(stored, cv2.IMREAD_GRAYSCALE)
    return image


def _background(camera: Camera, options: RenderOptions, random: np.random.Generator) -> np.ndarray:
    """(H, W) float32: an evenly or unevenly lit surface."""
    coarse = random.standard_normal((2 + camera.height // BLOB_PX, 2 + camera.width // BLOB_PX), dtype=np.float32)
    patches = cv2.resize(coarse, (camera.width, camera.height), interpolation=cv2.INTER_CUBIC)
    ramp = np.linspace(-0.5, 0.5, camera.width, dtype=np.float32)
    return np.float32(options.background) + np.float32(options.unevenness) * patches + np.float32(options.gradient) * ramp


# --- sets of images as files -----------------------------------------------------------------------------------------------

SETS_FILE, RIG_FILE = "sets.csv", "rig.yaml"


@dataclass(frozen=True)
class Photographs:
    """A sets of C images to render.

    Raises InputError for names that occur twice or cannot name a file, and for threads that a camera does not see completely.
    """

    names: tuple[str, ...]  # A names, used in the names of files
    curves: np.ndarray  # (A, n, 3) mm: the threads' centre lines
    point: np.ndarray  # (A, 3) mm: v⁰
    direction: np.ndarray  # (A, 3) of e⁰
    diameter_mm: float  # of all threads
    rig: Rig  # the cameras
    options: RenderOptions = RenderOptions()  # of the images
    seed: int = 0  # of everything random; set a has the seed (``seed``, a), so that its images do not depend on the other sets

    def __post_init__(self) -> None:
        if len(set(self.names)) < len(self.names) or any(not name or set(name) & set('/\\\0') for name in self.names):
            raise InputError("image synthesis", "names", "one occurs twice, or cannot name a file", "name the sets apart")
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


def save_photographs(folder: Path, photographs: Photographs, on_set: Callable[[], object] = lambda: None) -> None:
    """Write all images, ``sets.csv`` and ``rig.yaml`` to ``folder``; ``on_set`` is called after each set.

    Images are JPEG of the options' quality, or PNG without one. ``sets.csv`` is written last: if it exists, all files do.
    """
    with ThreadPoolExecutor(2) as executor:  # OpenCV and NumPy release the interpreter's lock
        for _ in executor.map(partial(_save_set, folder, photographs), range(len(photographs.names))):
            on_set()
    save_rig(folder / RIG_FILE, photographs.rig)
    seeds = np.concatenate([photographs.point, photographs.direction], axis=1).round(12) + 0.0
    write_text(folder / SETS_FILE, csv_text(("name", *photographs.rig.names, *SEED), (
        (name, *_files(photographs, index), *seeds[index]) for index, name in enumerate(photographs.names))))


def _files(photographs: Photographs, index: int) -> list[str]:
    suffix = ".png" if photographs.options.jpeg_quality is None else ".jpg"
    return [f"{photographs.names[index]}_{camera}{suffix}" for camera in photographs.rig.names]


def _save_set(folder: Path, photographs: Photographs, index: int) -> None:
    """Write the images of one set, compressed once, as files."""
    quality = photographs.options.jpeg_quality
    raw = replace(photographs, options=replace(photographs.options, jpeg_quality=None))
    how = [] if quality is None else [cv2.IMWRITE_JPEG_QUALITY, int(quality)]
    for file, image in zip(_files(photographs, index), raw.images(index), strict=True):
        content = cv2.imencode(Path(file).suffix, image, how)[1].tobytes()
        write_whole(folder / file, lambda opened, content=content: opened.write(content))
