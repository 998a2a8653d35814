"""A rod's result is the same to the last bit alone, in a batch of 4096 mixed rods, in any place, on any threads."""

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from doo_ti.relaxation.relax import Descent, Newton, relax
from doo_ti.rod.types import Clamp, Material
from doo_ti.system import runtime
from tests.references.rods import clamps_at, jiggled
from tests.relaxation.rods import PAIRS, RESULTS, assert_same, definite, wandering, with_kinds

BATCH, STARTS, MATERIALS, EDGES = 4096, 30, 8, 20


def mixed_rods(seed: int, kind: str):
    """Tables of starts under all pairs of clamps and of materials over decades, and the rows of a shuffled batch."""
    rng = np.random.default_rng(seed)
    rods = wandering(rng, STARTS, EDGES, rng.uniform(1, 6, EDGES))
    clamps = with_kinds(clamps_at(rods), [PAIRS[k % len(PAIRS)] for k in range(STARTS)])
    bend = np.geomspace(1e5, 5e6, MATERIALS)
    if kind == "general":
        bend = bend[:, None, None, None] * definite(rng, MATERIALS, EDGES, scale=1.0)
    material = Material(bend, rng.uniform(1e5, 1e6, MATERIALS), rng.uniform(0.5, 2, MATERIALS))
    return jiggled(rods, rng, 0.05), clamps, material, rng.integers(0, [STARTS, MATERIALS], (BATCH, 2))


def row_of(material: Material, row: int) -> Material:
    return Material(material.bend[[row]], material.twist[[row]], material.weight[[row]])


@pytest.mark.sampled(2)
@pytest.mark.parametrize("precision", ["f64", "f32", "mixed"])
@pytest.mark.parametrize("kind", ["isotropic", "general"])
def test_newton(kind, precision):
    start, clamps, material, rows = mixed_rods(5, kind)
    batch = relax(
        start, material, clamps, precision=precision, configuration_index=rows[:, 0], material_index=rows[:, 1])
    print(f"seed 5, {kind}, {precision}: {np.bincount(batch.status, minlength=5)} rods by status")
    # In any place: every rod that occurs again.
    _, first, inverse = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    assert_same(batch, np.arange(BATCH), batch, first[inverse.ravel()])
    # Alone, and in a batch smaller than a pack.
    for place in (0, 1, 15, 16, 777, 2048, 4095):
        s, g = rows[place]
        alone = relax(start.take([s]), row_of(material, g), clamps.take([s]), precision=precision)
        assert_same(batch, [place], alone, [0])
    few = relax(start, material, clamps, precision=precision, configuration_index=rows[100:103, 0],
                material_index=rows[100:103, 1])
    assert_same(batch, np.arange(100, 103), few, np.arange(3))


def test_descent():
    rng = np.random.default_rng(6)
    rods = wandering(rng, 5, 9)
    clamps = with_kinds(clamps_at(rods), [(3, 3), (2, 1), (3, 0), (1, 3), (0, 2)])
    start, material = jiggled(rods, rng, 0.05), Material([3e5, 2e6], 4e5, 1.0)
    options = Descent(tolerance=1e-2, max_iterations=400)
    rows = rng.integers(0, [5, 2], (90, 2))
    batch = relax(start, material, clamps, options, configuration_index=rows[:, 0], material_index=rows[:, 1])
    print(f"seed 6: {np.bincount(batch.status, minlength=5)} rods by status")
    _, first, inverse = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    assert_same(batch, np.arange(90), batch, first[inverse.ravel()])
    for place in (0, 31, 89):
        s, g = rows[place]
        alone = relax(start.take([s]), row_of(material, g), clamps.take([s]), options)
        assert_same(batch, [place], alone, [0])


def test_earlier_calls_leave_nothing_behind():
    """Scratch is kept between calls."""
    start, clamps, material, rows = mixed_rods(7, "isotropic")
    index = {"configuration_index": rows[:64, 0], "material_index": rows[:64, 1]}
    before = relax(start, material, clamps, **index)
    long = wandering(np.random.default_rng(8), 3, 100)
    relax(long, material, clamps_at(long, Clamp.FRAME, Clamp.FREE), Newton(max_iterations=3),
          configuration_index=np.arange(40) % 3, material_index=np.arange(40) % MATERIALS)
    assert_same(before, slice(None), relax(start, material, clamps, **index), slice(None))


def digest() -> str:
    """Of everything F returns for 300 mixed rods, through f32 and f64."""
    start, clamps, material, rows = mixed_rods(9, "isotropic")
    solution = relax(start, material, clamps, precision="mixed", configuration_index=rows[:300, 0],
                     material_index=rows[:300, 1])
    arrays = (solution.configuration.quaternions, *(getattr(solution, name) for name in RESULTS))
    return hashlib.sha256(b"".join(array.tobytes() for array in arrays)).hexdigest()


@pytest.mark.thorough
def test_one_thread_and_all_threads():
    script = ("from doo_ti.system import runtime; runtime.start(threads=1); "
              "from tests.relaxation.test_independence import digest; assert runtime.thread_count() == 1; print(digest())")
    alone = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True,
                           cwd=Path(__file__).resolve().parents[2])
    assert alone.returncode == 0, alone.stderr
    runtime.start()
    print(f"{runtime.thread_count()} threads of {os.cpu_count()} processors against one")
    assert alone.stdout.split()[-1] == digest()
