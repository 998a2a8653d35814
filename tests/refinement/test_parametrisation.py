"""Unknowns without bounds, their derivatives, the prior, and what an estimate says."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from doo_ti import InputError, Material, Newton, relax, relax_again
from doo_ti.refinement.estimate import Estimate
from doo_ti.refinement.linear_density import relative_stiffness, stiffness, weight_per_length
from doo_ti.refinement.parametrisation import Parametrisation, Theta
from doo_ti.refinement.sensitivity import sensitivity
from tests.references.rods import clamps_at
from tests.relax.rods import wandering

SHARP = Newton(tolerance=1e-12, first_shift=0.0)
LENGTHS = np.array([2.0, 3.0, 4.0, 3.0, 2.0, 5.0, 3.0, 3.0, 3.0, 2.0, 2.0, 3.0])
RIBBON = Theta([[2e5, 3e4], [3e4, 1e5]], 1.5e5, 1.2, [2e-3, -1e-3], np.array([0.2, 0.1, 1.0]) / np.sqrt(1.05))
ROUND = Theta(2e5 * np.eye(2), 1.5e5)


def unknowns(*names, spread=1 / 300, reach=9.0) -> Parametrisation:
    return Parametrisation(names, LENGTHS, spread, reach)


@pytest.mark.parametrize("names, theta", [
    (("bend", "twist", "weight", "rest_curvature", "up"), ROUND),
    (("bend_1", "twist", "bend_2", "bend_12", "up"), RIBBON),
    (("bend_2", "rest_curvature", "weight"), RIBBON),
    (("bend_1", "rest_curvature_per_joint"), RIBBON),
])
def test_rods_move_as_the_chain_rule_says(rng, names, theta):
    space = unknowns(*names)
    theta = space.begun(theta, 0.3)
    rods = wandering(rng, 3, 12, rest_length=LENGTHS)
    solution = relax(rods, theta.material, clamps_at(rods), SHARP, up=theta.up)
    elementary, chain = space.chain(theta)
    slopes = sensitivity(solution, elementary).vertices @ chain

    def moved(step):
        there = space.moved(theta, step)
        tilted = replace(solution, tables=replace(solution.tables, up=there.up))
        return relax_again(tilted, there.material, SHARP).configuration.vertices

    for column in range(min(len(space.names), 8)):
        step = np.zeros(len(space.names))
        step[column] = 1e-4 * space.scale[column]
        expected = (moved(step) - moved(-step)) / (2 * step[column])
        own = slopes[..., column]
        np.testing.assert_allclose(own, expected, atol=2e-6 * np.abs(expected).max(), err_msg=space.names[column])


def test_no_step_leaves_the_materials_there_are(rng):
    space = unknowns("bend_1", "bend_2", "bend_12", "twist", "weight", "up")
    for _ in range(50):
        theta = space.moved(RIBBON, 3 * rng.normal(size=len(space.names)))
        assert isinstance(theta.material, Material) and np.linalg.norm(theta.up) == pytest.approx(1.0)


def test_steps_add_up_and_what_is_not_learned_stays():
    space = unknowns("bend_1", "bend_12")
    step = np.array([0.3, -0.2])
    there = space.moved(space.moved(RIBBON, step), -step)
    np.testing.assert_allclose(there.bend, RIBBON.bend)
    once = space.moved(RIBBON, np.array([0.3, 0.0]))
    assert once.bend[0, 1] / np.sqrt(once.bend[0, 0] * once.bend[1, 1]) == pytest.approx(3e4 / np.sqrt(2e10))
    assert (once.twist, once.weight, once.bend[1, 1]) == (RIBBON.twist, RIBBON.weight, pytest.approx(1e5))


def test_the_prior_is_the_inverse_of_its_covariance():
    space = unknowns("bend", "rest_curvature_per_joint", spread=0.004, reach=7.0)
    place = np.cumsum(LENGTHS)[:-1]
    covariance = 0.004**2 * np.exp(-np.abs(place[:, None] - place) / 7.0)
    theta = space.begun(ROUND, 0.3)
    value, slope, half = space.prior(theta)
    np.testing.assert_allclose(half[1::2, 1::2], np.linalg.inv(covariance), rtol=1e-9, atol=1e-6)
    assert (half[1::2, 2::2] == 0).all() and (half[0] == 0).all()
    curvature = theta.rest_curvature[:, 0]
    assert value == pytest.approx(curvature @ np.linalg.solve(covariance, curvature))
    np.testing.assert_allclose(slope[1::2], np.linalg.solve(covariance, curvature), rtol=1e-9)


@pytest.mark.parametrize("names, message", [
    (("bent",), "unknown"), (("bend", "bend_1"), "beside"), ((), "each parameter once"), (("bend", "bend"), "once"),
    (("rest_curvature", "rest_curvature_per_joint"), "beside"),
])
def test_contradicting_parameters_are_refused(names, message):
    with pytest.raises(InputError, match=message):
        unknowns(*names)


def test_a_theta_that_does_not_fit_is_refused():
    with pytest.raises(InputError, match="not round"):
        unknowns("bend").begun(RIBBON)
    with pytest.raises(InputError, match="joint to joint"):
        unknowns("rest_curvature").begun(replace(ROUND, rest_curvature=np.zeros((11, 2))))
    with pytest.raises(InputError, match="no logarithm"):
        unknowns("weight").begun(replace(ROUND, weight=0.0))
    with pytest.raises(InputError, match="vary along the rod"):
        Theta.of(Material(1e5, np.full((1, 11), 1e5)))


def estimate(*names, covariance, degrees=np.inf, theta=RIBBON) -> Estimate:
    return Estimate(theta, unknowns(*names), np.asarray(covariance, dtype=float), degrees)


def test_intervals_are_factors_of_what_is_positive():
    found = estimate("bend_1", "rest_curvature", covariance=np.diag([0.04, 1e-8, 4e-8]), degrees=20)
    reach = stats.t.ppf(0.975, 20)
    bend, first, second = found.parameters
    assert (bend.low, bend.high) == pytest.approx((2e5 * np.exp(-0.2 * reach), 2e5 * np.exp(0.2 * reach)))
    assert (second.low, second.value, second.high) == pytest.approx((-1e-3 - 2e-4 * reach, -1e-3, -1e-3 + 2e-4 * reach))
    assert (bend.unit, first.unit, bend.error) == ("mm³", "1/mm", pytest.approx(0.2))


def test_a_region_s_outline_is_on_its_border(rng):
    root = rng.normal(size=(3, 3))
    found = estimate("bend_1", "twist", "weight", covariance=0.01 * root @ root.T, degrees=30)
    outline = np.log(found.region("twist", "bend_1") / [RIBBON.twist, 2e5])
    pair = found.covariance[np.ix_([1, 0], [1, 0])]
    squared = np.einsum("ni,ij,nj->n", outline, np.linalg.inv(pair), outline)
    np.testing.assert_allclose(squared, 2 * stats.f.ppf(0.95, 2, 30), rtol=1e-9)
    np.testing.assert_allclose(outline[0], outline[-1], atol=1e-12)
    with pytest.raises(InputError, match="was not learned"):
        found.region("bend_2", "twist")


def test_the_joint_region_holds_what_it_should(rng):
    root = rng.normal(size=(3, 3))
    covariance = 1e-4 * root @ root.T
    found = estimate("bend_1", "twist", "up", covariance=np.block(
        [[covariance, np.zeros((3, 1))], [np.zeros((1, 3)), 1e-4 * np.eye(1)]]))
    draws = rng.multivariate_normal(np.zeros(4), found.covariance, 2000)
    inside = [found.holds(found.parametrisation.moved(found.theta, draw)) for draw in draws]
    assert np.mean(inside) == pytest.approx(0.95, abs=0.015)


def test_directions_that_are_left_open_are_named():
    even = np.full((2, 2), 100.0) + 0.01 * np.eye(2)
    assert estimate("bend_1", "twist", covariance=even).left_open == ("0.71 bend_1 + 0.71 twist",) or (
        estimate("bend_1", "twist", covariance=even).left_open == ("0.71 twist + 0.71 bend_1",))
    assert estimate("bend_1", "twist", covariance=np.diag([0.01, 100.0])).left_open == ("twist",)
    assert estimate("bend_1", "twist", covariance=0.01 * np.eye(2)).left_open == ()


def test_stiffness_over_weight_does_not_know_their_common_scale():
    shared = np.full((2, 2), 1.0) + np.diag([0.01, 0.0])
    value, low, high = estimate("bend_1", "weight", covariance=shared).over_weight("bend_1")
    assert (value, low, high) == pytest.approx((2e5 / 2.4, 2e5 / 2.4 * np.exp(-0.196), 2e5 / 2.4 * np.exp(0.196)), rel=1e-4)
    assert estimate("bend_1", covariance=[[1.0]]).over_weight("twist") == pytest.approx([1.5e5 / 2.4] * 3)


def test_units_of_stiffness():
    """A steel wire of 1 mm: E 210 GPa, 7850 kg/m³."""
    area, moment = np.pi / 4 * 1e-6, np.pi / 64 * 1e-12
    density = 7850 * area * 1e3  # g/m
    bend = 2 * 210e9 * moment / (7850 * area * 9.80665) * 1e9  # mm³, weight 1
    assert stiffness(bend, 1.0, density) == pytest.approx(210e9 * moment)
    assert relative_stiffness(bend, 1.0) * weight_per_length(density) * 1e-9 == pytest.approx(210e9 * moment)
