"""Rates on a machine that others use too: each is taken together with that of a fixed NumPy workload, as a ratio."""

import os
import platform
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

ELEMENTS = 32_768  # three such arrays of doubles stay in a core's cache
PASSES = 1_000


def machine() -> dict[str, str | int]:
    """What the figures were taken on: the processor's name and the number of cores, nothing that names the host."""
    return {"processor": _processor(), "cores": os.cpu_count() or 1}


class Reference:
    """A multiply and an add over arrays in cache, in NumPy, on as many threads as the kernels use.

    What slows the kernels down (a busy neighbour, a lower clock) slows this down too, so ratios to it hold where rates
    do not.
    """

    def __init__(self, threads: int):
        self._arrays = [np.linspace(0.0, 1.0, ELEMENTS) + thread for thread in range(threads)]
        self._pool = ThreadPoolExecutor(threads)

    def rate(self) -> float:
        """Multiply-adds per second, in units of 1e9, all threads together."""
        began = time.perf_counter()
        list(self._pool.map(_multiply_add, self._arrays))
        return len(self._arrays) * ELEMENTS * PASSES / (time.perf_counter() - began) / 1e9


def timed(work) -> tuple[float, object]:
    """(seconds, result) of ``work()``."""
    began = time.perf_counter()
    result = work()
    return time.perf_counter() - began, result


def _multiply_add(array: np.ndarray) -> None:
    product = np.empty_like(array)
    for _ in range(PASSES):
        np.multiply(array, 0.5, out=product)
        np.add(product, array, out=product)


def _processor() -> str:
    information = Path("/proc/cpuinfo")
    if information.exists():
        for line in information.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
