"""Growth of the time with the number of rods, edges and threads."""

from dataclasses import dataclass

import numpy as np

from doo_ti.bench import clock, workload
from doo_ti.bench.cases import COARSE, FINE
from doo_ti.bench.workload import Rods
from doo_ti.rod.types import Configuration
from tools.bench.curves import Panel

RODS = tuple(2**k for k in range(8, 21, 2))
EDGES = tuple(2**k for k in range(3, 10))
EDGES_TOGETHER = 1 << 20  # of all rods where their edges are varied
ROUNDS = 3  # of which the fastest counts


@dataclass(frozen=True)
class Point:
    """``rods`` of ``edges`` edges in one call."""

    rods: int
    edges: int
    precision: str
    seconds: float
    converged: float
    iterations: float

    @property
    def rods_per_second(self) -> float:
        """Converged rods per second."""
        return self.rods * self.converged / self.seconds


def with_rods(tables: Rods, count: int) -> Point:
    """The same starts under ``count`` materials, f32 to 1e-6."""
    return _point(workload.paired(tables.starts, tables.clamps, workload.isotropic_materials(count)), "f32")


def with_edges(tables: Rods, edges: int) -> Point:
    """Rods of the same length and of ``edges`` edges, fewer the more edges they have. In f64: the shorter the edges, the
    more rods f32 would leave to it."""
    starts = refined(tables.starts, edges)
    count = max(EDGES_TOGETHER // edges, 1)
    return _point(workload.paired(starts, tables.clamps, workload.isotropic_materials(count)), "f64")


def refined(starts: Configuration, edges: int) -> Configuration:
    """The starts with ``edges`` equal edges: the same length, the frames between those that are given.

    The far end is then slightly off its clamp; the solver corrects that.
    """
    total = np.atleast_2d(starts.rest_length).sum(axis=-1)
    frames = starts.quaternions.copy()
    alike = np.where(np.sum(frames[:, 1:] * frames[:, :-1], axis=-1) < 0, -1.0, 1.0)
    frames[:, 1:] *= np.cumprod(alike, axis=1)[..., None]
    place = np.clip((np.arange(edges) + 0.5) / edges * starts.edges - 0.5, 0, starts.edges - 1)
    left = np.minimum(place.astype(int), starts.edges - 2)
    share = (place - left)[:, None]
    between = (1 - share) * frames[:, left] + share * frames[:, left + 1]
    between /= np.linalg.norm(between, axis=-1, keepdims=True)
    lengths = np.tile(total[:, None] / edges, (1, edges))
    return Configuration(starts.start, between, lengths[0] if len(lengths) == 1 else lengths)


def thread_counts(most: int) -> list[int]:
    """1, 2, 4, … and ``most``."""
    return sorted({most, *(2**k for k in range(most.bit_length()) if 2**k <= most)})


def panels(rods: list[dict], edges: list[dict], threads: list[dict]) -> list[Panel]:
    """The picture of the points as ``bench.json`` holds them."""
    calls = [point["seconds"] for point in rods]
    each = [1e6 * point["seconds"] / (point["rods"] * point["iterations"]) for point in edges]
    rates = [point["rods_per_second"] for point in threads]
    of_rods = Panel("rods, f32", "rods in a call", "time of a call [s]",
                    {"measured": ([point["rods"] for point in rods], calls)}, growth=True)
    of_edges = Panel("edges, f64", "edges of a rod", "time per rod and iteration [µs]",
                     {"measured": ([point["edges"] for point in edges], each)}, growth=True)
    of_threads = Panel("threads, f32", "threads", "converged rods per second [1/s]",
                       {"measured": ([point["threads"] for point in threads], rates)}, growth=True)
    return [of_rods, of_edges, of_threads]


def _point(rods: Rods, precision: str) -> Point:
    solver = {"f32": COARSE, "f64": FINE}[precision]
    rods.take(slice(1)).relaxed(solver, precision)
    seconds, solution = min((clock.timed(lambda: rods.relaxed(solver, precision)) for _ in range(ROUNDS)),
                            key=lambda run: run[0])
    return Point(rods.count, rods.starts.edges, precision, seconds, float(solution.converged.mean()),
                 float(solution.iterations.mean()))
