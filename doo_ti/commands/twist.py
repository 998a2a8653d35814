"""Twist angles from shapes (§IV-B)."""

import json
from argparse import Namespace
from dataclasses import replace
from pathlib import Path

import numpy as np

from doo_ti import options as given
from doo_ti.commands.arguments import add_json, add_material
from doo_ti.commands.printing import counted, plain, theta_text
from doo_ti.dataset import Observations, load_observations
from doo_ti.grid import Grid
from doo_ti.progress import progress
from doo_ti.scene import PRECISIONS
from doo_ti.start import check_experiment, observation_clamps
from doo_ti.terminal import in_line
from doo_ti.whole_file import write_whole

MOST_TOLD = 20


def declare(add) -> None:
    parser = add("twist", allow_abbrev=False, help="how far rods are twisted, from their shapes")
    parser.add_argument("observations", metavar="OBS", help="observations, or what perceive wrote: .npz, .csv or .parquet")
    parser.add_argument("--out", required=True, metavar="F.npz", help="file to write")
    add_material(parser, "one number, --bend also A1,A2 or A1,A2,A12")
    parser.add_argument("--observations", dest="together", metavar="D",
                        help="so many observations in succession share φ (default 1, with --offsets all of a grasp)")
    parser.add_argument("--offsets", metavar="FILE", help="how the end frames lie to each other: .npz or .csv with "
                        "offset_deg or end_frame (default: the observations' own end_frame)")
    parser.add_argument("--regrasp", nargs="+", action="extend", default=[], metavar="INDEX",
                        help="observations from which on the rod was grasped anew, each with a φ of its own")
    parser.add_argument("--picture", metavar="F.png", help="also draw the curves (default: not)")
    parser.add_argument("--up", metavar="X,Y,Z", help="direction against gravity (default: the file's, else 0,0,1)")
    parser.add_argument("--precision", choices=PRECISIONS, default="f32", help="default f32: labels are coarser")
    add_json(parser)
    parser.set_defaults(run=run)


def run(options: Namespace, words: list[str]) -> int:
    """Eq. 4 for each group of observations that share φ; writes φ and the whole curve, and prints what is ambiguous."""
    grid = given.single_cell(options)
    out, up = given.output_file(options.out, ".npz"), given.up(options)
    picture = None if options.picture is None else given.output_file(options.picture, ".png", "--picture")
    observations = load_observations(options.observations, up)
    given.refuse_overwriting(out, options.observations)

    from doo_ti.twist.curves import consecutive_groups, end_offsets, load_offsets
    from doo_ti.twist.estimation import TwistOptions, estimate_twist

    offset = None
    if options.offsets is not None:
        observations, offset = load_offsets(Path(options.offsets), observations)
    regrasps = given.rows("--regrasp", ",".join(options.regrasp) or None, observations.count)
    together = given.whole("--observations", options.together, 1, observations.count)
    if together is None:
        together = observations.count if options.offsets or regrasps else 1
    group = consecutive_groups(observations.count, together, regrasps)
    check_experiment(replace(observations, frames=None), observation_clamps(observations), grid.axes[-1].values[-1], 0.0)
    if offset is None and (together > 1 or options.offsets):
        offset = end_offsets(observations, group)
    search = TwistOptions(precision=options.precision)
    with progress() as bar:
        task = bar.add_task("twist", total=observations.count * len(search.angles), unit="rods")

        def advance(rods: int) -> None:
            bar.advance(task, rods)
            # What refining the minima takes shows only then.
            bar.update(task, total=max(bar.tasks[task].completed, bar.tasks[task].total))

        estimate = estimate_twist(observations, grid.materials(), group, offset, search, advance)
    result = _arrays(estimate)
    out.parent.mkdir(parents=True, exist_ok=True)
    write_whole(out, lambda file: np.savez_compressed(file, **result))
    if picture is not None:
        _draw(picture, observations, estimate)
    _tell(options, observations, grid, estimate, result, out)
    return 0 if np.isfinite(estimate.phi).any() else 1


def _arrays(estimate) -> dict[str, np.ndarray]:
    """What the file holds; docs/twist.md."""
    return {
        "phi_deg": np.degrees(estimate.phi), "objective_mm": estimate.objective, "phi_grid_deg": np.degrees(estimate.angles),
        "least_mm": estimate.least, "verdict": estimate.verdict, "low_deg": np.degrees(estimate.low),
        "high_deg": np.degrees(estimate.high), "minima_deg": np.degrees(estimate.minima),
        "minima_mm": estimate.minima_objective, "unsound": estimate.unsound, "group": estimate.group,
        "offset_deg": np.degrees(estimate.offset), "total_twist_deg": np.degrees(estimate.total_twist),
    }


def _rows(estimate, group: int) -> str:
    """``observations 6 to 11``."""
    rows = np.flatnonzero(estimate.group == group)
    return f"observation {rows[0]}" if len(rows) == 1 else f"observations {rows[0]} to {rows[-1]}"


def _draw(path: Path, observations: Observations, estimate) -> None:
    from doo_ti.report import angle_curves_picture
    from doo_ti.report.identifiability import MOST_CURVES

    names = [f"{_rows(estimate, k)}: {np.degrees(estimate.phi[k]):.0f}°, {_word(estimate.verdict[k])}"
             for k in range(min(MOST_CURVES, len(estimate.phi)))]
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, lambda file: angle_curves_picture(
        file, np.degrees(estimate.angles), estimate.objective, phi=np.degrees(estimate.phi), low=np.degrees(estimate.low),
        high=np.degrees(estimate.high), names=names, unsound=estimate.unsound, title=f"{observations.name}: Eq. 4"))


def _word(verdict: int) -> str:
    from doo_ti.twist.estimation import Verdict

    return Verdict(verdict).name.lower().replace("_", " ")


def _tell(options: Namespace, observations: Observations, grid: Grid, estimate, result: dict, out: Path) -> None:
    theta = {name: float(value[0]) for name, value in grid.cell_values().items()}
    verdicts = {_word(kind): int(count) for kind, count in zip(*np.unique(estimate.verdict, return_counts=True), strict=True)}
    unsound = int(estimate.unsound.sum())
    rods = observations.count * len(estimate.angles)
    if options.json:
        told = ("phi_deg", "least_mm", "low_deg", "high_deg", "minima_deg", "minima_mm", "total_twist_deg")
        print(json.dumps(plain({
            "observations": observations.count, "groups": len(estimate.phi), **theta, "verdicts": verdicts,
            "unsound_rods": unsound, "verdict": [_word(kind) for kind in estimate.verdict],
            **{name: result[name] for name in told}, "out": str(out)})))
        return
    print(f"{observations.name}: {observations.count} observations in {len(estimate.phi)} groups that share φ")
    print(f"  material    {theta_text(theta | {'bend_12': grid.bend_12}, grid.is_isotropic)}")
    print(f"  verdicts    {counted(verdicts)}; {unsound} of {rods} rods on the curves came to no certified minimum")
    for k in range(min(MOST_TOLD, len(estimate.phi))):
        _tell_group(estimate, k)
    if len(estimate.phi) > MOST_TOLD:
        print(f"  and {len(estimate.phi) - MOST_TOLD} more, which {in_line(out.name)} holds")
    print(f"  written to {in_line(out)}")


def _tell_group(estimate, k: int) -> None:
    phi, low, high = (np.degrees(values[k]) for values in (estimate.phi, estimate.low, estimate.high))
    if np.isnan(phi):
        print(f"  {_rows(estimate, k)}: {_word(estimate.verdict[k])}, no rod came to rest")
        return
    others = zip(np.degrees(estimate.minima[k][1:]), estimate.minima_objective[k][1:], strict=True)
    rivals = "".join(f"; also {other:.0f}°, {value:.3g} mm" for other, value in others if np.isfinite(other))
    together = int((estimate.group == k).sum())
    least = f"{estimate.least[k]:.3g} mm" if together == 1 else f"Σ {estimate.least[k]:.3g} mm over {together} rods"
    print(f"  {_rows(estimate, k)}: φ = {phi:.1f}°, {least}, {_word(estimate.verdict[k])} (nearly as good: "
          f"{low:.0f}° to {high:.0f}°){rivals}")
