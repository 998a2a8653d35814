"""Calibrated cameras around a scene: x_cam = R x_world + t, then K with radial and tangential distortion (§V-A).

Axes: C cameras, V vertices. Millimetres in the world, pixels in images, pixel (0, 0) at the centre of the upper left one.
"""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from doo_ti.errors import InputError, real_array
from doo_ti.file_content import read_content
from doo_ti.frames import FRAME_TOLERANCE, handedness, orthonormality_error
from doo_ti.vision.opencv_yaml import read_opencv_yaml
from doo_ti.whole_file import write_whole

COEFFICIENTS = 5
"""Of distortion: k1, k2, p1, p2, k3."""
MOST_FILE_BYTES = 1 << 20
"""Of a rig: some thousand cameras."""
MOST_SIDE = 20_000
"""Pixels along a side of an image."""
LEAST_FOCAL_PX, MOST_PX = 1.0, 1e6
"""Of focal lengths; principal points lie as far off at most."""
MOST_DISTORTION = 1e6
MOST_MM = 1e6
"""From the world's origin to a camera."""
OTHER_COLUMNS = ("name", "frame", "time_s", "view", "seed_x", "seed_y", "seed_z", "dir_x", "dir_y", "dir_z")
"""Of tables that have a column of images for each camera, named as it is."""


@dataclass(frozen=True)
class Camera:
    """One calibrated camera.

    matrix       (3, 3) K, px: focal lengths and principal point, without skew
    distortion   (5,) k1, k2, p1, p2, k3
    rotation     (3, 3) R from world to camera, x right, y down, z forward
    translation  (3,) t, mm

    Raises InputError for sizes that are not positive, shapes that do not match, an R that is no rotation, and numbers beyond
    the bounds of any camera, which are stated above.
    """

    name: str
    width: int
    height: int
    matrix: np.ndarray
    distortion: np.ndarray
    rotation: np.ndarray
    translation: np.ndarray
    source: str = "rig"

    def __post_init__(self):
        for name, shape in (("matrix", (3, 3)), ("distortion", None), ("rotation", (3, 3)), ("translation", (3,))):
            value = np.array(real_array(self.source, f"cameras.{self.name}.{_KEYS[name]}", getattr(self, name), "give numbers"),
                             dtype=np.float64)
            value = value if name in ("matrix", "rotation") else value.reshape(-1)
            if name == "distortion" and value.size in (0, 4):
                value = np.concatenate([value, np.zeros(COEFFICIENTS - value.size)])
            if value.shape != (shape or (COEFFICIENTS,)) or not np.isfinite(value).all():
                wanted = f"give {shape or (1, COEFFICIENTS)} numbers"
                raise self._error(_KEYS[name], f"shape {value.shape}, or not finite", wanted)
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        if not (1 <= self.width <= MOST_SIDE and 1 <= self.height <= MOST_SIDE):
            raise self._error("width, height", f"{self.width} x {self.height}",
                              f"give the size of the images in pixels, at most {MOST_SIDE:,} a side")
        (fx, skew, _), (lower, fy, _), last = self.matrix
        if not (fx > 0 and fy > 0) or skew != 0 or lower != 0 or (last != [0, 0, 1]).any():
            raise self._error("K", f"{self.matrix.tolist()}", "give [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] with fx, fy > 0")
        for name, value, most in (("K", self.matrix[:2], MOST_PX), ("dist", self.distortion, MOST_DISTORTION),
                                  ("t", self.translation, MOST_MM)):
            if (np.abs(value) > most).any():
                raise self._error(name, f"{value[np.abs(value) > most][0]:g}", f"give numbers up to {most:,.0f}")
        if min(fx, fy) < LEAST_FOCAL_PX:
            raise self._error("K", f"a focal length of {min(fx, fy):g} px", f"give {LEAST_FOCAL_PX:g} px or more")
        if orthonormality_error(self.rotation) > FRAME_TOLERANCE or handedness(self.rotation) < 0:
            raise self._error("R", f"{np.round(self.rotation, 4).tolist()} is no rotation", "give a right-handed rotation")

    def _error(self, field: str, problem: str, remedy: str) -> InputError:
        return InputError(self.source, f"cameras.{self.name}.{field}", problem, remedy)

    @property
    def centre(self) -> np.ndarray:
        """(3,) mm: where the camera is in the world."""
        return -self.rotation.T @ self.translation

    def project(self, points: np.ndarray) -> np.ndarray:
        """(..., 2) px of (..., 3) points in the world, distorted as the lens does; NaN for points that are not in front."""
        seen = np.asarray(points, dtype=np.float64) @ self.rotation.T + self.translation
        depth = np.where(seen[..., 2] > 0, seen[..., 2], np.nan)
        x, y = seen[..., 0] / depth, seen[..., 1] / depth
        k1, k2, p1, p2, k3 = self.distortion
        square = x * x + y * y
        radial = 1 + square * (k1 + square * (k2 + square * k3))
        bent_x = x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x)
        bent_y = y * radial + p1 * (square + 2 * y * y) + 2 * p2 * x * y
        (fx, _, cx), (_, fy, cy), _ = self.matrix
        return np.stack([fx * bent_x + cx, fy * bent_y + cy], axis=-1)

    def depth(self, points: np.ndarray) -> np.ndarray:
        """(...) mm along the optical axis of (..., 3) points in the world."""
        return np.asarray(points, dtype=np.float64) @ self.rotation[2] + self.translation[2]


@dataclass(frozen=True)
class Rig:
    """C cameras that look at one scene. Raises InputError for names that occur twice, and for no camera at all."""

    cameras: tuple[Camera, ...]
    source: str = "rig"

    def __post_init__(self):
        if not self.cameras:
            raise InputError(self.source, "cameras", "no camera", "describe at least two")
        check_camera_names(self.source, [camera.name for camera in self.cameras])

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(camera.name for camera in self.cameras)

    def project(self, points: np.ndarray) -> np.ndarray:
        """(C, ..., 2) px of (..., 3) points in the world."""
        return np.stack([camera.project(points) for camera in self.cameras])

    def only(self, names) -> "Rig":
        """The cameras of these names, in that order. Raises InputError for one that is not there."""
        by_name = {camera.name: camera for camera in self.cameras}
        for name in names:
            if name not in by_name:
                raise InputError(self.source, "cameras", f"no camera {name!r}", f"the rig has {', '.join(by_name)}")
        return Rig(tuple(by_name[name] for name in names), self.source)


def check_camera_names(source: str, names: list[str]) -> None:
    """Raise InputError for names of cameras that occur twice, are empty, hold a line break, or name another column of tables of
    images."""
    for name in names:
        if names.count(name) > 1:
            raise InputError(source, "cameras", f"the name {name!r} occurs twice", "name them apart")
        if "\n" in name:
            raise InputError(source, "cameras", f"{name!r} holds a line break", "name it in one line, such as cam0")
        if not name or name in OTHER_COLUMNS:
            raise InputError(source, "cameras", f"{name!r} cannot be a camera's name, tables of images have another column of "
                             "that name" if name else "a camera without a name", "name it otherwise, such as cam0")


_KEYS = {"matrix": "K", "distortion": "dist", "rotation": "R", "translation": "t"}


def load_rig(path: str | os.PathLike) -> Rig:
    """The rig of an OpenCV FileStorage YAML file: a sequence ``cameras`` of maps name, width, height, K, dist, R, t.

    Raises InputError for a file that cannot be read, for what is missing, and for whatever :class:`Camera` refuses.
    """
    path = Path(path)
    stored = read_content(path, MOST_FILE_BYTES, "name a readable rig")
    try:
        content = read_opencv_yaml(stored.decode())
    except ValueError as error:  # no text, or no YAML
        raise InputError(path, "file", f"not a rig ({str(error)[:80]})", "give OpenCV FileStorage YAML") from None
    found = content.get("cameras") if isinstance(content, dict) else None
    if not isinstance(found, list) or not found:
        raise InputError(path, "cameras", "missing or empty", "give a sequence of name, width, height, K, dist, R, t")
    return Rig(tuple(_camera(path, entries, index) for index, entries in enumerate(found)), str(path))


def _camera(path: Path, entries, index: int) -> Camera:
    """One camera of the file."""
    if not isinstance(entries, dict):
        raise InputError(path, f"cameras[{index}]", "is no map", "give name, width, height, K, dist, R, t")
    name = entries.get("name") if isinstance(entries.get("name"), str) else f"cam{index}"
    size = {}
    for key in ("width", "height"):
        size[key] = entries.get(key)
        if type(size[key]) is not int:
            raise InputError(path, f"cameras.{name}.{key}", "missing or no whole number", "give the images' size in pixels")
    values = {}
    for field, key in _KEYS.items():
        found = entries.get(key)
        if not isinstance(found, np.ndarray):
            raise InputError(path, f"cameras.{name}.{key}", "missing or no matrix",
                             "give K (3, 3), dist (1, 5), R (3, 3), t (3, 1)")
        values[field] = found
    return Camera(name=name, **size, **values, source=str(path))


def save_rig(path: str | os.PathLike, rig: Rig) -> None:
    """Write ``rig`` as OpenCV FileStorage YAML; :func:`load_rig` reads it back."""
    import cv2

    storage = cv2.FileStorage(".yaml", cv2.FileStorage_WRITE | cv2.FileStorage_MEMORY | cv2.FileStorage_FORMAT_YAML)
    storage.startWriteStruct("cameras", cv2.FileNode_SEQ)
    for camera in rig.cameras:
        storage.startWriteStruct("", cv2.FileNode_MAP)
        storage.write("name", camera.name)
        storage.write("width", camera.width)
        storage.write("height", camera.height)
        storage.write("K", np.array(camera.matrix))
        storage.write("dist", camera.distortion.reshape(1, COEFFICIENTS).copy())
        storage.write("R", np.array(camera.rotation))
        storage.write("t", camera.translation.reshape(3, 1).copy())
        storage.endWriteStruct()
    storage.endWriteStruct()
    text = storage.releaseAndGetString()
    write_whole(Path(path), lambda file: file.write(text.encode()))
