"""A run's folder that is not what a sweep wrote: refused in one line, never computed with."""

import json
import shutil

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest

from doo_ti.cli import main
from doo_ti.errors import InputError
from doo_ti.learning.landscape import read_landscape
from doo_ti.learning.sweeps import sweep
from tests.sweeps.lab import DYNAMIC, GRID, small_lab


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    sweep(folder / "static", small_lab(), GRID)
    sweep(folder / "dynamic", small_lab(), GRID, options=DYNAMIC)
    return folder


@pytest.fixture
def copy(runs, tmp_path):
    def copied(name: str):
        shutil.copytree(runs / name, tmp_path / name)
        return tmp_path / name

    return copied


def refused(capsys, argv: list, field: str) -> None:
    capsys.readouterr()
    assert main([str(word) for word in argv]) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and field in err


def with_column(run, name: str, change) -> None:
    """Change one column of a run's first file of cells."""
    path = min((run / "cells").glob("*.parquet"))
    table = pyarrow.parquet.read_table(path)
    values = table.column(name).to_pylist()
    change(values)
    kind = table.schema.field(name).type
    pyarrow.parquet.write_table(table.set_column(table.column_names.index(name), name, pyarrow.array(values, kind)), path)


def at_two(value):
    return lambda values: values.__setitem__(2, value)


@pytest.mark.parametrize(("run", "column", "value"), [
    ("static", "distance_mm", -1.0), ("static", "distance_mm", np.inf), ("static", "distance_mm", None),
    ("static", "status", 77), ("static", "stable", None), ("static", "observation", -1), ("static", "bend_1", None),
    ("dynamic", "pair_weight", -1.0), ("dynamic", "pair_weight", np.nan), ("dynamic", "jumps", -1),
])
def test_values_that_no_sweep_finds(capsys, copy, run, column, value):
    folder = copy(run)
    with_column(folder, column, at_two(value))
    refused(capsys, ["learn", folder], column)
    with pytest.raises(InputError):
        read_landscape(folder)


@pytest.mark.parametrize(("option", "value"), [
    ("frame_weight_mm", [1.0]), ("frame_weight_mm", -1), ("sub_step_rad", 1e-300), ("sub_step_rad", None), ("spins", -1),
    ("precision", "f16"), ("objective", ["static"]), ("solver", 3), ("clamp_start", 5),
])
def test_options_that_no_sweep_has(capsys, copy, option, value):
    folder = copy("static")
    summary = json.loads((folder / "summary.json").read_text())
    summary["provenance"]["options"][option] = value
    (folder / "summary.json").write_text(json.dumps(summary))
    refused(capsys, ["refine", folder], "summary.json")


def test_an_identity_that_is_no_text(copy):
    folder = copy("static")
    (folder / "cells" / "identity.txt").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="another sweep"):
        sweep(folder, small_lab(), GRID)
