"""How often Eq. 4 finds the twist (§V-F, Fig. 7): a table over D = 1 … 6, and the histogram as a PNG.

    python tools/twist_study.py --runs RUNS --data ../shared/data/lab_a --out FOLDER

RUNS/MATERIAL holds the sweep of each material (`doo-ti sweep lab_a/MATERIAL.npz --bend 5e4:1e7:25 --twist-ratio 0.1:6:25`), of
which the best cell counts.
"""

import argparse
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import Progress

from doo_ti.dataset import load_observations, write_whole
from doo_ti.learning import read_landscape
from doo_ti.report import angle_errors_picture
from doo_ti.twist import Verdict
from doo_ti.twist_trials import SUCCESS, twist_trials

MATERIALS = ("nylon", "vicryl", "silk")
PAPER = {1: "53.3 %", 6: "80 %"}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=Path, required=True)
    parser.add_argument("--data", type=Path, default=Path(__file__).resolve().parents[2] / "shared" / "data" / "lab_a")
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
              f"| {np.mean(verdict == Verdict.AMBIGUOUS):.1%} | {_share(failed, verdict == Verdict.AMBIGUOUS)} "
              f"| {_share(failed, verdict == Verdict.CLEAR)} | {np.sum(verdict == Verdict.UNDETERMINED)} "
              f"| {sum(int(one.estimate.unsound.sum()) for one in trials)} |")
    errors = {f"D = {together}": np.degrees(np.concatenate([one.error for one in trials]))
              for together, trials in found.items()}
    write_whole(options.out / "fig7.png", lambda file: angle_errors_picture(
        file, errors, success_deg=np.degrees(SUCCESS), title="Errors of the end frame's rotation, all threads (Fig. 7)"))
    print(f"written to {options.out / 'fig7.png'}")


def _trials(options, material: str, together: int, done):
    observations = load_observations(options.data / f"{material}.npz")
    with np.load(options.data / f"{material}_truth.npz") as truth:
        total_twist = np.radians(truth["total_twist_deg"])
    landscape = read_landscape(options.runs / material)
    theta = landscape.grid.materials(slice(landscape.best, landscape.best + 1))
    trials = twist_trials(observations, total_twist, theta, together, options.trials, options.seed)
    done()
    return trials


def _share(failed: np.ndarray, rows: np.ndarray) -> str:
    return f"{failed[rows].mean():.1%}" if rows.any() else "none"


if __name__ == "__main__":
    main()
