"""Grippers that bring a rod to a target (§VI): ``doo-ti steer`` plans their motion; what ``doo-ti servo`` shares with it."""

from argparse import Namespace
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from doo_ti.commands import loading
from doo_ti.commands import options as given
from doo_ti.commands.moving_rods import curved, settled
from doo_ti.commands.results import report
from doo_ti.contact.surroundings import Surroundings
from doo_ti.io.arrays import AXES, checked_arrays, frame_columns, read_npz
from doo_ti.io.motion_file import ClampPath
from doo_ti.rod.observations import Observations
from doo_ti.rod.physical_units import UNITS_IN_MM
from doo_ti.rod.start import check_experiment, observation_clamps
from doo_ti.rod.types import Clamp, Clamps, Material, Solution
from doo_ti.system.errors import InputError
from doo_ti.system.files import read_content, write_text
from doo_ti.system.terminal import busy, in_line, warn

MOST_SECONDS = 3600.0
"""Of a search."""
REACHED = 2.0
"""mm, default distance to the target at which it is reached."""


def declare(add) -> None:
    parser = given.command(add, "steer", run, "plan a motion of both grippers that brings a rod to a shape (§VI)")
    add_steered(parser)
    parser.add_argument("--out", required=True, metavar="PATH.csv", help="file to write, which predict --motion reads")
    parser.add_argument("--reached", metavar="MM", help=f"distance at which the target is reached (default {REACHED:g})")
    parser.add_argument("--seconds", metavar="S", help="longest search (default 10)")
    parser.add_argument("--seed", metavar="N", help="of the search's random numbers (default 0)")


def run(options: Namespace) -> int:
    out = given.output_file(options.out, ".csv")
    reached, seconds = given.length("--reached", options.reached), given.positive("--seconds", options.seconds, "s")
    if seconds is not None and seconds > MOST_SECONDS:
        raise InputError(given.SOURCE, "--seconds", f"{options.seconds}", f"give at most {MOST_SECONDS:g}")
    seed = given.whole("--seed", options.seed, 0, 2**31 - 1)
    rod = steered_rod(options, [out])

    from doo_ti.manipulation.plan import PlanOptions, plan_manipulation
    from doo_ti.manipulation.targets import Targets

    chosen = PlanOptions(reached_mm=reached or REACHED, seconds=seconds or PlanOptions.seconds, seed=seed or 0)
    with busy("planning (kernels are compiled once on a machine)"):
        start, held = rod.at_rest()
        path = plan_manipulation(start.configuration, rod.material, held, Targets(rod.places), chosen, up=rod.observations.up,
                                 **rod.surroundings.arguments)
    out.parent.mkdir(parents=True, exist_ok=True)
    write_text(out, path_table(path))
    if not path.reached:
        warn_not_reached(options, f"the path ends {path.distance:.3g} mm from it, at the nearest shape that was found")
    summary = {"reached": path.reached, "distance_mm": path.distance, "moments": path.moments, "seconds": path.time[-1],
               "out": str(out)}
    report(options, summary, lambda: [
        f"{rod.observations.name}: target {'reached' if path.reached else 'not reached'}, {path.distance:.3g} mm from it "
        "(root mean square)", f"  path        {path.moments} moments, certified stable, without a jump",
        loading.rod_line(rod.observations), f"  written to {in_line(out)}"])
    return 0


# --- shared with servo ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class SteeredRod:
    """A rod, how it is held where it begins, and (1, V, 3) mm the ``places`` where its vertices shall be, NaN where nothing is
    asked. ``source`` is the file that it is of."""

    source: str
    observations: Observations
    clamps: Clamps
    material: Material
    surroundings: Surroundings
    places: np.ndarray

    def at_rest(self) -> tuple[Solution, Clamps]:
        """The rod at the start, and its grippers, which hold frames from there on: where the file has none, those of the rod
        that rolls freely. Raises InputError where it has no stable equilibrium."""
        from doo_ti.relaxation.relax import relax
        from doo_ti.rod.shapes import end_clamps

        begin = settled(self.observations, self.clamps, self.material, self.surroundings)
        start = relax(begin, self.material, self.clamps, up=self.observations.up, **self.surroundings.arguments)
        if not (start.converged & start.stable).all():
            raise InputError(self.source, "vertices_mm", "observation 0 has no stable equilibrium",
                             "give a rod that is held within its length")
        return start, end_clamps(start.configuration, Clamp.FRAME, Clamp.FRAME)


def add_steered(parser) -> None:
    """START, TARGET, and the options of the rod."""
    parser.add_argument("start", metavar="START.npz", help=f"the rod as it is, in row 0: {loading.FORMATS}")
    parser.add_argument("--target", required=True, metavar="TARGET.npz",
                        help="vertices_mm (1, V, 3), where vertices shall be; NaN where nothing is asked")
    given.add_material(parser, "one number each", given.SHAPE_ONLY, round_rod=True)
    given.add_clamps(parser)
    given.add_obstacles(parser, "without friction")
    loading.add_loading(parser, "START and TARGET")


def steered_rod(options: Namespace, written: Iterable[Path]) -> SteeredRod:
    """What :func:`add_steered` describes. Raises InputError for whatever is wrong with it, and for files to be ``written`` that
    are read."""
    surroundings = given.surroundings(options)
    if surroundings.rub:
        raise InputError(options.obstacles, "friction", "given, but steered rods know none", "leave it out")
    grid = given.round_cell(options, "steered")
    observations = loading.load(options, options.start).take(np.zeros(1, dtype=np.int64))
    for out in written:
        given.refuse_overwriting(out, options.start, options.target)
    places = _target(options, observations)
    clamps = observation_clamps(observations, *given.clamps(options))
    for end, kind in (("start", clamps.start), ("end", clamps.end)):
        if (np.asarray(kind) < Clamp.TANGENT).any():
            raise InputError(given.SOURCE, f"--clamp-{end}", Clamp(int(np.max(kind))).name.lower(), "give tangent or frame")
    check_experiment(observations, clamps, grid.axes[-1].values[-1], 0.0)
    material = curved(options, grid.materials(), observations.rest_length)
    loading.warn(observations, surroundings)
    return SteeredRod(options.start, observations, clamps, material, surroundings, places)


def warn_not_reached(options: Namespace, rest: str) -> None:
    """Say that the target is not reached; ``rest`` says what is instead."""
    warn(f"{in_line(options.target)}: the target is not reached; {rest}")


def _target(options: Namespace, observations: Observations) -> np.ndarray:
    """(1, V, 3) mm."""
    path = Path(options.target)
    if path.suffix != ".npz":
        raise InputError(path, "file", f"suffix {path.suffix!r}", "name a .npz file with vertices_mm")
    arrays = read_npz(path, read_content(path), ("vertices_mm",))
    if "vertices_mm" not in arrays:
        raise InputError(path, "vertices_mm", "missing", "give (1, V, 3) mm, NaN where nothing is asked")
    places = arrays["vertices_mm"]
    missing = np.isnan(places) if places.dtype.kind == "f" else np.zeros(places.shape, dtype=bool)
    places = checked_arrays(path, {"vertices_mm": np.where(missing, 0, places) if missing.any() else places})["vertices_mm"]
    wanted = (1, observations.edges + 1, 3)
    if places.shape != wanted:
        raise InputError(path, "vertices_mm", f"shape {places.shape}", f"give {wanted}, as START has vertices")
    places = np.where(missing, np.nan, places)
    if not np.isfinite(places).all(axis=-1).any():
        raise InputError(path, "vertices_mm", "NaN everywhere", "give at least one vertex a place")
    return places if options.unit is None else places * UNITS_IN_MM[options.unit]


def path_table(path: ClampPath) -> str:
    """The path of the grippers of one rod as CSV, which ``predict --motion`` reads."""
    names, columns = ["time_s"], [path.time[:, None]]
    for end in ("start", "end"):
        names += [f"{end}_{axis}_mm" for axis in AXES] + list(frame_columns(f"{end}_frame"))
        columns += [getattr(path, f"{end}_position")[:, 0], getattr(path, f"{end}_frame")[:, 0].reshape(path.moments, 9)]
    rows = np.concatenate(columns, axis=1)
    return "\n".join([",".join(names), *(",".join(repr(float(value)) for value in row) for row in rows)]) + "\n"
