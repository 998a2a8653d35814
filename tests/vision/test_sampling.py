"""Distance maps between their pixels: the B-spline against its definition."""

from functools import cache

import numpy as np
import pytest
import taichi as ti

from doo_ti.vision.sampling import MapSampling
from tests.oracle.reprojection import STEP, Map
from tests.vision.device import every_number, row_kernel


@cache
def sampling_kernel(number):
    """(set, u, v) to the value alone, and to the value with its derivatives."""
    sampling = MapSampling(number, 0)

    @ti.func
    def function(scratch: ti.template(), numbers: ti.template(), values: ti.template()):
        frame = sampling.window(numbers, scratch[0], 0)
        pixel = (scratch[1], scratch[2])
        alone = sampling.value(values, numbers, scratch[0], 0, frame, pixel)
        value, gradient, second = sampling.derivatives(values, numbers, scratch[0], 0, frame, pixel)
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
