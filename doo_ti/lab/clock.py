"""Rates on a machine that others use too: each is taken together with that of a fixed NumPy workload, as a ratio; and the
processor's peak rate: multiplications and additions per second in registers."""

import os
import platform
import time
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import version
from pathlib import Path

import numpy as np
import taichi as ti

from doo_ti import __version__
from doo_ti.physics.number import Number
from doo_ti.system import runtime

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


WIDTHS = {32: (8, 16, 32), 64: (4, 8, 16)}
"""Lanes of a value, by bits: CHAINS values fill twelve registers of 128, 256 or 512 bits. With fewer the arithmetic units wait
for results, with many more the values no longer fit into the registers; the fastest width counts."""
CHAINS = 6
TRIPS = 300_000
RUNS = 20
"""Of each width. A run takes about a millisecond, so that some run is not interrupted, even on a machine that others use."""


def peak_gflops(known: dict[str, float] | None = None) -> dict[str, float]:
    """10⁹ operations per second, all threads together, in f32 and f64: the most that was measured now or is ``known`` from
    before. Empty where Taichi runs elsewhere than on a CPU."""
    if runtime.start() != "cpu":
        return {}
    rates = {f"f{bits}": max(_measured(Number(width, bits)) for width in widths) for bits, widths in WIDTHS.items()}
    return {name: max(rate, (known or {}).get(name, 0.0)) for name, rate in rates.items()}


@runtime.exclusive
def _measured(number: Number) -> float:
    threads = runtime.thread_count()
    kernel, sums = _chains(number), ti.ndarray(number.type, threads)
    kernel(threads, 1, 0.999, 0.001, sums)
    seconds = []
    for _ in range(RUNS):
        ti.sync()
        began = time.perf_counter()
        kernel(threads, TRIPS, 0.999, 0.001, sums)
        ti.sync()
        seconds.append(time.perf_counter() - began)
    return 1e-9 * 2 * CHAINS * number.width * TRIPS * threads / min(seconds)


def _chains(number: Number):
    """The kernel: on every thread CHAINS values, independent of each other, each turned ``trips`` times into value · a + b."""
    scalar, constant = number.scalar, number.lanes().constant

    @runtime.kernel
    def chains(
        threads: ti.i32,
        trips: ti.i32,
        factor: scalar,
        summand: scalar,
        sums: ti.types.ndarray(dtype=number.type, ndim=1),  # [thread] out, so that nothing is left out as unused
    ):
        for thread in range(threads):
            a, b = constant(factor), constant(summand)
            p, q, r, s, t, u = constant(0.0), constant(0.2), constant(0.4), constant(0.6), constant(0.8), constant(1.0)
            for _ in range(trips):
                p, q, r, s, t, u = p * a + b, q * a + b, r * a + b, s * a + b, t * a + b, u * a + b
            sums[thread] = p + q + r + s + t + u

    return chains
