"""Stiffness from photographs: ``python tools/studies/picture_study.py [--specimens N] [--seed S] [--rough FACTOR]``.

Draws cables of 300 mm that hang between two clips, ten poses each, clips at random places and in random directions, which
nobody measures. Their shapes are equilibria of the continuum rod of marks_study/rod.py; OpenCV draws them, two cameras take
them, with blur, noise and an uneven background. Then the commands of docs/perception.md: ``doo-ti perceive`` begun by a click
in one camera, under a stiffness that is wrong by a factor, and ``doo-ti refine``. Prints a line for each specimen, and how many
95 % intervals of EI over weight contain the truth. Exit code 1 where fewer than nine tenths do.
"""

import argparse
import io
import json
import sys
import tempfile
import time
from contextlib import redirect_stdout
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from doo_ti import Camera, Rig
from doo_ti.commands.cli import main as doo_ti
from doo_ti.vision.rig_files import save_rig
from tests.vision.scenes import looking
from tools.studies.marks_study.rod import equilibria

LENGTH, POSES = 300.0, 10
SIZE, FOCAL_PX, AWAY_MM = (1280, 960), 1500.0, 650.0
THICK_PX, BLUR_PX, NOISE = 4, 0.8, 3.0
FINER = 4  # threads are drawn on finer pixels: OpenCV rounds the joints of a thick line to whole ones
CLICK_PX = 3.0
OUTER = 2  # vertices at either end that are left out
DEGREE = 40  # of the polynomials along a true rod


def pose(rng: np.random.Generator, load: float, ratio: float) -> np.ndarray:
    """(6001, 3) mm: the cable in a random pose about the world's origin, z up."""
    while True:
        way = rng.uniform(-0.6, 0.6)
        span = rng.uniform(0.45, 0.85) * np.array([np.cos(way), np.sin(way), rng.uniform(-0.4, 0.4)])
        turns = [Rotation.from_euler("zy", [way + rng.uniform(-0.9, 0.9), dip + rng.uniform(-0.7, 0.7)])
                 for dip in (0.5, -0.5)]
        rolls = [Rotation.from_euler("x", rng.uniform(-0.8, 0.8)) for _ in turns]
        start, end = (turn * roll for turn, roll in zip(turns, rolls, strict=True))
        rods, stable = equilibria(DEGREE, ratio, np.array([[0, 0, load]]), start.as_matrix()[None], span[None],
                                  end.as_matrix()[None], np.zeros((DEGREE + 1, 3)), np.ones(DEGREE + 1))
        if stable[0]:
            found = rods.points_at(np.linspace(0, 1, 6001))[0]
            return LENGTH * (found - 0.5 * (found.min(axis=0) + found.max(axis=0)))


def rig(rng: np.random.Generator) -> Rig:
    """Two cameras that look at the origin, 40 to 90 degrees apart, somewhat from above."""
    matrix = np.array([[FOCAL_PX, 0, SIZE[0] / 2], [0, FOCAL_PX, SIZE[1] / 2], [0, 0, 1.0]])
    apart, cameras = np.radians(rng.uniform(40, 90)), []
    for name, azimuth in (("left", -0.5 * np.pi - 0.5 * apart), ("right", -0.5 * np.pi + 0.5 * apart)):
        tilt = rng.uniform(0.1, 0.5)
        ahead = -np.array([np.cos(azimuth) * np.cos(tilt), np.sin(azimuth) * np.cos(tilt), np.sin(tilt)])
        cameras.append(Camera(name, *SIZE, matrix, np.array([-0.05, 0.02, 0, 0, 0]), *looking(ahead, AWAY_MM)))
    return Rig(tuple(cameras))


def photograph(camera: Camera, rod: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A dark thread before a light wall of uneven brightness."""
    wall = cv2.resize(rng.uniform(150, 215, (5, 6)).astype(np.float32), SIZE, interpolation=cv2.INTER_CUBIC)
    line, shift = np.zeros((FINER * SIZE[1], FINER * SIZE[0]), np.uint8), 4
    points = np.round(((camera.project(rod[::5]) + 0.5) * FINER - 0.5) * 2**shift).astype(np.int32)  # centres are whole numbers
    cv2.polylines(line, [points[:, None]], False, 255, FINER * THICK_PX, cv2.LINE_AA, shift)
    line = cv2.resize(line, SIZE, interpolation=cv2.INTER_AREA)
    image = wall + (60 - wall) * (line / 255.0)
    image = cv2.GaussianBlur(image, (0, 0), BLUR_PX) + rng.normal(0, NOISE, image.shape)
    return np.clip(image, 0, 255).astype(np.uint8)


def photographed(folder: Path, seed: int) -> tuple[float, list[np.ndarray]]:
    """Write rig.yaml, the images and sets.csv of a specimen; returns its EI over weight in mm³, and its true shapes."""
    rng = np.random.default_rng(seed)
    stiffness, ratio = np.exp(rng.uniform(np.log(2e5), np.log(2e6))), rng.uniform(0.5, 1.2)
    cameras, lines, rods = rig(rng), ["name,left,right,left_u,left_v"], []
    save_rig(folder / "rig.yaml", cameras)
    for number in range(POSES):
        rods.append(pose(rng, LENGTH**3 / stiffness, ratio))
        names = [f"pose_{number}_{camera.name}.png" for camera in cameras.cameras]
        for camera, name in zip(cameras.cameras, names, strict=True):
            cv2.imwrite(str(folder / name), photograph(camera, rods[-1], rng))
        u, v = cameras.cameras[0].project(rods[-1][:1])[0] + rng.uniform(-CLICK_PX, CLICK_PX, 2)
        lines.append(f"pose_{number},{','.join(names)},{u:.0f},{v:.0f}")
    (folder / "sets.csv").write_text("\n".join(lines) + "\n")
    return float(stiffness), rods


def answer(*words: str) -> dict:
    """What a command prints as JSON."""
    out = io.StringIO()
    with redirect_stdout(out):
        doo_ti([*words, "--json"])
    return json.loads(out.getvalue())


def learned(folder: Path, bend: float) -> tuple[dict, dict, np.ndarray]:
    """(of perceive, of refine, the rods' vertices), both begun with this bend stiffness, weight 1."""
    rough, rods = ["--bend", f"{bend:.4g}", "--twist-ratio", "0.8"], str(folder / "rods.npz")
    marks = str(folder / "marks.npz")
    seen = answer("perceive", "--rig", str(folder / "rig.yaml"), "--sets", str(folder / "sets.csv"), *rough, "--out", rods,
                  "--no-picture", "--no-recording")
    with redirect_stdout(io.StringIO()):
        doo_ti(["convert", rods, marks, "--marks", f"{OUTER}:-{OUTER}", "--complete"])
    return seen, answer("refine", marks, *rough, "--clip", "0")[0], np.load(rods)["vertices_mm"]


def main(words: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--specimens", type=int, default=20)
    parser.add_argument("--seed", type=int, default=2011)
    parser.add_argument("--rough", type=float, default=3.0, help="the true stiffness times this, or over this where "
                        "the seed is odd, is what the commands begin with")
    options = parser.parse_args(words)
    print("| seed | EI/w | guessed | found | 95 % interval | inside | median mm | clear, likely | used | s |\n|" + "---|" * 10)
    rows = []
    for seed in range(options.seed, options.seed + options.specimens):
        with tempfile.TemporaryDirectory() as folder:
            begun, factor = time.monotonic(), options.rough ** (-1) ** seed
            truth, shapes = photographed(Path(folder), seed)
            seen, fit, rods = learned(Path(folder), 2 * truth * factor)
        value, low, high = fit["stiffness"]["EI_over_weight_mm3"]
        low, high = 0.0 if low is None else low, np.inf if high is None else high
        off = [cKDTree(shape).query(rod[OUTER:-OUTER])[0] for rod, shape in zip(rods, shapes, strict=True)]
        rows.append((low <= truth <= high, abs(np.log(value / truth)), high / max(low, 1e-300), np.median(np.concatenate(off)),
                     fit["rods_used"]))
        inside, verdicts = "yes" if rows[-1][0] else "NO", f"{seen['verdicts']['clear']}, {seen['verdicts']['likely']}"
        used = f"{fit['rods_used']}{'' if fit['converged'] else ', NOT converged'}"
        print(f"| {seed} | {truth:.3g} | ×{factor:.2g} | {value:.4g} | {low:.4g} … {high:.4g} | {inside} | {rows[-1][3]:.3f} | "
              f"{verdicts} | {used} | {time.monotonic() - begun:.0f} |", flush=True)
    inside, error, width, off, used = np.transpose(rows)
    print(f"\n{inside.sum():.0f} of {len(rows)} intervals contain the truth; median estimate off by "
          f"×{np.exp(np.median(error)):.3f}, median interval ×{np.median(width):.3f} wide; median of rods "
          f"{np.median(off):.3f} mm; {used.sum():.0f} of {POSES * len(rows)} poses used")
    return int(inside.sum() < 0.9 * options.specimens)


if __name__ == "__main__":
    sys.exit(main())
