"""Which angle between cameras determines what: rods recovered from ideal detections of random smooth curves.

    python tools/studies/angle_study.py [--curves 20] [--noise 0.5] [--angles 5 10 20 40 90]

Curves of 100 mm, which no rod made, in front of two cameras whose lines of sight differ by an angle, and of a third above the
first, by the same angle. A rod is correct within 1 mm, both ways, and twice what a tenth of a pixel changes in depth.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial import cKDTree

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from doo_ti import Camera, Detection, Material, PerceptionVerdict, Rig, distance_maps, perceive

LENGTH_MM, EDGES, AWAY_MM, FOCAL_PX, WIDTH, HEIGHT = 100.0, 33, 200.0, 1000.0, 800, 600
KNOTS, BEND = 6, 0.9
DEPTH_PX = 0.1
WITHIN_MM = 1.0


def curve(rng: np.random.Generator) -> np.ndarray:
    """(2001, 3) mm about the origin, LENGTH_MM long: a smooth random direction, integrated."""
    knots = np.cumsum(rng.normal(0, BEND, (KNOTS, 3)), axis=0) + rng.normal(0, 1, 3)
    direction = CubicSpline(np.linspace(0, 1, KNOTS), knots)(np.linspace(0, 1, 2001))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    points = np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * (direction[1:] + direction[:-1]), axis=0)])
    points *= LENGTH_MM / np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
    return points - 0.5 * (points.min(axis=0) + points.max(axis=0))


def cameras(degrees: float, third: bool) -> Rig:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    turns = {"front": np.eye(3), "side": [[c, 0, s], [0, 1, 0], [-s, 0, c]], "above": [[1, 0, 0], [0, c, -s], [0, s, c]]}
    matrix = np.array([[FOCAL_PX, 0, WIDTH / 2], [0, FOCAL_PX, HEIGHT / 2], [0, 0, 1.0]])
    seen = [Camera(name, WIDTH, HEIGHT, matrix, np.zeros(5), np.array(turn), np.array([0.0, 0.0, AWAY_MM]))
            for name, turn in turns.items()]
    return Rig(tuple(seen if third else seen[:2]))


def detection(view: Camera, points: np.ndarray, noise: float, rng: np.random.Generator) -> Detection:
    """The curve's image, a point per pixel, each off across the line by ``noise`` px, alike over a few of them."""
    image = view.project(points)
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(image, axis=0), axis=1))])
    place = np.arange(0.0, arc[-1], 0.8)
    found = np.stack([np.interp(place, arc, column) for column in image.T], axis=1)
    tangent = np.gradient(found, axis=0)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-12)
    off = np.convolve(rng.normal(size=len(place) + 8), np.ones(9) / 3.0, mode="valid") * noise
    found = found + off[:, None] * np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
    return Detection(found, tangent, np.full(len(found), 50.0), 2.0, "dark", (HEIGHT, WIDTH), "ridge")


def apart(one: np.ndarray, other: np.ndarray) -> float:
    """mm: mean distance between two curves, both ways."""
    return 0.5 * float(cKDTree(one).query(other)[0].mean() + cKDTree(other).query(one)[0].mean())


def dense(vertices: np.ndarray) -> np.ndarray:
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(vertices, axis=0), axis=1))])
    return np.stack([np.interp(np.linspace(0, arc[-1], 500), arc, column) for column in vertices.T], axis=1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--curves", type=int, default=20)
    parser.add_argument("--noise", type=float, default=0.5)
    parser.add_argument("--angles", type=float, nargs="+", default=[5.0, 10.0, 20.0, 40.0, 90.0])
    parser.add_argument("--seed", type=int, default=2011)
    options = parser.parse_args()
    print(f"seed {options.seed}, {options.curves} curves, detected points off by {options.noise} px\n"
          "| cameras | angle | correct | median mm | clear | clear and wrong |\n|---|---|---|---|---|---|")
    for third in (False, True):
        for angle in options.angles:
            rng = np.random.default_rng(options.seed)
            rig, curves = cameras(angle, third), [curve(rng) for _ in range(options.curves)]
            seen = [[detection(view, points, options.noise, rng) for view in rig.cameras] for points in curves]
            start = np.array([points[0] for points in curves])
            direction = np.array([points[60] - points[0] for points in curves])
            found = perceive(distance_maps(seen), rig, start, direction, np.full(EDGES, LENGTH_MM / EDGES), Material(6e5, 8e5))
            errors = np.array([apart(dense(rod), points) for rod, points in zip(found.vertices, curves, strict=True)])
            within = WITHIN_MM + DEPTH_PX * AWAY_MM / FOCAL_PX / np.sin(np.radians(angle)) * 2
            clear = found.verdict == PerceptionVerdict.CLEAR
            print(f"| {len(rig.cameras)} | {angle:g}° | {(errors < within).sum()} of {len(errors)} | {np.median(errors):.2f} | "
                  f"{clear.sum()} | {(clear & (errors >= within)).sum()} |", flush=True)


if __name__ == "__main__":
    main()
