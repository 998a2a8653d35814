"""How wide a lens maps, and distance maps beyond their windows."""

from functools import cache

import numpy as np
import pytest
import taichi as ti

from doo_ti import Camera, Rig
from doo_ti.vision import sampling
from tests.vision.device import every_number, row_kernel
from tests.vision.scenes import three_cameras


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
    values = rng.uniform(0, 20, offsets[-1])
    far = [1e6, -1e6, np.inf, -np.inf, np.nan]
    rows = np.array([[1, u, v] for u in far for v in far])
    first = sampling_kernel(number)(rows, windows, values)
    other, kept = np.full_like(values, 77.0), slice(int(windows[1, 0, 0]), int(windows[2, 0, 0]))
    other[kept] = values[kept]
    np.testing.assert_array_equal(first, sampling_kernel(number)(rows, windows, other))
