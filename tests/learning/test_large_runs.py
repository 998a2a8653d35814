"""A run of many rods: its sums over cells, a check without reading its rods, and an even part of a large grid."""

import shutil

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest

from doo_ti import Axis, Grid, Status, SweepOptions, sweep
from doo_ti.learning import chunks
from doo_ti.learning.figures import thinned
from doo_ti.learning.landscape import gather_landscape
from tests.conftest import check_refused
from tests.learning.lab import DYNAMIC, GRID, small_lab

CELLS_OF_A_FILE, OBSERVATIONS = 40, 100


def written(run, files: int, rng) -> Grid:
    """A run of ``files`` files of 4,000 rods in random order, some of which are not sound."""
    grid = Grid((Axis("bend", np.geomspace(1e5, 1e6, files)), Axis("twist_ratio", np.geomspace(0.3, 3, CELLS_OF_A_FILE))))
    (run / "cells").mkdir(parents=True)
    for file in range(files):
        values = grid.cell_values(slice(CELLS_OF_A_FILE * file, CELLS_OF_A_FILE * (file + 1)))
        count = CELLS_OF_A_FILE * OBSERVATIONS
        columns = {name: np.repeat(value, OBSERVATIONS) for name, value in values.items()}
        columns |= {"observation": np.tile(np.arange(OBSERVATIONS), CELLS_OF_A_FILE), "distance_mm": rng.uniform(1, 9, count),
                    "status": np.where(rng.random(count) < 1e-3, Status.STALLED, Status.CONVERGED).astype(np.int8),
                    "stable": rng.random(count) > 1e-3, "end_distance_mm": np.full(count, np.nan),
                    "end_rotation_deg": np.full(count, np.nan)}
        columns["status"][columns["observation"] == 7] = Status.ITERATION_LIMIT  # sound in no cell
        pyarrow.parquet.write_table(pyarrow.table(columns).take(rng.permutation(count)), run / "cells" / f"{file:03d}.parquet")
    return grid


def test_sums_are_those_of_all_rods(tmp_path, rng):
    grid = written(tmp_path, 6, rng)
    landscape = gather_landscape(tmp_path, grid, "silk", None)
    compared = landscape.sound.any(axis=0)
    assert not landscape.compared[7]
    whole = landscape.sound[:, compared].all(axis=1)
    # Term by term, as a column of a table is added up: to the last bit, whatever the order in the files.
    mean = np.cumsum(landscape.distance[:, compared], axis=1)[:, -1] / compared.sum()
    np.testing.assert_array_equal(landscape.mean_distance, np.where(whole, mean, np.nan))
    np.testing.assert_array_equal(landscape.unsound, (~landscape.sound[:, compared]).sum(axis=1))
    assert 0 < whole.sum() < grid.size


@pytest.mark.parametrize("damage", ["twice", "elsewhere", "missing"])
def test_a_rod_that_is_there_twice_or_never_is_found(tmp_path, rng, damage):
    grid = written(tmp_path, 3, rng)
    path = tmp_path / "cells" / "001.parquet"
    rows = pyarrow.parquet.read_table(path)
    changed = {"twice": pyarrow.concat_tables([rows.slice(0, len(rows) - 1), rows.slice(3, 1)]),
               "elsewhere": rows.set_column(0, "bend_1", pyarrow.array(np.full(len(rows), 3.3e5))),
               "missing": rows.slice(1)}[damage]
    pyarrow.parquet.write_table(changed, path)
    check_refused("cell", gather_landscape, tmp_path, grid, "silk", None)


def test_cells_are_found_by_their_values():
    for axes in ((Axis("bend", np.geomspace(1e4, 1e7, 57)), Axis("twist_ratio", np.geomspace(0.1, 6, 31)),
                  Axis("weight", [0.0, 1.0, 3.0])),
                 (Axis("bend_1", [1e5, 2e5]), Axis("bend_2", np.linspace(1e5, 7e5, 11)), Axis("twist", [1e4, 5e5]))):
        grid = Grid(axes)
        values = grid.cell_values()
        np.testing.assert_array_equal(grid.cells_of(values), np.arange(grid.size))
        values["twist"] = values["twist"] * (1 + 1e-14)
        assert (grid.cells_of(values) == -1).all()


@pytest.mark.thorough
@pytest.mark.parametrize("options", [SweepOptions(), DYNAMIC])
def test_a_finished_sweep_reads_no_rods_and_overlooks_no_file(tmp_path, monkeypatch, options):
    summary = sweep(tmp_path / "run", small_lab(), GRID, options=options)
    with monkeypatch.context() as patched:
        patched.setattr(chunks, "read_rows", lambda *arguments: pytest.fail("rods were read"))
        assert sweep(tmp_path / "run", small_lab(), GRID, options=options) == summary
    chunk = min((tmp_path / "run" / "cells").glob("*.parquet"))
    shutil.copy(chunk, chunk.with_name("copy.parquet"))
    check_refused("once", sweep, tmp_path / "run", small_lab(), GRID, options=options)


@pytest.mark.parametrize("shape", [(25, 25, 1), (50, 50, 1), (7, 1, 1), (12, 9, 30, 2), (1, 1, 1)])
@pytest.mark.parametrize("most", [1, 9, 100, 700, 10**6])
def test_parts_are_even_and_hold_what_they_must(shape, most, rng):
    kept = [tuple(int(rng.integers(size)) for size in shape) for _ in range(2)]
    part = thinned(shape, most, kept)
    counts = [len(indices) for indices in part]
    for axis, (size, indices) in enumerate(zip(shape, part, strict=True)):
        assert (np.diff(indices) > 0).all() and indices[0] >= 0 and indices[-1] < size
        assert {cell[axis] for cell in kept} <= set(indices.tolist())
        gaps = np.diff(indices)
        assert len(gaps) == 0 or gaps.max() <= 2 * np.ceil((size - 1) / len(gaps))
    smallest = np.prod([max(min(2, size), len({cell[axis] for cell in kept})) for axis, size in enumerate(shape)])
    assert np.prod(counts) <= max(most, smallest)
    if np.prod(shape) <= most:
        assert counts == list(shape)
    elif most > smallest:  # one value more on the longest axis would be too many
        assert np.prod(counts) * (1 + 1 / max(counts)) > 0.8 * most
