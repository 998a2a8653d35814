"""Goals that no straight motion of the grippers reaches, and how often and how fast ``plan_manipulation`` finds a way.

    python tools/studies/planner_study.py [KIND ...] [--goals N] [--seed S] [--seconds S]

Rods of 330 mm between two grippers that wander: LEGS random straight motions, each followed by the package's own journeys,
without a jump. Where the rod ends is the goal, if a straight motion from the beginning does not lead there. Kinds:

    branch  where the walk has led
    same    the grippers go back to where they began, and the rod has become another equilibrium under the same poses
    poles   two poles stand near the rod, which may touch them

A way that the planner calls reached is judged once more: followed by ``predict`` at a quarter of its sub-step, certified,
without a jump, and no deeper in an obstacle than the tolerance. Axes: B rods, M tasks.
"""

import argparse
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from doo_ti import Capsule, ManipulationPath, PlanOptions, Surroundings, Targets, plan_manipulation, predict, relax
from doo_ti.manipulation.model import moved, put_rows
from doo_ti.motion.journey import Journey
from doo_ti.motion.path import LARGEST_TURN, motion_between
from doo_ti.rod.types import Clamps, Configuration, Material, put_rods
from tools.studies.servo_tasks import BEND, LENGTH, TAUT, tasks

LEGS = 6
MOVE = np.repeat([60.0, 0.7, 60.0, 0.7], 3)  # standard deviations of a leg's motion, mm and rad
RADIUS, POLE = 1.5, 8.0
DRAWN = {"branch": 12, "same": 12, "poles": 5}  # rods that wander for each goal that is kept
DIFFERENT = 0.02  # of the rod's length, by which two equilibria differ at least
DEEP = 2e-3  # of the rod's radius, the tolerance of gaps with a margin for rods between moments
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Task:
    """A rod at rest under its grippers' poses, (1, V, 3) mm the goal, and what stands around."""

    rod: Configuration
    clamps: Clamps
    goal: np.ndarray
    around: Surroundings


def carried(rods: Configuration, clamps: Clamps, goal: Clamps, around: Surroundings) -> tuple[Configuration, np.ndarray]:
    """The B rods after a straight motion, and which (B,) followed it without a jump."""
    journey = Journey(motion_between(clamps, goal), Material(BEND, BEND), LARGEST_TURN, rods.rest_length, UP,
                      surroundings=around)
    solution, jumps = journey.end(rods)
    return solution.configuration, solution.converged & solution.stable & (jumps == 0)


def poles(rods: Configuration, random: np.random.Generator) -> Surroundings:
    """Two upright ones near each rod, at 20 to 80 mm from it in some direction."""
    count = rods.count
    bodies = []
    for _ in range(2):
        middle = rods.vertices[np.arange(count), random.integers(4, rods.edges - 4, size=count)]
        angle = random.uniform(0, 2 * np.pi, count)
        foot = middle + random.uniform(20.0, 80.0, (count, 1)) * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
        bodies.append(Capsule(foot - 600.0 * UP, foot + 600.0 * UP, POLE))
    return Surroundings(bodies, RADIUS)


def goals(kind: str, count: int, seed: int) -> list[Task]:
    """``count`` tasks from a seed."""
    random = np.random.default_rng(seed)
    own = tasks(DRAWN[kind] * count, seed)
    clamps, rest = own.clamps, relax(own.rods, Material(BEND, BEND), own.clamps)
    rods, sound = rest.configuration, rest.converged & rest.stable
    around = poles(rods, random) if kind == "poles" else Surroundings()
    if around:
        sound &= around.smallest_gap(rods.vertices) > 0
    rows = np.flatnonzero(sound)
    rods, clamps, around = rods.take(rows), clamps.take(rows), around.take(rows)
    here, there = rods, clamps
    for leg in range(LEGS + (kind == "same")):
        goal = clamps if leg == LEGS else moved(there, MOVE * random.normal(size=(rods.count, 12)))
        after, sound = carried(here, there, goal, around)
        sound &= np.linalg.norm(goal.end_position - goal.start_position, axis=1) < TAUT * LENGTH
        rows = np.flatnonzero(sound)  # others rest
        here, there = put_rods(here, rows, after.take(rows)), put_rows(there, rows, goal.take(rows))
    direct, follows = carried(rods, clamps, there, around)
    apart = np.linalg.norm(direct.vertices - here.vertices, axis=-1).max(axis=1)
    sound |= kind != "same"  # others rested on their last leg
    rows = np.flatnonzero(sound & (~follows | (apart > DIFFERENT * LENGTH)))[:count]
    if len(rows) < count:
        raise RuntimeError(f"{len(rows)} of {count} goals: draw more")
    return [Task(rods.take([row]), clamps.take([row]), here.take([row]).vertices, around.take([row])) for row in rows]


def sound(task: Task, path: ManipulationPath) -> bool:
    """Whether the rod follows a path at a quarter of the sub-step, to the goal, without a jump and clear of obstacles."""
    followed = predict(task.rod, Material(BEND, BEND), task.clamps, path, sub_step=LARGEST_TURN / 4, up=UP, precision="f64",
                       **task.around.arguments)
    deepest = task.around.smallest_gap(followed.vertices[:, 0]).min() if task.around else np.inf
    return bool(followed.followed.all() and not followed.jumps.any() and deepest > -DEEP * RADIUS
                and Targets(task.goal).distance(followed.vertices[-1])[0] < 2.0)


def row(kind: str, count: int, seed: int, seconds: float) -> str:
    """A line of the table."""
    said, held, took = np.zeros(count), np.zeros(count), np.zeros((2, count))
    for number, task in enumerate(goals(kind, count, seed)):
        begin, worked = time.monotonic(), time.process_time()
        path = plan_manipulation(task.rod, Material(BEND, BEND), task.clamps, Targets(task.goal),
                                 PlanOptions(reached_mm=2.0, seconds=seconds), up=UP, **task.around.arguments)
        took[:, number] = time.monotonic() - begin, time.process_time() - worked
        said[number] = path.reached
        held[number] = path.reached and sound(task, path)
        print(number, path.reached, bool(held[number]), f"{path.distance:.2f} mm {took[0, number]:.1f} s", file=sys.stderr)
    spent = " | ".join(f"{np.median(one):.1f}, {np.quantile(one, 0.95):.1f}, {one.max():.1f}" for one in took)
    return f"| {kind} | {100 * said.mean():.0f} | {100 * held.mean():.0f} | {spent} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("kinds", nargs="*", choices=[*DRAWN, []], help="default: all")
    parser.add_argument("--goals", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=10.0)
    options = parser.parse_args()
    print("| goals | said to be reached, % | reached, as judged, % | seconds: median, 95 %, most | of processors |")
    print("|---" * 5 + "|")
    for kind in options.kinds or DRAWN:
        print(row(kind, options.goals, options.seed, options.seconds), flush=True)


if __name__ == "__main__":
    main()
