"""A sweep whose work a Dask cluster does: the same rows, and one line where there is no cluster."""

import sys

import pytest

from doo_ti.errors import InputError, InterruptedRunError
from doo_ti.learning import sweeps, workers
from doo_ti.learning.maker import maker
from doo_ti.learning.sweeps import SweepOptions, sweep
from tests.sweeps.lab import GRID, small_lab
from tests.sweeps.test_sweep import assert_same_cells


@pytest.fixture(scope="module")
def scheduler():
    distributed = pytest.importorskip("distributed", reason="no cluster without Dask")
    with distributed.LocalCluster(n_workers=2, threads_per_worker=2, host="127.0.0.1", dashboard_address=None) as cluster:
        yield cluster.scheduler_address


@pytest.fixture
def small_chunks(monkeypatch):
    monkeypatch.setattr(sweeps, "CHUNK_BYTES", 18 * 32 * 33)  # three cells of six observations


@pytest.mark.filterwarnings("default")
def test_a_cluster_changes_nothing(tmp_path, scheduler, small_chunks):
    observations = small_lab()
    alone = sweep(tmp_path / "alone", observations, GRID)
    shared = sweep(tmp_path / "shared", observations, GRID, options=SweepOptions(scheduler=scheduler))
    assert shared["provenance"]["sweep_sha256"] == alone["provenance"]["sweep_sha256"], "either goes on with the other's run"
    assert_same_cells(tmp_path / "alone", tmp_path / "shared")


def _refuses(*chunk):
    raise ValueError("a worker's trouble")


@pytest.mark.filterwarnings("default")
def test_what_fails_on_a_worker_is_told_with_the_way_on(tmp_path, scheduler, small_chunks, monkeypatch):
    monkeypatch.setattr(sweeps, "_rows", _refuses)
    with pytest.raises(InterruptedRunError, match="a worker's trouble.*go on with: doo-ti sweep"):
        sweep(tmp_path / "run", small_lab(), GRID, options=SweepOptions(scheduler=scheduler), command=["doo-ti", "sweep"])


@pytest.mark.filterwarnings("default")
def test_no_scheduler_is_told_before_anything_is_written(tmp_path, scheduler, monkeypatch):
    monkeypatch.setattr(workers, "ANSWER_SECONDS", 0.5)
    for address in ("tcp://127.0.0.1:1", "nowhere at all"):
        with pytest.raises(InputError, match="--dask: no scheduler answers"):
            sweep(tmp_path / "run", small_lab(), GRID, options=SweepOptions(scheduler=address))
    assert not (tmp_path / "run").exists()


@pytest.mark.filterwarnings("default")
def test_workers_of_another_version_are_refused(scheduler):
    from distributed import Client

    with Client(scheduler, set_as_default=False) as client:
        workers._check_workers(client, maker())
        with pytest.raises(InputError, match="tcp://.*sources 00000000"):
            workers._check_workers(client, maker() | {"sources_sha256": "0" * 64})


@pytest.mark.filterwarnings("default")
def test_a_cluster_without_workers_is_refused(tmp_path, monkeypatch):
    distributed = pytest.importorskip("distributed", reason="no cluster without Dask")
    monkeypatch.setattr(workers, "ANSWER_SECONDS", 1)
    with distributed.LocalCluster(n_workers=0, host="127.0.0.1", dashboard_address=":0") as cluster:
        with pytest.raises(InputError, match="no workers"):
            sweep(tmp_path / "run", small_lab(), GRID, options=SweepOptions(scheduler=cluster.scheduler_address))
    assert not (tmp_path / "run").exists()


def test_dask_that_is_not_installed(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"--dask: Dask is not installed; pip install 'doo_ti\[dask\]'"):
        sweep(tmp_path / "run", small_lab(), GRID, options=SweepOptions(scheduler="tcp://127.0.0.1:8786"))
    assert not (tmp_path / "run").exists()
