"""Wrong input: exit code 2, one line naming file or option, field and remedy, no traceback, nothing written."""

import os
import warnings
import zipfile
from pathlib import Path

import numpy as np
import pytest

from tests.commands.calls import MATERIAL, good_keys, in_process, npz_bytes, refused

# ---- files of observations: what only commands refuse, and one key of each kind; all keys: tests/io/test_observations.py

KEYS = {
    "clamps further apart than the rod": ("rest_length_mm", lambda x: x / 2, "further apart"),
    "a label below zero": ("end_distance_mm", lambda v: np.array([30.0, -1.0, 30.0]), "-1 mm"),
    "lengths of another unit": ("rest_length_mm", lambda x: 1000 * x, "mm apart on average"),
    "an edge of no length": ("rest_length_mm", lambda x: np.where(np.arange(8) == 3, 5e-324, x), "at edge 3"),
    "a mark far away": ("vertices_mm", lambda v: np.where(v == v[1, 4, 0], 1e6, v), "of observation 1 is 1e+06 mm away"),
    "object array": ("vertices_mm", lambda v: v.astype(object), "cannot be read")}


@pytest.mark.parametrize("case", KEYS)
def test_wrong_keys(capsys, tmp_path, case):
    field, change, problem = KEYS[case]
    keys = good_keys()
    keys[field] = change(keys.get(field))
    path = tmp_path / "bad.npz"
    np.savez(path, **keys)
    for command, out in (("relax", "F.npz"), ("sweep", "run")):
        refused(capsys, tmp_path, [command, str(path), *MATERIAL, "--out", str(tmp_path / out)], str(path), field, problem)


@pytest.mark.parametrize("suffix", [".npz", ".csv", ".parquet"])
def test_wrong_files(capsys, tmp_path, suffix):
    path = tmp_path / f"bad{suffix}"
    path.write_bytes(npz_bytes(tmp_path)[:-200] if suffix == ".npz" else b"0 0 0\n1 1 1\n")
    for command in (["relax", str(path), *MATERIAL, "--out", str(tmp_path / "F.npz")],
                    ["sweep", str(path), "--bend", "1e5:1e6:3", "--out", str(tmp_path / "run")],
                    ["convert", str(path), str(tmp_path / "out.csv")]):
        refused(capsys, tmp_path, command, str(path))


@pytest.mark.parametrize(("member", "content"), [
    ("vertices_mm.npy", b""),  # beside another of that name
    ("sigma_mm.npy", b"\x93NUMPY\x01\x00\x10\x00{'descr': '<f8', "),  # a header that is never closed
])
def test_an_npz_of_wrong_members(capsys, tmp_path, member, content):
    npz_bytes(tmp_path)
    with warnings.catch_warnings(), zipfile.ZipFile(tmp_path / "good.npz", "a") as archive:
        warnings.simplefilter("ignore")  # that a name is there twice
        archive.writestr(member, content)
    argv = ["relax", str(tmp_path / "good.npz"), *MATERIAL, "--out", str(tmp_path / "F.npz")]
    refused(capsys, tmp_path, argv, member.removesuffix(".npy"))


def test_files_that_are_not_there_or_those_of_another_command(capsys, tmp_path):
    for name, word in (("absent.npz", "no such file"), ("absent.dat", "no such file"), ("", "is a folder")):
        refused(capsys, tmp_path, ["relax", str(tmp_path / name), *MATERIAL, "--out", str(tmp_path / "F.npz")], word)
    for command, out in (("sweep", "run"), ("synth", "x.npz")):
        argv = [command, str(tmp_path / "absent.toml"), "--out", str(tmp_path / out)]
        refused(capsys, tmp_path, argv, "absent.toml", "no such file")
    refused(capsys, tmp_path, ["learn", str(tmp_path / "absent")], "summary.json", "no such file")
    refused(capsys, tmp_path, ["view", str(tmp_path / "absent")], "absent", "no such file")
    refused(capsys, tmp_path, ["group", "scenes/motion/whip.toml", "--out", str(tmp_path / "F.npz")],
            "this is a scene of another command")


# ---- options of relax and sweep in a valid command line, and words of the message; texts of grids: tests/rod/test_grid.py

OPTIONS = {
    "B not positive definite": (["--bend", "1e5,1e5,2e5"], "--bend", "not positive definite"),
    "bend no number": (["--bend", "stiff"], "--bend", "'stiff'"),
    "bend given twice": (["--bend-1", "1e5"], "bend_1", "beside bend"),
    "twist and ratio": (["--twist-ratio", "1"], "twist_ratio", "beside twist"),
    "weight negative": (["--weight", "-1e-3"], "--weight", "-0.001"),
    "frame weight beyond numbers": (["--frame-weight", "1e300"], "--frame-weight", "up to 1e+30"),
    "twist below numbers": (["--twist", "1e-300"], "--twist", "below 1e-30"),
    "up no number": (["--up", "0,0,z"], "--up", "'z'"),
    "up too short": (["--up", "-1,0"], "--up", "direction"),
    "clamp": (["--clamp-start", "glued"], "--clamp-start", "'glued'"),
    "unknown option": (["--stretch", "3"], "--stretch", "unknown option"),
    "abbreviated option": (["--weigh=3"], "--weigh", "unknown option"),
    "one argument too many": (["more.npz"], "more.npz", "unexpected argument"),
    "a value for a switch": (["--json=yes"], "--json", "yes"),
    "an option over two lines": (["--bend", "1e5\n2e5"], "--bend"),
    "a grid": (["--bend", "1e5:1e6:3"], "--bend", "3 cells"),
    "nothing holds the rod": (["--clamp-start", "free", "--clamp-end", "free"], "clamps", "both ends are free"),
    "a frame weight without frames": (["--frame-weight", "2"], "frames", "missing", "--frame-weight")}


GRIDS = {
    "grid of zero cells": (["--bend", "1e5:1e6:0"], "--bend", "zero cells"),
    "grid from below": (["--bend", "1e5", "--twist-ratio", "-1:1:5:lin"], "--twist-ratio", "not positive"),
    "no bend": (["--twist", "1e5"], "--bend", "missing"),
    "half of bend": (["--bend-1", "1e5:1e6:3"], "bend_2", "missing"),
    "seed": (["--bend", "1e5", "--seed", "x"], "--seed", "'x'"),
    "seed negative": (["--bend", "1e5", "--seed", "-1"], "--seed", "below 0"),
    "workers without end": (["--bend", "1e5", "--workers", "9223372036854775808"], "--workers", "above 1024"),
    "a cluster and workers": (["--bend", "1e5", "--workers", "2", "--dask", "tcp://127.0.0.1:1"], "--dask", "--workers")}


@pytest.mark.parametrize("case", [*OPTIONS, *GRIDS])
def test_wrong_options(capsys, tmp_path, case):
    words, *expected = OPTIONS.get(case) or GRIDS[case]
    npz_bytes(tmp_path)
    command, own, out = ("relax", MATERIAL, "F.npz") if case in OPTIONS else ("sweep", [], "run")
    refused(capsys, tmp_path, [command, str(tmp_path / "good.npz"), *own, "--out", str(tmp_path / out), *words], *expected)


def test_unknown_command(capsys, tmp_path):
    for argv, word in ((["dance"], "dance: unknown command"), (["--bend", "3"], "doo-ti"), (["relax"], "OBS"),
                       (["sweep", "x.npz"], "--out"), (["learn"], "RUN"), (["convert", "x.npz"], "OUT")):
        refused(capsys, tmp_path, argv, word)


# ---- outputs

def test_outputs_that_cannot_be(capsys, tmp_path):
    npz_bytes(tmp_path)
    good, below = str(tmp_path / "good.npz"), str(tmp_path / "good.npz" / "deep" / "F.npz")
    (tmp_path / "folder.npz").mkdir()
    commands = {
        "relax": ["relax", good, *MATERIAL, "--out"], "sweep": ["sweep", good, "--bend", "1e5:1e6:3", "--out"],
        "convert": ["convert", good],
        "synth": ["synth", str(Path(__file__).resolve().parents[2] / "scenes" / "silk.toml"), "--out"]}
    named = {name: "OUT" if name == "convert" else "--out" for name in commands}
    for name, argv in commands.items():
        refused(capsys, tmp_path, [*argv, below], named[name], "good.npz", "is a file")
    refused(capsys, tmp_path, [*commands["sweep"], good], "--out", "good.npz")
    for name in ("relax", "convert"):
        refused(capsys, tmp_path, [*commands[name], good], named[name], "is the input itself")
    refused(capsys, tmp_path, [*commands["sweep"], ""], "--out", "is not a folder")
    for name in ("relax", "convert", "synth"):
        refused(capsys, tmp_path, [*commands[name], str(tmp_path / "folder.npz")], named[name], "is a folder")
        refused(capsys, tmp_path, [*commands[name], str(tmp_path / "F.txt")], "suffix '.txt'")
    (tmp_path / "dangling").symlink_to(tmp_path / "missing")
    refused(capsys, tmp_path, [*commands["sweep"], str(tmp_path / "dangling" / "run")], "--out", "dangling")


def test_outputs_that_may_not_be(capsys, tmp_path, monkeypatch):
    npz_bytes(tmp_path)
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    for argv in (["relax", str(tmp_path / "good.npz"), *MATERIAL, "--out", str(tmp_path / "F.npz")],
                 ["sweep", str(tmp_path / "good.npz"), *MATERIAL, "--out", str(tmp_path / "new" / "run")]):
        refused(capsys, tmp_path, argv, "--out", str(tmp_path), "not writable")


# ---- scenes; all keys: tests/io/test_scene.py

LAB, GRID = "[synthesis]\nbend = 1\ntwist = 1\n", "[grid]\nbend = 3\n"
SCENES = {
    "absent file": ('[observations]\nfile = "absent.npz"\n[grid]\nbend = 3\n', "absent.npz", "no such file"),
    "TOML without end": (f"x={'[' * 20_000}", "not TOML"),
    "a name that leads elsewhere": (f'name = "../../x"\n{LAB}{GRID}', "name", "cannot name a folder"),
    "a name that is none": (f'name = "a\\u0000b"\n{LAB}{GRID}', "name", "cannot name a folder"),
    "turns without end": (f"{LAB}end_rotations_deg = [1e18]\n{GRID}", "synthesis.end_rotations_deg", "360000"),
    "marks of hundreds of digits": (f"{LAB}marks = {'9' * 400}\n{GRID}", "synthesis.marks", "99999")}


@pytest.mark.parametrize("case", SCENES)
def test_wrong_scenes(capsys, tmp_path, case):
    text, *expected = SCENES[case]
    path = tmp_path / "scene.toml"
    path.write_text(text, encoding="utf-8")
    for command, out in (("sweep", "run"), ("synth", "x.npz")):
        argv = [command, str(path), "--out", str(tmp_path / out)]
        refused(capsys, tmp_path, argv, *expected, *([] if case == "absent file" else [str(path)]))


def test_a_clamp_that_needs_a_frame_nobody_gave_or_gave_by_another_name(capsys, tmp_path):
    """Other commands' files hold more keys than observations have, but end_frme is a misspelling."""
    keys = good_keys()
    frame = keys.pop("end_frame")
    np.savez(tmp_path / "slip.npz", **keys, end_frme=frame)
    slip = ["relax", str(tmp_path / "slip.npz"), *MATERIAL, "--out", str(tmp_path / "F.npz")]
    refused(capsys, tmp_path, slip, "slip.npz", "end_frme", "name it end_frame")
    np.savez(tmp_path / "bad.npz", **keys)
    argv = [str(tmp_path / "bad.npz"), *MATERIAL, "--clamp-end", "frame", "--out", str(tmp_path / "F.npz")]
    refused(capsys, tmp_path, ["relax", *argv], "bad.npz", "end_frame", "missing")
    refused(capsys, tmp_path, ["sweep", *argv], "bad.npz", "end_frame", "missing")


LIMITS = {
    "a plan over twist that rides on bend": (["plan", "GOOD", "--bend", "1e5:1e6:3", "--out", "OUT"], "twist", "--twist-ratio"),
    "label uncertainty": (["plan", "SCENE", "--sigma", "1e-300"], "sigma", "1e-09 to 1e+06"),
    "occluders": (["synth", "SCENE", "--images", "OUT", "--rig", "RIG", "--render", "occluders=1000000"], "occluders", "1000"),
    "diameter": (["synth", "SCENE", "--images", "OUT", "--rig", "RIG", "--diameter", "1e300"], "--diameter", "1000"),
    "distortion": (["synth", "SCENE", "--images", "OUT", "--rig", "WRONG_RIG"], "dist", "1,000,000"),
    "positions": (["predict", "GOOD", "--motion", "FAR", *MATERIAL, "--out", "OUT"], "start_position", "1e+06 mm"),
    "turns": (["predict", "GOOD", "--motion", "TURNS", *MATERIAL, "--out", "OUT"], "end_rotation", "rad")}


@pytest.fixture
def limited(tmp_path) -> dict[str, Path]:
    """The files that LIMITS names."""
    scenes = Path(__file__).resolve().parents[2] / "scenes"
    npz_bytes(tmp_path)
    rig = (scenes / "rig.yaml").read_text()
    first = rig.index("data: [", rig.index("dist:")) + len("data: [")
    (tmp_path / "wrong.yaml").write_text(rig[:first] + " -1e300," + rig[rig.index(",", first) + 1 :])
    marks = good_keys()["vertices_mm"][0]
    np.savez(tmp_path / "far.npz", positions_mm=1e6 * np.stack([marks, 1.01 * marks]))
    np.savez(tmp_path / "turns.npz", end_rotation_deg=np.array([0.0, 2.0**32]))
    return {"SCENE": scenes / "silk.toml", "RIG": scenes / "rig.yaml", "WRONG_RIG": tmp_path / "wrong.yaml",
            "GOOD": tmp_path / "good.npz", "FAR": tmp_path / "far.npz", "TURNS": tmp_path / "turns.npz",
            "OUT": tmp_path / "out.npz"}


@pytest.mark.parametrize("case", LIMITS)
def test_limits_are_stated(capsys, tmp_path, limited, case):
    words, *expected = LIMITS[case]
    refused(capsys, tmp_path, [str(limited.get(word, word)) for word in words], *expected)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("case", ["label uncertainty", "diameter", "positions"])
def test_no_library_says_anything_beside_the_line(limited, case):
    """In a separate process, with Taichi loaded, whose standard error is captured."""
    words = [str(limited.get(word, word)) for word in LIMITS[case][0]]
    done = in_process(words)
    assert (done.returncode, done.stdout) == (2, "") and done.stderr.count("\n") == 1, done.stderr


