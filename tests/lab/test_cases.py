"""The timed rods, those of the shipped scenes and others derived from them; and the cases on a few of them: each runs, counts
its rods, and reports the use of its lanes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from doo_ti import Newton, relax
from doo_ti.io.scene import load_scene
from doo_ti.lab import cases as timed
from doo_ti.lab import workload
from doo_ti.lab.cases import Case, Outcome, Specimens, cases, measure
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


@pytest.mark.slow
@pytest.mark.parametrize("number", range(len(cases(Specimens(RODS)))))
def test_a_case_does_what_it_counts(specimens, reference, number):
    case = cases(specimens)[number]
    found = measure(case, reference, 1)
    assert found.per_second > 0 and found.ratio > 0
    assert found.converged == found.stable == 1.0
    assert found.residual <= timed.COARSE.tolerance
    assert 0 < found.busy <= 1
    assert found.iterations == pytest.approx(np.average(np.arange(len(found.histogram)), weights=found.histogram))


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


@pytest.fixture(scope="module")
def sutures():
    """The table of 180 starts, and their clamps."""
    return workload.in_turn([workload.started(seen) for seen in workload.observed(*workload.SUTURES)])


@pytest.mark.parametrize("name", workload.LAB)
def test_the_rods_are_those_of_the_shipped_scenes(name):
    assert replace(load_scene(SCENES / f"{name}.toml").observations, source="synthesis") == workload.LAB[name]


@pytest.mark.thorough
def test_starts_take_turns_and_rods_alone_are_the_same_rods():
    tables = [workload.started(observations) for observations in workload.observed("nylon", "silk")]
    starts, clamps = workload.in_turn(tables)
    assert starts.count == 120
    for place, (table, held) in enumerate(tables):
        np.testing.assert_array_equal(starts.quaternions[place::2], table.quaternions)
        np.testing.assert_array_equal(clamps.end_position[place::2], held.end_position)
    rods = workload.paired(starts, clamps, workload.isotropic_materials(130))
    together, alone = rods.relaxed(Newton(), "f64"), rods.alone([125, 3]).relaxed(Newton(), "f64")
    np.testing.assert_array_equal(together.energy[[125, 3]], alone.energy)


@pytest.mark.thorough
def test_near_materials_are_a_tenth_away_and_take_fewer_iterations(sutures):
    rods = workload.paired(*sutures, workload.isotropic_materials(200))
    near = workload.near(rods)
    for name in ("bend", "twist"):
        there, here = getattr(rods.material, name), getattr(near, name)
        assert set(np.round(here[there > 0] / there[there > 0], 12)) == {0.9, 1.1}
    solution = rods.relaxed(Newton(), "f64")
    moved = relax(solution, near)
    assert 1 < moved.iterations.mean() < solution.iterations.mean()
