"""Many starts at once."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.slow
def test_commands_start_however_many_do_at_once():
    done = subprocess.run([sys.executable, "tools/starts.py", "--starts", "80"], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0 and re.findall(r"\d+", done.stdout) == ["80", "8", "0"], done.stdout + done.stderr
