"""``doo-ti sweep``: a grid over Θ (§III-E)."""

import json
import os
import shlex
import time
from argparse import Namespace
from dataclasses import dataclass, replace
from pathlib import Path

import doo_ti
from doo_ti.commands import doubts, given, loading, results
from doo_ti.io.scene import MOST_ROLLS, OBJECTIVES, Scene, Synthesis, load_scene
from doo_ti.io.toml_file import scene_file
from doo_ti.learning.chunks import SUMMARY
from doo_ti.learning.terms import Pairs, load_pairs
from doo_ti.rod.grid import Grid
from doo_ti.rod.material import relative_stiffness, stiffness
from doo_ti.rod.observations import Observations
from doo_ti.rod.start import check_experiment, observation_clamps
from doo_ti.rod.types import Clamp
from doo_ti.system.errors import InputError, require
from doo_ti.system.terminal import in_line

MOST_WORKERS = 1024
RIBBON_PARAMETERS = " --parameters bend-1,bend-2,twist"


def declare(add) -> None:
    parser = given.command(add, "sweep", run_sweep, "search a grid of material parameters for the smallest error (Eq. 2 or 3)")
    parser.add_argument("sources", nargs="+", metavar="SCENE.toml|OBS", type=scene_file,
                        help=f"scenes, or observations: {loading.FORMATS}; each "
                        "of several gets a folder of its name below RUN")
    given.add(parser, "--out", "RUN", given.folder, "folder to write; an unfinished run in it is resumed", required=True)
    given.add_material(parser, "a number or LO:HI:N[:log|:lin]; overrides the scene's axis",
                       density="for --EI, --GJ and results in N m²")
    given.add_relaxation(parser, None)
    loading.add_loading(parser)
    given.add_obstacles(parser, "without friction, which acts in simulate and predict")
    parser.add_argument("--objective", choices=OBJECTIVES, help="static: Eq. 2 (default), dynamic: Eq. 3")
    given.add(parser, "--pairs", "FILE.csv", str, "pairs of observations for Eq. 3, columns from,to[,weight][,rotation_deg] "
              "(default: those of the paper, from the labels)")
    given.add(parser, "--roll-hypotheses", "N", given.whole(0, MOST_ROLLS), "roll angles to try for clamps whose roll was not "
              "measured (default 0: these clamps roll freely)", dest="spins")
    given.add_old_name(parser, "--spins", "spins")
    given.add(parser, "--seed", "N", given.FROM_ZERO, "seed of all random numbers (default: the scene's, else 0)")
    given.add(parser, "--workers", "N", given.whole(1, MOST_WORKERS), "number of processes (default: one)")
    given.add(parser, "--dask", "ADDRESS", str, "compute on the workers of a Dask cluster: its scheduler's address, "
              "tcp://HOST:8786", dest="scheduler")


@dataclass(frozen=True)
class _Search:
    """One source and everything for its sweep, checked."""

    scene: Scene
    observations: Observations
    grid: Grid
    options: "doo_ti.SweepOptions"
    pairs: Pairs | None
    run: Path


def run_sweep(options: Namespace) -> int:
    searches, out = [_search(options, source, options.out) for source in options.sources], options.out
    if len(searches) > 1:  # each gets a folder below --out
        names = [search.observations.name for search in searches]
        if len(set(names)) < len(names):
            twice = max(names, key=names.count)
            raise InputError(given.SOURCE, "SOURCE", f"two of the name {twice!r}", "name the scenes or files apart")
        require(not os.path.exists(out / "cells"), out, "--out", "holds the sweep of a single source", "name another folder")
        searches = [replace(search, run=out / name) for search, name in zip(searches, names, strict=True)]
    for search in searches:
        doubts.warn(search.observations, search.options.surroundings, **loading.stated(options))

    began, summaries, relaxed = time.monotonic(), [], []
    for search in searches:
        before = _stamp(search.run)
        summary = doo_ti.sweep(search.run, search.observations, search.grid, options=search.options, pairs=search.pairs,
                               command=options.words, linear_density=options.linear_density)
        summaries.append(summary)
        finished_before = _stamp(search.run) == before
        if not finished_before:
            relaxed.append(summary)
        if not options.json:
            print("\n".join(_lines(search, summary, options.linear_density, finished_before)))
        doubts.say(search.observations.source, loading.up_text(summary.get("other_up")))
    if options.json:
        print(json.dumps(results.plain(summaries if len(options.sources) > 1 else summaries[0])))
    else:
        rods, loads, relaxes = (sum(summary["timing"][name] for summary in relaxed)
                                for name in ("relaxed_rods", "loading_s", "relaxation_s"))
        work = f": {loads:.1f} s to load the kernels, {relaxes:.1f} s to relax ({rods / relaxes:,.0f} rods/s)" if rods else ""
        print(f"{rods:,} rods in {time.monotonic() - began:.1f} s{work}")
    results.note_theta(options)
    return 0


def _stamp(run: Path) -> int | None:
    """The time at which the summary of a run was written."""
    return (run / SUMMARY).stat().st_mtime_ns if (run / SUMMARY).exists() else None


def _search(options: Namespace, source: str, run: Path) -> _Search:
    require(os.path.exists(source), source, "file", "no such file", "name a scene or observations")
    if Path(source).suffix == ".toml":
        scene = load_scene(source)
    else:
        scene = Scene(in_line(Path(source).stem), Path(source), given.grid(options))
    grid, seed = given.grid(options, scene.grid), options.seed
    frame_weight = scene.frame_weight if options.frame_weight is None else options.frame_weight
    both = options.scheduler and options.workers
    require(not both, given.SOURCE, "--dask", "given beside --workers", "give one of the two")
    if isinstance(scene.observations, Synthesis):
        seed = scene.observations.seed if seed is None else seed
        scene = replace(scene, observations=replace(scene.observations, seed=seed))
    observations = loading.of_scene(options, scene).along_arcs()
    clamp_start, clamp_end = given.clamps(options, (scene.clamp_start, scene.clamp_end))
    objective = options.objective or scene.objective
    if objective == "static":
        observations = loading.with_ends_in_reach(observations, clamp_start, clamp_end)
    clamps = observation_clamps(observations, clamp_start, clamp_end)
    check_experiment(observations, clamps, grid.axes[-1].values[-1], frame_weight)
    if options.pairs is not None and objective != "dynamic":
        raise InputError(given.SOURCE, "--pairs", "given, but the objective is static", "add --objective dynamic")
    file = options.pairs or scene.pairs
    pairs = load_pairs(Path(file), observations) if file is not None and objective == "dynamic" else None

    from doo_ti.learning.experiment import SOLVERS

    chosen = doo_ti.SweepOptions(
        frame_weight=frame_weight, clamp_start=clamp_start, clamp_end=clamp_end, solver=SOLVERS[options.solver](),
        precision=options.precision or scene.precision, objective=objective,
        spins=scene.roll_hypotheses if options.spins is None else options.spins, seed=seed or 0,
        surroundings=given.surroundings(options), workers=options.workers, scheduler=options.scheduler)
    return _Search(scene, observations, grid, chosen, pairs, run)


def _lines(search: _Search, summary: dict, density: float | None, finished_before: bool) -> list[str]:
    (first, *rest), best, grid, spins = results.run_lines(summary), summary["best"], search.grid, search.options.spins
    clamps = observation_clamps(search.observations, search.options.clamp_start, search.options.clamp_end)
    rolls = grid.is_isotropic and Clamp.FRAME > min(clamps.start, clamps.end) and not spins
    names = {"EI": "bend_1"} if grid.is_isotropic else {"EI_1": "bend_1", "EI_2": "bend_2"}
    physical = density is not None and best["weight"] > 0 and ", ".join(
        f"{symbol} {stiffness(relative_stiffness(best[name], best['weight']), density):.4g} N m²"
        for symbol, name in (names | ({} if rolls else {"GJ": "twist"})).items())
    varied = {axis.name for axis in grid.axes if len(axis) > 1}
    ratios = "weight" in varied and len(varied) > 1 and not any(axis.name == "twist" and len(axis) == 1 for axis in grid.axes)
    lines = [
        first, loading.rod_line(search.observations),
        *results.rows(("WARNING", loading.up_text(summary.get("other_up")))), *rest,
        *results.hypotheses_lines(summary, search.observations.labels), *results.rows(
            ("stiffness", physical and f"{physical} in the best cell"),
            ("note", spins and f"rolls are tried in steps of {360 / spins:.3g}°: coarse steps narrow the range of the twist "
                               "ratio, fine ones leave it open"),
            ("note", rolls and "an end rolls freely, so nothing twists the rod: twist is not determined"),
            ("note", ratios and "only ratios matter: shapes stay the same when stiffness and weight grow together, so the data "
                                "do not determine both"))]
    if isinstance(search.scene.observations, Synthesis):
        recipe, material = search.scene.observations, search.scene.observations.material()
        (first_bend, mixed), (_, second) = material.bend[0, 0]
        true = results.theta_text({"bend_1": first_bend, "bend_2": second, "bend_12": mixed, "twist": material.twist[0, 0],
                                   "weight": material.weight[0]}, material.is_isotropic)
        lines.append(f"  true Θ      {true} (the virtual lab's, seed {recipe.seed})")
    lines.append(f"  {'finished before in' if finished_before else 'written to'} {in_line(search.run)}")
    if search.options.objective == "static" and not search.options.spins and not search.options.surroundings:
        swivels = rolls and Clamp.TANGENT > min(clamps.start, clamps.end)
        more = " --parameters bend" if swivels else "" if search.grid.is_isotropic else RIBBON_PARAMETERS
        lines.append(f"  intervals   doo-ti refine {in_line(shlex.quote(str(search.run)))}{more}")
    return lines
