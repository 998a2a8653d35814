"""The pairs of Eq. 3, from labels and from files; hypotheses about unknown turns and spins, the same in all cells."""

import re
from dataclasses import replace

import numpy as np
import pytest

from doo_ti import Axis, Clamp, Grid, load_observations, observation_clamps, read_landscape, sweep
from doo_ti.learning import terms
from doo_ti.learning.experiment import Experiment, SweepOptions
from tests.conftest import check_refused
from tests.io.rods import joint_twist
from tests.learning.lab import DYNAMIC, lab_rods, small_lab


def test_pairs_of_the_paper(laboratory):
    """12 for each end distance, 72 in all: the same distance, 120 degrees apart, both ways, not around the circle."""
    experiment, _ = lab_rods(laboratory, "nylon")
    observations, pairs = experiment.observations, experiment.pairs
    distance, rotation = observations.end_distance, observations.end_rotation
    assert pairs.count == 72 and (pairs.weight == 1).all()
    np.testing.assert_array_equal(distance[pairs.from_index], distance[pairs.to_index])
    assert (np.bincount(np.searchsorted(np.unique(distance), distance[pairs.from_index])) == 12).all()
    turned = rotation[pairs.to_index] - rotation[pairs.from_index]
    assert (np.abs(turned) == 120).all() and (turned > 0).sum() == 36
    np.testing.assert_allclose(np.degrees(pairs.rotation), turned)
    expected = {(x, y) for x in range(60) for y in range(60)
                if distance[x] == distance[y] and abs(rotation[x] - rotation[y]) == 120}
    assert set(zip(pairs.from_index.tolist(), pairs.to_index.tolist(), strict=True)) == expected


def test_files_are_read_and_written(tmp_path):
    observations, path = small_lab(), tmp_path / "pairs.csv"
    path.write_text("to, from,weight,rotation_deg\n4,0,2.5,480\n0,4,0,-120\n")
    pairs = terms.load_pairs(path, observations)
    assert (pairs.from_index.tolist(), pairs.to_index.tolist(), pairs.weight.tolist()) == ([0, 4], [4, 0], [2.5, 0])
    np.testing.assert_allclose(np.degrees(pairs.rotation), [480, -120])
    assert pairs.weighted.count == 1
    terms.save_pairs(tmp_path / "again.csv", pairs)
    again = terms.load_pairs(tmp_path / "again.csv", observations)
    for name in ("from_index", "to_index", "weight"):
        np.testing.assert_array_equal(getattr(again, name), getattr(pairs, name))
    np.testing.assert_allclose(again.rotation, pairs.rotation)
    path.write_text("from,to\n0,4\n1,3\n")
    bare = terms.load_pairs(path, observations)
    assert bare.weight.tolist() == [1, 1]
    np.testing.assert_allclose(np.degrees(bare.rotation), [120, 60])
    assert terms.load_pairs(path, replace(observations, end_rotation=None)).rotation is None


@pytest.mark.parametrize("text, words", [
    ("from,to\n0,6\n", "to: '6' in line 2 is no observation"), ("from,to\n0.5,1\n", "from: '0.5' in line 2 is not a whole"),
    ("from,to\n3,3\n", "from 3 to itself"), ("from,to\n0,1\n1,0\n0,1\n", "pair 0, 1 is given twice"),
    ("from,to,weight\n0,1,-1\n", "weight: -1 of pair 0"), ("from,to,weight\n0,1,nan\n", "weight: 'nan' in line 2"),
    ("from,to,weight\n0,1,0\n", "weight: all are zero"), ("from,to,rotation_deg\n0,1,inf\n", "rotation_deg: 'inf' in line 2"),
    ("from,to,rotation_deg\n0,1,1e6\n", "more than 100 turns"), ("from\n0\n", "to: the column is missing"),
    ("from,to,colour\n0,1,2\n", "colour: unknown column")])
def test_wrong_files(tmp_path, text, words):
    path = tmp_path / "pairs.csv"
    path.write_text(text)
    check_refused(f"pairs.csv: .*{re.escape(words)}", terms.load_pairs, path, small_lab())


def test_missing_labels_are_named():
    observations = small_lab()
    for name, key in (("end_distance", "end_distance_mm"), ("end_rotation", "end_rotation_deg")):
        check_refused(f"{key}: missing", terms.pairs_from_labels, replace(observations, **{name: None}))
    check_refused("120", terms.pairs_from_labels, replace(observations, end_rotation=np.zeros(6)))


def test_half_a_turn_needs_a_given_direction(rng):
    observations = small_lab()
    over = observations.end_frame.copy()
    over[1] = over[0] * [1, -1, -1]
    clamps = observation_clamps(replace(observations, end_frame=over))
    check_refused("0 to 1", terms.check_ways, terms.Pairs([0], [1], [1.0]), clamps)
    terms.check_ways(terms.Pairs([0], [1], [1.0], [np.pi]), clamps)
    terms.check_ways(terms.Pairs([0], [2], [1.0]), clamps)


THREE = terms.Hypotheses(np.repeat(np.arange(4), 3), np.tile([-1, 0, 1], 4))
SMALL = Grid((Axis("bend", np.geomspace(5e4, 1e7, 16)), Axis("twist_ratio", np.geomspace(0.1, 6, 16))))


def test_scores_are_means_over_the_rods_of_a_hypothesis(rng):
    of_rod = rng.integers(0, 5, 40)
    of_rod[:5] = np.arange(5)
    distance, weight, sound = rng.uniform(1, 9, (7, 40)), rng.uniform(0.1, 3, 40), rng.uniform(size=(7, 40)) < 0.9
    distance[2, 6] = np.nan
    mean, whole = terms.scores(distance, sound, weight, of_rod)
    for cell in range(7):
        for h in range(5):
            rods = of_rod == h
            expected = np.sum(distance[cell, rods] * weight[rods]) / weight[rods].sum()
            assert np.isclose(mean[cell, h], np.inf if np.isnan(expected) else expected)
            assert whole[cell, h] == sound[cell, rods].all()


def test_the_nearest_sound_one_in_each_cell(rng):
    distance = rng.uniform(1, 9, (30, 12))
    sound = rng.uniform(size=distance.shape) < 0.7
    for cell, chosen in enumerate(terms.nearest(distance, sound, THREE)):
        for observation in range(4):
            own = np.arange(3 * observation, 3 * observation + 3)
            good = own[sound[cell, own]] if sound[cell, own].any() else own
            assert chosen[observation] == good[np.argmin(distance[cell, good])]


def test_what_explains_an_observation_stands_for_it_in_all_cells(rng):
    true, best = np.array([2, 3, 8, 10]), 17
    distance = rng.uniform(2, 9, (40, 12))
    distance[best, :] = 8
    distance[best, true] = 0.3
    sound = np.ones(distance.shape, dtype=bool)
    chosen, ambiguous = terms.resolved(distance, sound, np.ones(4), THREE)
    assert (chosen == true).all() and not ambiguous.any() and (terms.nearest(distance, sound, THREE) != true).any()
    # A runner-up within 5 %: each cell keeps its nearest for that observation alone.
    distance[best, 4] = 0.31
    chosen, ambiguous = terms.resolved(distance, sound, np.ones(4), THREE)
    assert ambiguous.tolist() == [False, True, False, False] and (chosen[:, [0, 2, 3]] == true[[0, 2, 3]]).all()
    np.testing.assert_array_equal(chosen[:, 1], terms.nearest(distance, sound, THREE)[:, 1])
    # Rods that did not converge are not chosen, nor are those whose distance is NaN.
    sound[best, 3], distance[best, 2] = False, np.inf
    chosen, ambiguous = terms.resolved(distance, sound, np.ones(4), THREE)
    assert (chosen[:, 1] == 4).all() and chosen[0, 0] != 2
    nothing, ambiguous = terms.resolved(np.full((3, 12), np.inf), sound[:3], np.ones(4), THREE)
    assert ambiguous.all() and nothing.shape == (3, 4)


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["nylon", "vicryl", "silk"])
def test_turns_of_the_lab_are_recovered(tmp_path, laboratory, name):
    """Without total_twist every one of 60 observations gets the turn that the labels give, and the landscape is the same."""
    observations = load_observations(laboratory / "lab_a" / f"{name}.npz")
    labelled = Experiment(observations, SMALL).hypotheses
    summary = sweep(tmp_path / "none", replace(observations, total_twist=None), SMALL)
    settled = summary["hypotheses"]
    kept = terms.Hypotheses.from_dict(settled["kept"])
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
    assert summary["hypotheses"]["kept"]["turns"] == Experiment(observations, SMALL, DYNAMIC).hypotheses.turns.tolist()


def test_spins_are_spread_over_a_turn():
    observations = replace(small_lab(), end_frame=None, total_twist=None)
    clamps = observation_clamps(observations)
    assert (clamps.start, clamps.end) == (Clamp.FRAME, Clamp.TANGENT)
    found = terms.hypotheses_of(observations, clamps, spins=8)
    assert found.count == 6 * 8 * 3 and found.are_several
    start, held = terms.started(observations, clamps, found)
    assert (held.start, held.end) == (Clamp.FRAME, Clamp.FRAME)
    np.testing.assert_allclose(start.frames[:, -1], held.end_frame, atol=1e-12)
    np.testing.assert_allclose(held.end_frame[..., 0], clamps.end_frame[found.observation][..., 0], atol=1e-12)
    total = np.sort(joint_twist(start.quaternions).sum(axis=1).reshape(6, 24), axis=1)
    np.testing.assert_allclose(np.diff(total, axis=1), np.pi / 4, atol=1e-9)
    # The start's spin may be the unknown one, or a hint may leave one turn for each angle.
    turned = replace(small_lab(), start_frame=None, total_twist=None)
    clamps = observation_clamps(turned)
    start, held = terms.started(turned, clamps, terms.hypotheses_of(turned, clamps, spins=8))
    total = np.sort(joint_twist(start.quaternions).sum(axis=1).reshape(6, 24), axis=1)
    np.testing.assert_allclose(np.diff(total, axis=1), np.pi / 4, atol=1e-9)
    np.testing.assert_allclose(held.end_frame, clamps.end_frame[np.repeat(np.arange(6), 24)], atol=1e-12)
    hinted = replace(small_lab(), end_frame=None)
    assert terms.hypotheses_of(hinted, observation_clamps(hinted), spins=8).count == 6 * 8


@pytest.mark.thorough
def test_an_unknown_spin_is_found(tmp_path):
    """Without end frames, of 24 angles the twist of the labels is found again, and the material with it."""
    known = small_lab()
    unknown = replace(known, end_frame=None, total_twist=None)
    grid = Grid((Axis("bend", [2e5, 4e5, 8e5]), Axis("twist_ratio", [0.5, 1.0, 2.0])))
    labelled = sweep(tmp_path / "known", known, grid)["best"]
    summary = sweep(tmp_path / "spins", unknown, grid, options=SweepOptions(spins=12))
    assert (summary["best"]["bend_1"], summary["best"]["twist"]) == (labelled["bend_1"], labelled["twist"])
    kept = terms.Hypotheses.from_dict(summary["hypotheses"]["kept"])
    sure = ~np.isin(kept.observation, summary["hypotheses"]["ambiguous"])
    start, _ = terms.started(unknown, observation_clamps(unknown), kept.take(sure))
    off = joint_twist(start.quaternions).sum(axis=1) - known.total_twist[kept.observation[sure]]
    assert sure.sum() >= 4 and (np.abs(off) < np.radians(45)).all() and len(read_landscape(tmp_path / "spins").observation) == 6


def test_spins_that_are_not_unknown_are_refused():
    observations = small_lab()
    bare = replace(observations, start_frame=None, end_frame=None, total_twist=None)
    assert Experiment(bare, SMALL, SweepOptions(spins=4)).hypotheses.count == 6 * 4 * 3
    flat = Grid((Axis("bend_1", [1e5, 1e6]), Axis("bend_2", 1e5)))
    free = SweepOptions(spins=4, clamp_start=Clamp.POSITION)
    for seen, grid, options, said in ((observations, SMALL, SweepOptions(spins=4), "spins: "),
                                      (replace(observations, end_frame=None), SMALL, free, "spins: "),
                                      (bare, flat, SweepOptions(spins=4), "roll")):
        check_refused(said, Experiment, seen, grid, options)
