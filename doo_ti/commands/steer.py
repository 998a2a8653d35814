"""Grippers that bring a rod to a target (§VI). ``steer`` plans their motion. ``servo`` does it with visual feedback, in the
virtual lab (§V-A): cameras render the true rod, a tracker sees it, and a servo that knows its stiffness only roughly moves the
grippers.
"""

from argparse import Namespace
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import doo_ti
from doo_ti.commands import doubts, given, image_options, loading, results
from doo_ti.commands.moving_rods import settled, with_rest_curvature
from doo_ti.contact.surroundings import Surroundings
from doo_ti.io.motion_file import ClampPath, path_table
from doo_ti.rod.material import relative_stiffness, stiffness
from doo_ti.rod.observations import Observations
from doo_ti.rod.shapes import end_clamps
from doo_ti.rod.start import check_experiment, observation_clamps
from doo_ti.rod.types import POSES, Clamp, Clamps, Material, Solution
from doo_ti.system.errors import InputError, InterruptedRunError, require
from doo_ti.system.files import csv_text, write_text
from doo_ti.system.terminal import busy, can_record, in_line, progress, warn
from doo_ti.vision.cameras import Rig

if TYPE_CHECKING:
    from doo_ti.perception.virtual_lab import SeenMoment, VirtualCameras

SECONDS = given.number("a positive number of s up to 3600", lambda seconds: 0 < seconds <= 3600)
SEED = given.whole(0, 2**31 - 1)
MOVES = ("start-shift", "start-turn", "end-shift", "end-turn")
PLANNED = 2.0  # mm, default distance to the target at which it is reached


def declare(add) -> None:
    parser = given.command(add, "steer", run_steer, "plan a motion of both grippers that brings a rod to a shape (§VI)")
    add_steered(parser)
    given.add_out(parser, "PATH.csv", "file to write, which predict --motion reads")
    given.add(parser, "--reached", "MM", given.LENGTH, "distance at which the target is reached", PLANNED)
    given.add(parser, "--seconds", "S", SECONDS, "longest search, besides compiling and following the path", 10.0)
    given.add(parser, "--seed", "N", SEED, "of the search's random numbers", 0)
    parser = given.command(add, "servo", run_servo,
                           "bring a rod to a shape by what cameras see of it, in the virtual lab (§VI)")
    add_steered(parser)
    image_options.add_rig(parser)
    given.add(parser, "--out", "DIR", given.folder, f"folder for {PATH}, {TABLE}, {PICTURE} and {RECORDING}", required=True)
    lab = parser.add_argument_group("virtual lab", "the true rod and its images")
    given.add(lab, "--true-EI", "NM2", given.positive("N m²"), "bend stiffness of the true rod in N m² (default: the model's)")
    given.add(lab, "--true-GJ", "NM2", given.positive("N m²"), "its twist stiffness in N m² (default: the model's)")
    given.add(lab, "--diameter", "MM", given.LENGTH, "diameter of the rod in the images", 2.0)
    given.add(lab, "--noise", "GREY", given.not_negative(), "noise of the images, grey levels (default 3)")
    lab.add_argument("--occlude", metavar="CAMERA:SHARE", action="append",
                     help="share of the steps in which something covers a camera; once for each camera")
    given.add(lab, "--seed", "N", SEED, "of all random numbers", 0)
    given.add(parser, "--steps", "N", given.whole(1, MOST_STEPS), "most steps", STEPS)
    given.add(parser, "--reached", "MM", given.LENGTH, "distance at which the target is reached", REACHED)
    parser.add_argument("--no-recording", action="store_true", help=f"do not write {RECORDING}")


def run_steer(options: Namespace) -> int:
    out = options.out
    rod = steered_rod(options, [out])

    chosen = doo_ti.PlanOptions(free=rod.free, reached_mm=options.reached, seconds=options.seconds, seed=options.seed)
    with busy("planning (kernels are compiled once on a machine)"):
        start, held = rod.at_rest()
        path = doo_ti.plan_manipulation(start.configuration, rod.material, held, doo_ti.Targets(rod.places), chosen,
                                        up=rod.observations.up, **rod.surroundings.arguments)
    write_text(out, path_table(path))
    if not path.reached:
        warn(f"{in_line(options.target)}: the target is not reached; the path ends {path.distance:.3g} mm from it, at the "
             "nearest shape that was found")
    if not path.mesh_error <= options.reached:
        warn(f"{in_line(options.start)}: its edges are long for this shape: a finer rod ends about {path.mesh_error:.2g} mm "
             "elsewhere; give START and TARGET more vertices")
    elif not path.clamp_error <= options.reached:
        warn(f"{in_line(options.start)}: its grippers are taken to hold half of each outer edge; if they end at the outer "
             f"marks, the rod ends about {path.clamp_error:.2g} mm elsewhere; give START and TARGET more vertices then")
    touches, gap = path.smallest_gap == 0, path.smallest_gap
    if not touches and gap < path.mesh_error + path.clamp_error:
        warn(f"{in_line(options.obstacles)}: the rod passes {gap:.2g} mm beside them, but mesh and clamps may put it "
             f"{path.mesh_error + path.clamp_error:.2g} mm elsewhere; plan with a larger --radius")
    summary = {"reached": path.reached, "distance_mm": path.distance, "mesh_error_mm": path.mesh_error,
               "clamp_error_mm": path.clamp_error, "smallest_gap_mm": gap if rod.surroundings else None,
               "smallest_radius_mm": path.smallest_radius, "moments": path.moments, "seconds": path.time[-1], "out": str(out)}
    results.report(options, summary, lambda: [
        f"{rod.observations.name}: target {'reached' if path.reached else 'not reached'}, {path.distance:.3g} mm from it "
        "(root mean square)",
        *results.rows(
            ("path", f"{path.moments} moments, certified stable, without a jump"),
            ("obstacles", rod.surroundings and ("touched" if touches else f"passed by {gap:.3g} mm at least")),
            ("bends", f"to a radius of {path.smallest_radius:.3g} mm where it bends most"),
            ("mesh error", f"{path.mesh_error:.2g} mm: about how far a rod of many edges ends from that"),
            ("clamps", f"{path.clamp_error:.2g} mm: about how far it ends from that if they end at the outer marks")),
        loading.rod_line(rod.observations)])
    return 0


# --- the rod -------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class SteeredRod:
    """A rod, how it is held where it begins, and (1, V, 3) mm the ``places`` where its vertices shall be, NaN where nothing is
    asked. ``source`` is the file that it is of, ``free`` what of its grippers moves."""

    source: str
    observations: Observations
    clamps: Clamps
    material: Material
    surroundings: Surroundings
    places: np.ndarray
    free: tuple[str, ...]

    def at_rest(self) -> tuple[Solution, Clamps]:
        """The rod at the start, and its grippers, which hold frames from there on: where the file has none, those of the rod
        that rolls freely. Raises InputError where it has no stable equilibrium."""
        begin = settled(self.observations, self.clamps, self.material, self.surroundings)
        start = doo_ti.relax(begin, self.material, self.clamps, up=self.observations.up, **self.surroundings.arguments)
        require((start.converged & start.stable).all(), self.source, "vertices_mm", "observation 0 has no stable equilibrium",
                "give a rod that is held within its length" + ", outside the obstacles" * bool(self.surroundings))
        return start, end_clamps(start.configuration, Clamp.FRAME, Clamp.FRAME)


def add_steered(parser) -> None:
    """START, TARGET, and the options of the rod."""
    parser.add_argument("start", metavar="START.npz", help=f"the rod as it is, in row 0: {loading.FORMATS}")
    given.add(parser, "--target", "TARGET.npz", str, "vertices_mm (1, V, 3), where vertices shall be; NaN where nothing is "
              "asked", required=True)
    given.add_material(parser, "one number each", given.SHAPE_ONLY, round_rod=True)
    given.add(parser, "--free", "NAME,…", _free, f"what of the grippers moves: {', '.join(MOVES)} (default: all)")
    given.add_clamps(parser)
    given.add_obstacles(parser, "without friction")
    loading.add_loading(parser, "START and TARGET")


def steered_rod(options: Namespace, written: Iterable[Path]) -> SteeredRod:
    """What :func:`add_steered` describes. Raises InputError for whatever is wrong with it, and for files to be ``written`` that
    are read."""
    surroundings = given.surroundings(options)
    require(not surroundings.rub, options.obstacles, "friction", "given, but steered rods know none", "leave it out")
    grid = given.round_cell(options, "steered")
    observations = loading.load(options, options.start).take(np.zeros(1, dtype=np.int64))
    for out in written:
        results.refuse_overwriting(out, options.start, options.target)
    places = loading.target(options, observations)
    clamps = observation_clamps(observations, *given.clamps(options))
    for end, kind in (("start", clamps.start), ("end", clamps.end)):
        if (np.asarray(kind) < Clamp.TANGENT).any():
            raise InputError(given.SOURCE, f"--clamp-{end}", Clamp(int(np.max(kind))).name.lower(), "give tangent or frame")
    check_experiment(observations, clamps, grid.axes[-1].values[-1], 0.0)
    material = with_rest_curvature(options, grid.materials(), observations.rest_length)
    doubts.warn(observations, surroundings, **loading.stated(options))
    free = tuple(name.replace("-", "_") for name in options.free or MOVES)
    return SteeredRod(options.start, observations, clamps, material, surroundings, places, free)


def _free(option: str, text: str) -> tuple[str, ...]:
    """Names of MOVES between commas."""
    names = tuple(text.split(","))
    if set(names) - set(MOVES) or len(set(names)) < len(names):
        raise InputError(given.SOURCE, option, f"{text!r}", f"give some of {', '.join(MOVES)}, each once")
    return names


# --- servo ---------------------------------------------------------------------------------------------------------------

STEPS, MOST_STEPS = 30, 1000
REACHED = 1.0  # mm, default distance to the target at which it is reached
SETTLED = 3  # steps at the target after which the loop ends
PATH, TABLE, PICTURE, RECORDING = "path.csv", "steps.csv", "servo.png", "servo.rrd"
STATUSES = ("on its way", "reached", "as near as it comes", "blocked by an instability", "lost")
"""In the order of ServoStatus."""
HOW = ("tracked", "found anew", "lost")  # in the order of How


@dataclass(frozen=True)
class Step:
    """One step: what the cameras saw, where the ``model`` (V, 3) was then, the grippers' poses and the distances to the target
    after it, mm, status, and what was learned."""

    seen: "SeenMoment"
    model: np.ndarray
    clamps: Clamps
    true_mm: float
    estimated_mm: float
    status: int
    learned: "doo_ti.LearnedMaterial"


@dataclass(frozen=True)
class Stiffness:
    """How stiffness is written: its two names, the unit, and the numbers that bend and twist in mm³ are multiplied by."""

    names: tuple[str, str]
    unit: str
    factor: float

    def of(self, learned: "doo_ti.LearnedMaterial") -> list[tuple[float, float, float]]:
        """(value, low, high) of each."""
        return [(self.factor * value[0], *(self.factor * interval[0])) for value, interval in (
            (learned.bend, learned.bend_interval), (learned.twist, learned.twist_interval))]


def run_servo(options: Namespace) -> int:
    from doo_ti.report.motions import servo_picture

    folder, rig, reached = options.out, image_options.rig(options), options.reached
    rod = steered_rod(options, [folder / name for name in (PATH, TABLE, PICTURE, RECORDING)])
    density, weight, unit = options.linear_density, rod.material.weight[0], Stiffness(("bend", "twist"), "mm3", 1.0)
    if density is None:
        given.refuse(options, ("true_EI", "true_GJ"), "given without --linear-density", "give both")
    elif weight > 0:
        unit = Stiffness(("EI", "GJ"), "Nm2", float(stiffness(relative_stiffness(1.0, weight), density)))
    bend = rod.material.bend[0, 0, 0, 0] if options.true_EI is None else options.true_EI / unit.factor
    twist = rod.material.twist[0, 0] if options.true_GJ is None else options.true_GJ / unit.factor
    true = Material(bend, twist, rod.material.weight, rod.material.rest_curvature)
    cameras = _cameras(options, rig, rod)
    begin, steps, end = _steps(rod, true, cameras, rig, options.steps, reached)

    held = [begin, *(step.clamps for step in steps)]
    write_text(folder / PATH, path_table(ClampPath(np.arange(len(held), dtype=float), **{
        name: np.stack([getattr(clamps, name) for clamps in held]) for name in POSES})))
    names = [f"{name}{bound}_{unit.unit}" for name in unit.names for bound in ("", "_low", "_high")]
    write_text(folder / TABLE, csv_text(
        ["step", "distance_mm", "estimated_mm", "status", "rod", "vertices_seen", "covered", *names], (
            [number, step.true_mm, step.estimated_mm, STATUSES[step.status], HOW[step.seen.frame.how],
             np.isfinite(step.seen.seen).all(axis=1).sum(), " ".join(step.seen.covered),
             *(value for row in unit.of(step.learned) for value in row)] for number, step in enumerate(steps, 1))))
    distance = np.array([(step.true_mm, step.estimated_mm) for step in steps])
    servo_picture(folder / PICTURE, rod.observations.name, steps[0].seen.rod, end, rod.places[0], distance, reached,
                  rod.observations.up)
    written = [folder / name for name in (PATH, TABLE, PICTURE)]
    if not options.no_recording and can_record():
        from doo_ti.record.images import record_servo

        written.append(folder / RECORDING)
        record_servo(written[-1], run_id=f"servo {folder.name}", name=rod.observations.name, rig=rig,
                     moments=[step.seen for step in steps], model=np.array([step.model for step in steps]),
                     target=rod.places[0], distance=distance, words=[STATUSES[step.status] for step in steps],
                     up=rod.observations.up)
    summary = _summary(steps, unit, true, written)
    if not summary["reached"]:
        warn(f"{in_line(options.target)}: the target is not reached; the rod is {summary['distance_mm']:.3g} mm from it, "
             f"{summary['status']}")
    results.report(options, summary, lambda: _lines(rod, summary))
    return 0


def _cameras(options: Namespace, rig: Rig, rod: SteeredRod) -> "VirtualCameras":
    """What looks at the true rod."""
    from doo_ti.perception.virtual_lab import VirtualCameras
    from doo_ti.vision.render import RenderOptions, check_diameter

    covered = {name: share for name, (share,) in image_options.by_camera(
        "--occlude", options.occlude, rig.names, "SHARE").items()}
    for name, share in covered.items():
        if not 0 <= share <= 1:
            raise InputError(given.SOURCE, "--occlude", f"{share:g} for {in_line(name)}", "give a share of the steps, 0 to 1")
    check_diameter(options.diameter, given.SOURCE, "--diameter")
    look = RenderOptions() if options.noise is None else replace(RenderOptions(), noise=options.noise)
    material = replace(rod.material, rest_curvature=None)
    return VirtualCameras(rig, rod.observations.rest_length, material, up=rod.observations.up, diameter_mm=options.diameter,
                          look=look, covered=covered, seed=options.seed)


def _steps(rod: SteeredRod, true: Material, cameras: "VirtualCameras", rig: Rig, most: int, reached: float
           ) -> tuple[Clamps, list[Step], np.ndarray]:
    """The grippers' first poses, what has been done, and (V, 3) mm the true rod at the end."""
    from doo_ti.perception.virtual_lab import TRACKED_NOISE

    up, around, targets, steps = rod.observations.up, rod.surroundings.arguments, doo_ti.Targets(rod.places), []
    with progress() as bar:
        shown = bar.add_task("steps", total=most, unit="steps")
        model, begin = rod.at_rest()
        simulation = doo_ti.Simulation(model.configuration, true, begin, up=up, **around)
        state = simulation.state
        require((state.converged & state.stable).all(), given.SOURCE, "--true-EI",
                "the true rod has no stable equilibrium at the start", "give another, or a rod that is held within its length")
        vertices = state.configuration.vertices[0]
        rig.check_sight(vertices, "the rod at its start")
        if (seeing := sum(bool(camera.sees(vertices).all()) for camera in rig.cameras)) < 2:
            raise InputError(rig.source, "cameras", f"{seeing} of {len(rig.cameras)} see all of the rod at its start",
                             "let two or more look at it from different sides")
        chosen = doo_ti.ServoOptions(free=rod.free, reached_mm=reached,
                                     noise_mm=TRACKED_NOISE * float(np.sum(rod.observations.rest_length)))
        servo = doo_ti.Servo(model.configuration, rod.material, begin, targets, chosen, up=up, **around)
        while len(steps) < most and not (len(steps) >= SETTLED and all(
                step.status == STATUSES.index("reached") for step in steps[-SETTLED:])):
            truth, expected = state.configuration.vertices[0], servo.vertices[0]
            if not np.isfinite(truth).all():
                raise InterruptedRunError(f"the true rod has no equilibrium after step {len(steps)}; nothing is written; give "
                                          f"--steps {len(steps) - 1} to see the steps before")
            seen = cameras.see(truth, servo.clamps)
            state = simulation.step(servo.step(seen.seen[None]))
            steps.append(Step(seen, expected, servo.clamps, float(targets.distance(state.configuration.vertices)[0]),
                              float(servo.distance[0]), int(servo.status[0]), servo.material))
            bar.update(shown, advance=1, description=f"steps: {STATUSES[steps[-1].status]}")
    return begin, steps, state.configuration.vertices[0]


def _summary(steps: list[Step], unit: Stiffness, true: Material, written: list[Path]) -> dict:
    last, how = steps[-1], [HOW[step.seen.frame.how] for step in steps]
    values = (true.bend[0, 0, 0, 0], true.twist[0, 0])
    return {
        "reached": STATUSES[last.status] == "reached", "status": STATUSES[last.status], "distance_mm": last.true_mm,
        "estimated_mm": last.estimated_mm, "steps": len(steps), "frames": {word: how.count(word) for word in HOW},
        "covered": sum(bool(step.seen.covered) for step in steps), "unit": unit.unit,
        **{name: {"value": row[0], "low": row[1], "high": row[2], "true": unit.factor * value}
           for name, row, value in zip(unit.names, unit.of(last.learned), values, strict=True)},
        "written": [str(path) for path in written],
    }


def _lines(rod: SteeredRod, summary: dict) -> list[str]:
    unit = {"Nm2": "N m²", "mm3": "mm³"}[summary["unit"]]
    frames = ", ".join(f"{word} in {count}" for word, count in summary["frames"].items())
    learned = [f"  {name:<11} {found['value']:.3g} {unit}, 95 % within {found['low']:.3g} and {found['high']:.3g}; true "
               f"{found['true']:.3g}" for name, found in summary.items() if isinstance(found, dict) and "true" in found]
    return [
        f"{rod.observations.name}: target {'reached' if summary['reached'] else 'not reached'}, {summary['distance_mm']:.3g} mm"
        f" from it (root mean square), {summary['estimated_mm']:.3g} mm as estimated",
        f"  steps       {summary['steps']}; the rod {frames}; a camera covered in {summary['covered']}",
        f"  status      {summary['status']}", *learned, loading.rod_line(rod.observations)]
