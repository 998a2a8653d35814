"""docs/reading_runs.md: its examples run as they stand, on a small run."""

import json
import re
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest

from doo_ti import Status, sweep
from doo_ti.learning.chunks import maker
from tests.learning.lab import DYNAMIC, GRID, small_lab

PAGE = (Path(__file__).parents[2] / "docs" / "reading_runs.md").read_text(encoding="utf-8")
EXAMPLES = dict(re.findall(r"^## ([^\n]+)\n(?:(?!^## ).)*?```python\n(.*?)```", PAGE, re.DOTALL | re.MULTILINE))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("reading")
    sweep(folder / "runs" / "silk", small_lab(), GRID)
    sweep(folder / "runs" / "moved", small_lab(), GRID, options=DYNAMIC)
    return folder


def printed(folder, word: str, monkeypatch, capsys) -> str:
    """What the example prints whose heading has that word."""
    example, = (text for heading, text in EXAMPLES.items() if word in heading)
    monkeypatch.chdir(folder)
    capsys.readouterr()
    exec(example, {})
    return capsys.readouterr().out


@pytest.mark.thorough
def test_the_example_finds_the_best_cell(folder, monkeypatch, capsys):
    found = [float(number) for number in printed(folder, "pyarrow", monkeypatch, capsys).split()]
    best = json.loads((folder / "runs" / "silk" / "summary.json").read_text())["best"]
    assert found[:4] == [best[key] for key in ("bend_1", "bend_2", "twist", "weight")]
    assert np.isclose(found[4], best["mean_distance_mm"], rtol=1e-12)


@pytest.mark.thorough
def test_the_maker_of_each_file_is_printed(folder, monkeypatch, capsys):
    out = printed(folder, "who made it", monkeypatch, capsys)
    summary = json.loads((folder / "runs" / "silk" / "summary.json").read_text())
    assert f"72 {summary['provenance']['sweep_sha256'][:8]} {maker()['doo_ti']}" in out


@pytest.mark.thorough
def test_every_column_and_status_is_explained(folder):
    names = set()
    for run in ("silk", "moved"):
        names |= set(pyarrow.parquet.read_schema(min((folder / "runs" / run / "cells").glob("*.parquet"))).names)
    assert not {name for name in names if f"`{name}`" not in PAGE}
    for kind in Status:
        assert f"{int(kind)} {kind.name.lower().replace('_', ' ')}" in PAGE
