"""The same Newton in JAX (tools/bench/newton_in_jax.py), in batches."""

import numpy as np

from doo_ti.bench.workload import Rods
from doo_ti.frames import vertices_from_quaternions
from tools.peers.problem import Problem
from tools.peers.swinging import seconds

COUNT = 4096


def batch(problem: Problem) -> Rods:
    """The rods of the problem in turn, COUNT of them."""
    return Rods(problem.start, problem.clamps, problem.material, np.arange(COUNT) % problem.start.count,
                np.zeros(COUNT, dtype=np.int64))


def shapes(problem: Problem, frames: np.ndarray) -> np.ndarray:
    """(R, V, 3) mm of the first R rods from their frames (COUNT, E, 4)."""
    count = problem.start.count
    return vertices_from_quaternions(problem.start.start, frames[:count], problem.start.rest_length)


def relaxed(problem: Problem, bits: int) -> tuple[np.ndarray, float]:
    """(R, V, 3) mm, and processor seconds for all. Raises InputError where jax is absent."""
    from tools.bench import newton_in_jax as twin

    rods = batch(problem)
    frames, _, _, _ = twin.relaxed(rods, bits)
    with twin.floats_of(bits):
        batches = twin.batches_of(rods, bits)
        program = twin.compiled(batches[0], bits)
        taken = seconds(lambda: twin.run(program, batches, rods.count))
    return shapes(problem, frames), taken
