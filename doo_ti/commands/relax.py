"""``doo-ti relax``: F on each observation (§III-D)."""

from argparse import Namespace
from pathlib import Path

import numpy as np

import doo_ti
from doo_ti.commands import doubts, given, loading, results
from doo_ti.commands.moving_rods import with_rest_curvature
from doo_ti.learning.landscape import status_counts
from doo_ti.rod.frames import total_twist
from doo_ti.rod.grid import Grid
from doo_ti.rod.observations import Observations
from doo_ti.rod.start import check_experiment, choose_hypothesis, observation_clamps, start_configuration, turn_hypotheses
from doo_ti.rod.types import Status
from doo_ti.system.arguments import counted
from doo_ti.system.terminal import busy

WRITTEN = ("energy", "status", "iterations", "residual", "stable", "end_force")


def declare(add) -> None:
    parser = given.command(add, "relax", run_relax,
                           "relax each observed rod under one material and compare it with its observation (Eq. 1)")
    parser.add_argument("observations", metavar="OBS", help=f"observations: {loading.FORMATS}")
    given.add_out(parser, "F.npz|F.csv")
    given.add_material(parser, "one number each", given.SHAPE_ONLY)
    given.add_relaxation(parser, "f64")
    loading.add_loading(parser)
    given.add_obstacles(parser, "without friction, which acts in simulate and predict")


def run_relax(options: Namespace) -> int:
    """F on each observation (§III-D), to one npz; of several whole turns what :func:`.choose_hypothesis` takes."""
    grid = given.single_cell(options, "give one number, or use sweep")
    frame_weight, out = options.frame_weight or 0.0, options.out
    surroundings = given.surroundings(options)
    observations = loading.load(options, options.observations)
    clamps = observation_clamps(observations, *given.clamps(options))
    check_experiment(observations, clamps, grid.axes[-1].values[-1], frame_weight)
    results.refuse_overwriting(out, options.observations)
    doubts.warn(observations, surroundings, **loading.stated(options))

    from doo_ti.learning.experiment import SOLVERS

    material = with_rest_curvature(options, grid.materials(), observations.rest_length)
    index, turns = turn_hypotheses(observations, clamps)
    observed, held = observations.take(index), clamps.take(index)
    # Without a solver relax allows more iterations among obstacles.
    solver = None if surroundings else SOLVERS[options.solver]()
    with busy(f"relaxing {observed.count} rods (kernels are compiled once on a machine)"):
        start = start_configuration(observed, held, turns)
        solution = doo_ti.relax(start, material, held, solver, up=observations.up, precision=options.precision,
                                **surroundings.arguments)
    relaxed = solution.configuration
    error = doo_ti.distance(relaxed, observations, index, frame_weight)
    infeasible = np.flatnonzero(solution.status == Status.INFEASIBLE)
    error[infeasible] = np.nan
    best = choose_hypothesis(index, error, solution.converged & solution.stable, total_twist(relaxed.quaternions))
    doubts.warn_of_turns(observations, index[best], turns[best])
    doubts.warn_of_distance(observations, error[best])
    configuration = relaxed.take(best)
    result = {"vertices_mm": configuration.vertices, "frames": configuration.frames, "distance_mm": error[best],
              "rest_length_mm": observations.rest_length}
    result |= {name: getattr(solution, name)[best] for name in WRITTEN}
    contact = {}
    if surroundings:
        result["contact_force"] = solution.contact_force[best]
        result["smallest_gap_mm"] = surroundings.smallest_gap(result["vertices_mm"])
        contact = results.contact_summary(surroundings, result["contact_force"], result["smallest_gap_mm"], result["status"])
    result["start_force"] = results.start_force(material, observations.rest_length, observations.up, result["status"],
                                                result["end_force"], result.get("contact_force"))
    results.save_arrays(out, results.in_newton(result, given.newtons(options, material.weight), 0))
    inside = results.inside_reason(surroundings.take(infeasible), *(one.take(infeasible) for one in (held, start)),
                                   index[infeasible])
    sound = best[(solution.converged & solution.stable)[best]]
    mesh = results.mesh_summary(relaxed.take(sound), material, held.take(sound), observations.up, surroundings.take(sound))
    summary = _summary(observations, grid, result, out) | contact | mesh | {"infeasible_reason": inside}
    results.report(options, summary, lambda: _lines(observations, grid, result, summary))
    return 0 if (result["status"] == Status.CONVERGED).any() else 1


def _summary(observations: Observations, grid: Grid, result: dict, out: Path) -> dict:
    finite = result["distance_mm"][np.isfinite(result["distance_mm"])]
    return {
        "observations": observations.count, "edges": observations.edges, **results.theta_of(grid),
        "status": status_counts(result["status"]), "stable": int(result["stable"].sum()), "out": str(out),
        "mean_distance_mm": finite.mean() if len(finite) else np.nan,
        "largest_distance_mm": finite.max() if len(finite) else np.nan,
        "median_iterations": np.median(result["iterations"]), "largest_residual": np.max(result["residual"]),
    }


def _lines(observations: Observations, grid: Grid, result: dict, summary: dict) -> list[str]:
    return [
        f"{observations.name}: {counted(observations.count, 'rod')} of {observations.edges} edges",
        loading.rod_line(observations), *results.rows(
            ("material", results.theta_text(results.theta_of(grid), grid.is_isotropic)),
            ("status", f"{results.status_text(summary['status'])}; {summary['stable']} certified stable"),
            ("distance", np.isfinite(summary["mean_distance_mm"]) and
             f"mean {summary['mean_distance_mm']:.4g} mm, largest {summary['largest_distance_mm']:.4g} mm at observation "
             f"{observations.labels[np.nanargmax(result['distance_mm'])]} (Eq. 1)"),
            *results.mesh_rows(summary), results.contact_row(summary, observations.count),
            ("infeasible", summary["infeasible_reason"]),
            ("iterations", f"median {summary['median_iterations']:.0f}, most {int(result['iterations'].max())}"))]
