"""Python programs in processes of their own."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def python(*words: object, folder: Path = ROOT, **environment: object) -> subprocess.CompletedProcess:
    """Python with these words, which finds the package; None takes a variable out of its environment."""
    names = {**os.environ, "PYTHONPATH": str(ROOT), **environment}
    return subprocess.run([sys.executable, *map(str, words)], cwd=folder, capture_output=True, text=True, encoding="utf-8",
                          timeout=300, env={name: str(value) for name, value in names.items() if value is not None})
