"""The timed rods are those of the shipped scenes; what is counted of a case: rods that converged, trips, busy lanes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from doo_ti.io.scene import load_scene
from doo_ti.lab import cases as timed
from doo_ti.lab import workload
from doo_ti.lab.cases import Case, Outcome, Specimens, measure
from doo_ti.relaxation import batch

RODS = 48


@pytest.fixture(scope="module", autouse=True)
def short_rounds():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(timed, "ROUND_SECONDS", 0.0)
        yield


@pytest.fixture(scope="module")
def reference():
    return workload.Reference(1)


@pytest.fixture(scope="module")
def specimens():
    return Specimens(RODS)


@pytest.mark.thorough
def test_only_rods_that_converged_count(specimens):
    solution = specimens.many.relaxed(timed.Newton(max_iterations=6), "f64")
    done = solution.converged
    assert 0 < done.sum() < RODS
    outcome = timed.converged((solution, 0))
    assert (outcome.amount, outcome.converged) == (done.sum(), done.mean())
    assert outcome.residual == solution.residual[done].max()


@pytest.mark.thorough
def test_trips_are_counted_by_launch(monkeypatch, specimens):
    """Of all lanes, idle ones too; of a launch in f64 only where it ended a rod."""
    monkeypatch.setattr(batch, "pack_trips", {32: (10, 16), 64: (5, 8)}.__getitem__)
    for precision, count in (("f32", 160), ("mixed", 200), ("f64", 40)):
        assert timed.trips(specimens.many.relaxed(timed.COARSE, precision), precision) == count


def test_busy_lanes(reference):
    found = measure(Case("made up", "rods/s", lambda: Outcome(3.0, iterations=np.array([20, 40, 90]), trips=200)), reference, 1)
    assert found.busy == 150 / 200


SCENES = Path(__file__).resolve().parents[2] / "scenes"


@pytest.mark.parametrize("name", workload.LAB)
def test_the_rods_are_those_of_the_shipped_scenes(name):
    assert replace(load_scene(SCENES / f"{name}.toml").observations, source="synthesis") == workload.LAB[name]
