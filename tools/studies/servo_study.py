"""Rods brought to random shapes by ``Servo`` and by a learned Jacobian: distances, what is learned, snaps.

    python tools/studies/servo_study.py [PLANT ...] [--cameras] [--tasks N] [--seed S] [--steps N]

Rods of 330 mm between two grippers; the goal is the shape of the true rod after a random move of the grippers. The model's
stiffness is off by a log-normal factor of 0.4 in bend and in twist over bend; eleven marks are seen with 0.3 mm of noise. The
other controller learns its Jacobian on the way: Broyden's rank-one update, begun with that of the nominal model.

With --cameras three virtual cameras render each rod, one covered in a third of the moments, and what is tracked in their images
is seen instead of the marks; the learned Jacobian is left out.

PLANT: own, far (one gripper moves), finer, clips, curved, all. Axes: B tasks.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from doo_ti import Camera, Newton, Rig, Servo, ServoOptions, Targets, gripper_jacobian, relax
from doo_ti.manipulation.damped_steps import DampedSteps
from doo_ti.manipulation.model import held, moved
from doo_ti.perception.virtual_lab import TRACKED_NOISE, VirtualCameras
from tests.vision.scenes import looking
from tools.studies.servo_tasks import BEND, LENGTH, Plant, Tasks, tasks

PLANTS = {"own": Plant(), "far": Plant(), "finer": Plant(finer=3), "clips": Plant(clip_mm=0.7, clip_deg=2.0),
          "curved": Plant(curvature=6e-4), "all": Plant(3, 0.7, 2.0, 6e-4)}
MARKS, NEAR = 11, 2.0
SNAP = 0.25  # a rod has snapped where a step moves a vertex by more than so much of its length
VIEWS = {"front": (0.0, 1.0, -0.3), "beside": (-0.8, 0.6, -0.3), "above": (0.3, 0.3, -1.0)}
"""Directions in which three cameras look at the middle of the rods, from FAR mm away."""
MIDDLE, FAR = (100.0, 0.0, -60.0), 900.0
COVERED = {"front": 1 / 3}  # share of the moments at which something hides everything from a camera


class Broyden:
    """The learned Jacobian: of the marks by the grippers' coordinates, from the nominal model, corrected after each step by
    what was seen; it has no model of the rod besides, and rests where nothing is seen."""

    def __init__(self, own: Tasks, options: ServoOptions):
        self.clamps, self._options = own.clamps, options
        nominal = relax(own.rods, own.nominal, own.clamps, Newton.careful())
        columns = np.nan_to_num(gripper_jacobian(nominal).vertices)
        self._jacobian = columns.reshape(own.count, -1, 12) * (options.moves / options.scale)
        self._goal, self._step, self._before = own.goal.reshape(own.count, -1), None, None

    def step(self, seen: np.ndarray):
        """The grippers' next poses."""
        marks = np.nan_to_num(seen).reshape(len(seen), -1)
        visible = np.isfinite(seen).reshape(len(seen), -1)
        if self._step is not None:
            missed = np.where(visible, marks - self._before - (self._jacobian @ self._step[..., None])[..., 0], 0.0)
            size = np.maximum(np.sum(self._step**2, axis=1), 1.0)[:, None, None]
            self._jacobian = self._jacobian + missed[..., None] * self._step[:, None] / size
        across = np.swapaxes(self._jacobian * visible[..., None], 1, 2) / np.maximum(visible.sum(axis=1), 1)[:, None, None]
        error = np.where(visible, self._goal - marks, 0.0)[..., None]
        steps = DampedSteps(3 * across @ self._jacobian, 3 * (across @ error)[..., 0])
        whole = np.ones(len(seen))
        self._step = steps.below(self._options.step_mm * whole, 0.0 * steps.gradient, whole)
        self._before = marks
        self.clamps = moved(self.clamps, self._step / self._options.scale)
        return self.clamps


def by_marks(own: Tasks, seed: int):
    """What is seen of true rods: some marks, with noise."""
    random = np.random.default_rng(seed)
    return lambda rods, clamps: own.marks(rods, MARKS, random)


def by_cameras(own: Tasks, seed: int):
    """What is seen of true rods: what three cameras track with the nominal material; nothing of rods without equilibrium."""
    matrix = np.array([[900.0, 0.0, 319.5], [0.0, 900.0, 239.5], [0.0, 0.0, 1.0]])
    rig = Rig(tuple(Camera(name, 640, 480, matrix, np.zeros(5), *looking(np.array(view) / np.linalg.norm(view), FAR, MIDDLE))
                    for name, view in VIEWS.items()))
    watching = [VirtualCameras(rig, own.rods.rest_length, own.nominal.take([row]), covered=COVERED, seed=seed + row)
                for row in range(own.count)]

    def see(rods, clamps):
        seen = np.full_like(own.vertices(rods), np.nan)
        for row in np.flatnonzero(np.isfinite(rods.vertices).all(axis=(1, 2))):
            seen[row] = watching[row].see(rods.vertices[row], clamps.take([row])).seen
        return seen

    return see


def run(own: Tasks, controller, steps: int, see) -> tuple[np.ndarray, int]:
    """(steps, B) mm, mean distances of the true rods to their goals, NaN of rods that are lost; and how often one snapped."""
    simulation, distances, snaps = own.simulation(), [], 0
    before = own.vertices(simulation.state.configuration)
    for _ in range(steps):
        seen = see(simulation.state.configuration, controller.clamps)
        state = simulation.step(held(controller.step(seen), own.clip))
        now = own.vertices(state.configuration)
        snaps += int((np.linalg.norm(now - before, axis=-1).max(axis=1) > SNAP * LENGTH).sum())
        distances.append(np.linalg.norm(now - own.goal, axis=-1).mean(axis=1))
        before = now
    return np.array(distances), snaps


def row(name: str, count: int, seed: int, steps: int, cameras: bool = False) -> str:
    """A line of the table for one plant."""
    both = name != "far"
    own = tasks(count, seed, PLANTS[name], both)
    free = ServoOptions.free if both else ("end_shift", "end_turn")
    options = ServoOptions(free, noise_mm=TRACKED_NOISE * LENGTH if cameras else ServoOptions.noise_mm)
    servo = Servo(own.rods, own.nominal, own.clamps, Targets(own.goal), options)
    distances, snaps = run(own, servo, steps, (by_cameras if cameras else by_marks)(own, seed))
    learned, true = servo.material, BEND * own.factors[0]
    inside = [np.mean((interval[:, 0] <= value) & (value <= interval[:, 1])) for interval, value in (
        (learned.bend_interval, true), (learned.ratio_interval, own.factors[1]))]
    width = np.median(np.log(learned.bend_interval[:, 1] / learned.bend_interval[:, 0])) / 2
    far = np.linalg.norm(own.vertices(own.real) - own.goal, axis=-1).mean()
    moments = distances[[steps // 3 - 1, 2 * steps // 3 - 1, -1]]
    within = [f"{share:.1f}" for share in 100 * np.mean(moments < NEAR, axis=1)]
    line = (f"| {name} | {12 if both else 6} | {far:.0f} | {np.nanmedian(distances[-1]):.2f} | {', '.join(within)} "
            f"| {100 * inside[0]:.0f}, {100 * inside[1]:.0f} | ±{100 * width:.0f} | {snaps} |")
    if cameras:
        return line + " – | – | – |"
    other, other_snaps = run(own, Broyden(own, options), steps, by_marks(own, seed))
    return line + f" {np.nanmedian(other[-1]):.2f} | {100 * np.mean(other[-1] < NEAR):.1f} | {other_snaps} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("plants", nargs="*", choices=[*PLANTS, []], help="default: all")
    parser.add_argument("--cameras", action="store_true", help="see rods in rendered images, instead of marks")
    parser.add_argument("--tasks", type=int, default=200)
    parser.add_argument("--seed", type=int, default=11)
    parser.add_argument("--steps", type=int, default=30)
    options = parser.parse_args()
    print("| plant | degrees | first mm | median mm | under 2 mm after a third, two thirds, all steps, % "
          "| bend, ratio inside 95 %, % | bend % | snaps | Broyden: median mm | under 2 mm, % | snaps |")
    print("|---" * 11 + "|")
    for name in options.plants or PLANTS:
        print(row(name, options.tasks, options.seed, options.steps, options.cameras), flush=True)


if __name__ == "__main__":
    main()
