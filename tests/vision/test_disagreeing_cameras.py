"""Rigs, boards and labels that do not belong together: what is said of them."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import doo_ti as d
from doo_ti.commands import cameras, doubts
from doo_ti.vision.board import Board, Views
from doo_ti.vision.calibration import Sighting, calibrate
from doo_ti.vision.marks import Marks, observe
from doo_ti.vision.triangulation import MarkStatus, TriangulationOptions, triangulate
from tests.vision.boards import around, poses

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
    pixels = labelled(rng, 6)
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
