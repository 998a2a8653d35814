"""One rod per thread, as on a GPU: the same source with scalars, and scratch laid out item by item across the threads."""

import numpy as np
import pytest

from doo_ti import Clamp, Clamps, Configuration, Descent, Material, Newton, relax
from doo_ti.physics.number import Number
from doo_ti.relaxation import batch

THREADS, STRIDE = 7, 9


def rods(rng, count: int = 20, edges: int = 12):
    """Clamped rods between points a little closer than they are long."""
    bend = np.cumsum(rng.normal(0.0, 0.15, (count, edges)), axis=1)
    quaternions = np.stack([np.cos(bend / 2), 0 * bend, 0 * bend, np.sin(bend / 2)], axis=-1)
    start = Configuration(np.zeros((count, 3)), quaternions, np.full(edges, 3.0))
    frames = start.frames
    end = 0.9 * start.vertices[:, -1] + rng.normal(0.0, 0.3, (count, 3))
    clamps = Clamps(Clamp.FRAME, Clamp.TANGENT, start.start, end, frames[:, 0], frames[:, -1])
    return start, clamps


def test_other_numbers_of_rods_need_no_other_kernels_on_a_gpu():
    layouts = [batch.layout_of_gpu(count, 64) for count in range(1, 100_000, 17)]
    assert len({stride for _, _, stride, _ in layouts}) <= 6
    assert all(stride >= threads for _, threads, stride, _ in layouts)


@pytest.mark.parametrize("numbers", [1 << 30, 1000])
def test_scratch_holds_what_all_threads_need(monkeypatch, numbers):
    monkeypatch.setattr(batch.of, "MOST_NUMBERS", numbers)
    sizes = []
    monkeypatch.setattr(batch.runtime, "array_for", lambda key, size, kind: sizes.append(size))
    launch = batch.laid_out(batch.layout_of_gpu(70, 64), lambda *layout: (layout, lambda given: 30), None)
    _, stride, _ = launch.kernel
    assert launch.threads <= stride and sizes == [stride * 30] and stride * 30 <= numbers
    assert launch.threads == min(70, numbers // 30)


DESCENT = Descent(tolerance=1e-3, max_iterations=20_000)
CASES = {"newton f64": (Newton(), "f64"), "newton f32": (Newton(), "f32"), "descent f64": (DESCENT, "f64")}


@pytest.mark.thorough
@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("isotropic", [True, False], ids=["isotropic", "general"])
def test_one_lane_per_thread_is_bit_for_bit_a_pack(rng, monkeypatch, case, isotropic):
    solver, precision = CASES[case]
    start, clamps = rods(rng)
    material = Material(4e5, 3e5) if isotropic else Material([[4e5, 5e4], [5e4, 9e5]], 3e5, rest_curvature=(0.002, -0.001))
    packed = relax(start, material, clamps, solver, precision=precision)
    assert packed.converged.all()
    monkeypatch.setattr(batch, "layout_for", lambda count, bits, alone=False: (Number(1, bits), THREADS, STRIDE, 1))
    single = relax(start, material, clamps, solver, precision=precision)
    np.testing.assert_array_equal(single.configuration.quaternions, packed.configuration.quaternions)
    for name in ("energy", "residual", "iterations", "status", "stable"):
        np.testing.assert_array_equal(getattr(single, name), getattr(packed, name))
