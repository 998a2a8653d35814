"""Which configurations to measure next."""

import csv
import io
import json
from argparse import Namespace
from dataclasses import replace
from pathlib import Path

import numpy as np

from doo_ti.commands import options as given
from doo_ti.commands.arguments import add_json, add_material
from doo_ti.commands.experiment import observed
from doo_ti.commands.printing import plain
from doo_ti.errors import InputError
from doo_ti.io.observations import Observations, load_observations, write_whole
from doo_ti.io.scene import CLAMPS, Synthesis, load_scene
from doo_ti.terminal import in_line

SIGMA_MM = 0.1
"""Label uncertainty where nobody says one."""


def declare(add) -> None:
    parser = add("plan", allow_abbrev=False, help="rank configurations by what measuring them would tell about the rod")
    parser.add_argument("source", metavar="SCENE.toml|OBS", help="a scene whose [synthesis] says which clamps can be had, or "
                        "observations whose clamps they are")
    add_material(parser, "a number or LO:HI:N[:log|:lin]: what is thought possible; overrides the scene's axis")
    parser.add_argument("--end-distances", metavar="MM,MM,…", help="in place of the scene's")
    parser.add_argument("--end-rotations", metavar="DEG,DEG,…", help="in place of the scene's")
    parser.add_argument("--sigma", metavar="MM", help=f"label uncertainty (default: the source's, else {SIGMA_MM:g})")
    parser.add_argument("--picks", metavar="K", help="configurations to rank (default 10)")
    parser.add_argument("--measured", metavar="I,I,…", help="configurations, by number, that are measured already")
    parser.add_argument("--clamp-start", choices=CLAMPS, help="default: frame where it is given, else tangent")
    parser.add_argument("--clamp-end", choices=CLAMPS, help="default: frame where it is given, else tangent")
    parser.add_argument("--out", metavar="FOLDER", help="for plan.csv, plan.json and identifiability.png (default: none)")
    add_json(parser)
    parser.set_defaults(run=run)


def run(options: Namespace, words: list[str]) -> int:
    """Rank configurations; what the grid holds is the prior."""
    scene = load_scene(options.source) if Path(options.source).suffix == ".toml" else None
    grid = given.grid(options, scene.grid if scene else None)
    out = None if options.out is None else given.output_folder(options.out)
    picks = given.whole("--picks", options.picks, 1) or 10
    sigma = given.length("--sigma", options.sigma)
    configurations = _configurations(options, scene)
    measured = given.rows("--measured", options.measured, configurations.count)
    if sigma is None:
        sigma = SIGMA_MM if configurations.sigma is None else float(np.mean(configurations.sigma))

    from doo_ti.plan import plan

    found = plan(configurations, grid, sigma=sigma, picks=picks, clamp_start=given.clamp(options.clamp_start),
                 clamp_end=given.clamp(options.clamp_end), measured=measured)
    summary = _summary(configurations, found, sigma)
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        _write(out, configurations, found, summary)
    if options.json:
        print(json.dumps(plain(summary)))
    else:
        _tell(configurations, found, sigma)
        if out is not None:
            print(f"  written to {in_line(out)}")
    return 0


def _configurations(options: Namespace, scene) -> Observations:
    """What can be measured: the scene's recipe with the given distances and rotations, or the observations themselves."""
    distances = given.numbers("--end-distances", options.end_distances)
    rotations = given.numbers("--end-rotations", options.end_rotations)
    recipe = scene.observations if scene and isinstance(scene.observations, Synthesis) else None
    if recipe is None:
        if distances or rotations:
            raise InputError("command line", "--end-distances" if distances else "--end-rotations",
                             "given for observations, whose clamps are what they are", "plan with a scene that has [synthesis]")
        return observed(scene, None) if scene else load_observations(options.source)

    from doo_ti.plan import planned

    changed = {"end_distances_mm": distances} if distances else {}
    changed |= {"end_rotations_deg": rotations} if rotations else {}
    recipe = replace(recipe, **changed)
    return replace(planned(recipe), sigma=np.array(recipe.label_noise_mm) if recipe.label_noise_mm > 0 else None)


def _named(configurations: Observations, row: int) -> str:
    """``54 mm, 120°``, or the observation's number."""
    labels = ((configurations.end_distance, " mm"), (configurations.end_rotation, "°"))
    parts = [f"{values[row]:g}{unit}" for values, unit in labels if values is not None]
    return ", ".join(parts) or f"observation {row}"


def _summary(configurations: Observations, found, sigma: float) -> dict:
    strength = {f"{name}_mm": found.strength[:, k] for k, name in enumerate(found.parameters)}
    labels = {"end_distance_mm": configurations.end_distance, "end_rotation_deg": configurations.end_rotation}
    return {
        "configurations": configurations.count, "cells": found.cells, "sigma_mm": sigma,
        "asked": [found.parameters[k] for k in found.asked],
        "order": found.order, "volume_left": found.volume, "least_informative": found.least,
        "moved_by_a_factor_e": strength, "moved_by_all_mm": found.total, "cells_sensed": found.sensed,
        **{name: values for name, values in labels.items() if values is not None},
    }


def _write(out: Path, configurations: Observations, found, summary: dict) -> None:
    """plan.json, plan.csv and identifiability.png."""
    from doo_ti.report import identifiability_picture

    text = json.dumps(plain(summary), indent=2) + "\n"
    write_whole(out / "plan.json", lambda file: file.write(text.encode()))
    rank = np.full(configurations.count, 0)
    rank[found.order] = 1 + np.arange(len(found.order))
    table = io.StringIO()
    writer = csv.writer(table, lineterminator="\n")
    writer.writerow(["configuration", "end_distance_mm", "end_rotation_deg", *(f"{name}_mm" for name in found.parameters),
                     "all_mm", "cells_sensed", "rank"])
    labels = (configurations.end_distance, configurations.end_rotation)
    for row in range(configurations.count):
        writer.writerow([row, *("" if values is None else f"{values[row]:g}" for values in labels),
                         *(f"{value:.6g}" for value in (*found.strength[row], found.total[row])), found.sensed[row],
                         rank[row] or ""])
    write_whole(out / "plan.csv", lambda file: file.write(table.getvalue().encode()))
    write_whole(out / "identifiability.png", lambda file: identifiability_picture(
        file, found.parameters, found.strength, rank, configurations.end_distance, configurations.end_rotation))


def _tell(configurations: Observations, found, sigma: float) -> None:
    asked = ", ".join(found.parameters[k] for k in found.asked)
    print(f"{configurations.name}: {configurations.count} configurations over {found.cells} cells, labels to {sigma:g} mm")
    print("  a mark moves, root mean square along the rod and median over the cells, when a parameter grows by a factor e:")
    names = "".join(f"{name + ' [mm]':>13}" for name in found.parameters)
    print(f"  {'rank':>4}  {'configuration':18}{names}{'region left':>14}")
    for place, (row, left) in enumerate(zip(found.order, found.volume, strict=True), 1):
        _tell_row(configurations, found, str(place), row, f"{left:.2g}")
    _tell_row(configurations, found, "last", found.least, "least of all")
    lost = int((found.sensed < found.cells).sum())
    if lost:
        print(f"  note        {lost} configurations come to no certified equilibrium in some cells, which then say nothing")
    print(f"  'region left' is the volume of the confidence region of {asked}, over that before")


def _tell_row(configurations: Observations, found, rank: str, row: int, left: str) -> None:
    strength = "".join(f"{value:13.3g}" for value in found.strength[row])
    print(f"  {rank:>4}  {_named(configurations, row):18}{strength}{left:>14}")
