"""Chunks of work in other processes, of this machine or of a Dask cluster, their results in order."""

import os
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from multiprocessing import get_context, parent_process
from multiprocessing.connection import wait
from socket import create_connection
from threading import Thread

from doo_ti import runtime
from doo_ti.errors import InputError
from doo_ti.interruption import kept_from_children
from doo_ti.learning.maker import as_made, maker, other_worker

ANSWER_SECONDS = 10
"""How long a scheduler may take to answer."""


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
        """(chunk, ``work(*chunk)``) of each chunk in order; where one fails those done behind it come before the error."""
        chunks, waiting = iter(chunks), deque()
        while True:
            with kept_from_children():  # work may start processes
                for chunk in islice(chunks, self.ahead - len(waiting)):
                    waiting.append((chunk, self.executor.submit(*self.through, work, *chunk)))
            if not waiting:
                return
            chunk, future = waiting.popleft()
            try:
                result = future.result()
            except BaseException:
                for later, other in waiting:
                    if other.done() and not other.cancelled() and other.exception() is None:
                        yield later, other.result()
                raise
            yield chunk, result


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

    Raises InputError for fewer workers than one, where Dask is not installed and where no scheduler answers.
    """
    if scheduler is not None:
        with _client(scheduler) as client:
            _check_workers(client, maker())
            yield Crew(client.get_executor(pure=False), max(4, 2 * len(client.nthreads())), (_on_dask_worker, maker()))
    elif workers is not None:
        if workers < 1:
            raise InputError("sweep", "workers", f"{workers} is below 1", "give at least one")
        share = max(1, len(runtime.processors()) // workers)
        executor = ProcessPoolExecutor(workers, get_context("spawn"), initializer=_start_worker, initargs=(share,))
        try:
            yield Crew(executor, 2 * workers, (as_made, maker()))
        finally:
            executor.shutdown(cancel_futures=True)
    else:
        yield Alone()


def _client(address: str):
    try:
        from distributed import Client
        from distributed.comm import parse_address, parse_host_port
    except ImportError:
        raise InputError(
            "sweep", "--dask", "Dask is not installed", "pip install 'doo_ti[dask]', here and on the workers") from None
    try:
        # A client that finds nobody takes long to give up for good.
        with create_connection(parse_host_port(parse_address(address)[1]), ANSWER_SECONDS):
            pass
        return Client(address, timeout=ANSWER_SECONDS, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError("sweep", "--dask", f"no scheduler answers at {address!r} ({error})",
                         "give the address that dask scheduler prints, tcp://HOST:8786") from None


def _check_workers(client, expected: dict[str, str]) -> None:
    """Raise InputError unless there are workers, and all are the ``expected`` maker."""
    try:
        client.wait_for_workers(1, timeout=ANSWER_SECONDS)
        makers = client.run(maker)
    except TimeoutError:
        raise InputError("sweep", "--dask", "the scheduler has no workers", "start some: dask worker ADDRESS") from None
    except Exception as error:  # whatever a worker without the package, or with another one, answers
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError("sweep", "--dask", f"a worker cannot say what it runs ({reason})",
                         "install doo_ti on the workers, the same as here, and start them anew") from None
    for name, made in makers.items():
        if made != expected:
            raise other_worker(f"the worker {name}", made, expected)


def _on_dask_worker(expected: dict[str, str], work, *chunk):
    """``work`` on all threads of a Dask worker, and so on one chunk at a time; workers may come and go, so it is checked here
    too what this one runs."""
    from distributed import get_worker

    runtime.start(threads=get_worker().state.nthreads, pinned=False)
    return runtime.exclusive(as_made)(expected, work, *chunk)


def _start_worker(threads: int) -> None:
    """Start Taichi on ``threads`` threads, and see to it that the worker does not outlive its parent."""

    def end_with_parent() -> None:
        wait([parent_process().sentinel])
        os._exit(1)

    Thread(target=end_with_parent, daemon=True).start()
    runtime.start(threads=threads, pinned=False)
