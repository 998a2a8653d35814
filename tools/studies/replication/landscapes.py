"""Eqs. 2 and 3 of a specimen over its scene's grid, in memory; Figs. 1, 3, 4 and 5 with their criteria."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from doo_ti import Landscape, Material, Pairs, distance, predict
from doo_ti.dynamics.scene import load_motion_scene
from doo_ti.learning.experiment import Experiment, journey
from doo_ti.learning.sweeps import chunk_rows
from doo_ti.learning.terms import started
from tools.studies.replication.settings import Setting
from tools.studies.replication.specimens import SCENES, Specimen

CELLS_AT_ONCE = 125
APART_MM, DEEP = 3.2, 0.05


def landscape(specimen: Specimen, setting: Setting, objective: str, pairs: Pairs | None = None) -> Landscape:
    """The distances of all observations, or pairs, in all cells.

    pairs  of Eq. 3; None: the paper's
    """
    options = replace(setting.sweeps, objective=objective, frame_weight=specimen.frame_weight)
    experiment = Experiment(specimen.observations, specimen.grid, options, pairs)
    rows_of = chunk_rows if objective == "static" or setting.relaxed_first else _carried_from_the_observation
    chunks = [rows_of(experiment, first, min(first + CELLS_AT_ONCE, specimen.grid.size))
              for first in range(0, specimen.grid.size, CELLS_AT_ONCE)]
    names = {"distance_mm", "status", "stable"} | ({"jumps"} if objective == "dynamic" else set())
    shape = specimen.grid.size, experiment.terms
    found = {name: np.concatenate([chunk[name] for chunk in chunks]).reshape(shape) for name in names}
    if experiment.pairs is None:
        begin = end = np.arange(experiment.terms)
        weight = np.ones(experiment.terms)
    else:
        begin, end, weight = experiment.pairs.from_index, experiment.pairs.to_index, experiment.pairs.weight
    observations = specimen.observations
    return Landscape(
        run=Path(specimen.name), name=specimen.name, grid=specimen.grid, objective=objective, distance=found["distance_mm"],
        status=found["status"], stable=found["stable"], observation=end, from_observation=begin, weight=weight,
        end_distance=observations.end_distance[end], end_rotation=observations.end_rotation[end], jumps=found.get("jumps"))


def _carried_from_the_observation(experiment: Experiment, first: int, last: int) -> dict[str, np.ndarray]:
    """Eq. 3 as printed, F(Γ^x, E_Θ, C^y): the observation itself is carried, not the rod relaxed from it."""
    materials = experiment.grid.materials(slice(first, last))
    hypothesis, term = experiment.rods
    starts, _ = started(experiment.observations, experiment.clamps, experiment.hypotheses)
    solution, jumps = journey(experiment, materials).end(starts.take(np.tile(hypothesis, materials.count)))
    own = np.tile(experiment.pairs.to_index[term], materials.count)
    off = distance(solution.configuration, experiment.observations, own, experiment.options.frame_weight)
    return {"distance_mm": off, "status": solution.status, "stable": solution.stable, "jumps": jumps}


def best_cells(landscape: Landscape) -> dict[float, int]:
    """The best cell of each end distance."""
    found = {}
    for each in np.unique(landscape.end_distance):
        terms = landscape.end_distance == each
        error = np.where(landscape.sound[:, terms].all(axis=1), landscape.distance[:, terms].mean(axis=1), np.inf)
        found[float(each)] = int(error.argmin())
    return found


def learned(landscape: Landscape, by_distance: bool) -> Material:
    """Θ of the static objective: one, or a row for each observation by its end distance."""
    if not by_distance:
        return landscape.grid.materials(slice(landscape.best, landscape.best + 1))
    best = best_cells(landscape)
    cells = np.array([best[float(each)] for each in landscape.end_distance])
    return landscape.grid.materials().take(cells)


def values(landscape: Landscape, cell: int) -> dict[str, float]:
    """Θ of a cell by name."""
    return {name: float(value[0]) for name, value in landscape.grid.cell_values(np.array([cell])).items()}


def figure_1() -> tuple[dict[str, list[bool]], list[str]]:
    """Three materials from one start through one motion: how far apart they end."""
    scene = load_motion_scene(SCENES / "motion" / "three_materials.toml")
    found = predict(scene.start, scene.material, scene.clamps, scene.path)
    shapes, pairs = found.vertices[-1], [(0, 1), (0, 2), (1, 2)]
    apart = [float(np.linalg.norm(shapes[a] - shapes[b], axis=-1).mean()) for a, b in pairs]
    text = ", ".join(f"{scene.names[a]} and {scene.names[b]} {off:.0f} mm" for (a, b), off in zip(pairs, apart, strict=True))
    return {"apart": [min(apart) >= APART_MM]}, [f"Mean distance of the vertices at the end: {text}."]


def figure_3(specimens: list[dict[str, Landscape]]) -> tuple[dict[str, list[bool]], list[str]]:
    held = [len({one.best for one in landscapes.values()}) == len(landscapes) for landscapes in specimens]
    lines = ["| material | best bend, mm³, by specimen | best β/α, by specimen |", "|---|---|---|"]
    for name in specimens[0]:
        best = [values(one[name], one[name].best) for one in specimens]
        bends = ", ".join(f"{theta['bend_1']:.2g}" for theta in best)
        ratios = ", ".join(f"{theta['twist'] / theta['bend_1']:.2f}" for theta in best)
        lines.append(f"| {name} | {bends} | {ratios} |")
    return {"differ": held}, lines


def figure_4(vicryl: list[Landscape]) -> tuple[dict[str, list[bool]], list[str]]:
    best = [[values(one, cell) for cell in (best_cells(one)[54.0], best_cells(one)[66.0], one.best)] for one in vicryl]
    ratios = np.array([[theta["twist"] / theta["bend_1"] for theta in cells] for cells in best])
    low, high = ratios[:, :2].min(axis=1), ratios[:, :2].max(axis=1)
    between = (low <= ratios[:, 2]) & (ratios[:, 2] <= high)
    held = {"lower": (ratios[:, 0] < ratios[:, 1]).tolist(), "between": between.tolist()}
    columns = ("54 mm", "66 mm", "all")
    texts = (f"{name}: {', '.join(f'{value:.2f}' for value in ratios[:, k])}" for k, name in enumerate(columns))
    return held, [f"β/α of the best cell, by specimen: {'; '.join(texts)}."]


def clear_minima(landscape: Landscape) -> list[int]:
    """The regions of the minima of a landscape over two axes whose basin rises by DEEP of their value before it spills, by
    flooding; cells that do not compete are walls."""
    grid = landscape.grid
    shape = tuple(len(axis) for axis in grid.axes if len(axis) > 1)
    error = np.where(np.isnan(landscape.mean_distance), np.inf, landscape.mean_distance)
    basin, spilled = np.full(grid.size, -1), {}
    for cell in np.argsort(error, kind="stable"):
        if not np.isfinite(error[cell]):
            break
        row, column = np.unravel_index(cell, shape)
        beside = [np.ravel_multi_index(place, shape) for place in
                  ((row - 1, column), (row + 1, column), (row, column - 1), (row, column + 1))
                  if 0 <= place[0] < shape[0] and 0 <= place[1] < shape[1]]
        basins = sorted({int(basin[other]) for other in beside if basin[other] >= 0}, key=lambda bottom: error[bottom])
        basin[cell] = basins[0] if basins else cell
        for bottom in basins[1:]:
            spilled[bottom] = error[cell] / error[bottom] - 1
            basin[basin == bottom] = basins[0]
    return [_region(landscape, cell) for cell, depth in {int(error.argmin()): np.inf, **spilled}.items() if depth >= DEEP]


def _region(landscape: Landscape, cell: int) -> int:
    """The paper's regions 1 to 3; 0: β is between the two bend stiffnesses."""
    theta = values(landscape, cell)
    first, second, twist = theta["bend_1"], theta["bend_2"], theta["twist"]
    if twist > max(first, second):
        return 1
    return 0 if twist >= min(first, second) else 2 if second > first else 3


def figure_5(ribbons: list[tuple[Landscape, Landscape]]) -> tuple[dict[str, list[bool]], list[str]]:
    """ribbons: for each specimen the static and the dynamic landscape."""
    held, lines = {"dynamic": [], "static": [], "axis": []}, []
    for number, pair in enumerate(ribbons):
        clear = [clear_minima(each) for each in pair]
        best = [values(each, each.best) for each in pair]
        held["static"].append(not {2, 3} <= set(clear[0]))
        held["dynamic"].append({2, 3} <= set(clear[1]))
        held["axis"].append(all(theta["bend_1"] > theta["bend_2"] for theta in best))
        for name, theta, regions, each in zip(("Eq. 2", "Eq. 3"), best, clear, pair, strict=True):
            lines.append(f"- specimen {number}, {name}: best α1 {theta['bend_1']:.2g}, α2 {theta['bend_2']:.2g} mm³ (region "
                         f"{_region(each, each.best)}), {each.mean_distance[each.best]:.2f} mm; {len(regions)} clear minima, "
                         f"in regions {', '.join(map(str, sorted(set(regions))))}")
    truth = "Truth: α1 6e6, α2 1.2e5, β 5e5 mm³. Region 0: β is between α1 and α2."
    return held, [truth, "", *lines]
