"""The continuous optimum: Θ comes back from rods made with it, intervals hold it as often as they say, doubts are told."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti import Clamp, Grid, InputError, Observations, observation_clamps, relax
from doo_ti.grid import Axis
from doo_ti.refinement.clips import held_whole
from doo_ti.refinement.folds import folds_of, refine_held_out
from doo_ti.refinement.multi_start import lowest_cells, refine_from, theta_of_cell
from doo_ti.refinement.parametrisation import Theta
from doo_ti.refinement.refine import RefinementOptions, refine
from doo_ti.types import Status
from tests.references.rods import clamps_at
from tests.relax.lab import RIBBON_WIDTH, SUTURES, Lab, lab
from tests.relax.rods import wandering

NOISE = 0.12  # mm


def made(rods: Lab, theta: Theta, noise: float = 0.0, rng: np.random.Generator | None = None) -> Observations:
    """Observations of the lab's clamps, of the same mesh as the model, under ``theta``; noise on the inner marks."""
    made_of = relax(rods.start, theta.material, rods.clamps, up=theta.up).configuration
    vertices = made_of.vertices
    if noise:
        vertices[:, 1:-1] += noise * rng.normal(size=vertices[:, 1:-1].shape)
    frames = None if rods.observations.frames is None else made_of.frames
    return replace(rods.observations, vertices=vertices, frames=frames, sigma=np.array(noise) if noise else None)


def relative_errors(theta: Theta, truth: Theta) -> list[float]:
    return [abs(theta.bend[0, 0] / truth.bend[0, 0] - 1), abs(theta.bend[1, 1] / truth.bend[1, 1] - 1),
            abs(theta.twist / truth.twist - 1)]


@pytest.mark.parametrize("name", SUTURES)
def test_noise_free_rods_give_their_theta_back(shared_data, name):
    rods = lab(shared_data, name)
    truth = Theta(rods.bend, rods.twist)
    found = refine(made(rods, truth), rods.clamps, Theta(1.4 * rods.bend, 0.8 * rods.twist))
    assert found.converged and found.used.all() and not found.other_branch.any()
    assert max(relative_errors(found.theta, truth)) < 1e-4 and found.mean_distance < 1e-5


def test_a_noise_free_ribbon_gives_its_three_back(shared_data):
    rods = lab(shared_data, "ribbon").take(np.arange(0, 60, 3))
    truth = Theta(rods.bend, rods.twist)
    options = RefinementOptions(("bend_1", "bend_2", "twist"), frame_weight=RIBBON_WIDTH)
    observations = made(rods, truth)
    begin = Theta(np.diag([1.3, 0.8]) * rods.bend, 1.2 * rods.twist)
    found = refine(observations, observation_clamps(observations), begin, options)
    assert found.converged and max(relative_errors(found.theta, truth)) < 1e-3


def test_rest_curvature_and_up_come_back(shared_data):
    rods = lab(shared_data, "vicryl").take(np.arange(0, 60, 2))
    truth = Theta(rods.bend, rods.twist, 1.0, [2e-3, -1e-3], np.array([0.05, -0.08, 1.0]) / np.linalg.norm([0.05, -0.08, 1.0]))
    options = RefinementOptions(("bend", "twist", "rest_curvature", "up"))
    found = refine(made(rods, truth), rods.clamps, Theta(1.2 * rods.bend, rods.twist), options)
    assert found.converged and max(relative_errors(found.theta, truth)) < 1e-3
    np.testing.assert_allclose(found.theta.rest_curvature, truth.rest_curvature, atol=1e-6)
    np.testing.assert_allclose(found.theta.up, truth.up, atol=1e-4)


def test_noise_leaves_theta_in_its_region_and_chi_square_at_one(shared_data, rng):
    rods = lab(shared_data, "vicryl")
    truth = Theta(rods.bend, rods.twist)
    observations = made(rods, truth, NOISE, rng)
    found = refine(observations, rods.clamps, Theta(0.8 * rods.bend, rods.twist))
    assert found.reaches_noise and "to their noise" in found.verdict and abs(found.neighbours) < 0.05
    assert found.reduced_chi_square == pytest.approx(1, abs=0.08)
    assert found.estimate.holds(truth, 0.9999) and found.left_out == {}
    unknown = refine(replace(observations, sigma=None), rods.clamps, Theta(0.8 * rods.bend, rods.twist))
    assert unknown.sigma == pytest.approx(NOISE, rel=0.04) and unknown.reaches_noise is None
    assert unknown.reduced_chi_square == 1 and "by construction" in unknown.verdict
    np.testing.assert_allclose(unknown.theta.bend, found.theta.bend, rtol=1e-6)
    np.testing.assert_allclose(unknown.estimate.covariance, found.estimate.covariance, rtol=0.1)


def test_a_rod_in_another_equilibrium_than_was_observed_is_a_misfit(shared_data, rng):
    rods = lab(shared_data, "vicryl").take(np.arange(0, 60, 3))
    truth = Theta(rods.bend, rods.twist)
    observations = made(rods, truth, NOISE, rng)
    twist = observations.total_twist.copy()
    twist[4] += 2 * np.pi
    found = refine(replace(observations, total_twist=twist), rods.clamps, truth)
    assert np.flatnonzero(found.misfits).tolist() == [4] and found.reaches_noise is False
    assert not refine(observations, rods.clamps, truth).misfits.any()


def test_a_model_that_lacks_something_is_told(shared_data):
    """The lab's own rods are finer, clipped and bent at rest."""
    rods = lab(shared_data, "silk")
    observations = replace(rods.observations, sigma=np.array(NOISE))
    found = refine(observations, rods.clamps, Theta(rods.bend, rods.twist))
    assert found.reduced_chi_square > 10 and found.reaches_noise is False and "does not reach the noise" in found.verdict
    assert found.mean_distance < found.start_mean_distance
    unknown = refine(rods.observations, rods.clamps, Theta(rods.bend, rods.twist))
    assert unknown.misses_something and unknown.neighbours > 0.8 and "lacks something" in unknown.verdict


def test_what_nothing_determines_is_named(rng):
    """Twist where both spins are free; a common factor of bend and weight where both are learned."""
    rods = wandering(rng, 12, 12)
    observations = Observations(rods.vertices, rest_length=np.full(12, 3.0))
    clamps = observation_clamps(observations)
    found = refine(observations, clamps, Theta(2e3 * np.eye(2), 2e3), RefinementOptions(("bend", "twist", "weight")))
    assert "twist" in found.estimate.left_open
    assert any(set(direction.split()) >= {"bend", "weight", "+"} for direction in found.estimate.left_open)
    assert found.theta.twist == pytest.approx(2e3)
    high = found.estimate.parameters[1].high
    assert not np.isfinite(high) or high > 1e100


def test_rods_without_an_equilibrium_do_not_count(shared_data):
    rods = lab(shared_data, "nylon").take(np.arange(6))
    observations = made(rods, Theta(rods.bend, rods.twist))
    rods.clamps.end_position[2] += [500.0, 0.0, 0.0]
    found = refine(observations, rods.clamps, Theta(1.2 * rods.bend, rods.twist))
    assert found.used.tolist() == [True, True, False, True, True, True] and found.left_out == {"infeasible": 1}
    assert max(relative_errors(found.theta, Theta(rods.bend, rods.twist))) < 1e-4
    assert found.status[2] == Status.INFEASIBLE and np.isnan(found.distance[2]) and np.isfinite(found.mean_distance)
    rods.clamps.end_position[:] += [500.0, 0.0, 0.0]
    with pytest.raises(InputError, match="no rod is converged"):
        refine(observations, rods.clamps, Theta(rods.bend, rods.twist))


def test_the_same_input_gives_the_same_output(shared_data):
    rods = lab(shared_data, "nylon").take(np.arange(0, 60, 5))
    first, second = (refine(rods.observations, rods.clamps, Theta(rods.bend, rods.twist)) for _ in range(2))
    np.testing.assert_array_equal(first.theta.bend, second.theta.bend)
    np.testing.assert_array_equal(first.estimate.covariance, second.estimate.covariance)


def test_the_best_of_several_starts_comes_first(shared_data):
    rods = lab(shared_data, "silk").take(np.arange(0, 60, 4))
    truth = Theta(rods.bend, rods.twist)
    starts = [Theta(2 * rods.bend, 8 * rods.twist), Theta(1.1 * rods.bend, rods.twist)]
    found = refine_from(made(rods, truth), rods.clamps, starts)
    assert len(found) == 2 and max(relative_errors(found[0].theta, truth)) < 1e-3
    assert found[0].sigma <= found[1].sigma


def test_lowest_cells_are_those_no_neighbour_is_below():
    grid = Grid((Axis("bend", np.geomspace(1e5, 1e7, 4)), Axis("twist", np.geomspace(1e5, 1e7, 3))))
    height = np.array([[3, 2, 5], [4, 9, 5], [np.nan, 9, 1], [0, 7, 6]], dtype=float).ravel()
    assert lowest_cells(grid, height, 5).tolist() == [9, 8, 1]
    assert lowest_cells(grid, height, 2).tolist() == [9, 8]
    assert not len(lowest_cells(grid, np.full(12, np.nan), 2))
    theta = theta_of_cell(grid, 8, [0.0, 1.0, 0.0])
    assert (theta.bend[0, 0], theta.twist, theta.up.tolist()) == (grid.axes[0].values[2], 1e7, [0, 1, 0])


def test_folds_cut_no_group_apart():
    groups = np.array([4, 4, 4, 1, 1, 2, 9, 9, 9, 9])
    fold = folds_of(groups, 3)
    assert all(len(set(fold[groups == group])) == 1 for group in groups)
    assert sorted(np.bincount(fold).tolist()) == [3, 3, 4]
    for count in (1, 5):
        with pytest.raises(InputError, match="give 2 to 4 folds"):
            folds_of(groups, count)


def test_held_out_errors_are_those_of_rods_the_fit_did_not_see(shared_data, rng):
    rods = lab(shared_data, "vicryl").take(np.arange(0, 60, 5))
    observations = made(rods, Theta(rods.bend, rods.twist), NOISE, rng)
    fold = folds_of(np.arange(12), 3)
    found = refine_held_out(observations, rods.clamps, Theta(rods.bend, rods.twist), fold)
    inside = np.flatnonzero(fold != 1)
    alone = refine(observations.take(inside), rods.clamps.take(inside), Theta(rods.bend, rods.twist))
    np.testing.assert_array_equal(found.refinements[1].theta.bend, alone.theta.bend)
    assert found.sound.all() and len(found.refinements) == 3
    # Eq. 1 of marks that are 0.12 mm off in each coordinate: √(8/π) of that, of 31 marks over 33.
    assert found.mean_distance == pytest.approx(NOISE * np.sqrt(8 / np.pi) * 31 / 33, rel=0.1)
    assert 0 < found.standard_error < 0.05


def test_held_edges_are_cut_from_outside(rng):
    rods = wandering(rng, 3, 12)
    observations = Observations(rods.vertices, rest_length=np.full(12, 3.0), start_frame=rods.frames[:, 0])
    cut = held_whole(observations, 1.0)
    np.testing.assert_allclose(cut.vertices[:, 1:-1], observations.vertices[:, 1:-1], atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(cut.vertices[:, 1] - cut.vertices[:, 0], axis=1), 1.0)
    np.testing.assert_allclose(cut.vertices[:, 1] - cut.vertices[:, 0], rods.frames[:, 0, :, 0], atol=1e-9)
    assert cut.rest_length.tolist() == [1.0, *[3.0] * 10, 1.0]
    for length in (0.0, 3.5):
        with pytest.raises(InputError, match="below theirs"):
            held_whole(observations, length)


def test_a_frame_weight_needs_frames(rng):
    observations = Observations(wandering(rng, 3, 12).vertices)
    with pytest.raises(InputError, match="a frame weight is given"):
        refine(observations, observation_clamps(observations), Theta(1e5 * np.eye(2), 1e5), RefinementOptions(frame_weight=5.0))


def test_spins_that_are_free_do_not_keep_rest_curvature_from_being_learned(rng):
    rods = wandering(rng, 12, 12, wander=0.05)
    truth = Theta(3e4 * np.eye(2), 3e4, 1.0, [0.02, 0.0])
    clamps = clamps_at(rods, Clamp.TANGENT, Clamp.TANGENT)
    seen = relax(rods, truth.material, clamps).configuration
    observations = Observations(seen.vertices, rest_length=np.full(12, 3.0))
    found = refine(observations, clamps, Theta(3.3e4 * np.eye(2), 3e4), RefinementOptions(("bend", "rest_curvature")))
    size = np.linalg.norm(found.theta.rest_curvature)
    assert size == pytest.approx(0.02, rel=0.02) and "rest_curvature[1]" in found.estimate.left_open
