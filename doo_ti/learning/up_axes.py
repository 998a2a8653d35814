"""Whether another axis than the one given as ``up`` explains the observations far better: data recorded with y upwards and read
with z upwards fit some stiff rod, with narrow intervals, and nothing in the fit shows that gravity was wrong.

Up to MOST observations are relaxed under the given direction, under those axes ±x, ±y, ±z that are far from it, and without
weight, each with stiffness on a coarse grid and then around the best cell. With q the mean square distance of an observation's
marks, and m the median of the least q of each observation in all the grids, the misfit of a direction is

    M = ½ mean_d ln(m + q_d),

so that one mislabelled observation counts little, and neither does what is far below the errors that every direction leaves.
M(no weight) − M(up) is what gravity along ``up`` explains. Of D observations another axis fits far better where

    M(given) − M(other) > M(no weight) − M(given) + CLEAR/√D.

The first term rests on gravity: of a rod that feels its weight the right axis explains some of the shape, a wrong one next to
nothing, and then the grid ends at stiff rods. It keeps rest curvature and clips, which are not in this model and which a wrong
axis may imitate, from outvoting a right axis that does explain. The second is chance: each observation says which axis is
nearer with an error of about one, in units of ln. Planar observations, and rods that their weight does not bend, leave all M
alike, and no axis is named.
"""

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import ArrayLike

from doo_ti.contact.surroundings import Surroundings
from doo_ti.relaxation.relax import relax
from doo_ti.rod.observations import Observations
from doo_ti.rod.start import start_configuration, turn_hypotheses
from doo_ti.rod.types import Clamp, Clamps, Material

MOST = 24  # observations that are relaxed, evenly among all
CLEAR = 1.25
"""In units of ln, of a single observation. Chosen among rods of independent solvers and of a motion capture: of 50 sets, and
of random draws of 2 to 24 of their observations, none under its right axis came to more than 85 % of exp(CLEAR/√D)."""
FAR = 0.8  # cosine: axes closer to the given direction are not other ones
LEAST = 1e-4  # of the rod's length: misfits below it are alike
STIFFNESS = np.geomspace(3e-4, 3.0, 8)  # B/(2 μ L³) of the coarse grid: from limp rods to those that hardly sag
AROUND = np.geomspace(0.4, 2.5, 5)
TWIST_RATIOS = np.array([0.4, 0.9, 2.0])
RATIOS_AROUND = np.array([0.67, 1.0, 1.5])
NO_WEIGHT_RATIOS = np.geomspace(0.2, 4.0, 7)


@dataclass(frozen=True)
class OtherUp:
    """An axis that fits far better than the direction that was given."""

    up: tuple[float, ...]  # the axis, three numbers
    option: str  # the option that sets it
    also: tuple[str, ...]  # names of other axes that fit far better, too, and that the first does not rule out
    misfit_mm: float  # typical distance of a mark with the axis upwards
    given_misfit_mm: float  # the same with the given direction upwards
    without_gravity_mm: float  # and of rods without weight
    observations: int  # number of observations that were relaxed

    @property
    def text(self) -> str:
        """What was found, and the remedy."""
        also = f" ({', '.join(self.also)} fits far better, too)" if self.also else ""
        return (f"with {_name(self.up)} upwards the rods fit far better: marks are off by {self.misfit_mm:.3g} mm, and by "
                f"{self.given_misfit_mm:.3g} mm with the direction given ({self.without_gravity_mm:.3g} mm without "
                f"gravity){also}; if they were recorded so, give {self.option}; if they lay on something, --obstacles")


def other_up(observations: Observations, clamps: Clamps, up: ArrayLike | None = None,
             surroundings: Surroundings = Surroundings()) -> OtherUp | None:
    """The axis that explains the observations far better than ``up``, by default their own, or None.

    clamps        of the observations
    up            (3,) direction against gravity
    surroundings  what the rods touch, with one row for all observations or one for each
    """
    up = observations.up if up is None else np.asarray(up, dtype=float)
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    axes = axes[axes @ up < FAR]
    trial = _Trial.of(observations, clamps, surroundings)
    grids = [trial.squares(STIFFNESS, trial.ratios, direction) for direction in (up, *axes)]
    least = np.min([squares.min(axis=0) for squares in grids], axis=0)
    floor = max(float(np.median(least)), (LEAST * trial.observations.length) ** 2)
    given, *others = (trial.least(squares, direction, floor) for squares, direction in zip(grids, (up, *axes), strict=True))
    no_weight = trial.squares(STIFFNESS[-1:], NO_WEIGHT_RATIOS if trial.twists else trial.ratios, up, weight=0.0)
    nothing, chance = max(_misfit(no_weight, floor).min(), given), CLEAR / np.sqrt(trial.observations.count)

    def rules_out(better: float, worse: float) -> bool:
        return worse - better > max(nothing - worse, 0.0) + chance

    best = int(np.argmin(others))
    if not rules_out(others[best], given):
        return None
    also = tuple(_name(axes[k]) for k in np.argsort(others, kind="stable")[1:]
                 if rules_out(others[k], given) and not rules_out(others[best], others[k]))
    size = [float(np.sqrt(max(np.exp(2 * misfit) - floor, 0.0))) for misfit in (others[best], given, nothing)]
    return OtherUp(tuple((axes[best] + 0.0).tolist()), f"--up {_name(axes[best])}", also, *size, trial.observations.count)


def other_up_of(observations: Observations, clamps: Clamps, weight: float, up: ArrayLike, surroundings: Surroundings
                ) -> dict | None:
    """What :func:`other_up` finds for rods of that ``weight``, as JSON holds it; None where they have none."""
    found = None if weight == 0 else other_up(observations, clamps, up, surroundings)
    return None if found is None else asdict(found)


def _name(axis: ArrayLike) -> str:
    """``y`` or ``-y``."""
    side = int(np.abs(axis).argmax())
    return "-" * bool(axis[side] < 0) + "xyz"[side]


def _misfit(squares: np.ndarray, floor: float) -> np.ndarray:
    """(G,) M of each material of (G, D) ``squares``."""
    return 0.5 * np.log(floor + squares).mean(axis=-1)


@dataclass(frozen=True)
class _Trial:
    """The rods to relax: D observations, with H hypotheses of all."""

    observations: Observations
    clamps: Clamps
    surroundings: Surroundings
    counts: np.ndarray  # (D, V) bool: marks that are compared: not those that the clamps were taken from

    @classmethod
    def of(cls, observations: Observations, clamps: Clamps, surroundings: Surroundings) -> "_Trial":
        rows = np.unique(np.linspace(0, observations.count - 1, MOST).round().astype(int))
        observations, clamps = observations.take(rows), clamps.take(rows)
        counts = observations.valid.copy()
        for kind, outer, inner in ((clamps.start, 0, 1), (clamps.end, -1, -2)):
            counts[:, outer] &= np.asarray(kind) < Clamp.POSITION
            counts[:, inner] &= np.asarray(kind) < Clamp.TANGENT
        return cls(observations, clamps, surroundings.take(rows), counts)

    @property
    def twists(self) -> bool:
        """Whether both ends hold the roll of some rod, so that the stiffness against twist matters."""
        return bool((np.minimum(self.clamps.start, self.clamps.end) == Clamp.FRAME).any())

    @property
    def ratios(self) -> np.ndarray:
        """Twist over bend stiffness, of the coarse grid."""
        return TWIST_RATIOS if self.twists else np.ones(1)

    def squares(self, stiffness: np.ndarray, ratios: np.ndarray, up: np.ndarray, weight: float = 1.0) -> np.ndarray:
        """(G, D) mean square distance of the marks, mm², for each pair of B/(2 μ L³) and twist ratio; of a rod that failed
        L²."""
        seen = self.observations
        index, turns = turn_hypotheses(seen, self.clamps)
        held = self.clamps.take(index)
        starts = start_configuration(seen.take(index), held, turns)
        bend = 2 * seen.length**3 * np.repeat(stiffness, len(ratios))
        materials = Material(bend, bend * np.tile(ratios, len(stiffness)), weight)
        of_material, hypothesis = np.divmod(np.arange(materials.count * len(index)), len(index))
        rows = index[hypothesis]
        found = relax(starts, materials, held, up=up, configuration_index=hypothesis, material_index=of_material,
                      **self.surroundings.take(rows).arguments)
        apart = found.configuration.vertices - np.nan_to_num(seen.vertices)[rows]
        counts = self.counts[rows]
        square = np.where(counts, (apart**2).sum(axis=-1), 0.0).sum(axis=1) / np.maximum(counts.sum(axis=1), 1)
        square = np.where(found.converged & found.stable, square, seen.length**2).reshape(materials.count, len(index))
        return np.minimum.reduceat(square, np.searchsorted(index, np.arange(seen.count)), axis=1)

    def least(self, squares: np.ndarray, up: np.ndarray, floor: float) -> float:
        """M of the best material around the best of the coarse grid, of which the (G, D) ``squares`` are."""
        misfit = _misfit(squares, floor)
        cell, ratio = np.divmod(int(np.argmin(misfit)), len(self.ratios))
        ratios = self.ratios[ratio] * (RATIOS_AROUND if self.twists else np.ones(1))
        around = self.squares(STIFFNESS[cell] * AROUND, ratios, up)
        return float(min(misfit.min(), _misfit(around, floor).min()))
