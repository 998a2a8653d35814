"""The thread under a pixel, by colour and in masks; with glints, and needles that are wider than their threads: in pictures
drawn by OpenCV, and in photographs that others took."""

from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from scipy.spatial import cKDTree

from doo_ti import DetectionOptions, Rig, detect, detect_mask, follow, load_rig
from doo_ti.io.scene import load_scene
from doo_ti.perception.virtual_lab import lab_rods
from doo_ti.rod.frames import unit_vectors
from doo_ti.vision.render import render_set
from doo_ti.vision.sight import Sight
from doo_ti.vision.tubes import smooth_curve
from tests.conftest import check_refused
from tests.vision.scenes import normals

SIZE = 400, 600
GREEN, YELLOW, RED = (60, 120, 40), (70, 210, 230), (50, 40, 200)
PAPER = (205, 215, 220)


def wave(phase: float = 0.0, scale: float = 1.0) -> np.ndarray:
    """(N, 2) px: a curve through the picture."""
    t = np.linspace(0, 1, 2000)[:, None]
    return scale * np.hstack([60 + 480 * t, 200 + 90 * np.sin(5 * t + phase)])


def beside(curve: np.ndarray, shift: float) -> np.ndarray:
    return curve + shift * normals(curve)


def drawn(*strokes, size=SIZE, seed=0, ground=PAPER) -> np.ndarray:
    """A picture of (curve, colour, width) one on another, blurred, with noise."""
    image = np.full((*size, 3), ground, np.uint8)
    for curve, colour, width in strokes:
        cv2.polylines(image, [np.rint(16 * curve).astype(int)], False, colour, width, cv2.LINE_AA, 4)
    return photographed(image, seed)


def photographed(image: np.ndarray, seed: int) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(0, 3, image.shape)
    return np.clip(cv2.GaussianBlur(image, (0, 0), 0.8) + noise, 0, 255).round().astype(np.uint8)


def shares(points: np.ndarray, true: np.ndarray, near: float = 3.0) -> tuple[float, float]:
    """Recall and precision."""
    if not len(points):
        return 0.0, 0.0
    return tuple(float((cKDTree(a).query(b)[0] <= near).mean()) for a, b in ((points, true), (true, points)))


def test_a_striped_thread_is_followed_at_its_middle_past_others():
    curve = wave()
    image = drawn((beside(curve, -2.5), GREEN, 5), (beside(curve, 2.5), YELLOW, 5), (wave(2.2), RED, 8))
    found = follow(image, tuple(beside(curve, 2.0)[300]))
    assert min(shares(found.points, curve, 1.5)) > 0.97
    assert np.median(cKDTree(curve).query(found.points)[0]) < 0.6 and found.width_px == pytest.approx(11, abs=2.5)
    assert np.linalg.norm(np.diff(found.points, axis=0), axis=1).max() < 1.6  # in order
    assert (found.strength == 0).any() and (found.strength == 0).mean() < 0.1  # where the other one lies on it
    across = normals(curve)[cKDTree(curve).query(found.points)[1]]
    assert np.median(np.abs((across * found.direction).sum(axis=1))) < 0.14


@pytest.mark.thorough
@pytest.mark.parametrize("colour", [RED, YELLOW, (40, 40, 40)])
@pytest.mark.parametrize("aside", [5.0, 8.0])
def test_the_shadow_beside_a_cable_is_no_part_of_it(colour, aside):
    """A soft shadow on one side, at which the click is, too; of a cable in a colour of its own, and of a black one."""
    curve, shadow = wave(), np.zeros(SIZE, np.float32)
    cv2.polylines(shadow, [np.rint(16 * beside(curve, aside)).astype(int)], False, 0.35, 10, cv2.LINE_8, 4)
    light = 1 - cv2.GaussianBlur(shadow, (0, 0), 2.5)
    ground, cable = np.float32(PAPER) * light[..., None], np.zeros(SIZE, np.float32)
    cv2.polylines(cable, [np.rint(16 * curve).astype(int)], False, 1.0, 8, cv2.LINE_AA, 4)
    image = photographed(ground + cable[..., None] * (np.float32(colour) - ground), 3)
    for shift in (0.0, 3.0):
        assert min(shares(follow(image, tuple(beside(curve, shift)[900])).points, curve, 1.7)) > 0.97


@pytest.mark.parametrize("shift", [-2.8, 2.8])
def test_a_cable_round_which_a_stripe_winds_is_followed_at_its_middle(shift):
    """One of its colours is near that of its shadow; clicks on either."""
    curve, width, pixels = wave(), 10, np.stack(np.meshgrid(np.arange(600), np.arange(400)), axis=-1)
    away, at = cKDTree(curve).query(pixels)
    side = ((pixels - curve[at]) * normals(curve)[at]).sum(axis=-1)
    light = 1 - 0.35 * np.exp(-0.5 * ((side - 10) / 5) ** 2) * (away < 40)
    cable = np.where((side < 0.45 * width * np.sin(at / 130))[..., None], (60, 90, 40), (90, 150, 170))
    share = np.clip(width / 2 + 0.5 - away, 0, 1)[..., None]
    image = photographed(np.float32(PAPER) * light[..., None] * (1 - share) + cable * share, 3)
    found = follow(image, tuple(beside(curve, shift)[900]))
    assert min(shares(found.points, curve, 2.0)) > 0.97 and found.width_px == pytest.approx(width, abs=2.0)


@pytest.mark.thorough
@pytest.mark.parametrize("width", [2, 60, 150])
def test_threads_of_any_width(width):
    scale = max(1.0, width / 20)
    curve, size = wave(scale=scale), (int(SIZE[0] * scale), int(SIZE[1] * scale))
    image = drawn((curve, RED, width), size=size)
    for found in (follow(image, tuple(curve[900])), detect(image, DetectionOptions(colour=RED[::-1])), detect(image)):
        recall, precision = shares(found.points, curve, max(1.5, 0.03 * width))
        assert recall > 0.97 and precision > 0.9
        assert found.width_px == pytest.approx(width, abs=3 + 0.1 * width)  # blur widens


def test_a_region_and_a_colour():
    image, curve, region = drawn((wave(), RED, 6), (wave(2.2), GREEN, 12)), wave(), (100, 20, 300, 350)
    assert shares(detect(image, DetectionOptions(colour=RED[::-1])).points, curve)[1] > 0.97
    for part in (detect(image, DetectionOptions(colour=RED[::-1], region=region)),
                 follow(image, tuple(curve[600]), DetectionOptions(region=region))):
        assert part.count and (part.points >= [99, 19]).all() and (part.points <= [401, 371]).all()
        assert shares(part.points, curve)[1] > 0.99


@pytest.mark.thorough
def test_more_points_than_opencv_samples_at_once():
    image = np.full((1000, 1000), 200, np.uint8)
    for row in range(10, 1000, 14):
        cv2.line(image, (20, row), (980, row), 60, 2, cv2.LINE_AA)
    assert detect(image).count > 40_000


@pytest.mark.sampled(1)
@pytest.mark.parametrize("rough", [0, 25])
@pytest.mark.parametrize("width", [3, 9, 40])
def test_the_centre_line_of_a_mask(width, rough):
    """The mask is smoothed noise and threshold, so that its border is rough."""
    curve, pixels = wave(), np.stack(np.meshgrid(np.arange(600), np.arange(400)), axis=-1)
    distance = cKDTree(curve).query(pixels, distance_upper_bound=2.0 * width)[0]
    noise = cv2.GaussianBlur(np.random.default_rng(1).normal(0, rough, SIZE), (0, 0), 1) / 25
    found, caps = detect_mask(distance + noise < width / 2), np.linspace(0, width / 2, 99)[:, None]
    tips = [curve[end] + caps * unit_vectors(curve[end] - curve[beside]) for end, beside in ((0, 1), (-1, -2))]
    assert min(shares(found.points, np.concatenate([curve, *tips]), 1.5 if width < 40 else 3)) > 0.97
    assert found.width_px == pytest.approx(width, abs=1.5) and found.width.shape == (found.count,)


def test_a_mask_gives_the_same_points_on_any_number_of_threads():
    mask, before = np.zeros(SIZE, np.uint8), cv2.getNumThreads()
    cv2.polylines(mask, [np.rint(wave()).astype(int)], False, 1, 20)
    found = detect_mask(mask)
    try:
        cv2.setNumThreads(1)
        np.testing.assert_array_equal(detect_mask(mask).points, found.points)
    finally:
        cv2.setNumThreads(before)


def test_labels_are_a_mask_and_nothing_is_none():
    labels = np.zeros(SIZE, np.uint8)
    for label, phase in enumerate((0, 2.2), 1):
        cv2.polylines(labels, [np.rint(16 * wave(phase)).astype(int)], False, label, 7, cv2.LINE_8, 4)
    assert min(shares(detect_mask(labels).points, np.concatenate([wave(), wave(2.2)]))) > 0.97
    assert detect_mask(np.zeros(SIZE, np.uint8)).count == 0 and detect_mask(np.ones(SIZE, bool)).count < 2000
    assert follow(np.full((*SIZE, 3), 90, np.uint8), (200, 200)).count == 0


@pytest.mark.parametrize("call, word", [
    (lambda image: follow(image, (-9, 3)), "pixel"), (lambda image: follow(image[..., :2], (3, 3)), "image"),
    (lambda image: follow(image, (np.nan, 3)), "pixel"), (detect_mask, "mask"),
    (lambda image: detect(image, DetectionOptions(colour=(1, 2))), "colour"),
    (lambda image: detect(image, DetectionOptions(colour=(1, 2, 300))), "colour"),
    (lambda image: detect(image, DetectionOptions(region=(0, 0, 5, 50))), "region"),
    (lambda image: detect(image, DetectionOptions(region=(590, 0, 50, 50))), "region")])
def test_bad_input_is_refused(call, word):
    check_refused(word, call, drawn((wave(), RED, 6)))


@pytest.mark.thorough
@pytest.mark.parametrize("kind, recall, precision", [("simple", 0.8, 0.8), ("hard", 0.7, 0.8)])
def test_cables_in_photographs(shared_data, kind, recall, precision):
    """Masks of this set are strokes along splines, up to a few px beside the cables. Clicks are where no other cable hides
    the one."""
    of_masks, of_clicks = [], []
    for picture in sorted((shared_data / "photographs").glob(f"{kind}_*.jpg")):
        masks = [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) > 0
                 for path in sorted(picture.parent.glob(f"{picture.stem}_mask_[0-9].png"))]
        for mask in masks:
            inner = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
            middle = np.argwhere(inner >= 0.8 * np.median(inner[mask]) * 2)[:, ::-1]
            alone = middle[np.sum(masks, axis=0)[middle[:, 1], middle[:, 0]] == 1]
            followed = follow(cv2.imread(str(picture)), tuple(alone[len(alone) // 2]))
            of_masks.append(shares(detect_mask(mask).points, middle))
            of_clicks.append(shares(followed.points, middle))
    assert np.mean(of_masks, axis=0).min() > 0.97 and (np.mean(of_clicks, axis=0) > [recall, precision]).all()


SCENES = Path(__file__).resolve().parents[2] / "scenes"
DARK = 50, 40, 60


def grey(*strokes) -> np.ndarray:
    return cv2.cvtColor(drawn(*strokes), cv2.COLOR_BGR2GRAY)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("near, parts", [(3.0, [(0, 1700, DARK, 4), (1700, 2000, DARK, 10)]), *(
    (3.5, [(0, 2000, DARK, 4), (800, 1100, DARK, 8), (815, 1085, light, 4)]) for light in (PAPER, (255,) * 3, (150,) * 3))])
def test_a_needle_wider_than_its_thread_and_a_glint_within_it(near, parts):
    """At a glint the thread is wider, and as light in its middle as the paper."""
    image = grey(*((wave()[first:last], colour, width) for first, last, colour, width in parts))
    recall, precision = shares(detect(image).points, wave(), near)
    assert recall > 0.97 and precision > 0.98


@pytest.mark.parametrize("width", [24, 48])
def test_a_shiny_cable_is_found_at_its_middle(width):
    """It glints along most of its length, beside its middle, and is lighter there than the paper."""
    curve = wave()
    glints = [(beside(curve, 0.2 * width)[first:last], (255,) * 3, width // 4) for first, last in ((100, 900), (1100, 1900))]
    image = drawn((curve, (40, 40, 45), width), *glints, ground=(150, 160, 170))
    for found in (detect(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)), follow(image, tuple(beside(curve, -0.4 * width)[700]))):
        assert found.polarity == "dark" and found.width_px == pytest.approx(width, abs=3.0)
        assert min(shares(found.points, curve, 2.0 + width)[1], shares(found.points, curve[40:-40], 2.0)[0]) > 0.98


@pytest.mark.parametrize("width", [12, 48])
def test_a_wide_thread_is_found_as_exactly_as_a_narrow_one(width):
    """Its two halves differ, as lit from one side: the middle is between its edges."""
    curve = wave()
    found = detect(drawn(*[(beside(curve, sign * width / 4), (level,) * 3, width // 2) for sign, level in ((-1, 40), (1, 90))]))
    assert found.width_px == pytest.approx(width, abs=3.0)
    assert np.median(cKDTree(curve).query(found.points)[0]) < 0.25 and shares(found.points, curve)[0] > 0.98


@pytest.mark.thorough
def test_what_crosses_or_lies_alone_is_not_the_thread():
    """A wider line that begins at no end of the thread."""
    curve, other = wave(), np.stack([np.linspace(300, 330, 200), np.linspace(20, 380, 200)], axis=1)
    assert shares(detect(grey((other, DARK, 13), (curve, DARK, 4))).points, curve, 4.0)[1] > 0.97


@pytest.mark.thorough
@pytest.mark.parametrize("apart", [4.0, 6.0])
def test_strands_side_by_side_are_two_lines(apart):
    """Where they touch, nothing is put between them."""
    curve = wave()
    aside = apart / 2 + 4.0 * np.abs(np.linspace(-1, 1, len(curve)))[:, None]
    pair = [beside(curve, sign * aside) for sign in (-1, 1)]
    found = detect(grey(*((line, DARK, 4) for line in pair)))
    assert not (cKDTree(curve).query(found.points)[0] < 1.0).any()
    assert shares(found.points, np.concatenate(pair), 2.0)[1] > 0.93


@pytest.mark.thorough
@pytest.mark.parametrize("seed", [0, 5, 7])
def test_a_narrow_loop_is_no_glint(seed):
    """A rod that crosses itself, seen from beside it: two strands three widths apart, on which a line between them ends."""
    rods = lab_rods(load_scene(SCENES / "silk.toml").observations)
    rig = Rig(load_rig(SCENES / "rig.yaml").cameras[2:])
    curve = smooth_curve(rods.curve[rods.names.index("silk_54mm_150deg")], 8)
    recall, precision = shares(detect(render_set(rig, curve, 0.5, seed=seed)[0]).points, rig.project(curve)[0], 2.0)
    assert recall > 0.99 and precision > 0.97


def test_a_cable_lit_from_one_side_is_seen_whole_by_its_colour(tmp_path):
    """Of its colour at the click, of which less than a third is left on the other side, there is a strip only."""
    camera = SimpleNamespace(name="left", width=SIZE[1], height=SIZE[0], turned=False)
    curve, file = wave(), tmp_path / "left.png"
    strips = [(beside(curve, 2 * k - 9), tuple(np.multiply((20, 16, 190), 1 - 0.08 * k)), 3) for k in range(10)]
    cv2.imwrite(str(file), drawn(*strips, ground=(100, 100, 100)))
    sight, _ = Sight(clicks=({0: tuple(curve[900])},), by_colour=True).of_set(0, [file], [camera])
    found = sight.detected(file, camera)
    assert min(shares(found.points, curve, 2.0)) > 0.9 and 18 < found.width_px < 26
