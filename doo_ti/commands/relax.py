"""F on each observation (§III-D)."""

import json
from argparse import Namespace
from pathlib import Path

import numpy as np

from doo_ti import options as given
from doo_ti.commands.arguments import add_material, add_relaxation
from doo_ti.commands.printing import busy, counted, plain, theta_text
from doo_ti.dataset import Observations, load_observations
from doo_ti.grid import Grid
from doo_ti.learning.objective import status_counts
from doo_ti.start import (
    check_experiment,
    choose_hypothesis,
    observation_clamps,
    start_configuration,
    turn_hypotheses,
)
from doo_ti.terminal import in_line
from doo_ti.types import Status
from doo_ti.whole_file import write_whole


def declare(add) -> None:
    parser = add("relax", allow_abbrev=False, help="relax each observation under one material")
    parser.add_argument("observations", metavar="OBS", help="observations: .npz, .csv or .parquet")
    parser.add_argument("--out", required=True, metavar="F.npz", help="file to write")
    add_material(parser, "one number, --bend also A1,A2 or A1,A2,A12")
    add_relaxation(parser, "f64")
    parser.set_defaults(run=run)


def run(options: Namespace, words: list[str]) -> int:
    """F on each observation (§III-D), to one npz; of several whole-turn hypotheses the one nearest to what was seen."""
    grid = given.single_cell(options, "give one number, or use sweep")
    frame_weight, up, out = given.frame_weight(options), given.up(options), given.output_file(options.out, ".npz")
    observations = load_observations(options.observations, up)
    clamps = observation_clamps(observations, given.clamp(options.clamp_start), given.clamp(options.clamp_end))
    check_experiment(observations, clamps, grid.axes[-1].values[-1], frame_weight)
    given.refuse_overwriting(out, options.observations)

    from doo_ti.metric import distance
    from doo_ti.relaxation.relax import relax as relax_rods

    index, turns = turn_hypotheses(observations, clamps)
    observed, held = observations.take(index), clamps.take(index)
    with busy(f"relaxing {observed.count} rods (kernels are compiled once on a machine)"):
        solution = relax_rods(start_configuration(observed, held, turns), grid.materials(), held, given.solver(options.solver),
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
        print(json.dumps(plain(summary)))
        return
    print(f"{observations.name}: {observations.count} rods of {observations.edges} edges")
    print(f"  material    {theta_text(theta | {'bend_12': grid.bend_12}, grid.is_isotropic)}")
    print(f"  status      {counted(counts)}; {summary['stable']} certified stable")
    if len(finite):
        print(f"  distance    mean {finite.mean():.4g} mm, largest {finite.max():.4g} mm at observation "
              f"{int(np.nanargmax(distance))} (Eq. 1)")
    print(f"  iterations  median {summary['median_iterations']:.0f}, most {int(result['iterations'].max())}")
    print(f"  written to {in_line(out)}")
