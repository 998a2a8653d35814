"""Experiments that several tests work on: a small virtual lab, and the rods of the development data."""

import json
from functools import cache
from pathlib import Path

import numpy as np

from doo_ti import Axis, Grid, Material, Observations, load_observations
from doo_ti.io.scene import Synthesis
from doo_ti.lab.synthesis import synthesise
from doo_ti.learning.experiment import Experiment, SweepOptions

GRID = Grid((Axis("bend", [2e5, 4e5, 8e5, 1.6e6]), Axis("twist_ratio", [0.5, 1.0, 2.0])))
DYNAMIC = SweepOptions(objective="dynamic")


@cache
def small_lab() -> Observations:
    """Two end distances, end rotations of 0, 60 and 120 degrees."""
    return synthesise(Synthesis(bend=4e5, twist=4e5, end_distances_mm=(42.0, 66.0), end_rotations_deg=(0.0, 60.0, 120.0)))


def lab_rods(folder: Path, name: str, **options) -> tuple[Experiment, Material]:
    """The dynamic experiment on one rod of the development data, and its true material."""
    observations = load_observations(folder / "lab_a" / f"{name}.npz")
    truth = json.loads((folder / "lab_a" / "truth.json").read_text())[name]
    return Experiment(observations, GRID, SweepOptions(objective="dynamic", **options)), Material(
        np.array(truth["bend"]), truth["twist"], truth["weight"])
