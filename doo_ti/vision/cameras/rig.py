"""Cameras around a scene, and the file that describes them: OpenCV FileStorage YAML (§V-A).

FileStorage's own reader crashes on damaged files, so that what it writes is read without it; a matrix is a map
``rows, cols, dt, data`` with the tag ``!!opencv-matrix``. Axes: C cameras, V vertices.
"""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from doo_ti.errors import InputError
from doo_ti.file_content import read_content
from doo_ti.vision.cameras.camera import COEFFICIENTS, KEYS, Camera
from doo_ti.whole_file import write_whole

MOST_FILE_BYTES = 1 << 20
"""Of a rig: some thousand cameras."""
OTHER_COLUMNS = ("name", "frame", "time_s", "view", "seed_x", "seed_y", "seed_z", "dir_x", "dir_y", "dir_z")
"""Of tables that have a column of images for each camera, named as it is."""
KINDS = ("u", "c", "w", "s", "i", "f", "d")
"""Of numbers in a matrix of one channel."""


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
    for field, key in KEYS.items():
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


# --- what FileStorage writes ---------------------------------------------------------------------------------------------


class DamagedError(ValueError):
    """Text that FileStorage does not write."""


def read_opencv_yaml(text: str):
    """The values of one document: dictionaries, lists, text, numbers, and matrices as arrays (rows, cols) in f64.

    Raises DamagedError for whatever is no YAML, and for matrices that are none. Nothing but these values is ever made.
    """
    import yaml

    class Loader(yaml.SafeLoader):
        def compose_node(self, parent, index):
            if self.check_event(yaml.AliasEvent):  # FileStorage writes none, and they can unfold without end
                raise DamagedError("an alias")
            return super().compose_node(parent, index)

        def matrix(self, node):
            return _matrix(self.construct_mapping(node, deep=True))

    Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", Loader.matrix)
    # FileStorage begins with a line that only OpenCV takes for a version of YAML, %YAML:1.0.
    lines = text.splitlines(keepends=True)
    body = "".join(lines[1:]) if lines and lines[0].startswith("%YAML") else text
    try:
        return yaml.load(body, Loader)
    except (yaml.YAMLError, RecursionError, OverflowError) as error:
        raise DamagedError((str(error) or type(error).__name__).splitlines()[0]) from None
    except (TypeError, ValueError, AttributeError) as error:  # a key that is a list, a date that is none
        raise DamagedError(str(error).splitlines()[0]) from None


def _matrix(entries: dict) -> np.ndarray:
    rows, columns, kind, data = (entries.get(key) for key in ("rows", "cols", "dt", "data"))
    for name, value in (("rows", rows), ("cols", columns)):
        if type(value) is not int or value < 1:
            raise DamagedError(f"{name} of a matrix is {value!r}")
    if kind not in KINDS:
        raise DamagedError(f"dt of a matrix is {kind!r}")
    if not isinstance(data, list) or len(data) != rows * columns:
        raise DamagedError(f"data of a matrix are not {rows} x {columns} numbers")
    return np.array([_number(value) for value in data]).reshape(rows, columns)


def _number(value) -> float:
    # YAML takes 1e3, without a point, for text.
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise DamagedError(f"{value!r} in a matrix is no number")
    try:
        return float(value)
    except (ValueError, OverflowError):
        raise DamagedError(f"{value!r} in a matrix is no number") from None
