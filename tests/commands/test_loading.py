"""Own files on the command line: units, columns, motion capture, finer meshes; what was loaded, and what is doubted of it."""

import json
from argparse import Namespace
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from doo_ti import Observations, load_observations
from doo_ti.commands.doubts import apart_doubt, length_doubt, order_doubt, repeats_doubt, reverse_doubt, warn_of_rod
from doo_ti.commands.loading import stated
from doo_ti.commands.results import hypotheses_lines
from doo_ti.io.observation_files import read_recording
from doo_ti.rod.frames import arc_lengths
from tests.commands.calls import ended, refused, succeeded, written
from tests.io.test_formats import MARKS, motive, table

CONVERT = "convert x.csv out.npz"
METRES = f"{CONVERT} --columns observation=shot,vertex=marker,x=east,y=height,z=north"


@pytest.fixture
def metres():
    """A cable of 0.1 m in metres, y up, its columns named otherwise."""
    Path("x.csv").write_text(table(MARKS[..., [0, 2, 1]] / 1000, "shot,marker,east,height,north"))


def test_metres_taken_for_millimetres_are_warned_of(metres, capfd):
    said = ended(capfd, METRES)[1]
    assert "warning" in said and "--unit m" in said and "x.csv" in said
    np.savez("large.npz", vertices_mm=1e4 * MARKS)
    assert "warning" in ended(capfd, "convert large.npz out.npz")[1]


def test_several_rods_taken_for_one_are_warned_of(capfd):
    marks = MARKS + np.arange(len(MARKS))[:, None, None] * (0, 0, 9000.0)
    Path("x.csv").write_text(table(marks.reshape(1, -1, 3), "x,y,z", number=False))
    assert "--columns observation=NAME" in ended(capfd, CONVERT)[1]


def test_columns_that_are_swapped_are_warned_of(capfd):
    """Marks of many poses, each taken for a pose of many marks."""
    poses = np.random.default_rng(0).normal(0, 30, (8, 1, 3)) + np.linspace(0, 200, 12)[:, None] * (1.0, 0, 0)
    Path("x.csv").write_text(table(poses, "observation,vertex,x,y,z"))
    for more, said in (("", ""), (" --columns observation=vertex,vertex=observation", "observation and vertex swapped")):
        err = ended(capfd, CONVERT + more)[1]
        assert said in err and bool(said) == bool(err)


@pytest.mark.parametrize(("density", "stiffness", "words"), [
    ("10", "1e-4", ()), ("0.01", "1e-4", ("0.01 g/m", "kg/m")), ("50", "4e3", ("4000 N m²", "g/m")), ("10", "1e-4:1e5:9", ())])
def test_masses_and_stiffnesses_of_no_rod_are_warned_of(tmp_path, capfd, density, stiffness, words):
    warn_of_rod("rod", np.full(10, 50.0), None, **stated(Namespace(EI=stiffness, linear_density=float(density))))
    said = capfd.readouterr().err
    assert all(word in said for word in words) and bool(said) == bool(words)


def test_columns_that_others_call_otherwise_are_asked_for(tmp_path, capfd):
    Path("x.csv").write_text(table(MARKS, "Pose,mark,x,y,z"))
    refused(capfd, tmp_path, CONVERT, "give --columns observation=Pose,vertex=mark")
    succeeded(capfd, f"{CONVERT} --columns observation=Pose,vertex=mark")
    assert load_observations("out.npz").count == len(MARKS)


def test_lengths_that_the_marks_contradict_are_refused_and_those_that_they_hardly_allow_doubted(tmp_path, metres, capfd):
    refused(capfd, tmp_path, f"{METRES} --unit m --rest-length 300", "--rest-length: 300 mm, but arcs through the marks are")
    succeeded(capfd, f"{METRES} --unit m --rest-length 110")
    seen = Observations(MARKS)
    stated, plausible = (replace(seen, rest_length=share * seen.arcs) for share in (1.1, 0.98))
    assert "rest_length_mm" in length_doubt(stated) and f"{1.1 * seen.arcs.sum():.4g} mm" in length_doubt(stated)
    assert length_doubt(plausible) is None and length_doubt(seen) is None


@pytest.mark.parametrize(("first", "second"), [(2, 3), (0, 1), (2, 7), (9, 10)])
def test_labels_exchanged_in_every_pose_are_doubted(rng, first, second):
    """As a wrong template of motion capture has them; the lengths between marks, which the marks say, hide it."""
    angle = np.cumsum(rng.normal(0, 0.3, (6, 11)), axis=1)
    marks = np.cumsum(20 * np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1), axis=1)
    marks += rng.normal(0, 1.0, marks.shape)
    assert order_doubt(Observations(marks)) is None and apart_doubt(Observations(marks)) is None
    marks[:, [first, second]] = marks[:, [second, first]]
    assert f"with marks {first} and {second}, counted from 0, exchanged" in order_doubt(Observations(marks))


def test_a_mark_that_is_too_far_away_for_the_rod_is_doubted():
    marks = np.array(MARKS)
    marks[1, -1] = 0.0
    doubt = apart_doubt(Observations(marks, rest_length=Observations(MARKS).rest_length))
    last = len(marks[1]) - 1
    assert f"marks {last - 1} and {last}, counted from 0, of observation 1 are" in doubt and "leave marks" in doubt.lower()
    dense = np.stack([np.linspace(0, 300, 200), np.zeros(200), np.zeros(200)], axis=-1)
    noisy = dense + np.random.default_rng(1).normal(0, 0.3, (9, 200, 3))
    assert apart_doubt(Observations(noisy, rest_length=np.full(199, 300 / 199))) is None


def test_a_pose_whose_frames_fit_its_marks_in_reverse_order_is_doubted(rng):
    angle = np.cumsum(rng.normal(0, 0.3, (6, 11)), axis=1) + rng.uniform(0, 6, (6, 1))
    tangents = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1)
    up = np.broadcast_to([0.0, 0.0, 1.0], (6, 3))
    start, end = (np.stack([t, np.cross(up, t), up], axis=-1) for t in (tangents[:, 0], tangents[:, -1]))
    marks = np.concatenate([np.zeros((6, 1, 3)), np.cumsum(20 * tangents, axis=1)], axis=1) + rng.normal(0, 0.5, (6, 12, 3))
    given = dict(start_frame=start, end_frame=end)
    assert reverse_doubt(Observations(marks, **given)) is None
    marks[4] = marks[4, ::-1]
    assert "observation 4 look as if in reverse order" in reverse_doubt(Observations(marks, **given))


@pytest.mark.parametrize(("shared", "jitter", "words"), [(0.5, 0.05, "12 observations of 16 agree"), (0.0, 0.5, None)])
def test_frames_that_share_their_errors_are_doubted(rng, shared, jitter, words):
    """Four poses of four frames. Frames whose errors are independent are as good as poses."""
    poses = rng.normal(0, 30, (4, 1, 1, 3)) + np.linspace(0, 200, 12)[:, None] * (1.0, 0, 0)
    poses = poses + rng.normal(0, shared, (4, 1, 12, 3))
    marks = (poses + rng.normal(0, jitter, (4, 4, 12, 3))).reshape(16, 12, 3)
    doubt = repeats_doubt(Observations(marks), np.hypot(shared, jitter))
    assert doubt is None if words is None else words in doubt


def test_observations_keep_their_labels():
    found = {"hypotheses": 9, "resolved": 2, "ambiguous": [1], "kept": {"observation": [0, 1, 2], "turns": [0, 1, 0]}}
    lines = hypotheses_lines({"hypotheses": found}, np.array(["first", "second", "third"]))
    assert lines[-1].endswith("ambiguous observations: second")


def test_motion_capture_as_motion_and_as_observations(capfd):
    seen = np.concatenate([MARKS] * 5)
    seen[3, 1] = np.nan
    Path("take.csv").write_text(motive(seen / 1000, "Meters"))
    assert "0,1,0" in succeeded(capfd, "convert take.csv motion.npz --motion")
    found = written("motion.npz")
    np.testing.assert_allclose(found["positions_mm"], seen)
    assert found["rate_hz"] == 120.0 and found["up"].tolist() == [0, 1, 0]
    succeeded(capfd, "convert take.csv marks.csv --select 1:10:2 --complete")
    np.testing.assert_allclose(load_observations("marks.csv").vertices, seen[[1, 5, 7, 9]])


def test_observations_without_marks_and_outer_marks_are_left_out(tmp_path, capfd):
    """As of what perceive writes: a rod that was not found, and ends that are uncertain."""
    rods = np.random.default_rng(0).normal(0, 9, (3, 7, 3))
    valid, sigma = np.ones(rods.shape[:2], bool), np.arange(1.0, 1 + rods[..., 0].size).reshape(rods.shape[:2])
    valid[0] = False
    np.savez("rods.npz", vertices_mm=rods, valid=valid, sigma_mm=sigma, rest_length_mm=np.arange(1.0, rods.shape[1]))
    refused(capfd, tmp_path, "convert rods.npz marks.npz --marks 1:-1", "observation 0")
    succeeded(capfd, "convert rods.npz marks.npz --marks 1:-1 --complete")
    found = load_observations("marks.npz")
    np.testing.assert_array_equal(found.vertices, rods[1:, 1:-1])
    np.testing.assert_array_equal(found.sigma, sigma[1:, 1:-1])
    assert found.labels.tolist() == list(range(1, len(rods)))
    np.testing.assert_array_equal(found.rest_length, np.arange(2.0, rods.shape[1] - 1))
    succeeded(capfd, "convert rods.npz second.npz --select 2,0 --complete")  # numbered as in the file
    np.testing.assert_array_equal(load_observations("second.npz").vertices, rods[2:])
    np.savez("rods.npz", name=list("abc"), vertices_mm=rods, verdict=np.array([1, 2, 0], np.int8))
    assert "ambiguous in the images: b\n" in succeeded(capfd, "convert rods.npz likely.npz --complete")
    assert load_observations("likely.npz").labels.tolist() == ["a", "c"]
    succeeded(capfd, "convert rods.npz ambiguous.npz --select 1:2")
    np.testing.assert_array_equal(load_observations("ambiguous.npz").vertices, rods[1:2])


def test_marks_whose_frames_would_be_lost_stay(tmp_path, shipped_data, capfd):
    words = f"convert {shipped_data}/lab_a/vicryl.npz marks.npz --marks"
    refused(capfd, tmp_path, f"{words} 2:-2", "start_frame")
    succeeded(capfd, f"{words} ::3")
    whole, part = map(load_observations, words.split()[1:3])
    np.testing.assert_array_equal(part.vertices, whole.vertices[:, ::3])
    np.testing.assert_allclose(part.rest_length, whole.rest_length.reshape(-1, 3).sum(axis=1))


def test_relax_prints_what_it_loaded(capfd):
    marks = np.stack([np.linspace(0, 0.09, 12), np.zeros(12), 0.01 * np.sin(np.linspace(0, np.pi, 12))], axis=-1)
    Path("x.csv").write_text(table(marks[None], "observation,vertex,x,y,z"))
    assert "1 observation of 12 marks" in succeeded(capfd, "relax x.csv --unit m --bend 1e6 --out f.npz")
    out, err = ended(capfd, "relax x.csv --unit m --bend 1e6 --out f.npz --json")
    assert json.loads(out)["observations"] == 1 and err == ""


@pytest.mark.parametrize("words", [
    "--unit inch", "--columns x=east,y", "--columns x=west,y=height,z=north", "--select 1", "--select a:b", "--select 0,x",
    "--select 0,9999", "--select 5:6", "--marks 1:2", "--marks 3", "--motion"])
def test_wrong_options_write_nothing(tmp_path, metres, capfd, words):
    refused(capfd, tmp_path, f"{CONVERT} --columns x=east,y=height,z=north {words}")


@pytest.mark.thorough
def test_results_as_csv(capsys, shipped_data):
    succeeded(capsys, f"convert {shipped_data}/lab_a/vicryl.npz marks.npz --select 0,1")
    Path("path.csv").write_text("time_s,end_rotation_deg\n0,0\n1,20\n")
    for name, more in (("relax", ""), ("predict", "--motion path.csv"), ("twist", "")):
        for suffix in ("npz", "csv"):
            succeeded(capsys, f"{name} marks.npz {more} --bend 6e5 --twist 8e5 --out {name}.{suffix}")
    found = {name: written(f"{name}.npz") for name in ("relax", "predict", "twist")}
    np.testing.assert_array_equal(load_observations("relax.csv").vertices, found["relax"]["vertices_mm"])
    head, *lines = Path("predict.csv").read_text().splitlines()
    assert head.split(",")[:3] == ['"moment"', '"rod"', '"vertex"'] and len(lines) == found["predict"]["vertices_mm"].size // 3
    angles = np.genfromtxt("twist.csv", delimiter=",", names=True, deletechars='"')
    np.testing.assert_allclose(angles["total_twist_deg"], found["twist"]["total_twist_deg"])


def test_a_finer_mesh_lies_on_the_curve_through_the_marks(tmp_path, capsys):
    """A catenary-like curve with eleven marks, one of them missing."""
    curve = np.stack([np.linspace(-100, 100, 2001), np.zeros(2001), 0.002 * np.linspace(-100, 100, 2001) ** 2], axis=-1)
    arc = arc_lengths(curve)
    rows = np.searchsorted(arc, np.linspace(0, arc[-1], 11)).clip(0, 2000)
    vertices = curve[rows]
    vertices[4] = np.nan
    np.savez("marks.npz", vertices_mm=vertices[None], rest_length_mm=np.diff(arc[rows]))
    assert "61 vertices" in succeeded(capsys, "convert marks.npz fine.npz --edges 60")
    fine = load_observations("fine.npz")
    assert fine.edges == 60 and fine.valid.all() and np.ptp(fine.rest_length) < 1e-9
    assert np.linalg.norm(fine.vertices[0][:, None] - curve, axis=-1).min(axis=1).max() < 1.0
    refused(capsys, tmp_path, "convert marks.npz no.npz --edges 1")


def test_frames_and_markers_are_chosen_and_what_a_motion_cannot_have_is_refused(tmp_path, rng, capsys):
    np.savez("take.npz", positions_mm=rng.normal(size=(2, 40, 6, 3)), rate_hz=100.0, recording=np.array(["slow", "fast"]))
    out = succeeded(capsys, "convert take.npz out.npz --motion --select 0:20:4 --marks 1:-1")
    assert out.startswith("2 recordings of 5 frames of 4 markers at 25/s, 0 positions missing")
    found, whole = read_recording("out.npz"), read_recording("take.npz")
    np.testing.assert_array_equal(found.positions, whole.positions[:, :20:4, 1:-1])
    assert found.rate == 25.0 and found.names == whole.names
    refused(capsys, tmp_path, "convert take.npz out.npz --motion --select 5:5", "positions_mm: none is left")
    for words in ("--complete", "--rest-length 100", "--edges 9"):
        refused(capsys, tmp_path, f"convert take.npz out.npz --motion {words}", f"{words.split()[0]}: given with --motion")


def test_a_recording_that_states_no_rate_needs_one(tmp_path, capsys):
    Path("take.csv").write_text(motive(MARKS / 1000, "Meters").replace("Export Frame Rate,120.000000,", ""))
    refused(capsys, tmp_path, "convert take.csv out.npz --motion", "states no frames per second")
    succeeded(capsys, "convert take.csv out.npz --motion --rate 50")
    assert read_recording("out.npz").rate == 50.0
