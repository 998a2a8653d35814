"""The two configurations, and how much is run."""

from dataclasses import dataclass

import numpy as np

from doo_ti import DetectionOptions, Newton, PerceptionOptions, SweepOptions

NU = PerceptionOptions().nu
AS_THE_PAPER = PerceptionOptions(
    nu=NU, growing_nu=NU, cap=1e4, growing_cap=1e4, children=PerceptionOptions().samples, growing_iterations=50, finalists=1,
    pieces=1, final_points=PerceptionOptions().points, evidence="rod")
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

    name         of the size
    specimens    of each material, the first one that of the shipped scene
    ribbons      specimens of the ribbon
    images       of the specimens, those whose images are perceived, and rods of each, of 60; by setting
    loops        threads in loops, and rods of each, None: all that cross themselves in every view; by setting
    trials       of Fig. 7, for each specimen and D
    harder       of each harder laboratory: specimens, rods of each whose images are perceived, trials
    descent      observations of each material that the paper's own scheme relaxes at the learned Θ
    """

    name: str
    specimens: int
    ribbons: int
    images: dict[str, tuple[int, int]]
    loops: dict[str, tuple[int, int | None]]
    trials: int
    harder: tuple[int, int, int]
    descent: int


FULL = Size("full", 6, 3, {PAPER.name: (1, 60), PACKAGE.name: (5, 60)}, {PAPER.name: (3, 4), PACKAGE.name: (3, None)}, 1000,
            (2, 8, 200), 60)
QUICK = Size("quick", 2, 1, {PAPER.name: (1, 6), PACKAGE.name: (1, 6)}, {PAPER.name: (1, 1), PACKAGE.name: (1, 2)}, 100,
             (1, 6, 50), 4)
TINY = Size("tiny", 1, 1, {PAPER.name: (1, 1), PACKAGE.name: (1, 2)}, {PAPER.name: (1, 1), PACKAGE.name: (1, 1)}, 4,
            (1, 1, 4), 1)
"""For a test of the tool: too small for a verdict."""


def over_specimens(values) -> tuple[float, float]:
    """Mean of (n,) values and its standard error, NaN for one."""
    values = np.asarray(values, dtype=float)
    return values.mean(), values.std(ddof=1) / np.sqrt(len(values)) if len(values) > 1 else np.nan


def entry(values, digits: int = 2) -> str:
    """``0.36 ± 0.02``: mean and standard error over specimens."""
    mean, error = over_specimens(values)
    return f"{mean:.{digits}f}" if np.isnan(error) else f"{mean:.{digits}f} ± {error:.{digits}f}"
