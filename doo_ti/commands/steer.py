"""Paths of both grippers that bring a rod to a target (§VI)."""

from argparse import Namespace

from doo_ti.commands import loading
from doo_ti.commands import options as given
from doo_ti.commands.results import report
from doo_ti.commands.steered import add_steered, path_table, steered_rod, warn_not_reached
from doo_ti.system.errors import InputError
from doo_ti.system.files import write_text
from doo_ti.system.terminal import busy, in_line

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


def run(options: Namespace, words: list[str]) -> int:
    """Plan the motion, write it, and print whether it reaches the target."""
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
