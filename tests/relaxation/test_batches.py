"""A rod's result does not depend on the others of its call: the same bits alone, shuffled, and among rods of other kinds."""

import numpy as np
import pytest

from doo_ti import Clamp, Clamps, Itself, Material, Plane, Solution, Springs, relax
from doo_ti.contact.obstacles import Sphere
from doo_ti.rod.frames import across, bishop_frames, quaternion_from_matrix
from doo_ti.rod.types import Configuration

EDGES, EDGE = 16, 6.0
FIELDS = ("energy", "residual", "closure", "iterations", "status", "stable", "end_force", "precision")


def rods(rng: np.random.Generator, count: int) -> tuple[Configuration, Material, Clamps]:
    """Random rods with every pair of clamps that holds one; round ones, ribbons, tapers and rods with rest curvature."""
    turns = np.cumsum(rng.normal(0, 0.12, (count, EDGES, 3)), axis=1)
    tangents = turns + [1.0, 0, 0] + 0.5 * rng.normal(size=(count, 1, 3))
    tangents /= np.linalg.norm(tangents, axis=-1, keepdims=True)
    frames = bishop_frames(tangents, across(tangents[:, 0]))
    start = Configuration(rng.uniform(-5, 5, (count, 3)), quaternion_from_matrix(frames), np.full(EDGES, EDGE))
    kinds = rng.integers(0, 4, (count, 2))
    kinds[(kinds == 0).all(axis=1), 0] = Clamp.FRAME
    vertices = start.vertices
    ends = vertices[:, -1] + rng.normal(0, 3.0, (count, 3))
    clamps = Clamps(kinds[:, 0], kinds[:, 1], vertices[:, 0], ends, frames[:, 0], frames[:, -1])
    alpha, kind = 10.0 ** rng.uniform(4.5, 6, count), rng.integers(0, 4, count)
    bend = alpha[:, None, None, None] * np.eye(2) * np.ones((1, EDGES, 1, 1))
    bend[kind == 1, :, 0, 0] *= 3.0
    bend[kind == 2] *= np.linspace(0.5, 2.0, EDGES)[:, None, None]
    rest = np.where((kind == 3)[:, None, None], 1e-3, 0.0) * np.ones((1, EDGES - 1, 2))
    return start, Material(bend, 0.7 * alpha, 1.0, rest), clamps


def call(given, rows: np.ndarray, **options) -> Solution:
    start, material, clamps = given
    springs = options.pop("springs", None)
    if springs is not None:
        options["external"] = Springs(springs.points[rows], springs.stiffness[rows])
    return relax(start.take(rows), material.take(rows), clamps.take(rows), **options)


def assert_same(whole: Solution, part: Solution, rows: np.ndarray) -> None:
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(whole, name)[rows], getattr(part, name), err_msg=name)
    np.testing.assert_array_equal(whole.configuration.quaternions[rows], part.configuration.quaternions)
    np.testing.assert_array_equal(whole.configuration.start[rows], part.configuration.start)


def surroundings(kind: str, count: int, rng: np.random.Generator) -> dict:
    if kind == "springs":
        return {"springs": Springs(rng.uniform(-50, 100, (count, EDGES + 1, 3)), np.full((count, EDGES + 1), 0.5))}
    obstacles = [Plane((0, 0, -25.0), (0, 0, 1)), Sphere((60.0, 0, -10.0), 8.0)]
    return {"nothing": {}, "obstacles": {"obstacles": obstacles, "radius": 1.0},
            "itself": {"obstacles": [Itself()], "radius": 1.0}}[kind]


def compare(rng, count: int, kind: str, precision: str, batches) -> None:
    given = rods(rng, count)
    options = surroundings(kind, count, rng) | {"precision": precision}
    whole = call(given, np.arange(count), **options)
    print(f"{kind} {precision}: {np.bincount(whole.status, minlength=5)}, {whole.stable.sum()} stable")
    for size, number in batches:
        order = rng.permutation(count)
        for first in range(0, min(count, size * number), size):
            rows = order[first : first + size]
            assert_same(whole, call(given, rows, **options), rows)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("kind", ["nothing", "springs", "obstacles", "itself"])
@pytest.mark.parametrize("precision", ["f64", "mixed", "f32"])
def test_shuffled_batches_have_the_same_bits(rng, kind, precision):
    compare(rng, 240, kind, precision, ((1, 12), (7, 6), (100, 3)))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["nothing", "springs", "obstacles"])
def test_twenty_thousand_rods_have_the_same_bits(rng, kind):
    compare(rng, 20_000, kind, "f64", ((1, 100), (7, 60), (1000, 20)))
