"""The timed rods: those of the shipped scenes, and rods derived from them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from doo_ti import Newton, relax
from doo_ti.io.scene import load_scene
from doo_ti.lab import workload

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
