"""Fig. 7: twist from perceived shapes, D = 1 to 6 observations, and the histogram of its errors."""

from dataclasses import dataclass, replace

import numpy as np

from doo_ti.rod.types import Material
from doo_ti.twist.curves import end_offsets
from doo_ti.twist.estimation import TwistVerdict
from tools.studies.replication.images import Seen
from tools.studies.replication.settings import over_specimens
from tools.studies.replication.specimens import Specimen
from tools.studies.trials.twist import SUCCESS, twist_trials

MOST_TOGETHER = 6
PAPER = {1: 0.533, 6: 0.80}
NEAR, AMBIGUOUS = 0.10, 0.10
BINS_DEG = (0, 15, 30, 60, 90, 180, 360, 720)


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


def percent(values) -> str:
    """``98.5 ± 0.3 %``: mean and standard error over specimens."""
    mean, error = over_specimens(values)
    return f"{100 * mean:.1f} %" if np.isnan(error) else f"{100 * mean:.1f} ± {100 * error:.1f} %"
