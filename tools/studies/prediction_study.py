"""Accuracy of predicted motions (§III-D): the lab's rotation steps, cables between two grippers, and the rate for a planner.

    python tools/studies/prediction_study.py [lab cables candidates] [--data DIR]

The lab's data ships with the tests; that of the cables does not (docs/cables.md): ``cables`` runs where --data names it.
"""

import argparse
import json
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from doo_ti import ClampPath, Observations, distance, load_observations, load_path, relax
from doo_ti.motion.journey import Journey
from doo_ti.motion.path import LARGEST_TURN, motion_between
from doo_ti.motion.predict import Prediction, predict, predict_step
from doo_ti.rod.frames import matrix_from_quaternion, quaternion_about, quaternion_from_matrix, quaternion_product
from doo_ti.rod.start import observation_clamps, start_configuration
from doo_ti.rod.types import Clamps, Material

CABLES = {"dlo1": 3.16e6, "dlo3": 4.47e7}
"""bend in mm³ at weight 1, the minimum of a sweep over the still frames (33 values over 2.4 decades; 14.07 and 15.76 mm). Twist
is not determined, because the ends may spin."""
CANDIDATES = 4096
SAME_BRANCH = 1.0  # mm: largest distance of vertices between two shapes on one branch


@dataclass(frozen=True)
class ObservedSteps:
    """P predictions from one observation to another.

    error        (P,) mm, Eq. 1 to the other observation, NaN where the rod could not follow
    own_error    (P,) mm, error of the model relaxed from the observation itself, which no prediction can avoid
    jumps        (P,) predicted jumps
    same_branch  (P,) bool: the prediction is the minimum next to the observation; else one of the two jumped and the other not
    """

    error: np.ndarray
    own_error: np.ndarray
    jumps: np.ndarray
    same_branch: np.ndarray


def predict_steps(observations: Observations, material: Material) -> ObservedSteps:
    """From each observation to that with the same end distance and the next larger end rotation; the far end is rotated."""
    order = np.lexsort((observations.end_rotation, observations.end_distance))
    along = np.diff(observations.end_distance[order]) == 0
    before, after = observations.take(order[:-1][along]), observations.take(order[1:][along])
    held, goal = observation_clamps(before), observation_clamps(after)
    turn = np.radians(after.end_rotation - before.end_rotation)
    poses = {name: np.stack([getattr(held, name), getattr(goal, name)])
             for name in ("start_position", "end_position", "start_frame", "end_frame")}
    path = ClampPath(np.array([0.0, 1.0]), end_rotation=np.stack([0 * turn, turn]), **poses)
    carried = predict(start_configuration(before, held), material, held, path, up=observations.up)
    own = relax(start_configuration(after, goal), material, goal, up=observations.up)
    apart = np.linalg.norm(carried.vertices[-1] - own.configuration.vertices, axis=-1).max(axis=1)
    error = np.where(carried.followed[-1], distance(carried.at(-1), after), np.nan)
    return ObservedSteps(error, distance(own.configuration, after), carried.jumps.sum(axis=0), apart <= SAME_BRANCH)


def predict_marks(observations: Observations, material: Material, path: ClampPath) -> Prediction:
    """Rods that start from their first marks and follow the grippers that hold their first and last edges."""
    clamps = observation_clamps(observations)
    start = start_configuration(observations, clamps)
    return predict(start, material, clamps, path, sub_step=np.radians(10.0), up=observations.up)


def moved_as_one(vertices: np.ndarray, start_shift: np.ndarray, end_shift: np.ndarray) -> np.ndarray:
    """(N, V, 3) mm: the first shape, moved by the mean displacement of its ends (N, 3)."""
    return vertices + 0.5 * (start_shift + end_shift)[:, None]


def moved_by_blend(vertices: np.ndarray, start_shift: np.ndarray, end_shift: np.ndarray, rest_length: np.ndarray) -> np.ndarray:
    """(N, V, 3) mm: each vertex moved by the displacements of the ends (N, 3), interpolated linearly along the rod (E,) mm."""
    share = np.concatenate([[0.0], np.cumsum(rest_length)]) / rest_length.sum()
    return vertices + (1 - share[:, None]) * start_shift[:, None] + share[:, None] * end_shift[:, None]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("rows", nargs="*", help="default: lab candidates")
    parser.add_argument("--data", type=Path, default=Path(__file__).resolve().parents[2] / "tests" / "data")
    options = parser.parse_args()
    rows = options.rows or ["lab", "candidates"]
    if "lab" in rows:
        lab_steps(options.data / "lab_a")
    if "cables" in rows:
        for name, bend in CABLES.items():
            cable(options.data / "cables", name, bend)
    if "candidates" in rows:
        candidates(options.data / "lab_a")


def lab_steps(folder: Path) -> None:
    """Each observation from the one before it, 30° of rotation less, under the true Θ."""
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    print("| 30° steps | steps | mean mm | median mm | largest mm | own minimum's mean mm | predicted jumps "
          "| on another branch | lost |")
    print("|---" * 9 + "|")
    for name, theta in truth.items():
        observations = load_observations(folder / f"{name}.npz")
        steps = predict_steps(observations, Material(np.array(theta["bend"]), theta["twist"]))
        error = steps.error
        print(f"| {name} | {len(error)} | {np.nanmean(error):.3f} | {np.nanmedian(error):.3f} | {np.nanmax(error):.2f} "
              f"| {steps.own_error.mean():.3f} | {int(steps.jumps.sum())} | {int((~steps.same_branch).sum())} "
              f"| {int(np.isnan(error).sum())} |")


def cable(folder: Path, name: str, bend: float) -> None:
    """The last frame of each sequence, predicted from the first and the grippers' path."""
    still = load_observations(folder / f"{name}.npz")
    path = load_path(folder / f"{name}_motion.npz")
    with np.load(folder / f"{name}_motion.npz") as file:
        marks = file["positions_mm"].astype(float)
    first, last = (Observations(marks[:, moment], rest_length=still.rest_length, name=name) for moment in (0, -1))
    prediction = predict_marks(first, Material(bend, bend), path)
    shifts = (marks[:, -1, 0] - marks[:, 0, 0], marks[:, -1, -1] - marks[:, 0, -1])
    guesses = {"as one": moved_as_one(first.vertices, *shifts),
               "blend": moved_by_blend(first.vertices, *shifts, still.rest_length)}
    off = distance(prediction.at(-1), last)
    print(f"\n| {name}, bend {bend:g} | model at first | predicted mm | "
          + " | ".join(f"{guess} mm" for guess in guesses) + " | beaten | jumps | followed |")
    print("|---" * (6 + len(guesses)) + "|")
    errors = {guess: np.linalg.norm(shape - last.vertices, axis=-1).sum(axis=1) / still.edges
              for guess, shape in guesses.items()}
    started = distance(prediction.at(0), first)
    for stretch in range(len(off)):
        others = [error[stretch] for error in errors.values()]
        print(f"| stretch {stretch} | {started[stretch]:.1f} | **{off[stretch]:.1f}** | "
              + " | ".join(f"{error:.1f}" for error in others)
              + f" | {'both' if off[stretch] < min(others) else 'no'} | {prediction.jumps[:, stretch].sum()} "
              f"| {'yes' if prediction.followed[-1, stretch] else 'no'} |")


def candidates(folder: Path) -> None:
    """Rods per second and sub-step over many end motions of one rod, kernels compiled."""
    observations = load_observations(folder / "vicryl.npz").take([14])
    clamps, material = observation_clamps(observations), Material(6e5, 8e5)
    rod = relax(start_configuration(observations, clamps), material, clamps).configuration
    goal = _end_motions(clamps)
    motion = motion_between(clamps.take(np.zeros(CANDIDATES, dtype=int)), goal)
    each = Journey(motion, material, LARGEST_TURN, rod.rest_length).sub_steps
    steps = each.sum() / CANDIDATES
    print(f"\n{CANDIDATES} end motions of one rod, up to 10 mm and 10°, {each.min()} to {each.max()} sub-steps")
    for watch in (True, False):
        seconds = []
        for _ in range(12):
            began = time.perf_counter()
            solution, jumps = predict_step(rod, material, clamps, goal, watch=watch)
            seconds.append(time.perf_counter() - began)
        rate = CANDIDATES * steps / np.array(seconds[1:])
        found = f", {int(jumps.sum())} jumps" if watch else ""
        print(f"  jumps {'detected' if watch else 'not detected'}: median {np.median(rate):,.0f}, best {rate.max():,.0f} "
              f"rods/s per sub-step; {int(solution.converged.sum())} converged{found}")


def _end_motions(clamps: Clamps) -> Clamps:
    random = np.random.default_rng(2011)
    rows = np.zeros(CANDIDATES, dtype=int)
    shift, axis = (vector / np.linalg.norm(vector, axis=1)[:, None] for vector in random.normal(size=(2, CANDIDATES, 3)))
    size = random.random((2, CANDIDATES))
    turn = quaternion_about(axis, np.radians(10.0) * size[0])
    frame = matrix_from_quaternion(quaternion_product(turn, quaternion_from_matrix(clamps.end_frame[rows])))
    still = clamps.take(rows)
    return Clamps(clamps.start, clamps.end, still.start_position, still.end_position + 10.0 * size[1][:, None] * shift,
                  still.start_frame, frame)


if __name__ == "__main__":
    main()
