"""``doo-ti warm`` compiles kernels in processes of their own; ``doo-ti bench``: its table and file."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from doo_ti.commands import machine
from doo_ti.commands.cli import _parser
from doo_ti.commands.machine import percent
from doo_ti.lab import cases
from tests.commands.calls import ended, refused, succeeded


@pytest.mark.parametrize("command", machine.STEPS)
def test_steps_are_valid_commands_that_end_with_their_own(command):
    for step in machine.STEPS[command]:
        _parser().parse_args(step.split())
    assert command in (step.split()[0] for step in machine.STEPS[command])


def test_each_step_is_run_and_a_failure_is_reported(monkeypatch, capsys):
    monkeypatch.setattr(machine, "STEPS", {
        "relax": ("--version", "convert absent.npz a.npz", "convert never.npz b.npz"), "sweep": ("--version",),
        "twist": ("--version",)})
    found = json.loads(ended(capsys, "warm relax sweep --json", 1)[0])
    assert set(found["seconds"]) == {"relax", "sweep"} and set(found["failed"]) == {"relax"}
    assert "absent.npz" in found["failed"]["relax"] and "twist" in succeeded(capsys, ["warm", "twist"])


@pytest.fixture(autouse=True)
def small(monkeypatch):
    monkeypatch.setattr(cases, "ROUND_SECONDS", 0.0)


@pytest.mark.thorough
def test_everything_goes_into_one_table_and_one_file(capsys):
    text, progress = ended(capsys, "bench --rods 64 --rounds 1 --out new/bench")
    assert [path.name for path in Path("new/bench").iterdir()] == ["bench.json"]
    found = json.loads(Path("new/bench/bench.json").read_text(encoding="utf-8"))
    assert len(found["cases"]) == 7
    for name, case in found["cases"].items():
        assert f"\n| {name} " in text and f" {percent(case['busy'])} " in text
    assert found["machine"]["processor"] in text and found["f32_against_f64"]["rods"] == 64
    assert re.search(r"(\d+)/\1 ", progress)


def test_shares_are_rounded_down_and_those_above_all_are_shown():
    shares = {None: "–", 1: "100 %", 0.999999: "99.99 %", 0.5678: "56.78 %", 0.57: "57.00 %", 1.2345: "123.45 %"}
    assert {share: percent(share) for share in shares} == shares


def test_for_machines_it_is_one_object_and_nothing_is_written(capsys, tmp_path, monkeypatch):
    monkeypatch.setattr(cases, "benchmark", lambda rods, rounds, threads: {
        "rods": rods, "rounds": rounds, "threads": threads, "rate": np.float64(np.nan)})
    found = json.loads(succeeded(capsys, "bench --rods 32 --rounds 2 --threads 1 --json"))
    assert found == {"rods": 32, "rounds": 2, "threads": 1, "rate": None} and not list(tmp_path.iterdir())


@pytest.mark.parametrize("words, expected", [
    ("warm convert", ("'convert' has no kernels",)), ("bench --out new --rods 1000000000000", ("--rods", "above")),
    ("bench --out new --threads 100000", ("--threads", "above")),
    ("bench --out new --rounds 1000001", ("--rounds", "above 1000"))])
def test_wrong_options(capsys, tmp_path, words, expected):
    refused(capsys, tmp_path, words, *expected)
