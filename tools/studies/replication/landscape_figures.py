"""Figs. 1, 3, 4 and 5: their criteria."""

from dataclasses import dataclass

import numpy as np

from doo_ti import Landscape, predict
from doo_ti.dynamics.scene import load_motion_scene
from tools.studies.replication.landscapes import best_cells, values
from tools.studies.replication.specimens import SCENES

APART_MM, DEEP = 3.2, 0.05


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
    ratios = np.array([[_ratio(one, best_cells(one)[54.0]), _ratio(one, best_cells(one)[66.0]), _ratio(one, one.best)]
                       for one in vicryl])
    low, high = ratios[:, :2].min(axis=1), ratios[:, :2].max(axis=1)
    between = (low <= ratios[:, 2]) & (ratios[:, 2] <= high)
    held = {"lower": (ratios[:, 0] < ratios[:, 1]).tolist(), "between": between.tolist()}
    columns = ("54 mm", "66 mm", "all")
    texts = (f"{name}: {', '.join(f'{value:.2f}' for value in ratios[:, k])}" for k, name in enumerate(columns))
    return held, [f"β/α of the best cell, by specimen: {'; '.join(texts)}."]


def _ratio(landscape: Landscape, cell: int) -> float:
    theta = values(landscape, cell)
    return theta["twist"] / theta["bend_1"]


@dataclass(frozen=True)
class Minimum:
    """A minimum of a landscape; ``depth``: how far its basin rises before it spills, over its value."""

    cell: int
    region: int
    value: float
    depth: float


def minima(landscape: Landscape) -> list[Minimum]:
    """All minima of a landscape over two axes, by flooding; cells that do not compete are walls."""
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
    deepest = int(error.argmin())
    return [Minimum(cell, _region(landscape, cell), float(error[cell]), float(depth))
            for cell, depth in {deepest: np.inf, **spilled}.items()]


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
        clear = [{one.region for one in minima(each) if one.depth >= DEEP} for each in pair]
        best = [values(each, each.best) for each in pair]
        held["static"].append(not {2, 3} <= clear[0])
        held["dynamic"].append({2, 3} <= clear[1])
        held["axis"].append(all(theta["bend_1"] > theta["bend_2"] for theta in best))
        for name, theta, regions, each in zip(("Eq. 2", "Eq. 3"), best, clear, pair, strict=True):
            deep = [one for one in minima(each) if one.depth >= DEEP]
            lines.append(f"- specimen {number}, {name}: best α1 {theta['bend_1']:.2g}, α2 {theta['bend_2']:.2g} mm³ (region "
                         f"{_region(each, each.best)}), {each.mean_distance[each.best]:.2f} mm; {len(deep)} clear minima, in "
                         f"regions {', '.join(map(str, sorted(regions)))}")
    truth = "Truth: α1 6e6, α2 1.2e5, β 5e5 mm³. Region 0: β is between α1 and α2."
    return held, [truth, "", *lines]
