"""From the grid's best cells, or from a guess, to the continuous optimum of Θ with its uncertainty (§III-E)."""

import json
from argparse import Namespace
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from doo_ti import options as given
from doo_ti.commands.arguments import MATERIAL, add_json, add_material
from doo_ti.commands.printing import busy, plain
from doo_ti.commands.refine_text import summary_of, tell
from doo_ti.dataset import Observations, load_observations, write_whole
from doo_ti.errors import InputError
from doo_ti.file_content import read_content
from doo_ti.importers import read_npz
from doo_ti.scene import CLAMPS
from doo_ti.start import check_experiment, observation_clamps
from doo_ti.terminal import in_line
from doo_ti.types import Clamps

if TYPE_CHECKING:  # it reads Parquet
    from doo_ti.learning.landscape import Landscape

STARTS = 3
LEAST = 1e-6
"""Of what a rest curvature is and how far it reaches, in 1/mm and mm; the inverse at most."""
CURVATURES = ("field", "uniform", "none")
OLD_CURVATURES = {"rest_curvature": "uniform", "rest_curvature_per_joint": "field"}
"""Names of parameters that used to ask for a rest curvature."""


def declare(add) -> None:
    parser = add("refine", allow_abbrev=False, help="the continuous optimum, with intervals and what is not determined")
    parser.add_argument("sources", nargs="+", metavar="RUN|OBS",
                        help="folders that sweep wrote, whose best cells are begun from, or observations: .npz, .csv, .parquet")
    add_material(parser, "one number each, where observations are begun from, --bend also A1,A2 or A1,A2,A12")
    parser.add_argument("--parameters", metavar="A,B", default="bend,twist",
                        help="what is learned of the material, of bend, bend-1, bend-2, bend-12, twist, weight, up "
                        "(default bend,twist)")
    parser.add_argument("--starts", metavar="N", help=f"cells of a run to begin from (default {STARTS})")
    parser.add_argument("--sigma", metavar="MM", help="label uncertainty (default: the file's, else learned)")
    model = parser.add_argument_group("the model of the experiment")
    model.add_argument("--clip", metavar="MM|unknown", default="unknown",
                       help="length of rod that a clip holds, from the outer mark on (default: unknown, learned)")
    model.add_argument("--rest-curvature", choices=CURVATURES, default=None,
                       help="of the rod when nothing bends it (default: field, a smooth function along it)")
    model.add_argument("--clamps", choices=("auto", "loose", "exact"), default="auto",
                       help="loose: they may be off the poses that were reported; auto: unless the evidence says they are not "
                       "(default)")
    model.add_argument("--edges", metavar="N", help="edges of the mesh (default: twice the marks', corrected for their length)")
    model.add_argument("--curvature-spread", metavar="1/MM", help="standard deviation of the rest curvature (default: learned)")
    model.add_argument("--curvature-range", metavar="MM", help="along which it is about the same (default: learned)")
    parser.add_argument("--no-models", action="store_true", help="leave out the comparison with other models")
    parser.add_argument("--folds", metavar="N", help="also cross-validate in N folds")
    parser.add_argument("--groups", metavar="FILE:KEY", help="a number per observation; equal ones stay in one fold")
    parser.add_argument("--clamp-start", choices=CLAMPS, help="default: the run's, else frame where it is given, else tangent")
    parser.add_argument("--clamp-end", choices=CLAMPS, help="default: the run's, else frame where it is given, else tangent")
    parser.add_argument("--frame-weight", metavar="MM", help="w_m of Eq. 1 (default 0, or the run's)")
    parser.add_argument("--up", metavar="X,Y,Z", help="direction against gravity (default: the file's, else 0,0,1)")
    parser.add_argument("--out", metavar="F.json", help="file to write (default: none)")
    add_json(parser)
    parser.set_defaults(run=run)


@dataclass(frozen=True)
class Task:
    """What one source asks for: observations, what holds them, and the Θ to begin from; the landscape of a run,
    or None."""

    observations: Observations
    clamps: Clamps
    thetas: tuple
    frame_weight: float
    landscape: "Landscape | None"


def run(options: Namespace, words: list[str]) -> int:
    """Θ of least χ² for each source, the best of several starts, and how well the observations determine it."""
    out = None if options.out is None else given.output_file(options.out, ".json")
    starts, folds = given.whole("--starts", options.starts, 1) or STARTS, given.whole("--folds", options.folds, 2)
    density = _positive("--linear-density", options.linear_density, "a linear density in g/m")
    tasks = [_task(options, source, starts) for source in options.sources]
    groups = [_groups(options.groups, task.observations) for task in tasks]

    from doo_ti.refinement.folds import folds_of, refine_held_out
    from doo_ti.refinement.refine import refine

    splits = [None if folds is None else folds_of(group, folds) for group in groups]
    summaries = []
    for task, split in zip(tasks, splits, strict=True):
        chosen = _refinement_options(options, task)
        with busy(f"refining {task.observations.name} (kernels are compiled once on a machine)"):
            found = refine(task.observations, task.clamps, task.thetas, chosen)
        held_out = None
        if split is not None:
            with busy(f"cross-validating {task.observations.name} in {folds} folds"):
                begin = replace(found.theta, rest_curvature=None)
                held_out = refine_held_out(task.observations, task.clamps, begin, split, chosen)
        summaries.append(summary_of(task.observations, found, held_out, density))
        picture = None if task.landscape is None else _draw(task.landscape, found)
        if not options.json:
            tell(summaries[-1])
            if picture is not None:
                print(f"  picture            {in_line(picture)}")
    if out is not None:
        content = json.dumps(plain(summaries), indent=2) + "\n"
        out.parent.mkdir(parents=True, exist_ok=True)
        write_whole(out, lambda file: file.write(content.encode()))
    if options.json:
        print(json.dumps(plain(summaries)))
    elif out is not None:
        print(f"written to {in_line(out)}")
    return 0


def _draw(landscape, found) -> Path | None:
    """RUN/refined.png: the landscape with the joint 95 % region; none where the grid has not two of the learned
    parameters."""
    from doo_ti.learning.drawing import plane_of
    from doo_ti.report import landscape_picture

    grid, estimate = landscape.grid, found.estimate
    free = [axis.name for axis in grid.axes if len(axis) > 1]
    pair = [{"twist_ratio": "twist"}.get(name, name) for name in free]
    if len(free) != 2 or not set(pair) <= set(estimate.names) or np.isnan(landscape.mean_distance).all():
        return None
    outline = estimate.region(*pair)
    if "twist_ratio" in free:
        outline[:, free.index("twist_ratio")] /= outline[:, 1 - free.index("twist_ratio")]
    path = landscape.run / "refined.png"
    write_whole(path, lambda file: landscape_picture(
        file, plane_of(landscape), title=f"{landscape.name}: the grid's error, and the 95 % region of the refined model",
        region=outline))
    return path


def _task(options: Namespace, source: str, starts: int) -> Task:
    """What ``source``, a run's folder or a file of observations, asks for, checked."""
    if Path(source).is_dir():
        observations, thetas, kinds, weight, landscape = _of_run(options, Path(source), starts)
    else:
        observations = load_observations(source, given.up(options))
        thetas, kinds, weight = _of_file(options, observations), (None, None), given.frame_weight(options)
        landscape = None
    sigma = given.length("--sigma", options.sigma)
    if sigma is not None:
        observations = replace(observations, sigma=np.array(sigma))
    asked = (given.clamp(options.clamp_start), given.clamp(options.clamp_end))
    kinds = (kind if own is None else own for own, kind in zip(asked, kinds, strict=True))
    clamps = observation_clamps(observations, *kinds)
    check_experiment(observations, clamps, max(theta.weight for theta in thetas), weight)
    task = Task(observations, clamps, thetas, weight, landscape)
    _check_model(_refinement_options(options, task), task)
    return task


def _of_run(options: Namespace, run: Path, starts: int):
    """(observations, the Θ of the lowest cells, kinds of clamps, frame weight, landscape) of a run's folder."""
    from doo_ti.learning.landscape import read_landscape
    from doo_ti.learning.run_folder import read_experiment
    from doo_ti.refinement.fit import lowest_cells, theta_of_cell

    for name in MATERIAL:
        if getattr(options, name) is not None:
            raise InputError("command line", f"--{name.replace('_', '-')}", f"given, but {run} has cells to begin from",
                             "leave it out, or name a file of observations")
    experiment, landscape = read_experiment(run), read_landscape(run)
    if experiment.options.objective != "static" or experiment.options.spins:
        raise InputError(run, "objective", "a sweep of Eq. 3, or over unknown spins", "name a static one without --spins")
    up = given.up(options)
    observations = experiment.observations if up is None else replace(experiment.observations, up=up)
    height = landscape.mean_distance
    if np.isnan(height).all():  # no cell has all its rods certified: those with most of them do to begin from
        few = landscape.unsound == landscape.unsound.min()
        height = np.where(few, landscape.sums.distance_of_sound, np.nan)
    cells = lowest_cells(experiment.grid, height, starts)
    if not len(cells):
        raise InputError(run, "distance_mm", "no cell has an error", "look at the rods' status in cells/")
    thetas = tuple(theta_of_cell(experiment.grid, cell, observations.up) for cell in cells)
    return (observations, thetas, (experiment.options.clamp_start, experiment.options.clamp_end),
            given.frame_weight(options, experiment.options.frame_weight), landscape)


def _of_file(options: Namespace, observations: Observations) -> tuple:
    """The one Θ that the command line names."""
    from doo_ti.refinement.fit import theta_of_cell

    grid = given.single_cell(options, "give one, or refine the run of a sweep")
    return (theta_of_cell(grid, 0, observations.up),)


def _refinement_options(options: Namespace, task: Task):
    from doo_ti.refinement.refine import RefinementOptions

    names = [name.strip().replace("-", "_") for name in options.parameters.split(",") if name.strip()]
    curvature = options.rest_curvature
    for name, own in OLD_CURVATURES.items():
        if name in names:
            names.remove(name)
            curvature = curvature or own
    spread = _positive("--curvature-spread", options.curvature_spread, "a curvature in 1/mm")
    reach = given.length("--curvature-range", options.curvature_range)
    for option, value in (("--curvature-spread", spread), ("--curvature-range", reach)):
        if value is not None and not LEAST <= value <= 1 / LEAST:
            raise InputError("command line", option, f"{value:g}", f"give {LEAST:g} to {1 / LEAST:g}")
    return RefinementOptions(
        tuple(names), None if options.clip == "unknown" else given.length("--clip", options.clip), curvature or "field",
        options.clamps, task.frame_weight,
        curvature_spread=spread, curvature_range=reach,
        edges=given.whole("--edges", options.edges, 6), models=not options.no_models)


def _check_model(chosen, task: Task) -> None:
    """Raise InputError for options that do not fit the observations or each other, before anything is relaxed."""
    from doo_ti.refinement.held_rod import HeldRod
    from doo_ti.refinement.refine import FEWEST_EDGES, check
    from doo_ti.refinement.unknowns import Unknowns

    check(task.observations, chosen)
    rod = HeldRod(task.observations, task.clamps, FEWEST_EDGES)
    unknowns = Unknowns(rod, chosen.parameters, chosen.clip is None, chosen.curvature)
    unknowns.begun(task.thetas[0], unknowns.clip_prior)


def _positive(option: str, text: str | None, wanted: str) -> float | None:
    values = given.numbers(option, text)
    if text is not None and (len(values) != 1 or not values[0] > 0):
        raise InputError("command line", option, f"{text!r} is not a positive number", f"give {wanted}")
    return values[0] if values else None


def _groups(text: str | None, observations: Observations) -> np.ndarray:
    """(D,) which observations belong together; by default none do."""
    if text is None:
        return np.arange(observations.count)
    path, _, key = text.rpartition(":")
    if not path:
        raise InputError("command line", "--groups", f"{text!r} names no key", "give FILE.npz:KEY")
    content = read_content(Path(path), remedy="name a readable .npz file")
    groups = read_npz(Path(path), content, (key,)).get(key)
    if groups is None:
        raise InputError(path, key, "the key is missing", "name one that the file has")
    if groups.dtype.kind not in "biufU" or groups.dtype.kind == "f" and not np.isfinite(groups).all():
        raise InputError(path, key, f"dtype {groups.dtype}, or not finite", "give a number for each observation")
    if groups.shape != (observations.count,):
        raise InputError(path, key, f"shape {groups.shape}", f"give ({observations.count},), one per observation")
    return groups
