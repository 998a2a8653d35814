"""Rendered images against the projection they were made with."""

import cv2
import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.ndimage import map_coordinates

from doo_ti.rod.frames import arc_lengths
from doo_ti.vision.render import RenderOptions, render_set
from doo_ti.vision.tubes import Tube, draw, smooth_curve
from tests.conftest import check_refused
from tests.vision.scenes import bow, normals, small_rig

UP, BLANK = np.array([0.0, 0, 1]), np.full((360, 480), 200.0)


def test_the_curve_is_scipys_spline():
    vertices = bow(9) + np.random.default_rng(2).normal(size=(9, 3))
    chord = arc_lengths(vertices)
    place = np.append((chord[:-1, None] + np.diff(chord)[:, None] * np.arange(5) / 5).ravel(), chord[-1])
    found = smooth_curve(np.stack([vertices, 2 * vertices]), 5)[0]
    np.testing.assert_allclose(found, CubicSpline(chord, vertices)(place), atol=1e-10)
    np.testing.assert_allclose(smooth_curve(vertices[:2], 4), np.linspace(*vertices[:2], 5), atol=1e-12)


@pytest.mark.parametrize("diameter", [0.6, 1.3, 5.0])
def test_a_line_lies_and_is_as_wide_as_the_projection_says(diameter):
    """Its centre of mass across, before brightness is rounded, at every place along it."""
    curve = smooth_curve(bow(), 20)
    for camera in small_rig().cameras:
        image = 200 - draw(camera, [Tube(curve, diameter / 2, 50.0)], BLANK, UP, 0.0)
        image = cv2.GaussianBlur(image, (0, 0), 1.0).astype(np.float64)
        line = camera.project(curve)[20:-20:3]
        across = np.arange(-15, 15.01, 0.25)
        at = line[:, None] + across[:, None] * normals(camera.project(curve))[20:-20:3, None]
        spline = map_coordinates(image, [at[..., 1], at[..., 0]], order=3)  # without OpenCV's rounding of places
        mass = spline.sum(axis=1)
        centre = (spline * across).sum(axis=1) / mass
        assert np.abs(centre).max() < 0.02 and abs(centre.mean()) < 5e-3
        np.testing.assert_allclose(mass * 0.25 / 150, diameter * camera.matrix[0, 0] / camera.depth(curve)[20:-20:3], rtol=0.02)


def test_the_nearer_strand_covers_the_farther():
    camera = small_rig(1).cameras[0]
    (run, other, toward), step = camera.rotation, np.linspace(-20, 20, 41)[:, None]
    near, far = step * run - 5 * toward, step * other + 5 * toward
    pixel = tuple(np.rint(camera.project(np.zeros(3))).astype(int)[::-1])
    tubes = [Tube(near, 2.0, 10.0), Tube(far, 2.0, 90.0)]
    for order in (tubes, tubes[::-1]):
        assert draw(camera, order, BLANK, UP, 0.0)[pixel] == pytest.approx(10.0)
    loop = np.concatenate([near, [(near[-1] + far[-1]) / 2 + 30 * run + 30 * other], far[::-1]])
    assert draw(camera, [Tube(loop, 2.0, np.linspace(10, 90, len(loop)))], BLANK, UP, 0.0)[pixel] < 40


def test_the_lit_side_is_brighter():
    camera = small_rig(1).cameras[0]
    curve = np.linspace(-20, 20, 41)[:, None] * camera.rotation[0]
    image = draw(camera, [Tube(curve, 4.0, 50.0)], np.full((360, 480), 50.0), -camera.rotation[1], 100.0)
    column, row = camera.project(np.zeros(3))
    above, below = image[: int(row), int(column)], image[int(row) + 1 :, int(column)]
    assert above.max() > 120 and below.max() < 60


def test_the_same_seed_gives_the_same_images():
    options = RenderOptions(occluders=2, clutter=3)
    first, again, other = (render_set(small_rig(), bow(), 1.3, options, (4, index)) for index in (0, 0, 1))
    np.testing.assert_array_equal(first, again)
    assert np.shape(first) == (2, 360, 480) and first[0].dtype == np.uint8
    assert (np.array(first) != np.array(other)).any()


def test_what_cannot_be_drawn_is_refused():
    for change in ({"blur_px": -1}, {"jpeg_quality": 0}, {"light": (0, 0, 0)}, {"occluded_share": 2}, {"occluders": 10**6}):
        check_refused(": ", RenderOptions, **change)
    for rod, diameter in ((bow()[:1], 1), (bow() * np.nan, 1), (bow()[[0, 0, 1]], 1), (bow(), 0), (bow(), 1e300)):
        check_refused(": ", render_set, small_rig(), rod, diameter)
