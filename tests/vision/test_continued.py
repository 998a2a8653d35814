"""Threads with glints, and needles that are wider than their threads, drawn by OpenCV; strands beside each other."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial import cKDTree

from doo_ti.io.scene import load_scene
from doo_ti.perception.virtual_lab import lab_rods
from doo_ti.vision.cameras import Rig
from doo_ti.vision.detect import detect
from doo_ti.vision.render import render_set
from doo_ti.vision.rig_files import load_rig
from doo_ti.vision.tubes import smooth_curve
from tests.vision.test_follow import beside, drawn, shares, wave

SCENES = Path(__file__).resolve().parents[2] / "scenes"
DARK, WHITE = (50, 40, 60), (205, 215, 220)


def grey(*strokes) -> np.ndarray:
    return cv2.cvtColor(drawn(*strokes), cv2.COLOR_BGR2GRAY)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("light", [WHITE, (255, 255, 255), (150, 150, 150)])
def test_a_glint_within_the_thread(light):
    """The thread is wider there, and as light in its middle as the paper."""
    curve = wave()
    image = grey((curve, DARK, 4), (curve[800:1100], DARK, 8), (curve[815:1085], light, 4))
    recall, precision = shares(detect(image).points, curve, 3.5)
    assert recall > 0.97 and precision > 0.98


def test_a_needle_is_wider_than_its_thread():
    curve = wave()
    image = grey((curve[:1700], DARK, 4), (curve[1700:], DARK, 10))
    recall, precision = shares(detect(image).points, curve, 3.0)
    assert recall > 0.97 and precision > 0.98


@pytest.mark.thorough
def test_what_crosses_or_lies_alone_is_not_the_thread():
    """A wider line that begins at no end of the thread."""
    curve, other = wave(), np.stack([np.linspace(300, 330, 200), np.linspace(20, 380, 200)], axis=1)
    found = detect(grey((other, DARK, 13), (curve, DARK, 4)))
    assert (cKDTree(curve).query(found.points)[0] <= 4.0).mean() > 0.97


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
