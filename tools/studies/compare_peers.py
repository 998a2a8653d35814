"""Other simulators on the same rods, side by side in one run.

    pip install '.[peers]' && python tools/studies/compare_peers.py [--quick]

At rest: rods between two ends held by position and tangent (peers/problem.py), each peer from the same start: MuJoCo,
PyElastica and Newton. In motion: a rod swings (peers/swinging.py). Prints a table of each; docs/compared.md says what they
mean. Peers that are not installed are listed as left out.
"""

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from doo_ti import InputError, Material, Newton
from doo_ti.lab import workload
from doo_ti.lab.workload import Rods
from tools.studies.peers import capsules, cosserat, flex, swinging
from tools.studies.peers.problem import BEND, Problem, problem, strain

COUNT = 4096
STEPS = (2e-3, 5e-4)  # s, of MuJoCo
RADII = (2e-3, 5e-4)  # m, of PyElastica's rods: they determine its steps
NEWTON_STEPS = (2e-3, 1e-3)  # s, of Newton
ROUNDS = 3


@dataclass(frozen=True)
class Row:
    """A line of the table at rest: µs of processor for each rod; the residual in the peer's own terms; the largest strain of an
    edge; and mm from the references in f64, on the same mesh and on one 15 times finer."""

    name: str
    microseconds: float
    residual: str
    strain: float
    same_mesh: float
    continuum: float


def here(task: Problem, precision: str) -> Row:
    """The rods of the task in turn, COUNT of them in one call."""
    rows, same = np.arange(COUNT) % task.start.count, np.zeros(COUNT, dtype=np.int64)
    rods = Rods(task.start, task.clamps, Material(BEND, BEND), rows, same)
    rods.relaxed(Newton(), precision)
    taken = swinging.seconds(lambda: rods.relaxed(Newton(), precision), ROUNDS)
    solution = rods.relaxed(Newton(), precision)
    vertices = solution.configuration.vertices[: task.start.count]
    return Row(f"this package, {precision}, {rods.count} rods", 1e6 * taken / rods.count,
               f"{solution.residual.max():.0e}", strain(vertices), *task.apart(vertices))


def moving(task: Problem, name: str, peer, size: float) -> Row:
    """Of a peer whose rods move until they rest; ``size``: its step, or whatever else its precision depends on."""
    vertices, taken, speed = peer.settled(task, size)
    return Row(name, 1e6 * taken, f"{1e3 * speed:.0e} mm/s", strain(vertices), *task.apart(vertices))


def at_rest(quick: bool) -> tuple[list[Row], list[str]]:
    """The rows, and the peers that are left out."""
    task, left_out = problem(), []
    rows = [here(task, precision) for precision in ("f32", "mixed", "f64")]
    for name, peer, sizes, about in (
            ("MuJoCo", flex, STEPS, "flex, steps of {:g} ms, one rod"),
            ("PyElastica", cosserat, RADII, "radius {:g} mm, one rod"),
            ("Newton", capsules, NEWTON_STEPS, f"VBD, steps of {{:g}} ms, {task.start.count} rods")):
        try:
            for size in sizes[: 1 if quick else None]:
                rows.append(moving(task, f"{name}, {about.format(1e3 * size)}", peer, size))
                print(rows[-1], file=sys.stderr, flush=True)
        except (ImportError, InputError) as error:
            left_out.append(f"{name}: {error}")
    return rows, left_out


def table(rows: list[Row]) -> list[str]:
    lines = ["| simulator | µs of processor a rod | residual | largest strain | from f64, same mesh, mm "
             "| from the continuum, mm | times the first row |", "|---" * 7 + "|"]
    for row in rows:
        lines.append(f"| {row.name} | {row.microseconds:,.1f} | {row.residual} | {row.strain:.0e} | {row.same_mesh:.2g} "
                     f"| {row.continuum:.2g} | {row.microseconds / rows[0].microseconds:,.0f} |")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="one step of each, without motion")
    options = parser.parse_args()
    machine = workload.machine()
    rows, left_out = at_rest(options.quick)
    print(f"{machine['processor']}, {machine['cores']} cores. At rest:\n", *table(rows), sep="\n")
    print("", *(f"Left out: {one}." for one in left_out), sep="\n")
    if not options.quick:
        print("In motion:\n", *swinging.table(), sep="\n")


if __name__ == "__main__":
    main()
