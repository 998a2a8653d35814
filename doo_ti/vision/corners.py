"""Where a board's inner corners lie in an image, to a few hundredths of a pixel."""

import numpy as np

from doo_ti.vision.board import Board

REACH = 0.4
"""Half the window around a corner, in squares."""
EDGE_PX = 1.5
"""How far blur carries an edge: what is this near to a marker is left out."""
ROUNDS = 8
MOST_MOVE = 0.2
"""A corner that refinement moves further than this, in squares, was none."""
FEWEST = 6
NOTHING = np.zeros(0, dtype=np.int64), np.zeros((0, 2))


def find_corners(image: np.ndarray, board: Board) -> tuple[np.ndarray, np.ndarray]:
    """(n,) which of ``board.points`` are seen in a grey ``image`` (height, width) uint8, and (n, 2) where, px.

    A chessboard is seen as a whole or not at all; of a ChArUco board any six corners or more, not all on one line.
    """
    import cv2

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
    grid = np.asarray(corners, dtype=np.float64).reshape(size[1], size[0], 2)
    # Seen from the front, x to the right and y up the page turn against the clock; pixels have y downwards.
    along, down = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
    if along[0] * down[1] - along[1] * down[0] < 0:
        grid = grid[:, ::-1]
    # The square between the first four corners is black, as is the board's at the upper left.
    middle = (grid[:-1, :-1] + grid[:-1, 1:] + grid[1:, :-1] + grid[1:, 1:]) / 4
    place = np.clip(np.round(middle).astype(int), 0, [image.shape[1] - 1, image.shape[0] - 1])
    grey = image[place[..., 1], place[..., 0]].astype(np.float64)
    even = np.add.outer(np.arange(size[1] - 1), np.arange(size[0] - 1)) % 2 == 0
    if grey[even].mean() > grey[~even].mean():
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
    """(n, 2) px where the edges around each corner meet, and (n,) whether they do near ``rough``.

    All gradients g at q around a corner p are across edges that run through p: Σ w g gᵀ (q − p) = 0.
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

    A square on the board, so that a slanted view gathers nothing from the neighbours; of markers it keeps away.
    """
    reach = REACH * board.square
    steps = int(np.clip(np.ceil(reach * np.linalg.norm(scale, axis=1).max()), 3, 25))
    axis = np.linspace(-reach, reach, 2 * steps + 1)
    offset = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    weight = np.exp(-2 * np.sum((offset / reach) ** 2, axis=-1))[None] * np.ones((len(scale), 1))
    if board.marker is not None:
        # Blur is of the image: across an edge of the board it reaches further in a slanted view.
        across = np.abs(np.linalg.det(scale))[:, None] / np.linalg.norm(scale, axis=1)[:, ::-1]
        gap = (board.square - board.marker) / 2
        clear = np.maximum(gap - EDGE_PX / across, gap / 3)
        weight *= (np.abs(offset)[None] < clear[:, None]).any(axis=-1)
    return offset, weight
