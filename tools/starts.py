"""Start many processes of a short command that compiles or loads a kernel, several at once, and count failures.

    python tools/starts.py [--starts 2000] [--together 8]

A start fails if its exit code is not 0, if it prints on standard error, or if its file differs from that of the first.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
COMMAND = "-m doo_ti relax o.npz --bend 4e5 --twist 4e5 --precision f32 --json --out"
MOST_SECONDS = 300


def started(folder: Path, number: int) -> str:
    """The problem of one start, if any, else the content of its file."""
    path = folder / f"{number}.npz"
    done = subprocess.run([sys.executable, *COMMAND.split(), path.name], cwd=folder, capture_output=True, text=True,
                          timeout=MOST_SECONDS, env={**os.environ, "PYTHONPATH": str(ROOT)})
    if done.returncode or done.stderr:
        return f"exit code {done.returncode}: {' '.join(done.stderr.split())}"
    content = path.read_bytes().hex()
    path.unlink()
    return content


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--starts", type=int, default=2000)
    parser.add_argument("--together", type=int, default=8)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder, angle = Path(temporary), np.linspace(0.0, 1.0, 9)
        np.savez(folder / "o.npz", vertices_mm=30.0 * np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=-1)[None])
        expected, found, began = started(folder, 0), Counter(), time.monotonic()
        with ThreadPoolExecutor(options.together) as threads:
            for done, result in enumerate(threads.map(started, [folder] * options.starts, range(options.starts)), 1):
                found["" if result == expected else result[:200]] += 1
                if done % 50 == 0:
                    rate = done / (time.monotonic() - began)
                    print(f"{done} of {options.starts} starts, {rate:.2f} a second, {done - found['']} failed, "
                          f"{(options.starts - done) / rate / 60:.1f} min left", file=sys.stderr)
    failed = options.starts - found[""]
    print(f"{options.starts} starts, {options.together} at once: {failed} failed")
    for reason, count in found.most_common():
        if reason:
            print(f"  {count} x {reason}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
