"""Corners of rendered boards, and rigs from them."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from doo_ti import Camera, Rig
from doo_ti.vision.board import Board, find_corners, parse_board
from doo_ti.vision.calibration import Bundle, Calibration, Sighting, adjusted, calibrate, places
from tests.conftest import check_refused
from tests.vision.boards import around, look, poses, sightings

CHESSBOARD, CHARUCO = Board(9, 6, 10.0), Board(10, 7, 10.0, 7.0)
BOARDS = {"chessboard": CHESSBOARD, "tall chessboard": Board(6, 9, 9.0), "charuco": CHARUCO}


def calibrated(seen: list[Sighting], views: int, rig: Rig = around(), board: Board = CHESSBOARD, **options) -> Calibration:
    """From what cameras with the names and sizes of those of ``rig`` saw."""
    sizes = {camera.name: (camera.width, camera.height) for camera in rig.cameras}
    return calibrate(board.points, seen, sizes, views, **options)


@pytest.mark.thorough
@pytest.mark.parametrize("name", BOARDS)
def test_rendered_boards_give_corners_and_a_rig(name, rng):
    """Each corner in its own place, to a few hundredths of a pixel, also where the board lies upside down; a rig with at most
    0.2 px, centres within 0.3 mm at 300 mm."""
    board, rig, errors, seen = BOARDS[name], around(), [], []
    placed = poses(board, 10, rng)
    placed.append((np.diag([-1.0, -1.0, 1.0]), -placed[0][1] * [1, 1, 0]))
    for view, (turn, place) in enumerate(placed):
        for index, camera in enumerate(rig.cameras):
            found, pixels = find_corners(look(board, camera, turn, place, rng), board)
            errors.append(pixels - camera.project(board.points @ turn.T + place)[found])
            seen += [Sighting(view, index, found, pixels)] if len(found) else []
    errors = np.concatenate(errors)
    assert len(errors) > 0.8 * len(placed) * len(rig.cameras) * len(board.points)
    assert np.sqrt(np.mean(errors**2)) < 0.04 and np.abs(errors).max() < 0.3
    calibration = calibrated(seen, len(placed), board=board)
    assert calibration.overall_rms < 0.2 and calibration.rms[calibration.worst] < 0.2
    for camera, truth in zip(calibration.rig.cameras, rig.cameras):
        assert np.linalg.norm(camera.centre - (truth.centre - placed[0][1])) < 0.3
        assert abs(camera.matrix[0, 0] / truth.matrix[0, 0] - 1) < 2e-3


def test_a_part_of_a_charuco_board_serves(rng):
    camera, (turn, place) = around().cameras[0], poses(CHARUCO, 1, rng)[0]
    image = look(CHARUCO, camera, turn, place, rng)
    image[:, : int(camera.project(CHARUCO.points.mean(axis=0) @ turn.T + place)[0])] = 120
    found, pixels = find_corners(image, CHARUCO)
    assert 6 <= len(found) < 40
    np.testing.assert_allclose(pixels, camera.project(CHARUCO.points @ turn.T + place)[found], atol=0.3)


def test_no_board_no_corners(rng):
    for board in (CHESSBOARD, CHARUCO):
        for image in (np.full((240, 320), 90, np.uint8), rng.integers(0, 255, (240, 320)).astype(np.uint8)):
            found, pixels = find_corners(image, board)
            assert found.shape == (0,) and pixels.shape == (0, 2)


@pytest.mark.parametrize("text, upside_down", [
    ("circles:7x5:12", False), ("acircles:4x11:8", False), ("acircles:4x11:8", True)])
def test_centres_of_circles_in_the_board_s_order(text, upside_down):
    camera = Camera("cam", 640, 480, [[800.0, 0, 320], [0, 800, 240], [0, 0, 1]], np.zeros(5), np.eye(3), np.zeros(3))
    board, image, angle = parse_board(text), np.full((480, 640), 220, np.uint8), np.linspace(0, 2 * np.pi, 60)
    turn = cv2.Rodrigues(np.array([0.0, 0, np.pi * upside_down]))[0] @ cv2.Rodrigues(np.array([np.pi + 0.3, 0.2, 0.1]))[0]
    place = np.array([0, 0, 300.0]) - turn @ board.points.mean(axis=0)
    for centre in board.points:
        rim = centre + 0.3 * board.square * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
        cv2.fillPoly(image, [np.rint(16 * camera.project(rim @ turn.T + place)).astype(int)], 30, cv2.LINE_AA, 4)
    found, pixels = find_corners(image, board)
    assert found.tolist() == list(range(board.columns * board.rows))
    np.testing.assert_allclose(pixels, camera.project(board.points @ turn.T + place), atol=0.4)


def test_boards_from_text():
    assert parse_board("chessboard:9x6:10") == CHESSBOARD
    board = parse_board("charuco:10x7:12.5:9:DICT_5X5_100")
    assert (board.square, board.marker, board.dictionary, board.corners) == (12.5, 9.0, "DICT_5X5_100", (9, 6))
    assert len(board.points) == 54
    np.testing.assert_allclose(board.points[[1, 9]], [[12.5, 0, 0], [0, -12.5, 0]])


@pytest.mark.parametrize("text, word", [
    ("chessboard", "give chessboard"), ("chessboard:9x6", "give chessboard"), ("chessboard:9x6:10:7", "give chessboard"),
    ("chessboard:8x6:10", "half a turn"), ("chessboard:9x7:10", "half a turn"), ("acircles:4x10:8", "half a turn"),
    ("chessboard:2x3:10", "too small"), ("chessboard:9x6:0", "0 mm"), ("charuco:9x6:10:11", "markers of 11 mm"),
    ("charuco:9x6:10:7:DICT_9X9", "dictionary"), ("charuco:20x20:10:7", "200 markers"), ("charuco:7x5:12", "give chessboard"),
    ("circles:7x5:12:8", "give chessboard"), ("circles:7x5", "give chessboard")])
def test_invalid_boards_are_refused(text, word):
    check_refused(word, parse_board, text)


def test_the_world_is_the_first_board_or_the_first_camera(rng):
    rig, placed = around(), poses(CHESSBOARD, 8, rng)
    seen = sightings(CHESSBOARD, rig, placed, 1e-3, rng)
    board = calibrated(seen, 8)
    np.testing.assert_allclose(board.rotations[0], np.eye(3), atol=1e-14)
    np.testing.assert_allclose(board.translations[3], placed[3][1] - placed[0][1], atol=0.02)
    for camera, truth in zip(board.rig.cameras, rig.cameras):
        np.testing.assert_allclose(camera.rotation, truth.rotation, atol=1e-4)
        assert camera.centre[2] > 200  # z points out of the board, to the cameras
    first = calibrated(seen, 8, world="camera")
    np.testing.assert_array_equal(first.rig.cameras[0].rotation, np.eye(3))
    np.testing.assert_array_equal(first.centre_sigma[0], 0)
    # Another choice of axes is the same rig.
    assert first.overall_rms == pytest.approx(board.overall_rms, rel=1e-6)
    between = [np.linalg.norm(c.rig.cameras[2].centre - c.rig.cameras[0].centre) for c in (board, first)]
    assert between[0] == pytest.approx(between[1], abs=1e-4)


@pytest.mark.parametrize(("distortion", "fixed"), [(4, cv2.CALIB_FIX_K3), (5, 0)])
def test_two_cameras_agree_with_opencv(rng, distortion, fixed):
    """Beside cv2.stereoCalibrate, which also adjusts both lenses and all poses."""
    rig = Rig(around().cameras[:2])
    seen = [replace(entry, pixels=entry.pixels.astype(np.float32).astype(float))
            for entry in sightings(CHESSBOARD, rig, poses(CHESSBOARD, 8, rng), 0.2, rng)]
    calibration = calibrated(seen, 8, rig, world="camera", distortion=distortion)
    found = calibration.rig.cameras
    pixels = [[entry.pixels.astype(np.float32) for entry in seen if entry.camera == index] for index in range(2)]
    points = [CHESSBOARD.points.astype(np.float32)] * 8
    lenses = [part for camera in found for part in (camera.matrix.copy(), camera.distortion.copy())]
    result = cv2.stereoCalibrate(points, *pixels, *lenses, (640, 480), flags=cv2.CALIB_USE_INTRINSIC_GUESS | fixed,
                                 criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 300, 1e-12))
    # It stops early: its sum of squares may be slightly larger, and its lenses a tenth of their standard deviations away.
    assert 1 - 1e-9 < result[0] / calibration.overall_rms < 1 + 1e-5
    for camera, matrix in zip(found, (result[1], result[3])):
        np.testing.assert_allclose(camera.matrix, matrix, atol=0.1 * calibration.focal_sigma.min())
    assert (np.abs(found[1].centre - (-result[5].T @ np.ravel(result[6]))) < 0.1 * calibration.centre_sigma[1]).all()


@pytest.mark.thorough
def test_uncertainties_match_the_errors(rng):
    """Over many rigs, errors of centres and focal lengths in units of their standard deviations have mean square 1."""
    rig, scores = around(), []
    for _ in range(12):
        placed = poses(CHESSBOARD, 6, rng)
        found = calibrated(sightings(CHESSBOARD, rig, placed, 0.3, rng), 6)
        assert found.sigma_px == pytest.approx(0.3, rel=0.1)
        for index, (camera, truth) in enumerate(zip(found.rig.cameras, rig.cameras)):
            scores.append((camera.centre - truth.centre + placed[0][1]) / found.centre_sigma[index])
            scores.append((camera.matrix[[0, 1], [0, 1]] - truth.matrix[[0, 1], [0, 1]]) / found.focal_sigma[index])
    assert 0.6 < np.mean(np.concatenate(scores) ** 2) < 1.6


def test_adjustment_comes_back_from_afar(rng):
    rig, placed = around(), poses(CHESSBOARD, 6, rng)
    seen = sightings(CHESSBOARD, rig, placed, 0.0, rng)
    true = Bundle(rig.cameras, *(np.array(part) for part in zip(*placed)))
    free = np.ones(3 * 15 + 6 * 6, dtype=bool)
    lenses, _, of_views = places(3, 6)
    free[lenses[:, 8]] = free[of_views[0]] = False
    push = rng.normal(size=len(free)) * np.where(free, 0.02, 0)
    push[lenses[:, :4]] *= 500
    push[lenses[:, 4:]] *= 0.5
    push[of_views[1:, 3:]] *= 200
    found, covariance = adjusted(true.moved(push), CHESSBOARD.points, seen, free)
    assert sum(np.sum(found.residual(CHESSBOARD.points, sighting) ** 2) for sighting in seen) < 1e-12
    np.testing.assert_allclose(found.cameras[2].centre, rig.cameras[2].centre, atol=1e-5)
    assert (covariance[~free] == 0).all() and (np.diag(covariance)[free] > 0).all()


def test_not_every_camera_sees_every_view(rng):
    """A chain: the first and the last camera share no view, the middle one connects them."""
    seen = sightings(CHESSBOARD, around(), poses(CHESSBOARD, 10, rng), 0.1, rng,
                     lambda view, camera: camera == 1 or (view < 5) == (camera == 0) and view != 7)
    found = calibrated(seen, 10)
    assert found.corners[7].tolist() == [0, 54, 0] and np.isnan(found.rms[7, 0]) and found.overall_rms < 0.2
    check_refused("cam2: .*cam0, cam1", calibrated, [entry for entry in seen if entry.camera != 1 or entry.view < 5], 10)


@pytest.mark.thorough
def test_what_does_not_determine_a_rig_is_refused(rng):
    seen = sightings(CHESSBOARD, around(), poses(CHESSBOARD, 4, rng), 0.1, rng)
    later = [entry for entry in seen if entry.view]
    check_refused("first view", calibrated, later, 4)
    assert calibrated(later, 4, world="camera").overall_rms < 0.2
    check_refused("cam1: .*2", calibrated, [entry for entry in seen if entry.camera != 1 or entry.view < 2], 4)
    check_refused("cam", calibrated, sightings(CHESSBOARD, around(), poses(CHESSBOARD, 1, rng) * 4, 0.1, rng), 4)
