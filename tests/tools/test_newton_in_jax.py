"""The solver in JAX that the benchmark compares with ends where the package ends."""

import sys

import numpy as np
import pytest

from doo_ti import Newton
from doo_ti.bench import workload
from doo_ti.errors import InputError
from doo_ti.types import Configuration

pytest.importorskip("jax")

from tools.bench import newton_in_jax  # noqa: E402
from tools.bench.pair_in_jax import DERIVATIVES  # noqa: E402

RODS = 64


@pytest.fixture(scope="module")
def rods():
    """Rods of all three sutures."""
    tables = [workload.started(observations) for observations in workload.observed(*workload.SUTURES)]
    return workload.paired(*workload.in_turn(tables), workload.isotropic_materials(RODS))


@pytest.fixture(scope="module", params=[32, 64])
def outcome(request, rods):
    """(bits, frames, energy, converged, iterations), a batch that shrinks on the way and one that does not."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(newton_in_jax, "SHRINK", (16,) if request.param == 64 else ())
        return request.param, *newton_in_jax.relaxed(rods, request.param)


def test_energies_are_those_of_the_package(rods, outcome):
    bits, _, energy, converged, _ = outcome
    solution = rods.relaxed(Newton(), "f64")
    apart = np.abs(energy - solution.energy) / np.abs(solution.energy)
    assert np.mean(apart <= (1e-8 if bits == 64 else 1e-5)) >= 0.95
    assert converged.mean() >= 0.95


def test_no_more_iterations_are_taken_than_by_the_package(rods, outcome):
    bits, *_, iterations = outcome
    assert iterations.mean() < rods.relaxed(Newton(), f"f{bits}").iterations.mean() + 1


def test_frames_are_unit_the_ends_held_and_closure_holds(rods, outcome):
    bits, frames, _, converged, _ = outcome
    rounding = 1e-14 if bits == 64 else 1e-6
    assert frames.dtype == np.dtype(f"float{bits}")
    np.testing.assert_allclose(np.linalg.norm(frames, axis=-1), 1.0, rtol=rounding)
    start, clamps = rods.starts.take(rods.of_start), rods.clamps.take(rods.of_start)
    found = Configuration(clamps.start_position, frames.astype(np.float64), start.rest_length)
    for edge, held in ((0, clamps.start_frame), (-1, clamps.end_frame)):
        np.testing.assert_allclose(found.frames[:, edge], held, atol=10 * rounding)
    gap = np.linalg.norm(found.vertices[:, -1] - clamps.end_position, axis=-1)
    assert gap[converged].max() <= (1e-12 if bits == 64 else 1e-6) * start.rest_length.sum()


def test_batches_and_lengths_of_their_own_change_nothing(rods, monkeypatch):
    monkeypatch.setattr(newton_in_jax, "BATCH", 8)
    some = rods.take(slice(20))
    together = newton_in_jax.relaxed(some, 64)
    lengths = np.tile(some.starts.rest_length, (some.starts.count, 1))
    own = workload.Rods(Configuration(some.starts.start, some.starts.quaternions, lengths), some.clamps, some.material,
                        some.of_start, some.of_material)
    monkeypatch.setattr(newton_in_jax, "BATCH", 20)
    alone = newton_in_jax.relaxed(own, 64)
    np.testing.assert_allclose(together[1], alone[1], rtol=1e-12)
    assert len(together[0]) == 20 and (together[2] == alone[2]).all()


def test_derivatives_by_autodiff_end_where_those_written_out_do(rods, monkeypatch):
    monkeypatch.setattr(newton_in_jax, "SHRINK", ())
    (_, written, *_), (_, found, converged, _) = (
        newton_in_jax.relaxed(rods.take(slice(32)), 64, derivatives) for derivatives in ("explicit", "automatic"))
    np.testing.assert_allclose(found, written, rtol=1e-12)
    assert converged.all()


@pytest.mark.parametrize("bits", [32, 64])
def test_a_pairs_derivatives_are_the_same_by_both_ways(rods, bits):
    with newton_in_jax.floats_of(bits):
        frames, task = newton_in_jax.batches_of(rods.take(slice(4)), bits)[0]
        frames = tuple(np.transpose(frames, (2, 1, 0)))
        written, found = (of_pairs(bits, task, frames) for of_pairs in DERIVATIVES.values())
    for explicit, automatic in zip(written, found, strict=True):
        close = (2e-6 if bits == 32 else 1e-13) * np.abs(explicit).max()
        np.testing.assert_allclose(automatic, explicit, rtol=0, atol=close)


def test_the_rate_counts_rods_that_converged(rods, monkeypatch):
    monkeypatch.setattr(newton_in_jax, "POLICY", Newton(max_iterations=2))
    found = newton_in_jax.rate(rods.take(slice(8)), 32, rounds=1)
    assert (found.rods_per_second, found.converged, found.iterations) == (0.0, 0.0, 2.0)
    assert found.compile_seconds > 0


def test_without_jax_the_remedy_is_reported(rods, monkeypatch):
    monkeypatch.setitem(sys.modules, "jax", None)
    monkeypatch.delitem(sys.modules, "tools.bench.newton_in_jax")
    monkeypatch.delattr("tools.bench.newton_in_jax")
    from tools.bench import newton_in_jax as bare

    with pytest.raises(InputError, match="--jax: .*pip install jax"):
        bare.rate(rods, 32)
