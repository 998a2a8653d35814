"""Rods in motion: simulated from a recording's grippers, or from a scene (docs/dynamics.md)."""

from argparse import SUPPRESS, Namespace
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

import doo_ti
from doo_ti.commands import doubts, given, loading, moving_rods, results
from doo_ti.commands.moving_rods import LOSSES, OF_MOTIONS, SimulatedRods
from doo_ti.contact.surroundings import Surroundings
from doo_ti.contact.touch import Touch
from doo_ti.dynamics.parameters import Stepping
from doo_ti.io.pose_table import holds_poses
from doo_ti.io.scene import PRECISIONS
from doo_ti.io.toml_file import scene_file
from doo_ti.learning.landscape import status_counts
from doo_ti.rod.types import Clamp, Status
from doo_ti.system.arguments import counted
from doo_ti.system.errors import InputError, require
from doo_ti.system.terminal import busy, in_line, progress, warn

CLAMPS = ("clamp_start", "clamp_end")
OF_STEPPING = ("substeps", "scheme", "precision", "tolerance", "most_substeps", "quasi_static")  # options that are its fields
MOST_LISTED = 8
OF_ALL = ("rate_hz", "recording")  # arrays that have no row for each rod
NOTABLE = 0.02  # share of the energy: what the time steps lose beyond it is said
STILL = 1e-3  # of its length, by which a rod moves that is at rest but for rounding
SPLIT = ("kinetic", "gravity", "bending", "twist", "dissipated", "work", "unaccounted", "sum")
"""Energies in pictures and recordings."""


@dataclass(frozen=True)
class _Simulated:
    """What was simulated: R rods at T frames, and what was recorded of them, or None."""

    name: str
    names: list[str]
    positions: np.ndarray  # (R, T, V, 3)
    status: np.ndarray  # (R, T)
    rate: float
    up: np.ndarray
    recorded: np.ndarray | None = None
    glitches: tuple[str, ...] = ()
    alone: bool = False  # one recording, written without an axis for several
    energies: dict[str, np.ndarray] = field(default_factory=dict)  # (R, T) each
    substeps: np.ndarray | None = None  # (R,)
    step_error: np.ndarray | None = None  # (R,) mm, where there is a tolerance
    tolerance: float | None = None
    surroundings: Surroundings = Surroundings()
    contact: dict[str, np.ndarray] = field(default_factory=dict)  # (R, T, ...) arrays of contact, with obstacles
    newtons: np.ndarray | None = None  # (R,) N in the unit of force
    end_force: np.ndarray | None = None  # (R, F, 3) of the far clamp on the rod, at the last F frames


def declare(add) -> None:
    parser = given.command(add, "simulate", run, "simulate rods in motion: with inertia, damping and drag, grippers moving")
    parser.add_argument("source", metavar="RECORDING|SCENE.toml|OBS", type=scene_file,
                        help=f"recorded markers, the first and last edges on the grippers: {loading.RECORDINGS}; or a scene; "
                        f"or, with --motion, observations the rods start from: {loading.FORMATS}")
    given.add_out(parser, "F.npz|F.csv")
    given.add(parser, "--substeps", "N", given.whole(1, 1000), "time steps from one frame to the next (default: 1, or the "
              "scene's)")
    given.add(parser, "--tolerance", "MM", given.LENGTH, "estimate the error of the time steps, and double them for each rod "
              "until it is below this in all frames (default: fixed steps, no estimate)")
    given.add(parser, "--most-substeps", "N", given.whole(2, 4096), "with --tolerance, at most (default 64)")
    given.add(parser, "--scheme", None, ("bdf2", "euler"), "of time steps: second order, or backward Euler (default bdf2)")
    given.add(parser, "--precision", None, PRECISIONS, "arithmetic; mixed: f32, and f64 for rods that it cannot finish", "f64")
    parser.add_argument("--quasi-static", action="store_true", help="without inertia and drag: every step is an equilibrium "
                        "(default: as the scene says)")
    given.add_material(parser, "of rods that observations show: a number or LO:HI:N[:log|:lin]; a RECORDING needs --theta",
                       given.EVERYTHING, "for --EI, --GJ and forces in N")
    moving_rods.add_losses(parser)
    given.add_clamps(parser)
    moving_rods.add_motion(parser)
    parser.add_argument("--start", metavar="OBS", help=SUPPRESS)
    parser.set_defaults(theta_note=None)
    loading.add_rest_length(parser)
    given.add_obstacles(parser, "with friction")
    loading.add_recordings(parser, "the file's, else the one in THETA.json, else 0,0,1")
    given.add_file(parser, "--picture", "F.png", "also draw rods and errors over time (default: no)")
    given.add_file(parser, "--recording", "F.rrd", "also record the motion for the viewer (default: no)")
    given.add_file(parser, "--animation", "F.gif|F.webp", "also write a short animation (default: no)")


def run(options: Namespace) -> int:
    out, up = options.out, given.world_up(options)
    if options.tolerance is None:
        given.refuse(options, ("most_substeps",), "given without --tolerance", "give both, or --substeps")
    stated = vars(options) | {"quasi_static": options.quasi_static or None}
    changes = {name: stated[name] for name in OF_STEPPING if stated[name] is not None}
    if Path(options.source).suffix == ".toml":
        found = _scene(options, changes, up)
    else:
        if options.start is not None:  # how observations and their motion were named before
            options.source, options.motion = options.start, options.source
        elif options.motion is None and holds_poses(Path(options.source)):
            raise InputError(options.source, "file", "holds poses of grippers, and no rods", "give observations of the "
                             "rods, and this file as --motion")
        found = _recorded(options, out, changes, up) if options.motion is None else _carried(
            options, moving_rods.simulated_rods(options, out, changes))
    arrays, summary = _results(found, out)
    whole = arrays
    if found.alone:
        arrays = {key: value if key in OF_ALL else value[0] for key, value in arrays.items()}
    results.save_arrays(out, arrays, ("frame",) if found.alone else ("rod", "frame"))
    _draw(found, options.picture, options.recording, options.animation)
    if summary.get("above_tolerance"):
        warn(f"{in_line(options.source)}: the time steps of {counted(summary['above_tolerance'], 'rod')} are off by more than "
             f"--tolerance with {int(found.substeps.max())} of them a frame; give --most-substeps, or more frames a second")
    results.report(options, summary, lambda: _lines(found, summary, whole))
    return 0 if (found.status[:, -1] == Status.CONVERGED).any() else 1


def _recorded(options: Namespace, out: Path, changes: dict, up: np.ndarray) -> _Simulated:
    from doo_ti.dynamics.rollouts import Rollouts

    require(options.theta is not None, given.SOURCE, "--theta", "missing",
            "give the rod: a file that doo-ti identify has written")
    given.refuse(options, (*given.MATERIAL, *LOSSES, *OF_MOTIONS, *CLAMPS, "rest_length"), "given, but the rod is recorded",
                 "leave it out, or give observations with --motion")
    theta, surroundings = given.theta(options), given.surroundings(options)
    motion, = loading.recordings(options, [options.source])
    results.refuse_overwriting(out, options.source)
    require(motion.edges == len(theta.rest_length), options.theta, "rest_length_mm",
            f"{len(theta.rest_length)} edges, {in_line(options.source)} has {motion.edges}", "give the theta of this rod")
    moving_rods.require_length(options.theta, theta, float(motion.edge_lengths().sum()))
    doubts.warn_of_rod(options.source, theta.rest_length, surroundings)
    own_up = up if options.up is not None else motion.up
    theta = theta if own_up is None else replace(theta, up=own_up)
    stepping = Stepping(motion.rate, **changes)
    with progress() as bar:
        task = bar.add_task("simulating", total=motion.count * (motion.positions.shape[1] - 2), unit="rods x frames")
        rollouts = Rollouts.of(motion, theta, stepping, doo_ti.IdentifyOptions.end, surroundings, options.smoothing)
        positions, status, energies, found = rollouts.simulated(
            theta, progress=lambda done: bar.update(task, completed=motion.count * done))
    contact = found.contact_force, found.friction_work, found.touch
    return _Simulated(Path(options.source).stem, list(motion.names), positions, status, motion.rate, theta.up,
                      motion.positions, tuple(motion.glitches()), motion.alone, energies, found.substeps,
                      None if stepping.tolerance is None else found.error, stepping.tolerance, surroundings,
                      _contact(surroundings, found.positions, *contact) if surroundings else {},
                      given.newtons(options, np.full(motion.count, 1.0 - theta.marker_share)), found.end_force)


def _contact(surroundings: Surroundings, positions: np.ndarray, force, work, touch) -> dict[str, np.ndarray]:
    """What is written of contact with ``surroundings``: at every frame forces (R, T, V, 3), smallest gaps and work of friction
    (R, T), and what sticks and slips (R, T, V)."""
    gap = surroundings.smallest_gaps(np.swapaxes(positions, 0, 1)).T
    return {"contact_force": force, "smallest_gap_mm": gap, "friction_work": work, "touch": touch}


def _scene(options: Namespace, changes: dict, up: np.ndarray) -> _Simulated:
    from doo_ti.dynamics.scene import load_motion_scene

    given.refuse(options, ("theta", "fill_gaps", "rate", "smoothing", "free_end", *OF_MOTIONS, *given.MATERIAL, *LOSSES,
                           *CLAMPS, *loading.OF_OBSERVATIONS), "given, but a scene has its own rods", "leave it out")
    scene = load_motion_scene(options.source)
    if scene.stepping is None:
        raise InputError(options.source, "rate_hz", "missing", "give it and duration_s, or the scene to doo-ti predict")
    grippers = scene.grippers
    if options.linear_density is not None and scene.newtons is not None:
        raise InputError(given.SOURCE, "--linear-density", "given, but the scene has it", "leave it out")
    surroundings = given.scene_surroundings(options, scene.surroundings())
    doubts.warn_of_rod(options.source, scene.start.rest_length, surroundings,
                        **loading.stated_in_scene(scene.material, scene.newtons))
    count = scene.material.count
    pairs = np.zeros(count, dtype=np.int64), np.arange(count)
    start, first_force = scene.start, 0.0
    if scene.at_rest:
        if Clamp.FREE == grippers.start and Clamp.FREE == grippers.end:
            raise InputError(options.source, "rod.at_rest", "both ends are free", "let it begin straight, or clamp an end")
        with busy(f"relaxing {count} rods (kernels are compiled once on a machine)"):
            solution = doo_ti.relax(start, scene.material, grippers.at(0), up=up, configuration_index=pairs[0],
                                    material_index=pairs[1], **surroundings.at(0).arguments)
        first_force = 0.0 if solution.contact_force is None else solution.contact_force
        start, pairs = solution.configuration, (np.arange(count), np.arange(count))
    grippers = grippers.take(pairs[0] * 0) if start.count > 1 else grippers
    newtons = given.newtons(options, scene.material.weight) if scene.newtons is None else scene.newtons
    return _carried(options, SimulatedRods(
        scene.name, list(scene.names), start, scene.material, grippers, scene.dynamics, replace(scene.stepping, **changes), up,
        pairs, surroundings, newtons, first_force))


def _carried(options: Namespace, moved: SimulatedRods) -> _Simulated:
    """The rods at all instants."""
    count, instants = len(moved.names), moved.grippers.instants
    stepping = replace(moved.stepping, detailed=True)
    with progress() as bar:
        task = bar.add_task(moved.name, total=count * (instants - 1), unit="rods x frames")
        try:
            found = doo_ti.simulate(moved.start, moved.material, moved.grippers, moved.dynamics, stepping, up=moved.up,
                                    pairs=moved.pairs, progress=lambda done: bar.update(task, completed=count * done),
                                    **moved.surroundings.arguments)
        except InputError as error:
            own = error.field == "obstacles" and options.obstacles is None
            raise InputError(options.source if own else error.source, error.field, error.problem, error.remedy) from None
    positions = np.concatenate([moved.start.vertices[moved.pairs[0]][:, None], found.positions], axis=1)
    status = np.concatenate([np.zeros((count, 1), dtype=np.int8), found.status], axis=1)
    contact = {}
    if moved.surroundings:
        work = np.pad(found.friction_work, ((0, 0), (1, 0)))
        first = np.broadcast_to(moved.first_force, found.contact_force[:, 0].shape)
        force = np.concatenate([first[:, None], found.contact_force], axis=1)
        contact = _contact(moved.surroundings, positions, force, work, np.pad(found.touch, ((0, 0), (1, 0), (0, 0))))
    return _Simulated(moved.name, moved.names, positions, status, stepping.rate, moved.up,
                      energies={} if found.detail is None else found.detail.energies, substeps=found.substeps,
                      step_error=None if stepping.tolerance is None else found.error, tolerance=stepping.tolerance,
                      surroundings=moved.surroundings, contact=contact, newtons=moved.newtons, end_force=found.end_force)


def _results(found: _Simulated, out: Path) -> tuple[dict, dict]:
    arrays = {"positions_mm": found.positions, "status": found.status, "rate_hz": np.float64(found.rate),
              "recording": np.array(found.names), "substeps": found.substeps}
    arrays |= {f"energy_{name}": value for name, value in found.energies.items()} | found.contact
    before = found.positions.shape[1] - found.end_force.shape[1]  # frames at which the motion begins, whose force is not known
    arrays["end_force"] = np.pad(found.end_force, ((0, 0), (before, 0), (0, 0)), constant_values=np.nan)
    arrays = results.in_newton(arrays, None if found.newtons is None else np.broadcast_to(found.newtons, len(found.names)), 0)
    last = found.status[:, -1]
    summary = {"rods": len(found.names), "frames": found.positions.shape[1], "vertices": found.positions.shape[2],
               "status": status_counts(last), "failed": [name for name, value in zip(found.names, last, strict=True) if value],
               "out": str(out)}
    if found.contact:
        gap = found.contact["smallest_gap_mm"].copy()
        if found.recorded is not None:
            gap[:, :2] = np.nan  # as recorded
        summary |= results.contact_summary(found.surroundings, found.contact["contact_force"], gap, found.status)
    if found.energies:
        summary["lost_energy"] = dict(zip(found.names, _lost_share(found.energies, found.positions), strict=True))
    if found.step_error is not None:
        arrays["step_error_mm"] = found.step_error
        used, rods = np.unique(found.substeps, return_counts=True)
        summary |= {"substeps": {str(n): int(rod) for n, rod in zip(used, rods, strict=True)},
                    "above_tolerance": int((~(found.step_error <= found.tolerance)).sum()),
                    "step_error_mm": dict(zip(found.names, found.step_error, strict=True))}
    if found.recorded is not None:
        from doo_ti.dynamics.rollouts import mean_error

        arrays["error_mm"] = mean_error(found.positions, found.recorded)
        each = arrays["error_mm"][:, 2:].mean(axis=1)
        sound = each[np.isfinite(each)]
        summary |= {"error_mm": dict(zip(found.names, each, strict=True)),
                    "mean_error_mm": sound.mean() if len(sound) else np.nan,
                    "median_error_mm": np.median(sound) if len(sound) else np.nan, "glitches": list(found.glitches)}
    return arrays, summary


def _lines(found: _Simulated, summary: dict, arrays: dict) -> list[str]:
    duration, error = (summary["frames"] - 1) / found.rate, found.step_error
    steps = ", ".join(f"{n} for {rods}" for n, rods in summary.get("substeps", {}).items())
    first = found.status.argmax(axis=1)
    infeasible = found.contact and (found.status[np.arange(len(first)), first] == Status.INFEASIBLE).any()
    work, touch = (found.contact[name][:, -1] if found.contact else None for name in ("friction_work", "touch"))
    lost = max(summary.get("lost_energy", {"": 0.0}).values())
    glitches = results.shortened(list(found.glitches), MOST_LISTED, "and {} more")
    return [
        f"{in_line(found.name)}: {counted(summary['rods'], 'rod')} of {summary['vertices'] - 1} edges, {duration:.3g} s at "
        f"{found.rate:g} frames/s", *results.rows(
            ("status", f"{results.status_text(summary['status'])} at the end"),
            ("failed", summary["failed"] and f"{results.listed(summary['failed'], MOST_LISTED)}: no positions from there on"),
            ("infeasible", infeasible and "a gripper holds a rod in an obstacle, or moves it into one by more than its radius "
                                          "in a time step: check their places, or give more --substeps"),
            results.contact_row(summary, len(found.names)), *results.force_rows(arrays, 0),
            ("friction", found.contact and
             f"takes {np.nanmin(work):.3g} to {np.nanmax(work):.3g} mm² in all; at the end {(touch == Touch.STICKS).sum()} "
             f"vertices stick, {(touch == Touch.SLIPS).sum()} slip"),
            ("energy", lost > NOTABLE and f"the time steps lose up to {100 * lost:.0f} % of what a rod had, took or gave, as a "
                       "damping does: --tolerance says what that is in mm"),
            ("time steps", error is not None and
             f"{steps} rods a frame; estimated error: median {np.median(error):.3g}, largest {error.max():.3g} mm, above the "
             f"tolerance in {summary['above_tolerance']} rods"),
            ("error", found.recorded is not None and
             f"mean {summary['mean_error_mm']:.4g} mm, median {summary['median_error_mm']:.4g} mm over recordings (mean "
             "|difference| over markers and coordinates, grippers' included)"),
            *(("glitch", in_line(line)) for line in glitches))]


def _lost_share(energies: dict[str, np.ndarray], positions: np.ndarray) -> np.ndarray:
    """(R,) the largest energy unaccounted for, mostly lost by the time steps, over the largest that a rod had, took or gave;
    zero for rods that are still, at ``positions`` (R, T, V, 3)."""
    each = [energies[name] for name in ("kinetic", "work", "dissipated")] + [energies["sum"] - energies["kinetic"]]
    exchanged = np.max([np.nanmax(value, axis=1) - np.nanmin(value, axis=1) for value in each], axis=0)
    moved = np.nanmax(np.linalg.norm(positions - positions[:, :1], axis=-1), axis=(1, 2))
    moves = moved > STILL * np.linalg.norm(np.diff(positions[:, 0], axis=1), axis=-1).sum(axis=1)
    return moves * np.nanmax(np.abs(energies["unaccounted"]), axis=1) / np.maximum(exchanged, np.finfo(float).tiny)


def _draw(found: _Simulated, picture: Path | None, recording: Path | None, animation: Path | None) -> None:
    if not (picture or recording or animation):
        return
    from doo_ti.report.contact import Touched
    from doo_ti.report.motions import save_animation, save_rollout

    touched = None
    if found.contact:
        touched = Touched(found.surroundings, found.positions, found.contact["contact_force"], found.newtons)
    energies = {name: found.energies[name] for name in SPLIT} if found.energies else None
    rods = found.name, found.names, found.positions, found.recorded, found.rate, found.up
    if picture is not None:
        save_rollout(picture, *rods, energies, touched)
    if animation is not None:
        with busy("drawing the animation"):
            save_animation(animation, *rods, touched)
    if recording is not None:
        from doo_ti.record.motions import record_rollout

        record_rollout(recording, *rods, energies, touched)
