"""The processor's peak rate: multiplications and additions per second in registers."""

import time

import taichi as ti

from doo_ti.physics.number import Number
from doo_ti.system import runtime

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
