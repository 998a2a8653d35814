"""``doo-ti group``: rods that touch each other or are tied together, at rest or along a motion."""

import re
import sys
from argparse import Namespace
from dataclasses import fields
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import doo_ti
from doo_ti.commands import doubts, given, results
from doo_ti.contact.surroundings import Surroundings, smallest_of_pairs
from doo_ti.contact.touch import Touch
from doo_ti.io.toml_file import scene_file
from doo_ti.learning.landscape import status_counts
from doo_ti.rod.types import Status
from doo_ti.system.arguments import counted
from doo_ti.system.errors import InputError, InterruptedRunError
from doo_ti.system.terminal import in_line, progress

if TYPE_CHECKING:
    from doo_ti.groups.scene import GroupScene

OF_RODS = ("group", "contact_force", "touch")  # fields of a solution that are lists, one for each rod
MOST_LISTED = 6  # names or forces in a line


def declare(add) -> None:
    parser = given.command(add, "group", run, "relax rods that touch each other or are tied together, grippers moving or not")
    parser.add_argument("scene", metavar="SCENE.toml", type=scene_file,
                        help="rods, ties, obstacles and clamps (docs/scenes.md)")
    given.add_out(parser, "F.npz")
    given.add_up(parser, "0,0,1")
    given.add_file(parser, "--picture", "F.png", "also draw the rods, and forces over time (default: no)")
    given.add_file(parser, "--recording", "F.rrd", "also record the rods for the viewer (default: no)")


def run(options: Namespace) -> int:
    from doo_ti.groups.scene import load_group_scene

    up = given.world_up(options)
    scene = load_group_scene(options.scene)
    doubts.warn_of_rod(options.scene, max((rod.rest_length for rod in scene.group.rods), key=np.max), scene.surroundings)
    moments = []
    with progress() as bar:
        task = bar.add_task(f"{scene.name} (kernels are compiled once on a machine)", total=len(scene.time), unit="moments")
        try:
            for solution in doo_ti.follow_group(scene.group, scene.clamps, up=up, **scene.arguments):
                moments.append(solution)
                bar.advance(task)
        except InputError as error:
            of_rod = re.fullmatch(r"\w+: rod (\d+)", error.source)
            field = f"rods.{scene.names[int(of_rod[1])]}.{error.field}" if of_rod else error.field
            raise InputError(options.scene, field, error.problem, error.remedy) from None
        except KeyboardInterrupt:
            if not moments:
                raise
            results.save_arrays(options.out, _arrays(scene, moments))
            raise InterruptedRunError(f"interrupted: {len(moments)} of {len(scene.time)} moments are in "
                                      f"{in_line(options.out)}; the same command starts from the beginning") from None
    results.save_arrays(options.out, _arrays(scene, moments))
    _draw(scene, moments, up, options.picture, options.recording)
    summary = _summary(scene, moments, options.out)
    results.report(options, summary, lambda: _lines(scene, summary))
    return 0 if moments[-1].converged[0] else 1


def _arrays(scene: "GroupScene", moments: "list[doo_ti.GroupSolution]") -> dict[str, np.ndarray]:
    """What is written, with the vertices and edges of all rods one after the other."""
    def along(values) -> np.ndarray:
        """(T, all vertices or edges, ...) from those of each rod at each moment."""
        return np.array([np.concatenate([part[0] for part in of_rods]) for of_rods in values])

    rods = scene.group.rods
    number = np.arange(len(rods))
    arrays = {
        "time_s": scene.time[: len(moments)], "rod_names": np.array(scene.names),
        "rod": np.repeat(number, [rod.edges + 1 for rod in rods]), "edge_rod": np.repeat(number, [rod.edges for rod in rods]),
        "positions_mm": along([rod.vertices for rod in moment.rods] for moment in moments),
        "frames": along([rod.frames for rod in moment.rods] for moment in moments),
        "rest_length_mm": np.concatenate([rod.rest_length for rod in rods]),
        "contact_force": along(moment.contact_force for moment in moments),
        "touch": along(moment.touch for moment in moments)}
    arrays |= {"smallest_gap_mm" if field.name == "gap" else field.name: np.array(
        [getattr(moment, field.name)[0] for moment in moments]) for field in fields(moments[0]) if field.name not in OF_RODS}
    return results.in_newton(arrays, None if scene.newton is None else np.array([scene.newton]), 0)


def _draw(scene: "GroupScene", moments: "list[doo_ti.GroupSolution]", up: np.ndarray, picture: Path | None,
          recording: Path | None) -> None:
    wanted = [path for path in (picture, recording) if path is not None]
    if not wanted:
        return
    if all(np.isnan(moment.energy[0]) for moment in moments):
        print(f"doo-ti: note: {' and '.join(map(in_line, wanted))} not written: the rods have no place at any moment",
              file=sys.stderr)
        return
    from doo_ti.report.contact import GroupMotion, save_group

    seen = GroupMotion.of(moments, scene.name, scene.names, scene.surroundings, scene.rate, up, scene.newton)
    if picture is not None:
        save_group(picture, seen)
    if recording is not None:
        from doo_ti.record.motions import record_group

        record_group(recording, seen)


def _summary(scene: "GroupScene", moments: "list[doo_ti.GroupSolution]", out: Path) -> dict:
    status = np.array([moment.status[0] for moment in moments])
    last = moments[-1]
    gap, closure = (np.array([getattr(moment, name)[0] for moment in moments]) for name in ("gap", "closure"))
    forces = {f"{name}, {end}": np.linalg.norm(getattr(last, f"{end}_force")[0, rod])
              for rod, name in enumerate(scene.names) for end in ("start", "end")}
    touch = np.concatenate([part[0] for part in last.touch])
    return {
        "name": scene.name, "rods": len(scene.names), "edges": int(sum(rod.edges for rod in scene.group.rods)),
        "ties": len(scene.group.ties), "moments": len(moments),
        "status": status_counts(status),
        "failed_s": [float(time) for time, value in zip(scene.time, status, strict=True) if value != Status.CONVERGED],
        "stable": int(sum(moment.stable[0] for moment in moments)), "energy": last.energy[0], "kinetic": last.kinetic[0],
        "closure": np.max(closure[np.isfinite(closure)], initial=0.0),
        "smallest_gap_mm": np.min(gap[np.isfinite(gap)], initial=np.inf),
        "overlap": _overlap(scene) if status[0] == Status.INFEASIBLE else None,
        "contact_force": {name: np.linalg.norm(force[0].sum(axis=0))
                          for name, force in zip(scene.names, last.contact_force, strict=True)},
        "held_force": {name: value for name, value in forces.items() if value > 0},
        "tie_force": np.linalg.norm(last.tie_force[0], axis=-1), "force_unit_N": scene.newton,
        "friction_work": np.nansum([moment.friction_work[0] for moment in moments]),
        "sticks": int((touch == Touch.STICKS).sum()), "slips": int((touch == Touch.SLIPS).sum()), "out": str(out)}


def _overlap(scene: "GroupScene") -> str | None:
    """Which rods begin inside an obstacle or each other; None where none do."""
    from doo_ti.relaxation.contact_table import DEEPEST_STEP

    rods, around = scene.group.rods, scene.surroundings
    if around.radius is None:
        return None
    radius = np.broadcast_to(np.ravel(around.radius), len(rods))
    for name, rod, own in zip(scene.names, rods, radius, strict=True):
        if around.bodies and Surroundings(around.bodies, own).smallest_gap(rod.vertices)[0] < -own:
            return f"{in_line(name)} begins inside an obstacle"
    tied = [{tie.first[0], tie.second[0]} for tie in scene.group.ties]  # these may touch
    for one, other in (pair for pair in combinations(range(len(rods)), 2) if {*pair} not in tied):
        vertices = np.concatenate([rods[one].vertices, rods[other].vertices], axis=1)
        early, late = (pair.ravel() for pair in np.meshgrid(np.arange(rods[one].edges), rods[one].edges + 1
                                                            + np.arange(rods[other].edges)))
        apart = smallest_of_pairs(vertices, early, late, lambda _, distance: distance)[0]
        if apart < DEEPEST_STEP * radius.min():
            return f"{in_line(scene.names[one])} and {in_line(scene.names[other])} begin {apart:.2g} mm apart"
    return None


def _lines(scene: "GroupScene", summary: dict) -> list[str]:
    several, failed, ties, gap = summary["moments"] > 1, summary["failed_s"], summary["ties"], summary["smallest_gap_mm"]
    moving = f" and {summary['kinetic']:.4g} mm² kinetic" if scene.dynamics is not None else ""
    at_rest = scene.time[summary["moments"] - 1] not in failed  # else forces are those of no equilibrium
    factor, unit = (1.0, "mm²/mm") if scene.newton is None else (scene.newton, "N")
    pushed = [f"{in_line(name)} {factor * force:.4g}" for name, force in summary["contact_force"].items() if force > 0]
    pushes = f"; forces on {'; '.join(pushed[:MOST_LISTED])} {unit}" * bool(at_rest and pushed)
    held = sorted(summary["held_force"].items(), key=lambda pair: -pair[1])[:MOST_LISTED]
    return [
        f"{in_line(scene.name)}: {counted(summary['rods'], 'rod')} of {summary['edges']} edges in all, {counted(ties, 'tie')}"
        + f", {summary['moments']} moments in {scene.time[-1]:.3g} s" * several,
        *results.rows(
            ("status", f"{results.status_text(summary['status'])}; {summary['stable']} certified stable"),
            ("failed at", failed and ", ".join(f"{time:g}" for time in failed[:MOST_LISTED]) + " s"
                          + " and later" * (len(failed) > MOST_LISTED)),
            ("energy", np.isfinite(summary["energy"]) and f"{summary['energy']:.6g} mm²{moving}" + " at the end" * several
                       + f"; ties and ends miss their places by at most {summary['closure']:.1e} of the longest rod"),
            ("infeasible", summary["overlap"]),
            ("contact", np.isfinite(gap) and f"smallest gap {gap:.2g} mm" + pushes),
            ("friction", scene.surroundings.rub and f"takes {summary['friction_work']:.3g} mm²; at the end {summary['sticks']} "
                                                    f"vertices stick, {summary['slips']} slip"),
            ("forces", at_rest and held and "of clamps: " + "; ".join(
                f"{in_line(name)} {factor * force:.4g}" for name, force in held) + f" {unit}"),
            ("ties", at_rest and ties and "; ".join(f"{factor * force:.4g}" for force in summary["tie_force"][:MOST_LISTED])
                     + "; …" * (ties > MOST_LISTED) + f" {unit}"))]
