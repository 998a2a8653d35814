"""Single flipped bits in the folder of a finished sweep: each must be reported, repaired, or without effect.

    python tools/bit_flips.py [--flips 2000] [--seed 2011]

Positions are drawn evenly over the files of a static and a dynamic run, and evenly in each file. Every command that reads the
file is called. It must refuse the file in one line that names it, or print and write the same as without the flip; a
repeated ``sweep`` may also write the file again, and must print that it does.
"""

import argparse
import os
import random
import re
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import chdir, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

from rerun import bindings

from doo_ti.cli import main as command_line
from doo_ti.learning.summary import changed_files, read_summary

SCENE = """[synthesis]
bend = 4e5
twist = 4e5
end_distances_mm = [42.0, 66.0]
end_rotations_deg = [0.0, 60.0, 120.0]
[grid]
bend = "2e5:8e5:3"
"""
RUNS = ("static", "dynamic")
READERS = {
    ".parquet": ("learn", "figures", "refine", "sweep"), "summary.json": ("learn", "figures", "refine", "view", "sweep"),
    "observations.npz": ("figures", "refine", "sweep"), "pairs.csv": ("figures", "sweep"), "run.rrd": ("view", "sweep"),
    "landscape.png": ("sweep",), "identity.txt": ("sweep",), "plan.json": ("sweep",),
}
"""By the end of a file's name; a command that refuses the file is not run without it."""
COMMANDS = {
    "learn": "learn RUN --json", "figures": "figures RUN --cells 2 --out out", "view": "view RUN",
    "refine": "refine RUN --no-models --clip 0 --clamps exact --rest-curvature none --parameters bend --json",
    "sweep": "sweep o.npz --bend 2e5:8e5:3 --objective RUN --out RUN",
}
NAMED, REMADE, HARMLESS, UNNOTICED = "named", "made again", "without effect", "UNNOTICED"
VERDICTS = NAMED, REMADE, HARMLESS, UNNOTICED


@dataclass(frozen=True)
class Flip:
    """A bit of the byte at ``place`` of a file in the folder of ``run``."""

    run: str
    file: str
    place: int
    bit: int


def called(command: str, run: str) -> tuple[int, str, str]:
    """Exit code, standard output and standard error of a command on ``run``, in this process."""
    out, err = StringIO(), StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        code = command_line([run if word == "RUN" else word for word in COMMANDS[command].split()])
    return code, out.getvalue(), err.getvalue()


def contents(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def restore(folder: Path, whole: dict[str, bytes]) -> None:
    """Have ``folder`` hold the files ``whole`` again, and no others."""
    now = contents(folder)
    for name in now.keys() - whole.keys():
        (folder / name).unlink()
    for name, content in whole.items():
        if now.get(name) != content:
            (folder / name).write_bytes(content)


class Laboratory:
    """Finished runs in the current folder, and what their readers print and write when nothing is flipped."""

    def __init__(self, runs: tuple[str, ...] = RUNS):
        Path("scene.toml").write_text(SCENE)
        command_line(["synth", "scene.toml", "--out", "o.npz"])
        for run in runs:
            code, _, err = called("sweep", run)
            if code:
                raise SystemExit(err)
        self.whole = {run: contents(Path(run)) for run in runs}
        self._expected: dict[tuple[str, str], tuple] = {}

    def drawn(self, count: int, seed: int) -> Iterator[Flip]:
        """``count`` flips, file by file in turn, as the seed says."""
        chance = random.Random(seed)
        files = [(run, name) for run, files in self.whole.items() for name in files]
        for index in range(count):
            run, name = files[index % len(files)]
            yield Flip(run, name, chance.randrange(len(self.whole[run][name])), chance.randrange(8))

    def judged(self, flip: Flip) -> dict[str, str]:
        """The reaction of each reader of the file to the flip."""
        readers = next(commands for end, commands in READERS.items() if flip.file.endswith(end))
        # refine does not read runs under Eq. 3.
        return {reader: self._verdict(reader, flip) for reader in readers if (reader, flip.run) != ("refine", "dynamic")}

    def _undisturbed(self, reader: str, run: str) -> tuple:
        if (reader, run) not in self._expected:
            self._expected[reader, run] = self._read(reader, run)
            restore(Path(run), self.whole[run])
        return self._expected[reader, run]

    def _read(self, reader: str, run: str) -> tuple:
        """The output, without seconds and memory, and the picture of figures."""
        restore(Path("out"), {})
        code, out, err = called(reader, run)
        lines = [line for line in out.splitlines() if not re.search(r" s\)?$| MB of memory", line)]
        return code, lines, err, contents(Path("out")).get("landscapes.png")

    def _verdict(self, reader: str, flip: Flip) -> str:
        folder, whole = Path(flip.run), self.whole[flip.run]
        flipped = bytearray(whole[flip.file])
        flipped[flip.place] ^= 1 << flip.bit
        (folder / flip.file).write_bytes(flipped)
        code, lines, err, _ = found = self._read(reader, flip.run)
        now, made_again = contents(folder), next((line for line in lines if line.startswith("  made again  ")), "")
        sealed = code or reader != "sweep" or not changed_files(folder, read_summary(folder))
        restore(folder, whole)
        if code == 2 and err.count("\n") == 1 and (Path(flip.file).name in err or flip.file.endswith("identity.txt")):
            return NAMED
        if now == whole | {flip.file: bytes(flipped)} and found == self._undisturbed(reader, flip.run):
            return HARMLESS
        same = {name for name in whole if now.get(name) == whole[name]}
        if code == 0 and sealed and Path(flip.file).name in made_again and now.keys() == whole.keys() \
                and same >= whole.keys() - {"run.rrd", "summary.json"}:
            return REMADE
        return UNNOTICED


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--flips", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=2011)
    options = parser.parse_args()
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):  # view must not open a window where the recording is intact
        os.environ.pop(name, None)
    counts: Counter = Counter()
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        laboratory, began = Laboratory(), time.monotonic()
        for done, flip in enumerate(laboratory.drawn(options.flips, options.seed), 1):
            file = "cells" if flip.file.endswith(".parquet") else Path(flip.file).name
            for reader, verdict in laboratory.judged(flip).items():
                counts[file, reader, verdict] += 1
                if verdict == UNNOTICED:
                    print(f"unnoticed by {reader}: {flip}", flush=True)
            if done % 50 == 0:
                bindings.flush_and_cleanup_orphaned_recordings()  # rerun keeps the threads of each recording until this call
                rate = done / (time.monotonic() - began)
                print(f"{done} of {options.flips} flips, {rate:.1f} a second, "
                      f"{(options.flips - done) / rate / 60:.1f} min left", file=sys.stderr)
    print(f"| file | reader | {' | '.join(VERDICTS)} |\n|---|---|{'--:|' * len(VERDICTS)}")
    for file, reader in dict.fromkeys((file, reader) for file, reader, _ in sorted(counts)):
        print(f"| {file} | {reader} | {' | '.join(str(counts[file, reader, verdict]) for verdict in VERDICTS)} |")
    return 1 if any(verdict == UNNOTICED for _, _, verdict in counts) else 0


if __name__ == "__main__":
    sys.exit(main())
