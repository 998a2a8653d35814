"""The distorted camera on the device, derivatives to the third against a complex step; and distance maps between their pixels,
the B-spline against its definition."""

from functools import cache

import numpy as np
import pytest
import taichi as ti

from doo_ti import Camera, Rig
from doo_ti.vision import sampling
from tests.oracle.reprojection import STEP, Map, jacobian, project
from tests.vision.device import every_number, row_kernel
from tests.vision.scenes import three_cameras

CAMERA = 1


@cache
def point_kernel(number):
    """A point and a direction to (u, v, speed, seen, point and direction turned into the camera and back)."""
    camera = sampling.Projection(number)

    @ti.func
    def function(scratch: ti.template(), numbers: ti.template(), values: ti.template()):
        y = camera.entered(numbers, CAMERA, (scratch[0], scratch[1], scratch[2]))
        d = camera.turned(numbers, CAMERA, (scratch[3], scratch[4], scratch[5]))
        lens = camera.lens(numbers, CAMERA)
        x0, x1, inverse, seen = camera.normalised(lens, y)
        pixel, j = sampling.bent(lens, x0, x1), sampling.bent_slope(lens, x0, x1)
        zero = 0.0 * inverse
        back = camera.turned_back(numbers, CAMERA, d)
        return (pixel[0], pixel[1], camera.speed(lens, j, x0, x1, inverse, d), ti.select(seen, zero + 1.0, zero)) + back

    return row_kernel(number, 6, 7, function)


@cache
def lens_kernel(number):
    """(X, Y) to the derivatives of the lens: three first, four second, five third."""
    camera = sampling.Projection(number)

    @ti.func
    def function(scratch: ti.template(), numbers: ti.template(), values: ti.template()):
        lens = camera.lens(numbers, CAMERA)
        x, y = scratch[0], scratch[1]
        return sampling.bent_slope(lens, x, y) + sampling.bent_curvature(lens, x, y) + sampling.bent_third(lens, x, y)

    return row_kernel(number, 2, 12, function)


@pytest.mark.sampled(1)
@every_number
def test_pixels_and_their_speed(number, rng):
    rig = three_cameras()
    camera = rig.cameras[CAMERA]
    points, directions = rng.uniform(-60, 60, (37, 3)), rng.normal(size=(37, 3))
    found = point_kernel(number)(np.concatenate([points, directions], axis=1), sampling.camera_table(rig)[None], np.zeros(1))
    exact = number.bits == 64
    np.testing.assert_allclose(found[:, :2], camera.project(points), atol=1e-9 if exact else 4e-4)
    np.testing.assert_allclose(found[:, :2], [project(camera, point) for point in points], atol=1e-9 if exact else 4e-4)
    motion = [np.linalg.norm(jacobian(camera, point) @ along) for point, along in zip(points, directions)]
    np.testing.assert_allclose(found[:, 2], motion, rtol=1e-12 if exact else 2e-5)
    assert (found[:, 3] == 1).all()
    np.testing.assert_allclose(found[:, 4:], directions, atol=1e-12 if exact else 1e-5)


@pytest.mark.sampled(1)
@every_number
def test_derivatives_of_the_lens(number, rng):
    """Each order is the derivative of the one before, which the Jacobian's is of the projection itself."""
    rig = three_cameras()
    places = rng.uniform(-0.4, 0.4, (21, 2))
    kernel = lens_kernel(number)

    def at(shift):
        return kernel(places + shift, sampling.camera_table(rig)[None], np.zeros(1))

    step = 1e-5 if number.bits == 64 else 5e-3
    by_x, by_y = ((at(step * axis) - at(-step * axis)) / (2 * step) for axis in np.eye(2))
    first, second, third = np.split(at(np.zeros(2)), [3, 7], axis=1)
    close = {"atol": 1e-8 if number.bits == 64 else 2e-3, "rtol": 0}
    np.testing.assert_allclose(by_x[:, :3], second[:, :3], **close)
    np.testing.assert_allclose(by_y[:, :3], second[:, 1:], **close)
    np.testing.assert_allclose(by_x[:, 3:7], third[:, :4], **close)
    np.testing.assert_allclose(by_y[:, 3:7], third[:, 1:], **close)
    for (x, y), row in zip(places, first):
        camera = rig.cameras[CAMERA]
        there = camera.rotation.T @ (np.array([x, y, 1.0]) * 200 - camera.translation)
        sideways = jacobian(camera, there) @ camera.rotation.T[:, :2] * 200
        wanted = sideways / np.diag(camera.matrix)[:2, None]
        np.testing.assert_allclose(row, wanted[[0, 0, 1], [0, 1, 1]], atol=1e-9 if number.bits == 64 else 1e-5)


@pytest.mark.sampled(1)
@every_number
def test_points_behind_or_beyond_the_lens_are_not_seen(number):
    rig = three_cameras()
    camera = rig.cameras[CAMERA]
    # 1e-3 mm in front; behind; 87° off the axis; not a number.
    offsets = [[0, 0, 1e-3], [3, 2, -50], [100, 0, 5], [np.nan, 0, 100], [0, 0, np.nan], [0, 0, 100]]
    points = np.array([camera.centre + camera.rotation.T @ np.array(offset, dtype=float) for offset in offsets])
    table = sampling.camera_table(rig)[None]
    found = point_kernel(number)(np.concatenate([points, np.ones((6, 3))], axis=1), table, np.zeros(1))
    assert found[:, 3].tolist() == [0, 0, 0, 0, 0, 1]


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


# --- distance maps between their pixels -----------------------------------------------------------------------------------

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


def five_maps(rng):
    """Maps of random distances and sizes: (oracle's maps, windows (5, 1, 5), values)."""
    sizes = [(3, 3), (4, 9), (17, 6), (30, 40), (5, 3)]
    maps = [Map(rng.uniform(0, 20, size).astype(np.float32), int(rng.integers(-9, 900)), int(rng.integers(-9, 900)))
            for size in sizes]
    offsets = np.cumsum([0] + [m.distances.size for m in maps])
    windows = [[[offset, m.left, m.top, *m.distances.shape[::-1]]] for offset, m in zip(offsets, maps)]
    return maps, np.array(windows, dtype=float), np.concatenate([m.distances.ravel() for m in maps])


def places(rng, maps, count=60):
    """(N, 3): set and pixel, in the windows and around them."""
    rows = rng.integers(0, len(maps), count)
    corner = np.array([[maps[row].left, maps[row].top] for row in rows])
    size = np.array([maps[row].distances.shape[::-1] for row in rows])
    return np.column_stack([rows, corner + rng.uniform(-0.4, 1.4, (count, 2)) * size])


@pytest.mark.sampled(1)
@every_number
def test_values_and_derivatives_are_those_of_the_spline(number, rng):
    maps, windows, values = five_maps(rng)
    rows = places(rng, maps)
    found = sampling_kernel(number)(rows, windows, values)
    exact = number.bits == 64
    for (row, u, v), (alone, value, *derivatives) in zip(rows, found):
        at = maps[int(row)].at
        wanted = at(np.array([u, v]))
        slope = [at(np.array([u + 1j * STEP, v])).imag / STEP, at(np.array([u, v + 1j * STEP])).imag / STEP]
        assert alone == pytest.approx(wanted, rel=1e-12 if exact else 3e-4)
        assert value == pytest.approx(alone, rel=1e-13 if exact else 1e-6)
        np.testing.assert_allclose(derivatives[:2], slope, atol=1e-11 if exact else 5e-3)


@pytest.mark.thorough
@every_number
def test_no_place_reads_outside_its_map(number, rng):
    """Far away, infinite, not a number: values of another map never show."""
    maps, windows, values = five_maps(rng)
    far = [1e6, -1e6, np.inf, -np.inf, np.nan]
    rows = np.array([[1, u, v] for u in far for v in far])
    first = sampling_kernel(number)(rows, windows, values)
    other, kept = np.full_like(values, 77.0), slice(int(windows[1, 0, 0]), int(windows[2, 0, 0]))
    other[kept] = values[kept]
    np.testing.assert_array_equal(first, sampling_kernel(number)(rows, windows, other))
