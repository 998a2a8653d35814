"""Damaged inputs and wrong options for every command, which has to refuse them in one line or to succeed.

    python tools/fuzz.py [--cases 500] [--seed 2011] [--first 0] [--case N] [--folder FOLDER]

A case is a valid command line over small files of every format (tools/fuzzing/corpus.py), with one change: of bytes of a
file, its structure, a value, of the file itself (replaced), or of the options. Cases follow from the seed and their number, so
that ``--case N`` repeats one and prints its description and result. They run in a worker process, one after another; after a
case that hangs or crashes the worker is replaced. Failures:

- an end by a signal, a traceback, an exit code other than 0, 1 and 2; with 2 anything but one line ``doo-ti: …`` on the
  standard error, with 1 more than one such line; lines there that are not the package's;
- more than 60 s (of processor time on a shared machine); more than 4 GB;
- a file written outside ``--out``, or any file where the input is refused; part files left over;
- control characters in the output, invalid JSON.

Exit code 1 if there is any failure. Each result is a line of FOLDER/results.jsonl. Changes of values, structure and options
that were accepted are listed for inspection.
"""

import argparse
import json
import os
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter, defaultdict
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

from tools.fuzzing import corpus  # noqa: E402

MOST_SECONDS, MOST_BYTES = 60.0, 4 << 30
CASES_OF_A_WORKER = 1000
"""Cases after which a worker is replaced, so that memory accumulated over many commands is not counted for one case."""
MOST_AGAIN = 2
"""Cases of one kind of failure that are run again."""
MOST_WAITING = 5
"""On a shared machine a case may take so many times as long, if it uses the processor for so few seconds."""
LOOK_SECONDS = 0.05
START_SECONDS = 120.0
COUNTED = {0: "accepted", 1: "failed in one line", 2: "refused"}


class Worker:
    """The process that runs cases; a new one is started when it has ended."""

    def __init__(self, folder: Path, seed: int):
        self.folder, self.seed, self.process, self.done = folder, seed, None, 0
        self.kernels = os.environ.get("TI_OFFLINE_CACHE_FILE_PATH") or str(
            Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "taichi" / "ticache"
        )

    def start(self) -> None:
        for name in ("home", "temporary"):
            shutil.rmtree(self.folder / name, ignore_errors=True)
            (self.folder / name).mkdir()
        (self.folder / "matplotlib").mkdir(exist_ok=True)
        environment = {
            name: value
            for name, value in os.environ.items()
            if not name.startswith("XDG_") and name not in ("DISPLAY", "WAYLAND_DISPLAY")
        }
        environment |= {
            "HOME": str(self.folder / "home"),
            "TMPDIR": str(self.folder / "temporary"),
            "PYTHONPATH": str(ROOT),
            "TI_OFFLINE_CACHE_FILE_PATH": self.kernels,
            "MPLCONFIGDIR": str(self.folder / "matplotlib"),
            "OPENBLAS_NUM_THREADS": "1",
        }
        inward, self.asked = os.pipe()
        self.results, outward = os.pipe()
        words = [sys.executable, "-m", "tools.fuzzing.worker", str(self.folder), str(self.seed), str(inward), str(outward)]
        with open(self.folder / "worker.log", "wb") as log:
            self.process = subprocess.Popen(
                words,
                cwd=ROOT,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                pass_fds=(inward, outward),
                start_new_session=True,
            )
        os.close(inward)
        os.close(outward)
        self.waiting, self.done = b"", 0

    def stop(self) -> None:
        """End it and whatever processes it started."""
        if self.process is not None:
            try:
                os.killpg(self.process.pid, signal.SIGKILL)
            except ProcessLookupError:
                pass
            self.process.wait()
            os.close(self.asked)
            os.close(self.results)
        self.process = None

    def run(self, number: int) -> dict:
        """Description and result of a case."""
        if self.process is None or self.done >= CASES_OF_A_WORKER:
            self.stop()
            self.start()
        first = self.done == 0
        os.write(self.asked, b"%d\n" % number)
        about, problem = self._line(START_SECONDS)
        if not problem:
            began = time.monotonic()
            # Its first case also imports the package and loads kernels.
            found, problem = self._line(START_SECONDS if first else MOST_SECONDS)
            if not problem:
                self.done += 1
                if found["memory"] > MOST_BYTES:
                    found["problem"] = found["problem"] or f"{found['memory'] / 1e9:.1f} GB"
                return found
            about["seconds"] = time.monotonic() - began
        self.stop()
        return (
            {
                "number": number,
                "code": None,
                "memory": 0,
                "seconds": 0.0,
                "err": "",
                "out": "",
                "recipe": "?",
                "format": "?",
                "kind": "?",
                "target": "?",
                "change": "?",
                "words": [],
            }
            | about
            | {"problem": problem}
        )

    def _line(self, most: float) -> tuple[dict, str]:
        """(The next line that the worker writes, the problem where there is none)."""
        began, used = time.monotonic(), self._processor()
        while b"\n" not in self.waiting:
            if select.select([self.results], [], [], LOOK_SECONDS)[0]:
                more = os.read(self.results, 1 << 16)
                if not more:
                    code = self.process.wait()
                    log = (self.folder / "worker.log").read_text(errors="replace")[-300:]
                    return {}, f"ended by signal {-code}" if code < 0 else f"the worker ended with {code}: {log}"
                self.waiting += more
            elif time.monotonic() - began > most and not 0 < self._processor() - used < most or (
                time.monotonic() - began > MOST_WAITING * most
            ):
                return {}, f"hangs: more than {most:.0f} s"
            elif self._held() > MOST_BYTES:
                return {}, f"more than {MOST_BYTES / 1e9:.1f} GB"
        line, _, self.waiting = self.waiting.partition(b"\n")
        return json.loads(line), ""

    def _processor(self) -> float:
        """Seconds of the processor that the process has had."""
        try:
            words = Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()
        except OSError:
            return 0.0
        return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")

    def _held(self) -> int:
        try:
            pages = Path(f"/proc/{self.process.pid}/statm").read_text().split()[1]
        except (OSError, IndexError):
            return 0
        return int(pages) * os.sysconf("SC_PAGE_SIZE")


def prepared(folder: Path) -> None:
    """Make the corpus there, unless it is there."""
    if not (folder / "corpus").is_dir():
        made = folder / "corpus.part"
        shutil.rmtree(made, ignore_errors=True)
        done = subprocess.run(
            [
                sys.executable,
                "-c",
                "import sys; from pathlib import Path; from tools.fuzzing import corpus; corpus.make(Path(sys.argv[1]))",
                str(made),
            ],
            cwd=ROOT,
            capture_output=True,
            text=True,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
        )
        if done.returncode:
            raise SystemExit(done.stderr)
        made.rename(folder / "corpus")


def campaign(folder: Path, seed: int, numbers: range, verbose: bool = True) -> list[dict]:
    """Results of all cases with these numbers; some that fail are run once more, alone."""
    prepared(folder)
    worker, results, began = Worker(folder, seed), [], time.monotonic()
    shown = began
    try:
        for number in numbers:
            results.append(worker.run(number))
            with open(folder / "results.jsonl", "a", encoding="utf-8") as kept:
                print(json.dumps(results[-1]), file=kept)
            if results[-1]["problem"] and verbose:
                print(
                    f"case {number}: {results[-1]['problem']}\n    doo-ti {' '.join(results[-1]['words'])[:200]}\n    "
                    f"{results[-1]['target']}: {results[-1]['change']}",
                    flush=True,
                )
            if verbose and time.monotonic() - shown > 30:
                shown, rate = time.monotonic(), len(results) / (time.monotonic() - began)
                print(
                    f"{len(results)} of {len(numbers)} cases, {rate:.1f} a second, "
                    f"{(len(numbers) - len(results)) / rate / 60:.0f} min left, "
                    f"{sum(bool(each['problem']) for each in results)} failures",
                    flush=True,
                )
        again = Counter()
        for found in results:
            again[found["problem"]] += 1
            if found["problem"] and again[found["problem"]] <= MOST_AGAIN:
                worker.stop()
                found["alone"] = worker.run(found["number"])["problem"] or "nothing"
    finally:
        worker.stop()
    return results


def report(results: list[dict]) -> str:
    """Tables: cases by command and by format, what was accepted, and what failed."""
    lines = []
    for title, key in (
        ("command", lambda found: found["recipe"].split()[0]),
        ("format", lambda found: found["format"]),
        ("kind", lambda found: found["kind"]),
    ):
        counts = defaultdict(Counter)
        for found in results:
            counts[key(found)][COUNTED.get(found["code"], "crash or hang")] += 1
            counts[key(found)]["failures"] += bool(found["problem"])
        columns = [*COUNTED.values(), "crash or hang", "failures"]
        lines += [f"| {title} | cases | {' | '.join(columns)} |", f"|---|--:|{'--:|' * len(columns)}"]
        for name, count in sorted(counts.items()):
            cases = sum(count.values()) - count["failures"]
            lines.append(f"| {name} | {cases} | {' | '.join(str(count[column]) for column in columns)} |")
        lines.append("")
    lines += _accepted(results)
    slowest = max(results, key=lambda found: found["seconds"])
    largest = max(results, key=lambda found: found["memory"])
    failures = [found for found in results if found["problem"]]
    lines.append(
        f"slowest {slowest['seconds']:.1f} s, case {slowest['number']}; most memory {largest['memory'] / 1e9:.2f} GB, case "
        f"{largest['number']}"
    )
    groups = defaultdict(list)
    for found in failures:
        groups[found["problem"]].append(found)
    for problem, same in sorted(groups.items(), key=lambda group: -len(group[1])):
        alone = Counter("the same" if found.get("alone") == problem else found.get("alone", "not run") for found in same)
        lines.append(
            f"{len(same)} x {problem}: cases {', '.join(str(found['number']) for found in same[:8])}; alone: "
            f"{', '.join(f'{count} x {what}' for what, count in alone.items())}"
        )
    lines.append(f"{len(results)} cases, {len(failures)} failures")
    return "\n".join(lines)


def _accepted(results: list[dict]) -> list[str]:
    """Changes of values, structure and options that were accepted."""
    found = defaultdict(list)
    for each in results:
        if each["code"] == 0 and not each["problem"] and each["kind"] in ("values", "structure", "options"):
            found[(each["recipe"].split()[0], each["target"], each["kind"], each["change"])].append(each["number"])
    lines = ["accepted changes of values, structure and options:"]
    return [
        *lines,
        *(
            f"  {command:<11} {target}: {change}; case{'s' * (len(numbers) > 1)} {', '.join(map(str, numbers[:5]))}"
            for (command, target, _, change), numbers in sorted(found.items())
        ),
        "",
    ]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=500)
    parser.add_argument("--first", type=int, default=0, metavar="N", help="number of the first case (default 0)")
    parser.add_argument("--seed", type=int, default=corpus.SEED)
    parser.add_argument(
        "--case", type=int, metavar="N", help="repeat one case alone and print it; its files stay in FOLDER/case"
    )
    parser.add_argument("--folder", type=Path, help="where everything lies (default: a temporary folder, which goes)")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = (options.folder or Path(temporary)).resolve()
        folder.mkdir(parents=True, exist_ok=True)
        if options.case is None:
            results = campaign(folder, options.seed, range(options.first, options.first + options.cases))
            print(report(results))
        else:
            results = campaign(folder, options.seed, range(options.case, options.case + 1), verbose=False)
            print(json.dumps(results[0], indent=1, ensure_ascii=False))
    return int(any(found["problem"] for found in results))


if __name__ == "__main__":
    sys.exit(main())
