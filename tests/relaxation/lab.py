"""The development data as rods: observations, their clamps and starts, and the material they were made of."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from doo_ti import Clamps, Configuration, Material, Observations, load_observations, observation_clamps, start_configuration

SUTURES = ("nylon", "vicryl", "silk")
RIBBON_WIDTH = 6.7  # mm, w_m of Eq. 1


@dataclass(frozen=True)
class Lab:
    """One rod of the virtual lab: observations, clamps and starts share their rows."""

    observations: Observations
    clamps: Clamps
    start: Configuration
    bend: np.ndarray
    twist: float

    def material(self, bend: float = 1.0, twist: float = 1.0) -> Material:
        """The rod's own Θ, its B and β times the given factors."""
        return Material(self.bend * bend, self.twist * twist, 1.0)

    def take(self, rows) -> "Lab":
        return Lab(self.observations.take(rows), self.clamps.take(rows), self.start.take(rows), self.bend, self.twist)


def lab(folder: Path, name: str) -> Lab:
    """``name`` of ``lab_a`` below the folder of development data."""
    observations = load_observations(folder / "lab_a" / f"{name}.npz")
    truth = json.loads((folder / "lab_a" / "truth.json").read_text())[name]
    clamps = observation_clamps(observations)
    start = start_configuration(observations, clamps)
    return Lab(observations, clamps, start, np.array(truth["bend"]), truth["twist"])


def vertex_distance(first: Configuration, second: Configuration) -> np.ndarray:
    """(R,) mean distance of corresponding vertices, mm: two minima are the same below 0.02."""
    return np.linalg.norm(first.vertices - second.vertices, axis=2).mean(axis=1)
