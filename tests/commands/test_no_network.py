"""No command opens a socket to another machine: the kernel ends it, or a trace shows that it stays on this one."""

import os
import platform
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from doo_ti.commands.cli import main
from doo_ti.commands.machine import INPUTS
from doo_ti.io.observation_files import save_observations
from tests.commands.test_cameras import TEXT, pictures, prepared, rows_of  # noqa: F401  a fixture
from tests.io.rods import wavy_vertices
from tests.learning.lab import small_lab
from tests.processes import ROOT, python

# System call number of socket(2), and the number of the architecture that a seccomp filter receives.
SOCKET = {"x86_64": (41, 0xC000003E), "aarch64": (198, 0xC00000B7)}
pytestmark = pytest.mark.skipif(sys.platform != "linux" or platform.machine() not in SOCKET, reason="takes seccomp")

# A filter that ends the process, and each one it starts, at socket(AF_INET or AF_INET6, …); sockets between processes of
# this machine are not meant. Each step: operation, steps to skip if so, if not, number (linux/filter.h, linux/seccomp.h).
GUARD = """
import ctypes
import struct
import sys

NUMBER, ARCHITECTURE = NUMBERS
LOAD, EQUAL, RETURN = 0x20, 0x15, 0x06
KILL, ALLOW = 0x80000000, 0x7FFF0000
steps = [(LOAD, 0, 0, 4), (EQUAL, 0, 5, ARCHITECTURE), (LOAD, 0, 0, 0), (EQUAL, 0, 3, NUMBER), (LOAD, 0, 0, 16),
         (EQUAL, 2, 0, 2), (EQUAL, 1, 0, 10), (RETURN, 0, 0, ALLOW), (RETURN, 0, 0, KILL)]
program = ctypes.create_string_buffer(b"".join(struct.pack("HBBI", *step) for step in steps))
header = ctypes.create_string_buffer(struct.pack("HP", len(steps), ctypes.addressof(program)))
libc = ctypes.CDLL(None, use_errno=True)
assert libc.prctl(38, 1, 0, 0, 0) == 0 and libc.prctl(22, 2, header, 0, 0) == 0, ctypes.get_errno()
"""
COMMANDS = """
from doo_ti.commands.cli import main

if __name__ == "__main__":
    for words in sys.argv[1:]:
        print(words, flush=True)
        assert main(words.split()) == 0
"""
MATERIAL = "--bend 4e5 --twist 4e5"


def guarded(script: str, *arguments: str, folder: Path) -> subprocess.CompletedProcess:
    """``script`` in a process with the guard, in which Taichi has not yet checked for a new version."""
    source = folder / "guarded.py"
    source.write_text(GUARD.replace("NUMBERS", repr(SOCKET[platform.machine()])) + script)
    kernels = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "taichi" / "ticache"
    return python(source, *arguments, folder=folder, XDG_CACHE_HOME=folder / "cache", TI_OFFLINE_CACHE_FILE_PATH=kernels)


def open_no_socket(words: list[str], folder: Path) -> None:
    done = guarded(COMMANDS, *words, folder=folder)
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"


def test_the_guard_ends_what_opens_a_socket(tmp_path):
    done = guarded("import socket\nsocket.socketpair()\nprint('here', flush=True)\nsocket.socket()\n", folder=tmp_path)
    assert done.stdout == "here\n" and done.returncode < 0


@pytest.mark.parametrize("words", [
    pytest.param([f"relax o.npz {MATERIAL} --out F.npz", "sweep o.npz --bend 2e5:8e5:3 --workers 2 --out run", "learn run"],
                 marks=pytest.mark.thorough),
    pytest.param(["convert o.npz o.csv", "sweep o.npz --bend 2e5:8e5:3 --out run", "figures run --out figures",
                  f"refine o.npz {MATERIAL} --parameters bend", f"twist o.npz {MATERIAL} --out phi.npz"],
                 marks=pytest.mark.slow)])
def test_no_command_opens_a_socket(tmp_path, words):
    save_observations(tmp_path / "o.npz", small_lab())
    open_no_socket(words, tmp_path)


@pytest.mark.slow
def test_no_command_on_images_opens_a_socket(tmp_path, pictures, rng, monkeypatch):  # noqa: F811
    monkeypatch.chdir(tmp_path)
    Path("lab.toml").write_text(INPUTS["seen.toml"])
    synth = f"synth lab.toml --images images --rig {ROOT}/scenes/rig.yaml"
    assert main(synth.split()) == 0
    sets = tmp_path / "images" / "sets.csv"
    sets.with_name("frames.csv").write_text(sets.read_text().replace("name,", "frame,", 1))
    seen = f"--rig images/rig.yaml --rest-length 3:33 {MATERIAL}"
    words = [synth, f"perceive {seen} --sets images/sets.csv --out p.npz",
             f"track {seen} --frames images/frames.csv --out t.npz",
             f"predict {ROOT}/scenes/motion/pulled_straight.toml --out m.npz --recording m.rrd --picture m.png",
             f"calibrate {pictures}/views.csv --board {TEXT} --out rig.yaml", "plan lab.toml --twist 4e5",
             f"{prepared(tmp_path, rows_of(wavy_vertices(rng, count=2, marks=8), rng))} --out marks.npz"]
    open_no_socket(words, tmp_path)


def connections(folder: Path, *words: str, **environment: str) -> tuple[int, list[str]]:
    """Exit code of a command, and the addresses that it, and what it starts, connects to by network."""
    trace = ["strace", "-f", "--seccomp-bpf", "-e", "trace=connect,sendto", "-o", "trace.txt"]
    done = subprocess.run([*trace, sys.executable, "-m", "doo_ti", *words], cwd=folder, capture_output=True, timeout=300,
                          env={**os.environ, "PYTHONPATH": str(ROOT), **environment})
    return done.returncode, re.findall(r'inet_(?:addr\(|pton\(AF_INET6, )"([^"]+)"', (folder / "trace.txt").read_text())


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("strace") is None, reason="takes strace")
def test_dask_and_the_viewer_stay_on_this_machine(tmp_path):
    distributed = pytest.importorskip("distributed", reason="no cluster without Dask")
    save_observations(tmp_path / "o.npz", small_lab())
    words = "sweep o.npz --bend 2e5:8e5:3 --out run --dask".split()
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None) as cluster:
        code, addresses = connections(tmp_path, *words, cluster.scheduler_address)
    assert code == 0 and addresses and set(addresses) == {"127.0.0.1"}
    code, addresses = connections(tmp_path, "view", "run", DISPLAY=":99")
    assert code == 1 and set(addresses) <= {"127.0.0.1", "::1"}
    code, addresses = connections(tmp_path, "view", "run", "--screenshot", "view.png")  # with or without a Vulkan driver
    assert code in (0, 1) and addresses and set(addresses) <= {"127.0.0.1", "::1"}
