"""Success rate of Eq. 4 (§V-F, Fig. 7): a table over D = 1 … 6, and the histogram as a PNG.

    python tools/twist_study.py --runs RUNS --data ../shared/data/lab_a --out FOLDER

RUNS/MATERIAL holds the sweep of each material (`doo-ti sweep lab_a/MATERIAL.npz --bend 5e4:1e7:25 --twist-ratio 0.1:6:25`), of
which the best cell counts. With --perceived SHAPES the marks are those of rods that `doo-ti perceive` recovered from images
of scenes/MATERIAL.toml, SHAPES/MATERIAL.npz; then RUNS/MATERIAL is the sweep of that scene.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import Progress

if not __package__:
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from doo_ti.io.files import write_whole  # noqa: E402
from doo_ti.io.observations import Observations, load_observations  # noqa: E402
from doo_ti.io.scene import load_scene  # noqa: E402
from doo_ti.learning.landscape import read_landscape  # noqa: E402
from doo_ti.synthesis import synthesise  # noqa: E402
from doo_ti.twist.estimation import TwistVerdict  # noqa: E402
from tools.trials.twist import SUCCESS, twist_trials  # noqa: E402
from tools.trials.twist_picture import angle_errors_picture  # noqa: E402

SCENES = Path(__file__).resolve().parents[1] / "scenes"
MATERIALS = ("nylon", "vicryl", "silk")
PAPER = {1: "53.3 %", 6: "80 %"}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=Path, required=True)
    parser.add_argument("--data", type=Path, default=Path(__file__).resolve().parents[2] / "shared" / "data" / "lab_a")
    parser.add_argument("--perceived", type=Path, help="folder of what doo-ti perceive wrote, by material")
    parser.add_argument("--trials", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=2011)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    found = {}
    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("trials", total=6 * len(MATERIALS))
        for together in range(1, 7):
            found[together] = [_trials(options, material, together, lambda: bar.advance(task)) for material in MATERIALS]
    print(f"{options.trials} trials per material and D, seed {options.seed}; Θ is the static minimum of each material's sweep")
    print("| D | " + " | ".join(MATERIALS) + " | all | paper | median error | ambiguous | failed of these "
          "| failed of the clear | undetermined | unsound rods |")
    print("|---" * (len(MATERIALS) + 9) + "|")
    for together, trials in found.items():
        success = [one.successful.mean() for one in trials]
        error = np.degrees(np.concatenate([one.error for one in trials]))
        verdict, failed = (np.concatenate(parts) for parts in (
            [one.estimate.verdict for one in trials], [~one.successful for one in trials]))
        print(f"| {together} | " + " | ".join(f"{100 * share:.1f} %" for share in success)
              + f" | **{100 * np.mean(success):.1f} %** | {PAPER.get(together, '')} | {np.nanmedian(error):.0f}° "
              f"| {np.mean(verdict == TwistVerdict.AMBIGUOUS):.1%} | {_share(failed, verdict == TwistVerdict.AMBIGUOUS)} "
              f"| {_share(failed, verdict == TwistVerdict.CLEAR)} | {np.sum(verdict == TwistVerdict.UNDETERMINED)} "
              f"| {sum(int(one.estimate.unsound.sum()) for one in trials)} |")
    errors = {f"D = {together}": np.degrees(np.concatenate([one.error for one in trials]))
              for together, trials in found.items()}
    write_whole(options.out / "fig7.png", lambda file: angle_errors_picture(
        file, errors, success_deg=np.degrees(SUCCESS), title="Errors of the end frame's rotation, all threads (Fig. 7)"))
    print(f"written to {options.out / 'fig7.png'}")


def _trials(options, material: str, together: int, done):
    observations, total_twist = (_labelled if options.perceived is None else _perceived)(options, material)
    landscape = read_landscape(options.runs / material)
    theta = landscape.grid.materials(slice(landscape.best, landscape.best + 1))
    trials = twist_trials(observations, total_twist, theta, together, options.trials, options.seed)
    done()
    return trials


def _labelled(options, material: str) -> tuple[Observations, np.ndarray]:
    with np.load(options.data / f"{material}_truth.npz") as truth:
        return load_observations(options.data / f"{material}.npz"), np.radians(truth["total_twist_deg"])


def _perceived(options, material: str) -> tuple[Observations, np.ndarray]:
    """The lab's end frames and total twist, which follow from its scene to 15°, with the perceived shapes."""
    observations = synthesise(load_scene(SCENES / f"{material}.toml").observations)
    with np.load(options.perceived / f"{material}.npz") as seen:
        return replace(observations, vertices=seen["vertices_mm"]), observations.total_twist


def _share(failed: np.ndarray, rows: np.ndarray) -> str:
    return f"{failed[rows].mean():.1%}" if rows.any() else "none"


if __name__ == "__main__":
    main()
