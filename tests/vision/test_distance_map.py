"""Distance maps against every piece of every line, pixel by pixel, and beyond their windows; how wide a lens maps."""

from functools import cache

import numpy as np
import pytest
import taichi as ti

from doo_ti import Camera, Detection, Rig, detect
from doo_ti.rod.frames import normal_to
from doo_ti.vision import sampling
from doo_ti.vision.distance_map import COMPARED_PX, distance_maps
from doo_ti.vision.render import RenderOptions, render_set
from tests.conftest import check_refused
from tests.oracle.reprojection import polyline_distance
from tests.vision.device import every_number, row_kernel
from tests.vision.scenes import bow, line_of, map_of, small_rig, three_cameras

SHAPE = 360, 480


def circle(radius: float) -> Detection:
    """A closed line of dense points around a place between pixels."""
    angle = np.arange(0, 2 * np.pi, 0.7 / radius)
    out = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return line_of(np.array([200.3, 170.6]) + radius * out, normal_to(out), shape=SHAPE)


def pixels_of(window: np.ndarray) -> np.ndarray:
    """(height, width, 2) px."""
    _, left, top, width, height = window
    return np.stack(np.meshgrid(np.arange(left, left + width), np.arange(top, top + height)), axis=-1).astype(float)


def by_force(found: Detection, window: np.ndarray) -> np.ndarray:
    """(height, width) px: the smallest distance to a piece of half a pixel either way."""
    pieces = zip(found.points - found.direction / 2, found.points + found.direction / 2)
    return np.min([polyline_distance(pixels_of(window), np.array(piece)) for piece in pieces], axis=0)


@pytest.mark.thorough
def test_maps_are_the_distance_to_the_nearest_piece():
    rendered = [detect(image) for image in render_set(small_rig(), bow(), 1.3, RenderOptions(occluders=2), 3)]
    sets = [rendered, [circle(40.0), line_of(np.array([[3.2, 4.8]]), np.array([0.6, 0.8]), shape=SHAPE)]]
    maps = distance_maps(sets, 30)
    assert maps.window.shape == (2, 2, 5) and maps.values.dtype == np.float32
    assert len(maps.values) == (maps.window[..., 3] * maps.window[..., 4]).sum()
    for a, c in np.ndindex(2, 2):
        exact, found = by_force(sets[a][c], maps.window[a, c]), map_of(maps, a, c).distances
        assert np.abs(found - exact)[exact < 20].max() < 0.03 and np.abs(found - exact).max() < 0.1
        assert np.mean(np.abs(found - exact)[exact < 20] > 1e-3) < 0.01


def test_the_valley_does_not_ripple_along_the_line():
    maps = distance_maps([[circle(60.0)]], 40)
    exact = np.abs(np.linalg.norm(pixels_of(maps.window[0, 0]) - [200.3, 170.6], axis=-1) - 60.0)
    off = np.abs(map_of(maps, 0, 0).distances - exact)
    assert off[exact < COMPARED_PX - 1].max() < 0.01 and off.max() < 0.1


def test_windows_stay_within_the_image_and_do_not_depend_on_the_batch():
    maps = distance_maps([[line_of(np.array([[0.4, 358.7]]), np.array([1.0, 0.0]), shape=SHAPE)], [circle(30.0)]], 25)
    np.testing.assert_array_equal(maps.window[0, 0], [0, 0, 333, 27, 27])
    np.testing.assert_array_equal(map_of(maps, 1, 0).distances, map_of(distance_maps([[circle(30.0)]], 25), 0, 0).distances)


def test_detections_without_a_map_are_refused():
    check_refused("set 0, image 1: ", distance_maps, [[circle(30.0), Detection.none(SHAPE, "ridge")]])
    for sets in ([], [[]], [[circle(30.0)], [circle(30.0)] * 2]):
        check_refused("detections", distance_maps, sets)
    check_refused("margin", distance_maps, [[circle(30.0)]], 1)


def test_the_widest_a_lens_maps():
    table = sampling.camera_table(three_cameras())
    assert table.shape == (3, sampling.CAMERA_COLUMNS)
    for row, camera in zip(table, three_cameras().cameras):
        k1, k2, _, _, k3 = camera.distortion
        square = np.linspace(0, row[sampling.WIDEST] * 0.999, 1000)
        assert (1 + 3 * k1 * square + 5 * k2 * square**2 + 7 * k3 * square**3 > 0).all()
    plain = Camera("plain", 10, 10, np.diag([5.0, 5, 1]), np.zeros(5), np.eye(3), np.zeros(3))
    barrel = Camera("barrel", 10, 10, np.diag([5.0, 5, 1]), [-0.3, 0, 0, 0, 0], np.eye(3), np.zeros(3))
    found = sampling.camera_table(Rig((plain, barrel)))[:, sampling.WIDEST]
    assert found[0] == 100 and found[1] == pytest.approx(1 / 0.9)


@cache
def sampling_kernel(number):
    """(set, u, v) to the value alone, and to the value with its derivatives."""
    maps = sampling.MapSampling(number, 0)

    @ti.func
    def function(scratch: ti.template(), numbers: ti.template(), values: ti.template()):
        frame = maps.window(numbers, scratch[0], 0)
        pixel = (scratch[1], scratch[2])
        alone = maps.value(values, numbers, scratch[0], 0, frame, pixel)
        value, gradient, second = maps.derivatives(values, numbers, scratch[0], 0, frame, pixel)
        return (alone, value) + gradient + second

    return row_kernel(number, 3, 7, function)


@pytest.mark.thorough
@every_number
def test_no_place_reads_outside_its_map(number, rng):
    """Far away, infinite, not a number: values of another map never show."""
    sizes = [(3, 3), (9, 4), (6, 17)]
    offsets = np.cumsum([0] + [width * height for width, height in sizes])
    windows = np.array([[[offset, -5, 700, *size]] for offset, size in zip(offsets, sizes)], dtype=float)
    values, far = rng.uniform(0, 20, offsets[-1]), [1e6, -1e6, np.inf, -np.inf, np.nan]
    rows = np.array([[1, u, v] for u in far for v in far])
    first = sampling_kernel(number)(rows, windows, values)
    other, kept = np.full_like(values, 77.0), slice(int(windows[1, 0, 0]), int(windows[2, 0, 0]))
    other[kept] = values[kept]
    np.testing.assert_array_equal(first, sampling_kernel(number)(rows, windows, other))
