"""Material parameters with intervals, fitted from a grid's best cells or from one Θ (§III-E)."""

import json
import os
from argparse import Namespace
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import doo_ti
from doo_ti.commands import doubts, given, loading, results
from doo_ti.commands.refine_text import summary_lines, summary_of
from doo_ti.io.arrays import read_npz
from doo_ti.learning.chunks import DENSITY, read_summary
from doo_ti.learning.landscape import Landscape, plane_of, read_landscape
from doo_ti.refinement.theta import common_rod
from doo_ti.rod.observations import UNKNOWN_SPACING, Observations
from doo_ti.rod.start import check_experiment, observation_clamps
from doo_ti.rod.types import Clamps
from doo_ti.system.errors import InputError, require
from doo_ti.system.files import read_content
from doo_ti.system.terminal import busy, in_line

REFINED = "refined.json"  # in the folder of a run, with its picture beside it
STARTS = 3
CURVATURES = ("auto", "field", "uniform", "none")
OLD_CURVATURES = {"rest_curvature": "uniform", "rest_curvature_per_joint": "field"}
"""Old names in --parameters for a rest curvature."""


def declare(add) -> None:
    parser = given.command(add, "refine", run, "fit parameters with confidence intervals, starting from a sweep or one Θ")
    parser.add_argument("sources", nargs="+", metavar="RUN|OBS",
                        help="folders that sweep wrote, to start from their best cells, or "
                        f"observations: {loading.FORMATS}")
    given.add_material(parser, "one number each: the start of the fit where observations are given",
                       density="for --EI, --GJ and results in N m²")
    given.add(parser, "--parameters", "A,B", str, "material parameters to learn, of bend, bend-1, bend-2, bend-12, twist, "
              "weight, and up, the direction against gravity", "bend,twist")
    given.add(parser, "--starts", "N", given.COUNT, "number of best cells of a run to start from", STARTS)
    given.add(parser, "--spacing-error", "SHARE", given.not_negative("a share"), "how far each length between marks may be "
              "off, as 0.02: these are learned with that prior (default: the file's; lengths that it states are exact, those "
              "of --rest-length are off by " f"{loading.MEASURED:g}, others by {UNKNOWN_SPACING:g})")
    given.add(parser, "--sigma", "MM", given.LENGTH, "label uncertainty (default: the file's, else learned)")
    model = parser.add_argument_group("the model of the experiment")
    given.add(model, "--clip", "MM|unknown", given.either({"unknown": None}, given.not_negative("mm")), "length of rod that a "
              "clip holds, from the outer mark on; 0: it ends at that mark (default: unknown, which is learned)")
    model.add_argument("--rest-curvature", choices=CURVATURES, default=None,
                       help="curvature of the unloaded rod: field, a smooth function along it; uniform; none; auto, field "
                       "unless frames are missing and the evidence is for a straight rod (default)")
    model.add_argument("--stiffness", choices=("auto", "uniform", "field"), default="auto",
                       help="bend stiffness along the rod: uniform; field, a smooth function along it; auto: a field where "
                       "the evidence is for it (default)")
    model.add_argument("--clamps", choices=("auto", "loose", "exact"), default="loose",
                       help="loose: errors of reported frames are learned, and what is not reported is unknown in each "
                       "observation (default); auto: the same; exact: all is as reported, and as the outer marks say")
    given.add(model, "--frames", "exact|MM,DEG", _frames, "how well the reported frames are known: exactly, as "
              "--clamps exact, or the standard deviations of their places and directions (default: learned)")
    given.add(model, "--edges", "N", given.whole(6), "edges of the mesh (default: twice those between marks, with a correction "
              "for the mesh error)")
    parser.add_argument("--no-models", action="store_true", help="do not compare with other models")
    given.add(parser, "--folds", "N", given.whole(2), "also cross-validate in N folds")
    given.add_clamps(parser, "the run's, else frame where the file gives one, else tangent")
    given.add_frame_weight(parser, "the run's, else 0")
    given.add_obstacles(parser, "without friction; the run's, where it has any")
    given.add(parser, "--mass", "MARK:G,…|FILE", str, "bodies of known mass in g that hang at these marks, counted from 0, in "
              "every observation, or a .npz with mass_g (D, V); with --parameters bend,twist,weight the rod's own mass is "
              "learned too, from --linear-density on")
    loading.add_loading(parser)
    given.add_file(parser, "--out", "F.json",
                   f"file for the results of all sources (default: those of a run in RUN/{REFINED} only)")


def _frames(option: str, text: str) -> str | tuple[float, float]:
    """``exact``, or standard deviations in mm and rad."""
    if text == "exact":
        return text
    error = given.NUMBERS(option, text)
    require(len(error) == 2 and min(error) > 0, given.SOURCE, option, f"{text!r}",
            "give exact, or two positive numbers: mm,degrees")
    return error[0], float(np.radians(error[1]))


@dataclass(frozen=True)
class Task:
    """One source: its observations, their clamps, the Θ to start from, the linear density in g/m, the landscape of a run, or
    None, and what is to be learned, with what the rods touch and the weights that hang at the marks, or None."""

    observations: Observations
    clamps: Clamps
    thetas: tuple
    density: float | None
    landscape: Landscape | None
    chosen: "doo_ti.RefinementOptions"


def run(options: Namespace) -> int:
    """Θ of least χ² for each source, the best of several starts, and how well the observations determine it."""
    out, folds = options.out, options.folds
    tasks = [_task(options, source) for source in options.sources]

    from doo_ti.learning.up_axes import other_up_of
    from doo_ti.refinement.folds import folds_of, refine_held_out

    for task in tasks:
        if task.landscape is None:
            doubts.warn(task.observations, **loading.stated(options))
    splits = [None if folds is None else folds_of(np.arange(task.observations.count), folds) for task in tasks]
    summaries = []
    for task, split in zip(tasks, splits, strict=True):
        around, loads = task.chosen.surroundings, task.chosen.loads
        with busy(f"refining {task.observations.name} (kernels are compiled once on a machine)"):
            found = doo_ti.refine(task.observations, task.clamps, task.thetas, task.chosen)
        mesh = np.full(found.mesh_edges, task.observations.rest_length.sum() / found.mesh_edges)
        doubts.say(task.observations.source, doubts.mesh_doubt(mesh, around),
                   doubts.repeats_doubt(task.observations, found.adequacy.noise))
        held_out = None
        if split is not None:
            with busy(f"cross-validating {task.observations.name} in {folds} folds"):
                begin = replace(found.theta, rest_curvature=None)
                held_out = refine_held_out(task.observations, task.clamps, begin, split, task.chosen)
        weight = found.theta.weight if loads is None else 0.0  # what bodies that hang on rods do is not compared
        other = other_up_of(task.observations, task.clamps, weight, found.theta.up, around)
        summary = summary_of(task.observations, around, found, held_out, task.density, loads is not None) | {
            "other_up": other, "of_run": task.landscape is not None}
        summaries.append(summary)
        written = [] if task.landscape is None else _kept(task.landscape, found, summary)
        if not options.json:
            first, *rest = summary_lines(summary)
            kept = [f"  {'written to':<18} {in_line(path)}" for path in written]
            if not written and out is None:
                kept = [f"  {'written to':<18} no file: give --out F.json to keep this"]
            print("\n".join([first, loading.rod_line(task.observations), *rest, *kept]))
        doubts.say(task.observations.source, loading.up_text(other))
    if out is not None:
        results.save_json(out, summaries)
    if options.json:
        print(json.dumps(results.plain(summaries)))
    elif out is not None:
        print(f"written to {in_line(out)}")
    results.note_theta(options)
    return 0


def _kept(landscape, found, summary: dict) -> list[Path]:
    """Write the result into the folder of its run, as --json prints it, and where the grid has two of the learned parameters
    the landscape with their joint 95 % region; returns the files."""
    from doo_ti.report.landscapes import landscape_picture

    path, grid, estimate = landscape.run / REFINED, landscape.grid, found.estimate
    results.save_json(path, [summary])
    free = [axis.name for axis in grid.axes if len(axis) > 1]
    pair = [{"twist_ratio": "twist"}.get(name, name) for name in free]
    if len(free) != 2 or not set(pair) <= set(estimate.names) or np.isnan(landscape.mean_distance).all():
        return [path]
    outline = estimate.region(*pair)
    if "twist_ratio" in free:
        outline[:, free.index("twist_ratio")] /= outline[:, 1 - free.index("twist_ratio")]
    landscape_picture(path.with_suffix(".png"), plane_of(landscape), region=outline,
                      title=f"{landscape.name}: the grid's error, and the 95 % region of the refined model")
    return [path, path.with_suffix(".png")]


def _task(options: Namespace, source: str) -> Task:
    """The task of ``source``, a run's folder or a file of observations, checked."""
    density = options.linear_density
    if os.path.isdir(source):
        observations, thetas, kinds, weight, around, landscape = _of_run(options, Path(source))
        if density is None:  # that which its sweep was given
            density = read_summary(Path(source)).get(DENSITY)
            density = float(density) if isinstance(density, (int, float)) and 0 < density < np.inf else None
        grid = landscape.grid
    else:
        from doo_ti.refinement.search import theta_of_cell

        observations, around, landscape = loading.load(options, source).along_arcs(), given.surroundings(options), None
        grid = given.single_cell(options, "give one, or refine the run of a sweep")
        thetas, kinds, weight = (theta_of_cell(grid, 0, observations.up),), (None, None), options.frame_weight or 0.0
    if options.sigma is not None:
        observations = replace(observations, sigma=np.array(options.sigma))
    if options.spacing_error is not None:
        observations = replace(observations, spacing_error=options.spacing_error)
    loads = None if options.mass is None else _loads(options.mass, observations, density)
    kinds = given.clamps(options, kinds)
    exact = "exact" in (options.clamps, options.frames)
    every, observations = observations.labels, loading.with_ends_in_reach(observations, *kinds, exact)
    loads = None if loads is None else loads[np.isin(every, observations.labels)]
    clamps = observation_clamps(observations, *kinds)
    check_experiment(observations, clamps, max(theta.weight for theta in thetas), weight, exact)
    # Options that do not fit the observations or each other are refused before anything is relaxed.
    from doo_ti.refinement.held_rod import HeldRod
    from doo_ti.refinement.refine import FEWEST_EDGES, check, unknowns_of

    chosen = _refinement_options(options, frame_weight=weight, surroundings=around, loads=loads,
                                 twist_follows="twist" not in [axis.name for axis in grid.axes])
    check(observations, clamps, chosen)
    unknowns = unknowns_of(HeldRod(observations, clamps, FEWEST_EDGES), chosen)
    unknowns.begun(thetas[0], unknowns.clip_prior)
    return Task(observations, clamps, thetas, density, landscape, chosen)


def _loads(text: str, observations: Observations, density: float | None) -> np.ndarray:
    """(D, M) weights in the package's unit of the bodies that ``--mass`` states: as much as so many mm of rod weigh."""
    count, marks = observations.valid.shape
    require(density is not None, given.SOURCE, "--mass", "given without --linear-density",
            "give that of the rod, or a guess beside --parameters bend,twist,weight")
    if text.endswith(".npz"):
        mass = read_npz(Path(text), read_content(Path(text), remedy="name a readable .npz file"), ("mass_g",)).get("mass_g")
        if mass is None or mass.shape != (count, marks) or mass.dtype.kind not in "iuf":
            raise InputError(text, "mass_g", "missing, or of another shape", f"give numbers of shape ({count}, {marks})")
    else:
        mass = np.zeros((count, marks))
        for part in text.split(","):
            mark, _, grams = part.partition(":")
            at = given.whole(0, marks - 1)("--mass", mark)
            mass[:, at] = given.not_negative("g")("--mass", grams)
    if not (np.isfinite(mass) & (mass >= 0)).all():
        raise InputError(text, "mass_g", "not finite, or negative", "give grams, zero where nothing hangs")
    return 2e3 * mass / density


def _of_run(options: Namespace, run: Path):
    """(observations, the Θ of the lowest cells, kinds of clamps, frame weight, obstacles, landscape) of a run's folder."""
    from doo_ti.learning.run_folder import read_experiment
    from doo_ti.refinement.search import lowest_cells, theta_of_cell

    given.refuse(options, (*given.MATERIAL, *loading.OF_OBSERVATIONS, "obstacles", "radius", "mass"),
                 f"given, but {run} is the run of a sweep", "leave it out, or name a file of observations")
    experiment, landscape = read_experiment(run), read_landscape(run)
    require(experiment.options.objective == "static" and not experiment.options.spins, run, "objective",
            "a sweep of Eq. 3, or with roll hypotheses", "name a static sweep without --roll-hypotheses")
    observations = experiment.observations if options.up is None else replace(experiment.observations, up=options.up)
    height = landscape.mean_distance
    if np.isnan(height).all():  # no cell has all its rods certified: start from those that have most of them
        few = landscape.unsound == landscape.unsound.min()
        height = np.where(few, landscape.distance_of_sound, np.nan)
    cells = lowest_cells(experiment.grid, height, options.starts)
    require(len(cells), run, "distance_mm", "no cell has an error", "look at the rods' status in cells/")
    thetas = tuple(theta_of_cell(experiment.grid, cell, observations.up) for cell in cells)
    thetas += (common_rod(thetas[0]),)  # the best cells of rods taken for straight may all be wrong in twist
    own = experiment.options
    return (observations, thetas, (own.clamp_start, own.clamp_end),
            own.frame_weight if options.frame_weight is None else options.frame_weight, own.surroundings, landscape)


def _refinement_options(options: Namespace, **of_source) -> "doo_ti.RefinementOptions":
    """What the options say, and the fields that are ``of_source``."""
    names = [name.strip().replace("-", "_") for name in options.parameters.split(",") if name.strip()]
    curvature = options.rest_curvature
    for name, own in OLD_CURVATURES.items():
        if name in names:
            names.remove(name)
            curvature = curvature or own
    exact = "exact" in (options.clamps, options.frames)
    return doo_ti.RefinementOptions(
        tuple(names), options.clip, curvature or "auto", options.stiffness, "exact" if exact else "loose",
        None if options.frames == "exact" else options.frames, edges=options.edges, models=not options.no_models, **of_source)
