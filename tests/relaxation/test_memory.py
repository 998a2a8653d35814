"""Results own their memory while they are referenced; later results reuse it afterwards."""

import numpy as np
import pytest

from doo_ti import InputError, Material, relax
from doo_ti.relaxation import tables
from tests.references.rods import clamps_at
from tests.relaxation.rods import wandering


def relaxed(rng, count: int, bend: float):
    rods = wandering(rng, count, 12)
    return relax(rods, Material(bend, bend), clamps_at(rods), precision="f32")


@pytest.mark.thorough
def test_referenced_results_are_never_overwritten(rng):
    """Not even one frame of one rod, taken from a solution that is gone."""
    held = [relaxed(rng, 400, 1e5 * (k + 1)).configuration.quaternions for k in range(3)]
    held.append(relaxed(rng, 400, 1e5).configuration.quaternions[7, 3])
    copies = [array.copy() for array in held]
    for _ in range(6):
        relaxed(rng, 400, 3e6)
    for array, copy in zip(held, copies, strict=True):
        np.testing.assert_array_equal(array, copy)


@pytest.mark.slow
def test_memory_that_nobody_holds_is_used_again_and_bounded(rng, monkeypatch):
    monkeypatch.setattr(tables, "pool", [])  # not what earlier tests have left
    for _ in range(3):
        relaxed(rng, 500, 1e5)
    before = len(tables.pool)
    for _ in range(20):
        relaxed(rng, 500, 1e5)
    assert len(tables.pool) == before
    monkeypatch.setattr(tables, "POOLED_BYTES", 500_000)
    kept = [relaxed(rng, 500, 1e5) for _ in range(8)]
    assert sum(array.nbytes for array in tables.pool) <= 500_000 and len(kept) == 8


def test_too_many_rods_for_one_call_are_refused(rng, monkeypatch):
    monkeypatch.setattr(tables, "MOST_NUMBERS", 12 * 4 * 10)
    relaxed(rng, 10, 1e5)
    with pytest.raises(InputError, match=" 10 "):
        relaxed(rng, 11, 1e5)
