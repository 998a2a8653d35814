"""What is left when a sweep is killed at a random moment, and resumed: the same tables, byte by byte, or it is told.

    python tools/kill.py [--kills 12] [--seed 2011] [--folder FOLDER]

Sweeps under Eq. 2 and Eq. 3, alone and with two workers, are ended by SIGKILL, SIGTERM and Ctrl-C (SIGINT to all processes of
the command, as a terminal sends it), at a moment drawn evenly over the time that the undisturbed sweep took. The same command
is then repeated, and what it leaves is compared with the undisturbed run.
"""

import argparse
import hashlib
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from itertools import product
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SIGNALS = {"SIGKILL": signal.SIGKILL, "SIGTERM": signal.SIGTERM, "Ctrl-C": signal.SIGINT}
OBJECTIVES, WORKERS = ("static", "dynamic"), (0, 2)
SCENE = """[synthesis]
bend = 4e5
twist = 4e5
end_distances_mm = [42.0, 54.0, 66.0]
end_rotations_deg = [0.0, 60.0, 120.0]
[grid]
bend = "1e5:1e6:120"
twist_ratio = "0.5:2:100"
"""
"""108 000 rods under Eq. 2: several chunks, so that kills fall between them too."""
MOST_SECONDS = 300
MOST_SECONDS_TO_END = 2.0
"""After which a command that ends well has not just been about to."""


@dataclass(frozen=True)
class Kill:
    """Which sweep is killed, by what, and at which share of the time that it takes undisturbed."""

    objective: str
    workers: int
    signal: str
    share: float


def drawn(count: int, seed: int) -> list[Kill]:
    """``count`` kills: every signal on every sweep in turn, in an order and at moments that the seed says."""
    chance = random.Random(seed)
    cases = list(product(OBJECTIVES, WORKERS, SIGNALS))
    chance.shuffle(cases)
    return [Kill(*cases[index % len(cases)], chance.random()) for index in range(count)]


def tables(run: Path) -> dict[str, str]:
    """Name and SHA-256 of every table of a run."""
    return {path.relative_to(run).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
            for path in sorted(run.rglob("*.parquet"))}


def judged(before: dict[str, str], after: dict[str, str], code: int, leftovers: list[str]) -> str:
    """``identical``, or what is wrong with a resumed run: its tables beside the undisturbed ones, its exit code, its files."""
    if code:
        return f"refused to go on (exit code {code})"
    different = sorted(name for name in before.keys() | after.keys() if before.get(name) != after.get(name))
    if different:
        return f"differs: {', '.join(different)}"
    return f"left over: {', '.join(leftovers)}" if leftovers else "identical"


def leftovers(run: Path) -> list[str]:
    """Files that a finished run has no use for."""
    return sorted(path.name for path in run.rglob("*") if path.name.endswith((".part", ".tmp")))


def command(folder: Path, run: Path, objective: str, workers: int) -> list[str]:
    return [sys.executable, "-m", "doo_ti", "sweep", str(folder / "scene.toml"), "--objective", objective, "--out", str(run),
            *(["--workers", str(workers)] if workers else [])]


def started(words: list[str]) -> subprocess.Popen:
    """In a group of processes of its own, so that a signal reaches the workers too and nobody else."""
    return subprocess.Popen(words, env={**os.environ, "PYTHONPATH": str(ROOT)}, stdout=subprocess.DEVNULL,
                            stderr=subprocess.PIPE, text=True, start_new_session=True)


def undisturbed(folder: Path, objective: str, workers: int) -> tuple[dict[str, str], float]:
    """The tables of the whole run, and the seconds that it took."""
    run, began = folder / f"whole_{objective}_{workers}", time.monotonic()
    process = started(command(folder, run, objective, workers))
    message = process.communicate(timeout=MOST_SECONDS)[1]
    if process.returncode:
        raise SystemExit(f"the undisturbed sweep failed: {message}")
    return tables(run), time.monotonic() - began


def killed(folder: Path, run: Path, kill: Kill, seconds: float) -> tuple[int, str]:
    """Exit code of the command that is killed, 0 where it was done before, and what is wrong with what it said."""
    process = started(command(folder, run, kill.objective, kill.workers))
    try:
        process.communicate(timeout=kill.share * seconds)
        return process.returncode, ""
    except subprocess.TimeoutExpired:
        pass
    sent = time.monotonic()
    if kill.signal == "Ctrl-C":
        os.killpg(process.pid, signal.SIGINT)
    else:
        process.send_signal(SIGNALS[kill.signal])
    try:
        message = process.communicate(timeout=60)[1]
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        return process.returncode, "did not end within 60 s"
    if process.returncode == 0 and time.monotonic() - sent > MOST_SECONDS_TO_END:
        return 0, "went on in spite of the signal"
    return process.returncode, "traceback" if "Traceback" in message else ""


def resumed(folder: Path, run: Path, kill: Kill, whole: dict[str, str]) -> str:
    process = started(command(folder, run, kill.objective, kill.workers))
    process.communicate(timeout=MOST_SECONDS)
    return judged(whole, tables(run), process.returncode, leftovers(run))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=12)
    parser.add_argument("--seed", type=int, default=2011)
    parser.add_argument("--folder", type=Path, help="where runs are kept (default: a temporary folder, which goes)")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "scene.toml").write_text(SCENE)
        whole, good = {}, True
        print("| kill | objective | workers | signal | after [s] | exit code | chunks kept | resumed |")
        print("|--:|---|--:|---|--:|--:|--:|---|")
        for number, kill in enumerate(drawn(options.kills, options.seed)):
            case = kill.objective, kill.workers
            if case not in whole:
                whole[case] = undisturbed(folder, *case)
            expected, seconds = whole[case]
            run = folder / f"run{number}"
            code, fault = killed(folder, run, kill, seconds)
            kept = len(tables(run)) if run.exists() else 0
            result = resumed(folder, run, kill, expected)
            good &= result == "identical" and not fault
            print(f"| {number} | {kill.objective} | {kill.workers} | {kill.signal} | {kill.share * seconds:.2f} | {code} | "
                  f"{kept} of {len(expected)} | {'; '.join(filter(None, [fault, result]))} |", flush=True)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
