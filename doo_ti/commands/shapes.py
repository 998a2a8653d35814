"""Shapes of observed rods under one Θ: ``relax``, F on each observation (§III-D); ``twist``, the angles that explain them
(§IV-B)."""

from argparse import Namespace
from dataclasses import replace
from pathlib import Path

import numpy as np

from doo_ti.commands import loading, results
from doo_ti.commands import options as given
from doo_ti.commands.moving_rods import curved
from doo_ti.contact.surroundings import Surroundings
from doo_ti.io.observation_tables import write_columns
from doo_ti.io.scene import PRECISIONS
from doo_ti.learning.landscape import status_counts
from doo_ti.rod.grid import Grid
from doo_ti.rod.observations import Observations
from doo_ti.rod.start import check_experiment, choose_hypothesis, observation_clamps, start_configuration, turn_hypotheses
from doo_ti.rod.types import Status
from doo_ti.system.errors import InputError
from doo_ti.system.files import write_whole
from doo_ti.system.terminal import busy, in_line, progress

WRITTEN = ("energy", "status", "iterations", "residual", "stable", "end_force")


def declare(add) -> None:
    parser = given.command(add, "relax", run_relax,
                           "relax each observed rod under one material and compare it with its observation (Eq. 1)")
    parser.add_argument("observations", metavar="OBS", help=f"observations: {loading.FORMATS}")
    parser.add_argument("--out", required=True, metavar="F.npz|F.csv", help="file to write")
    given.add_material(parser, "one number each", given.SHAPE_ONLY)
    given.add_relaxation(parser, "f64")
    loading.add_loading(parser)
    given.add_obstacles(parser, "without friction, which acts in simulate and predict")
    parser = given.command(add, "twist", run_twist, "estimate the twist of rods from their shapes (Eq. 4)")
    parser.add_argument("observations", metavar="OBS",
                        help=f"observations, or a file that perceive wrote: {loading.FORMATS}")
    parser.add_argument("--out", required=True, metavar="F.npz|F.csv", help="file to write")
    given.add_material(parser, "one number each", given.SHAPE_ONLY)
    parser.add_argument("--observations", dest="together", metavar="D",
                        help="each D consecutive observations share one angle φ "
                        "(default 1; with --offsets all of one grasp)")
    parser.add_argument("--offsets", dest="offset", metavar="FILE",
                        help="angles between the observations' end frames: .npz or .csv "
                        "with offset_deg or end_frame (default: from the observations' end_frame)")
    parser.add_argument("--regrasp", nargs="+", action="extend", default=[], metavar="INDEX",
                        help="observations before which the rod was released and grasped again; each starts a new φ")
    parser.add_argument("--picture", metavar="F.png", help="also draw the curves (default: no)")
    given.add_obstacles(parser, "without friction")
    loading.add_loading(parser)
    parser.add_argument("--precision", choices=PRECISIONS, default="f32",
                        help="floating-point arithmetic (default f32, whose error is below that of labels)")


def run_relax(options: Namespace) -> int:
    """F on each observation (§III-D), to one npz; of several whole-turn hypotheses the one nearest to the observation."""
    grid = given.single_cell(options, "give one number, or use sweep")
    frame_weight, out = given.frame_weight(options), given.output_file(options.out, results.RODS)
    surroundings = given.surroundings(options)
    observations = loading.load(options, options.observations)
    clamps = observation_clamps(observations, *given.clamps(options))
    check_experiment(observations, clamps, grid.axes[-1].values[-1], frame_weight)
    given.refuse_overwriting(out, options.observations)
    loading.warn(observations, surroundings)

    from doo_ti.learning.experiment import SOLVERS
    from doo_ti.relaxation.relax import relax as relax_rods
    from doo_ti.rod.metric import distance

    material = curved(options, grid.materials(), observations.rest_length)
    index, turns = turn_hypotheses(observations, clamps)
    observed, held = observations.take(index), clamps.take(index)
    # Without a solver relax allows more iterations among obstacles.
    solver = None if surroundings else SOLVERS[options.solver]()
    with busy(f"relaxing {observed.count} rods (kernels are compiled once on a machine)"):
        start = start_configuration(observed, held, turns)
        solution = relax_rods(start, material, held, solver, up=observations.up, precision=options.precision,
                              **surroundings.arguments)
    relaxed = solution.configuration
    error = distance(relaxed, observations, index, frame_weight)
    infeasible = np.flatnonzero(solution.status == Status.INFEASIBLE)
    error[infeasible] = np.nan
    best = choose_hypothesis(index, error, solution.converged & solution.stable)
    configuration = relaxed.take(best)
    result = {"vertices_mm": configuration.vertices, "frames": configuration.frames, "distance_mm": error[best],
              "rest_length_mm": observations.rest_length}
    result |= {name: getattr(solution, name)[best] for name in WRITTEN}
    contact = {}
    if surroundings:
        result["contact_force"] = solution.contact_force[best]
        result["smallest_gap_mm"] = surroundings.smallest_gap(result["vertices_mm"])
        contact = results.contact_summary(surroundings, result["contact_force"], result["smallest_gap_mm"], result["status"])
    results.save_arrays(out, results.in_newton(result, given.newtons(options, material.weight), 0))
    inside = _inside(surroundings, held, start, index, infeasible)
    summary = _summary_relax(observations, grid, result, out) | contact | {"infeasible_reason": inside}
    results.report(options, summary, lambda: _lines_relax(observations, grid, result, summary))
    return 0 if (result["status"] == Status.CONVERGED).any() else 1


def _inside(surroundings: Surroundings, clamps, start, index: np.ndarray, rows: np.ndarray) -> str | None:
    """What of the first of the ``rows`` is inside an obstacle, and by how much; None where nothing is."""
    from doo_ti.relaxation.contact_table import require_clear

    if not surroundings or not len(rows):
        return None
    try:
        require_clear("relax", surroundings.take(rows), clamps.take(rows), start.take(rows), index[rows])
    except InputError as error:
        return error.problem
    return None


def _summary_relax(observations: Observations, grid: Grid, result: dict, out: Path) -> dict:
    finite = result["distance_mm"][np.isfinite(result["distance_mm"])]
    return {
        "observations": observations.count, "edges": observations.edges, **results.theta_of(grid),
        "status": status_counts(result["status"]), "stable": int(result["stable"].sum()), "out": str(out),
        "mean_distance_mm": finite.mean() if len(finite) else np.nan,
        "largest_distance_mm": finite.max() if len(finite) else np.nan,
        "median_iterations": np.median(result["iterations"]), "largest_residual": np.max(result["residual"]),
    }


def _lines_relax(observations: Observations, grid: Grid, result: dict, summary: dict) -> list[str]:
    rods = f"{observations.count} rod{'s' * (observations.count != 1)}"
    lines = [f"{observations.name}: {rods} of {observations.edges} edges",
             loading.rod_line(observations), f"  material    {results.theta_text(results.theta_of(grid), grid.is_isotropic)}",
             f"  status      {results.counted(summary['status'])}; {summary['stable']} certified stable"]
    if np.isfinite(summary["mean_distance_mm"]):
        lines.append(f"  distance    mean {summary['mean_distance_mm']:.4g} mm, largest {summary['largest_distance_mm']:.4g} "
                     f"mm at observation {observations.labels[np.nanargmax(result['distance_mm'])]} (Eq. 1)")
    lines += results.contact_lines(summary, observations.count)
    if summary["infeasible_reason"]:
        lines.append(f"  infeasible  {summary['infeasible_reason']}")
    return [*lines, f"  iterations  median {summary['median_iterations']:.0f}, most {int(result['iterations'].max())}",
            f"  written to {in_line(summary['out'])}"]


# --- twist ---------------------------------------------------------------------------------------------------------------

MOST_LISTED = 20


def run_twist(options: Namespace) -> int:
    """Eq. 4 for each group of observations that share φ; writes φ and the whole curve, and prints ambiguous groups."""
    grid = given.single_cell(options)
    out = given.output_file(options.out, results.RODS)
    picture = given.output_file(options.picture, ".png", "--picture")
    observations = loading.load(options, options.observations)
    given.refuse_overwriting(out, options.observations)

    from doo_ti.perception.twist import TwistOptions, estimate_twist
    from doo_ti.perception.twist_curves import consecutive_groups, end_offsets, load_offsets

    offset = None
    if options.offset is not None:
        observations, offset = load_offsets(Path(options.offset), observations)
    regrasps = given.rows("--regrasp", ",".join(options.regrasp) or None, observations.count)
    together = given.whole("--observations", options.together, 1, observations.count)
    if together is None:
        together = observations.count if options.offset or regrasps else 1
    group = consecutive_groups(observations.count, together, regrasps)
    check_experiment(replace(observations, frames=None), observation_clamps(observations), grid.axes[-1].values[-1], 0.0)
    if offset is None and (together > 1 or options.offset):
        offset = end_offsets(observations, group)
    loading.warn(observations)
    material = curved(options, grid.materials(), observations.rest_length)
    search = TwistOptions(precision=options.precision, surroundings=given.surroundings(options))
    with progress() as bar:
        task = bar.add_task("twist", total=observations.count * len(search.angles), unit="rods")

        def advance(rods: int) -> None:
            bar.advance(task, rods)
            # How many rods refining the minima takes is known only afterwards.
            bar.update(task, total=max(bar.tasks[task].completed, bar.tasks[task].total))

        estimate = estimate_twist(observations, material, group, offset, search, advance)
    result = _arrays_twist(estimate)
    if out.suffix == ".npz":
        results.save_arrays(out, result)
    else:
        out.parent.mkdir(parents=True, exist_ok=True)
        write_whole(out, lambda file: write_columns(file, _columns(observations, result)))
    if picture is not None:
        _draw_twist(picture, observations, estimate)
    summary = _summary_twist(observations, grid, estimate, result, out)
    results.report(options, summary, lambda: _lines_twist(observations, grid, estimate, summary))
    return 0 if np.isfinite(estimate.phi).any() else 1


def _arrays_twist(estimate) -> dict[str, np.ndarray]:
    """The arrays of the file; docs/commands/twist.md."""
    return {
        "phi_deg": np.degrees(estimate.phi), "objective_mm": estimate.objective, "phi_grid_deg": np.degrees(estimate.angles),
        "least_mm": estimate.least, "verdict": estimate.verdict, "low_deg": np.degrees(estimate.low),
        "high_deg": np.degrees(estimate.high), "minima_deg": np.degrees(estimate.minima),
        "minima_mm": estimate.minima_objective, "unsound": estimate.unsound, "group": estimate.group,
        "offset_deg": np.degrees(estimate.offset), "total_twist_deg": np.degrees(estimate.total_twist),
    }


def _columns(observations: Observations, result: dict) -> dict[str, np.ndarray]:
    """What a CSV file holds of them: a row per observation, with the values of its group."""
    own = {name: result[name] for name in ("group", "offset_deg", "total_twist_deg")}
    shared = {name: result[name][result["group"]] for name in ("phi_deg", "least_mm", "verdict", "low_deg", "high_deg")}
    return {"observation": observations.labels, **own, **shared}


def _rows(observations: Observations, estimate, group: int) -> str:
    """``observations 6 to 11``."""
    rows = observations.labels[estimate.group == group]
    return f"observation {rows[0]}" if len(rows) == 1 else f"observations {rows[0]} to {rows[-1]}"


def _draw_twist(path: Path, observations: Observations, estimate) -> None:
    from doo_ti.report import angle_curves_picture
    from doo_ti.report.figures import MOST_CURVES

    names = [f"{_rows(observations, estimate, k)}: {np.degrees(estimate.phi[k]):.0f}°, {_word(estimate.verdict[k])}"
             for k in range(min(MOST_CURVES, len(estimate.phi)))]
    path.parent.mkdir(parents=True, exist_ok=True)
    angle_curves_picture(
        path, np.degrees(estimate.angles), estimate.objective, phi=np.degrees(estimate.phi), low=np.degrees(estimate.low),
        high=np.degrees(estimate.high), names=names, unsound=estimate.unsound, title=f"{observations.name}: Eq. 4")


def _word(verdict: int) -> str:
    from doo_ti.perception.twist import TwistVerdict

    return TwistVerdict(verdict).name.lower().replace("_", " ")


def _summary_twist(observations: Observations, grid: Grid, estimate, result: dict, out: Path) -> dict:
    verdicts = {_word(kind): int(count) for kind, count in zip(*np.unique(estimate.verdict, return_counts=True), strict=True)}
    arrays = ("phi_deg", "least_mm", "low_deg", "high_deg", "minima_deg", "minima_mm", "total_twist_deg")
    theta = results.theta_of(grid)
    del theta["bend_12"]
    return {"observations": observations.count, "groups": len(estimate.phi), **theta, "verdicts": verdicts,
            "unsound_rods": int(estimate.unsound.sum()), "verdict": [_word(kind) for kind in estimate.verdict],
            **{name: result[name] for name in arrays}, "out": str(out)}


def _lines_twist(observations: Observations, grid: Grid, estimate, summary: dict) -> list[str]:
    rods = observations.count * len(estimate.angles)
    return [
        f"{observations.name}: {observations.count} observations in {summary['groups']} groups that share φ",
        loading.rod_line(observations),
        f"  material    {results.theta_text(results.theta_of(grid), grid.is_isotropic)}",
        f"  verdicts    {results.counted(summary['verdicts'])}; {summary['unsound_rods']} of {rods} rods on the curves have no "
        "certified minimum",
        *results.shortened([_group_line(observations, estimate, k) for k in range(len(estimate.phi))], MOST_LISTED,
                           f"  and {{}} more, which {in_line(Path(summary['out']).name)} holds"),
        f"  written to {in_line(summary['out'])}"]


def _group_line(observations: Observations, estimate, k: int) -> str:
    phi, low, high = (np.degrees(values[k]) for values in (estimate.phi, estimate.low, estimate.high))
    if np.isnan(phi):
        return f"  {_rows(observations, estimate, k)}: {_word(estimate.verdict[k])}, no rod found an equilibrium"
    others = zip(np.degrees(estimate.minima[k][1:]), estimate.minima_objective[k][1:], strict=True)
    rivals = "".join(f"; also {other:.0f}°, {value:.3g} mm" for other, value in others if np.isfinite(other))
    together = int((estimate.group == k).sum())
    least = f"{estimate.least[k]:.3g} mm" if together == 1 else f"Σ {estimate.least[k]:.3g} mm over {together} rods"
    return (f"  {_rows(observations, estimate, k)}: φ = {phi:.1f}°, {least}, {_word(estimate.verdict[k])} (95 %: "
            f"{low:.0f}° to {high:.0f}°){rivals}")
