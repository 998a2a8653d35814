"""The rods that are measured and timed: observed starts with their clamps, and parameters drawn over a range.

Axes: S starts, D observations, R rods.
"""

import numpy as np

from doo_ti import Clamps, Configuration, Material, Observations, observation_clamps, start_configuration

SUTURES = ("nylon", "vicryl", "silk")
BEND_RANGE = (5e4, 1e7)  # mm³
TWIST_RATIO_RANGE = (0.1, 6.0)
RIBBON_TWIST = 5e5  # mm³, β of the lab's ribbon
SEED = 0


def started(observations: Observations) -> tuple[Configuration, Clamps]:
    """Starts and clamps of D observations, the whole turn taken from the hint: one rod each."""
    clamps = observation_clamps(observations)
    return start_configuration(observations, clamps), clamps


def in_turn(tables: list[tuple[Configuration, Clamps]]) -> tuple[Configuration, Clamps]:
    """Tables of D starts each as one, the tables' rows taking turns: the first of each, then the second of each, …

    Rods have the same number of edges, and both ends the same kinds of clamps.
    """
    starts, clamps = zip(*tables, strict=True)
    lengths = [np.broadcast_to(rods.rest_length, (rods.count, rods.edges)) for rods in starts]
    if all((length == lengths[0][0]).all() for length in lengths):
        rest_length = lengths[0][0]
    else:
        rest_length = _interleaved(lengths)
    fields = ("start_position", "end_position", "start_frame", "end_frame")
    held = Clamps(clamps[0].start, clamps[0].end, *(_interleaved([getattr(c, name) for c in clamps]) for name in fields))
    quaternions = _interleaved([rods.quaternions for rods in starts])
    return Configuration(_interleaved([rods.start for rods in starts]), quaternions, rest_length), held


def isotropic_materials(count: int) -> Material:
    """R materials, bend and twist ratio log-uniform over the grid's ranges, from the fixed seed."""
    random = np.random.default_rng(SEED)
    bend = _log_uniform(random, BEND_RANGE, count)
    return Material(bend, bend * _log_uniform(random, TWIST_RATIO_RANGE, count))


def ribbon_materials(count: int) -> Material:
    """R materials with bend_1 and bend_2 log-uniform over the grid's range and the ribbon's twist, from the fixed seed."""
    random = np.random.default_rng(SEED)
    return Material.diagonal(_log_uniform(random, BEND_RANGE, count), _log_uniform(random, BEND_RANGE, count), RIBBON_TWIST)


def _log_uniform(random: np.random.Generator, limits: tuple[float, float], count: int) -> np.ndarray:
    return np.exp(random.uniform(*np.log(limits), size=count))


def _interleaved(arrays: list[np.ndarray]) -> np.ndarray:
    return np.stack(arrays, axis=1).reshape(-1, *arrays[0].shape[1:])
