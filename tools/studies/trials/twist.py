"""Success rate of Eq. 4 on rods with known twist (§V-F, Fig. 7).

A trial takes some configurations of one rod at random. Where they are several, the reported end frames and total twist
are rotated by one hidden angle, which Eq. 4 has to find.
A trial succeeds where φ is within a quarter turn of the truth, whole turns counted.

Axes: D configurations of a trial, K trials, N = K·D observations.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from doo_ti.rod.frames import turned_about_tangent
from doo_ti.rod.observations import Observations
from doo_ti.rod.types import Material
from doo_ti.twist.curves import end_offsets
from doo_ti.twist.estimation import TwistEstimate, TwistOptions, estimate_twist

SUCCESS = np.pi / 2
"""rad, as in §V-F."""


@dataclass(frozen=True)
class Trials:
    """Results of K trials of D configurations.

    configurations  (K, D) rows of the observations
    truth           (K,) rad, total twist less τ, mean over the trial
    estimate        the estimate of Eq. 4
    """

    configurations: np.ndarray
    truth: np.ndarray
    estimate: TwistEstimate

    @property
    def error(self) -> np.ndarray:
        """(K,) |φ − truth| in rad, whole turns counted; NaN where nothing was found."""
        return np.abs(self.estimate.phi - self.truth)

    @property
    def successful(self) -> np.ndarray:
        """(K,) bool."""
        return self.error <= SUCCESS


def twist_trials(
    observations: Observations, total_twist: np.ndarray, material: Material, together: int, count: int, seed: int,
    options: TwistOptions | None = None, advance: Callable[[int], None] = lambda rods: None,
) -> Trials:
    """``count`` random trials of ``together`` configurations of one rod.

    observations  with ``end_frame`` where trials are of several; labelled vertices or perceived ones
    total_twist   (N,) the true one of each observation, rad
    material      Θ, one for all or one for each observation
    """
    random = np.random.default_rng([seed, together])
    chosen = np.argsort(random.random((count, observations.count)), axis=1)[:, :together]
    hidden = random.uniform(-np.pi, np.pi, count)
    rows, group = chosen.ravel(), np.repeat(np.arange(count), together)
    known, twist = observations.take(rows), np.asarray(total_twist)[rows]
    offset = np.zeros(len(rows))
    if together > 1:
        turned = turned_about_tangent(known.end_frame, hidden[group])
        offset = end_offsets(replace(known, end_frame=turned, total_twist=twist + hidden[group]), group)
    if material.count > 1:
        material = material.take(rows)
    estimate = estimate_twist(known, material, group, offset, options or TwistOptions(), advance)
    truth = (twist - offset).reshape(count, together).mean(axis=1)
    return Trials(chosen, truth, estimate)
