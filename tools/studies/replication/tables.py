"""Tables I to III (§V-B, §V-C) over several specimens, and their criteria."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from doo_ti import Landscape
from doo_ti.learning.cross_validation import Part, Scores, chosen_cells, cross_validate, partition
from tools.studies.replication.settings import entry, over_specimens

DISTANCES = (30.0, 54.0, 78.0)
LARGEST_MM, NEAR, STATIC_RATIO, COLUMNS_ON_DIAGONAL = 3.2, 0.07, 1.32, 6
"""Of the paper's criteria: :mod:`tools.studies.replication.criteria`."""
PAPER_I = ((1.40, 3.09, 2.14), (1.59, 2.56, 2.73), (1.36, 3.201, 2.15))
PAPER_II = (
    (1.02, 1.13, 1.71, 2.61, 3.70, 3.27, 1.93, 2.61, 2.35), (1.05, 1.08, 1.65, 2.32, 3.27, 3.25, 1.81, 2.34, 2.47),
    (1.43, 1.25, 1.65, 1.99, 2.33, 2.97, 2.18, 2.16, 2.72), (1.78, 1.39, 1.59, 1.85, 1.88, 2.97, 2.34, 2.24, 2.93),
    (2.05, 1.56, 1.63, 1.85, 1.74, 3.04, 2.41, 2.23, 3.04), (1.61, 1.32, 1.58, 1.85, 2.14, 3.16, 2.25, 2.28, 2.91),
    (1.15, 1.08, 1.66, 2.56, 3.09, 3.11, 1.83, 2.06, 2.44), (2.17, 1.66, 1.66, 2.07, 2.17, 3.52, 1.95, 1.85, 3.04),
    (2.37, 2.31, 1.96, 5.25, 5.56, 3.45, 3.52, 3.87, 2.20))
PAPER_III = (
    (1.81, 2.69, 3.33, 4.57, 6.92, 10.43), (1.98, 2.36, 3.40, 6.72, 8.84, 10.88), (3.99, 5.02, 3.09, 5.57, 10.73, 11.13),
    (2.17, 3.01, 3.42, 1.50, 4.81, 8.59), (1.99, 3.11, 3.38, 2.03, 4.67, 8.44), (1.95, 3.47, 3.29, 3.09, 5.11, 8.43))


@dataclass(frozen=True)
class TableRuns:
    """A table of S specimens: ``held`` by criterion, a bool for each; ``mean`` (S, P, P) mm; ``labels`` (P,)."""

    held: dict[str, list[bool]]
    mean: np.ndarray
    labels: tuple[str, ...]

    @classmethod
    def of(cls, scores: list[Scores], holds: Callable[[Scores], dict[str, bool]]) -> "TableRuns":
        held, labels = [holds(one) for one in scores], tuple(part.label for part in scores[0].partition.parts)
        return cls({name: [one[name] for one in held] for name in held[0]}, np.stack([one.mean for one in scores]), labels)


def scored(landscapes: list[Landscape], by: tuple[str, ...]) -> Scores:
    (found,) = partition(landscapes, by, DISTANCES if "end-distance" in by else ())
    return cross_validate(found)


def table_1(specimens: list[dict[str, Landscape]]) -> TableRuns:
    """specimens: for each the static landscape of every material, nylon, silk, vicryl."""
    return TableRuns.of([scored(list(one.values()), ("material",)) for one in specimens], _table_1_holds)


def _table_1_holds(found: Scores) -> dict[str, bool]:
    mean, error = found.mean, found.standard_error
    nylon, silk, vicryl = range(3)
    alike = all(abs(mean[nylon, column] - mean[vicryl, column]) <= max(error[nylon, column], error[vicryl, column])
                for column in (nylon, vicryl))
    return {"silk": all(mean[row, silk] > mean[silk, silk] + error[silk, silk] for row in (nylon, vicryl)), "alike": alike,
            "size": bool((mean.diagonal() <= LARGEST_MM).all()), "own": bool((mean.argmin(axis=0) == np.arange(3)).all())}


def table_2(specimens: list[dict[str, Landscape]]) -> TableRuns:
    return TableRuns.of([scored(list(one.values()), ("material", "end-distance")) for one in specimens], _table_2_holds)


def _table_2_holds(found: Scores) -> dict[str, bool]:
    diagonal, least = found.mean.diagonal(), found.mean.min(axis=0)
    whole = [_trained_on_all(part) for part in found.partition.parts]
    return {"diagonal": (diagonal <= least).sum() >= COLUMNS_ON_DIAGONAL, "near": (diagonal <= (1 + NEAR) * least).all(),
            "split": diagonal.mean() < np.mean(whole)}


def _trained_on_all(part: Part) -> float:
    """Mean error of a part under Θ of its material, all end distances, leave-one-out."""
    landscape = part.landscape
    cells = chosen_cells(Part(part.label, landscape, np.arange(len(landscape.observation))), part.ends)
    return float(landscape.distance[cells, part.terms].mean())


def table_3(specimens: list[tuple[Landscape, Landscape]]) -> TableRuns:
    """specimens: for each the static and the dynamic landscape of one material."""
    return TableRuns.of([scored(list(one), ("objective", "end-distance")) for one in specimens], _table_3_holds)


def _table_3_holds(found: Scores) -> dict[str, bool]:
    mean, error, count = found.mean, found.standard_error, len(found.partition.parts) // 2
    static, dynamic = mean[:count], mean[count:]
    better = dynamic[:, count:].diagonal() + error[count:, count:].diagonal() < static[:, count:].diagonal()
    ratio = dynamic[:, :count].diagonal() / static[:, :count].diagonal()
    return {"diagonal": (mean.argmin(axis=0) == np.arange(2 * count)).all(), "dynamic": better.all(),
            "static": (ratio <= STATIC_RATIO).all()}


def gain(runs: TableRuns) -> tuple[float, float, float]:
    """What Θ of Eq. 3 gains over Θ of Eq. 2, tested on Eq. 3 at the same end distance, mean over distances: mm, its standard
    error over specimens, and the error under Θ of Eq. 2."""
    count = len(runs.labels) // 2
    static = runs.mean[:, :count, count:].diagonal(axis1=1, axis2=2).mean(axis=1)
    dynamic = runs.mean[:, count:, count:].diagonal(axis1=1, axis2=2).mean(axis=1)
    return *over_specimens(static - dynamic), static.mean()


def beside(paper: tuple, runs: list[TableRuns]) -> list[str]:
    """The paper's numbers beside those of the configurations: lines of Markdown."""
    labels = runs[0].labels
    lines = ["| train \\ test | " + " | ".join(labels) + " |", "|---" * (len(labels) + 1) + "|"]
    for row, label in enumerate(labels):
        entries = [" / ".join([f"{paper[row][column]:.2f}", *(entry(one.mean[:, row, column]) for one in runs)])
                   for column in range(len(labels))]
        lines.append(f"| {label} | " + " | ".join(entries) + " |")
    return lines
