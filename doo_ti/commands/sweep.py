"""The search over a grid (§III-E)."""

import json
from argparse import Namespace
from dataclasses import replace
from pathlib import Path

from doo_ti import options as given
from doo_ti.commands.arguments import add_material, add_relaxation
from doo_ti.commands.experiment import observed
from doo_ti.commands.printing import plain, tell_hypotheses, tell_landscape, theta_text
from doo_ti.dataset import Observations, load_observations
from doo_ti.errors import InputError
from doo_ti.learning import read_landscape
from doo_ti.pairs import Pairs, load_pairs
from doo_ti.scene import MOST_SPINS, OBJECTIVES, Scene, Synthesis, load_scene
from doo_ti.start import check_experiment, observation_clamps
from doo_ti.types import Clamp


def declare(add) -> None:
    parser = add("sweep", allow_abbrev=False, help="search a parameter grid for what explains the observations")
    parser.add_argument("source", metavar="SCENE.toml|OBS", help="a scene, or observations: .npz, .csv or .parquet")
    parser.add_argument("--out", required=True, metavar="RUN", help="folder to write; a run begun there is resumed")
    add_material(parser, "a number or LO:HI:N[:log|:lin]; overrides the scene's axis")
    add_relaxation(parser, None)
    parser.add_argument("--objective", choices=OBJECTIVES, help="static: Eq. 2 (default), dynamic: Eq. 3")
    parser.add_argument("--pairs", metavar="FILE.csv",
                        help="columns from,to[,weight][,rotation_deg] (default: those of the paper, from the labels)")
    parser.add_argument("--spins", metavar="N",
                        help="try N angles where an end's spin is unknown although it was held (default 0: it spins)")
    parser.add_argument("--seed", metavar="N", help="of everything random (default: the scene's, else 0)")
    parser.add_argument("--workers", metavar="N", help="processes to share the work (default: one)")
    parser.set_defaults(run=run)


def run(options: Namespace, words: list[str]) -> int:
    """Eq. 2 or 3 over a grid; writes the run's folder and prints the best Θ with the ranges that fit nearly as well."""
    scene = load_scene(options.source) if Path(options.source).suffix == ".toml" else None
    grid = given.grid(options, scene.grid if scene else None)
    frame_weight = given.frame_weight(options, scene.frame_weight if scene else 0.0)
    seed, workers = given.whole("--seed", options.seed, 0), given.whole("--workers", options.workers, 1)
    if scene and isinstance(scene.observations, Synthesis):
        seed = scene.observations.seed if seed is None else seed
        scene = replace(scene, observations=replace(scene.observations, seed=seed))
    up, run = given.up(options), given.output_folder(options.out)
    observations = observed(scene, up) if scene else load_observations(options.source, up)
    clamp_start, clamp_end = given.clamp(options.clamp_start), given.clamp(options.clamp_end)
    if scene:
        clamp_start = scene.clamp_start if clamp_start is None else clamp_start
        clamp_end = scene.clamp_end if clamp_end is None else clamp_end
    clamps = observation_clamps(observations, clamp_start, clamp_end)
    check_experiment(observations, clamps, grid.axes[-1].values[-1], frame_weight)
    objective = options.objective or (scene.objective if scene else "static")
    pairs = _pairs(options, scene, observations, objective)
    spins = given.whole("--spins", options.spins, 0, MOST_SPINS)

    from doo_ti.sweeps import SweepOptions
    from doo_ti.sweeps import sweep as sweep_grid

    chosen = SweepOptions(
        frame_weight=frame_weight, clamp_start=clamp_start, clamp_end=clamp_end, solver=given.solver(options.solver),
        precision=options.precision or (scene.precision if scene else "mixed"),
        objective=objective, spins=(scene.spins if scene else 0) if spins is None else spins, seed=seed or 0, workers=workers,
    )
    summary = sweep_grid(run, observations, grid, options=chosen, pairs=pairs, command=words)
    if options.json:
        print(json.dumps(plain(summary)))
    else:
        tell_landscape(read_landscape(run))
        tell_hypotheses(summary)
        if grid.is_isotropic and Clamp.FRAME > min(clamps.start, clamps.end) and not chosen.spins:
            print("  note        an end may spin, so nothing twists the rod: twist is not determined")
        if scene and isinstance(scene.observations, Synthesis):
            print(f"  true Θ      {_true_theta(scene.observations)} (the virtual lab's, seed {seed})")
        print(f"  written to {run}")
    return 0


def _pairs(options: Namespace, scene: Scene | None, observations: Observations, objective: str) -> Pairs | None:
    """The pairs of a file, of which the command line's comes before the scene's, or None."""
    if options.pairs is not None and objective != "dynamic":
        raise InputError("command line", "--pairs", "given, but the objective is static", "add --objective dynamic")
    file = options.pairs or (scene.pairs if scene else None)
    return load_pairs(Path(file), observations) if file is not None and objective == "dynamic" else None


def _true_theta(synthesis: Synthesis) -> str:
    """Θ of the rod that the virtual lab made."""
    material = synthesis.material()
    (first, mixed), (_, second) = material.bend[0, 0]
    return theta_text({"bend_1": first, "bend_2": second, "bend_12": mixed, "twist": material.twist[0, 0],
                   "weight": material.weight[0]}, material.is_isotropic)
