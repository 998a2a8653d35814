"""Depth of perceived rods against matching along rows: ``python tools/depth_study.py RIG LEFT RIGHT --seed X,Y,Z,DX,DY,DZ``.

In a rectified pair of images the place of a thread's pixel in the other image is on the same row. Where the colours around it
agree there with one place only, both ways, that gives the depth without any model of the thread. Prints for each pair how far
the rod that ``perceive`` finds in grey images is from these depths, along the line of sight: root mean square and median of
|difference| in mm. RIG may also be a folder with rig.yaml, centre_lines.npz and pairs ``*_left_N_*.png``,
``*_right_N_*.png``. Exit code 1 where the root mean square of a pair exceeds 2 mm.
"""

import argparse
import sys
from pathlib import Path

import cv2
import numpy as np

if not __package__:
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from doo_ti.perception.perceive import perceive  # noqa: E402
from doo_ti.perception.whole_thread import whole_threads  # noqa: E402
from doo_ti.rod.types import Material  # noqa: E402
from doo_ti.vision.cameras.rig import Rig, load_rig  # noqa: E402
from doo_ti.vision.detection.detect import detect  # noqa: E402
from doo_ti.vision.detection.images import read_image  # noqa: E402
from doo_ti.vision.detection.line import Detection, thinned  # noqa: E402
from doo_ti.vision.reprojection.distance_map import distance_maps  # noqa: E402

MATERIAL, UP, EDGES = Material(1e6, 8e5), np.array([0.0, 0.0, 1.0]), 33
NEAREST, FARTHEST = 40.0, 400.0
"""mm: depths that are looked at."""
HALF = 9, 4
"""Half the height and width of the patches that are compared, px."""
ALIKE, CLEARLY = 0.8, 0.1
"""Least correlation of two patches, and by how much it must exceed that of every other place on the row."""
BACK_PX = 1.0
"""Largest distance between a pixel and the match of its match."""
ACROSS = 0.5
"""Least cosine between the thread and the columns: where it runs along the rows its place on a row is not determined."""
MOST_RMS_MM = 2.0


def matched(one: np.ndarray, other: np.ndarray, x: int, y: int, first: int, last: int) -> float | None:
    """The column of the row ``y`` of ``other``, from ``first`` to ``last``, whose patch is like that of ``one`` at x, to a
    fraction of a pixel; None where none is, or two are."""
    up, aside = HALF
    height, width = one.shape[:2]
    first, last = max(first, aside), min(last, width - 1 - aside)
    if not up <= y < height - up or not aside <= x < width - aside or last - first < 2 * aside:
        return None
    patch = one[y - up : y + up + 1, x - aside : x + aside + 1]
    alike = cv2.matchTemplate(other[y - up : y + up + 1, first - aside : last + aside + 1], patch, cv2.TM_CCOEFF_NORMED)[0]
    best = int(np.argmax(alike))
    others = np.delete(alike, np.arange(max(best - 3, 0), min(best + 4, len(alike))))
    if not 0 < best < len(alike) - 1 or alike[best] < max(ALIKE, others.max(initial=-1.0) + CLEARLY):
        return None
    before, here, after = (float(value) for value in alike[best - 1 : best + 2])
    return first + best + 0.5 * (before - after) / min(before - 2 * here + after, -1e-9)


def disparities(left: np.ndarray, right: np.ndarray, line: Detection, least: float, most: float
                ) -> tuple[np.ndarray, np.ndarray]:
    """(N, 2) px of the left image on the thread, and (N,) px by which they are farther left in the right one; only where the
    match from right to left leads back."""
    points, direction = thinned(line)
    places, found = [], []
    for (x, y), way in zip(np.rint(points).astype(int), direction, strict=True):
        if abs(way[1]) < ACROSS:
            continue
        there = matched(left, right, x, y, x - int(most), x - int(least))
        if there is None:
            continue
        middle = int(round(there))
        back = matched(right, left, middle, y, middle + int(least), middle + int(most))
        if back is not None and abs(back - there + middle - x) <= BACK_PX:
            places.append((x, y))
            found.append(x - there)
    return np.array(places, dtype=float).reshape(-1, 2), np.array(found)


def depth_errors(rig: Rig, paths: list[Path], point: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """(N,) mm by which the rod found in a rectified pair is farther away than matching along rows says."""
    left, right = rig.cameras
    images = [detect(read_image(path, camera)) for path, camera in zip(paths, rig.cameras, strict=True)]
    way = direction[None] / np.linalg.norm(direction)
    length = whole_threads(rig, [images], point[None], way, MATERIAL, UP).length[0]
    found = perceive(distance_maps([images]), rig, point[None], way, np.full(EDGES, length / EDGES), MATERIAL)
    rod = found.configuration.vertices[0]
    rod = np.concatenate([rod[:-1] + share * np.diff(rod, axis=0) for share in np.linspace(0, 1, 8)])
    scale = left.lens[0] * np.linalg.norm(left.centre - right.centre)
    colour = [read_image(path, camera, colour=True) for path, camera in zip(paths, rig.cameras, strict=True)]
    places, apart = disparities(*colour, images[0], scale / FARTHEST, scale / NEAREST)
    image = left.project(rod)
    nearest = np.linalg.norm(places[:, None] - image, axis=-1).argmin(axis=1)
    return left.depth(rod)[nearest] - scale / apart


def main(words: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("rig", type=Path)
    parser.add_argument("images", nargs="*", type=Path)
    parser.add_argument("--seed", help="X,Y,Z,DX,DY,DZ: where the rod begins, in mm, and its direction")
    options = parser.parse_args(words)
    if options.rig.is_dir():
        folder = options.rig
        rig, given = load_rig(folder / "rig.yaml"), dict(np.load(folder / "centre_lines.npz"))
        pairs = [(name.split("_")[-1], given[name], given[name.replace("mm", "direction")]) for name in sorted(given)
                 if name.startswith("seed_mm_")]
        tasks = [(number, [next(folder.glob(f"*_{camera.name}_{number}_*.png")) for camera in rig.cameras], point, direction)
                 for number, point, direction in pairs]
    else:
        if options.seed is None or len(options.images) != 2:
            parser.error("give LEFT, RIGHT and --seed, or a folder")
        seed = np.array([float(value) for value in options.seed.split(",")])
        rig, tasks = load_rig(options.rig), [(options.images[0].stem, options.images, seed[:3], seed[3:])]
    print("| pair | places matched | rms mm | median mm |\n|" + "---|" * 4)
    worst = 0.0
    for name, paths, point, direction in tasks:
        error = depth_errors(rig, paths, point, direction)
        rms = float(np.sqrt(np.mean(error**2))) if len(error) else np.nan
        worst = max(worst, rms)
        print(f"| {name} | {len(error)} | {rms:.2f} | {np.median(np.abs(error)):.2f} |", flush=True)
    return int(not worst <= MOST_RMS_MM)


if __name__ == "__main__":
    sys.exit(main())
