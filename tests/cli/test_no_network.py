"""No command opens a socket to another machine: the kernel ends the process at the first one."""

import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest

from doo_ti.dataset import save_observations
from tests.sweeps.lab import small_lab

# System call number of socket(2), and the number of the architecture that a seccomp filter is told.
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
from doo_ti.cli import main

if __name__ == "__main__":
    for words in sys.argv[1:]:
        print(words, flush=True)
        assert main(words.split()) == 0
"""
MATERIAL = "--bend 4e5 --twist 4e5"


def guarded(script: str, *arguments: str, folder: Path) -> subprocess.CompletedProcess:
    """``script`` in a process with the guard, which believes that it has never called home."""
    source = folder / "guarded.py"
    source.write_text(GUARD.replace("NUMBERS", repr(SOCKET[platform.machine()])) + script)
    kernels = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "taichi" / "ticache"
    environment = {**os.environ, "XDG_CACHE_HOME": str(folder / "cache"), "TI_OFFLINE_CACHE_FILE_PATH": str(kernels),
                   "PYTHONPATH": str(Path(__file__).resolve().parents[2])}
    return subprocess.run([sys.executable, str(source), *arguments], capture_output=True, text=True, cwd=folder,
                          env=environment)


def test_the_guard_ends_what_opens_a_socket(tmp_path):
    done = guarded("import socket\nsocket.socketpair()\nprint('here', flush=True)\nsocket.socket()\n", folder=tmp_path)
    assert done.stdout == "here\n" and done.returncode < 0


def test_no_command_opens_a_socket(tmp_path):
    save_observations(tmp_path / "o.npz", small_lab())
    words = [f"relax o.npz {MATERIAL} --out F.npz", "convert o.npz o.csv",
             "sweep o.npz --bend 2e5:8e5:3 --workers 2 --out run", "learn run", "figures run --out figures",
             f"refine o.npz {MATERIAL} --parameters bend", f"twist o.npz {MATERIAL} --out phi.npz"]
    done = guarded(COMMANDS, *words, folder=tmp_path)
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"
