"""``doo-ti twist``: the angles that explain the shapes of observed rods (§IV-B, Eq. 4)."""

from argparse import Namespace
from dataclasses import replace
from pathlib import Path

import numpy as np

import doo_ti
from doo_ti.commands import doubts, given, loading, results
from doo_ti.commands.moving_rods import with_rest_curvature
from doo_ti.io.observation_tables import write_columns
from doo_ti.io.scene import PRECISIONS
from doo_ti.rod.grid import Grid
from doo_ti.rod.observations import Observations
from doo_ti.rod.start import check_experiment, observation_clamps
from doo_ti.system.files import write_whole
from doo_ti.system.terminal import in_line, progress, warn

MOST_LISTED = 20


def declare(add) -> None:
    parser = given.command(add, "twist", run_twist, "estimate the twist of rods from their shapes (Eq. 4)")
    parser.add_argument("observations", metavar="OBS",
                        help=f"observations, or a file that perceive wrote: {loading.FORMATS}")
    given.add_out(parser, "F.npz|F.csv")
    given.add_material(parser, "one number each", given.SHAPE_ONLY)
    given.add(parser, "--observations", "D", str, "each D consecutive observations share one angle φ (default 1; with "
              "--offsets all of one grasp)", dest="together")
    given.add(parser, "--offsets", "FILE", str, "angles between the observations' end frames: .npz or .csv with offset_deg or "
              "end_frame (default: from the observations' end_frame)", dest="offset")
    parser.add_argument("--regrasp", nargs="+", action="extend", default=[], metavar="INDEX",
                        help="observations before which the rod was released and grasped again; each starts a new φ")
    given.add_file(parser, "--picture", "F.png", "also draw the curves (default: no)")
    given.add_obstacles(parser, "without friction")
    loading.add_loading(parser)
    parser.add_argument("--precision", choices=PRECISIONS, default="f32",
                        help="floating-point arithmetic (default f32, whose error is below that of labels)")


def run_twist(options: Namespace) -> int:
    """Eq. 4 for each group of observations that share φ; writes φ and the whole curve, and prints ambiguous groups."""
    grid = given.single_cell(options)
    out = options.out
    observations = loading.load(options, options.observations)
    results.refuse_overwriting(out, options.observations)

    from doo_ti.perception.twist_curves import load_offsets

    offset = None
    if options.offset is not None:
        observations, offset = load_offsets(Path(options.offset), observations)
    regrasps = given.rows("--regrasp", ",".join(options.regrasp) or None, observations.count)
    together = observations.count if options.offset or regrasps else 1
    if options.together is not None:
        together = given.whole(1, observations.count)("--observations", options.together)
    group = doo_ti.consecutive_groups(observations.count, together, regrasps)
    check_experiment(replace(observations, frames=None), observation_clamps(observations), grid.axes[-1].values[-1], 0.0)
    if offset is None and (together > 1 or options.offset):
        offset = doo_ti.end_offsets(observations, group)
    surroundings = given.surroundings(options)
    doubts.warn(observations, surroundings, **loading.stated(options))
    if all(getattr(options, name) is None for name in ("twist", "twist_ratio", "GJ", "theta")):
        warn("GJ is not given, and taken to be as large as EI: shapes show GJ times the twist, so half the GJ is twice the "
             "twist; give --GJ, or --twist")
    material = with_rest_curvature(options, grid.materials(), observations.rest_length)
    search = doo_ti.TwistOptions(precision=options.precision, surroundings=surroundings)
    with progress() as bar:
        task = bar.add_task("twist", total=observations.count * len(search.angles), unit="rods")

        def advance(rods: int) -> None:
            bar.advance(task, rods)
            # How many rods refining the minima takes is known only afterwards.
            bar.update(task, total=max(bar.tasks[task].completed, bar.tasks[task].total))

        estimate = doo_ti.estimate_twist(observations, material, group, offset, search, advance)
    result = _arrays(estimate)
    if out.suffix == ".npz":
        results.save_arrays(out, result)
    else:
        # A row per observation, with the values of its group.
        own = {name: result[name] for name in ("group", "offset_deg", "total_twist_deg")}
        shared = {name: result[name][result["group"]] for name in ("phi_deg", "least_mm", "verdict", "low_deg", "high_deg")}
        write_whole(out, lambda file: write_columns(file, {"observation": observations.labels, **own, **shared}))
    if options.picture is not None:
        from doo_ti.report.figures import MOST_CURVES, angle_curves_picture

        names = [f"{_rows(observations, estimate, k)}: {np.degrees(estimate.phi[k]):.0f}°, {_word(estimate.verdict[k])}"
                 for k in range(min(MOST_CURVES, len(estimate.phi)))]
        angle_curves_picture(
            options.picture, result["phi_grid_deg"], estimate.objective, phi=result["phi_deg"], low=result["low_deg"],
            high=result["high_deg"], names=names, unsound=estimate.unsound, title=f"{observations.name}: Eq. 4")
    summary = _summary(observations, grid, estimate, result, out)
    results.report(options, summary, lambda: _lines(observations, grid, estimate, summary))
    return 0 if np.isfinite(estimate.phi).any() else 1


def _arrays(estimate) -> dict[str, np.ndarray]:
    """The arrays of the file; docs/commands/twist.md."""
    return {
        "phi_deg": np.degrees(estimate.phi), "objective_mm": estimate.objective, "phi_grid_deg": np.degrees(estimate.angles),
        "least_mm": estimate.least, "verdict": estimate.verdict, "low_deg": np.degrees(estimate.low),
        "high_deg": np.degrees(estimate.high), "minima_deg": np.degrees(estimate.minima),
        "minima_mm": estimate.minima_objective, "unsound": estimate.unsound, "group": estimate.group,
        "offset_deg": np.degrees(estimate.offset), "total_twist_deg": np.degrees(estimate.total_twist),
    }


def _rows(observations: Observations, estimate, group: int) -> str:
    """``observations 6 to 11``."""
    rows = observations.labels[estimate.group == group]
    return f"observation {rows[0]}" if len(rows) == 1 else f"observations {rows[0]} to {rows[-1]}"


def _word(verdict: int) -> str:
    return doo_ti.TwistVerdict(verdict).name.lower().replace("_", " ")


def _summary(observations: Observations, grid: Grid, estimate, result: dict, out: Path) -> dict:
    verdicts = {_word(kind): int(count) for kind, count in zip(*np.unique(estimate.verdict, return_counts=True), strict=True)}
    arrays = ("phi_deg", "least_mm", "low_deg", "high_deg", "minima_deg", "minima_mm", "total_twist_deg")
    theta = results.theta_of(grid)
    del theta["bend_12"]
    return {"observations": observations.count, "groups": len(estimate.phi), **theta, "verdicts": verdicts,
            "unsound_rods": int(estimate.unsound.sum()), "verdict": [_word(kind) for kind in estimate.verdict],
            **{name: result[name] for name in arrays}, "out": str(out)}


def _lines(observations: Observations, grid: Grid, estimate, summary: dict) -> list[str]:
    rods = observations.count * len(estimate.angles)
    return [
        f"{observations.name}: {observations.count} observations in {summary['groups']} groups that share φ",
        loading.rod_line(observations),
        f"  material    {results.theta_text(results.theta_of(grid), grid.is_isotropic)}",
        f"  verdicts    {results.status_text(summary['verdicts'])}; {summary['unsound_rods']} of {rods} rods on the curves "
        "have no certified minimum",
        *results.shortened([_group_line(observations, estimate, k) for k in range(len(estimate.phi))], MOST_LISTED,
                           f"  and {{}} more, which {in_line(Path(summary['out']).name)} holds")]


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
