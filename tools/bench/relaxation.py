"""Benchmark of relaxations: ``python tools/bench/relaxation.py [CASE ...] [--rods N] [--rounds N] [--check | --write]``.

The cases of ``doo-ti bench``, and single rods, the paper's scheme, derivatives, motion, a servo, Eq. 1. Prints one table:
rods/s, the ratio to a NumPy workload timed in the same round, and that ratio over the baseline's. ``--check`` exits with 1
where a ratio is below half the baseline or fewer rods converge; ``--write`` makes a new baseline, on an idle machine.
"""

import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from doo_ti import Descent, Observations, Servo, ServoStatus, Targets, distance, pullback, relax
from doo_ti.dynamics.grippers import Grippers
from doo_ti.dynamics.parameters import Dynamics, Stepping
from doo_ti.dynamics.simulate import simulate
from doo_ti.lab.cases import COARSE, FINE, Case, Outcome, Specimens, relaxed
from doo_ti.lab.cases import cases as command_cases
from doo_ti.lab.workload import Rods
from doo_ti.manipulation.model import held
from doo_ti.relaxation.sensitivity import GRIPPERS
from doo_ti.rod.types import Clamp, Clamps, Configuration, Material, Solution
from tools.bench.baseline import derived, run
from tools.studies.servo_tasks import Tasks, tasks

BASELINE = Path(__file__).with_name("baseline.json")
DERIVED = 4096
STEERED, STEPS, MARKS = 1024, 6, 11


def cases(rods: Specimens) -> list[Case]:
    """All cases, those of the command first."""
    singles = cache(lambda: rods.alone(1, max(rods.count // 512, 1)))
    resting = cache(lambda: rods.many.take(slice(DERIVED)).relaxed(FINE, "f64"))
    return [
        *command_cases(rods),
        Case("newton f32 one rod", "rods/s", lambda: relaxed(singles(), COARSE, "f32")),
        Case("descent f64", "iterations/s", lambda: stepped(rods.many.take(slice(max(rods.count // 64, 1))))),
        Case("gripper jacobians", "rods/s", lambda: derived(resting())),
        Case("pullback", "rods/s", lambda: pulled_back(resting())),
        Case("motion f32", "rod-steps/s", lambda: moved(rods.count, "f32", Dynamics())),
        Case("motion f32 damped", "rod-steps/s", lambda: moved(rods.count, "f32", Dynamics(bend_damping=0.02, drag=0.1))),
        Case("motion f64 damped", "rod-steps/s", lambda: moved(rods.count, "f64", Dynamics(bend_damping=0.02, drag=0.1))),
        Case("servo", "rod-steps/s", steered),
        Case("metric", "rods/s", lambda: compared(rods.relaxed.configuration, rods.sutures[0])),
    ]


@cache
def _swinging(count: int) -> tuple[Configuration, Material, Grippers]:
    """Ropes of 1 m and 33 edges between two grippers that move, each in its own way, for 50 steps of 10 ms."""
    rng = np.random.default_rng(0)
    straight = Configuration(np.zeros((count, 3)), np.tile([1.0, 0, 0, 0], (count, 33, 1)), np.full(33, 1000.0 / 33))
    frames = np.broadcast_to(np.eye(3), (count, 3, 3))
    clamps = Clamps(Clamp.FRAME, Clamp.FRAME, np.zeros((count, 3)), np.tile([750.0, 0, 0], (count, 1)), frames, frames)
    material = Material(1e8, 1e8)
    time = 0.01 * np.arange(51)
    phase, rate = rng.uniform(0, 2 * np.pi, (count, 1)), rng.uniform(2, 6, (count, 1))
    way = 40.0 * np.stack([np.sin(rate * time + phase) - np.sin(phase), np.cos(rate * time + phase) - np.cos(phase),
                           np.sin(2 * rate * time + phase) - np.sin(phase)], axis=-1)
    resting = Grippers.resting(clamps, 51)
    moving = replace(resting, start_position=resting.start_position + way, end_position=resting.end_position - 0.5 * way)
    return relax(straight, material, clamps, precision="f32").configuration, material, moving


def moved(count: int, precision: str, dynamics: Dynamics) -> Outcome:
    """Steps of :func:`doo_ti.dynamics.simulate.simulate`, those of rods that converged throughout."""
    found = simulate(*_swinging(count), dynamics, Stepping(100.0, precision=precision))
    steps = found.status == 0
    return Outcome(float(steps.sum()), float(steps.mean()), residual=float(found.residual[steps].max()),
                   iterations=found.iterations.ravel())


def stepped(rods: Rods) -> Outcome:
    """Gradient steps of the paper's scheme, whether they were enough or not."""
    iterations = rods.relaxed(Descent(max_iterations=1000), "f64").iterations
    return Outcome(float(iterations.sum()), iterations=iterations)


def pulled_back(solution: Solution) -> Outcome:
    """Gradients of a scalar by both grippers' poses, the material, and the rest curvature of every joint."""
    parameters = (*GRIPPERS, "bend", "twist", "weight", "rest_curvature_per_joint")
    usable = pullback(solution, np.ones_like(solution.configuration.vertices), parameters).usable
    return Outcome(float(usable.sum()), float(usable.mean()))


@cache
def _watched() -> tuple[Tasks, list[np.ndarray]]:
    """Tasks, and what is seen in the first steps of a servo, which does the same each time."""
    own, random = tasks(STEERED, seed=3), np.random.default_rng(0)
    servo, plant, rods, seen = Servo(own.rods, own.nominal, own.clamps, Targets(own.goal)), own.simulation(), own.real, []
    for _ in range(STEPS):
        seen.append(own.marks(rods, MARKS, random))
        rods = plant.step(held(servo.step(seen[-1]), own.clip)).configuration
    return own, seen


def steered() -> Outcome:
    """Steps of :class:`doo_ti.manipulation.servo.Servo`, its beginning included."""
    own, every = _watched()
    servo = Servo(own.rods, own.nominal, own.clamps, Targets(own.goal))
    for seen in every:
        servo.step(seen)
    return Outcome(float(STEERED * STEPS), float((servo.status != ServoStatus.LOST).mean()))


def compared(configuration: Configuration, observations: Observations) -> Outcome:
    """Eq. 1 of all rods."""
    error = distance(configuration, observations, np.arange(configuration.count) % observations.count)
    return Outcome(float(configuration.count), float(np.isfinite(error).mean()))


def main(arguments: list[str]) -> int:
    return run(arguments, __doc__.splitlines()[0], BASELINE, "rods", 65_536, 1, lambda count: cases(Specimens(count)))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
