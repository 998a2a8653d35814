"""Boards of circles, drawn as polygons that a camera sees."""

import cv2
import numpy as np
import pytest

from doo_ti import Camera, InputError
from doo_ti.vision.cameras.board import find_corners, parse_board

CAMERA = Camera("cam", 640, 480, np.array([[800.0, 0, 320], [0, 800, 240], [0, 0, 1]]), np.zeros(5), np.eye(3), np.zeros(3))


def seen(board, turn: np.ndarray, place: np.ndarray) -> np.ndarray:
    image, around = np.full((480, 640), 220, np.uint8), np.linspace(0, 2 * np.pi, 60)
    for centre in board.points:
        rim = centre + 0.3 * board.square * np.stack([np.cos(around), np.sin(around), 0 * around], axis=1)
        cv2.fillPoly(image, [np.rint(16 * CAMERA.project(rim @ turn.T + place)).astype(int)], 30, cv2.LINE_AA, 4)
    return image


@pytest.mark.parametrize("text, upside_down", [
    ("circles:7x5:12", False), ("acircles:4x11:8", False), ("acircles:4x11:8", True)])
def test_centres_are_found_in_the_board_s_order(text, upside_down):
    board = parse_board(text)
    turn = cv2.Rodrigues(np.array([0.0, 0, np.pi * upside_down]))[0] @ cv2.Rodrigues(np.array([np.pi + 0.3, 0.2, 0.1]))[0]
    place = np.array([0, 0, 300.0]) - turn @ board.points.mean(axis=0)
    found, pixels = find_corners(seen(board, turn, place), board)
    assert found.tolist() == list(range(board.columns * board.rows))
    np.testing.assert_allclose(pixels, CAMERA.project(board.points @ turn.T + place), atol=0.4)


@pytest.mark.parametrize("text", ["acircles:4x10:8", "circles:7x5:12:8", "circles:7x5", "charuco:7x5:12"])
def test_other_boards_are_refused(text):
    with pytest.raises(InputError, match="board"):
        parse_board(text)
