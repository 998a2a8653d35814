"""Chunks of work in other processes, of this machine or of a Dask cluster, their results in order."""

import os
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context, parent_process
from multiprocessing.connection import wait
from threading import Lock, Thread

from doo_ti import runtime
from doo_ti.errors import InputError

ANSWER_SECONDS = 10
"""How long a scheduler may take to answer."""

_busy = Lock()


@dataclass(frozen=True)
class Crew:
    """Who does the work.

    executor  takes the chunks
    ahead     how many it is given before the first is waited for
    through   what calls the work there, if anything does
    """

    executor: Executor
    ahead: int
    through: tuple = ()

    def results(self, work, chunks):
        """(chunk, ``work(*chunk)``) of each chunk in order."""
        waiting = []
        for chunk in chunks:
            waiting.append((chunk, self.executor.submit(*self.through, work, *chunk)))
            if len(waiting) > self.ahead:
                chunk, future = waiting.pop(0)
                yield chunk, future.result()
        for chunk, future in waiting:
            yield chunk, future.result()


class Alone:
    """This process does the work itself."""

    def results(self, work, chunks):
        """As :meth:`Crew.results`."""
        for chunk in chunks:
            yield chunk, work(*chunk)


@contextmanager
def crew(workers: int | None, scheduler: str | None) -> Iterator[Alone | Crew]:
    """That many spawned processes, which share the processors, or the workers of the Dask scheduler at that address; without
    either this process.

    Raises InputError where Dask is not installed or no scheduler answers.
    """
    if scheduler is not None:
        with _client(scheduler) as client:
            yield Crew(client.get_executor(pure=False), max(4, 2 * len(client.nthreads())), (_on_dask_worker,))
    elif workers is not None:
        share = max(1, (os.cpu_count() or 1) // workers)
        with ProcessPoolExecutor(workers, get_context("spawn"), initializer=_start_worker, initargs=(share,)) as executor:
            yield Crew(executor, 2 * (os.cpu_count() or 1))
    else:
        yield Alone()


def _client(address: str):
    try:
        from distributed import Client
    except ImportError:
        raise InputError(
            "sweep", "--dask", "Dask is not installed", "pip install 'doo_ti[dask]', here and on the workers") from None
    try:
        return Client(address, timeout=ANSWER_SECONDS, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError("sweep", "--dask", f"no scheduler answers at {address!r} ({error})",
                         "give the address that dask scheduler prints, tcp://HOST:8786") from None


def _on_dask_worker(work, *chunk):
    """``work`` on all threads of a Dask worker, and so on one chunk at a time."""
    from distributed import get_worker

    with _busy:
        runtime.start(threads=get_worker().state.nthreads)
        return work(*chunk)


def _start_worker(threads: int) -> None:
    """Start Taichi on ``threads`` threads, and see to it that the worker does not outlive its parent."""

    def end_with_parent() -> None:
        wait([parent_process().sentinel])
        os._exit(1)

    Thread(target=end_with_parent, daemon=True).start()
    runtime.start(threads=threads)
