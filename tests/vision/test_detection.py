"""The thread's centre line in rendered images; rendered images against the projection they were made with."""

import cv2
import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree

from doo_ti import DetectionOptions, detect, detect_mask, load_rig
from doo_ti.rod.frames import arc_lengths
from doo_ti.vision.images import read_image
from doo_ti.vision.render import RenderOptions, render_set
from doo_ti.vision.tubes import Tube, draw, smooth_curve
from tests.conftest import check_refused
from tests.vision.scenes import against, bow, normals, small_rig

PLAIN = RenderOptions(noise=2, shading=0, jpeg_quality=None)
LINE = smooth_curve(bow(), 20)


def errors(options: RenderOptions, diameter: float, detection: DetectionOptions = DetectionOptions()):
    """Errors, completeness and false points over the small rig's images, and the last detection."""
    found = [detect(image, detection) for image in render_set(small_rig(), bow(), diameter, options, 7)]
    error, complete, false = zip(*[against(one, camera.project(LINE)) for one, camera in zip(found, small_rig().cameras)])
    return np.concatenate(error), min(complete), max(false), found[-1]


@pytest.mark.sampled(2)
@pytest.mark.parametrize("options, diameter, polarity", [
    (PLAIN, 1.3, "dark"), (RenderOptions(thread=180, background=50, shading=0), 1.3, "light"), (PLAIN, 4.0, "dark")])
def test_the_centre_line_is_found(options, diameter, polarity):
    error, complete, false, found = errors(options, diameter)
    assert abs(error.mean()) < 0.03 and np.median(np.abs(error)) < 0.05 and np.quantile(np.abs(error), 0.95) < 0.15
    assert complete > 0.98 and false < 0.01
    assert found.polarity == polarity and found.width_px == pytest.approx(diameter * 600 / 250, abs=1.0)


@pytest.mark.thorough
def test_directions_are_tangents_and_points_are_dense():
    found = errors(PLAIN, 1.3)[-1]
    line = small_rig().cameras[-1].project(smooth_curve(bow(), 200))
    nearest = cKDTree(line).query(found.points)[1]
    assert np.median(np.abs((normals(line)[nearest] * found.direction).sum(axis=1))) < np.sqrt(1 - 0.999**2)
    assert np.diff(np.sort(arc_lengths(line)[nearest])).max() < 1.15


def test_a_thread_lit_from_the_side_is_found_between_its_edges():
    """The ridge of its brightness is further from its middle."""
    lit = RenderOptions(thread=120, background=20, shading=80, light=(0, 1, -0.3), noise=0, jpeg_quality=None)
    error, complete, _, _ = errors(lit, 4.0)
    assert complete > 0.95 and np.median(np.abs(error)) < 0.15


@pytest.mark.parametrize("way", [1, -1])
def test_a_colour_selects_a_thread_lit_from_the_side_and_its_edges_say_where_it_is(way):
    row, column = np.mgrid[:200, :300]
    off = row - (100 + 30 * np.sin(column / 60))
    around = np.clip(off / 6, -1, 1)
    shade = np.clip(0.3 + 0.7 * (0.6 * np.sqrt(1 - around**2) - 0.8 * way * around), 0.3, 1.0)[..., None]
    inside = np.clip(6.5 - np.abs(off), 0, 1)[..., None]
    image = (inside * shade * [50, 60, 210] + (1 - inside) * [225, 230, 235]).round().astype(np.uint8)
    found = detect(cv2.GaussianBlur(image, (0, 0), 0.8), DetectionOptions(colour=(190, 55, 45)))
    x, y = found.points.T
    error = (y - (100 + 30 * np.sin(x / 60))) / np.hypot(1, 0.5 * np.cos(x / 60))
    assert len(x) > 250 and abs(np.median(error)) < 0.2 and found.width_px == pytest.approx(11, abs=1.5)


def test_the_papers_way_is_as_exact_as_pixels():
    error, complete, false, found = errors(PLAIN, 1.3, DetectionOptions(method="canny"))
    assert abs(error.mean()) < 0.1 and np.quantile(np.abs(error), 0.95) < 0.9 and complete > 0.95 and false < 0.01
    assert (found.points == np.rint(found.points)).all() and found.method == "canny"


def test_gaps_stay_gaps():
    error, complete, false, _ = errors(RenderOptions(occluders=2, shading=0), 1.3)
    assert 0.5 < complete < 0.97 and false < 0.02 and np.median(np.abs(error)) < 0.1


def test_polarity_and_width_may_be_given():
    error, complete, _, found = errors(PLAIN, 1.3, DetectionOptions(polarity="dark", width_px=3.3))
    assert complete > 0.98 and found.width_px == 3.3
    image = render_set(small_rig(), bow(), 1.3, PLAIN)[0]
    assert detect(image, DetectionOptions(polarity="light")).count == 0
    assert detect(image, DetectionOptions(least_contrast=250)).count == 0


@pytest.mark.parametrize("image", [
    np.full((120, 160), 128, np.uint8), np.repeat(150 * (np.arange(160) > 60), 120).reshape(160, 120).astype(np.uint8),
    cv2.GaussianBlur(cv2.circle(np.full((360, 480), 200, np.uint8), (200, 180), 80, 60, -1), (0, 0), 1),
    np.random.default_rng(1).normal(128, 12, (360, 480)).clip(0, 255).astype(np.uint8)],
    ids=["blank", "a border", "a disc", "noise"])
def test_where_there_is_no_thread_none_is_found(image):
    found = detect(image)
    assert found.count == 0 and found.polarity == "" and np.isnan(found.width_px) and found.shape == image.shape


def test_images_in_files(laboratory):
    folder = laboratory / "images_a"
    rig, truth = load_rig(folder / "rig.yaml"), np.load(folder / "truth.npz")
    curves = zip(truth["names"][::3], smooth_curve(truth["vertices_mm"], 20)[::3], strict=True)
    parts = [against(detect(read_image(folder / f"{name}_{camera.name}.jpg", camera)), camera.project(curve))
             for name, curve in curves for camera in rig.cameras]
    error, complete, false = zip(*parts)
    error = np.concatenate(error)
    assert abs(error.mean()) < 0.01 and np.median(np.abs(error)) < 0.05 and np.quantile(np.abs(error), 0.95) < 0.1
    assert min(complete) > 0.98 and max(false) < 0.01


@pytest.mark.parametrize("change", [{"method": "sobel"}, {"polarity": "grey"}, {"width_px": 0}, {"width_px": 1e9},
                                    {"least_contrast": np.nan}])
def test_bad_options_are_refused(change):
    check_refused(next(iter(change)), DetectionOptions, **change)
    check_refused("image", detect, np.zeros((10, 10, 3)))


EXACT = RenderOptions(noise=0, jpeg_quality=None, unevenness=0, shading=0)
UP = np.array([0.0, 0, 1])


def test_the_curve_is_scipys_spline():
    vertices = bow(9) + np.random.default_rng(2).normal(size=(9, 3))
    chord = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(vertices, axis=0), axis=1))])
    place = np.append((chord[:-1, None] + np.diff(chord)[:, None] * np.arange(5) / 5).ravel(), chord[-1])
    found = smooth_curve(np.stack([vertices, 2 * vertices]), 5)[0]
    np.testing.assert_allclose(found, CubicSpline(chord, vertices)(place), atol=1e-10)
    np.testing.assert_allclose(smooth_curve(vertices[:2], 4), np.linspace(*vertices[:2], 5), atol=1e-12)


@pytest.mark.parametrize("diameter", [0.6, 1.3, 5.0])
def test_a_line_lies_and_is_as_wide_as_the_projection_says(diameter):
    """Its centre of mass across, before brightness is rounded, at every place along it."""
    curve = smooth_curve(bow(), 20)
    for camera in small_rig().cameras:
        image = 200 - draw(camera, [Tube(curve, diameter / 2, 50.0)], np.full((360, 480), 200.0), UP, 0.0)
        image = cv2.GaussianBlur(image, (0, 0), 1.0).astype(np.float64)
        line, across = camera.project(curve)[20:-20:3], np.arange(-15, 15.01, 0.25)
        at = line[:, None] + across[:, None] * normals(camera.project(curve))[20:-20:3, None]
        spline = map_coordinates(image, [at[..., 1], at[..., 0]], order=3)  # without OpenCV's rounding of places
        mass = spline.sum(axis=1)
        centre = (spline * across).sum(axis=1) / mass
        assert np.abs(centre).max() < 0.02 and abs(centre.mean()) < 5e-3
        wanted = diameter * camera.matrix[0, 0] / camera.depth(curve)[20:-20:3]
        np.testing.assert_allclose(mass * 0.25 / 150, wanted, rtol=0.02)


def test_the_nearer_strand_covers_the_farther():
    camera = small_rig(1).cameras[0]
    toward = camera.rotation[2]
    run, other = camera.rotation[0], camera.rotation[1]
    step = np.linspace(-20, 20, 41)[:, None]
    near, far = step * run - 5 * toward, step * other + 5 * toward
    pixel = tuple(np.rint(camera.project(np.zeros(3))).astype(int)[::-1])
    for tubes in ([Tube(near, 2.0, 10.0), Tube(far, 2.0, 90.0)], [Tube(far, 2.0, 90.0), Tube(near, 2.0, 10.0)]):
        assert draw(camera, tubes, np.full((360, 480), 200.0), UP, 0.0)[pixel] == pytest.approx(10.0)
    loop = np.concatenate([near, [(near[-1] + far[-1]) / 2 + 30 * run + 30 * other], far[::-1]])
    one = draw(camera, [Tube(loop, 2.0, np.linspace(10, 90, len(loop)))], np.full((360, 480), 200.0), UP, 0.0)
    assert one[pixel] < 40


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


@pytest.mark.parametrize("width", [4, 7, 13, 24, 40])
@pytest.mark.parametrize("cap", ["flat", "round"])
def test_lines_end_at_the_tips_of_threads(width, cap, rng):
    """Bands drawn by supersampling, at any angle and phase; of grey pictures and of masks."""
    finer = 8 if width < 20 else 3
    for _ in range(3):
        side, angle = 9 * width + 80, rng.uniform(0, np.pi)
        axis, place = np.array([np.cos(angle), np.sin(angle)]), (np.arange(finer * side) + 0.5) / finer - 0.5
        middle, half = side / 2 + rng.uniform(-0.5, 0.5, 2), 3 * width + 20
        x, y = place - middle[0], (place - middle[1])[:, None]
        along, aside = np.abs(x * axis[0] + y * axis[1]), np.abs(y * axis[0] - x * axis[1])
        short = half if cap == "flat" else half - width / 2 + np.sqrt(np.maximum(width**2 / 4 - aside**2, 0))
        inside = ((along <= short) & (aside <= width / 2)).reshape(side, finer, side, finer).mean(axis=(1, 3))
        for found in (detect(200 - 140 * cv2.GaussianBlur(inside, (0, 0), 0.7)), detect_mask(inside > 0.5)):
            reach = (found.points - middle) @ axis
            assert np.abs([reach.max() - half, reach.min() + half]).max() < 0.5 + 0.02 * width
