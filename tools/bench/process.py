"""Measurements that need a new process: start-up, memory, and the number of threads.

The parent calls :class:`Children`; a child is ``python tools/bench/process.py TASK STARTS NUMBER ...`` and prints one JSON
object. Taichi's kernel cache is a temporary folder, so that nothing is left behind and the first child finds it empty.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median

import numpy as np

if not __package__:
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from doo_ti.system.errors import InterruptedRunError  # noqa: E402

CALLS = 2000
LARGEST_CALL = 256  # rods
IMPORT = ("import time; began = time.perf_counter(); import doo_ti; "
          "print('{\"seconds\": %r}' % (time.perf_counter() - began))")


class Children:
    """Processes started one after another, each of which relaxes the same starts under drawn materials, f32 to 1e-6.

    tables  () → (starts, clamps), the first time that a child needs them

    Use as a context: the folder with the starts and the kernel cache goes with it. Each method raises InterruptedRunError
    where its child fails.
    """

    def __init__(self, tables):
        self._tables = tables

    def __enter__(self) -> "Children":
        self.folder = tempfile.TemporaryDirectory(prefix="doo-ti-bench-")
        self._starts = Path(self.folder.name) / "starts.npz"
        return self

    def __exit__(self, *reason) -> None:
        self.folder.cleanup()

    def import_seconds(self) -> float:
        """How long ``import doo_ti`` takes."""
        return self._told(["-c", IMPORT])["seconds"]

    def process_seconds(self) -> float:
        """From the start of a process to its end, one rod relaxed per start on the way. The first child to relax anything
        compiles its kernels, those after it find them in the cache."""
        words = self._words("first")
        began = time.perf_counter()
        self._told(words)
        return time.perf_counter() - began

    def bytes_per_rod(self, rods: int) -> float | None:
        """Growth of the peak memory from ``rods`` to four times as many, per rod, less the results': input, tables, and
        temporary arrays of the call. None where the system does not report it."""
        return self._run("memory", rods)["bytes"]

    def growth_kb_per_call(self, calls: int) -> float | None:
        """Growth of the memory per call over the second half of ``calls`` calls of varied size, in kB; None where the
        system does not report it."""
        return self._run("calls", calls)["kb"]

    def rods_per_second(self, threads: int, rods: int, calls: int) -> float:
        """Converged rods per second on that many threads, median of ``calls`` of ``rods`` each, kernels warm."""
        return self._run("rate", threads, rods, calls)["rods_per_second"]

    def _run(self, task: str, *numbers: int) -> dict:
        return self._told(self._words(task, *numbers))

    def _words(self, task: str, *numbers: int) -> list[str]:
        if not self._starts.exists():
            _store(self._starts, *self._tables())
        return [__file__, task, str(self._starts), *map(str, numbers)]

    def _told(self, words: list[str]) -> dict:
        environment = {**os.environ, "TI_OFFLINE_CACHE_FILE_PATH": self.folder.name}
        done = subprocess.run([sys.executable, *words], env=environment, stdin=subprocess.DEVNULL, capture_output=True,
                              text=True, encoding="utf-8")
        if done.returncode:
            reason = (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]
            raise InterruptedRunError(f"benchmark: a process of its own failed ({reason})")
        return json.loads(done.stdout)


def _store(path: Path, starts, clamps) -> None:
    kinds = {name: np.int64(getattr(clamps, name)) for name in ("start", "end")}
    held = {name: getattr(clamps, name) for name in ("start_position", "end_position", "start_frame", "end_frame")}
    np.savez(path, origin=starts.start, quaternions=starts.quaternions, rest_length=starts.rest_length, **kinds, **held)


def _specimens(path: str, count: int | None = None):
    """The starts of the file in turn, under ``count`` materials; by default as many as there are starts."""
    from doo_ti.bench.workload import isotropic_materials, paired
    from doo_ti.rod.types import Clamps, Configuration

    with np.load(path, allow_pickle=False) as file:
        starts = Configuration(file["origin"], file["quaternions"], file["rest_length"])
        clamps = Clamps(file["start"], file["end"], file["start_position"], file["end_position"], file["start_frame"],
                        file["end_frame"])
    return paired(starts, clamps, isotropic_materials(count or starts.count))


def _relaxed(rods):
    from doo_ti.relaxation.newton import Newton

    return rods.relaxed(Newton(tolerance=1e-4), "f32")


def _first(path: str) -> dict:
    return {"rods": _relaxed(_specimens(path)).configuration.count}


def _memory(path: str, count: int) -> dict:
    most, results = [], 0
    for rods in (count, 4 * count):
        solution = _relaxed(_specimens(path, rods))
        shape = solution.configuration
        held = [shape.start, shape.quaternions, *vars(solution).values()]
        results = sum(array.nbytes for array in held if isinstance(array, np.ndarray)) / rods
        most.append(_memory_bytes("VmHWM"))
    return {"bytes": None if None in most else (most[1] - most[0]) / (3 * count) - results}


def _calls(path: str, calls: int) -> dict:
    rods, random = _specimens(path, LARGEST_CALL), np.random.default_rng(0)
    held = []
    for size in random.integers(1, LARGEST_CALL + 1, calls):
        _relaxed(rods.alone(slice(size)))
        held.append(_memory_bytes("VmRSS"))
    later = held[calls // 2:]
    if None in later:
        return {"kb": None}
    return {"kb": float(np.polyfit(np.arange(len(later)), later, 1)[0]) / 1e3}


def _rate(path: str, threads: int, count: int, calls: int) -> dict:
    from doo_ti.bench.clock import timed
    from doo_ti.system import runtime

    runtime.start(threads=threads)
    rods = _specimens(path, count)
    _relaxed(rods)
    rates = [solution.converged.sum() / seconds
             for seconds, solution in (timed(lambda: _relaxed(rods)) for _ in range(calls))]
    return {"rods_per_second": median(rates)}


def _memory_bytes(field: str) -> int | None:
    """Resident memory of this process now (VmRSS) or at most so far (VmHWM); None elsewhere than on Linux."""
    status = Path("/proc/self/status")
    if not status.exists():
        return None
    lines = dict(line.split(":", 1) for line in status.read_text(encoding="utf-8").splitlines())
    return 1024 * int(lines[field].split()[0])


TASKS = {"first": _first, "memory": _memory, "calls": _calls, "rate": _rate}

if __name__ == "__main__":
    print(json.dumps(TASKS[sys.argv[1]](sys.argv[2], *map(int, sys.argv[3:]))))
