"""Fig. 7 (§V-F): twist from perceived shapes by Eq. 4, D = 1 to 6 observations, and the histogram of its errors.

A trial takes some configurations of one rod at random. Where they are several, the reported end frames and total twist
are rotated by one hidden angle, which Eq. 4 has to find.
A trial succeeds where φ is within a quarter turn of the truth, whole turns counted.

Axes: D configurations of a trial, K trials, N = K·D observations.
"""

from dataclasses import dataclass, replace

import numpy as np

from doo_ti import Material, Observations, TwistEstimate, TwistVerdict, end_offsets, estimate_twist
from doo_ti.rod.frames import turned_about_tangent
from tools.studies.replication.images import Seen
from tools.studies.replication.settings import entry
from tools.studies.replication.specimens import Specimen

SUCCESS = np.pi / 2  # rad, as in §V-F
MOST_TOGETHER = 6
PAPER = {1: 0.533, 6: 0.80}
NEAR, AMBIGUOUS = 0.10, 0.10
BINS_DEG = (0, 15, 30, 60, 90, 180, 360, 720)


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


def twist_trials(observations: Observations, total_twist: np.ndarray, material: Material, together: int, count: int,
                 seed: int) -> Trials:
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
    estimate = estimate_twist(known, material, group, offset)
    truth = (twist - offset).reshape(count, together).mean(axis=1)
    return Trials(chosen, truth, estimate)


@dataclass(frozen=True)
class Errors:
    """Of one specimen of each material: by D the errors (n,) in rad, NaN where nothing was found, and at D = 1 the share of
    ambiguous estimates."""

    by_count: dict[int, np.ndarray]
    ambiguous: float

    def success(self, together: int) -> float:
        """Share of errors within a quarter turn; NaN where there are too few rods for that many."""
        return float(np.mean(self.by_count[together] <= SUCCESS)) if together in self.by_count else np.nan


def twist_errors(specimens: dict[str, Specimen], seen: dict[str, Seen], theta: dict[str, Material], trials: int,
                 seed: int) -> Errors:
    """theta: by material, one, or a row for each observation of the specimen."""
    fewest = min(np.isfinite(rods.vertices).all(axis=(1, 2)).sum() for rods in seen.values())
    errors, ambiguous = {together: [] for together in range(1, min(MOST_TOGETHER, fewest) + 1)}, []
    for name, specimen in specimens.items():
        rods = seen[name]
        sound = np.isfinite(rods.vertices).all(axis=(1, 2))
        labelled = specimen.observations.take(rods.rows[sound])
        true = replace(labelled, vertices=rods.truth[sound])
        total_twist = end_offsets(true, np.arange(true.count))
        shapes = replace(labelled, vertices=rods.vertices[sound], total_twist=total_twist)
        material = theta[name] if theta[name].count == 1 else theta[name].take(rods.rows[sound])
        for together in errors:
            found = twist_trials(shapes, total_twist, material, together, trials, seed)
            errors[together].append(found.error)
            if together == 1:
                ambiguous.append(np.mean(found.estimate.verdict == TwistVerdict.AMBIGUOUS))
    return Errors({together: np.concatenate(parts) for together, parts in errors.items()}, float(np.mean(ambiguous)))


def figure_7(specimens: list[Errors]) -> tuple[dict[str, list[bool]], list[str]]:
    success = np.array([[one.success(together) for together in one.by_count] for one in specimens])
    held = {"grows": (success[:, -1] > success[:, 0]).tolist(),
            "least": ((success[:, 0] >= PAPER[1]) & (success[:, -1] >= PAPER[6])).tolist(),
            "near": (np.abs(success[:, 0] - PAPER[1]) <= NEAR).tolist(),
            "range": [one.ambiguous >= AMBIGUOUS for one in specimens]}
    bins = [f"{low}–{high}°" for low, high in zip(BINS_DEG[:-1], BINS_DEG[1:], strict=True)]
    lines = ["| D | within 90° | paper | median | " + " | ".join(bins) + " |", "|---" * (4 + len(bins)) + "|"]
    for column, together in enumerate(specimens[0].by_count):
        errors = np.degrees(np.concatenate([one.by_count[together] for one in specimens]))
        shares = np.histogram(errors[np.isfinite(errors)], BINS_DEG)[0] / len(errors)
        paper = f"{PAPER[together]:.1%}" if together in PAPER else ""
        lines.append(f"| {together} | {percent(success[:, column])} | {paper} | {np.nanmedian(errors):.0f}° | "
                     + " | ".join(f"{share:.1%}" for share in shares) + " |")
    return held, [*lines, "", f"Ambiguous at D = 1: {percent([one.ambiguous for one in specimens])}."]


def percent(shares) -> str:
    return f"{entry(100 * np.asarray(shares), 1)} %"
