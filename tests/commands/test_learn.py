"""``doo-ti learn``: tables on the terminal, in files and as JSON, and refused input."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from doo_ti.commands import runs as finished
from doo_ti.commands.cli import main
from tests.commands.calls import refused
from tests.commands.test_commands import write_run
from tests.learning.landscapes import dynamic, grid_of, static

LABELS = np.repeat([30.0, 54.0, 78.0], 6)
PAIRS = [(6 * group + one, 6 * group + other) for group in range(3) for one in range(6) for other in range(6) if one != other]


@pytest.fixture
def runs(monkeypatch, capsys, rng) -> None:
    """Runs by name: each material's bowl is lowest at its own cell, silk's pairs at another."""
    def bowl(cell, count):
        return 1 + rng.uniform(0, 0.2, (9, count)) + 0.5 * np.abs(np.arange(9) - cell)[:, None]

    built = {name: static(name, bowl(cell, 18), LABELS) for name, cell in (("nylon", 2), ("silk", 4), ("vicryl", 7))}
    built["silk_moved"] = dynamic("silk", bowl(6, len(PAIRS)), PAIRS, end_distance=LABELS)
    monkeypatch.setattr(finished, "read_landscape", lambda run: built[run.name])
    capsys.readouterr()  # the seed


def test_tables_of_the_paper(capsys, tmp_path, runs):
    assert main(["learn", "nylon", "silk", "vicryl", "silk_moved", "--out", str(tmp_path / "new" / "tables")]) == 0
    out = capsys.readouterr().out
    for words in ("Table I: leave-one-out error by material; static (Eq. 2)", "Table II: leave-one-out",
                  "Table III: leave-one-out error by objective and end distance; silk;",
                  "[ ] trained and tested on the same part", "What each training set chooses as a whole",
                  "every scored rod is a certified minimum"):
        assert words in out
    files = sorted(path.name for path in (tmp_path / "new" / "tables").iterdir())
    stems = ("by_material", "by_material_and_end_distance", "by_objective_and_end_distance")
    assert files == sorted([*(f"{stem}.{suffix}" for stem in stems for suffix in ("csv", "md")), "learn.json"])
    for stem, parts in zip(stems, (3, 9, 6), strict=True):
        with open(tmp_path / "new" / "tables" / f"{stem}.csv", newline="", encoding="utf-8") as file:
            lines = list(csv.DictReader(file))
        assert len(lines) == parts**2
        # Bowls differ by objective and material, so the diagonal's block holds each column's best.
        for line in lines:
            if line["is_best"] == "True":
                assert line["train"].split()[0] == line["test"].split()[0]


def test_json_says_what_the_files_say(capsys, tmp_path, runs):
    assert main(["learn", "nylon", "silk", "--by", "material", "--out", str(tmp_path), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed == json.loads((tmp_path / "learn.json").read_text())
    assert [run["material"] for run in printed["runs"]] == ["nylon", "silk"]
    table, = printed["tables"]
    assert (table["by"], table["within"], len(table["entries"])) == (["material"], "static", 4)
    assert table["training_error_mm"]["nylon"] == pytest.approx(printed["runs"][0]["mean_distance_mm"])
    before = (tmp_path / "by_material.csv").read_bytes()
    assert main(["learn", "nylon", "silk", "--by", "material", "--out", str(tmp_path), "--json"]) == 0
    assert (tmp_path / "by_material.csv").read_bytes() == before


def test_partitions_are_chosen(capsys, runs):
    assert main(["learn", "nylon", "silk", "--by", "end-distance, material", "--by", "material",
                 "--end-distances", "78,30"]) == 0
    out = capsys.readouterr().out
    assert "nylon 30 mm" in out and "nylon 78 mm" in out and "54 mm" not in out
    assert out.index("Table II:") < out.index("Table I:")
    assert main(["learn", "silk"]) == 0
    assert "end distance; silk static" in capsys.readouterr().out


def test_refused_runs(capsys, tmp_path, runs):
    out = tmp_path / "tables"
    for argv, words in ((["--by", "colour"], ("by", "'colour' is no partition", "material, objective, end-distance")),
                        (["--end-distances", "near"], ("--end-distances", "'near'")),
                        (["--by", "material", "--end-distances", "30"], ("--end-distances", "--by end-distance"))):
        refused(capsys, tmp_path, ["learn", "nylon", "silk", *argv, "--out", str(out)], *words)
    refused(capsys, tmp_path, ["learn", "silk", "--out", str(Path(__file__))], "--out", "is a file")


def test_runs_in_folders(capsys, tmp_path, rng):
    for name in ("nylon", "silk"):
        write_run(tmp_path / name, grid_of(4), rng.uniform(1, 2, (4, 5)), name)
    assert main(["learn", str(tmp_path / "nylon"), str(tmp_path / "silk")]) == 0
    out = capsys.readouterr().out
    assert "Table I:" in out and "Table II:" not in out, "without labels no table by end distance"
