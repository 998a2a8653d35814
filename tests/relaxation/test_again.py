"""F from a solution: the same equilibria as from other starts nearby; results own their memory."""

import numpy as np
import pytest

from doo_ti import Clamp, Descent, Material, Plane, Springs, Status, relax, straight_rod
from doo_ti.relaxation import tables
from tests.conftest import check_refused
from tests.references.rods import clamps_at
from tests.relaxation.rods import one_of_three_at_rest, wandering, with_kinds

COUNT = 24


@pytest.fixture
def solution(rng):
    rods = wandering(rng, 3, 12)
    kinds = [(Clamp.FRAME, Clamp.FRAME), (Clamp.FRAME, Clamp.TANGENT), (Clamp.POSITION, Clamp.FRAME)]
    clamps = with_kinds(clamps_at(rods), kinds)
    material = Material(rng.uniform(1e5, 3e5, 8), rng.uniform(1e5, 3e5, 8), 1.0)
    index = np.arange(COUNT)
    return relax(rods, material, clamps, configuration_index=index % 3, material_index=index // 3, up=[0.1, 0.0, 1.0])


@pytest.mark.sampled(1)
@pytest.mark.parametrize("precision", ["f64", "f32", "mixed"])
def test_another_material_gives_what_relax_gives_from_there(rng, solution, precision):
    near = Material(rng.uniform(1e5, 3e5, COUNT), rng.uniform(1e5, 3e5, COUNT), 1.0)
    before = solution.configuration.quaternions.copy()
    again = relax(solution, near, precision=precision)
    np.testing.assert_array_equal(solution.configuration.quaternions, before)
    assert again.converged.all() and again.stable.all()
    energies = [relax(again.configuration.take([row]), Material(near.bend[[row]], near.twist[[row]]),
                      clamps_at(again.configuration.take([row])), up=[0.1, 0.0, 1.0]).energy[0] for row in range(COUNT)]
    np.testing.assert_allclose(again.energy, energies, rtol=1e-4 if precision == "f32" else 1e-11)


def test_back_under_the_first_material_it_is_where_it_was(solution):
    """From a solution that one material made for all; and at once where nothing has changed. The clamps hold all along."""
    index, stiffness = np.arange(COUNT) // 3, solution.tables.material[:, tables.STIFFNESS :]
    material = Material(stiffness[:, tables.BEND], stiffness[:, tables.TWIST], 1.0)
    there = relax(solution, Material.diagonal(3e5, 1e5, 1e5))
    assert there.converged.all() and (there.energy != solution.energy).all()
    for begin, most in ((there, 100), (solution, 2)):
        again = relax(begin, material, material_index=index)
        np.testing.assert_allclose(again.energy, solution.energy, rtol=1e-9)
        now, before = again.configuration, solution.configuration
        np.testing.assert_array_equal(now.vertices[:, 0], before.vertices[:, 0])
        np.testing.assert_allclose(now.frames[:, -1, :, 0], before.frames[:, -1, :, 0], atol=1e-15)
        assert again.iterations.max() <= most


def test_rods_that_came_to_nothing_start_where_they_did(rng):
    first = one_of_three_at_rest(rng)
    again = relax(first, Material(2e5, 1e5))
    assert list(first.status) == list(again.status) == [Status.CONVERGED, Status.INFEASIBLE, Status.CONVERGED]
    assert np.isnan(again.energy[1])


@pytest.mark.thorough
def test_springs_stay(rng):
    rods = wandering(rng, 4, 12)
    clamps = with_kinds(clamps_at(rods), [(Clamp.FRAME, Clamp.FREE)] * 4)
    springs = Springs(rods.vertices, np.full((4, 13), 50.0))
    again = relax(relax(rods, Material(1e5, 1e5), clamps, external=springs), Material(2e5, 1e5))
    direct = relax(again.configuration, Material(2e5, 1e5), clamps, external=springs)
    np.testing.assert_allclose(again.energy, direct.energy, rtol=1e-10)


def test_materials_as_many_as_before_take_their_places(rng):
    rods = wandering(rng, 6, 9)
    clamps, index = clamps_at(rods), np.array([0, 1, 0, 1, 1, 0])
    before = relax(rods, Material([2e5, 3e5], 1e5), clamps, configuration_index=np.arange(6), material_index=index)
    after = relax(before, Material([2.2e5, 2.7e5], 1.1e5))
    again = relax(before, Material([2.2e5, 2.7e5], 1.1e5), material_index=index)
    np.testing.assert_array_equal(after.energy, again.energy)


def test_wrong_input_is_reported(solution):
    five, one, index = Material(np.full(5, 1e5), 1e5), Material(1e5, 1e5), np.full(COUNT, 5)
    for material, options, said in ((five, {}, "material_index"), (five, {"material_index": index}, "material_index"),
                                    (one, {"solver": Descent()}, "solver"),
                                    (Material(1e5, np.full((1, 5), 1e5)), {}, "entries along the rod")):
        check_refused(said, relax, solution, material, **options)


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


def test_tables_that_cannot_be_counted_are_refused(rng, monkeypatch):
    """All that kernels are given: of frames, for too many rods in one call, and of the forces of contacts."""
    monkeypatch.setattr(tables, "MOST_NUMBERS", 12 * 4 * 10)
    relaxed(rng, 10, 1e5)
    check_refused(" 10 ", relaxed, rng, 11, 1e5)
    rods = straight_rod(60.0, 10).take([0] * 4)
    clamps = clamps_at(rods, Clamp.FRAME, Clamp.FREE)
    monkeypatch.setattr(tables, "MOST_NUMBERS", 4 * 10 * 4)
    assert relax(rods, Material(1e5, 1e5, 1.0), clamps).converged.all()
    table = {"obstacles": [Plane((0, 0, -20), (0, 0, 1))] * 4, "radius": 1.0}
    check_refused("memory: 352 numbers", relax, rods, Material(1e5, 1e5, 1.0), clamps, **table)
