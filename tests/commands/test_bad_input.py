"""Wrong input: exit code 2, one line naming file or option, field and remedy, no traceback, nothing written."""

import os
from pathlib import Path

import numpy as np
import pytest

from tests.commands.calls import MATERIAL, good_keys, refused, write_good
from tests.processes import python


@pytest.mark.parametrize("field, change, problem", [
    ("rest_length_mm", lambda x: x / 2, "further apart"), ("rest_length_mm", lambda x: 1000 * x, "mm apart on average"),
    ("rest_length_mm", lambda x: np.where(np.arange(8) == 3, 5e-324, x), "at edge 3"),
    ("vertices_mm", lambda v: np.where(v == v[1, 4, 0], 1e6, v), "of observation 1 is 1e+06 mm away")])
def test_wrong_keys(capsys, tmp_path, field, change, problem):
    """What only commands refuse; the others: tests/io."""
    np.savez("bad.npz", **good_keys() | {field: change(good_keys()[field])})
    for command, out in (("relax", "F.npz"), ("sweep", "run")):
        refused(capsys, tmp_path, [command, "bad.npz", *MATERIAL, "--out", out], "bad.npz", field, problem)


def test_files_that_are_not_there_or_those_of_another_command(capsys, tmp_path):
    Path("scene.toml").write_text('[observations]\nfile = "absent.npz"\n[grid]\nbend = 3\n')
    for words, expected in (("relax absent.npz --bend 1 --out F.npz", ("absent.npz", "no such file")),
                            ("relax . --bend 1 --out F.npz", ("is a folder",)),
                            ("sweep absent.toml --out run", ("absent.toml", "no such file")),
                            ("sweep scene.toml --out run", ("absent.npz", "no such file")),
                            ("learn absent", ("summary.json", "no such file")), ("view absent", ("absent", "no such file")),
                            ("group scenes/motion/whip.toml --out F.npz", ("this is a scene of another command",))):
        refused(capsys, tmp_path, words, *expected)


@pytest.mark.parametrize("words, expected", [
    ("--bend 1e5,1e5,2e5", ("--bend", "not positive definite")), ("--bend stiff", ("--bend", "'stiff'")),
    ("--bend-1 1e5", ("bend_1", "beside bend")), ("--twist-ratio 1", ("twist_ratio", "beside twist")),
    ("--weight -1e-3", ("--weight", "-0.001")), ("--frame-weight 1e300", ("--frame-weight", "up to 1e+30")),
    ("--twist 1e-300", ("--twist", "below 1e-30")), ("--up 0,0,z", ("--up", "'z'")), ("--up -1,0", ("--up", "direction")),
    ("--clamp-start glued", ("--clamp-start", "'glued'")), ("--stretch 3", ("--stretch", "unknown option")),
    ("--weigh=3", ("--weigh", "unknown option")), ("more.npz", ("more.npz", "unexpected argument")),
    ("--json=yes", ("--json", "yes")), ("--bend=1e5\v2e5", ("--bend",)), ("--bend 1e5:1e6:3", ("--bend", "3 cells")),
    ("--clamp-start free --clamp-end free", ("clamps", "both ends are free")),
    ("--frame-weight 2", ("frames", "missing", "--frame-weight"))])
def test_wrong_options(capsys, tmp_path, words, expected):
    """Of relax, in a valid command line; \v stands for a line break within an option."""
    write_good(tmp_path)
    more = [word.replace("\v", "\n") for word in words.split(" ")]
    refused(capsys, tmp_path, ["relax", "good.npz", *MATERIAL, "--out", "F.npz", *more], *expected)


@pytest.mark.parametrize("words, expected", [
    ("--bend 1e5:1e6:0", ("--bend", "zero cells")), ("--twist 1e5", ("--bend", "missing")),
    ("--bend 1e5 --twist-ratio -1:1:5:lin", ("--twist-ratio", "not positive")), ("--bend-1 1e5:1e6:3", ("bend_2", "missing")),
    ("--bend 1e5 --seed x", ("--seed", "'x'")), ("--bend 1e5 --seed -1", ("--seed", "below 0")),
    ("--bend 1e5 --workers 9223372036854775808", ("--workers", "above 1024")),
    ("--bend 1e5 --workers 2 --dask tcp://127.0.0.1:1", ("--dask", "--workers"))])
def test_wrong_grids_and_other_options_of_sweep(capsys, tmp_path, words, expected):
    """Texts of grids: tests/rod/test_grid.py."""
    write_good(tmp_path)
    refused(capsys, tmp_path, f"sweep good.npz --out run {words}", *expected)


def test_unknown_command(capsys, tmp_path):
    for argv, word in (("dance", "dance: unknown command"), ("--bend 3", "doo-ti"), ("relax", "OBS"), ("sweep x.npz", "--out"),
                       ("learn", "RUN"), ("convert x.npz", "OUT")):
        refused(capsys, tmp_path, argv, word)


def test_outputs_that_cannot_or_may_not_be(capsys, tmp_path, monkeypatch):
    write_good(tmp_path)
    Path("folder.npz").mkdir()
    Path("dangling").symlink_to("missing")
    sweep = "sweep good.npz --bend 1e5:1e6:3 --out"
    for command in (f"relax good.npz {' '.join(MATERIAL)} --out", sweep, "convert good.npz", "synth silk --out"):
        named = "OUT" if command == "convert good.npz" else "--out"
        refused(capsys, tmp_path, f"{command} good.npz/deep/F.npz", named, "good.npz", "is a file")
        if command != sweep:
            refused(capsys, tmp_path, f"{command} folder.npz", named, "is a folder")
            refused(capsys, tmp_path, f"{command} F.txt", "suffix '.txt'")
            if "good" in command:
                refused(capsys, tmp_path, f"{command} good.npz", named, "is the input itself")
    refused(capsys, tmp_path, f"{sweep} good.npz", "--out", "good.npz")
    refused(capsys, tmp_path, [*sweep.split(), ""], "--out", "is not a folder")
    refused(capsys, tmp_path, f"{sweep} dangling/run", "--out", "dangling")
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    for command, out in (("relax", "F.npz"), ("sweep", "new/run")):
        argv = [command, tmp_path / "good.npz", *MATERIAL, "--out", tmp_path / out]
        refused(capsys, tmp_path, argv, "--out", str(tmp_path), "not writable")


@pytest.mark.thorough
@pytest.mark.parametrize("words", [
    "synth scenes/silk.toml --images absent --rig scenes/rig.yaml --diameter 1e300", "plan scenes/silk.toml --sigma 1e-300"])
def test_no_library_says_anything_beside_the_line(words):
    """In a separate process, with Taichi loaded, whose standard error is captured."""
    done = python("-m", "doo_ti", *words.split())
    assert (done.returncode, done.stdout) == (2, "") and done.stderr.count("\n") == 1, done.stderr
