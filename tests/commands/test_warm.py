"""``doo-ti warm``: kernels are compiled in processes of their own, and kept for the next ones."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from doo_ti.commands import machine
from doo_ti.commands.cli import _parser, main

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("command", machine.STEPS)
def test_steps_are_valid_commands_that_end_with_their_own(command):
    for step in machine.STEPS[command]:
        _parser().parse_args(step.split())
    assert command in (step.split()[0] for step in machine.STEPS[command])


def test_each_step_is_run_and_a_failure_is_reported(monkeypatch, capsys):
    monkeypatch.setattr(machine, "STEPS", {
        "relax": ("convert absent.npz a.npz", "convert never.npz b.npz"), "sweep": ("help", "--version"),
        "twist": ("--version",)})
    assert main(["warm", "relax", "sweep", "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert set(found["seconds"]) == {"relax", "sweep"} and set(found["failed"]) == {"relax"}
    assert "absent.npz" in found["failed"]["relax"]
    assert main(["warm", "twist"]) == 0
    assert "twist" in capsys.readouterr().out


def test_a_command_without_kernels_is_refused(capsys):
    assert main(["warm", "convert"]) == 2
    assert "'convert' has no kernels" in capsys.readouterr().err


@pytest.mark.slow
def test_kernels_are_kept(tmp_path):
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "TI_OFFLINE_CACHE_FILE_PATH": str(tmp_path / "kernels")}
    kept, seconds = [], []
    for _ in range(2):
        began = time.monotonic()
        subprocess.run([sys.executable, "-m", "doo_ti", "warm", "relax", "twist"], cwd=tmp_path, env=environment, check=True)
        seconds.append(time.monotonic() - began)
        kept.append(sorted(path.name for path in (tmp_path / "kernels").glob("*.tic")))
    assert len(kept[0]) > 2 and kept[0] == kept[1]
    print(f"{seconds[0]:.0f} s, then {seconds[1]:.0f} s")
