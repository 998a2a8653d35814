"""Who relaxes the chunks of a sweep: this process, others on this machine, or a Dask cluster. Results come in order."""

import logging
import os
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Executor, ProcessPoolExecutor
from concurrent.futures import wait as wait_for_futures
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import islice
from multiprocessing import get_context, parent_process
from multiprocessing.connection import wait
from socket import create_connection
from threading import Thread

from doo_ti.learning.chunks import maker, maker_text
from doo_ti.system import runtime
from doo_ti.system.errors import InputError
from doo_ti.system.terminal import kept_from_children

ANSWER_SECONDS = 10  # longest wait for a scheduler's answer
CHECK_SECONDS = 1.0  # interval at which the connection to the scheduler is checked
SCHEDULER_ENDED = "the connection to the scheduler is lost"


@dataclass(frozen=True)
class Workers:
    """Other processes that relax chunks."""

    executor: Executor  # takes the chunks
    ahead: int  # number of chunks submitted before the first result is waited for
    through: tuple = ()  # function and first arguments that call the work there, if any
    connected: Callable[[], bool] = lambda: True  # whether the processes can still be reached

    def results(self, work, chunks):
        """(chunk, ``work(*chunk)``) of each chunk in order; where one fails, results of later chunks come before the error."""
        chunks, waiting = iter(chunks), deque()
        while True:
            with kept_from_children():  # work may start processes
                for chunk in islice(chunks, self.ahead - len(waiting)):
                    waiting.append((chunk, self.executor.submit(*self.through, work, *chunk)))
            if not waiting:
                return
            chunk, future = waiting.popleft()
            try:
                while not future.done() and self.connected():
                    wait_for_futures([future], timeout=CHECK_SECONDS)
                if not future.done():
                    raise ConnectionError(SCHEDULER_ENDED)
                result = future.result()
            except BaseException as error:
                for later, other in waiting:
                    if other.done() and not other.cancelled() and other.exception() is None:
                        yield later, other.result()
                if isinstance(error, CancelledError):  # Dask cancels pending work when its scheduler ends
                    raise ConnectionError(SCHEDULER_ENDED) from None
                raise
            yield chunk, result


class ThisProcess:
    """This process relaxes the chunks itself."""

    def results(self, work, chunks):
        """The results of the chunks, as :meth:`Workers.results`."""
        for chunk in chunks:
            yield chunk, work(*chunk)


@contextmanager
def started_workers(workers: int | None, scheduler: str | None) -> Iterator[ThisProcess | Workers]:
    """``workers`` spawned processes, which share the processors, or the workers of the Dask scheduler at the address
    ``scheduler``; without either this process.

    Raises InputError for fewer workers than one, where Dask is not installed and where no scheduler answers.
    """
    if scheduler is not None:
        with _quiet(), _client(scheduler) as client:
            check_workers(client, maker())
            yield Workers(client.get_executor(pure=False), max(4, 2 * len(client.nthreads())), (_on_dask_worker, maker()),
                          lambda: client.status == "running")
    elif workers is not None:
        if workers < 1:
            raise InputError("sweep", "workers", f"{workers} is below 1", "give at least one")
        share = max(1, len(runtime.processors()) // workers)
        executor = ProcessPoolExecutor(workers, get_context("spawn"), initializer=_start_worker, initargs=(share,))
        try:
            yield Workers(executor, 2 * workers, (as_made, maker()))
        finally:
            executor.shutdown(cancel_futures=True)
    else:
        yield ThisProcess()


@contextmanager
def _quiet() -> Iterator[None]:
    """Silences what Dask logs where a scheduler or a worker is lost, with tracebacks: the sweep reports that in one line."""
    with suppress(ImportError):
        import distributed  # noqa: F401  this sets its loggers up
    loggers = [logger for name, logger in logging.root.manager.loggerDict.items()
               if name.split(".")[0] in ("distributed", "tornado") and isinstance(logger, logging.Logger)]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)


def _client(address: str):
    try:
        from distributed import Client
        from distributed.comm import parse_address, parse_host_port
    except ImportError:
        raise InputError(
            "sweep", "scheduler", "Dask is not installed", "pip install 'doo_ti[dask]', here and on the workers") from None
    try:
        # A client that finds no scheduler takes long to end: the port is tried first.
        protocol, place = parse_address(address)
        with create_connection(parse_host_port(place), ANSWER_SECONDS) as port:
            if protocol == "tcp" and not port.recv(1):  # a scheduler sends first
                raise ConnectionError("the connection was closed")
        return Client(address, timeout=ANSWER_SECONDS, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError("sweep", "scheduler", f"no scheduler answers at {address!r} ({error})",
                         "give the address that dask scheduler prints, tcp://HOST:8786") from None


def check_workers(client, expected: dict[str, str]) -> None:
    """Raise InputError unless there are workers, and all are the ``expected`` maker."""
    try:
        client.wait_for_workers(1, timeout=ANSWER_SECONDS)
        makers = client.run(maker)
    except TimeoutError:
        raise InputError("sweep", "scheduler", "the scheduler has no workers", "start some: dask worker ADDRESS") from None
    except Exception as error:  # such as that of a worker without the package
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError("sweep", "scheduler", f"a worker does not report its version ({reason})",
                         "install the same version of doo_ti on the workers, and restart them") from None
    for name, made in makers.items():
        if made != expected:
            raise _other_version(f"the worker {name}", made, expected)


def as_made(expected: dict[str, str], work, *chunk):
    """``work(*chunk)``, where this process is the ``expected`` maker. Raises InputError where it is another one."""
    if maker() != expected:
        raise _other_version("a worker", maker(), expected)
    return work(*chunk)


def _other_version(name: str, made: dict[str, str], expected: dict[str, str]) -> InputError:
    return InputError("sweep", "workers", f"{name} runs {maker_text(made)}, this process {maker_text(expected)}",
                      "install the same version on all, and restart the workers")


def _on_dask_worker(expected: dict[str, str], work, *chunk):
    """``work`` on all threads of a Dask worker, thus one chunk at a time. Workers may join later, so each chunk checks what
    its worker runs."""
    from distributed import get_worker

    runtime.start(threads=get_worker().state.nthreads, pinned=False)
    return runtime.exclusive(as_made)(expected, work, *chunk)


def _start_worker(threads: int) -> None:
    """Start Taichi on ``threads`` threads; the worker ends when its parent does."""

    def end_with_parent() -> None:
        wait([parent_process().sentinel])
        os._exit(1)

    Thread(target=end_with_parent, daemon=True).start()
    runtime.start(threads=threads, pinned=False)
