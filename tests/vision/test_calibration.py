"""Corners of rendered boards, and rigs from them; rigs, boards and labels that do not belong together: what is said of them."""

from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

import doo_ti as d
from doo_ti import Camera, Rig
from doo_ti.commands import cameras, doubts
from doo_ti.vision.board import Board, Views, find_corners, parse_board
from doo_ti.vision.calibration import Bundle, Calibration, Sighting, adjusted, calibrate, places
from doo_ti.vision.marks import Marks, observe
from doo_ti.vision.triangulation import MarkStatus, TriangulationOptions, triangulate
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


BOARD, RIG = Board(9, 6, 10.0), around()
SIZES = {camera.name: (camera.width, camera.height) for camera in RIG.cameras}


def seen(rng, views: int, moved_mm: float) -> list[Sighting]:
    """Corners of a board that moves so far before the last camera takes its image."""
    found = []
    for view, (turn, place) in enumerate(poses(BOARD, views, rng)):
        for index, camera in enumerate(RIG.cameras):
            shift = moved_mm * rng.normal(size=3) * (index == len(RIG.cameras) - 1)
            pixels = camera.project(BOARD.points @ turn.T + place + shift)
            found.append(Sighting(view, index, np.arange(len(pixels)), pixels + rng.normal(0, 0.05, pixels.shape)))
    return found


@pytest.mark.parametrize("moved_mm, taller", [(0.0, 1.0), (1.0, 1.0), (0.0, 1.02)])
def test_boards_that_move_between_cameras_or_whose_squares_are_none_are_said(rng, capsys, moved_mm, taller):
    """The rig of one that moves comes out some millimetres off; each camera alone knows of nothing. Images that are ``taller``
    are as those of a board that was printed so."""
    sightings = seen(rng, 9, moved_mm)
    for one in sightings:
        one.pixels[:, 1] *= taller
    found = calibrate(BOARD.points, sightings, SIZES, 9)
    assert found.alone.max() < 0.12
    cameras._doubt_calibration(Views(tuple("abcdefghi"), RIG.names, {}, "views.csv"), found)
    assert ("the board moved between cameras" in (said := capsys.readouterr().err)) == (moved_mm > 0)
    assert said.count("measure the board's squares both ways") == 3 * (taller > 1)


def test_cameras_at_one_place_and_images_that_fit_far_worse_are_doubted(capsys):
    rig = SimpleNamespace(cameras=(RIG.cameras[0],) * 2)
    rms = np.array([[0.1, 0.12], [0.1, 0.9], [0.11, np.nan]])
    twice = SimpleNamespace(rig=rig, rms=rms, focal_sigma=np.ones((2, 2)), alone=np.full(2, 0.1), overall_rms=0.1,
                            centre_sigma=np.full((2, 3), 0.1), covered=np.array([0.7, 0.3]), moved=None)
    cameras._doubt_calibration(Views(tuple("abc"), ("left", "right"), {}, "views.csv"), twice)
    said = capsys.readouterr().err
    assert "left and right are 0 mm apart: are their images the same?" in said
    assert "right: the boards cover 30 % of its images" in said and "left: the boards" not in said
    assert "view b: 0.9 px off, the median image 0.11" in said and said.count("view ") == 1


def test_a_wrong_corner_is_left_out_and_counted(rng):
    """As a marker of a ChArUco board read wrongly gives it: with it the cameras come out 2 mm off."""
    right = seen(rng, 9, 0.0)
    wrong = [Sighting(one.view, one.camera, one.found, one.pixels.copy()) for one in right]
    wrong[5].pixels[20] += [40.0, -25.0]
    found, known = (calibrate(BOARD.points, sightings, SIZES, 9) for sightings in (wrong, right))
    assert found.left_out[1, 2] == found.left_out.sum() == 1 and not known.left_out.any()
    for one, other in zip(found.rig.cameras, known.rig.cameras, strict=True):
        np.testing.assert_allclose(one.centre, other.centre, atol=0.2)


@pytest.mark.parametrize("up, turned, said", [(None, False, True), ((0.0, -1.0, 0.0), False, False), (None, True, False)])
def test_a_world_with_the_axes_of_a_camera_is_said(capsys, up, turned, said):
    camera = RIG.cameras[0]
    camera = camera if turned else replace(camera, rotation=np.eye(3), translation=np.zeros(3))
    doubts.warn_of_axes(SimpleNamespace(up=up, rig="stereo.yml"), d.Rig((camera, RIG.cameras[1])))
    assert ("stereo.yml: the world has the axes of cam0" in capsys.readouterr().err) is said


@pytest.mark.parametrize("moved", [0.0, 0.3])
def test_a_camera_that_moves_between_two_views_is_named(rng, capsys, moved):
    """Boards that move between images in all views alike are not taken for it."""
    views, found = 10, seen(rng, 10, 0.2 if moved else 1.0)
    for one in found:
        if one.camera == 1 and one.view >= 6:
            one.pixels[:] += moved * np.array([5.0, 2.0])
    calibration = calibrate(BOARD.points, found, SIZES, views)
    cameras._doubt_calibration(Views(tuple("abcdefghij"), RIG.names, {}, "views.csv"), calibration)
    assert ("cam1 moved before view g" in capsys.readouterr().err) == bool(moved) == (calibration.moved is not None)


def labelled(rng, rods: int) -> np.ndarray:
    """(3, D, 11, 1, 2) px labels of marks on helices of any pitch."""
    turn = rng.uniform(0.5, 1.5, (rods, 1)) * np.linspace(0, 4, 11) + rng.uniform(0, 6, (rods, 1))
    points = np.stack([20 * np.cos(turn), 20 * np.sin(turn), np.broadcast_to(np.linspace(-30, 30, 11), turn.shape)], axis=-1)
    return (RIG.project(points) + rng.normal(0, 0.5, (3, rods, 11, 2)))[:, :, :, None]


def said_of(pixels: np.ndarray, capsys) -> str:
    marks = Marks(tuple(f"p{row}" for row in range(pixels.shape[1])), pixels, "marks.csv")
    points = triangulate(RIG, pixels.reshape(3, -1, 2))
    if not cameras._doubt_rig(RIG, marks, points, TriangulationOptions()):
        cameras._doubt_labels(RIG, marks, points)
    doubts.say("marks.csv", doubts.exchanged_doubt(observe(marks, points, 8.0)[0]) if points.valid.all() else None)
    return capsys.readouterr().err


def test_what_is_wrong_with_labels_is_named(rng, capsys):
    pixels = labelled(rng, 4)
    assert said_of(pixels, capsys) == ""
    assert "if images had 2 times as many pixels" in said_of(pixels / 2, capsys)
    assert "if cam0 and cam2 are exchanged" in said_of(pixels[[2, 1, 0]], capsys)
    assert "px were stated (pairs of cameras" in said_of(pixels + rng.normal(0, 9.0, pixels.shape), capsys)
    wrong = pixels.copy()
    wrong[1, 3] = wrong[1, 3, ::-1]
    assert "observation p3: labels contradict" in (said := said_of(wrong, capsys)) and "most by cam1" in said
    wrong = pixels.copy()
    wrong[:, 2, [4, 5]] = wrong[:, 2, [5, 4]]
    assert "marks 4 and 5 of observation p2 look exchanged" in said_of(wrong, capsys)


def test_rays_that_meet_nowhere_end_in_a_status():
    """A rig whose poses are read the other way round: the normal equations became singular far off."""
    turns = [[[0.866025, -0.121268, 0.485071], [-0.5, -0.210042, 0.840168], [0, -0.970143, -0.242536]],
             [[0.984808, 0.042116, -0.168463], [0.173648, -0.238851, 0.955404], [0, -0.970143, -0.242536]],
             [[0.642788, 0.185793, -0.743172], [0.766044, -0.155899, 0.623596], [0, -0.970143, -0.242536]]]
    places = [[-225.0, -389.7114, 112.5], [78.1417, -443.1635, 112.5], [344.72, -289.2544, 112.5]]
    rig = d.Rig(tuple(d.Camera(f"cam{k}", 800, 600, [[900 + 7 * k, 0, 392 + 3 * k], [0, 901 + 7 * k, 305], [0, 0, 1]],
                               [-0.12, 0.05, 0.001, -0.0005, 0], turns[k], places[k]) for k in range(3)))
    found = triangulate(rig, np.array([[[394.566, 256.569]], [[411.98, 258.703]], [[430.945, 262.158]]]))
    assert found.status[0] > MarkStatus.OUTLIER_LEFT_OUT and np.isnan(found.position).all()


def test_a_camera_that_disagrees_at_most_marks_is_named(rng, capsys):
    rig = around(count=4)
    points = np.stack([np.linspace(-40, 40, 20), 10 * np.sin(np.arange(20)), 8 * np.cos(np.arange(20))], axis=-1)
    pixels = rig.project(points) + rng.normal(0, 0.3, (4, 20, 2))
    pixels[1] += [6.0, -8.0]
    cameras._doubt_cameras(rig, triangulate(rig, pixels))
    said = capsys.readouterr().err
    assert "cam1 disagrees with the others at" in said and said.count("disagrees") == 1
