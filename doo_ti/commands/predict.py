"""Where rods go when their clamps are moved (§III-D)."""

from argparse import Namespace
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from doo_ti.commands import loading
from doo_ti.commands import options as given
from doo_ti.commands.drawn_predictions import draw_prediction
from doo_ti.commands.moving_rods import (
    add_dynamic,
    curved,
    is_dynamic,
    losses,
    rubbed,
    step_lines,
    step_summary,
    stepping,
)
from doo_ti.commands.results import (
    RODS,
    contact_lines,
    contact_summary,
    counted,
    force_lines,
    in_newton,
    report,
    save_arrays,
    shortened,
)
from doo_ti.commands.starting_rods import settled, with_frames
from doo_ti.contact.surroundings import Surroundings
from doo_ti.io.motion_file import ClampPath
from doo_ti.io.scene import PRECISIONS
from doo_ti.io.toml_file import scene_file
from doo_ti.learning.landscape import status_counts
from doo_ti.rod.frames import matrix_from_quaternion, smallest_rotation
from doo_ti.rod.physical_units import UNITS_IN_MM
from doo_ti.rod.start import check_experiment, observation_clamps
from doo_ti.rod.types import Clamps, Configuration, Material, unit_up
from doo_ti.system.errors import InputError
from doo_ti.system.terminal import in_line, progress, warn

MOST_LISTED = 30
LEAST_DEGREES, MOST_DEGREES = 1e-3, 30.0
"""Of a sub-step: rods that are carried further at once may leave their branch; smaller steps make no difference."""
MOST_LENGTHS = 100.0
"""Of a rod, between its clamps."""
MOST_STEPS = 1000
"""With friction, from one state to the next."""
SAME_RATE = 1e-3
"""By which the rate that is given may differ from that of the motion's times."""
FAR_OFF = 0.05
"""Of the rod's length, from a clamp to where its motion begins: more is no error of measurement."""
MOST_BYTES = 8 << 30
"""Of frames: predictions are held in memory."""


@dataclass(frozen=True)
class _Task:
    """What to predict: N starts of rods, clamps and motions, or one for all, under G materials.

    names  R of the rods, material by material
    theta  columns of the file that state the G materials
    marks  (N, V, 3) mm, observed; None where nothing was
    loaded, labels  lines about the observations, and (N,) what the file calls them
    newtons  (R,) N in the unit of force, or None
    """

    name: str
    start: Configuration
    clamps: Clamps
    path: ClampPath
    material: Material
    names: list[str]
    theta: dict[str, np.ndarray]
    between: int
    up: np.ndarray
    marks: np.ndarray | None = None
    dynamics: object = None  # Dynamics of rods with inertia
    stepping: object = None  # Stepping, with them, or quasi-static for friction
    loaded: tuple[str, ...] = ()
    labels: np.ndarray | None = None
    newtons: np.ndarray | None = None
    surroundings: Surroundings = Surroundings()


def declare(add) -> None:
    parser = given.command(add, "predict", run, "predict the shapes of rods whose clamps move (§III-D)")
    parser.add_argument("source", metavar="OBS|SCENE.toml", type=scene_file,
                        help=f"observations the rods start from: {loading.FORMATS}; or a scene of motion")
    parser.add_argument("--motion", metavar="PATH", help="poses of the clamps over time: .npz, or .csv such as a robot's log")
    parser.add_argument("--out", required=True, metavar="F.npz|F.csv", help="file to write")
    given.add_material(parser, "a number or LO:HI:N[:log|:lin]: all materials of the grid at once", given.SHAPE_ONLY,
                       "for --EI, --GJ and forces in N")
    parser.add_argument("--relative", action="store_true",
                        help="apply the motion relative to each observation's own clamps, instead of as absolute poses")
    parser.add_argument("--steps-between", dest="between", metavar="N",
                        help="predicted steps from one moment of the motion to the next (default: 1, or the scene's)")
    given.add_old_name(parser, "--between", "between")
    parser.add_argument("--sub-step", metavar="DEG",
                        help="largest rotation of a clamp in one sub-step; rods are relaxed after each (default 5)")
    given.add_clamps(parser)
    loading.add_loading(parser, "OBS and PATH")
    group = parser.add_argument_group("the motion's file", "docs/motions.md")
    loading.add_poses(group, "--motion")
    group.add_argument("--motion-unit", choices=tuple(UNITS_IN_MM), help="unit of all lengths in PATH (default: --unit, else "
                       "as its columns state, else mm)")
    group.add_argument("--motion-up", metavar="X,Y,Z", help="direction against gravity in PATH, which is turned about the "
                       "origin so that it becomes that of OBS (default: both have the same coordinates)")
    add_dynamic(parser, "moments of the motion per second (default: by its times)")
    given.add_obstacles(parser, "with friction, where an obstacle has any, from one step to the next")
    parser.add_argument("--precision", choices=PRECISIONS, default="mixed",
                        help="floating-point arithmetic of the stored steps (default mixed)")
    parser.add_argument("--picture", metavar="F.png", help="also draw the motion (default: no)")
    parser.add_argument("--recording", metavar="F.rrd", help="also record it for the viewer (default: no)")


def run(options: Namespace, words: list[str]) -> int:
    """Carry all rods along the motion; writes them at its moments and prints where they jumped."""
    out = given.output_file(options.out, RODS)
    pictures = {suffix: None if text is None else given.output_file(text, suffix, option)
                for suffix, text, option in (
                    (".png", options.picture, "--picture"), (".rrd", options.recording, "--recording"))}
    between = given.whole("--steps-between", options.between, 1)
    sub_step = _sub_step(options)
    task = _scene(options, between) if Path(options.source).suffix == ".toml" else _observed(options, out, between)
    task = _with_inertia(options, task) if is_dynamic(options) else _with_history(task, sub_step)
    rods, intervals = len(task.names), (task.path.moments - 1) * task.between
    if rods * intervals * task.start.edges * 32 > MOST_BYTES:
        raise InputError(given.SOURCE, "--steps-between", f"{rods} rods at {intervals + 1} moments are too many to hold",
                         "give fewer materials, observations or moments")
    if task.marks is not None and not options.relative:
        _warn_of_distance(task.path, task.clamps, float(task.start.rest_length.sum()), task.labels)

    with progress() as bar:
        shown = bar.add_task(task.name, total=rods * intervals, unit="rods x moments")
        prediction = _predicted(task, sub_step, options.precision, lambda done: bar.advance(shown, done))
    result = _arrays(task, prediction)
    for path in filter(None, pictures.values()):
        path.parent.mkdir(parents=True, exist_ok=True)
    save_arrays(out, result, ("moment", "rod"))
    if any(pictures.values()):
        draw_prediction(task, prediction, result, pictures, _lines(task, prediction, result))
    report(options, _summary(task, prediction, result, out),
           lambda: [*_lines(task, prediction, result), *task.loaded, f"  written to {in_line(out)}"])
    return 0 if prediction.followed[-1].any() else 1


def _predicted(task: _Task, sub_step: float, precision: str, advance):
    inputs = {"between": task.between, "up": task.up, "advance": advance, **task.surroundings.arguments}
    if task.dynamics is not None:
        from doo_ti.prediction.moving import predict_moving

        return predict_moving(task.start, task.material, task.clamps, task.path, task.dynamics, task.stepping, **inputs)
    from doo_ti.prediction.predict import predict

    return predict(task.start, task.material, task.clamps, task.path, sub_step=sub_step, precision=precision, **inputs)


def _with_inertia(options: Namespace, task: _Task) -> _Task:
    """The task for rods with inertia. Raises InputError where neither times nor --rate say how fast the motion is."""
    from doo_ti.prediction.moving import rate_of

    rate = given.positive("--rate", options.rate, "moments per second")
    if task.path.timed:
        own = rate_of(task.path)
        if rate is not None and abs(rate - own) > SAME_RATE * own:
            raise InputError(given.SOURCE, "--rate", f"{rate:g} moments per second, and the motion's own times say {own:g}",
                             "leave --rate out; --steps-between gives more states")
        rate = own
    if rate is None:
        raise InputError(given.SOURCE, "--rate", "missing, and the motion has no times", "give its moments per second")
    options.theta_note = given.EVERYTHING
    return replace(task, dynamics=losses(options), stepping=stepping(options, rate))


def _with_history(task: _Task, sub_step: float) -> _Task:
    """The task in quasi-static steps where an obstacle has friction, which depends on the step before, or moves: as many
    between the returned states as its motion and that of the clamps need."""
    if not (task.surroundings.rub or task.surroundings.moves):
        return task
    from doo_ti.dynamics.obstacle_path import needed_substeps
    from doo_ti.dynamics.parameters import LEAST_WAY, Dynamics, Stepping
    from doo_ti.motion.path import motion_between

    motions = len(task.clamps.start_position)
    parts = [motion_between(task.path.at(k, task.clamps), task.path.at(k + 1, task.clamps), task.path.rotation(k, motions))
             for k in range(task.path.moments - 1)]
    needed = max(np.maximum(part.needed_steps(task.start.rest_length, sub_step),
                            task.surroundings.steps_for(part.start_shift)).max() for part in parts) / task.between
    # Obstacles are measured along straight ways between the states; the cubics of substeps may be steeper.
    needed = max(needed, 2 * needed_substeps(task.surroundings, LEAST_WAY, task.start))
    stepping = Stepping(1.0, int(np.clip(np.ceil(needed), 1, MOST_STEPS)), "euler", quasi_static=True)
    return replace(task, dynamics=Dynamics(density=1.0), stepping=stepping)


def _sub_step(options: Namespace) -> float:
    """The largest turn of a sub-step, rad."""
    given_degrees = given.numbers("--sub-step", options.sub_step) or (5.0,)
    if len(given_degrees) > 1 or not LEAST_DEGREES <= given_degrees[0] <= MOST_DEGREES:
        raise InputError(given.SOURCE, "--sub-step", f"{options.sub_step!r} is out of range",
                         f"give one number of degrees from {LEAST_DEGREES:g} to {MOST_DEGREES:g}")
    return np.radians(given_degrees[0])


def _scene(options: Namespace, between: int | None) -> _Task:
    from doo_ti.contact.obstacle_file import obstacles_of
    from doo_ti.io.motion_scene import load_motion_scene

    for name in ("motion", "motion_unit", "motion_up", "motion_columns", "theta", *given.MATERIAL, "linear_density",
                 "clamp_start", "clamp_end", *loading.OF_OBSERVATIONS):
        if getattr(options, name) is not None:
            raise InputError(given.SOURCE, f"--{name.replace('_', '-')}", "given, but the scene has it",
                             "leave it out, or give observations")
    if options.relative:
        raise InputError(given.SOURCE, "--relative", "given, but a scene has absolute poses", "leave it out")
    scene, up = load_motion_scene(options.source), given.up(options)
    theta = {"material_name": np.array(scene.names), "bend": scene.material.bend[:, 0], "twist": scene.material.twist[:, 0],
             "weight": scene.material.weight}
    _check_reach(scene.path, scene.clamps, float(scene.start.rest_length.sum()))
    between = scene.between if between is None else between
    own = Surroundings(obstacles_of(scene.source, scene.obstacles, scene.path.states(between)), scene.radius)
    return _Task(scene.name, scene.start, scene.clamps, scene.path, scene.material, list(scene.names), theta, between,
                 np.array([0.0, 0.0, 1.0]) if up is None else up, surroundings=given.scene_surroundings(options, own),
                 newtons=scene.newtons)


def _observed(options: Namespace, out: Path, between: int | None) -> _Task:
    if options.motion is None:
        raise InputError(given.SOURCE, "--motion", "missing", "name a file of poses, or give a scene of motion")
    grid, surroundings = given.grid(options), rubbed(options, given.surroundings(options))
    observations = loading.load(options, options.source)
    for source in (options.source, options.motion):
        given.refuse_overwriting(out, source)
    path = loading.poses(options, options.motion, options.motion_unit or options.unit, _turn(options, observations.up))
    observations = with_frames(observations, path, options.relative)
    if path.count not in (1, observations.count) and observations.count > 1:
        raise InputError(options.motion, "positions_mm", f"{path.count} motions for {observations.count} observations",
                         "give one motion, or one for each observation")
    if observations.count < path.count:
        observations = observations.take(np.zeros(path.count, dtype=np.int64))
    clamps = observation_clamps(observations, *given.clamps(options))
    check_experiment(observations, clamps, grid.axes[-1].values[-1], 0.0)
    path = path.relative_to(clamps) if options.relative else path
    loading.warn(observations)
    _check_reach(path, clamps, float(observations.rest_length.sum()))
    materials = curved(options, grid.materials(), observations.rest_length, options.dynamic)
    start, newtons = settled(observations, clamps, materials, surroundings), given.newtons(options, materials.weight)
    cells, rows = np.divmod(np.arange(materials.count * observations.count), observations.count)
    names = [f"cell {cell}, " * (materials.count > 1) + f"observation {observations.labels[row]}"
             for cell, row in zip(cells, rows, strict=True)]
    return _Task(observations.name, start, clamps, path, materials, names, grid.cell_values(), between or 1, observations.up,
                 np.where(observations.valid[..., None], observations.vertices, np.nan),
                 loaded=(loading.rod_line(observations),), labels=observations.labels, surroundings=surroundings,
                 newtons=None if newtons is None else np.repeat(newtons, observations.count))


def _turn(options: Namespace, up: np.ndarray) -> np.ndarray | None:
    """(3, 3) from the coordinates of the motion to those of the observations, whose direction against gravity is ``up``."""
    if options.motion_up is None:
        return None
    own = unit_up(given.numbers("--motion-up", options.motion_up), given.SOURCE)
    return matrix_from_quaternion(smallest_rotation(own, up))


def _check_reach(path: ClampPath, clamps: Clamps, length: float) -> None:
    """Raise InputError where clamps are further apart at a moment than :data:`MOST_LENGTHS` of the rod: positions in another
    unit, not a rod that is too short."""
    for moment in range(path.moments):
        held = path.at(moment, clamps)
        apart = np.linalg.norm(held.end_position - held.start_position, axis=-1).max()
        if apart > MOST_LENGTHS * length:
            raise InputError(path.source, f"moment {moment}", f"the clamps are {apart:.4g} mm apart, and the rod "
                             f"{length:.4g} mm long", "correct the positions")


def _warn_of_distance(path: ClampPath, clamps: Clamps, length: float, labels: np.ndarray) -> None:
    """Print a warning where the path begins farther from the clamps than :data:`FAR_OFF` of the rod: displacements, perhaps, or
    the path of another rod."""
    first = path.at(0, clamps)
    for name in ("start_position", "end_position"):
        off = np.linalg.norm(getattr(first, name) - getattr(clamps, name), axis=-1)
        if off.max() > FAR_OFF * length:
            warn(f"{path.source}: {name}_mm: the motion begins {off.max():.4g} mm from the clamp of observation "
                 f"{labels[off.argmax()]}; give --relative where these are displacements")
            return


def _arrays(task: _Task, prediction) -> dict[str, np.ndarray]:
    """What the file holds; docs/commands/predict.md."""
    per_material = {name: np.asarray(value)[prediction.material] for name, value in task.theta.items()}
    if task.surroundings:
        per_material |= {"contact_force": prediction.contact_force,
                         "smallest_gap_mm": task.surroundings.smallest_gaps(prediction.vertices)}
    return in_newton({
        "time_s": prediction.time, "vertices_mm": prediction.vertices, "energy": prediction.energy, "status": prediction.status,
        "stable": prediction.stable, "followed": prediction.followed, "jumps": prediction.jumps,
        "iterations": prediction.iterations, "residual": prediction.residual, "end_force": prediction.end_force,
        "total_twist_deg": np.degrees(prediction.total_twist), "end_rotation_deg": np.degrees(prediction.end_rotation),
        "observation": prediction.motion, "rest_length_mm": prediction.rest_length, **per_material,
        **({} if prediction.step_error is None else {"substeps": prediction.substeps, "step_error_mm": prediction.step_error}),
    }, task.newtons, 1)


def _lines(task: _Task, prediction, result: dict) -> list[str]:
    """The result as lines of text."""
    count, moments = len(task.names), len(prediction.time)
    jumps = np.argwhere(prediction.jumps > 0)
    lost = np.flatnonzero(~prediction.followed[-1])
    how = f"{int(prediction.stable.sum())} of {count * moments} certified stable"
    if task.dynamics is not None:
        how = (f"{task.stepping.substeps} quasi-static steps between states" if task.stepping.quasi_static else
               f"with inertia, {task.stepping.rate * task.between:.4g} states/s")
    lines = [f"{task.name}: {count} rod{'s' * (count > 1)} of {task.start.edges} edges at {moments} moments",
             f"  status      {counted(status_counts(prediction.status))}; {how}",
             *contact_lines(_contact(task, prediction, result), count), *force_lines(result, 1),
             *step_lines(_steps(task, prediction), "from one state to the next"),
             f"  far clamp   at the end turned about the rod by {_range(result['end_rotation_deg'][-1])}, total twist "
             f"{_range(result['total_twist_deg'][-1])}"]
    rods = f"to another branch, {len(np.unique(jumps[:, 1]))} of {count} rods" if len(jumps) else "all stayed on their branch"
    if task.dynamics is None:
        lines.append(f"  jumps       {int(prediction.jumps.sum())}, {rods}")
    lines += shortened([
        f"    {task.names[rod]}: between {prediction.time[max(moment - 1, 0)]:g} and {prediction.time[moment]:g} s, far clamp "
        f"turned by {result['end_rotation_deg'][moment, rod]:.1f}°" for moment, rod in jumps], MOST_LISTED, "    and {} more")
    if len(lost):
        lines.append(f"  lost        {len(lost)} of {count} rods cannot follow the motion to its end")
    return lines + shortened([
        f"    {task.names[rod]}: no prediction from {prediction.time[int(np.argmin(prediction.followed[:, rod]))]:g} s on"
        for rod in lost], MOST_LISTED, "    and {} more")


def _contact(task: _Task, prediction, result: dict) -> dict:
    if not task.surroundings:
        return {}
    return contact_summary(task.surroundings, *(np.swapaxes(value, 0, 1) for value in (
        result["contact_force"], result["smallest_gap_mm"], prediction.status)))


def _steps(task: _Task, prediction) -> dict:
    if prediction.step_error is None:
        return {}
    return step_summary(task.names, prediction.substeps, prediction.step_error, task.stepping.tolerance)


def _range(degrees: np.ndarray) -> str:
    finite = degrees[np.isfinite(degrees)]
    if not len(finite):
        return "unknown"
    return " to ".join(dict.fromkeys(f"{round(value, 1) + 0.0:.1f}°" for value in (finite.min(), finite.max())))


def _summary(task: _Task, prediction, result: dict, out: Path) -> dict:
    falls = [{"rod": int(rod), "name": task.names[rod], "from_s": prediction.time[max(moment - 1, 0)],
              "to_s": prediction.time[moment], "end_rotation_deg": result["end_rotation_deg"][moment, rod]}
             for moment, rod in np.argwhere(prediction.jumps > 0)]
    return {
        "rods": len(task.names), "moments": len(prediction.time), "edges": task.start.edges,
        "status": status_counts(prediction.status), "stable": int(prediction.stable.sum()),
        "followed": int(prediction.followed[-1].sum()), "falls": falls, "end_rotation_deg": result["end_rotation_deg"][-1],
        "total_twist_deg": result["total_twist_deg"][-1], "out": str(out), **_contact(task, prediction, result),
        **_steps(task, prediction)}
