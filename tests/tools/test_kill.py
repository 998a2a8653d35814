"""Commands that are killed and repeated: the drawn kills, the evaluation of their files, and a few kills."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tools.kill import CASES, ON_CLUSTER, SIGNALS, Kill, disturbed, drawn, faults, judged, kept, prepared

ROOT = Path(__file__).resolve().parents[2]
signals = pytest.mark.skipif(os.name != "posix", reason="sends signals as a terminal does")


def test_kills_follow_the_seed_and_cover_all():
    cases = ["learn", "sweep static, Dask"]
    kills, ways = drawn(18, 3, cases), 2 * len(SIGNALS) + len(ON_CLUSTER)
    assert kills == drawn(18, 3, cases) != drawn(18, 4, cases)
    done = [(kill.case, kill.how) for kill in kills]
    assert len(set(done[:ways])) == ways and done[:ways] == done[ways:]
    assert all(0 <= kill.share < 1 for kill in kills) and len({kill.share for kill in kills}) == 18


def test_runs_are_judged_by_their_files(tmp_path):
    (tmp_path / "cells").mkdir()
    (tmp_path / "cells" / "0-3.parquet").write_bytes(b"rows")
    whole = kept(tmp_path)
    assert list(whole) == ["cells/0-3.parquet"] and judged(whole, dict(whole), 0) == "identical"
    (tmp_path / "cells" / "0-3.parquet").write_bytes(b"rovs")
    (tmp_path / ".run.rrd.12ab.part").touch()
    (tmp_path / "f.png").write_bytes(b"\x89PNG")
    assert judged(whole, kept(tmp_path), 0) == "differs: cells/0-3.parquet; left over: .run.rrd.12ab.part, f.png"
    assert "torn" in kept(tmp_path)["f.png"]
    assert "cells/0-3.parquet" in judged(whole, {}, 0) and "2" in judged(whole, dict(whole), 2)


@pytest.mark.parametrize(("code", "message", "fault"), [
    (1, "x 3/3 cells\ndoo-ti: interrupted; the same command starts from the beginning\n", ""), (1, "doo-ti: interrupted\n", ""),
    (1, "doo-ti: run: sweep stopped (interrupted); finished cells are kept, resume with: doo-ti sweep\n", ""), (-9, "", ""),
    (1, "Traceback (most recent call last):\n", "traceback"), (1, "", "0 lines"),
    (2, "doo-ti: sweep: --dask: no scheduler answers; give one\n", ""), (1, "doo-ti: no\n", "does not say"),
])
def test_the_end_of_a_command_is_judged(code, message, fault):
    found = faults(code, message)
    assert found.startswith(fault) and bool(found) == bool(fault)


@pytest.mark.thorough
@signals
def test_a_terminated_prediction_leaves_nothing_and_says_so(tmp_path):
    prepared(tmp_path, [])
    assert disturbed(Kill("predict", "SIGTERM", 0.6), tmp_path / "run", 1.0, tmp_path)[1] == ""
    assert kept(tmp_path / "run") == {}


@pytest.mark.slow
@signals
def test_killed_and_repeated_commands_equal_undisturbed_ones():
    pytest.importorskip("distributed", reason="no cluster without Dask")
    done = subprocess.run([sys.executable, "tools/kill.py", "--kills", str(len(CASES))], cwd=ROOT, capture_output=True,
                          text=True)
    print(done.stdout)
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"{len(CASES)} of {len(CASES)} identical" in done.stdout
