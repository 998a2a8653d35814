"""``doo-ti plan``: output, files, refused input."""

import csv
import json
from pathlib import Path

import pytest

from tests.commands.calls import refused, succeeded

SCENE = """
name = "cord"
[synthesis]
bend = 1.8e6
twist = 1.2e6
end_distances_mm = [42.0, 66.0]
end_rotations_deg = [0.0, 120.0]
[grid]
bend = "2e5:5e6:3"
twist_ratio = "0.3:3:2"
"""


@pytest.fixture(autouse=True)
def scene(written_whole) -> None:
    Path("cord.toml").write_text(SCENE)


def test_a_scene(capsys):
    out = succeeded(capsys, "plan cord.toml --picks 3 --out plan")
    assert "4 configurations" in out and "6 cells" in out
    summary = json.loads(Path("plan/plan.json").read_text())
    assert summary["asked"] == ["bend", "twist"] and len(summary["order"]) == 3 and summary["sigma_mm"] == 0.12
    rows = list(csv.DictReader(Path("plan/plan.csv").read_text().splitlines()))
    assert [row["rank"] for row in rows].count("") == 1 and float(rows[0]["bend_mm"]) > 0
    assert Path("plan/identifiability.png").read_bytes().startswith(b"\x89PNG")


def test_what_is_measured_is_not_ranked(capsys):
    summary = json.loads(succeeded(capsys, "plan cord.toml --measured 1 --json"))
    assert summary["end_distance_mm"] == [42, 66, 42, 66] and sorted(summary["order"]) == [0, 2, 3]


@pytest.mark.parametrize("words, option", [
    ("--sigma 0", "--sigma"), ("--sigma 1e-300", "sigma"), ("--measured 9", "--measured"), ("--measured 1,1", "--measured"),
    ("--bend 1e6 --twist 1e6", "single cell"), ("--weight 1:2:2", "ratios")])
def test_wrong_input_is_one_line(tmp_path, capsys, words, option):
    refused(capsys, tmp_path, f"plan cord.toml {words} --out plan", option)
