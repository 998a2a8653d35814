"""Benchmark of contact: ``python tools/bench/contact.py [CASE ...] [--rods N] [--rounds N] [--check | --write]``.

Heavy rods of 33 edges, both ends held, on a table with two pegs in their way, NumPy in to NumPy out. *laid down*: from straight
starts that do not meet their clamps; *moved on*: from rest on the table, with other weights and far ends moved by up to a tenth
of the span, ``relax(solution, material, clamps, …)``; *other material*: these solutions relaxed again, with other stiffness and
weight; *out of reach*: moved on, with the table and the pegs far away; *alone* and *its own obstacle*: without them, and where
no rod may pass through itself; *Jacobians*: derivatives of these rods, at rest, by the poses of both grippers.
Ratios are to a NumPy workload timed in the same round; ``--check`` and ``--write`` are those of the benchmark of relaxations.
"""

import sys
from functools import cached_property, partial
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from doo_ti import Capsule, Clamp, Clamps, Configuration, Itself, Material, Plane, Solution, Status, relax
from doo_ti.lab.cases import Case, Outcome
from doo_ti.rod.frames import matrix_from_quaternion, quaternion_about, quaternion_product
from tools.bench.baseline import derived, outcome, run

BASELINE = Path(__file__).with_name("contact.json")
SEED = 2011
LENGTH, EDGES, RADIUS = 99.0, 33, 1.0  # mm
PEGS = ((33.0, 8.0), (66.0, -8.0))
PEG_RADIUS, PEG_HEIGHT = 4.0, 60.0


def obstacles(below: float = 0.0) -> list:
    """A table so far below and its pegs."""
    pegs = [Capsule((x, y, -5.0 - below), (x, y, PEG_HEIGHT - below), PEG_RADIUS) for x, y in PEGS]
    return [Plane((0, 0, -below), (0, 0, 1)), *pegs]


class Specimens:
    """Rods that are held just above the table, with the pegs on either side."""

    def __init__(self, count: int):
        self.count = count

    @cached_property
    def laid_down(self) -> tuple[Configuration, Material, Clamps]:
        """Straight starts beside the pegs."""
        random, count = np.random.default_rng(SEED), 2 * self.count
        one = Configuration.straight(np.zeros(3), np.array([1.0, 0.0, 0.0]), LENGTH, EDGES)
        up = np.broadcast_to([0.0, 0.0, 1.0], (count, 3))
        start = np.stack([np.zeros(count), random.uniform(-5, 5, count), np.full(count, 1.02 * RADIUS)], -1)
        span = random.uniform(0.75, 0.97, count) * LENGTH
        end = start + np.stack([span, random.uniform(-10, 10, count), np.zeros(count)], -1)
        frames = [matrix_from_quaternion(quaternion_product(quaternion_about(up, random.uniform(-0.6, 0.6, count)),
                                                            one.quaternions[:, 0])) for _ in range(2)]
        stiffness = 10 ** random.uniform(4.5, 5.5, count)
        material = Material(stiffness, stiffness, random.uniform(0, 100, count) * stiffness / LENGTH**3)
        rods = Configuration(start, np.repeat(one.quaternions, count, 0), one.rest_length)
        clamps = Clamps(Clamp.FRAME, Clamp.FRAME, start, end, *frames)
        found = relax(rods, material, clamps, obstacles=obstacles(), radius=RADIUS)
        kept = np.flatnonzero(found.status != Status.INFEASIBLE)[: self.count]
        return rods.take(kept), material.take(kept), clamps.take(kept)

    @cached_property
    def moved_on(self) -> tuple[Solution, Material, Clamps]:
        """Rods at rest, whose weights and far ends then change."""
        rods, material, clamps = self.laid_down
        random = np.random.default_rng(SEED + 1)
        rest = relax(rods, material, clamps, obstacles=obstacles(), radius=RADIUS)
        material, clamps = material.take(rest.converged), clamps.take(rest.converged)
        count = len(clamps.start_position)
        other = Material(material.bend, material.twist, material.weight * random.uniform(0.8, 1.25, count))
        end = clamps.end_position - [1.0, 0.0, 0.0] * random.uniform(0, 0.1, (count, 1)) * LENGTH
        held = Clamps(Clamp.FRAME, Clamp.FRAME, clamps.start_position, end, clamps.start_frame, clamps.end_frame)
        start = rest.configuration.take(rest.converged)
        # Not those whose far end is moved into a peg.
        found = relax(start, other, held, obstacles=obstacles(), radius=RADIUS)
        kept = np.resize(np.flatnonzero(found.status != Status.INFEASIBLE), self.count)
        rest = relax(start.take(kept), material.take(kept), clamps.take(kept), obstacles=obstacles(), radius=RADIUS)
        return rest, other.take(kept), held.take(kept)

    def relaxed_again(self, precision: str) -> Solution:
        """Those at rest among the obstacles, relaxed again with stiffness and weight up to a quarter larger or smaller."""
        random, rest = np.random.default_rng(SEED + 2), self.on_table
        stiffness, weight = 1.25 ** random.uniform(-1, 1, (2, self.count))
        _, material, _ = self.moved_on
        bend = material.bend[:, 0, 0, 0] * stiffness
        return relax(rest, Material(bend, bend, material.weight * weight), precision=precision)

    def other_material(self, precision: str) -> Outcome:
        return outcome(self.relaxed_again(precision))

    def resting(self, among: list) -> Solution:
        """The rods moved on, at rest among those obstacles."""
        rods, material, clamps = self.moved_on
        return relax(rods, material, clamps, obstacles=among, radius=RADIUS)

    @cached_property
    def on_table(self) -> Solution:
        return self.resting(obstacles())

    @cached_property
    def alone(self) -> Solution:
        return self.resting([])

    def relaxed(self, which: str, precision: str, among: list) -> Outcome:
        """Rods of that name, relaxed once ``among`` obstacles."""
        rods, material, clamps = getattr(self, which)
        return outcome(relax(rods, material, clamps, precision=precision, obstacles=among, radius=RADIUS))


def cases(rods: Specimens) -> list[Case]:
    """The timed cases."""
    return [*(Case(f"{name}, {precision}", "rods/s", partial(rods.relaxed, which, precision, among))
              for name, which, among in (
                  ("laid down", "laid_down", obstacles()), ("moved on", "moved_on", obstacles()),
                  ("out of reach", "moved_on", obstacles(1e4)), ("alone", "moved_on", []),
                  ("its own obstacle", "moved_on", [Itself()]))
              for precision in ("f32", "f64")),
            *(Case(f"other material, {precision}", "rods/s", partial(rods.other_material, precision))
              for precision in ("f32", "f64")),
            Case("Jacobians, moved on", "rods/s", lambda: derived(rods.on_table)),
            Case("Jacobians, alone", "rods/s", lambda: derived(rods.alone))]


def main(arguments: list[str]) -> int:
    return run(arguments, __doc__.splitlines()[0], BASELINE, "rods", 4096, 8, lambda count: cases(Specimens(count)))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
