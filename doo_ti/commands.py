"""What each command does, as plain functions of the parsed options: check all input, then work, then tell.

Each takes the options and the words of the command line, and returns the exit code. Heavy modules are imported where
they are used, so that wrong input is told at once.
"""

import json
import os
import sys
from argparse import Namespace
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from doo_ti import options as given
from doo_ti.dataset import Observations, load_observations, save_observations, write_whole
from doo_ti.errors import InputError, InterruptedRunError
from doo_ti.grid import Grid
from doo_ti.learning import Landscape, read_landscape, status_counts
from doo_ti.scene import Scene, Synthesis, load_scene
from doo_ti.start import (
    check_experiment,
    choose_hypothesis,
    observation_clamps,
    start_configuration,
    turn_hypotheses,
)
from doo_ti.types import Clamp, Status


def relax(options: Namespace, words: list[str]) -> int:
    """F on each observation (§III-D), to one npz; of several whole-turn hypotheses the one nearest to what was seen."""
    grid = given.grid(options)
    if grid.size > 1:
        option = f"--{grid.varying[0].name.replace('_', '-')}"
        raise InputError("command line", option, f"a grid of {grid.size} cells", "give one number, or use sweep")
    frame_weight, up, out = given.frame_weight(options), given.up(options), given.output_file(options.out, ".npz")
    observations = load_observations(options.observations, up)
    clamps = observation_clamps(observations, given.clamp(options.clamp_start), given.clamp(options.clamp_end))
    check_experiment(observations, clamps, grid.axes[-1].values[-1], frame_weight)
    given.refuse_overwriting(out, options.observations)

    from doo_ti.metric import distance
    from doo_ti.relaxation import relax as relax_rods

    index, turns = turn_hypotheses(observations, clamps)
    observed, held = observations.take(index), clamps.take(index)
    with _busy(f"relaxing {observed.count} rods (kernels are compiled once on a machine)"):
        solution = relax_rods(start_configuration(observed, held, turns), grid.materials(), held, _solver(options.solver),
                              up=observations.up, precision=options.precision)
    relaxed = solution.configuration
    error = distance(relaxed, observations, index, frame_weight)
    best = choose_hypothesis(index, error, solution.converged & solution.stable)
    configuration = relaxed.take(best)
    result = {"vertices_mm": configuration.vertices, "frames": configuration.frames, "distance_mm": error[best]}
    result |= {name: getattr(solution, name)[best] for name in ("energy", "status", "iterations", "residual", "stable")}
    out.parent.mkdir(parents=True, exist_ok=True)
    write_whole(out, lambda file: np.savez_compressed(file, **result))
    _tell_relaxation(options, observations, grid, result, out)
    return 0 if (result["status"] == Status.CONVERGED).any() else 1


def sweep(options: Namespace, words: list[str]) -> int:
    """Eq. 2 over a grid; writes the run's folder and prints the best Θ with the ranges that fit nearly as well."""
    scene = load_scene(options.source) if Path(options.source).suffix == ".toml" else None
    grid = given.grid(options, scene.grid if scene else None)
    frame_weight = given.frame_weight(options, scene.frame_weight if scene else 0.0)
    seed, workers = given.whole("--seed", options.seed, 0), given.whole("--workers", options.workers, 1)
    if scene and isinstance(scene.observations, Synthesis):
        seed = scene.observations.seed if seed is None else seed
        scene = replace(scene, observations=replace(scene.observations, seed=seed))
    up, run = given.up(options), given.output_folder(options.out)
    observations = _observed(scene, up) if scene else load_observations(options.source, up)
    clamp_start, clamp_end = given.clamp(options.clamp_start), given.clamp(options.clamp_end)
    if scene:
        clamp_start = scene.clamp_start if clamp_start is None else clamp_start
        clamp_end = scene.clamp_end if clamp_end is None else clamp_end
    clamps = observation_clamps(observations, clamp_start, clamp_end)
    check_experiment(observations, clamps, grid.axes[-1].values[-1], frame_weight)

    from doo_ti.sweeps import SweepOptions
    from doo_ti.sweeps import sweep as sweep_grid

    chosen = SweepOptions(
        frame_weight=frame_weight, clamp_start=clamp_start, clamp_end=clamp_end, solver=_solver(options.solver),
        precision=options.precision or (scene.precision if scene else "mixed"),
        objective=options.objective or (scene.objective if scene else "static"), seed=seed or 0, workers=workers,
    )
    summary = sweep_grid(run, observations, grid, options=chosen, command=words)
    if options.json:
        print(json.dumps(_plain(summary)))
    else:
        _tell_landscape(read_landscape(run))
        if grid.is_isotropic and Clamp.FRAME > min(clamps.start, clamps.end):
            print("  note        an end may spin, so nothing twists the rod: twist is not determined")
        if scene and isinstance(scene.observations, Synthesis):
            print(f"  true Θ      {_true_theta(scene.observations)} (the virtual lab's, seed {seed})")
        print(f"  written to {run}")
    return 0


def learn(options: Namespace, words: list[str]) -> int:
    """The best Θ of each run, with the ranges that fit nearly as well (§III-E); all runs over one grid."""
    landscapes = [read_landscape(Path(run)) for run in options.runs]
    for landscape in landscapes[1:]:
        if landscape.grid.as_dict() != landscapes[0].grid.as_dict():
            raise InputError(landscape.run, "grid", f"another grid than that of {landscapes[0].run}",
                             "sweep all runs over the same axes")
    if options.json:
        print(json.dumps(_plain([_best(landscape) for landscape in landscapes])))
    else:
        for landscape in landscapes:
            _tell_landscape(landscape)
    return 0


def view(options: Namespace, words: list[str]) -> int:
    """Open the rerun viewer on a run."""
    path = Path(options.recording)
    if not path.exists() or (path.is_file() and path.suffix != ".rrd"):
        problem = "not a recording" if path.exists() else "no such file or directory"
        raise InputError(path, "run", problem, "name the folder of a run, or an .rrd file")
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise InterruptedRunError("view: there is no display here; tools/screenshot.py saves a picture without one")
    from doo_ti.record import open_viewer

    return 1 if open_viewer(path) else 0


def convert(options: Namespace, words: list[str]) -> int:
    """Observations from one format to another; keys that are not observations' are left behind."""
    out = given.output_file(options.out)
    given.refuse_overwriting(out, options.observations)
    _save(out, load_observations(options.observations))
    return 0


def synth(options: Namespace, words: list[str]) -> int:
    """The observations of a scene to a file."""
    out = given.output_file(options.out)
    _save(out, _observed(load_scene(options.scene), None))
    return 0


def bench(options: Namespace, words: list[str]) -> int:
    """Throughput and accuracy on this machine; with a folder also as JSON and pictures."""
    given.jax(options.jax)
    rods, threads = given.bench_rods(options.rods, 65_536), given.threads(options.threads)
    rounds = given.whole("--rounds", options.rounds, 1) or 3
    out = None if options.out is None else given.output_folder(options.out)

    from doo_ti.bench import study
    from doo_ti.bench.table import text

    summary = study.measured(study.Plan(rods, rounds, threads, options.scaling, options.jax))
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        content = json.dumps(_plain(summary), indent=2) + "\n"
        write_whole(out / "bench.json", lambda file: file.write(content.encode()))
        study.draw(out, summary)
    print(json.dumps(_plain(summary)) if options.json else text(summary))
    return 0


def _busy(doing: str):
    """Says on a terminal what is being done, until it is."""
    from rich.console import Console

    return Console(stderr=True).status(doing)


def _observed(scene: Scene, up: np.ndarray | None) -> Observations:
    """A scene's observations, loaded or synthesised, under the scene's name."""
    if isinstance(scene.observations, Synthesis):
        from doo_ti.synthesis import synthesise

        observations = synthesise(scene.observations)
        observations = replace(observations, sha256=scene.sha256)
    else:
        observations = load_observations(scene.observations)
    return replace(observations, name=scene.name, **({} if up is None else {"up": up}))


def _save(out: Path, observations: Observations) -> None:
    out.parent.mkdir(parents=True, exist_ok=True)
    save_observations(out, observations)
    print(f"{observations.count} observations of {observations.edges + 1} vertices written to {out}")


def _solver(name: str):
    from doo_ti.relaxation import Descent, Newton

    return {"newton": Newton, "descent": Descent}[name]()


def _tell_relaxation(options: Namespace, observations: Observations, grid: Grid, result: dict, out: Path) -> None:
    distance, counts = result["distance_mm"], status_counts(result["status"])
    finite = distance[np.isfinite(distance)]
    theta = {name: float(value[0]) for name, value in grid.cell_values().items()}
    summary = {
        "observations": observations.count, "edges": observations.edges, **theta, "bend_12": grid.bend_12,
        "status": counts, "stable": int(result["stable"].sum()), "out": str(out),
        "mean_distance_mm": finite.mean() if len(finite) else np.nan,
        "largest_distance_mm": finite.max() if len(finite) else np.nan,
        "median_iterations": np.median(result["iterations"]), "largest_residual": np.max(result["residual"]),
    }
    if options.json:
        print(json.dumps(_plain(summary)))
        return
    print(f"{observations.name}: {observations.count} rods of {observations.edges} edges")
    print(f"  material    {_theta(theta | {'bend_12': grid.bend_12}, grid.is_isotropic)}")
    print(f"  status      {_counted(counts)}; {summary['stable']} certified stable")
    if len(finite):
        print(f"  distance    mean {finite.mean():.4g} mm, largest {finite.max():.4g} mm at observation "
              f"{int(np.nanargmax(distance))} (Eq. 1)")
    print(f"  iterations  median {summary['median_iterations']:.0f}, most {int(result['iterations'].max())}")
    print(f"  written to {out}")


def _best(landscape: Landscape) -> dict:
    """The best Θ of a run, as JSON holds it."""
    theta = {name: value[landscape.best] for name, value in landscape.grid.cell_values().items()}
    return {"run": str(landscape.run), "material": landscape.name, **theta, "bend_12": landscape.grid.bend_12,
            "mean_distance_mm": landscape.mean_distance[landscape.best],
            "intervals": [asdict(interval) for interval in landscape.intervals],
            "status": status_counts(landscape.status), "stable": landscape.stable.sum()}


def _tell_landscape(landscape: Landscape) -> None:
    cells, count = landscape.distance.shape
    best = _best(landscape)
    print(f"{landscape.name}: {cells} cells x {count} observations")
    print(f"  best Θ      {_theta(best, landscape.grid.is_isotropic)}")
    print(f"  distance    mean {best['mean_distance_mm']:.4g} mm (Eq. 1)")
    for interval in landscape.intervals:
        print(f"  within 5 %  {interval}{' (at the border of the grid: widen it)' * interval.at_border}")
    print("              (how flat the landscape is around its minimum; not a confidence interval)")
    print(f"  status      {_counted(best['status'])}; {best['stable']} certified stable")


def _theta(theta: dict, isotropic: bool) -> str:
    """Θ for a person."""
    names = ["bend_1"] if isotropic else ["bend_1", "bend_2"] + ["bend_12"] * bool(theta["bend_12"])
    bend = ", ".join(f"{'bend' if isotropic else name} {theta[name]:.4g} mm³" for name in names)
    return f"{bend}, twist {theta['twist']:.4g} mm³, weight {theta['weight']:.4g}"


def _true_theta(synthesis: Synthesis) -> str:
    """Θ of the rod that the virtual lab made."""
    material = synthesis.material()
    (first, mixed), (_, second) = material.bend[0, 0]
    return _theta({"bend_1": first, "bend_2": second, "bend_12": mixed, "twist": material.twist[0, 0],
                   "weight": material.weight[0]}, material.is_isotropic)


def _counted(counts: dict[str, int]) -> str:
    return ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in counts.items())


def _plain(value):
    """``value`` as strict JSON holds it: no NumPy types, null for what is not finite."""
    if isinstance(value, dict):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(entry) for entry in value]
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value
