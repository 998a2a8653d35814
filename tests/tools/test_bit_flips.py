"""Single flipped bits in the folders of finished sweeps: all are detected or have no effect."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tools.bit_flips import HARMLESS, NAMED, READERS, REMADE, UNNOTICED, Flip, Laboratory

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def laboratory(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    return Laboratory(("static",))


@pytest.mark.thorough
def test_every_bit_is_noticed(laboratory):
    files = [(run, name) for run, files in laboratory.whole.items() for name in files]
    assert all(any(name.endswith(end) for end in READERS) for _, name in files)
    for flip in laboratory.drawn(len(files), 7):
        assert UNNOTICED not in laboratory.judged(flip).values(), flip
    found = laboratory.judged(Flip("static", "observations.npz", 40, 3))
    assert found == {"figures": NAMED, "refine": NAMED, "sweep": REMADE}
    assert laboratory.judged(Flip("static", "cells/identity.txt", 3, 3)) == {"sweep": NAMED}
    assert laboratory.judged(Flip("static", "cells/identity.txt", 70, 3)) == {"sweep": HARMLESS}, "a remark: who made it"


@pytest.mark.slow
def test_two_thousand_bits():
    done = subprocess.run([sys.executable, "tools/bit_flips.py"], cwd=ROOT, capture_output=True, text=True,
                          env={**os.environ, "PYTHONPATH": str(ROOT)})
    print(done.stdout)
    assert done.returncode == 0, done.stdout + done.stderr
