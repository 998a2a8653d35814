"""Errors of the detected line in rendered images (docs/detection.md): ``python tools/studies/detection_study.py [--rods N]``.

The lab's vicryl, three cameras. Across the projected curve, px: bias (mean), median and 95th percentile of the distance.
Covered: share of the curve with a detected point within 2 px; false: share of points farther than 3 px from the curve.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from doo_ti import DetectionOptions
from doo_ti.vision.render import RenderOptions
from tools.studies.perception_study import photographed
from tools.studies.replication.specimens import scene

COVERED_PX, FALSE_PX = 2.0, 3.0
LIT = RenderOptions(thread=120.0, background=40.0, shading=120.0, light=(1.0, 0.0, 0.3))
ROWS = (("default", "ridge", RenderOptions()), ("default", "canny", RenderOptions()),
        ("noise of 10 grey levels", "ridge", RenderOptions(noise=10.0)), ("lit from one side", "ridge", LIT))


def across(points: np.ndarray, curve: np.ndarray) -> np.ndarray:
    """(N,) px: signed distances of points (N, 2) from a dense curve (n, 2)."""
    run = np.gradient(curve, axis=0)
    normal = np.stack([-run[:, 1], run[:, 0]], axis=1) / np.linalg.norm(run, axis=1, keepdims=True)
    nearest = np.argmin(np.linalg.norm(points[:, None] - curve, axis=-1), axis=1)
    return np.sum((points - curve[nearest]) * normal[nearest], axis=1)


def measured(rods: int, method: str, look: RenderOptions) -> tuple[float, ...]:
    """Bias, median, 95th percentile, covered, false."""
    case, _ = photographed(scene("vicryl").observations, rods, look, detection=DetectionOptions(method=method))
    off, covered, false = [], [], []
    for row, views in enumerate(case.detections):
        for found, curve in zip(views, case.pixels[:, row], strict=True):
            apart = np.linalg.norm(found.points[:, None] - curve, axis=-1)
            own = apart.min(axis=1, initial=np.inf) <= FALSE_PX
            off.append(across(found.points[own], curve))
            covered.append((apart.min(axis=0, initial=np.inf) <= COVERED_PX).mean())
            false.append((~own).mean() if len(own) else 0.0)
    off = np.concatenate(off)
    return off.mean(), np.median(abs(off)), np.percentile(abs(off), 95), np.mean(covered), np.mean(false)


def main(words: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rods", type=int, default=10)
    options = parser.parse_args(words)
    print("| images | method | bias | median | 95th percentile | covered | false |\n" + "|---" * 7 + "|")
    for name, method, look in ROWS:
        bias, median, high, covered, false = measured(options.rods, method, look)
        print(f"| {name} | {method} | {bias:.3f} | {median:.3f} | {high:.3f} | {covered:.1%} | {false:.1%} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
