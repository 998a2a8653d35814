"""Rods from images (§V-E, Fig. 6), under Θ learned from labelled marks."""

from dataclasses import dataclass

import numpy as np

from doo_ti import Material, Rig, perceive
from doo_ti.io.scene import Synthesis
from doo_ti.vision.render import RenderOptions
from tools.studies.perception_study import CORRECT_MM, photographed, with_energy
from tools.studies.replication.settings import Setting
from tools.studies.replication.specimens import SUTURES, Specimen, scene

PAPER_MM = {"nylon": 0.023, "silk": 0.028, "vicryl": 0.040}  # mean distance of the vertices from hand-labelled ones (§V-E)
SMALL_ENERGY = 1e-4


@dataclass(frozen=True)
class Seen:
    """A specimen's rods from images: ``rows`` of its observations, perceived and true vertices (A, V, 3) mm."""

    rows: np.ndarray
    vertices: np.ndarray
    truth: np.ndarray

    @property
    def error(self) -> np.ndarray:
        """(A,) mm, mean over vertices; infinite for a rod that failed."""
        off = np.linalg.norm(self.vertices - self.truth, axis=-1).mean(axis=1)
        return np.where(np.isfinite(off), off, np.inf)


def perceived(specimen: Specimen, setting: Setting, material: Material, sets: int, look: RenderOptions = RenderOptions(),
              assumed: Rig | None = None) -> Seen:
    """``sets`` of the specimen's 60 rods, from the seed that its first two labelled marks give.

    material  Θ, one for all
    assumed   the rig as calibrated, where it is not the one that took the images
    """
    rows = np.linspace(0, specimen.observations.count - 1, sets).round().astype(int)
    case, _ = photographed(specimen.recipe, rows.tolist(), look, detection=setting.detection)
    if setting.fill_gaps:
        case = case.filled()
    marks = specimen.observations.vertices[rows]
    found = perceive(case.maps, assumed or case.rig, marks[:, 0], marks[:, 1] - marks[:, 0], case.rods.rest_length, material,
                     options=setting.perception)
    return Seen(rows, found.vertices, case.rods.vertices)


def recovery(specimens: list[dict[str, Seen]]) -> tuple[dict[str, list[bool]], list[str]]:
    """The criteria of the 180 sets, and a table of all specimens."""
    held = {"all": [], "error": []}
    for seen in specimens:
        good = {name: one.error < CORRECT_MM for name, one in seen.items()}
        held["all"].append(all(these.all() for these in good.values()))
        held["error"].append(all(one.error[good[name]].mean() <= PAPER_MM[name] for name, one in seen.items()))
    lines = ["| material | correct | paper | mean vertex error mm, by specimen | paper |", "|---" * 5 + "|"]
    for name in SUTURES:
        errors = [seen[name].error for seen in specimens]
        good = [error < CORRECT_MM for error in errors]
        each = ", ".join(f"{error[these].mean():.3f}" for error, these in zip(errors, good, strict=True))
        count = f"{sum(map(np.sum, good))} of {sum(map(len, errors))}"
        lines.append(f"| {name} | {count} | 60 of 60 | {each} | {PAPER_MM[name]:.3f} |")
    return held, lines


def loops(theta: dict[str, Material], setting: Setting, most: int | None) -> tuple[dict[str, list[bool]], list[str]]:
    """Fig. 6: threads that cross themselves in every view, with the rod's energy and with a ten-thousandth of it.

    theta  learned, by material; most: rods of each material, None: all
    """
    held, lines = [], ["| thread | sets | correct with E_vis | with 1e-4 of the energy | wrong without, correct with |",
                       "|---" * 5 + "|"]
    for name, material in theta.items():
        recipe: Synthesis = scene(f"loops_{name}").observations
        case, _ = photographed(recipe, crossing=True, detection=setting.detection)
        if setting.fill_gaps:
            case = case.filled()
        some = np.arange(len(case.rods.names))[:most]
        good = []
        for share in (1.0, SMALL_ENERGY):
            found = perceive(case.maps.take(some), case.rig, case.rods.point[some], case.rods.direction[some],
                             case.rods.rest_length, material, options=with_energy(setting.perception, share))
            off = np.linalg.norm(found.vertices - case.rods.vertices[some], axis=-1).mean(axis=1)
            good.append(off < CORRECT_MM)
        decided = int((good[0] & ~good[1]).sum())
        held.append(decided > 0)
        lines.append(f"| {name} | {len(some)} | {good[0].sum()} | {good[1].sum()} | {decided} |")
    return {"energy": held}, lines
