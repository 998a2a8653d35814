"""Matching along rows: of a textured picture and the same farther left."""

import cv2
import numpy as np

from doo_ti.vision.detection.line import Detection
from tools.depth_study import disparities


def test_matches_are_as_far_apart_as_the_pictures():
    texture = cv2.GaussianBlur(np.random.default_rng(1).integers(0, 255, (60, 200, 3)).astype(np.uint8), (0, 0), 1.0)
    left, right = texture[:, :160], texture[:, 21:181]
    points = np.stack([np.full(30, 100.0), np.arange(15.0, 45.0)], axis=1)
    across, along = np.tile([0.0, 1.0], (30, 1)), np.tile([1.0, 0.0], (30, 1))
    for way, count in ((across, 30), (along, 0)):  # along a row a place on it is not determined
        line = Detection(points, way, np.ones(30), 3.0, "dark", left.shape[:2], "ridge")
        places, apart = disparities(left, right, line, 5.0, 60.0)
        assert len(places) == count and np.allclose(apart, 21.0, atol=0.1)
    noise = np.random.default_rng(2).integers(0, 255, right.shape).astype(np.uint8)
    line = Detection(points, across, np.ones(30), 3.0, "dark", left.shape[:2], "ridge")
    assert not len(disparities(left, noise, line, 5.0, 60.0)[0])
