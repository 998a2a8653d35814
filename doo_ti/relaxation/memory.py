"""Memory of earlier results and tables, for the next: a fresh page costs as much as a rod's step."""

import sys
from math import prod

import numpy as np

POOLED_BYTES = 1 << 30
"""Arrays no longer in use are kept up to this size."""
SMALLEST = 1 << 14
"""Numbers below which an array takes no pages of its own."""

_pool: list[np.ndarray] = []


def room(*shape: int) -> np.ndarray:
    """Doubles of any value: memory that nobody holds any more, neither whole nor by a view, where there is some that fits."""
    size = prod(shape)
    if size < SMALLEST:
        return np.empty(shape)
    for kept in _pool:
        # Held by the pool, by this loop and by the call only.
        if size <= kept.size <= 2 * size and sys.getrefcount(kept) == 3:
            return kept[:size].reshape(shape)
    fresh = np.empty(size)
    _pool.append(fresh)
    while sum(kept.nbytes for kept in _pool) > POOLED_BYTES:
        _pool.pop(0)
    return fresh.reshape(shape)
