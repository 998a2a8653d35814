"""Rates on a machine that others use too: each is taken together with that of a fixed NumPy workload, as a ratio."""

import os
import platform
import time
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import version
from pathlib import Path

import numpy as np

from doo_ti import __version__

ELEMENTS = 2_048  # doubles: they stay in a core's nearest cache
PRODUCTS = 10_000  # in a task: a few milliseconds
TASKS = 20  # for each thread


def machine() -> dict[str, str | int]:
    """What the figures were taken on: the processor's name and the number of cores, nothing that names the host."""
    return {"processor": _processor(), "cores": os.cpu_count() or 1}


def versions() -> dict[str, str]:
    """What the figures were taken with."""
    return {"doo_ti": __version__, "python": platform.python_version(),
            **{name: version(name) for name in ("taichi", "numpy")}}


class Reference:
    """Dot products of vectors in cache, in NumPy, on as many threads as the kernels use.

    What slows the kernels down (a busy neighbour, a lower clock) slows this down too, so ratios to it hold where rates
    do not. The work is handed out in small tasks, as the kernels hand out rods, and a task holds no lock.
    """

    def __init__(self, threads: int):
        self._tasks = [np.linspace(0.0, 1.0, ELEMENTS) for _ in range(threads * TASKS)]
        self._pool = ThreadPoolExecutor(threads)

    def rate(self) -> float:
        """Multiply-adds per second, all threads together."""
        began = time.perf_counter()
        list(self._pool.map(_dot_products, self._tasks))
        return len(self._tasks) * ELEMENTS * PRODUCTS / (time.perf_counter() - began)


def timed(work) -> tuple[float, object]:
    """(seconds, result) of ``work()``."""
    began = time.perf_counter()
    result = work()
    return time.perf_counter() - began, result


def _dot_products(vector: np.ndarray) -> None:
    np.vecdot(np.broadcast_to(vector, (PRODUCTS, ELEMENTS)), vector)


def _processor() -> str:
    information = Path("/proc/cpuinfo")
    if information.exists():
        for line in information.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
