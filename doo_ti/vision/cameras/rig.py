"""Cameras around a scene, and the file that describes them: OpenCV FileStorage YAML (§V-A).

Axes: C cameras.
"""

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from doo_ti.arguments import typed
from doo_ti.errors import InputError
from doo_ti.io.files import read_content, write_text
from doo_ti.io.opencv_yaml import read_opencv_yaml
from doo_ti.vision.cameras.camera import COEFFICIENTS, KEYS, Camera

MOST_FILE_BYTES = 1 << 20
"""Of a rig: some thousand cameras."""
OTHER_COLUMNS = ("name", "frame", "time_s", "view", "seed_x", "seed_y", "seed_z", "dir_x", "dir_y", "dir_z")
"""Of tables that have a column of images for each camera, named as it is."""


@typed
@dataclass(frozen=True)
class Rig:
    """C cameras that look at one scene. Raises InputError for names that occur twice, and for no camera at all."""

    cameras: tuple[Camera, ...]
    source: str = "rig"

    def __post_init__(self) -> None:
        if not self.cameras:
            raise InputError(self.source, "cameras", "no camera", "describe at least two")
        check_camera_names(self.source, [camera.name for camera in self.cameras])

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(camera.name for camera in self.cameras)

    def project(self, points: np.ndarray) -> np.ndarray:
        """(C, ..., 2) px of (..., 3) points in the world."""
        return np.stack([camera.project(points) for camera in self.cameras])

    def only(self, names: Iterable[str]) -> "Rig":
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


@typed
def load_rig(path: str | os.PathLike[str]) -> Rig:
    """The rig of an OpenCV FileStorage YAML file: a sequence ``cameras`` of maps name, width, height, K, dist, R, t.

    Raises InputError for a file that cannot be read, for missing entries, and for values that :class:`Camera` refuses.
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


def save_rig(path: str | os.PathLike[str], rig: Rig) -> None:
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
    write_text(Path(path), storage.releaseAndGetString())
