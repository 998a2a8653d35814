"""Cameras around a scene, and the file that describes them: OpenCV FileStorage YAML, or files of others (§V-A).

Axes: C cameras.
"""

import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from doo_ti.system.arguments import typed
from doo_ti.system.errors import InputError
from doo_ti.system.files import write_text
from doo_ti.vision.cameras.camera import Camera
from doo_ti.vision.cameras.foreign import RigReading, colmap_cameras, others, own_cameras, read_yaml, stereo_cameras

NEAREST_MM = 1.0  # distance of cameras below which lengths are hardly in mm
OTHER_COLUMNS = ("name", "frame", "time_s", "view", "seed_x", "seed_y", "seed_z", "dir_x", "dir_y", "dir_z")
"""Of tables that have a column of images for each camera, named as it is."""


@typed
@dataclass(frozen=True)
class Rig:
    """C cameras that look at one scene, and how their file was read. Raises InputError for names that occur twice, and for no
    camera at all."""

    cameras: tuple[Camera, ...]
    source: str = "rig"
    reading: RigReading = RigReading(unit="mm", poses="opencv")

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
        return Rig(tuple(by_name[name] for name in names), self.source, self.reading)

    def read_otherwise(self) -> Iterator[tuple["Rig", str, str]]:
        """The rigs of other readings of the same file, what they assume, and the option for it."""
        for reading, assumed, option in others(self.reading):
            yield Rig(tuple(reading.applied(camera) for camera in self.cameras), self.source, reading), assumed, option

    def check_sight(self, points: np.ndarray, what: str) -> None:
        """Raise InputError where cameras do not see ``points`` (N, 3), ``what`` for the caller, but would if their file were in
        another unit or had poses of another kind; the message names the option for it."""
        blind = [camera for camera in self.cameras if not camera.sees(points).all()]
        if 2 * len(blind) < len(self.cameras) or not blind:
            return  # a point may be beside a camera's image
        near = np.ptp([camera.centre for camera in self.cameras], axis=0).max() < NEAREST_MM
        for rig, assumed, option in self.read_otherwise():
            if (near or rig.reading.unit is None) and all(camera.sees(points).all() for camera in rig.cameras):
                where = "behind" if (blind[0].depth(points) <= 0).any() else "outside the image of"
                raise InputError(self.source, "cameras", f"{what} is {where} {blind[0].name}, but in every image if {assumed}",
                                 f"give {option}, or correct the seed")


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
def load_rig(path: str | os.PathLike[str], reading: RigReading = RigReading()) -> Rig:
    """The rig of a file: OpenCV FileStorage YAML with a list ``cameras`` of maps name, width, height, K, dist, R, t, or with
    K1, D1, K2, D2, R, T of a stereo calibration; or COLMAP's cameras.txt and images.txt, by either or their folder.

    Raises InputError for a file that cannot be read, for missing entries, and for values that :class:`Camera` refuses.
    """
    path = Path(path)
    if path.is_dir() or path.suffix == ".txt":
        cameras = colmap_cameras(path if path.is_dir() else path.parent)
    else:
        content = read_yaml(path)
        stereo = stereo_cameras(path, content, reading) if isinstance(content, dict) and "cameras" not in content else None
        cameras = own_cameras(path, content, reading) if stereo is None else stereo
    return Rig(tuple(reading.applied(camera) for camera in cameras), str(path), reading)


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
        storage.write("dist", camera.distortion.reshape(1, -1).copy())
        storage.write("R", np.array(camera.rotation))
        storage.write("t", camera.translation.reshape(3, 1).copy())
        if camera.turned:
            storage.write("orientation", "apply")
        storage.endWriteStruct()
    storage.endWriteStruct()
    write_text(Path(path), storage.releaseAndGetString())
