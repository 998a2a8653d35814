"""Which configurations inform Θ, and the order in which to measure them."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti import InputError, Material, Newton, distance, load_observations, relax, sensitivity
from doo_ti.io.scene import Synthesis
from doo_ti.refinement.plan import plan, planned
from doo_ti.rod.grid import Grid, parse_axis
from doo_ti.rod.start import observation_clamps, start_configuration

BEND, TWIST = 1.8e6, 1.2e6


def grid(*more: str) -> Grid:
    return Grid(tuple(parse_axis(*text.split("=")) for text in ("--bend=5e4:1e7:7", "--twist-ratio=0.1:6:5", *more)))


def lab(**changes) -> Synthesis:
    wanted = dict(bend=BEND, twist=TWIST, end_distances_mm=(30.0, 54.0, 78.0), end_rotations_deg=(0.0, 90.0, 180.0))
    return Synthesis(**wanted | changes)


@pytest.fixture(scope="module")
def configurations():
    return planned(lab())


def test_planned_rods_are_equilibria_of_the_model_that_is_fitted(configurations):
    clamps = observation_clamps(configurations)
    solution = relax(start_configuration(configurations, clamps), Material(BEND, TWIST), clamps)
    assert solution.stable.all()
    assert distance(solution.configuration, configurations).max() < 1e-4


def test_strength_is_how_far_marks_move(configurations):
    """One cell besides the asked parameter's two: against relaxations under a bend that is a little larger."""
    clamps = observation_clamps(configurations)
    start = start_configuration(configurations, clamps)
    narrow = Grid((parse_axis("--bend", "1.8e6:1.80001e6:2"), parse_axis("--twist", "1.2e6")))
    found = plan(configurations, narrow, sigma=0.1, picks=3)
    exact = Newton(tolerance=1e-9)
    step = 1e-4
    above, below = (relax(start, Material(BEND * factor, TWIST), clamps, exact).configuration.vertices
                    for factor in (1 + step, 1 - step))
    shift = (above - below) / (2 * step)
    wanted = np.sqrt(np.sum(shift**2, axis=(1, 2)) / shift.shape[1])
    np.testing.assert_allclose(found.strength[:, 0], wanted, rtol=1e-3)
    np.testing.assert_allclose(found.total, found.strength[:, 0])
    assert found.parameters == ("bend", "twist", "weight") and found.asked == (0,)


def test_only_ratios_matter(configurations):
    """A common factor of bend, twist and weight moves nothing: their sensitivities to logarithms add up to zero."""
    clamps = observation_clamps(configurations)
    solution = relax(start_configuration(configurations, clamps), Material(BEND, TWIST), clamps)
    moved = sensitivity(solution, ("bend", "twist", "weight")).vertices * [BEND, TWIST, 1.0]
    assert np.abs(moved.sum(axis=-1)).max() < 1e-6 * np.abs(moved).max()


@pytest.mark.thorough
def test_the_order_is_greedy_and_the_region_shrinks(configurations):
    found = plan(configurations, grid(), sigma=0.1, picks=5)
    assert len(set(found.order.tolist())) == 5 and (np.diff(found.volume) < 0).all() and found.volume[0] < 1
    def about(cell):
        known = found.prior + cell
        return np.linalg.slogdet(known)[1] - np.linalg.slogdet(known[2:, 2:])[1]

    gains = [np.mean([about(cell[row]) for cell in found.information]) for row in range(9)]
    assert found.order[0] == int(np.argmax(gains))
    later = plan(configurations, grid(), sigma=0.1, picks=2, measured=[int(found.order[0])])
    assert later.order.tolist() == found.order[1:3].tolist()


@pytest.mark.thorough
def test_measured_configurations_are_not_picked_and_picks_end(configurations):
    found = plan(configurations, grid(), sigma=0.1, picks=100, measured=[0, 4])
    assert sorted(found.order.tolist()) == [1, 2, 3, 5, 6, 7, 8]


@pytest.mark.slow
def test_the_best_ten_are_more_informative_than_ten_at_random(laboratory):
    observations = load_observations(laboratory / "lab_a" / "nylon.npz")
    found = plan(observations, grid(), sigma=0.12)
    random = np.random.default_rng(5)
    rivals = [random.choice(60, 10, replace=False) for _ in range(200)]

    def region(rows):
        """Volume, everything else integrated out, geometric mean over the cells."""
        known = found.prior + found.information[:, rows].sum(axis=1)
        return np.exp(0.5 * np.mean(np.linalg.slogdet(known[:, 2:, 2:])[1] - np.linalg.slogdet(known)[1]))

    region = [region(rows) for rows in (found.order, *rivals)]
    smaller = np.mean(region[0] < np.array(region[1:]))
    share = region[0] / np.median(region[1:])
    print(f"region of the best ten over that of ten at random (median): {share:.2f}; smaller than {smaller:.0%}")
    assert smaller > 0.95


def moved(configurations, searched: Grid) -> np.ndarray:
    """(D,) mm: the same as ``Plan.total``, by relaxations under a bend and a twist that are a little larger and smaller."""
    clamps = observation_clamps(configurations)
    start, cells = start_configuration(configurations, clamps), searched.cell_values()
    step, rods = 1e-3, np.arange(configurations.count)
    size = np.zeros((2, searched.size, len(rods)))
    for parameter in range(2):
        ends = []
        for factor in (1 + step, 1 - step):
            scale = np.where(np.arange(2) == parameter, factor, 1.0)
            material = Material(cells["bend_1"] * scale[0], cells["twist"] * scale[1])
            ends.append(relax(start, material, clamps, precision="mixed",
                              configuration_index=np.tile(rods, searched.size),
                              material_index=np.repeat(np.arange(searched.size), len(rods))))
        both = np.all([end.converged & end.stable for end in ends], axis=0)
        shift = (ends[0].configuration.vertices - ends[1].configuration.vertices) / (2 * step)
        rms = np.sqrt((shift**2).sum(axis=-1).mean(axis=-1))
        size[parameter] = np.where(both, rms, np.nan).reshape(searched.size, -1)
    return np.sqrt((np.nanmedian(size, axis=1) ** 2).sum(axis=0))


@pytest.mark.thorough
def test_the_least_informative_of_the_lab(shipped_data):
    observations = load_observations(shipped_data / "lab_a" / "nylon.npz")
    searched = Grid((parse_axis("--bend", "5e4:1e7:13"), parse_axis("--twist-ratio", "0.1:6:9")))
    found, expected = plan(observations, searched, sigma=0.12), moved(observations, searched)
    assert found.least in np.argsort(expected)[:3]
    assert np.corrcoef(found.total, expected)[0, 1] > 0.95


@pytest.mark.thorough
def test_clamps_on_one_line():
    """Untwisted the rod is an arch, which is hardly informative; of the twisted rods the least informative ones move least."""
    recipe = Synthesis(bend=BEND, twist=TWIST, start_direction=(1, 0, 0), end_direction=(1, 0, 0))
    configurations = planned(recipe)
    searched = Grid((parse_axis("--bend", "5e4:1e7:13"), parse_axis("--twist-ratio", "0.1:6:9")))
    found, expected = plan(configurations, searched, sigma=0.12), moved(configurations, searched)
    twisted = np.flatnonzero(configurations.end_rotation > 0)
    least = twisted[np.argmin(found.total[twisted])]
    assert least in twisted[np.argsort(expected[twisted])[:3]]
    assert configurations.end_rotation[found.least] == 0


@pytest.mark.thorough
def test_information_of_a_configuration_does_not_depend_on_others(configurations):
    alone = plan(configurations.take([4]), grid(), sigma=0.1, picks=1)
    together = plan(configurations, grid(), sigma=0.1, picks=1)
    np.testing.assert_array_equal(alone.strength[0], together.strength[4])


def test_wrong_input_is_reported(configurations):
    for change, word in (({"sigma": 0.0}, "sigma"), ({"sigma": np.nan}, "sigma")):
        with pytest.raises(InputError, match=word):
            plan(configurations, grid(), **change)
    with pytest.raises(InputError, match="single cell"):
        plan(configurations, Grid((parse_axis("--bend", "1e6"),)), sigma=0.1)
    with pytest.raises(InputError, match="ratios"):
        plan(configurations, grid("--weight=1:2:2"), sigma=0.1)
    with pytest.raises(InputError, match="away from the first"):
        apart = replace(configurations, vertices=configurations.vertices * 4)
        plan(replace(apart, rest_length=configurations.rest_length), grid(), sigma=0.1)
