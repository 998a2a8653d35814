"""Calibration boards, a chessboard, ChArUco (a chessboard with markers in its white squares) or a grid of circles, their
corners or centres in images, and which image shows which view to which camera.

A board's own axes: origin at its first inner corner in reading order, x along a row, y up the page, z out of the page. A
chessboard has its black corner square at the upper left; to be distinguished from itself after half a turn, it must have an
even number of corners one way and an odd number the other. Corners are found to a few hundredths of a pixel.

A list of views is a CSV file: a column ``view`` with names, and a column for each camera, named as the camera, with images
relative to the file, empty where that camera did not see the view.

Axes: N corners of the board, n seen corners, k places around a corner.
"""

import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from doo_ti.io.arrays import read_csv
from doo_ti.system.errors import InputError
from doo_ti.vision.calibration import Sighting
from doo_ti.vision.cameras import check_camera_names

FORMS = ("chessboard:9x6:10 (inner corners, square in mm), charuco:9x6:10:7 (squares, square and marker in mm), circles:9x6:10 "
         "(circles, from one to the next in mm) or acircles:4x11:10 (circles in staggered rows, from row to row in mm)")
DICTIONARY = "DICT_4X4_50"


@dataclass(frozen=True)
class Board:
    """A flat board with inner corners at known places.

    Raises InputError for a board too small, one that looks the same after half a turn, markers that do not fit into the
    squares, and a dictionary that is unknown or has too few markers.
    """

    columns: int  # inner corners of a chessboard, **squares** of a ChArUco board, circles, as OpenCV counts them
    rows: int
    square: float  # edge of a square, or distance of circles; in staggered rows the distance from row to row, mm
    marker: float | None = None  # edge of a marker, mm; None for a chessboard
    dictionary: str = DICTIONARY  # of the markers, as ``cv2.aruco`` names it
    circles: str = ""  # "" for squares; "circles", or "acircles" for staggered rows

    def __post_init__(self) -> None:
        size = f"{self.columns} x {self.rows}"
        if min(self.columns, self.rows) < 3:
            raise InputError("Board", "columns, rows", f"{size} is too small", "use a board of at least 3 x 4")
        if not 0 < self.square < np.inf:
            raise InputError("Board", "square", f"squares of {self.square:g} mm", "give the edge of a square in mm")
        if self.marker is not None:
            self._check_markers()
        elif self.circles:
            if self.circles == "acircles" and self.rows % 2 == 0:
                raise InputError("Board", "columns, rows", f"{size} staggered circles look the same after half a turn",
                                 "use an odd number of rows")
        elif (self.columns + self.rows) % 2 == 0:
            raise InputError("Board", "columns, rows", f"{size} corners look the same after half a turn",
                             "use a board with one number even and the other odd, or ChArUco")

    def _check_markers(self) -> None:
        if not 0 < self.marker < self.square:
            raise InputError("Board", "marker", f"markers of {self.marker:g} mm in squares of {self.square:g} mm",
                             "give the edge of a marker in mm, smaller than a square")
        import cv2

        if not (self.dictionary.startswith("DICT_") and hasattr(cv2.aruco, self.dictionary)):
            known = [name for name in dir(cv2.aruco) if name.startswith("DICT_")]
            raise InputError("Board", "dictionary", f"dictionary {self.dictionary!r}", f"use one of {', '.join(known)}")
        wanted, there = self.columns * self.rows // 2, len(self._markers().bytesList)
        if wanted > there:
            raise InputError("Board", "dictionary", f"{wanted} markers, but {self.dictionary} has {there}",
                             "name a larger dictionary")

    def _markers(self):
        import cv2

        return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))

    @property
    def corners(self) -> tuple[int, int]:
        """Columns and rows of inner corners."""
        less = 0 if self.marker is None else 1
        return self.columns - less, self.rows - less

    @property
    def points(self) -> np.ndarray:
        """(N, 3) mm: the inner corners in the board's own axes, row by row."""
        columns, rows = self.corners
        row, column = np.divmod(np.arange(columns * rows), columns)
        if self.circles == "acircles":
            column = 2 * column + row % 2
        return np.stack([self.square * column, -self.square * row, np.zeros(len(row))], axis=-1)

    def opencv(self):
        """The ``cv2.aruco.CharucoBoard``; its ``generateImage`` draws the board for printing."""
        import cv2

        return cv2.aruco.CharucoBoard((self.columns, self.rows), self.square, self.marker, self._markers())


def parse_board(text: str) -> Board:
    """The board that the text of ``--board`` describes, ``chessboard:9x6:10``, ``charuco:9x6:10:7[:DICTIONARY]``,
    ``circles:9x6:10`` or ``acircles:4x11:10``; InputError for anything else."""
    number = r"(\d+(?:\.\d*)?|\.\d+)"
    match = re.fullmatch(rf"(chessboard|charuco|a?circles):(\d+)x(\d+):{number}(?::{number}(?::(\w+))?)?", text)
    if match is None or (match[1] == "charuco") != (match[5] is not None):
        raise InputError("board", "board", f"{text!r}", f"give {FORMS}")
    kind, columns, rows, square, marker, dictionary = match.groups()
    circles = kind if kind.endswith("circles") else ""
    marker = None if marker is None else float(marker)
    try:
        return Board(int(columns), int(rows), float(square), marker, dictionary or DICTIONARY, circles)
    except InputError as error:
        raise InputError("board", "board", error.problem, error.remedy) from None


# --- where the corners lie in an image ---------------------------------------------------------------------------------

REACH = 0.4  # half the window around a corner, in squares
EDGE_PX = 1.5  # reach of the blur of an edge: places this near to a marker are left out
ROUNDS = 8
MOST_MOVE = 0.2  # A corner that refinement moves further than this, in squares, is rejected
FEWEST = 6
NOTHING = np.zeros(0, dtype=np.int64), np.zeros((0, 2))


def find_corners(image: np.ndarray, board: Board) -> tuple[np.ndarray, np.ndarray]:
    """(n,) rows of ``board.points`` that are seen in a grey ``image`` (height, width) uint8, and (n, 2) their pixels.

    Of a chessboard or circles either all are found or none; of a ChArUco board any six or more that are not all on one line.
    """
    import cv2

    if board.circles:
        return _circles(image, board)
    found, rough = _chessboard(image, board) if board.marker is None else _charuco(image, board)
    if len(found) < FEWEST or np.linalg.matrix_rank(board.points[found, :2] - board.points[found[0], :2]) < 2:
        return NOTHING
    plane = board.points[found, :2]
    homography = cv2.findHomography(plane, rough, cv2.RANSAC, 3.0)[0]
    if homography is None:
        return NOTHING
    pixels, sound = _refined(image, rough, _scale(homography, plane), board)
    return found[sound], pixels[sound]


def _chessboard(image: np.ndarray, board: Board) -> tuple[np.ndarray, np.ndarray]:
    """All corners or none, in the board's own order, to about a pixel."""
    import cv2

    size = board.corners
    seen, corners = cv2.findChessboardCorners(
        image, size, flags=cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK)
    if not seen:
        seen, corners = cv2.findChessboardCornersSB(image, size, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
    if not seen:
        return NOTHING
    grid = _from_the_front(corners, size)
    # The square between the first four corners is black, as is the board's at the upper left.
    middle = (grid[:-1, :-1] + grid[:-1, 1:] + grid[1:, :-1] + grid[1:, 1:]) / 4
    place = np.clip(np.round(middle).astype(int), 0, [image.shape[1] - 1, image.shape[0] - 1])
    grey = image[place[..., 1], place[..., 0]].astype(np.float64)
    even = np.add.outer(np.arange(size[1] - 1), np.arange(size[0] - 1)) % 2 == 0
    if grey[even].mean() > grey[~even].mean():
        grid = grid[::-1, ::-1]
    return np.arange(size[0] * size[1]), grid.reshape(-1, 2)


def _from_the_front(corners: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """(rows, columns, 2) px, turned over where the board would be seen from behind."""
    grid = np.asarray(corners, dtype=np.float64).reshape(size[1], size[0], 2)
    # Seen from the front, x to the right and y up the page turn counterclockwise; pixels have y downwards.
    along, down = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
    return grid[:, ::-1] if along[0] * down[1] - along[1] * down[0] < 0 else grid


def _circles(image: np.ndarray, board: Board) -> tuple[np.ndarray, np.ndarray]:
    """All centres or none, in the board's own order. A grid without staggered rows looks the same after half a turn: rows then
    run rightwards in the image."""
    import cv2

    size, staggered = board.corners, board.circles == "acircles"
    seen, centres = cv2.findCirclesGrid(
        image, size, flags=cv2.CALIB_CB_ASYMMETRIC_GRID if staggered else cv2.CALIB_CB_SYMMETRIC_GRID)
    if not seen:
        return NOTHING
    grid = np.asarray(centres, dtype=np.float64).reshape(size[1], size[0], 2)
    if not staggered:
        grid = _from_the_front(centres, size)
        if grid[0, -1, 0] < grid[0, 0, 0]:
            grid = grid[::-1, ::-1]
    return np.arange(size[0] * size[1]), grid.reshape(-1, 2)


def _charuco(image: np.ndarray, board: Board) -> tuple[np.ndarray, np.ndarray]:
    """The corners beside recognised markers, to about a pixel."""
    import cv2

    corners, found = cv2.aruco.CharucoDetector(board.opencv()).detectBoard(image)[:2]
    if found is None or len(found) == 0:
        return NOTHING
    return np.asarray(found, dtype=np.int64).reshape(-1), np.asarray(corners, dtype=np.float64).reshape(-1, 2)


def _scale(homography: np.ndarray, plane: np.ndarray) -> np.ndarray:
    """(n, 2, 2) px per mm around (n, 2) points of the board."""
    image = np.column_stack([plane, np.ones(len(plane))]) @ homography.T
    pixel = image[:, :2] / image[:, 2:]
    return (homography[None, :2, :2] - pixel[:, :, None] * homography[None, 2:, :2]) / image[:, 2, None, None]


def _refined(image: np.ndarray, rough: np.ndarray, scale: np.ndarray, board: Board) -> tuple[np.ndarray, np.ndarray]:
    """(n, 2) px where the edges around each corner intersect, and (n,) whether they do so near ``rough``.

    Gradients g at places q around a corner p are normal to edges through p: Σ w g gᵀ (q − p) = 0.
    """
    import cv2

    offset, weight = _window(scale, board)
    slope = [cv2.Scharr(image, cv2.CV_32F, *order) for order in ((1, 0), (0, 1))]
    pixels, spread = rough.copy(), offset @ np.swapaxes(scale, 1, 2)
    for _ in range(ROUNDS):
        at = (pixels[:, None] + spread).astype(np.float32)
        gradient = np.stack([cv2.remap(part, at, None, cv2.INTER_LINEAR, borderValue=0) for part in slope], axis=-1)
        outer = np.einsum("nk,nki,nkj->nij", weight, gradient, gradient, dtype=np.float64)
        moment = np.einsum("nk,nki,nkj,nkj->ni", weight, gradient, gradient, spread, dtype=np.float64)
        weak, strong = np.moveaxis(np.linalg.eigvalsh(outer), -1, 0)
        crossing = weak > 1e-3 * strong + 1e-9
        outer[~crossing] = np.eye(2)
        pixels = pixels + np.where(crossing[:, None], np.linalg.solve(outer, moment[..., None])[..., 0], 0.0)
    moved = np.linalg.norm(np.linalg.solve(scale, (pixels - rough)[..., None])[..., 0], axis=-1)
    return pixels, crossing & (moved < MOST_MOVE * board.square)


def _window(scale: np.ndarray, board: Board) -> tuple[np.ndarray, np.ndarray]:
    """(k, 2) mm around a corner and (n, k) weights there, for n corners with ``scale`` (n, 2, 2) px per mm.

    The places form a square on the board, so that also in a slanted view they exclude neighbouring corners; places near
    markers have no weight.
    """
    reach = REACH * board.square
    steps = int(np.clip(np.ceil(reach * np.linalg.norm(scale, axis=1).max()), 3, 25))
    axis = np.linspace(-reach, reach, 2 * steps + 1)
    offset = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    weight = np.exp(-2 * np.sum((offset / reach) ** 2, axis=-1))[None] * np.ones((len(scale), 1))
    if board.marker is not None:
        # The blur has a constant size in the image, so that in a slanted view it extends further on the board.
        across = np.abs(np.linalg.det(scale))[:, None] / np.linalg.norm(scale, axis=1)[:, ::-1]
        gap = (board.square - board.marker) / 2
        clear = np.maximum(gap - EDGE_PX / across, gap / 3)
        weight *= (np.abs(offset)[None] < clear[:, None]).any(axis=-1)
    return offset, weight


@dataclass(frozen=True)
class Views:
    """V views by C cameras."""

    names: tuple[str, ...]  # of the views
    cameras: tuple[str, ...]  # names of the cameras
    images: dict[tuple[int, int], Path]  # (view, camera) as numbers: the image
    source: str  # the file they come from


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
    from doo_ti.vision.images import read_image

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
