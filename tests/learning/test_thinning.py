"""A part of a grid: as many cells as asked for, even, with the cells that must be in it."""

import numpy as np
import pytest

from doo_ti.learning.figures import thinned


@pytest.mark.parametrize("shape", [(25, 25, 1), (50, 50, 1), (7, 1, 1), (12, 9, 30, 2), (1, 1, 1)])
@pytest.mark.parametrize("most", [1, 9, 100, 700, 10**6])
def test_parts_are_even_and_hold_what_they_must(shape, most, rng):
    kept = [tuple(int(rng.integers(size)) for size in shape) for _ in range(2)]
    part = thinned(shape, most, kept)
    counts = [len(indices) for indices in part]
    for axis, (size, indices) in enumerate(zip(shape, part, strict=True)):
        assert (np.diff(indices) > 0).all() and indices[0] >= 0 and indices[-1] < size
        assert {cell[axis] for cell in kept} <= set(indices.tolist())
        gaps = np.diff(indices)
        assert len(gaps) == 0 or gaps.max() <= 2 * np.ceil((size - 1) / len(gaps))
    smallest = np.prod([max(min(2, size), len({cell[axis] for cell in kept})) for axis, size in enumerate(shape)])
    assert np.prod(counts) <= max(most, smallest)
    if np.prod(shape) <= most:
        assert counts == list(shape)
    elif most > smallest:  # one value more on the longest axis would be too many
        assert np.prod(counts) * (1 + 1 / max(counts)) > 0.8 * most
