"""Pictures of calibration boards: a printed texture seen through a camera's pose and lens, anti-aliased, with noise."""

from functools import lru_cache

import cv2
import numpy as np

from doo_ti import Camera, Rig
from doo_ti.vision.board import Board
from doo_ti.vision.calibration import Sighting
from tests.vision.scenes import looking

OVERSAMPLING = 3


def texture(board: Board, texels: int) -> tuple[np.ndarray, float]:
    """The printed board, ``texels`` to a mm, with a white margin of one square, 0 to 1, and the mm from its edge to the first
    corner."""
    side = round(board.square * texels)
    if board.marker is None:
        rows, columns = np.indices((board.rows + 1, board.columns + 1))
        printed = np.kron(np.where((rows + columns) % 2, 255, 0).astype(np.uint8), np.ones((side, side), np.uint8))
    else:
        printed = board.opencv().generateImage((board.columns * side, board.rows * side), marginSize=0, borderBits=1)
    return np.pad(printed, side, constant_values=255).astype(np.float32) / 255, 2 * board.square


def look(board: Board, camera: Camera, rotation: np.ndarray, translation: np.ndarray, rng: np.random.Generator,
         noise: float = 2.0) -> np.ndarray:
    """(height, width) uint8: what ``camera`` sees of the board at the world pose x = R p + t."""
    texels = camera.width // 160  # about as many as rays: of finer ones a slanted view would miss some
    printed, margin = texture(board, texels)
    fine = np.diag([OVERSAMPLING, OVERSAMPLING, 1]) @ camera.matrix
    fine[:2, 2] += (OVERSAMPLING - 1) / 2
    size = (camera.width * OVERSAMPLING, camera.height * OVERSAMPLING)
    ray_x, ray_y = _rays(tuple(fine.ravel()), tuple(camera.distortion), size)
    turn, place = camera.rotation @ rotation, camera.rotation @ translation + camera.translation
    # A ray s (x, y, 1) = turn p + place meets the board's plane p_z = 0.
    inverse = np.linalg.inv(np.column_stack([turn[:, 0], turn[:, 1], place])).astype(np.float32)
    x, y, w = (row[0] * ray_x + row[1] * ray_y + row[2] for row in inverse)
    column, row = (margin + x / w) * texels - 0.5, (margin - y / w) * texels - 0.5
    seen = cv2.remap(printed, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0.45)
    seen = cv2.resize(seen, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    light = np.linspace(0.85, 1.0, camera.width, dtype=np.float32)
    picture = 25 + 195 * cv2.GaussianBlur(seen, (0, 0), 0.6) * light + rng.normal(0, noise, seen.shape)
    return np.clip(np.round(picture), 0, 255).astype(np.uint8)


@lru_cache(maxsize=8)
def _rays(matrix: tuple, distortion: tuple, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """x and y of the undistorted direction (x, y, 1) of each fine pixel."""
    pixels = np.stack(np.meshgrid(*map(np.arange, size)), axis=-1).astype(np.float32)
    rays = cv2.undistortPoints(pixels.reshape(-1, 1, 2), np.reshape(matrix, (3, 3)), np.array(distortion))
    return cv2.split(rays.reshape(pixels.shape))


def around(width: int = 640, height: int = 480, count: int = 3) -> Rig:
    """``count`` distorted cameras 300 mm from the origin, spread over 120 degrees, all looking at it from above."""
    cameras = []
    for index in range(count):
        azimuth, climb = np.radians(-150 + 120 * index / max(count - 1, 1)), np.radians(50 + 5 * index)
        forward = -np.array([np.cos(azimuth) * np.cos(climb), np.sin(azimuth) * np.cos(climb), np.sin(climb)])
        focal = width * (1.32 + 0.02 * index)
        matrix = [[focal, 0, width / 2 + 4 - 3 * index], [0, focal * 1.002, height / 2 - 5 + index], [0, 0, 1]]
        distortion = [-0.08 + 0.02 * index, 0.03, 5e-4, -4e-4, 0]
        cameras.append(Camera(f"cam{index}", width, height, matrix, distortion, *looking(forward, 300.0)))
    return Rig(tuple(cameras))


def poses(board: Board, count: int, rng: np.random.Generator) -> list[tuple[np.ndarray, np.ndarray]]:
    """World poses of a board: the first flat, its middle at the origin, the others tilted up to 35 degrees and moved."""
    middle = board.points.mean(axis=0)
    found = [(np.eye(3), -middle)]
    while len(found) < count:
        axis = rng.normal(size=3) * [1, 1, 0.5]
        turn = cv2.Rodrigues(axis / np.linalg.norm(axis) * rng.uniform(0.2, 0.6))[0]
        found.append((turn, rng.uniform([-25, -25, -25], [25, 25, 25]) - turn @ middle))
    return found


def sightings(board: Board, rig: Rig, placed: list, noise: float, rng: np.random.Generator,
              sees=lambda view, camera: True) -> list[Sighting]:
    """All corners of the board at each of its poses, in each camera that ``sees`` it, with ``noise`` px."""
    count = len(board.points)
    return [Sighting(view, index, np.arange(count),
                     camera.project(board.points @ turn.T + place) + rng.normal(0, noise, (count, 2)))
            for view, (turn, place) in enumerate(placed) for index, camera in enumerate(rig.cameras) if sees(view, index)]
