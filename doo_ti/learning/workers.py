"""Chunks of work in worker processes, their results in order."""

import os
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import nullcontext
from multiprocessing import get_context, parent_process
from multiprocessing.connection import wait


def pool(workers: int | None):
    """An executor of that many spawned processes that share the processors; without a number none."""
    if workers is None:
        return nullcontext()
    threads = max(1, (os.cpu_count() or 1) // workers)
    return ProcessPoolExecutor(workers, get_context("spawn"), initializer=_start_worker, initargs=(threads,))


def _start_worker(threads: int) -> None:
    """Start Taichi on ``threads`` threads, and see to it that the worker does not outlive its parent."""
    from threading import Thread

    from doo_ti import runtime

    def end_with_parent() -> None:
        wait([parent_process().sentinel])
        os._exit(1)

    Thread(target=end_with_parent, daemon=True).start()
    runtime.start(threads=threads)


def results(work, chunks, executor: Executor | None):
    """(chunk, columns) of each chunk in order, computed here or by the executor, a few ahead."""
    if executor is None:
        for chunk in chunks:
            yield chunk, work(*chunk)
        return
    ahead = 2 * (os.cpu_count() or 1)
    waiting = []
    for chunk in chunks:
        waiting.append((chunk, executor.submit(work, *chunk)))
        if len(waiting) > ahead:
            chunk, future = waiting.pop(0)
            yield chunk, future.result()
    for chunk, future in waiting:
        yield chunk, future.result()
