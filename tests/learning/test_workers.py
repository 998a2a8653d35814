"""Chunks that others relax, on a Dask cluster or this machine; runs of many rods, and an even part of a large grid."""

import os
import pickle
import re
import shutil
import socket
import subprocess
import sys
import time

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest

from doo_ti import Axis, Grid, InputError, InterruptedRunError, Status, SweepOptions, save_observations, sweep
from doo_ti.learning import chunks, sweeps, workers
from doo_ti.learning.chunks import maker
from doo_ti.learning.figures import thinned
from doo_ti.learning.landscape import gather_landscape
from doo_ti.learning.workers import as_made, started_workers
from tests.conftest import check_refused
from tests.learning.lab import DYNAMIC, GRID, small_lab
from tests.learning.test_sweep import assert_same_cells, small_chunks  # noqa: F401  a fixture
from tests.processes import ROOT


@pytest.fixture(scope="module")
def scheduler():
    distributed = pytest.importorskip("distributed", reason="no cluster without Dask")
    with distributed.LocalCluster(n_workers=2, threads_per_worker=2, host="127.0.0.1", dashboard_address=None) as cluster:
        yield cluster.scheduler_address


@pytest.mark.thorough
@pytest.mark.filterwarnings("default")
def test_a_cluster_changes_nothing(tmp_path, scheduler, small_chunks):  # noqa: F811
    observations = small_lab()
    alone = sweep(tmp_path / "alone", observations, GRID)
    shared = sweep(tmp_path / "shared", observations, GRID, options=SweepOptions(scheduler=scheduler))
    assert shared["provenance"]["sweep_sha256"] == alone["provenance"]["sweep_sha256"], "either resumes the other's run"
    assert_same_cells(tmp_path / "alone", tmp_path / "shared")


def _refuses(*chunk):
    raise ValueError("a worker's trouble")


@pytest.mark.thorough
@pytest.mark.filterwarnings("default")
def test_a_failure_on_a_worker_is_reported_with_the_way_to_resume(tmp_path, scheduler, small_chunks, monkeypatch):  # noqa: F811
    monkeypatch.setattr(sweeps, "chunk_rows", _refuses)
    with pytest.raises(InterruptedRunError, match="a worker's trouble.*doo-ti sweep"):
        sweep(tmp_path / "run", small_lab(), GRID, options=SweepOptions(scheduler=scheduler), command=["doo-ti", "sweep"])


def assert_refused(folder, scheduler: str, match: str = "scheduler: ") -> None:
    check_refused(match, sweep, folder / "run", small_lab(), GRID, options=SweepOptions(scheduler=scheduler))
    assert not (folder / "run").exists()


@pytest.mark.thorough
@pytest.mark.filterwarnings("default")
def test_what_is_no_scheduler_is_refused(tmp_path, monkeypatch):
    pytest.importorskip("distributed", reason="no cluster without Dask")
    monkeypatch.setattr(workers, "ANSWER_SECONDS", 0.5)
    with socket.create_server(("127.0.0.1", 0)) as mute:
        for address in ("tcp://127.0.0.1:1", "no address", f"tcp://127.0.0.1:{mute.getsockname()[1]}"):
            assert_refused(tmp_path, address)


@pytest.mark.thorough
def test_a_scheduler_that_is_killed_is_one_line(tmp_path):
    """The command, in a separate process: exit code 1, how to resume, and no log of Dask."""
    pytest.importorskip("distributed", reason="no cluster without Dask")
    save_observations(tmp_path / "o.npz", small_lab())
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}

    def dask(part: str, *words: str, **streams) -> subprocess.Popen:
        return subprocess.Popen([sys.executable, "-m", f"distributed.cli.dask_{part}", *words, "--no-dashboard"], cwd=tmp_path,
                                env=environment, **streams)
    with dask("scheduler", "--host", "127.0.0.1", "--port", "0", stderr=subprocess.PIPE, text=True) as scheduler:
        address = next(found[1] for line in scheduler.stderr if (found := re.search(r"Scheduler at:\s+(tcp://\S+)", line)))
        worker = dask("worker", address, "--nthreads", "1", "--death-timeout", "15", stderr=subprocess.DEVNULL)
        words = ["sweep", "o.npz", "--bend", "1e5:1e6:300", "--twist-ratio", "0.5:2:300", "--out", "run", "--dask", address]
        command = subprocess.Popen([sys.executable, "-m", "doo_ti", *words], cwd=tmp_path, stdout=subprocess.PIPE,
                                   stderr=subprocess.PIPE, text=True, env=environment)
        try:
            while command.poll() is None and not list(tmp_path.glob("run/cells/*.parquet")):
                time.sleep(0.02)
            scheduler.kill()
            out, err = command.communicate(timeout=60)
        finally:
            command.kill()
            scheduler.kill()
            worker.kill()
            worker.wait()
    assert (command.returncode, out) == (1, ""), err
    messages = [line for line in err.splitlines() if "cells" not in line or line.startswith("doo-ti")]
    assert len(messages) == 1 and "scheduler" in messages[0] and "doo-ti sweep" in messages[0], err


@pytest.mark.thorough
@pytest.mark.filterwarnings("default")
def test_workers_of_another_version_are_refused(scheduler):
    from distributed import Client

    with Client(scheduler, set_as_default=False) as client:
        workers.check_workers(client, maker())
        check_refused("tcp://.*sources 00000000", workers.check_workers, client, maker() | {"sources_sha256": "0" * 64})


@pytest.mark.thorough
@pytest.mark.filterwarnings("default")
def test_a_cluster_without_workers_is_refused(tmp_path, monkeypatch):
    distributed = pytest.importorskip("distributed", reason="no cluster without Dask")
    monkeypatch.setattr(workers, "ANSWER_SECONDS", 1)
    with distributed.LocalCluster(n_workers=0, host="127.0.0.1", dashboard_address=":0") as cluster:
        assert_refused(tmp_path, cluster.scheduler_address)


def test_dask_that_is_not_installed(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert_refused(tmp_path, "tcp://127.0.0.1:8786", r"scheduler: .*pip install 'doo_ti\[dask\]'")


def _slowly(first: int, last: int) -> int:
    if first == 3:
        time.sleep(0.5)
        raise ValueError("the fourth fails")
    return last - first


@pytest.mark.thorough
def test_work_finished_before_a_failure_is_returned_and_the_rest_is_not_begun():
    asked = []

    def chunks():
        for k in range(1000):
            asked.append(k)
            yield k, k + 1
    found = []
    with pytest.raises(ValueError, match="the fourth fails"), started_workers(2, None) as own:
        for chunk, _ in own.results(_slowly, chunks()):
            found.append(chunk[0])
    assert found[:3] == [0, 1, 2] and 3 not in found and len(found) > 3 and len(asked) < 10


def test_a_worker_that_runs_something_else_and_none_at_all_are_refused():
    assert as_made(maker(), max, 3, 4) == 4
    with pytest.raises(InputError, match="99.0") as caught:
        as_made(maker() | {"doo_ti": "99.0"}, max, 3, 4)
    again = pickle.loads(pickle.dumps(caught.value))  # as it comes from another process
    assert (str(again), again.remedy) == (str(caught.value), caught.value.remedy)
    with pytest.raises(InputError, match="workers: 0 is below 1"), started_workers(0, None):
        pass


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
    grid, path = written(tmp_path, 3, rng), tmp_path / "cells" / "001.parquet"
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
