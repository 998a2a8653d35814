"""The pairs of Eq. 3: from labels as in the paper, from files, and refused input."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti import InputError, observation_clamps
from doo_ti.learning.terms import Pairs, check_ways, load_pairs, pairs_from_labels, save_pairs
from tests.learning.lab import lab_rods, small_lab


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
    observations = small_lab()
    path = tmp_path / "pairs.csv"
    path.write_text("to, from,weight,rotation_deg\n4,0,2.5,480\n0,4,0,-120\n")
    pairs = load_pairs(path, observations)
    assert (pairs.from_index.tolist(), pairs.to_index.tolist(), pairs.weight.tolist()) == ([0, 4], [4, 0], [2.5, 0])
    np.testing.assert_allclose(np.degrees(pairs.rotation), [480, -120])
    assert pairs.weighted.count == 1
    save_pairs(tmp_path / "again.csv", pairs)
    again = load_pairs(tmp_path / "again.csv", observations)
    for name in ("from_index", "to_index", "weight"):
        np.testing.assert_array_equal(getattr(again, name), getattr(pairs, name))
    np.testing.assert_allclose(again.rotation, pairs.rotation)
    path.write_text("from,to\n0,4\n1,3\n")
    bare = load_pairs(path, observations)
    assert bare.weight.tolist() == [1, 1]
    np.testing.assert_allclose(np.degrees(bare.rotation), [120, 60])
    assert load_pairs(path, replace(observations, end_rotation=None)).rotation is None


@pytest.mark.parametrize("text, words", [
    ("from,to\n0,6\n", "to: 6 in line 2 is no observation"),
    ("from,to\n0.5,1\n", "from: 0.5 in line 2"),
    ("from,to\n3,3\n", "from 3 to itself"),
    ("from,to\n0,1\n1,0\n0,1\n", "pair 0, 1 is given twice"),
    ("from,to,weight\n0,1,-1\n", "weight: -1 of pair 0"),
    ("from,to,weight\n0,1,nan\n", "weight: 'nan' in line 2"),
    ("from,to,weight\n0,1,0\n", "weight: all are zero"),
    ("from,to,rotation_deg\n0,1,inf\n", "rotation_deg: 'inf' in line 2"),
    ("from,to,rotation_deg\n0,1,1e6\n", "more than 100 turns"),
    ("from,to\n0\n", "line 2: 1 cells"),
    ("from,to\n0,x\n", "to: 'x' in line 2"),
    ("from\n0\n", "to: the column is missing"),
    ("from,to,colour\n0,1,2\n", "colour: unknown column"),
    ("from,to\n", "no rows"),
    ("", "no rows"),
])
def test_wrong_files(tmp_path, text, words):
    path = tmp_path / "pairs.csv"
    path.write_text(text)
    with pytest.raises(InputError, match="pairs.csv") as error:
        load_pairs(path, small_lab())
    assert words in str(error.value)


def test_missing_labels_and_files(tmp_path):
    observations = small_lab()
    for name, key in (("end_distance", "end_distance_mm"), ("end_rotation", "end_rotation_deg")):
        with pytest.raises(InputError, match=f"{key}: missing"):
            pairs_from_labels(replace(observations, **{name: None}))
    with pytest.raises(InputError, match="120"):
        pairs_from_labels(replace(observations, end_rotation=np.zeros(6)))
    with pytest.raises(InputError, match="no such file"):
        load_pairs(tmp_path / "absent.csv", observations)


def test_half_a_turn_needs_a_given_direction(rng):
    """Its frames are the same whichever way it went."""
    observations = small_lab()
    over = observations.end_frame.copy()
    over[1] = over[0] * [1, -1, -1]
    clamps = observation_clamps(replace(observations, end_frame=over))
    with pytest.raises(InputError, match="0 to 1"):
        check_ways(Pairs([0], [1], [1.0]), clamps)
    check_ways(Pairs([0], [1], [1.0], [np.pi]), clamps)
    check_ways(Pairs([0], [2], [1.0]), clamps)
