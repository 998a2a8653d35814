"""``doo-ti plan``: which configurations to measure next."""

from argparse import Namespace
from dataclasses import replace
from pathlib import Path

import numpy as np

from doo_ti.commands import doubts, given, loading, results
from doo_ti.io.scene import Synthesis, load_scene
from doo_ti.io.toml_file import scene_file
from doo_ti.rod.observations import Observations
from doo_ti.system.files import csv_text, write_text
from doo_ti.system.terminal import in_line

SIGMA_MM = 0.1  # label uncertainty where none is given
PICKS = 10


def declare(add) -> None:
    parser = given.command(add, "plan", run_plan,
                           "rank configurations by how much measuring them would reduce the uncertainty of Θ")
    parser.add_argument("source", metavar="SCENE.toml|OBS", type=scene_file,
                        help="a scene whose [synthesis] lists the possible clamp poses, or observations that have them")
    given.add_material(parser, "a number or LO:HI:N[:log|:lin], the prior range; overrides the scene's axis")
    given.add(parser, "--sigma", "MM", given.LENGTH, f"label uncertainty (default: the source's, else {SIGMA_MM:g})")
    given.add(parser, "--picks", "K", given.COUNT, "how many configurations to rank", PICKS)
    given.add(parser, "--measured", "I,I,…", str, "row numbers, from 0, of the configurations already measured")
    given.add_clamps(parser)
    given.add_obstacles(parser, "without friction; the rods of a scene begin where they would be without obstacles")
    loading.add_loading(parser)
    given.add(parser, "--out", "FOLDER", given.folder, "folder for plan.csv, plan.json and identifiability.png (default: not "
              "written)")


def run_plan(options: Namespace) -> int:
    scene = load_scene(options.source) if Path(options.source).suffix == ".toml" else None
    grid = given.grid(options, scene.grid if scene else None)
    sigma, out = options.sigma, options.out
    if scene and isinstance(scene.observations, Synthesis):  # the candidates of its recipe
        from doo_ti.refinement.plan import planned

        noise = scene.observations.label_noise_mm
        configurations = replace(planned(scene.observations), sigma=np.array(noise) if noise > 0 else None)
    else:
        configurations = loading.of_scene(options, scene) if scene else loading.load(options, options.source)
    measured = given.rows("--measured", options.measured, configurations.count)
    if sigma is None:
        sigma = SIGMA_MM if configurations.sigma is None else float(np.nanmean(configurations.sigma))

    from doo_ti.refinement.plan import plan

    (clamp_start, clamp_end), surroundings = given.clamps(options), given.surroundings(options)
    found = plan(configurations, grid, sigma=sigma, picks=options.picks, clamp_start=clamp_start, clamp_end=clamp_end,
                 measured=measured, surroundings=surroundings)
    doubts.warn(configurations, surroundings, **loading.stated(options))
    summary = _summary(configurations, found, sigma)
    if out is not None:
        _write(out, configurations, found, summary)
    written = [] if out is None else [f"  written to {in_line(out)}"]
    results.report(options, summary, lambda: [*_lines(configurations, found, sigma), *written])
    return 0


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
    from doo_ti.report.figures import identifiability_picture

    results.save_json(out / "plan.json", summary)
    rank = np.full(configurations.count, 0)
    rank[found.order] = 1 + np.arange(len(found.order))
    heads = ["configuration", "end_distance_mm", "end_rotation_deg", *(f"{name}_mm" for name in found.parameters), "all_mm",
             "cells_sensed", "rank"]
    labels = (configurations.end_distance, configurations.end_rotation)
    write_text(out / "plan.csv", csv_text(heads, (
        [row, *("" if values is None else f"{values[row]:g}" for values in labels),
         *(f"{value:.6g}" for value in (*found.strength[row], found.total[row])), found.sensed[row], rank[row] or ""]
        for row in range(configurations.count))))
    identifiability_picture(out / "identifiability.png", found.parameters, found.strength, rank, configurations.end_distance,
                            configurations.end_rotation)


def _lines(configurations: Observations, found, sigma: float) -> list[str]:
    asked = ", ".join(found.parameters[k] for k in found.asked)
    names = "".join(f"{name + ' [mm]':>13}" for name in found.parameters)
    lines = [f"{configurations.name}: {configurations.count} configurations over {found.cells} cells, labels to {sigma:g} mm",
             loading.rod_line(configurations),
             "  motion of a mark, rms along the rod and median over the cells, when a parameter grows by a factor e:",
             f"  {'rank':>4}  {'configuration':18}{names}{'region left':>14}"]
    ranked = [(str(place), row, f"{left:.2g}")
              for place, (row, left) in enumerate(zip(found.order, found.volume, strict=True), 1)]
    labels = ((configurations.end_distance, " mm"), (configurations.end_rotation, "°"))
    for rank, row, left in (*ranked, ("last", found.least, "least of all")):
        name = ", ".join(f"{values[row]:g}{unit}" for values, unit in labels if values is not None)
        strength = "".join(f"{value:13.3g}" for value in found.strength[row])
        lines.append(f"  {rank:>4}  {name or f'observation {configurations.labels[row]}':18}{strength}{left:>14}")
    lost = int((found.sensed < found.cells).sum())
    if lost:
        lines.append(f"  note        {lost} configurations have no certified equilibrium in some cells, which do not count")
    return [*lines, f"  'region left': volume of the confidence region of {asked}, relative to that before"]
