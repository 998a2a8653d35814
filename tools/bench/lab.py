"""The lab's rods: their true Θ, and the cells that are searched."""

import numpy as np

from doo_ti import Clamps, Configuration, Grid, Material
from doo_ti.bench.workload import BEND_RANGE, RIBBON_TWIST, TWIST_RATIO_RANGE, Rods
from doo_ti.grid import parse_axis

TRUTH = {  # bend_1, bend_2, twist in mm³; weight 1
    "nylon": (1.8e6, 1.8e6, 1.2e6), "vicryl": (6e5, 6e5, 8e5), "silk": (1.5e5, 1.5e5, 5e4),
    "ribbon": (6e6, 1.2e5, RIBBON_TWIST),
}
NEIGHBOURS = ("truth", "bend ×5", "bend ÷5", "twist ratio ×3")


def true_grid(name: str) -> Grid:
    """The one cell of a suture's true Θ."""
    bend, _, twist = TRUTH[name]
    return Grid((parse_axis("--bend", f"{bend}"), parse_axis("--twist", f"{twist}")))


def search_grid(name: str, count: int) -> Grid:
    """count × count cells: bend × twist ratio for a suture, bend_1 × bend_2 at the true twist for the ribbon."""
    bend, ratio = (f"{low}:{high}:{count}" for low, high in (BEND_RANGE, TWIST_RATIO_RANGE))
    if name != "ribbon":
        return Grid((parse_axis("--bend", bend), parse_axis("--twist-ratio", ratio)))
    return Grid((parse_axis("--bend-1", bend), parse_axis("--bend-2", bend), parse_axis("--twist", f"{RIBBON_TWIST}")))


def neighbours(name: str) -> Material:
    """The four cells of NEIGHBOURS. Bend moves at a constant twist ratio, so β moves with it."""
    bend, ratio = np.array([1.0, 5.0, 0.2, 1.0]), np.array([1.0, 1.0, 1.0, 3.0])
    first, second, twist = TRUTH[name]
    if first == second:
        return Material(first * bend, twist * bend * ratio)
    return Material.diagonal(first * bend, second * bend, twist * bend * ratio)


def crossed(starts: Configuration, clamps: Clamps, material: Material) -> Rods:
    """Every start under every material: G·S rods, the starts running fastest."""
    of_material, of_start = np.divmod(np.arange(material.count * starts.count), starts.count)
    return Rods(starts, clamps, material, of_start, of_material)
