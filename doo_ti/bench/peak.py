"""What the processor can do at most: multiply-adds on packs as the kernels hold them, and nothing else."""

import taichi as ti

from doo_ti import runtime
from doo_ti.bench import clock
from doo_ti.physics.number import Number

PACKS = {32: Number(16, 32), 64: Number(8, 64)}
CHAINS = 20  # independent of each other: enough to fill multipliers and adders in spite of their latency
TRIPS = 5_000_000
RUNS = 10  # of which the fastest counts


def peak_gflops() -> dict[str, float]:
    """10⁹ floating-point operations per second, all threads together, in f32 and f64; empty where Taichi runs elsewhere
    than on a CPU."""
    if runtime.start() != "cpu":
        return {}
    return {f"f{bits}": _measured(number) for bits, number in PACKS.items()}


def _measured(number: Number) -> float:
    threads = runtime.thread_count()
    kernel, sums = _chains(number), ti.ndarray(number.type, threads)

    def run(trips: int) -> None:
        kernel(threads, trips, 0.999, 0.001, sums)
        ti.sync()

    run(1)
    seconds = min(clock.timed(lambda: run(TRIPS))[0] for _ in range(RUNS))
    return 1e-9 * 2 * CHAINS * number.width * TRIPS * threads / seconds


def _chains(number: Number):
    """The kernel: on every thread CHAINS values, each turned ``trips`` times into value · a + b."""
    value, scalar = number.type, number.scalar
    constant = number.lanes()[3]

    @ti.func
    def turned(group: ti.template(), a, b):
        return group[0] * a + b, group[1] * a + b, group[2] * a + b, group[3] * a + b, group[4] * a + b

    @ti.kernel
    def chains(
        threads: ti.i32,
        trips: ti.i32,
        factor: scalar,
        summand: scalar,
        sums: ti.types.ndarray(dtype=value, ndim=1),  # [thread] out: nothing may be left out as unused
    ):
        for thread in range(threads):
            a, b = constant(factor), constant(summand)
            p0, p1, p2, p3, p4 = constant(0.0), constant(0.1), constant(0.2), constant(0.3), constant(0.4)
            q0, q1, q2, q3, q4 = constant(0.5), constant(0.6), constant(0.7), constant(0.8), constant(0.9)
            r0, r1, r2, r3, r4 = constant(1.0), constant(1.1), constant(1.2), constant(1.3), constant(1.4)
            s0, s1, s2, s3, s4 = constant(1.5), constant(1.6), constant(1.7), constant(1.8), constant(1.9)
            for _ in range(trips):
                p0, p1, p2, p3, p4 = turned((p0, p1, p2, p3, p4), a, b)
                q0, q1, q2, q3, q4 = turned((q0, q1, q2, q3, q4), a, b)
                r0, r1, r2, r3, r4 = turned((r0, r1, r2, r3, r4), a, b)
                s0, s1, s2, s3, s4 = turned((s0, s1, s2, s3, s4), a, b)
            p, q = p0 + p1 + p2 + p3 + p4, q0 + q1 + q2 + q3 + q4
            r, s = r0 + r1 + r2 + r3 + r4, s0 + s1 + s2 + s3 + s4
            sums[thread] = p + q + r + s

    return chains
