"""Learning a rod's Θ from recorded motion (Eq. 3 for rods in motion, docs/dynamics.md)."""

from argparse import Namespace
from dataclasses import replace
from pathlib import Path

import numpy as np

import doo_ti
from doo_ti.commands import doubts, given, loading, results
from doo_ti.dynamics.recorded import RecordedMotion
from doo_ti.io.observation_files import load_observations
from doo_ti.system.errors import InputError, require
from doo_ti.system.terminal import in_line, progress

MOST_LISTED = 8
FAR_OFF = 0.02  # mean error after the fit over the rod's length: noise and friction do less, a wrong rate or direction more
RATE_OFF, RATE_GAIN = 0.03, 0.2
"""Relative change of the rate, and share of the squared residuals that it saves, with which it is likely to be wrong: of
recordings at the right rate, losses left out of the fit, it saves a twentieth; at one that is wrong by 4 to 10 %, 0.3 to 0.8
where rods swing. What time steps leave may look like 2 % of the rate; 24 for 25 frames a second are 4 %."""
FITTED = ("bend_damping", "drag", "quadratic_drag", "twist_ratio", "marker_share", "friction")


def declare(add) -> None:
    parser = given.command(add, "identify", run, "learn bend stiffness, damping, drag and rest curvature from recorded motion")
    parser.add_argument("motions", nargs="+", metavar="MOTION",
                        help=f"recorded markers of one rod: {loading.RECORDINGS}; the first and last edges are the grippers, "
                        "or with --free-end the first")
    given.add_out(parser, "THETA.json")
    parser.add_argument("--still", nargs="+", default=[], metavar="OBS",
                        help="also observations of the same rod at rest: .npz, .csv or .parquet, marked from the same end")
    given.add(parser, "--still-noise", "MM", given.LENGTH, "standard deviation of a coordinate of their marks (default: the "
              "file's, else from the residuals)")
    given.add(parser, "--clip", "MM", given.not_negative("mm"), "length of rod that a gripper holds, from its outer marker on; "
              "up to the distance to the inner one (default: half of that)")
    given.add(parser, "--modes", "K", given.whole(0, 12), "Legendre modes of the rest curvature in each direction; 0: straight "
              "at rest", 7)
    parser.add_argument("--fit", metavar="NAME,…", default=",".join(FITTED[:4]),
                        help="parameters besides bend and rest curvature: some of "
                        f"{', '.join(FITTED)} (default: the first four)")
    given.add(parser, "--bend", "A", given.positive("mm³"), "bend stiffness α to begin with, mm³ (default: several are tried)")
    given.add(parser, "--folds", "N", given.FROM_ZERO, "also fit N times, each without one N-th of the recordings, and report "
              "the error on those", 0)
    given.add(parser, "--robust", "MM", given.LENGTH, "differences beyond count linearly", 5.0)
    given.add(parser, "--substeps", "N", given.whole(1, 1000), "time steps from one frame to the next", 1)
    given.add_obstacles(parser, "with friction, the file's or, with --fit friction, one coefficient for all of them")
    loading.add_recordings(parser, "the file's, else 0,0,1")
    given.add_file(parser, "--picture", "F.png", "also draw predictions and errors over time (default: no)")


def run(options: Namespace) -> int:
    from doo_ti.dynamics.identify import guesses, require_clear_grippers

    fitted = tuple(filter(None, options.fit.split(",")))
    if unknown := next((name for name in fitted if name not in FITTED), None):
        raise InputError(given.SOURCE, "--fit", f"{unknown!r} is unknown", f"give some of {', '.join(FITTED)}")
    surroundings = given.surroundings(options)
    if "friction" in fitted and not surroundings.bodies:
        raise InputError(given.SOURCE, "--fit", "friction without obstacles", "give --obstacles and --radius, or leave it out")
    chosen = doo_ti.IdentifyOptions(options.modes, fitted, delta=options.robust, substeps=options.substeps,
                                    surroundings=surroundings, smoothing=options.smoothing, clip=options.clip)
    motion = RecordedMotion.together(loading.recordings(options, options.motions), options.motions)
    up = given.world_up(options, motion.up)
    stills = _stills(options, motion, surroundings)
    require(options.folds != 1 and options.folds <= motion.count, given.SOURCE, "--folds",
            f"{options.folds} for {motion.count} recordings", "give 0, or from 2 to their number")
    require_clear_grippers(motion, guesses(motion, chosen, options.bend, up)[0], chosen)
    doubts.warn_of_rod(options.motions[0], motion.edge_lengths(), surroundings)
    with progress(keep=True) as bar:
        def fit(part, label):
            task = bar.add_task(label, total=chosen.rounds, unit="iterations")
            def advance(horizon, k, error):
                bar.update(task, advance=1, rate=f"{horizon} frames: {error:.3g} mm")
            found = doo_ti.identify_from_guesses(part, chosen, options.bend, up, advance, stills)
            bar.update(task, completed=chosen.rounds)
            return found
        held_out = _held_out(motion, options.folds, chosen, fit) if options.folds else None
        found = fit(motion, "all recordings")
    if found.failed.all():
        raise RuntimeError(f"no recording could be rolled out, from {len(motion.names)}; give a higher --bend to begin with")
    rollouts = chosen.rollouts(motion, found.theta)
    summary = _summary(found, motion, held_out, rollouts, options.out)
    results.save_json(options.out, {"doo_ti": "theta", **summary["theta"], **{key: summary[key] for key in (
        "parameters", "error_mm", "mean_error_mm", "median_error_mm", "smoothing", "failed", "inside_mm", "held_out", "stills",
        "glitches")}})
    share = summary["mean_error_mm"] / motion.edge_lengths().sum()
    doubts.say(options.motions[0], None if not share > FAR_OFF else f"after the fit the rod is {share:.1%} of its length off; "
               "check the rate, the unit, --up and the order of the markers")
    doubts.say(options.motions[0], f"the motion fits better at about {found.rate:.3g} frames a second than at the "
               f"{motion.rate:g} stated; check the rate" if found.rate_gain > RATE_GAIN and abs(
                   found.rate / motion.rate - 1) > RATE_OFF else None)
    doubts.say(options.motions[0], "the best guess is half as far off if the last marker is on the gripper; give the markers "
               "from the gripper on" if motion.free_end and _better_reversed(motion, chosen, up) else None)
    if options.picture is not None:
        from doo_ti.report.contact import Touched
        from doo_ti.report.motions import save_rollout

        positions, _, _, simulation = rollouts.simulated(found.theta)
        touched = Touched(surroundings, positions, simulation.contact_force) if surroundings else None
        save_rollout(options.picture, "identified", list(motion.names), positions, motion.positions, motion.rate,
                     found.theta.up, touched=touched)
    results.report(options, summary, lambda: _lines(summary, motion))
    return 0


def _better_reversed(motion, chosen, up) -> bool:
    """Whether the best guess is half as far off where a rod's last marker is taken for its first."""
    from doo_ti.dynamics.identify import first_errors, guesses

    other = replace(motion, positions=motion.positions[:, :, ::-1])
    here, there = (first_errors(one, chosen, guesses(one, chosen, None, up)).min() for one in (motion, other))
    return bool(there < 0.5 * here)


def _stills(options: Namespace, motion, surroundings) -> list:
    """The observations at rest of the rod in ``motion``, with their noise, checked."""
    from doo_ti.dynamics.rollouts import roll_reference

    noise = options.still_noise
    if not options.still:
        given.refuse(options, ("still_noise",), "given without --still", "give both")
    found = [load_observations(path, options.up) for path in options.still]
    for one in found:
        doo_ti.Stills.of(one, roll_reference(motion), motion.edge_lengths().sum(), surroundings)
    return found if noise is None else [replace(one, sigma=np.array(noise)) for one in found]


def _held_out(motion, folds: int, chosen, fit) -> np.ndarray:
    """(R,) error of each recording under the Θ of the others, mm."""
    from doo_ti.dynamics.rollouts import mean_error

    error = np.full(motion.count, np.nan)
    for fold in range(folds):
        out = np.arange(motion.count) % folds == fold
        theta = fit(motion.take(np.flatnonzero(~out)), f"fold {fold + 1} of {folds}").theta
        rest = motion.take(np.flatnonzero(out))
        positions = chosen.rollouts(rest, theta).predicted([theta])[0][:, 0]
        error[out] = mean_error(positions, rest.positions)[:, 2:].mean(axis=1)
    return error


def _summary(found, motion, held_out, rollouts, out: Path) -> dict:
    from doo_ti.dynamics.theta import save_form

    sound = found.error[~found.failed]
    held = None
    if held_out is not None:
        finite = held_out[np.isfinite(held_out)]
        held = {"error_mm": dict(zip(motion.names, held_out, strict=True)), "mean_error_mm": finite.mean(),
                "standard_error_mm": finite.std(ddof=1) / np.sqrt(len(finite)), "median_error_mm": np.median(finite)}
    return {
        "recordings": motion.count, "frames": motion.positions.shape[1], "theta": save_form(found.theta),
        "parameters": found.parameters(),
        "not_fitted": {name: getattr(found.theta, name) for name in FITTED[:4] if name not in found.unknowns.fitted},
        "error_mm": dict(zip(motion.names, found.error, strict=True)),
        "mean_error_mm": sound.mean() if len(sound) else np.nan, "median_error_mm": np.median(sound) if len(sound) else np.nan,
        "stills": {"count": len(found.still_error), "left_out": int(np.isnan(found.still_error).sum()),
                   "mean_error_mm": np.nanmean(found.still_error) if np.isfinite(found.still_error).any() else None},
        "failed": [name for name, failed in zip(motion.names, found.failed, strict=True) if failed], "held_out": held,
        "inside_mm": {name: depth for name, depth in zip(motion.names, rollouts.depth, strict=True) if depth > 0},
        "smoothing": rollouts.layout.smoothing,
        "iterations": found.iterations, "converged": found.converged, "glitches": motion.glitches(), "out": str(out)}


def _lines(summary: dict, motion) -> list[str]:
    from doo_ti.dynamics.theta import Unknowns

    still, held, inside = summary["stills"], summary["held_out"], summary["inside_mm"]
    rest = np.asarray(summary["theta"]["rest_curvature_per_mm"])
    fitted = [entry for entry in summary["parameters"] if not entry["name"].startswith("rest_curvature")]
    glitches = results.shortened(summary["glitches"], MOST_LISTED, "and {} more")
    begun = "two frames" if summary["smoothing"] == 1 else f"{summary['smoothing']} frames, smoothed"
    error = "none was usable" if still["mean_error_mm"] is None else f"mean distance {still['mean_error_mm']:.4g} mm"
    return [
        f"{summary['recordings']} recordings of {motion.edges} edges, {summary['frames']} frames at {motion.rate:g}/s",
        *results.rows(
            *((entry["name"], f"{entry['value']:.4g} {entry['unit']}  [{entry['low'] or 0:.3g}, {entry['high']:.3g}] 95 %")
              for entry in fitted),
            ("not fitted", ", ".join(f"{name} {value:g} {Unknowns.UNITS[name]}".strip()
                                     for name, value in summary["not_fitted"].items())),
            ("rest curvature", rest.any() and f"{np.sqrt((rest**2).sum(axis=1).mean()):.3g} 1/mm root mean square along the "
                                              "rod"),
            ("error", f"mean {summary['mean_error_mm']:.4g} mm, median {summary['median_error_mm']:.4g} mm over recordings, "
                      f"rolled out from their first {begun}"),
            ("at rest", still["count"] and f"{still['count']} still frames, {still['left_out']} left out; {error}"),
            ("held out", held and f"mean {held['mean_error_mm']:.4g} ± {held['standard_error_mm']:.2g} mm, median "
                                  f"{held['median_error_mm']:.4g} mm"),
            ("NOT converged", not summary["converged"] and "more iterations would change Θ; give fewer --fit or --modes"),
            ("failed", summary["failed"] and f"{results.listed(summary['failed'], MOST_LISTED)}: left out"),
            ("inside", inside and f"the grippers of {results.listed(inside, MOST_LISTED)} hold the rod up to "
                                  f"{max(inside.values()):.3g} mm inside an obstacle: correct its place, or give a smaller "
                                  "--radius"),
            *(("glitch", in_line(line)) for line in glitches), width=16)]
