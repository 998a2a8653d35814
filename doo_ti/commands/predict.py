"""Where rods go when their clamps are moved (§III-D)."""

import hashlib
from argparse import Namespace
from dataclasses import replace
from pathlib import Path

import numpy as np

import doo_ti
from doo_ti.commands import doubts, given, loading, results
from doo_ti.commands.moving_rods import OF_MOTIONS, HeldRods, add_motion, check_reach, held_rods, warn_of, warn_of_start
from doo_ti.dynamics.parameters import LEAST_WAY, Dynamics, Stepping
from doo_ti.io.scene import PRECISIONS
from doo_ti.io.toml_file import scene_file
from doo_ti.learning.landscape import status_counts
from doo_ti.rod.frames import matrix_from_quaternion
from doo_ti.rod.material import STANDARD_GRAVITY
from doo_ti.rod.types import Clamp, Configuration, Status
from doo_ti.system.arguments import counted
from doo_ti.system.errors import require
from doo_ti.system.terminal import progress

MOST_LISTED = 30
DEGREES = given.number("a number of degrees from 0.001 to 30", lambda degrees: 1e-3 <= degrees <= 30)
"""Of a sub-step: rods that are carried further at once may leave their branch; smaller steps make no difference."""
MOST_STEPS = 1000  # with friction, from one state to the next
MOST_BYTES = 8 << 30  # of frames: predictions are held in memory
MESHES = 200  # states, of all rods and moments, whose mesh error is computed
NOTABLE, APART = 0.1, 0.1  # of gravity: accelerations that are said; s between the places that they are from, noise apart


def declare(add) -> None:
    parser = given.command(add, "predict", run, "predict the shapes of rods whose clamps move (§III-D)")
    parser.add_argument("source", metavar="OBS|SCENE.toml", type=scene_file,
                        help=f"observations the rods start from: {loading.FORMATS}; or a scene of motion")
    given.add_out(parser, "F.npz|F.csv")
    given.add_material(parser, "a number or LO:HI:N[:log|:lin]: all materials of the grid at once", given.SHAPE_ONLY,
                       "for --EI, --GJ and forces in N")
    add_motion(parser)
    given.add(parser, "--steps-between", "N", given.COUNT, "predicted steps from one moment of the motion to the next "
              "(default: 1, or the scene's)", dest="between")
    given.add_old_name(parser, "--between", "between")
    given.add(parser, "--sub-step", "DEG", DEGREES, "largest rotation of a clamp in one sub-step; rods are relaxed after "
              "each", 5.0)
    given.add_clamps(parser)
    loading.add_loading(parser, "OBS and PATH")
    given.add_obstacles(parser, "with friction, where an obstacle has any, from one step to the next")
    given.add(parser, "--precision", None, PRECISIONS, "floating-point arithmetic of the stored steps", "mixed")
    given.add_file(parser, "--picture", "F.png", "also draw the motion (default: no)")
    given.add_file(parser, "--recording", "F.rrd", "also record it for the viewer (default: no)")


def run(options: Namespace) -> int:
    out, between, sub_step = options.out, options.between, np.radians(options.sub_step)
    if Path(options.source).suffix == ".toml":
        rods, between = _scene(options, between)
    else:
        rods, between = held_rods(options, out, given.clamps(options)), between or 1
        warn_of(rods, options)
    stepping = _stepping(rods, between, sub_step)
    count, intervals = len(rods.names), (rods.path.moments - 1) * between
    require(count * intervals * rods.start.edges * 32 <= MOST_BYTES, given.SOURCE, "--steps-between",
            f"{count} rods at {intervals + 1} moments are too many to hold", "give fewer materials, observations or moments")

    with progress() as bar:
        shown = bar.add_task(rods.name, total=count * intervals, unit="rods x moments")
        moved = rods.start, rods.material, rods.clamps, rods.path
        chosen = {"between": between, "up": rods.up, "advance": lambda done: bar.advance(shown, done),
                  **rods.surroundings.arguments}
        if stepping is None:
            prediction = doo_ti.predict(*moved, sub_step=sub_step, precision=options.precision, **chosen)
        else:
            prediction = doo_ti.predict_moving(*moved, Dynamics(density=1.0), stepping, **chosen)
    if rods.observations is not None:
        warn_of_start(rods, prediction.at(0))
    result = _arrays(rods, prediction)
    results.save_arrays(out, result, ("moment", "rod"))
    summary = _summary(rods, prediction, result, out)
    if stepping is None:
        summary |= _mesh_summary(rods, prediction)
    lines = _lines(rods, stepping, prediction, result, summary)
    if options.picture or options.recording:
        _draw(rods, prediction, result, options.picture, options.recording, lines)
    loaded = [] if rods.observations is None else [loading.rod_line(rods.observations)]
    results.report(options, summary, lambda: lines + loaded)
    return 0 if prediction.followed[-1].any() else 1


def _stepping(rods: HeldRods, between: int, sub_step: float):
    """Quasi-static Stepping where an obstacle has friction, which depends on the step before, or moves: as many steps between
    the returned states as its motion and that of the clamps need. Else None."""
    around, path = rods.surroundings, rods.path
    if not (around.rub or around.moves):
        return None
    from doo_ti.dynamics.grippers import needed_substeps
    from doo_ti.motion.path import motion_between

    parts = [motion_between(path.at(k, rods.clamps), path.at(k + 1, rods.clamps), path.rotation(k, rods.clamps.count))
             for k in range(path.moments - 1)]
    needed = max(np.maximum(part.needed_steps(rods.start.rest_length, sub_step),
                            around.steps_for(part.start_shift)).max() for part in parts) / between
    # Obstacles are measured along straight ways between the states; the cubics of substeps may be steeper.
    needed = max(needed, 2 * needed_substeps(around, LEAST_WAY, rods.start))
    return Stepping(1.0, int(np.clip(np.ceil(needed), 1, MOST_STEPS)), "euler", quasi_static=True)


def _scene(options: Namespace, between: int | None) -> tuple[HeldRods, int]:
    """The rods of a scene, and how many states there are from one moment to the next."""
    from doo_ti.dynamics.scene import load_motion_scene

    given.refuse(options, (*OF_MOTIONS, "theta", *given.MATERIAL, "linear_density", "clamp_start", "clamp_end",
                           *loading.OF_OBSERVATIONS), "given, but the scene has it", "leave it out, or give observations")
    scene = load_motion_scene(options.source)
    theta = {"material_name": np.array(scene.names), "bend": scene.material.bend[:, 0], "twist": scene.material.twist[:, 0],
             "weight": scene.material.weight}
    path = scene.path
    check_reach(path, scene.clamps, float(scene.start.rest_length.sum()))
    between = scene.between if between is None else between
    surroundings = given.scene_surroundings(options, scene.surroundings(between))
    doubts.warn_of_rod(options.source, scene.start.rest_length, surroundings,
                        **loading.stated_in_scene(scene.material, scene.newtons))
    return HeldRods(scene.name, list(scene.names), scene.start, scene.clamps, path, scene.material, theta, scene.newtons,
                    given.world_up(options), surroundings), between


def _arrays(rods: HeldRods, prediction) -> dict[str, np.ndarray]:
    """What the file holds; docs/commands/predict.md."""
    per_material = {name: np.asarray(value)[prediction.material] for name, value in rods.theta.items()}
    if rods.surroundings:
        per_material |= {"contact_force": prediction.contact_force,
                         "smallest_gap_mm": rods.surroundings.smallest_gaps(prediction.vertices)}
    start_force = results.start_force(rods.material.take(prediction.material), prediction.rest_length, rods.up,
                                      prediction.status, prediction.end_force, prediction.contact_force)
    return results.in_newton({
        "time_s": prediction.time, "vertices_mm": prediction.vertices, "energy": prediction.energy, "status": prediction.status,
        "stable": prediction.stable, "followed": prediction.followed, "jumps": prediction.jumps,
        "iterations": prediction.iterations, "residual": prediction.residual, "start_force": start_force,
        "end_force": prediction.end_force,
        "total_twist_deg": np.degrees(prediction.total_twist), "end_rotation_deg": np.degrees(prediction.end_rotation),
        "observation": prediction.motion, "rest_length_mm": prediction.rest_length, **per_material,
    }, rods.newtons, 1)


def _mesh_summary(rods: HeldRods, prediction) -> dict:
    """:func:`doo_ti.commands.results.mesh_summary` of all states that were followed, or of as many evenly from the first to the
    last."""
    moment, rod = np.nonzero(prediction.followed)
    if not len(rod):
        return {}
    some = np.linspace(0, len(rod) - 1, min(len(rod), MESHES)).round().astype(np.int64)
    moment, rod = moment[some], rod[some]
    motion = prediction.motion[rod]
    states = Configuration(prediction.start[moment, rod], prediction.quaternions[moment, rod], prediction.rest_length)
    places, frames = states.vertices, states.frames
    held = replace(rods.clamps.take(motion), start_position=places[:, 0], start_frame=frames[:, 0],
                   end_position=places[:, -1], end_frame=frames[:, -1])
    return results.mesh_summary(states, rods.material.take(prediction.material[rod]), held, rods.up,
                                rods.surroundings.at(0).take(motion))


def _lines(rods: HeldRods, stepping, prediction, result: dict, summary: dict) -> list[str]:
    """The result as lines of text."""
    count, moments, falls = summary["rods"], summary["moments"], summary["falls"]
    lost = np.flatnonzero(~prediction.followed[-1])
    # What of rods that fail where their motion begins is inside an obstacle.
    failed = np.flatnonzero(prediction.status[0] != Status.CONVERGED)
    motion = prediction.motion[failed]
    start = rods.start.take(motion if rods.start.count == rods.clamps.count else failed)
    inside = results.inside_reason(rods.surroundings.at(0).take(motion), rods.path.at(0, rods.clamps).take(motion), start,
                                   failed)
    how = f"{summary['stable']} of {count * moments} certified stable"
    if stepping is not None:
        how = f"{stepping.substeps} quasi-static steps between states"
    where = "all stayed on their branch" + ", as far as they were followed" * bool(len(lost))
    if falls:
        where = f"to another branch, {len({fall['rod'] for fall in falls})} of {count} rods"
    return [
        f"{rods.name}: {counted(count, 'rod')} of {summary['edges']} edges at {moments} moments",
        *results.rows(
            ("status", f"{results.status_text(summary['status'])}; {how}"), *results.mesh_rows(summary),
            results.contact_row(summary, count), ("infeasible", inside), *results.force_rows(result, 1),
            ("inertia", (swift := _acceleration(prediction)) > NOTABLE and f"left out; rods accelerate by up to {swift:.2g} "
                        "of gravity: simulate has it"),
            ("far clamp", f"at the end turned about the rod by {_range(summary['end_rotation_deg'])}, total twist "
                          f"{_range(summary['total_twist_deg'])}"),
            ("jumps", stepping is None and f"{int(prediction.jumps.sum())}, {where}")),
        *results.shortened([
            f"    {fall['name']}: between {fall['from_s']:g} and {fall['to_s']:g} s; the far clamp is then turned about the "
            f"rod by {fall['end_rotation_deg']:.1f}°" for fall in falls], MOST_LISTED, "    and {} more"),
        *results.rows(("lost", len(lost) and f"{len(lost)} of {count} rods cannot follow the motion to its end")),
        *results.shortened([
            f"    {rods.names[rod]}: no prediction from {prediction.time[int(np.argmin(prediction.followed[:, rod]))]:g} s on"
            for rod in lost], MOST_LISTED, "    and {} more")]


def _acceleration(prediction) -> float:
    """The largest acceleration of a vertex over gravity's, of rods that do not jump, from places :data:`APART` s apart."""
    time = prediction.time
    apart = max(1, int(np.ceil(APART / np.diff(time).max()))) if len(time) > 1 else 1
    places, steps = prediction.vertices[::apart, ~prediction.jumps.any(axis=0)], np.diff(time[::apart])
    if len(steps) < 2:
        return 0.0
    speed = np.diff(places, axis=0) / steps[:, None, None, None]
    rates = 2.0 * np.linalg.norm(np.diff(speed, axis=0), axis=-1) / (steps[1:] + steps[:-1])[:, None, None]
    return float(np.nanmax(rates, initial=0.0) / (1e3 * STANDARD_GRAVITY))


def _range(degrees: np.ndarray) -> str:
    finite = degrees[np.isfinite(degrees)]
    if not len(finite):
        return "unknown"
    return " to ".join(dict.fromkeys(f"{round(value, 1) + 0.0:.1f}°" for value in (finite.min(), finite.max())))


def _summary(rods: HeldRods, prediction, result: dict, out: Path) -> dict:
    falls = [{"rod": int(rod), "name": rods.names[rod], "from_s": prediction.time[max(moment - 1, 0)],
              "to_s": prediction.time[moment], "end_rotation_deg": result["end_rotation_deg"][moment, rod]}
             for moment, rod in np.argwhere(prediction.jumps > 0)]
    contact = {}
    if rods.surroundings:
        contact = results.contact_summary(rods.surroundings, *(np.swapaxes(value, 0, 1) for value in (
            result["contact_force"], result["smallest_gap_mm"], prediction.status)))
    return {
        "rods": len(rods.names), "moments": len(prediction.time), "edges": rods.start.edges,
        "status": status_counts(prediction.status), "stable": int(prediction.stable.sum()),
        "followed": int(prediction.followed[-1].sum()), "falls": falls, "end_rotation_deg": result["end_rotation_deg"][-1],
        "total_twist_deg": result["total_twist_deg"][-1], "out": str(out), **contact}


def _draw(rods: HeldRods, prediction, arrays: dict[str, np.ndarray], picture: Path | None, recording: Path | None,
          lines: list[str]) -> None:
    """Write the picture and the recording that are asked for, of the file's ``arrays``; ``lines`` are the result as text."""
    from doo_ti.report.contact import Touched
    from doo_ti.report.motions import MovingRods, motions_picture

    seen = rods.observations
    marks = None if seen is None else np.where(seen.valid[..., None], seen.vertices, np.nan)[prediction.motion]
    touched = None if not rods.surroundings else Touched(rods.surroundings, *(
        np.swapaxes(arrays[name], 0, 1) for name in ("vertices_mm", "contact_force")), rods.newtons)
    moving = MovingRods(prediction.time, arrays["vertices_mm"], rods.names, prediction.jumps, prediction.followed, rods.up,
                        _gripper_lines(rods, prediction, arrays["vertices_mm"]), marks, touched)
    if picture is not None:
        motions_picture(picture, moving, title=rods.name)
    if recording is not None:
        from doo_ti.record.motions import record_motion

        force, unit = ("end_force_N", "N") if "end_force_N" in arrays else ("end_force", "mm")
        curves = {"Energy [mm²]": prediction.energy, "Total twist [°]": arrays["total_twist_deg"],
                  f"Force at the far clamp [{unit}]": np.linalg.norm(arrays[force], axis=-1)}
        record_motion(recording, run_id=hashlib.sha256(moving.vertices.tobytes()).hexdigest()[:32], name=rods.name,
                      rods=moving, curves=curves, text="\n\n".join(line.strip() for line in lines))


def _gripper_lines(rods: HeldRods, prediction, vertices: np.ndarray) -> np.ndarray:
    """(T, R, 4, 2, 3) mm: at each end the edge that is held, and a bar across it along m1; NaN where an end is free."""
    lines = np.full((*vertices.shape[:2], 4, 2, 3), np.nan)
    half = 0.02 * prediction.rest_length.sum()
    for first, edge, kind in ((0, 0, rods.clamps.start), (2, -1, rods.clamps.end)):
        held = np.broadcast_to(np.asarray(kind) > Clamp.FREE, rods.clamps.count)[prediction.motion]
        place = vertices[:, :, edge]
        across = half * matrix_from_quaternion(prediction.quaternions[:, :, edge])[..., 1]
        lines[:, held, first] = vertices[:, held][:, :, (0, 1) if edge == 0 else (-2, -1)]
        lines[:, held, first + 1] = np.stack([place - across, place + across], axis=2)[:, held]
    return lines
