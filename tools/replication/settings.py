"""The two configurations, and how much is run."""

from dataclasses import dataclass, field

import numpy as np

from doo_ti.learning.experiment import SweepOptions
from doo_ti.perception.search import PerceptionOptions
from doo_ti.relaxation.newton import Newton
from doo_ti.vision.detection.detect import DetectionOptions

NU = PerceptionOptions().nu
AS_THE_PAPER = PerceptionOptions(
    nu=NU, growing_nu=NU, cap=1e4, growing_cap=1e4, children=PerceptionOptions().samples, growing_iterations=50, finalists=1,
    pieces=1, final_points=PerceptionOptions().points)
"""One ν, no cap, all edges that suppression leaves, F solved in each step, the best hypothesis on the mesh on which it grew."""


@dataclass(frozen=True)
class Setting:
    """One configuration.

    relaxed_first  whether Eq. 3 relaxes Γ^x under C^x before it is carried; the paper carries the observation
    fill_gaps      whether gaps of the detection are filled from the truth, as the paper does by hand
    by_distance    whether Fig. 7 takes Θ by end distance
    """

    name: str
    sweeps: SweepOptions
    relaxed_first: bool
    detection: DetectionOptions
    perception: PerceptionOptions
    fill_gaps: bool
    by_distance: bool


PAPER = Setting("as the paper", SweepOptions(solver=Newton.careful(), precision="f64"), False, DetectionOptions("canny"),
                AS_THE_PAPER, True, True)
PACKAGE = Setting("as this package", SweepOptions(), True, DetectionOptions(), PerceptionOptions(), False, False)
SETTINGS = (PAPER, PACKAGE)


@dataclass(frozen=True)
class Size:
    """How much is run.

    specimens   of each material, the first one that of the shipped scene
    images      specimens whose images are perceived, by setting
    sets        rods of each of them, of 60
    loops       rods in loops of each material, None: all that cross themselves in every view
    trials      of Fig. 7, for each specimen and D
    harder      specimens of each harder laboratory; of its images
    descent     observations of each material that the paper's own scheme relaxes at the learned Θ
    """

    specimens: int
    images: dict[str, int] = field(hash=False)
    sets: int = 60
    loops: int | None = None
    trials: int = 1000
    harder: tuple[int, int] = (5, 1)
    descent: int = 60


FULL = Size(10, {PAPER.name: 1, PACKAGE.name: 5})
QUICK = Size(5, {PAPER.name: 1, PACKAGE.name: 1}, sets=10, loops=6, trials=100, harder=(2, 1), descent=4)
TINY = Size(1, {PAPER.name: 1, PACKAGE.name: 1}, sets=2, loops=1, trials=5, harder=(1, 1), descent=1)
"""For a test of the tool."""


def over_specimens(values) -> tuple[float, float]:
    """Mean of (n,) values and its standard error, NaN for one."""
    values = np.asarray(values, dtype=float)
    return values.mean(), values.std(ddof=1) / np.sqrt(len(values)) if len(values) > 1 else np.nan
