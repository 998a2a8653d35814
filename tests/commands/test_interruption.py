"""Ctrl-C at any moment: one line, exit code 1, no traceback, and it is never ignored."""

import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from urllib.request import urlopen

import pytest

from doo_ti.io.observation_files import save_observations
from doo_ti.system import terminal
from tests.learning.lab import small_lab
from tests.processes import ROOT, python

pytestmark = pytest.mark.skipif(os.name != "posix", reason="sends signals as a terminal does")

# Ctrl-C comes while the command line is imported.
STARTING = """
import os, signal, sys
from doo_ti.__main__ import main

class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == "doo_ti.commands.cli":
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Finder())
main()
print("lost")
"""
SWALLOWED = """
import os, signal, sys, time
from doo_ti.system import terminal

terminal.while_running(True)

class Ended:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.01)

try:
    USE
    time.sleep(10)
    print("lost")
except KeyboardInterrupt:
    print("interrupted")
"""
HIDING = """
import os, signal, time
try:
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(0.01)
except BaseException:
    pass
"""


def run_script(script: str, folder: Path) -> subprocess.CompletedProcess:
    return python("-c", script, folder=folder, PYTHONPATH=f"{ROOT}{os.pathsep}{folder}")


def started(folder: Path, line: str) -> subprocess.Popen:
    return subprocess.Popen([sys.executable, "-m", "doo_ti", *line.split()], cwd=folder, stdout=subprocess.PIPE,
                            stderr=subprocess.PIPE, text=True, start_new_session=True,
                            env={**os.environ, "PYTHONPATH": str(ROOT)})


def test_while_the_program_starts(tmp_path):
    done = run_script("import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n" + STARTING, tmp_path)
    assert (done.returncode, done.stdout) == (1, "") and done.stderr.count("\n") == 1


@pytest.mark.parametrize("use", ["import hiding", "Ended()"])
def test_where_an_exception_would_be_lost(tmp_path, use):
    (tmp_path / "hiding.py").write_text(HIDING)
    done = run_script(SWALLOWED.replace("USE", use), tmp_path)
    assert (done.stdout, done.stderr) == ("interrupted\n", "")


def test_a_program_whose_caller_ignores_it_does_so_too(tmp_path):
    script = f"import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)\n{STARTING}"
    done = run_script(script.replace("main()", "sys.argv[1:] = ['--version']; main()"), tmp_path)
    assert done.stdout.endswith("lost\n") and done.stderr == ""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_while_processes_are_started_waits_for_them(number):
    """Another thread receives it, which the mask of the main one does not prevent."""
    heard, before = [], signal.signal(number, lambda received, frame: heard.append(received))
    stop = threading.Event()
    other = threading.Thread(target=stop.wait)
    other.start()
    try:
        with terminal.kept_from_children():
            os.kill(os.getpid(), number)
            time.sleep(0.05)
            assert heard == []
        assert heard == [number]
    finally:
        stop.set()
        other.join()
        signal.signal(number, before)


@pytest.mark.thorough
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_served_viewer_ends_with_its_command(tmp_path, number):
    """Also where the terminal is closed, which signals only that."""
    (tmp_path / "run.rrd").write_bytes(b"RRF2")
    command = started(tmp_path, "view run.rrd --web")
    try:
        ports = [int(port) for port in re.findall(r"127\.0\.0\.1:(\d+)", command.stdout.readline())]
        assert len(ports) == 2 and all(answers(port) for port in ports)
        with urlopen(f"http://127.0.0.1:{ports[0]}/") as page:
            assert f"'self' http://127.0.0.1:{ports[1]} " in page.headers["Content-Security-Policy"]
            assert b"<canvas" in page.read()
        command.send_signal(number)
        out, err = command.communicate(timeout=30)
        assert command.returncode == 0 and err == "" and not any(answers(port, seconds=0) for port in ports)
    finally:
        os.killpg(command.pid, signal.SIGKILL) if command.poll() is None else None


def test_under_nohup_the_end_of_the_terminal_is_ignored(tmp_path):
    script = ("import os, signal, time\nfrom doo_ti.system import terminal\nsignal.signal(signal.SIGHUP, signal.SIG_IGN)\n"
              "terminal.while_running(True)\nos.kill(os.getpid(), signal.SIGHUP)\ntime.sleep(0.05)\nprint('goes on')")
    assert run_script(script, tmp_path).stdout == "goes on\n"


def answers(port: int, seconds: float = 20.0) -> bool:
    deadline = time.monotonic() + seconds
    while True:
        with socket.socket() as client:
            if client.connect_ex(("127.0.0.1", port)) == 0:
                return True
        if time.monotonic() >= deadline:
            return False
        time.sleep(0.1)


@pytest.mark.thorough
def test_a_terminals_signal_to_workers_too(tmp_path):
    """It goes to all processes of the command: only the first prints a message."""
    save_observations(tmp_path / "o.npz", small_lab())
    command = started(tmp_path, "sweep o.npz --bend 1e5:1e6:200 --twist-ratio 0.5:2:200 --workers 2 --out run")
    while command.poll() is None and not list(tmp_path.glob("run/cells/*.parquet")):
        time.sleep(0.05)
    os.killpg(command.pid, signal.SIGINT)
    out, err = command.communicate()
    assert (command.returncode, out) == (1, "") and "Traceback" not in err
    assert err.splitlines()[-1].startswith("doo-ti: ") and "resume with: doo-ti sweep" in err
