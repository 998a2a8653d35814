"""A Dask cluster on this machine, a process for each part, each of which can be killed."""

import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from threading import Thread

WORKERS, WORKER_THREADS = 2, 1


class Cluster:
    """A context: the scheduler on a free port of the loopback interface, and its workers, which run the package in ``root``."""

    def __init__(self, root: Path):
        self._root, self._workers = root, []

    def __enter__(self) -> "Cluster":
        self._folder = tempfile.TemporaryDirectory()
        self._scheduler = self._begun("scheduler", self._root, "--host", "127.0.0.1", "--port", "0", stderr=subprocess.PIPE)
        self.address = next(found[1].decode() for line in self._scheduler.stderr
                            if (found := re.search(rb"Scheduler at:\s+(tcp://\S+)", line)))
        self._reading = Thread(target=self._scheduler.stderr.read)  # a full pipe would block what it logs
        self._reading.start()
        for _ in range(WORKERS):
            self.add_worker(self._root)
        return self

    def __exit__(self, *raised) -> None:
        for process in (*self._workers, self._scheduler):
            process.kill()
            process.wait()
        self._reading.join()
        self._scheduler.stderr.close()
        self._folder.cleanup()

    def add_worker(self, root: Path) -> None:
        """Have one more join, which runs the package in ``root``."""
        self._workers.append(self._begun("worker", root, self.address, "--nthreads", str(WORKER_THREADS), "--no-nanny",
                                         "--host", "127.0.0.1", "--death-timeout", "5", stderr=subprocess.DEVNULL))

    def kill_worker(self) -> None:
        self._workers[0].kill()

    def kill_scheduler(self) -> None:
        self._scheduler.kill()

    def _begun(self, part: str, root: Path, *words: str, stderr) -> subprocess.Popen:
        return subprocess.Popen([sys.executable, "-m", f"distributed.cli.dask_{part}", *words, "--no-dashboard"],
                                cwd=self._folder.name, env={**os.environ, "PYTHONPATH": str(root)}, stderr=stderr,
                                stdout=subprocess.DEVNULL)


def another_version(package: Path, folder: Path) -> None:
    """Copy ``package`` into ``folder``, with distances doubled, as an upgrade may change results."""
    shutil.copytree(package, folder / package.name, ignore=shutil.ignore_patterns("__pycache__"))
    metric = folder / package.name / "rod" / "metric.py"
    metric.write_text(metric.read_text() + "\n_one = distance\n\n\ndef distance(*given, **options):\n"
                                           "    return 2 * _one(*given, **options)\n")
