"""How a ribbon looks in each of the regimes of Fig. 5: under the middle cell of each, between the same clamps (Fig. 5c).

Axes: D terms of the objective, one ribbon each in every regime, V vertices.
"""

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from doo_ti.contact_sheet import contact_sheet, known, observation_names
from doo_ti.io.files import write_whole
from doo_ti.learning.cells import relax_cells
from doo_ti.learning.experiment import Experiment
from doo_ti.learning.landscape import Landscape
from doo_ti.record import record_ribbons
from doo_ti.report import Ribbons, quantity, ribbon_sides, ribbons_picture, values_text
from doo_ti.report.plane import REGIMES, regime
from doo_ti.types import Status

COLORS = ((214, 57, 57), (52, 158, 79), (48, 105, 205))
"""Red, green and blue as in the paper."""
OBSERVED = (120, 120, 120)


@dataclass(frozen=True)
class Regime:
    """The ribbons of one regime.

    number    1 to 3, as `REGIMES` counts them
    cell      the cell in its middle, where its number stands in the landscape
    mean      mm, the mean distance there
    theta     what the cell is, in words
    vertices  (D, V, 3) mm
    across    (D, V - 1, 3) m1 of each edge
    distance  (D,) Eq. 1, mm
    sound     (D,) bool: certified minima
    """

    number: int
    cell: int
    mean: float
    theta: str
    vertices: np.ndarray
    across: np.ndarray
    distance: np.ndarray
    sound: np.ndarray

    @property
    def label(self) -> str:
        return f"{self.number}: {REGIMES[self.number - 1]}"


def regimes_of(experiment: Experiment, landscape: Landscape) -> list[Regime]:
    """The regimes that have cells in the grid."""
    values = landscape.grid.cell_values()
    bends = np.log(np.stack([values["bend_1"], values["bend_2"]], axis=-1))
    of_cell = regime(values["bend_1"], values["bend_2"], values["twist"])
    found = []
    for number in range(1, len(REGIMES) + 1):
        cells = np.flatnonzero(of_cell == number)
        if not len(cells):
            continue
        cell = int(cells[np.argmin(np.linalg.norm(bends[cells] - bends[cells].mean(axis=0), axis=-1))])
        columns, configuration = relax_cells(experiment, cell, cell + 1)
        theta = values_text([(name, values[name][cell], "mm³") for name in ("bend_1", "bend_2")])
        found.append(Regime(number, cell, float(landscape.mean_distance[cell]), theta, configuration.vertices,
                            configuration.frames[..., 1], columns["distance_mm"],
                            (columns["status"] == Status.CONVERGED) & columns["stable"]))
    return found


def difference(regimes: list[Regime]) -> np.ndarray:
    """(D,) mm by which the ribbons of a term lie apart, on average over vertices and pairs of regimes; −1 where one of
    them is no certified minimum."""
    shapes = np.stack([found.vertices for found in regimes])
    apart = np.linalg.norm(shapes[:, None] - shapes[None], axis=-1).mean(axis=(0, 1, 3))
    return np.where(np.all([found.sound for found in regimes], axis=0), apart, -1.0)


def draw_regimes(stem: Path, name: str, experiment: Experiment, landscape: Landscape,
                 observation: int | None) -> list[Path]:
    """Write ``stem``.png, the ribbons of an observation, by default of the one where they differ most, and ``stem``.rrd,
    those of all; returns the files, none where the grid has no regime."""
    regimes = regimes_of(experiment, landscape)
    if not regimes:
        return []
    observed, seen = experiment.observations, landscape.observation
    apart = difference(regimes)
    if observation is not None:
        apart[seen == observation] += apart.max() + 2
    order = np.argsort(apart, kind="stable")
    rank, term = np.argsort(order, kind="stable"), order[-1]
    labels = known({"end_distance_mm": observed.end_distance, "end_rotation_deg": observed.end_rotation})
    names = [observation_names(labels, observed.count)[d] for d in seen]
    ribbons = _ribbons(experiment, landscape, regimes)
    marks = np.where(observed.valid[..., None], observed.vertices, np.nan)
    basis = contact_sheet(marks[[seen[term]]], {}, observed.up).basis
    title = f"{name}, {names[term]}: one ribbon between the same clamps in each regime"
    if lost := [str(found.number) for found in regimes if not found.sound[term]]:
        title += f"\nno certified minimum in regime {', '.join(lost)}"
    picture, recording = stem.with_suffix(".png"), stem.with_suffix(".rrd")
    write_whole(picture, lambda file: ribbons_picture(file, ribbons, term, basis=basis, title=title))
    digest = hashlib.sha256(b"".join(np.ascontiguousarray(found.vertices).tobytes() for found in regimes))
    record_ribbons(recording, run_id=digest.hexdigest()[:32], name=f"{name}: regimes", ribbons=ribbons,
                   observation=seen, rank=rank, texts=[_text(names[k], regimes, k) for k in range(len(seen))], basis=basis)
    return [picture, recording]


def _ribbons(experiment: Experiment, landscape: Landscape, regimes: list[Regime]) -> list[Ribbons]:
    """Those of each regime, before them the observed ones where frames were measured; as wide as w_m of Eq. 1, if it is."""
    observed, seen = experiment.observations, landscape.observation
    width = experiment.options.frame_weight or observed.rest_length.sum() / 15
    ribbons = []
    if observed.frames is not None and observed.valid.all():
        sides = ribbon_sides(observed.vertices, observed.frames[..., 1], width)[seen]
        ribbons = [Ribbons("observed", OBSERVED, sides, filled=False)]
    label = "{}\n{}\nmean distance {} over all observations"
    return ribbons + [Ribbons(label.format(found.label, found.theta, quantity(found.mean, "mm")), COLORS[found.number - 1],
                              ribbon_sides(found.vertices, found.across, width)) for found in regimes]


def _text(name: str, regimes: list[Regime], term: int) -> str:
    """What stands beside the ribbons of a term, in Markdown."""
    lines = [f"**{name}**", "", "| regime | Θ | distance (Eq. 1) | mean over all |", "|---|---|---|---|"]
    lines += [f"| {found.label} | {found.theta} | **{quantity(found.distance[term], 'mm')}**"
              f"{'' if found.sound[term] else ', not a certified minimum'} | {quantity(found.mean, 'mm')} |"
              for found in regimes]
    return "\n".join([*lines, "", "Red, green, blue: regimes 1, 2, 3, each under the cell where its number stands in "
                                "the landscape; grey: observed."])
