"""NumPy's loops over many small matrices, shared out over the processors that the kernels use: by themselves they take one."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from doo_ti.system.runtime import thread_count

LEAST = 64
"""Rows of a part: with fewer, handing them to a thread takes longer than they do."""


def in_parts(function: Callable, *arrays: np.ndarray):
    """``function`` (*arrays), an array or a tuple of arrays whose rows follow from the same rows of ``arrays`` alone."""
    count = len(arrays[0])
    parts = min(thread_count(), count // LEAST)
    if parts < 2:
        return function(*arrays)
    ends = np.linspace(0, count, parts + 1).astype(int)
    with ThreadPoolExecutor(parts) as threads:
        found = list(threads.map(lambda first, last: function(*(array[first:last] for array in arrays)), ends[:-1], ends[1:]))
    return tuple(map(np.concatenate, zip(*found, strict=True))) if isinstance(found[0], tuple) else np.concatenate(found)
