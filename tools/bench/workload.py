"""The rods that are measured and timed: observed starts with their clamps, under materials drawn over a range.

Axes: S starts, G materials, D observations, R rods.
"""

from dataclasses import dataclass, replace

import numpy as np

from doo_ti import Clamps, Configuration, Descent, Material, Newton, Observations
from doo_ti.relaxation import relax
from doo_ti.start import observation_clamps, start_configuration
from doo_ti.types import Solution

SUTURES = ("nylon", "vicryl", "silk")
BEND_RANGE = (5e4, 1e7)  # mm³
TWIST_RATIO_RANGE = (0.1, 6.0)
RIBBON_TWIST = 5e5  # mm³, β of the lab's ribbon
SEED = 0
UP = (0.0, 0.0, 1.0)


@dataclass(frozen=True)
class Rods:
    """R rods: row ``of_start[r]`` of the S starts and clamps under row ``of_material[r]`` of the G materials."""

    starts: Configuration
    clamps: Clamps
    material: Material
    of_start: np.ndarray
    of_material: np.ndarray

    @property
    def count(self) -> int:
        """R."""
        return len(self.of_start)

    def relaxed(self, solver: Newton | Descent, precision: str) -> Solution:
        return relax(self.starts, self.material, self.clamps, solver, up=UP, precision=precision,
                     configuration_index=self.of_start, material_index=self.of_material)

    def take(self, rods: np.ndarray | slice) -> "Rods":
        """The rods named by ``rods``, in that order, over the same tables."""
        return replace(self, of_start=self.of_start[rods], of_material=self.of_material[rods])

    def alone(self, rods: np.ndarray | slice) -> "Rods":
        """The rods named by ``rods``, with tables that hold no others: a row for each."""
        start, row = self.of_start[rods], self.of_material[rods]
        material = Material(self.material.bend[row], self.material.twist[row], self.material.weight[row])
        return paired(self.starts.take(start), self.clamps.take(start), material)


def crossed(starts: Configuration, clamps: Clamps, material: Material) -> Rods:
    """Every start under every material: G·S rods, the starts running fastest."""
    of_material, of_start = np.divmod(np.arange(material.count * starts.count), starts.count)
    return Rods(starts, clamps, material, of_start, of_material)


def paired(starts: Configuration, clamps: Clamps, material: Material) -> Rods:
    """One rod per material, the starts in turn, over and over."""
    rods = np.arange(material.count)
    return Rods(starts, clamps, material, rods % starts.count, rods)


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
    alike = all((length == lengths[0][0]).all() for length in lengths)
    rest_length = lengths[0][0] if alike else _interleaved(lengths)
    fields = ("start_position", "end_position", "start_frame", "end_frame")
    held = (_interleaved([getattr(table, name) for table in clamps]) for name in fields)
    quaternions = _interleaved([rods.quaternions for rods in starts])
    configuration = Configuration(_interleaved([rods.start for rods in starts]), quaternions, rest_length)
    return configuration, Clamps(clamps[0].start, clamps[0].end, *held)


def isotropic_materials(count: int) -> Material:
    """G materials, bend and twist ratio log-uniform over the grid's ranges, from the fixed seed."""
    random = np.random.default_rng(SEED)
    bend = _log_uniform(random, BEND_RANGE, count)
    return Material(bend, bend * _log_uniform(random, TWIST_RATIO_RANGE, count))


def ribbon_materials(count: int) -> Material:
    """G materials, bend_1 and bend_2 log-uniform over the grid's range, the ribbon's twist, from the fixed seed."""
    random = np.random.default_rng(SEED)
    first, second = (_log_uniform(random, BEND_RANGE, count) for _ in range(2))
    return Material.diagonal(first, second, RIBBON_TWIST)


def _log_uniform(random: np.random.Generator, limits: tuple[float, float], count: int) -> np.ndarray:
    return np.exp(random.uniform(*np.log(limits), size=count))


def _interleaved(arrays: list[np.ndarray]) -> np.ndarray:
    return np.stack(arrays, axis=1).reshape(-1, *arrays[0].shape[1:])
