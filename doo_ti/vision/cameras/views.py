"""Which image shows which view to which camera, and the corners of a board found in them.

A list of views is a CSV file: a column ``view`` with names, and a column for each camera, named as the camera, with images
relative to the file, empty where that camera did not see the view.
"""

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from doo_ti.io.csv_table import read_csv
from doo_ti.system.errors import InputError
from doo_ti.vision.cameras.board import Board, find_corners
from doo_ti.vision.cameras.calibration import Sighting
from doo_ti.vision.cameras.rig import check_camera_names
from doo_ti.vision.detection.images import read_image


@dataclass(frozen=True)
class Views:
    """V views by C cameras.

    names    of the views
    cameras  names of the cameras
    images   (view, camera) as numbers: the image
    source   the file they come from
    """

    names: tuple[str, ...]
    cameras: tuple[str, ...]
    images: dict[tuple[int, int], Path]
    source: str


def read_views(path: Path) -> Views:
    """The views of a CSV file. Raises InputError for any other file, for fewer than two cameras, names that occur
    twice, and images that are not there."""
    table = read_csv(path, ("view",), form="view,cam0,cam1,…")
    cameras = tuple(name for name in table.columns if name != "view")
    check_camera_names(str(path), list(cameras))
    if len(cameras) < 2:
        raise InputError(path, "header", f"{len(cameras)} camera", "a rig has two or more: give each a column of images")
    names = tuple(table.columns["view"])
    table.refuse("view", np.array([not name or names.count(name) > 1 for name in names]), "is empty, or there twice",
                 "name the views apart")
    images = {(view, camera): path.parent / table.columns[name][view] for view in range(table.count)
              for camera, name in enumerate(cameras) if table.columns[name][view]}
    for (view, camera), image in images.items():
        if not os.path.isfile(image):
            raise InputError(path, cameras[camera], f"no such file: {image} (view {names[view]})", "correct the path")
    return Views(names, cameras, images, str(path))


def find_sightings(views: Views, board: Board, advance: Callable[[], object] = lambda: None,
                   turned: bool = False) -> tuple[list[Sighting], dict[str, tuple[int, int]]]:
    """The board's corners in all images that show it, and the width and height of each camera's images.

    advance  called after each image
    turned   images are turned as their orientation tags say

    Raises InputError for an image that cannot be read and for one of another size than the camera's others.
    """
    sightings, sizes = [], {}
    for (view, camera), path in sorted(views.images.items()):
        image = read_image(path, turned=turned)
        size = image.shape[1], image.shape[0]
        if sizes.setdefault(camera, size) != size:
            raise InputError(path, "size", f"{size[0]} x {size[1]} px, but {views.cameras[camera]}'s first image has "
                             f"{sizes[camera][0]} x {sizes[camera][1]}", "give images of one size per camera")
        found, pixels = find_corners(image, board)
        if len(found):
            sightings.append(Sighting(view, camera, found, pixels))
        advance()
    missing = next((name for camera, name in enumerate(views.cameras) if camera not in sizes), None)
    if missing is not None:
        raise InputError(views.source, missing, "no image of this camera", "give some, or leave the column out")
    return sightings, {name: sizes[camera] for camera, name in enumerate(views.cameras)}
