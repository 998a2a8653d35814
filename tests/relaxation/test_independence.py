"""A rod's result is the same to the last bit alone, shuffled, among rods of other kinds, and with any layout of threads."""

import hashlib
from types import SimpleNamespace

import numpy as np
import pytest

from doo_ti import Clamp, Clamps, Configuration, Descent, Itself, Material, Newton, Plane, Solution, Sphere, Springs, relax
from doo_ti.physics.number import Number
from doo_ti.relaxation import batch
from doo_ti.system import runtime
from tests.processes import python
from tests.references.rods import clamps_at
from tests.relaxation.rods import PAIRS, RESULTS, assert_same, wandering, with_kinds

EDGES, EDGE = 16, 6.0


def rods(rng: np.random.Generator, count: int, kinds: int = 4) -> tuple[Configuration, Material, Clamps]:
    """Random rods with every pair of clamps that holds one; of round, ribbon, taper, curved at rest the first."""
    start = wandering(rng, count, EDGES, EDGE, wander=0.12)
    clamps = with_kinds(clamps_at(start), [PAIRS[k] for k in rng.integers(0, len(PAIRS), count)])
    clamps.end_position[:] += rng.normal(0, 3.0, (count, 3))
    alpha, kind = 10.0 ** rng.uniform(4.5, 6, count), rng.integers(0, kinds, count)
    if kinds == 1:
        return start, Material(alpha, 0.7 * alpha, 1.0), clamps
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


def surroundings(kind: str, count: int, rng: np.random.Generator) -> dict:
    if kind == "springs":
        return {"springs": Springs(rng.uniform(-50, 100, (count, EDGES + 1, 3)), np.full((count, EDGES + 1), 0.5))}
    return {"descent": {"solver": Descent(tolerance=1e-2, max_iterations=400)},
            "obstacles": {"obstacles": [Plane((0, 0, -25.0), (0, 0, 1)), Sphere((60.0, 0, -10.0), 8.0)], "radius": 1.0},
            "itself": {"obstacles": [Itself()], "radius": 1.0}}.get(kind, {})


def compare(rng, count: int, kind: str, precision: str, batches) -> None:
    given = rods(rng, count, 1 if kind in ("round", "descent") else 4)
    options = surroundings(kind, count, rng) | {"precision": precision}
    whole = call(given, np.arange(count), **options)
    for size, number in batches:
        order = rng.permutation(count)
        for first in range(0, min(count, size * number), size):
            rows = order[first : first + size]
            assert_same(whole, rows, call(given, rows, **options), slice(None))


@pytest.mark.sampled(2)
@pytest.mark.parametrize("kind", ["nothing", "round", "springs", "obstacles", "itself"])
@pytest.mark.parametrize("precision", ["f64", "mixed", "f32"])
def test_shuffled_batches_have_the_same_bits(rng, kind, precision):
    compare(rng, 240, kind, precision, ((1, 12), (7, 6), (100, 3)))


def test_descent_has_the_same_bits_in_shuffled_batches(rng):
    compare(rng, 60, "descent", "f64", ((1, 3), (7, 3)))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["nothing", "springs", "obstacles"])
def test_twenty_thousand_rods_have_the_same_bits(rng, kind):
    compare(rng, 20_000, kind, "f64", ((1, 100), (7, 60), (1000, 20)))


def test_earlier_calls_leave_nothing_behind(rng):
    """Scratch is kept between calls."""
    given, long = rods(rng, 64, 1), wandering(rng, 3, 100)
    before = call(given, np.arange(64))
    relax(long, Material(1e5, 1e5), clamps_at(long, Clamp.FRAME, Clamp.FREE), Newton(max_iterations=3),
          configuration_index=np.arange(40) % 3)
    assert_same(before, slice(None), call(given, np.arange(64)), slice(None))


def digest() -> str:
    """Of everything F returns for 300 mixed rods, through f32 and f64."""
    solution = call(rods(np.random.default_rng(9), 300, 1), np.arange(300), precision="mixed")
    arrays = (solution.configuration.quaternions, *(getattr(solution, name) for name in RESULTS))
    return hashlib.sha256(b"".join(array.tobytes() for array in arrays)).hexdigest()


@pytest.mark.thorough
def test_one_thread_and_all_threads():
    script = ("from doo_ti.system import runtime; runtime.start(threads=1); "
              "from tests.relaxation.test_independence import digest; assert runtime.thread_count() == 1; print(digest())")
    alone = python("-c", script)
    assert alone.returncode == 0, alone.stderr
    runtime.start()
    assert alone.stdout.split()[-1] == digest()


def test_other_numbers_of_rods_need_no_other_kernels_on_a_gpu():
    layouts = [batch.layout_of_gpu(count, 64, batch.MOST_THREADS) for count in range(1, 100_000, 17)]
    assert len({stride for _, _, stride, _ in layouts}) <= 6
    assert all(stride >= threads for _, threads, stride, _ in layouts)


@pytest.mark.parametrize("numbers", [1 << 30, 1000])
def test_scratch_holds_what_all_threads_need(monkeypatch, numbers):
    monkeypatch.setattr(batch.of, "MOST_NUMBERS", numbers)
    sizes, launches = [], []
    monkeypatch.setattr(batch.runtime, "array_for", lambda key, size, kind: sizes.append(size))

    def kernel(number, stride, block):
        def call(threads, **given):
            launches.append((stride, threads))
        call.loop = SimpleNamespace(items=lambda given: 30)
        return call

    batch.launch(batch.layout_of_gpu(70, 64, batch.MOST_THREADS), kernel)
    (stride, threads), = launches
    assert threads <= stride and sizes == [stride * 30] and stride * 30 <= numbers
    assert threads == min(70, numbers // 30)


@pytest.mark.thorough
@pytest.mark.parametrize("solver, precision", [
    (Newton(), "f64"), (Newton(), "f32"), (Descent(tolerance=1e-3, max_iterations=20_000), "f64")])
@pytest.mark.parametrize("isotropic", [True, False], ids=["isotropic", "general"])
def test_one_lane_per_thread_is_bit_for_bit_a_pack(rng, monkeypatch, solver, precision, isotropic):
    start = wandering(rng, 20, 12)
    clamps = clamps_at(start, Clamp.FRAME, Clamp.TANGENT)
    material = Material(4e5, 3e5) if isotropic else Material([[4e5, 5e4], [5e4, 9e5]], 3e5, rest_curvature=(0.002, -0.001))
    packed = relax(start, material, clamps, solver, precision=precision)
    assert packed.converged.all()
    threads, stride = 7, 9
    monkeypatch.setattr(batch, "layout_for", lambda count, bits, alone=False: (Number(1, bits), threads, stride, 1))
    assert_same(packed, slice(None), relax(start, material, clamps, solver, precision=precision), slice(None))
