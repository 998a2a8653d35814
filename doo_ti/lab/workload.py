"""What is measured and timed, and by what. Rods: observed starts with their clamps, under materials drawn over a range. Rates,
on a machine that others use too: each is taken together with that of a fixed NumPy workload, as a ratio.

The observations are those of the shipped scenes, so that nothing but the package is needed.

Axes: S starts, G materials, D observations, R rods.
"""

import os
import platform
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path

import numpy as np

from doo_ti import __version__
from doo_ti.io.scene import load_scene
from doo_ti.io.toml_file import SCENES
from doo_ti.lab.synthesis import synthesise
from doo_ti.relaxation.descent import Descent
from doo_ti.relaxation.external import Springs
from doo_ti.relaxation.newton import Newton
from doo_ti.relaxation.relax import relax
from doo_ti.rod.observations import Observations
from doo_ti.rod.start import observation_clamps, start_configuration
from doo_ti.rod.types import Clamps, Configuration, Material, Solution

SUTURES = ("nylon", "vicryl", "silk")
LAB = {name: load_scene(SCENES / f"{name}.toml").observations for name in (*SUTURES, "ribbon")}
"""The recipes of the package's scenes."""
BEND_RANGE = (5e4, 1e7)  # mm³
TWIST_RATIO_RANGE = (0.1, 6.0)
SEED = 0
UP = (0.0, 0.0, 1.0)


@dataclass(frozen=True)
class Rods:
    """R rods: row ``of_start[r]`` of the S starts and clamps under row ``of_material[r]`` of the G materials, and where there
    are springs under row ``of_start[r]`` of those."""

    starts: Configuration
    clamps: Clamps
    material: Material
    of_start: np.ndarray
    of_material: np.ndarray
    springs: Springs | None = None

    @property
    def count(self) -> int:
        """R, the number of rods."""
        return len(self.of_start)

    def relaxed(self, solver: Newton | Descent, precision: str) -> Solution:
        """All rods, NumPy in to NumPy out."""
        return relax(self.starts, self.material, self.clamps, solver, up=UP, precision=precision,
                     configuration_index=self.of_start, material_index=self.of_material, external=self.springs,
                     external_index=None if self.springs is None else self.of_start)

    def take(self, rods: np.ndarray | slice) -> "Rods":
        """Some of the rods, over the same tables."""
        return replace(self, of_start=self.of_start[rods], of_material=self.of_material[rods])

    def alone(self, rods: np.ndarray | slice) -> "Rods":
        """Some of the rods, with tables that hold no others: a row for each."""
        start, row = self.of_start[rods], self.of_material[rods]
        return paired(self.starts.take(start), self.clamps.take(start), self.material.take(row))


def observed(*names: str) -> list[Observations]:
    """The observations of rods of the lab."""
    return [synthesise(LAB[name]) for name in names]


def paired(starts: Configuration, clamps: Clamps, material: Material) -> Rods:
    """One rod per material, the starts in turn, over and over."""
    rods = np.arange(material.count)
    return Rods(starts, clamps, material, rods % starts.count, rods)


def started(observations: Observations) -> tuple[Configuration, Clamps]:
    """Starts and clamps of D observations, the whole turn taken from the hint: one rod each."""
    clamps = observation_clamps(observations)
    return start_configuration(observations, clamps), clamps


def in_turn(tables: list[tuple[Configuration, Clamps]]) -> tuple[Configuration, Clamps]:
    """Tables of D starts each as one, the tables' rows taking turns: the first of each, then the second of each, …"""
    starts, clamps = zip(*tables, strict=True)
    together = Configuration.concatenate(starts)
    turns = np.arange(together.count).reshape(len(tables), -1).T.ravel()
    return together.take(turns), Clamps.concatenate(clamps).take(turns)


def log_uniform(random: np.random.Generator, limits: tuple[float, float], count: int) -> np.ndarray:
    """(count,) numbers whose logarithm is uniform between those of ``limits``."""
    return np.exp(random.uniform(*np.log(limits), size=count))


# --- the clock -----------------------------------------------------------------------------------------------------------

ELEMENTS = 2_048  # doubles: they stay in a core's nearest cache
PRODUCTS = 10_000  # in a task: a few milliseconds
TASKS = 20  # for each thread


def machine() -> dict[str, str | int]:
    """What the figures were taken on: the processor's name and the number of cores, nothing that names the host."""
    information = Path("/proc/cpuinfo")
    lines = information.read_text(encoding="utf-8").splitlines() if information.exists() else []
    name = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), None)
    return {"processor": name or platform.processor() or platform.machine(), "cores": os.cpu_count() or 1}


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
        list(self._pool.map(lambda vector: np.vecdot(np.broadcast_to(vector, (PRODUCTS, ELEMENTS)), vector), self._tasks))
        return len(self._tasks) * ELEMENTS * PRODUCTS / (time.perf_counter() - began)


def timed(work) -> tuple[float, object]:
    """(seconds, result) of ``work()``."""
    began = time.perf_counter()
    result = work()
    return time.perf_counter() - began, result
