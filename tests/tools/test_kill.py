"""Sweeps that are killed and resumed: which kills are drawn, how a resumed run is judged, and one round of them."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tools.kill import drawn, judged, leftovers, tables

ROOT = Path(__file__).resolve().parents[2]


def test_kills_follow_the_seed_and_cover_all():
    kills = drawn(24, 3)
    assert kills == drawn(24, 3) != drawn(24, 4)
    cases = [(kill.objective, kill.workers, kill.signal) for kill in kills]
    assert len(set(cases[:12])) == 12 and cases[:12] == cases[12:]
    assert all(0 <= kill.share < 1 for kill in kills) and len({kill.share for kill in kills}) == 24


def test_runs_are_judged_by_their_tables(tmp_path):
    (tmp_path / "cells").mkdir()
    (tmp_path / "cells" / "0-3.parquet").write_bytes(b"rows")
    (tmp_path / "summary.json").write_text("{}")
    whole = tables(tmp_path)
    assert list(whole) == ["cells/0-3.parquet"] and leftovers(tmp_path) == []
    assert judged(whole, dict(whole), 0, []) == "identical"
    (tmp_path / "cells" / "0-3.parquet").write_bytes(b"rovs")
    (tmp_path / ".run.rrd.12ab.part").touch()
    assert "cells/0-3.parquet" in judged(whole, tables(tmp_path), 0, [])
    assert "cells/0-3.parquet" in judged(whole, {}, 0, [])
    assert "12ab" in judged(whole, dict(whole), 0, leftovers(tmp_path))
    assert "2" in judged(whole, dict(whole), 2, [])


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="sends signals as a terminal does")
def test_what_is_killed_is_resumed():
    done = subprocess.run([sys.executable, "tools/kill.py", "--kills", "12"], cwd=ROOT, capture_output=True, text=True,
                          env={**os.environ, "PYTHONPATH": str(ROOT)})
    print(done.stdout)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("identical") == 12
