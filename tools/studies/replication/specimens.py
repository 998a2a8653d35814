"""Specimens of a material: the shipped scene with other seeds, so that rest curvature and label noise differ."""

from dataclasses import dataclass, replace
from pathlib import Path

from doo_ti import Grid, Observations
from doo_ti.io.scene import Scene, Synthesis, load_scene
from doo_ti.lab.synthesis import synthesise

SCENES = Path(__file__).resolve().parents[3] / "scenes"
SUTURES = ("nylon", "silk", "vicryl")  # in the order of the paper's tables
APART = 100  # between the seeds of a material's specimens: those of the scenes differ by less


@dataclass(frozen=True)
class Specimen:
    """One rod of a material, and its observations."""

    name: str
    recipe: Synthesis
    grid: Grid
    frame_weight: float
    observations: Observations


def scene(name: str) -> Scene:
    """A shipped scene of the virtual lab. Raises InputError where it is missing."""
    return load_scene(SCENES / f"{name}.toml")


def specimen(name: str, number: int, **changes) -> Specimen:
    """Specimen ``number`` of a material; 0 is the rod of the shipped scene. ``changes`` are fields of its recipe."""
    shipped = scene(name)
    recipe = replace(shipped.observations, seed=shipped.observations.seed + APART * number, **changes)
    return Specimen(name, recipe, shipped.grid, shipped.frame_weight, replace(synthesise(recipe), name=name))
