"""The most probable Θ: it is recovered from simulated rods, intervals contain it, misfits of the model are reported."""

from dataclasses import replace

import numpy as np
import pytest

import doo_ti as d
from doo_ti import Axis, Grid, Observations, RefinementOptions, Status, Theta, observation_clamps, refine, relax
from doo_ti.refinement import residuals
from doo_ti.refinement.folds import folds_of, refine_held_out
from doo_ti.refinement.search import lowest_cells, theta_of_cell
from doo_ti.rod.frames import rotation_matrix
from tests.conftest import check_refused
from tests.references.rods import clamps_at, observed
from tests.refinement.rods_between_clips import BEND, NOISE, TRUTH, TWIST, bare, suture
from tests.relaxation.rods import wandering

QUICK = RefinementOptions(intervals="covariance")
BEGIN = Theta(1.5 * BEND * np.eye(2), 0.8 * TWIST)


@pytest.fixture(scope="module")
def seen() -> Observations:
    """Twelve observations of a curved rod between clips of 2.5 mm, noisy."""
    return suture()


def fitted(seen: Observations, theta: Theta = BEGIN, **options):
    """Between their own clamps, with intervals by the covariance unless ``options`` say otherwise."""
    return refine(seen, observation_clamps(seen), theta, replace(QUICK, **options))


def own_mesh(rng, count: int = 12, edges: int = 14, bend: float = 3e4, **theta) -> tuple[Observations, Theta]:
    """Rods of the fit's own mesh, each clamped in the middle of its outer edges, without noise."""
    rods = wandering(rng, count, edges, wander=0.12)
    truth = Theta(bend * np.eye(2), 0.7 * bend, **theta)
    return observed(relax(rods, truth.material, clamps_at(rods), up=truth.up).configuration), truth


def holds(parameter, truth: float) -> bool:
    return (parameter.low is None or parameter.low <= truth) and (parameter.high is None or truth <= parameter.high)


def assert_holds(out, **truth: float) -> None:
    """Every interval of these parameters, of bend and twist by default, holds its truth."""
    for name, value in (truth or {"bend": BEND, "twist": TWIST}).items():
        assert holds(out.estimate.parameter(name), value), name


def test_noise_free_straight_rods_between_known_clips_give_their_theta_back(rng):
    observations, truth = own_mesh(rng)
    out = fitted(observations, Theta(1.4 * truth.bend, 0.8 * truth.twist), clip=1.5, curvature="none", clamps="exact", edges=14)
    assert out.converged and out.used.all() and out.mean_distance < 1e-4
    assert (out.theta.bend[0, 0], out.theta.twist) == pytest.approx((truth.bend[0, 0], truth.twist), rel=1e-4)


@pytest.mark.thorough
def test_marks_in_a_wrong_order_are_named(rng):
    observations, truth = own_mesh(rng, count=10)
    vertices = observations.vertices + 0.02 * rng.normal(size=observations.vertices.shape)
    vertices[4, [5, 9]] = vertices[4, [9, 5]]
    vertices[7, 6] += [0.0, 6.0, 0.0]
    wrong = replace(observations, vertices=vertices, start_frame=None, end_frame=None)
    out = fitted(wrong, truth, parameters=("bend",), curvature="none")
    assert {one.observation: one.marks for one in out.mislabelled} == {4: (5, 9), 7: (6,)}
    assert not out.used[[4, 7]].any() and out.used.sum() == 8 and "5 and 9" in out.mislabelled[0].text


def test_a_rod_about_to_snap_is_no_misfit(rng, monkeypatch):
    """It is near its marks and left out because it would move far: its marks are not called wrong."""
    monkeypatch.setattr(residuals, "SOFT", 1.3)
    observations, truth = own_mesh(rng)
    out = fitted(observations, truth, parameters=("bend",), curvature="none", clip=1.5)
    assert not out.used.all() and not out.misfits.any() and not out.mislabelled
    assert out.reasons == {"about to snap": int((~out.used).sum())}


@pytest.mark.thorough
def test_uniform_curvature_and_up_come_back(rng):
    up = np.array([0.05, -0.08, 1.0]) / np.sqrt(1.0089)
    observations, truth = own_mesh(rng, rest_curvature=np.array([4e-3, -2e-3]), up=up)
    out = fitted(observations, Theta(1.2 * truth.bend, truth.twist), parameters=("bend", "twist", "up"), clip=1.5,
                 curvature="uniform", clamps="exact", edges=14)
    assert out.theta.bend[0, 0] == pytest.approx(truth.bend[0, 0], rel=1e-3)
    np.testing.assert_allclose(out.theta.rest_curvature, np.tile([4e-3, -2e-3], (13, 1)), atol=1e-5)
    np.testing.assert_allclose(out.theta.up, truth.up, atol=1e-3)


@pytest.mark.thorough
def test_a_ribbon_s_three_stiffnesses_come_back():
    ribbon = suture(frames=True, bend=((9e5, 0.0), (0.0, 3e5)), label_noise_mm=0.02)
    out = fitted(ribbon, Theta(np.diag([6e5, 4e5]), 4e5), parameters=("bend_1", "bend_2", "twist"), frame_weight=5.0)
    assert out.converged
    assert_holds(out, bend_1=9e5, bend_2=3e5, twist=TWIST)


@pytest.mark.thorough
def test_intervals_hold_the_truth_of_a_curved_rod_between_clips(seen):
    found = fitted(seen, models=True, intervals="profile")
    assert found.converged and found.used.all() and found.reasons == {}
    # The lab's fine edges clamp half an edge before the clip ends.
    assert_holds(found, bend=BEND, twist=TWIST, twist_ratio=TWIST / BEND, clip_start=2.25, clip_end=2.25)
    assert found.adequacy.noise == pytest.approx(NOISE, rel=0.1) and found.adequacy.reaches_noise
    assert abs(found.adequacy.correlation) < 0.1 and not found.adequacy.advice and found.mesh_error < NOISE
    outline = found.estimate.region("bend", "twist")
    assert outline[:, 0].min() < found.theta.bend[0, 0] < outline[:, 0].max()
    straight, = (score for score in found.scores if score.model == "straight")
    assert straight.difference < -5 * straight.error


@pytest.mark.thorough
def test_stated_errors_of_frames_and_marks_are_taken_and_checked(seen):
    tight, learned = (fitted(seen, frame_error=error) for error in ((0.05, 1e-3), None))
    assert tight.estimate.scales["turn_scatter"] == 1e-3 and learned.estimate.scales["turn_scatter"] != 1e-3
    assert_holds(tight, bend=BEND)
    right, small = (fitted(replace(seen, sigma=np.array(sigma))) for sigma in (NOISE, 0.02))
    assert right.adequacy.stated and right.adequacy.reaches_noise and right.adequacy.excess == pytest.approx(1, abs=0.1)
    assert not small.adequacy.reaches_noise


@pytest.mark.thorough
@pytest.mark.parametrize("factor", [0.1, pytest.param(3.0, marks=pytest.mark.slow)])
def test_whole_turns_that_nobody_measured_are_found(factor):
    """Under a twist stiffness that is far too low rods with a wrong turn fit, and confirm it."""
    twisted = suture(end_rotations_deg=(0.0, 90.0, 170.0, 250.0, -120.0, -200.0), end_distances_mm=(42.0, 78.0))
    out = fitted(replace(twisted, total_twist=None), Theta(BEND * np.eye(2), factor * TWIST))
    assert out.converged and out.used.all()
    assert_holds(out)


@pytest.mark.thorough
def test_whole_turns_that_were_measured_wrong_are_left_out():
    """In one rod of eight, which may be a misfit instead, and in all."""
    twisted = suture(end_rotations_deg=(0.0, 90.0, 170.0, -120.0), end_distances_mm=(42.0, 66.0))
    for wrong in ([], [2], slice(None)):
        measured = twisted.total_twist.copy()
        measured[wrong] += 2 * np.pi
        out = fitted(replace(twisted, total_twist=measured))
        assert holds(out.estimate.parameter("twist"), TWIST), wrong
        assert wrong == [2] or out.turns_ignored == (wrong != [])


def test_what_a_model_lacks_is_named(seen):
    out = fitted(seen, curvature="none", clip=0.0, clamps="exact")
    assert not out.adequacy.reaches_noise and out.adequacy.gap > NOISE
    assert {"rest_curvature=field", "clip=unknown"} <= {one.option for one in out.adequacy.advice}


@pytest.mark.thorough
def test_a_parameter_the_rods_do_not_feel_changes_no_interval(rng):
    """Twist where the rolls of both ends are unknown: not determined, and bend as without it."""
    rods, truth = own_mesh(rng)
    vertices = rods.vertices + 0.02 * rng.normal(size=rods.vertices.shape)
    observations = replace(rods, vertices=vertices, start_frame=None, end_frame=None)
    with_twist, without = (fitted(observations, truth, parameters=names, curvature="none", intervals="profile").estimate
                           for names in (("bend", "twist"), ("bend",)))
    assert "twist" in with_twist.left_open
    assert with_twist.parameter("bend").error == pytest.approx(without.parameter("bend").error, rel=0.1)


@pytest.mark.thorough
def test_a_common_scale_is_not_determined(seen):
    out = fitted(seen, parameters=("bend", "twist", "weight"))
    assert {"bend", "twist", "weight"} <= set(out.estimate.left_open)
    over = next(one for one in out.estimate.over_weight if one.name == "bend")
    assert holds(over, BEND / 2) and 0 < over.low < BEND / 2


@pytest.mark.thorough
def test_missing_marks_and_wrong_branches(seen):
    valid, twist = seen.valid.copy(), seen.total_twist.copy()
    valid[:, 5:25:4] = False
    twist[[2, 7]] += 2 * np.pi
    out = fitted(replace(seen, valid=valid, total_twist=twist))
    assert out.used.sum() >= 10
    assert_holds(out)


@pytest.mark.thorough
def test_rods_without_an_equilibrium_do_not_count(seen):
    clamps = observation_clamps(seen)
    apart = clamps.end_position + np.where(np.arange(12) == 2, 500.0, 0.0)[:, None] * [1, 0, 0]
    out = refine(seen, replace(clamps, end_position=apart), BEGIN, QUICK)
    assert not out.used[2] and out.used.sum() == 11 and out.reasons == {"infeasible": 1}
    assert out.status[2] == Status.INFEASIBLE and np.isnan(out.distance[2]) and np.isfinite(out.mean_distance)
    check_refused("no rod is converged", refine, seen, replace(clamps, end_position=apart + [500.0, 0.0, 0.0]), BEGIN, QUICK)


def test_lowest_cells_are_those_no_neighbour_is_below():
    grid = Grid((Axis("bend", np.geomspace(1e5, 1e7, 4)), Axis("twist", np.geomspace(1e5, 1e7, 3))))
    height = np.array([[3, 2, 5], [4, 9, 5], [np.nan, 9, 1], [0, 7, 6]], dtype=float).ravel()
    assert lowest_cells(grid, height, 5).tolist() == [9, 8, 1] and lowest_cells(grid, height, 2).tolist() == [9, 8]
    assert not len(lowest_cells(grid, np.full(12, np.nan), 2))
    theta = theta_of_cell(grid, 8, [0.0, 1.0, 0.0])
    assert (theta.bend[0, 0], theta.twist, theta.up.tolist()) == (grid.axes[0].values[2], 1e7, [0, 1, 0])


def test_folds_cut_no_group_apart():
    groups = np.array([4, 4, 4, 1, 1, 2, 9, 9, 9, 9])
    fold = folds_of(groups, 3)
    assert all(len(set(fold[groups == group])) == 1 for group in groups)
    assert sorted(np.bincount(fold).tolist()) == [3, 3, 4]
    for count in (1, 5):
        check_refused("give 2 to 4 folds", folds_of, groups, count)


@pytest.mark.thorough
def test_held_out_errors_are_those_of_rods_the_fit_did_not_see(seen):
    fold = folds_of(np.arange(12), 3)
    out = refine_held_out(seen, observation_clamps(seen), TRUTH, fold, QUICK)
    alone = fitted(seen.take(np.flatnonzero(fold != 1)), TRUTH)
    np.testing.assert_array_equal(out.refinements[1].theta.bend, alone.theta.bend)
    assert out.sound.all() and len(out.refinements) == 3
    # Eq. 1 of marks that are NOISE off in each coordinate: √(8/π) of that, of the marks that are noisy.
    assert out.mean_distance == pytest.approx(NOISE * np.sqrt(8 / np.pi) * 31 / 33, rel=0.2)
    assert 0 < out.standard_error < 0.05


@pytest.mark.thorough
def test_a_fixed_twist_stiffness_bounds_bend_less_than_one_that_is_learned():
    """Straight rods whose frames nobody reported: a learned twist stiffness is expected near that of bend, which bounds bend. A
    fixed one is no such bound: the ratio of both may become anything."""
    rods = bare(suture(rotations=3, rest_curvature_rms_per_mm=0.0))
    fixed, learned = (fitted(rods, TRUTH, parameters=names, curvature="none", intervals="profile").estimate
                      for names in (("bend",), ("bend", "twist")))
    one, other = fixed.parameter("bend"), learned.parameter("bend")
    assert holds(one, BEND) and holds(other, BEND) and one.high > other.high
    assert one.error == pytest.approx(other.error, rel=0.1) and not learned.parameter("twist").determined


def test_wrong_options_are_refused(seen):
    clamps = observation_clamps(seen)
    for change, word in ((dict(frame_weight=5.0), "frame"), (dict(clip=60.0), "clip"), (dict(curvature="bent"), "curvature"),
                         (dict(parameters=("bent",)), "'bent' is unknown"), (dict(parameters=("bend", "bend_1")), "bend_1"),
                         (dict(edges=2), "edges"), (dict(intervals="none"), "intervals"),
                         (dict(frame_error=(0.0, 1.0)), "frame_error"),
                         (dict(frame_error=(1.0, 1.0), clamps="exact"), "frame_error"), (dict(clip=-1.0), "clip")):
        check_refused(word, refine, seen, clamps, BEGIN, replace(QUICK, **change))


@pytest.mark.thorough
def test_clips_have_intervals_in_mm_however_wide():
    """The end of a clip is a length: that it may be off by more than the logarithm of a factor of a thousand says nothing."""
    angle = np.outer([0.5, 0.8, 1.1], np.linspace(0.0, 1.0, 9))
    arcs = np.stack([np.sin(angle), 0 * angle, 1 - np.cos(angle)], axis=-1)
    observations = Observations(600.0 / angle[:, -1:, None] * arcs)
    out = fitted(observations, Theta(1e7 * np.eye(2), 1e7), parameters=("bend",), curvature="none", iterations=2)
    clip = out.estimate.parameter("clip_start")
    assert clip.low is not None and clip.high - clip.low > 7.0


@pytest.mark.thorough
def test_outer_marks_that_are_off_with_their_frames_do_not_bend_the_fit(seen):
    """Reported frames 2 degrees off about y, the outer marks 0.2 mm: the place and direction that a robot believes."""
    tilt, vertices = rotation_matrix(np.array([0.0, np.radians(2.0), 0.0])), seen.vertices.copy()
    vertices[:, [0, -1]] += [0.0, 0.1, 0.2]
    off = replace(seen, vertices=vertices, start_frame=tilt @ seen.start_frame, end_frame=tilt.T @ seen.end_frame)
    found = fitted(off, TRUTH)
    for name, truth in (("bend", BEND), ("twist", TWIST)):
        one = found.estimate.parameter(name)
        assert one.low < truth < one.high and one.value == pytest.approx(truth, rel=0.4)


@pytest.mark.thorough
def test_missing_marks_have_no_noise(rng):
    """As triangulate writes them: NaN. It used to become the noise of all."""
    rod, clamps = d.hanging(300.0, 20, np.zeros((4, 3)), [[150.0, 0, 40], [180, 0, 0], [210, 30, 0], [240, 0, -30]],
                            clamp=d.Clamp.FRAME)
    marks = d.relax(rod, d.Material(4e6, 4e6), clamps).configuration.vertices + rng.normal(0, 0.3, (4, 21, 3))
    marks[1, 7], sigma = np.nan, np.full((4, 21), 0.3)
    sigma[1, 7] = np.nan
    seen = d.Observations(marks, rest_length=np.full(20, 15.0), sigma=sigma)
    found = refine(seen, d.observation_clamps(seen), Theta(3e6 * np.eye(2), 3e6))
    assert found.adequacy.stated and found.adequacy.noise == pytest.approx(0.3) and 0.5 < found.adequacy.excess < 1.5
