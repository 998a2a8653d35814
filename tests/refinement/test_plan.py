"""Which configurations inform Θ, and the order in which to measure them."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti import Material, Newton, distance, load_observations, relax, sensitivity
from doo_ti.io.scene import Synthesis
from doo_ti.refinement.plan import plan, planned
from doo_ti.rod.grid import Grid, parse_axis
from doo_ti.rod.start import observation_clamps, start_configuration
from tests.conftest import check_refused

BEND, TWIST = 1.8e6, 1.2e6


def grid(bends: int = 7, ratios: int = 5) -> Grid:
    return Grid((parse_axis("--bend", f"5e4:1e7:{bends}"), parse_axis("--twist-ratio", f"0.1:6:{ratios}")))


@pytest.fixture(scope="module")
def configurations():
    return planned(Synthesis(bend=BEND, twist=TWIST, end_distances_mm=(30.0, 54.0, 78.0),
                             end_rotations_deg=(0.0, 90.0, 180.0)))


@pytest.fixture(scope="module")
def solution(configurations):
    clamps = observation_clamps(configurations)
    return relax(start_configuration(configurations, clamps), Material(BEND, TWIST), clamps)


def test_planned_rods_are_equilibria_of_the_model_that_is_fitted(configurations, solution):
    assert solution.stable.all()
    assert distance(solution.configuration, configurations).max() < 1e-4


def test_strength_is_how_far_marks_move(configurations):
    """One cell besides the asked parameter's two: against relaxations under a bend that is a little larger."""
    clamps = observation_clamps(configurations)
    start = start_configuration(configurations, clamps)
    narrow = Grid((parse_axis("--bend", "1.8e6:1.80001e6:2"), parse_axis("--twist", "1.2e6")))
    found = plan(configurations, narrow, sigma=0.1, picks=3)
    above, below = (relax(start, Material(BEND * factor, TWIST), clamps, Newton(tolerance=1e-9)).configuration.vertices
                    for factor in (1 + 1e-4, 1 - 1e-4))
    shift = (above - below) / 2e-4
    np.testing.assert_allclose(found.strength[:, 0], np.sqrt(np.sum(shift**2, axis=(1, 2)) / shift.shape[1]), rtol=1e-3)
    np.testing.assert_allclose(found.total, found.strength[:, 0])
    assert found.parameters == ("bend", "twist", "weight") and found.asked == (0,)


def test_only_ratios_matter(solution):
    """A common factor of bend, twist and weight moves nothing: their sensitivities to logarithms add up to zero."""
    moved = sensitivity(solution, ("bend", "twist", "weight")).vertices * [BEND, TWIST, 1.0]
    assert np.abs(moved.sum(axis=-1)).max() < 1e-6 * np.abs(moved).max()


@pytest.mark.thorough
def test_the_order_is_greedy_and_the_region_shrinks(configurations):
    found = plan(configurations, grid(), sigma=0.1, picks=5)
    assert len(set(found.order.tolist())) == 5 and (np.diff(found.volume) < 0).all() and found.volume[0] < 1
    known = found.prior + found.information
    gains = (np.linalg.slogdet(known)[1] - np.linalg.slogdet(known[..., 2:, 2:])[1]).mean(axis=0)
    assert found.order[0] == int(np.argmax(gains))
    later = plan(configurations, grid(), sigma=0.1, picks=100, measured=[int(found.order[0])])
    assert later.order[:4].tolist() == found.order[1:].tolist()
    assert sorted([*later.order, found.order[0]]) == list(range(9)), "all others, none twice"
    alone = plan(configurations.take([4]), grid(), sigma=0.1, picks=1)  # whatever else is measured
    np.testing.assert_array_equal(alone.strength[0], found.strength[4])


@pytest.mark.thorough
def test_the_least_informative_of_the_lab_are_those_that_move_least(shipped_data):
    """``Plan.total`` by relaxations under a bend and a twist that are a little larger and smaller."""
    observations, searched = load_observations(shipped_data / "lab_a" / "nylon.npz"), grid(13, 9)
    clamps, cells, step = observation_clamps(observations), searched.cell_values(), 1e-3
    start, (cell, row) = start_configuration(observations, clamps), np.divmod(np.arange(searched.size * 60), 60)
    squares = 0.0
    for of_bend, of_twist in ((step, 0.0), (0.0, step)):
        above, below = (relax(start, Material(cells["bend_1"] * (1 + sign * of_bend), cells["twist"] * (1 + sign * of_twist)),
                              clamps, configuration_index=row, material_index=cell) for sign in (1, -1))
        shift = (above.configuration.vertices - below.configuration.vertices) / (2 * step)
        sound = above.converged & above.stable & below.converged & below.stable
        moved = np.where(sound, np.sqrt((shift**2).sum(axis=-1).mean(axis=-1)), np.nan)
        squares = squares + np.nanmedian(moved.reshape(searched.size, 60), axis=0) ** 2
    found = plan(observations, searched, sigma=0.12)
    assert found.least in np.argsort(squares)[:3] and np.corrcoef(found.total, np.sqrt(squares))[0, 1] > 0.95


def test_wrong_input_is_reported(configurations):
    apart = replace(configurations, vertices=configurations.vertices * 4, rest_length=configurations.rest_length)
    for rods, searched, sigma, words in (
            (configurations, grid(), 0.0, "sigma"), (configurations, grid(), np.nan, "sigma"),
            (configurations, Grid((parse_axis("--bend", "1e5:1e6:3"),)), 0.1, "twist: .*twist_ratio"),
            (apart, grid(), 0.1, "away from the first")):
        check_refused(words, plan, rods, searched, sigma=sigma)
