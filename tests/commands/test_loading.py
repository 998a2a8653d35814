"""Own files on the command line: units, columns, motion capture, finer meshes; what was loaded, and what is doubted of it."""

import json
from argparse import Namespace
from dataclasses import replace

import numpy as np
import pytest

from doo_ti import Observations, load_observations
from doo_ti.commands.cli import main
from doo_ti.commands.doubts import apart_doubt, length_doubt, order_doubt, repeats_doubt, reverse_doubt, warn_of_rod
from doo_ti.commands.loading import stated
from doo_ti.commands.results import hypotheses_lines
from doo_ti.io.observation_files import read_recording
from doo_ti.rod.frames import arc_lengths
from tests.commands.calls import refused, succeeded, written
from tests.io.test_formats import MARKS, motive, table


@pytest.fixture
def metres(tmp_path):
    """A cable of 0.1 m in metres, y up, its columns named otherwise."""
    path = tmp_path / "cable.csv"
    path.write_text(table(MARKS[..., [0, 2, 1]] / 1000, "shot,marker,east,height,north"))
    return path


def test_metres_taken_for_millimetres_are_warned_of(tmp_path, metres, capfd):
    assert main(["convert", str(metres), "out.npz", "--columns", "observation=shot,vertex=marker,x=east,y=height,z=north"]) == 0
    printed = capfd.readouterr().err
    assert "warning" in printed and "--unit m" in printed and str(metres) in printed
    np.savez(tmp_path / "large.npz", vertices_mm=1e4 * MARKS)
    assert main(["convert", "large.npz", "out.npz"]) == 0
    assert "warning" in capfd.readouterr().err


def test_several_rods_taken_for_one_are_warned_of(tmp_path, metres, capfd):
    marks = MARKS + np.arange(len(MARKS))[:, None, None] * (0, 0, 9000.0)
    (tmp_path / "x.csv").write_text(table(marks.reshape(1, -1, 3), "x,y,z", number=False))
    assert main(["convert", "x.csv", "out.npz"]) == 0
    assert "--columns observation=NAME" in capfd.readouterr().err


def test_columns_that_are_swapped_are_warned_of(tmp_path, capfd):
    """Marks of many poses, each taken for a pose of many marks."""
    poses = np.random.default_rng(0).normal(0, 30, (8, 1, 3)) + np.linspace(0, 200, 12)[:, None] * (1.0, 0, 0)
    (tmp_path / "x.csv").write_text(table(poses, "observation,vertex,x,y,z"))
    words = ["convert", "x.csv", "out.npz"]
    assert main(words) == 0 and capfd.readouterr().err == ""
    assert main([*words, "--columns", "observation=vertex,vertex=observation"]) == 0
    assert "observation and vertex swapped" in capfd.readouterr().err


@pytest.mark.parametrize(("density", "stiffness", "words"), [
    ("10", "1e-4", ()), ("0.01", "1e-4", ("0.01 g/m", "kg/m")), ("50", "4e3", ("4000 N m²", "g/m")), ("10", "1e-4:1e5:9", ())])
def test_masses_and_stiffnesses_of_no_rod_are_warned_of(tmp_path, capfd, density, stiffness, words):
    """At 500 mm; of a range the least counts."""
    warn_of_rod("rod", np.full(10, 50.0), None, **stated(Namespace(EI=stiffness, linear_density=float(density))))
    said = capfd.readouterr().err
    assert all(word in said for word in words) and bool(said) == bool(words)


def test_columns_that_others_call_otherwise_are_asked_for(tmp_path, capfd):
    """A table of poses and marks is not one rod with all of its marks."""
    (tmp_path / "x.csv").write_text(table(MARKS, "Pose,mark,x,y,z"))
    words = ["convert", "x.csv", "out.npz"]
    refused(capfd, tmp_path, words, "give --columns observation=Pose,vertex=mark")
    assert main([*words, "--columns", "observation=Pose,vertex=mark"]) == 0
    assert load_observations(tmp_path / "out.npz").count == len(MARKS)


def test_lengths_that_the_marks_contradict_are_refused(tmp_path, metres, capfd):
    words = ["convert", str(metres), "out.npz", "--unit", "m", "--columns",
             "observation=shot,vertex=marker,x=east,y=height,z=north", "--rest-length"]
    refused(capfd, tmp_path, [*words, "300"], "--rest-length: 300 mm, but arcs through the marks are")
    assert main([*words, "110"]) == 0


def test_lengths_that_the_marks_hardly_allow_are_doubted():
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
    """As zeros are that stand for a mark that was not seen."""
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


def test_motion_capture_as_motion_and_as_observations(tmp_path, capfd):
    seen = np.concatenate([MARKS] * 5)
    seen[3, 1] = np.nan
    (tmp_path / "take.csv").write_text(motive(seen / 1000, "Meters"))
    assert "0,1,0" in succeeded(capfd, ["convert", "take.csv", "motion.npz", "--motion"])
    found = written(tmp_path / "motion.npz")
    np.testing.assert_allclose(found["positions_mm"], seen)
    assert found["rate_hz"] == 120.0 and found["up"].tolist() == [0, 1, 0]
    assert main(["convert", "take.csv", "marks.csv", "--select", "1:10:2", "--complete"]) == 0
    np.testing.assert_allclose(load_observations(tmp_path / "marks.csv").vertices, seen[[1, 5, 7, 9]])


def test_observations_without_marks_and_outer_marks_are_left_out(tmp_path, capfd):
    """As of what perceive writes: a rod that was not found, and ends that are uncertain."""
    file, out = tmp_path / "rods.npz", tmp_path / "marks.npz"
    rods = np.random.default_rng(0).normal(0, 9, (3, 7, 3))
    valid, sigma = np.ones(rods.shape[:2], bool), np.arange(1.0, 1 + rods[..., 0].size).reshape(rods.shape[:2])
    valid[0] = False
    np.savez(file, vertices_mm=rods, valid=valid, sigma_mm=sigma, rest_length_mm=np.arange(1.0, rods.shape[1]))
    refused(capfd, tmp_path, ["convert", str(file), str(out), "--marks", "1:-1"], "observation 0")
    assert main(["convert", str(file), str(out), "--marks", "1:-1", "--complete"]) == 0
    found = load_observations(out)
    np.testing.assert_array_equal(found.vertices, rods[1:, 1:-1])
    np.testing.assert_array_equal(found.sigma, sigma[1:, 1:-1])
    assert found.labels.tolist() == list(range(1, len(rods)))
    np.testing.assert_array_equal(found.rest_length, np.arange(2.0, rods.shape[1] - 1))


def test_marks_whose_frames_would_be_lost_stay(tmp_path, shipped_data, capfd):
    words = ["convert", str(shipped_data / "lab_a" / "vicryl.npz"), "marks.npz", "--marks"]
    refused(capfd, tmp_path, [*words, "2:-2"], "start_frame")
    assert main([*words, "::3"]) == 0
    whole, part = load_observations(words[1]), load_observations(words[2])
    np.testing.assert_array_equal(part.vertices, whole.vertices[:, ::3])
    np.testing.assert_allclose(part.rest_length, whole.rest_length.reshape(-1, 3).sum(axis=1))


def test_relax_prints_what_it_loaded(tmp_path, capfd):
    marks = np.stack([np.linspace(0, 0.09, 12), np.zeros(12), 0.01 * np.sin(np.linspace(0, np.pi, 12))], axis=-1)
    (tmp_path / "x.csv").write_text(table(marks[None], "observation,vertex,x,y,z"))
    words = ["relax", "x.csv", "--unit", "m", "--bend", "1e6", "--out", "f.npz"]
    assert "1 observation of 12 marks" in succeeded(capfd, words) and main([*words, "--json"]) == 0
    printed = capfd.readouterr()
    assert json.loads(printed.out)["observations"] == 1 and printed.err == ""


@pytest.mark.parametrize("words", [
    ["--unit", "inch"], ["--columns", "x=east,y"], ["--columns", "x=west,y=height,z=north"], ["--select", "1"],
    ["--select", "a:b"], ["--select", "0,x"], ["--select", "0,9999"],
    ["--select", "5:6"], ["--marks", "1:2"], ["--marks", "3"], ["--motion"]])
def test_wrong_options_write_nothing(tmp_path, metres, capfd, words):
    words = ["--columns", "x=east,y=height,z=north", *words]
    refused(capfd, tmp_path, ["convert", str(metres), "out.npz", *words])


@pytest.mark.thorough
def test_results_as_csv(tmp_path, shipped_data):
    """The same numbers as in the npz, for a program without NumPy."""
    marks = "marks.npz"
    assert main(["convert", str(shipped_data / "lab_a" / "vicryl.npz"), marks, "--select", "0,1"]) == 0
    (tmp_path / "path.csv").write_text("time_s,end_rotation_deg\n0,0\n1,20\n")
    material = ["--bend", "6e5", "--twist", "8e5"]
    commands = {"relax": [], "predict": ["--motion", "path.csv"], "twist": []}
    for name, more in commands.items():
        for suffix in ("npz", "csv"):
            assert main([name, marks, *more, *material, "--out", f"{name}.{suffix}"]) == 0
    found = {name: written(tmp_path / f"{name}.npz") for name in commands}
    np.testing.assert_array_equal(load_observations(tmp_path / "relax.csv").vertices, found["relax"]["vertices_mm"])
    head, *lines = (tmp_path / "predict.csv").read_text().splitlines()
    assert head.split(",")[:3] == ['"moment"', '"rod"', '"vertex"']
    assert len(lines) == found["predict"]["vertices_mm"].size // 3
    angles = np.genfromtxt(tmp_path / "twist.csv", delimiter=",", names=True, deletechars='"')
    np.testing.assert_allclose(angles["total_twist_deg"], found["twist"]["total_twist_deg"])


def test_a_finer_mesh_lies_on_the_curve_through_the_marks(tmp_path, capsys):
    """A catenary-like curve with eleven marks, one of them missing."""
    curve = np.stack([np.linspace(-100, 100, 2001), np.zeros(2001), 0.002 * np.linspace(-100, 100, 2001) ** 2], axis=-1)
    arc = arc_lengths(curve)
    rows = np.searchsorted(arc, np.linspace(0, arc[-1], 11)).clip(0, 2000)
    vertices = curve[rows]
    vertices[4] = np.nan
    source = "marks.npz"
    np.savez(source, vertices_mm=vertices[None], rest_length_mm=np.diff(arc[rows]))
    assert "61 vertices" in succeeded(capsys, ["convert", source, "fine.npz", "--edges", "60"])
    fine = load_observations(tmp_path / "fine.npz")
    assert fine.edges == 60 and fine.valid.all() and np.ptp(fine.rest_length) < 1e-9
    assert np.linalg.norm(fine.vertices[0][:, None] - curve, axis=-1).min(axis=1).max() < 1.0
    assert main(["convert", source, "no.npz", "--edges", "1"]) == 2
    assert main(["convert", source, "no.npz", "--edges", "9", "--motion"]) == 2


@pytest.fixture
def take(tmp_path, rng):
    path = tmp_path / "take.npz"
    np.savez(path, positions_mm=rng.normal(size=(2, 40, 6, 3)), rate_hz=100.0, recording=np.array(["slow", "fast"]))
    return str(path)


def test_frames_and_markers_are_chosen(take, tmp_path, capsys):
    out = tmp_path / "out.npz"
    assert main(["convert", take, str(out), "--motion", "--select", "0:20:4", "--marks", "1:-1"]) == 0
    assert capsys.readouterr().out.startswith("2 recordings of 5 frames of 4 markers at 25/s, 0 positions missing")
    found, whole = read_recording(out), read_recording(take)
    np.testing.assert_array_equal(found.positions, whole.positions[:, :20:4, 1:-1])
    assert found.rate == 25.0 and found.names == whole.names


@pytest.mark.parametrize(("words", "named"), [
    (["--select", "5:5"], "positions_mm: none is left"), (["--complete"], "--complete: given with --motion"),
    (["--rest-length", "100"], "--rest-length: given with --motion"), (["--edges", "9"], "--edges: given with --motion")])
def test_what_a_motion_cannot_have_is_refused(words, named, take, tmp_path, capsys):
    refused(capsys, tmp_path, ["convert", take, "out.npz", "--motion", *words], named)


def test_a_recording_that_states_no_rate_needs_one(tmp_path, capsys):
    (tmp_path / "take.csv").write_text(motive(MARKS / 1000, "Meters").replace("Export Frame Rate,120.000000,", ""))
    words = ["convert", "take.csv", "out.npz", "--motion"]
    assert main(words) == 2 and "states no frames per second" in capsys.readouterr().err
    assert main([*words, "--rate", "50"]) == 0 and read_recording(tmp_path / "out.npz").rate == 50.0
