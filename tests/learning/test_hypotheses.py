"""Unknown turns and spins: one hypothesis for each observation, the same in all cells, where the data allow."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti import Axis, Clamp, Grid, InputError, load_observations, observation_clamps, read_landscape, sweep
from doo_ti.learning.experiment import Experiment, SweepOptions
from doo_ti.learning.terms import Hypotheses, hypotheses_of, nearest, resolved, scores, started
from tests.io.rods import joint_twist
from tests.learning.lab import DYNAMIC, small_lab

THREE = Hypotheses(np.repeat(np.arange(4), 3), np.tile([-1, 0, 1], 4))
SMALL = Grid((Axis("bend", np.geomspace(5e4, 1e7, 16)), Axis("twist_ratio", np.geomspace(0.1, 6, 16))))


def test_scores_are_means_over_the_rods_of_a_hypothesis(rng):
    of_rod = rng.integers(0, 5, 40)
    of_rod[:5] = np.arange(5)
    distance, weight, sound = rng.uniform(1, 9, (7, 40)), rng.uniform(0.1, 3, 40), rng.uniform(size=(7, 40)) < 0.9
    distance[2, 6] = np.nan
    mean, whole = scores(distance, sound, weight, of_rod)
    for cell in range(7):
        for h in range(5):
            rods = of_rod == h
            expected = np.sum(distance[cell, rods] * weight[rods]) / weight[rods].sum()
            assert np.isclose(mean[cell, h], np.inf if np.isnan(expected) else expected)
            assert whole[cell, h] == sound[cell, rods].all()


def test_the_nearest_sound_one_in_each_cell(rng):
    distance = rng.uniform(1, 9, (30, 12))
    sound = rng.uniform(size=distance.shape) < 0.7
    for cell, chosen in enumerate(nearest(distance, sound, THREE)):
        for observation in range(4):
            own = np.arange(3 * observation, 3 * observation + 3)
            good = own[sound[cell, own]] if sound[cell, own].any() else own
            assert chosen[observation] == good[np.argmin(distance[cell, good])]


def test_what_explains_an_observation_stands_for_it_in_all_cells(rng):
    """The right hypothesis is near in the right cell only; elsewhere another one may be nearer."""
    true, best = np.array([2, 3, 8, 10]), 17
    distance = rng.uniform(2, 9, (40, 12))
    distance[best, :] = 8
    distance[best, true] = 0.3
    sound = np.ones(distance.shape, dtype=bool)
    chosen, ambiguous = resolved(distance, sound, np.ones(4), THREE)
    assert (chosen == true).all() and not ambiguous.any()
    assert (nearest(distance, sound, THREE) != true).any()
    # A runner-up within 5 %: each cell keeps its nearest for that observation alone.
    distance[best, 4] = 0.31
    chosen, ambiguous = resolved(distance, sound, np.ones(4), THREE)
    assert ambiguous.tolist() == [False, True, False, False] and (chosen[:, [0, 2, 3]] == true[[0, 2, 3]]).all()
    np.testing.assert_array_equal(chosen[:, 1], nearest(distance, sound, THREE)[:, 1])
    # Rods that did not converge are not chosen, nor are those whose distance is NaN.
    sound[best, 3], distance[best, 2] = False, np.inf
    chosen, ambiguous = resolved(distance, sound, np.ones(4), THREE)
    assert (chosen[:, 1] == 4).all() and chosen[0, 0] != 2
    nothing, ambiguous = resolved(np.full((3, 12), np.inf), sound[:3], np.ones(4), THREE)
    assert ambiguous.all() and nothing.shape == (3, 4)


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["nylon", "vicryl", "silk"])
def test_turns_of_the_lab_are_recovered(tmp_path, laboratory, name):
    """Without total_twist every one of 60 observations gets the turn that the labels give, and the landscape is the same."""
    observations = load_observations(laboratory / "lab_a" / f"{name}.npz")
    labelled = Experiment(observations, SMALL).hypotheses
    summary = sweep(tmp_path / "none", replace(observations, total_twist=None), SMALL)
    settled = summary["hypotheses"]
    kept = Hypotheses.from_dict(settled["kept"])
    sure = ~np.isin(kept.observation, settled["ambiguous"])
    right = kept.turns[sure] == labelled.turns[kept.observation[sure]]
    assert (settled["hypotheses"], settled["resolved"]) == (180, 60) and right.all()
    assert summary["timing"]["relaxed_rods"] == 180 * SMALL.size
    sweep(tmp_path / "hint", observations, SMALL)
    with_hint, without = (read_landscape(tmp_path / run) for run in ("hint", "none"))
    assert with_hint.best == without.best
    np.testing.assert_array_equal(with_hint.distance, without.distance)


def test_measured_frames_leave_no_turn_open(laboratory):
    ribbon = replace(load_observations(laboratory / "lab_a" / "ribbon.npz"), total_twist=None)
    assert not Experiment(ribbon, SMALL).hypotheses.are_several


@pytest.mark.thorough
def test_turns_under_eq_3_are_judged_where_rods_set_out(tmp_path, laboratory):
    """After a jump two turns may end alike; before it they do not."""
    observations = load_observations(laboratory / "lab_a" / "silk.npz")
    summary = sweep(tmp_path / "none", replace(observations, total_twist=None), SMALL, options=DYNAMIC)
    kept = summary["hypotheses"]["kept"]
    assert kept["turns"] == Experiment(observations, SMALL, DYNAMIC).hypotheses.turns.tolist()


def test_spins_are_spread_over_a_turn():
    observations = replace(small_lab(), end_frame=None, total_twist=None)
    clamps = observation_clamps(observations)
    assert (clamps.start, clamps.end) == (Clamp.FRAME, Clamp.TANGENT)
    found = hypotheses_of(observations, clamps, spins=8)
    assert found.count == 6 * 8 * 3 and found.are_several
    start, held = started(observations, clamps, found)
    assert (held.start, held.end) == (Clamp.FRAME, Clamp.FRAME)
    np.testing.assert_allclose(start.frames[:, -1], held.end_frame, atol=1e-12)
    np.testing.assert_allclose(held.end_frame[..., 0], clamps.end_frame[found.observation][..., 0], atol=1e-12)
    total = np.sort(joint_twist(start.quaternions).sum(axis=1).reshape(6, 24), axis=1)
    np.testing.assert_allclose(np.diff(total, axis=1), np.pi / 4, atol=1e-9)
    # The start's spin may be the unknown one, or a hint may leave one turn for each angle.
    turned = replace(small_lab(), start_frame=None, total_twist=None)
    clamps = observation_clamps(turned)
    start, held = started(turned, clamps, hypotheses_of(turned, clamps, spins=8))
    total = np.sort(joint_twist(start.quaternions).sum(axis=1).reshape(6, 24), axis=1)
    np.testing.assert_allclose(np.diff(total, axis=1), np.pi / 4, atol=1e-9)
    np.testing.assert_allclose(held.end_frame, clamps.end_frame[np.repeat(np.arange(6), 24)], atol=1e-12)
    hinted = replace(small_lab(), end_frame=None)
    assert hypotheses_of(hinted, observation_clamps(hinted), spins=8).count == 6 * 8


@pytest.mark.thorough
def test_an_unknown_spin_is_found(tmp_path):
    """The rods of the small lab without their end frames: with 24 angles the twist of the labels is found again, and
    the material with it; an end that may spin does not determine twist."""
    known = small_lab()
    unknown = replace(known, end_frame=None, total_twist=None)
    grid = Grid((Axis("bend", [2e5, 4e5, 8e5]), Axis("twist_ratio", [0.5, 1.0, 2.0])))
    labelled = sweep(tmp_path / "known", known, grid)["best"]
    summary = sweep(tmp_path / "spins", unknown, grid, options=SweepOptions(spins=12))
    assert (summary["best"]["bend_1"], summary["best"]["twist"]) == (labelled["bend_1"], labelled["twist"])
    kept = Hypotheses.from_dict(summary["hypotheses"]["kept"])
    sure = ~np.isin(kept.observation, summary["hypotheses"]["ambiguous"])
    start, _ = started(unknown, observation_clamps(unknown), kept.take(sure))
    off = joint_twist(start.quaternions).sum(axis=1) - known.total_twist[kept.observation[sure]]
    print(f"{sure.sum()} of 6 resolved, twist off by {np.degrees(off).round(1).tolist()} degrees")
    assert sure.sum() >= 4 and (np.abs(off) < np.radians(45)).all()
    assert len(read_landscape(tmp_path / "spins").observation) == 6


def test_spins_that_are_not_unknown_are_refused():
    observations = small_lab()
    with pytest.raises(InputError, match="spins: "):
        Experiment(observations, SMALL, SweepOptions(spins=4))
    with pytest.raises(InputError, match="spins: "):
        Experiment(replace(observations, end_frame=None), SMALL, SweepOptions(spins=4, clamp_start=Clamp.POSITION))
    bare = replace(observations, start_frame=None, end_frame=None, total_twist=None)
    assert Experiment(bare, SMALL, SweepOptions(spins=4)).hypotheses.count == 6 * 4 * 3
    flat = Grid((Axis("bend_1", [1e5, 1e6]), Axis("bend_2", 1e5)))
    with pytest.raises(InputError, match="roll"):
        Experiment(bare, flat, SweepOptions(spins=4))
