"""Finished sweeps as panels of a picture: one per run (Fig. 3, 5a, 5b), or one per end distance and all together (Fig. 4).

Axes: G grid cells, N terms of the objective.
"""

from dataclasses import fields, replace

import numpy as np

from doo_ti.errors import InputError
from doo_ti.learning.landscape import Landscape
from doo_ti.report import LandscapePanel
from doo_ti.report.plane import Plane

MARKS = "minimum of all together; beside it, those of each end distance"


def run_name(landscape: Landscape, landscapes: list[Landscape]) -> str:
    """What a run is called among others: its material, and its objective where they differ in that."""
    several = len({other.objective for other in landscapes}) > 1
    return f"{landscape.name}, {landscape.objective}" if several else landscape.name


def title_of(landscapes: list[Landscape]) -> str:
    """What the panels show."""
    objectives = sorted({landscape.objective for landscape in landscapes}, reverse=True)
    equations = {"static": "Eq. 2", "dynamic": "Eq. 3"}
    text = " and ".join(f"{objective} ({equations[objective]})" for objective in objectives)
    return f"{text[0].upper()}{text[1:]} error landscape{'s' * (len(landscapes) > 1)}"


def plane_of(landscape: Landscape) -> Plane:
    """The landscape as it is drawn."""
    shape = landscape.grid.shape
    return Plane.of(landscape.grid.picture_axes, landscape.mean_distance.reshape(shape),
                    np.unravel_index(landscape.best, shape), None, landscape.unsound.reshape(shape))


def panels_of_runs(landscapes: list[Landscape]) -> list[list[LandscapePanel]]:
    """One row, a panel per run."""
    return [[LandscapePanel(run_name(landscape, landscapes), plane_of(landscape)) for landscape in landscapes]]


def panels_by_end_distance(landscapes: list[Landscape]) -> list[list[LandscapePanel]]:
    """A row per run: each end distance, then all together; each panel marks the minimum of all together, and that one
    the minima of the others. Raises InputError where end distances are unknown."""
    return [_row(run_name(landscape, landscapes), landscape) for landscape in landscapes]


def in_rows(panels: list[LandscapePanel]) -> list[list[LandscapePanel]]:
    """The panels of one run in rows of four, which fill a page or a view better than one row."""
    return [panels[first:first + 4] for first in range(0, len(panels), 4)]


def _row(name: str, landscape: Landscape) -> list[LandscapePanel]:
    if np.isnan(landscape.end_distance).any():
        raise InputError(landscape.run, "end_distance_mm", "unknown",
                         "leave `by_end_distance` out, or give the observations the label")
    distances = np.unique(landscape.end_distance)
    together = plane_of(landscape)
    parts = [plane_of(_terms(landscape, landscape.end_distance == distance)) for distance in distances]
    row = [LandscapePanel(f"{name}, {distance:g} mm", part, (("", together.minimum),))
           for distance, part in zip(distances, parts, strict=True)]
    marks = tuple((f"{distance:g}", part.minimum) for distance, part in zip(distances, parts, strict=True))
    return [*row, LandscapePanel(f"{name}, all", together, marks)]


def _terms(landscape: Landscape, which: np.ndarray) -> Landscape:
    """The landscape of some of its terms."""
    values = {field.name: getattr(landscape, field.name) for field in fields(landscape)}
    return replace(landscape, **{name: value[..., which] for name, value in values.items() if isinstance(value, np.ndarray)})
