"""Chunks that others relax: a Dask cluster, with a message of one line where there is none, or processes of this machine."""

import os
import pickle
import re
import socket
import subprocess
import sys
import time

import pytest

from doo_ti import InputError, InterruptedRunError, SweepOptions, save_observations, sweep
from doo_ti.learning import sweeps, workers
from doo_ti.learning.chunks import maker
from doo_ti.learning.workers import as_made, started_workers
from tests.conftest import check_refused
from tests.learning.lab import GRID, small_lab
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


def test_a_worker_that_runs_something_else_is_refused():
    assert as_made(maker(), max, 3, 4) == 4
    with pytest.raises(InputError, match="99.0") as caught:
        as_made(maker() | {"doo_ti": "99.0"}, max, 3, 4)
    again = pickle.loads(pickle.dumps(caught.value))  # as it comes from another process
    assert (str(again), again.remedy) == (str(caught.value), caught.value.remedy)


def test_no_workers_are_refused():
    with pytest.raises(InputError, match="workers: 0 is below 1"), started_workers(0, None):
        pass
