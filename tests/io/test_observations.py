"""Observations: accepted values, their checked form, and errors with file, key, value and remedy."""

import pickle
import re
import warnings
import zipfile
from dataclasses import replace

import numpy as np
import pytest

from doo_ti import InputError, load_observations
from doo_ti.rod.observations import KEYS, Observations
from tests.conftest import check_refused
from tests.io.rods import twisted_frames, wavy_vertices


def full_keys(rng) -> dict[str, np.ndarray]:
    vertices = wavy_vertices(rng)
    twist = rng.uniform(-5, 5, len(vertices))
    frames, valid = twisted_frames(vertices, twist, rng), np.ones(vertices.shape[:2], dtype=bool)
    valid[1, 4] = False
    vertices[1, 4] = np.nan
    return {
        "vertices_mm": vertices, "valid": valid, "rest_length_mm": rng.uniform(2, 4, vertices.shape[1] - 1),
        "start_frame": frames[:, 0], "end_frame": frames[:, -1], "frames": frames, "total_twist_deg": np.degrees(twist),
        "up": np.array([0.0, 3.0, 4.0]), "sigma_mm": rng.uniform(0.1, 0.2, valid.shape),
        "end_distance_mm": np.array([30.0, 42.0, 54.0]), "end_rotation_deg": np.array([0.0, 30.0, 60.0])}


def same(first: Observations, second: Observations, tolerance: float = 0.0) -> bool:
    return all(
        (a is None) == (b is None) and (a is None or (np.shape(a) == np.shape(b) and np.allclose(
            a, b, rtol=0, atol=tolerance, equal_nan=True)))
        for a, b in [(getattr(first, name), getattr(second, name)) for name in KEYS])


def test_every_key_is_read_in_our_units_and_taken_with_its_observation(tmp_path, rng):
    keys, path = full_keys(rng), tmp_path / "suture.npz"
    np.savez(path, **keys, unsteadiness=np.array(["unknown keys", "are ignored"]))
    observations = load_observations(path)
    assert (observations.name, observations.source) == ("suture", str(path)) and len(observations.sha256) == 64
    assert observations.count == 3 and observations.edges == 8
    np.testing.assert_allclose(observations.total_twist, np.radians(keys["total_twist_deg"]))
    np.testing.assert_allclose(observations.up, [0, 0.6, 0.8])
    np.testing.assert_array_equal(observations.end_rotation, keys["end_rotation_deg"])
    np.testing.assert_array_equal(observations.vertices, keys["vertices_mm"])
    np.testing.assert_allclose(load_observations(path, up=(2, 0, 0)).up, [1, 0, 0])
    taken = observations.take(np.array([2, 0, 0]))
    np.testing.assert_array_equal(taken.vertices, observations.vertices[[2, 0, 0]])
    np.testing.assert_array_equal(taken.sigma, observations.sigma[[2, 0, 0]])
    np.testing.assert_array_equal(taken.rest_length, observations.rest_length)
    np.testing.assert_array_equal(taken.end_distance, [54, 30, 30])


def test_defaults_and_that_missing_marks_count_for_no_rest_length(rng):
    vertices = wavy_vertices(rng, count=5)
    vertices[2, 1] += 0.5
    observations = Observations(vertices)
    np.testing.assert_allclose(observations.rest_length, np.median(np.linalg.norm(np.diff(vertices, axis=1), axis=-1), axis=0))
    assert observations.spacing_error == 0.1 and observations.valid.all() and observations.valid.shape == vertices.shape[:2]
    np.testing.assert_array_equal(observations.up, [0, 0, 1])
    others = [name for name in KEYS if name not in ("vertices", "valid", "rest_length", "up", "labels", "spacing_error")]
    assert observations.labels.tolist() == [0, 1, 2, 3, 4] and all(getattr(observations, name) is None for name in others)
    vertices = wavy_vertices(rng, count=3)
    expected, valid = np.linalg.norm(np.diff(vertices[1:], axis=1), axis=-1), np.ones((3, 9), dtype=bool)
    valid[0, 4] = False
    vertices[0, 4] = np.nan
    np.testing.assert_allclose(Observations(vertices, valid).rest_length[3:5], np.median(expected[:, 3:5], axis=0))


def test_lengths_along_arcs():
    """Of a circle with an eighth of a radian between marks: chords are too short by 6.5e-4."""
    angle = np.arange(12) / 8.0
    marks = 80.0 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
    seen = Observations(np.stack([marks, 2.0 + marks]))
    np.testing.assert_allclose(seen.along_arcs().rest_length, 10.0, rtol=3e-6)
    stated = replace(seen, rest_length=np.full(11, 9.0), spacing_error=0.0)
    np.testing.assert_array_equal(stated.along_arcs().rest_length, 9.0)
    np.testing.assert_array_equal(replace(stated, spacing_error=0.1).along_arcs().rest_length, 9.0)
    with warnings.catch_warnings():  # of NumPy, about an edge that no rod shows
        warnings.simplefilter("error")
        unseen = replace(stated, valid=np.repeat(np.arange(seen.edges + 1)[None] > 0, seen.count, axis=0)).along_arcs()
    np.testing.assert_array_equal(unseen.rest_length, 9.0)


@pytest.mark.parametrize("key, wrong, problem", [
    ("vertices_mm", lambda v: v[0], "shape (9, 3)"), ("vertices_mm", lambda v: v[..., :2], "shape (3, 9, 2)"),
    ("vertices_mm", lambda v: v[:0], "shape (0, 9, 3)"), ("vertices_mm", lambda v: v[:, :2], "shape (3, 2, 3)"),
    ("vertices_mm", lambda v: np.where(v == v[0, 0, 0], np.inf, v), "inf"), ("vertices_mm", lambda v: v > 0, "bool"),
    ("vertices_mm", lambda v: v.astype(object), "cannot be read"), ("valid", lambda v: v[:, :-1], "shape (3, 8)"),
    ("valid", lambda v: v * 2, "other values than true and false"),
    ("valid", lambda v: v & (np.arange(9) == 1), "fewer than two"),
    ("rest_length_mm", lambda v: np.where(np.arange(8) == 3, -v, v), "at edge 3"),
    ("rest_length_mm", lambda v: v * (np.arange(8) != 5), "0 mm at edge 5"), ("rest_length_mm", lambda v: v[:5], "shape (5,)"),
    ("start_frame", lambda v: v * 1.01, "not orthonormal"), ("end_frame", lambda v: v * [1, 1, -1], "left-handed"),
    ("end_frame", lambda v: v * np.nan, "nan"), ("frames", lambda v: v[:, :-1], "E = 8"),
    ("frames", lambda v: v[..., [1, 0, 2]], "left-handed"), ("total_twist_deg", lambda v: v * np.nan, "nan"),
    ("up", lambda v: 0 * v, "no direction"), ("sigma_mm", lambda v: -v, "-0."), ("sigma_mm", lambda v: v[0], "shape (9,)"),
    ("end_distance_mm", lambda v: v - 40, "-10 mm"), ("end_rotation_deg", lambda v: v + np.inf, "at [0]")])
def test_wrong_keys_are_named(tmp_path, rng, key, wrong, problem):
    keys, path = full_keys(rng), tmp_path / "bad.npz"
    np.savez(path, **keys | {key: wrong(keys[key])})
    check_refused("^" + re.escape(f"{path}: {key}: ") + ".*" + re.escape(problem), load_observations, path)


def test_missing_and_misspelt_keys_are_named(tmp_path, rng):
    """Other commands' files hold more keys than observations have, but end_frme is a misspelling."""
    np.savez(tmp_path / "bad.npz", vertices=np.zeros((1, 3, 3)))
    check_refused("vertices_mm: ", load_observations, tmp_path / "bad.npz")
    keys = full_keys(rng)
    np.savez(tmp_path / "bad.npz", end_frme=keys.pop("end_frame"), **keys)
    check_refused("end_frme: .*; name it end_frame", load_observations, tmp_path / "bad.npz")


def test_nan_is_a_missing_mark(rng, tmp_path):
    """Unless `valid` says that it is there; and a mark that is not valid is nowhere, whatever the file says."""
    vertices = wavy_vertices(rng)
    vertices[1, 3, 2] = np.nan
    valid = np.ones((3, 9), dtype=bool)
    check_refused("nan at observation 1, vertex 3", Observations, vertices, valid)
    valid[1, 3] = False
    np.savez(tmp_path / "x.npz", vertices_mm=vertices)
    for found in (Observations(vertices), Observations(vertices, valid), load_observations(tmp_path / "x.npz"),
                  Observations(np.where(valid[..., None], vertices, 0.0), valid)):
        np.testing.assert_array_equal(found.valid, valid)
        np.testing.assert_array_equal(found.vertices, np.where(valid[..., None], vertices, np.nan))


def test_coinciding_neighbours_are_named_across_missing_marks(rng):
    vertices = wavy_vertices(rng)
    vertices[2, 6] = vertices[2, 4]
    assert Observations(vertices).count == 3
    valid = np.ones((3, 9), dtype=bool)
    valid[2, 5] = False
    check_refused("4 and 6 of observation 2", Observations, vertices, valid)


@pytest.mark.parametrize("key", ["vertices", "valid", "rest_length", "start_frame", "sigma", "up", "end_distance",
                                 "total_twist"])
@pytest.mark.parametrize("value", [[[1.0], [1.0, 2.0]], [1j, 2j], ["a"]])
def test_values_that_are_no_array_of_numbers(rng, key, value):
    with pytest.raises(InputError) as caught:
        Observations(**{"vertices": wavy_vertices(rng), key: value})
    assert key in caught.value.field


def test_sigma_may_be_one_number_and_unknown_where_nothing_was_seen(rng):
    vertices = wavy_vertices(rng)
    assert Observations(vertices, sigma=0.1).sigma.shape == ()
    valid = np.ones((3, 9), dtype=bool)
    valid[0, 2] = False
    assert np.isnan(Observations(vertices, valid, sigma=np.where(valid, 0.1, np.nan)).sigma[0, 2])


def test_files_that_are_no_npz(tmp_path, rng):
    good = tmp_path / "good.npz"
    np.savez_compressed(good, **full_keys(rng))
    content = good.read_bytes()
    np.save(tmp_path / "bare.npy", np.zeros(3))
    objects = tmp_path / "objects.npz"
    np.savez(objects, vertices_mm=np.array([[1], [1, 2]], dtype=object))
    contents = {"empty.npz": b"", "truncated.npz": content[: len(content) // 2], "text.npz": b"vertices", "x.dat": b"1 2 3",
                "text.parquet": b"0 0 0\n1 1 1\n", "two.csv": b"0 0 0\n1 1 1\n",
                "pickled.npz": pickle.dumps({"vertices_mm": [1.0]}), "objects.npz": objects.read_bytes(),
                "bare.npz": (tmp_path / "bare.npy").read_bytes()}
    for name, data in contents.items():
        (tmp_path / name).write_bytes(data)
        check_refused(f"{name}: .*{'suffix' if name == 'x.dat' else ''}", load_observations, tmp_path / name)


@pytest.mark.parametrize(("member", "content"), [
    ("vertices_mm.npy", b""),  # beside another of that name
    ("sigma_mm.npy", b"\x93NUMPY\x01\x00\x10\x00{'descr': '<f8', ")])  # a header that is never closed
def test_an_npz_of_wrong_members(tmp_path, rng, member, content):
    keys = full_keys(rng)
    del keys["sigma_mm"]
    np.savez(tmp_path / "x.npz", **keys)
    with warnings.catch_warnings(), zipfile.ZipFile(tmp_path / "x.npz", "a") as archive:
        warnings.simplefilter("ignore")  # that a name is there twice
        archive.writestr(member, content)
    check_refused(member.removesuffix(".npy"), load_observations, tmp_path / "x.npz")
