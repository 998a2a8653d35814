"""The objectives on the command line: pairs, unknown rolls, and the printed results."""

import json
import re
from dataclasses import replace

import pytest

from doo_ti.commands.cli import main
from doo_ti.io.observation_files import save_observations
from tests.commands.calls import refused
from tests.learning.lab import small_lab

GRID = ["--bend", "2e5:8e5:3", "--twist-ratio", "0.5:2:3"]


def written(folder, **changes) -> str:
    save_observations(folder / "lab.npz", replace(small_lab(), **changes))
    return str(folder / "lab.npz")


@pytest.mark.thorough
def test_a_dynamic_sweep_reports_pairs_and_jumps(capsys, tmp_path):
    argv = ["sweep", written(tmp_path), *GRID, "--objective", "dynamic", "--out", str(tmp_path / "run")]
    assert main(argv) == 0
    out = capsys.readouterr().out
    assert "9 cells x 4 pairs" in out and "Eq. 3" in out and "0 of 4 rods" in out
    assert "hypotheses" not in out
    assert main([*argv, "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert (summary["objective"], summary["pairs"], summary["jumps"]["rods"]) == ("dynamic", 4, 0)
    assert (tmp_path / "run" / "pairs.csv").read_text().startswith("from,to,weight,rotation_deg\n0,4,")


@pytest.mark.thorough
def test_pairs_of_a_file_and_of_a_scene(capsys, tmp_path):
    written(tmp_path)
    (tmp_path / "pairs.csv").write_text("from,to,weight\n0,2,1\n2,4,0.5\n5,1,0\n")
    scene = tmp_path / "scene.toml"
    scene.write_text('objective = "dynamic"\npairs = "pairs.csv"\n[observations]\nfile = "lab.npz"\n'
                     '[grid]\nbend = "2e5:8e5:3"\n')
    assert main(["sweep", str(scene), "--out", str(tmp_path / "scene")]) == 0
    assert "3 cells x 2 pairs" in capsys.readouterr().out
    assert main(["sweep", str(scene), "--objective", "static", "--out", str(tmp_path / "static")]) == 0
    assert "3 cells x 6 observations" in capsys.readouterr().out
    (tmp_path / "other.csv").write_text("from,to\n3,5\n")
    assert main(["sweep", str(scene), "--pairs", str(tmp_path / "other.csv"), "--out", str(tmp_path / "other")]) == 0
    assert "3 cells x 1 pairs" in capsys.readouterr().out


@pytest.mark.thorough
def test_settled_hypotheses_are_reported(capsys, tmp_path):
    argv = ["sweep", written(tmp_path, total_twist=None), *GRID, "--out", str(tmp_path / "run")]
    assert main(argv) == 0
    out = capsys.readouterr().out
    assert re.search(r"hypotheses +18\b.*\b6 observations.*\b0\b", out)
    unknown = written(tmp_path, total_twist=None, end_frame=None)
    assert main(["sweep", unknown, *GRID, "--spins", "6", "--out", str(tmp_path / "spins")]) == 0
    out = capsys.readouterr().out
    assert "hypotheses  108;" in out and "twist is not determined" not in out
    assert main(["sweep", unknown, *GRID, "--out", str(tmp_path / "free")]) == 0
    assert "twist is not" in capsys.readouterr().out


@pytest.mark.parametrize("words, expected", [
    (["--pairs", "pairs.csv"], ["--pairs", "the objective is static"]),
    (["--objective", "dynamic", "--pairs", "absent.csv"], ["absent.csv", "no such file"]),
    (["--objective", "both"], ["--objective", "'both'"]),
    (["--spins", "9999"], ["--roll-hypotheses", "9999"]),
    (["--spins", "12"], ["lab.npz", "spins", "no end is held by its tangent alone"]),
])
def test_what_makes_no_sense_is_refused(capsys, tmp_path, monkeypatch, words, expected):
    monkeypatch.chdir(tmp_path)
    refused(capsys, tmp_path, ["sweep", written(tmp_path), *GRID, "--out", str(tmp_path / "run"), *words], *expected)
