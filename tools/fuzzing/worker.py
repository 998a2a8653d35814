"""A process that runs cases one after another, without further processes.

    python -m tools.fuzzing.worker FOLDER SEED IN OUT

FOLDER holds ``corpus``, ``home`` and ``temporary``, the last two empty. The numbers of cases are read line by line from the
file descriptor IN; a line of JSON with the description of each case is written to OUT before it, one with its result after it.
"""

import json
import os
import random
import re
import shutil
import sys
import traceback
from contextlib import contextmanager
from pathlib import Path
from time import monotonic

from doo_ti.learning.summary import SEAL
from tools.fuzzing.commands import PATHS, RECIPES
from tools.fuzzing.files import STRUCTURED, spoil
from tools.fuzzing.options import spoilt

PROGRESS = re.compile(r"━|\d+/\d+ \w+ .*:")
"""Of the bar that some commands leave on the standard error."""
WARNING = "doo-ti: warning: "
"""Of lines that may come before any end."""
OPTIONS_SHARE, TWICE_SHARE, UNSEALED_SHARE = 0.3, 0.3, 0.5
"""Of cases, where the options are changed; of changed values, where another change follows; of runs, whose sums are left
out."""
SELDOM_READ = {"landscape.png": 0.1, "run.rrd": 0.1, "truth.npz": 0.3, "identity.txt": 0.3}
"""Files that few commands look at, and how often they are changed beside the others."""
WRITTEN_BESIDE = {"refine": ("refined.png",)}
"""Files that commands document to write into the run that they read."""


def main() -> None:
    folder, seed, inward, outward = Path(sys.argv[1]).resolve(), sys.argv[2], int(sys.argv[3]), int(sys.argv[4])
    with os.fdopen(inward) as numbers, os.fdopen(outward, "w", buffering=1) as results:
        for line in numbers:
            case = folder / "case"
            shutil.rmtree(case, ignore_errors=True)
            case.mkdir()
            os.chdir(case)
            about = prepare(folder / "corpus", seed, int(line))
            print(json.dumps(about), file=results)
            print(json.dumps(about | run(about, folder)), file=results)


def prepare(corpus: Path, seed: str, number: int) -> dict:
    """Put the files of a case into the working directory; returns its description, which follows from seed and number."""
    chance = random.Random(f"{seed} {number}")
    usable = [recipe for recipe in RECIPES if all((corpus / name).exists() for name in recipe.names)]
    recipe = chance.choices(usable, [recipe.weight for recipe in usable])[0]
    words = list(recipe.words)
    for name in sorted(recipe.names, key=len):
        place = Path("out/run" if name == recipe.held else name)
        place.parent.mkdir(parents=True, exist_ok=True)
        if (corpus / name).is_dir():
            shutil.copytree(corpus / name, place, dirs_exist_ok=True)
        elif not place.exists():
            shutil.copyfile(corpus / name, place)
    for summary in Path().rglob("summary.json"):
        if chance.random() < UNSEALED_SHARE:
            _unseal(summary)
    targets = sorted(path for path in Path().rglob("*") if path.is_file())
    if chance.random() < OPTIONS_SHARE or not targets:
        words, described = spoilt(words, chance)
        shape, kind, target = "options", "options", recipe.words[0]
    else:
        path = chance.choices(targets, [SELDOM_READ.get(each.name, 1.0) for each in targets])[0]
        shape, target = path.suffix, str(path)
        kind, described = spoil(path, corpus, chance)
        if kind == "values" and path.suffix in STRUCTURED and chance.random() < TWICE_SHARE:
            described += "; " + spoil(path, corpus, chance)[1]
    return {
        "number": number,
        "words": words,
        "recipe": " ".join(recipe.words),
        "format": shape,
        "kind": kind,
        "target": target,
        "change": described,
    }


def _unseal(path: Path) -> None:
    """Remove the digests from a summary, as in those of older versions, so that more of a changed run is read."""
    summary = json.loads(path.read_text())
    for key in ("files", SEAL):
        summary.pop(key, None)
    path.write_text(json.dumps(summary))


def run(about: dict, folder: Path) -> dict:
    """Run the command in the working directory; returns exit code, seconds, peak memory, and the problem, if any."""
    from doo_ti.__main__ import main as command

    before, began = _everything(folder), monotonic()
    sys.argv, failure, code = ["doo-ti", *about["words"]], "", None
    with open("/proc/self/clear_refs", "w") as peak:
        peak.write("5")
    with _captured(folder) as captured:
        try:
            code = command()
        except BaseException as error:
            failure = _where(error)
    seconds, (out, err), after = monotonic() - began, captured, _everything(folder)
    written = {name for name in before.keys() | after.keys() if before.get(name) != after.get(name)}
    outside = [name for name in sorted(written) if not _asked_for(name, about["words"], name in before)]
    problem = failure or judged(code, out, err, "--json" in about["words"] and "--help" not in about["words"])
    if not problem and outside:
        problem = f"written outside --out: {outside[0]}"
    if not problem and code == 2 and written:
        problem = f"written though refused: {sorted(written)[0]}"
    left = [name for name in after if name.endswith(".part")]
    if not problem and left:
        problem = f"left over: {left[0]}"
    return {
        "code": code,
        "seconds": round(seconds, 3),
        "memory": _peak(),
        "problem": problem,
        "err": err[-2000:],
        "out": out[-300:],
    }


def _asked_for(name: str, words: list[str], there: bool) -> bool:
    """Whether the command line asks for a file that was written; ``there``: it existed before, in the folder ``out`` or as an
    input."""
    name = name.removeprefix("case/")
    if name == "out" or name.startswith("out/") or Path(name).name in WRITTEN_BESIDE.get(words[0], ()):
        return True
    outputs = [os.path.normpath(word) for option, word in zip(words, words[1:]) if option in PATHS or words[0] == "convert"]
    return not there and any(
        f"{name}/".startswith(f"{place}/")
        or place.startswith(f"{name}/")
        or Path(name).with_suffix("") == Path(place).with_suffix("")
        for place in outputs
    )


def judged(code: int | None, out: str, err: str, as_json: bool) -> str:
    """The problem with the end of a command; empty where there is none."""
    lines = [line for line in err.splitlines() if not PROGRESS.search(line) and not line.startswith(WARNING)]
    ours = [line for line in lines if line.startswith("doo-ti: ")]
    if "Traceback" in err:
        return "traceback: " + lines[-1][:200]
    if code not in (0, 1, 2):
        return f"exit code {code}"
    if len(lines) > len(ours):
        other = next(line for line in lines if line not in ours)
        return f"another line on stderr at exit {code}: {re.sub(r'[0-9]+', 'N', other)[:120]}"
    if len(ours) != {0: 0, 1: min(len(ours), 1), 2: 1}[code] or code == 1 and not (ours or out):
        return f"{len(ours)} lines at exit {code}"
    if code == 2 and out:
        return "something on stdout though refused"
    if code == 2 and "; " not in err:
        return "no remedy in the line"
    if not (out + err).replace("\n", "").isprintable():
        return "control characters are printed"
    if as_json and code == 0 and out:
        try:
            json.loads(out, parse_constant=lambda word: 1 / 0)
        except (ValueError, ZeroDivisionError):
            return "no strict JSON"
    return ""


def _where(error: BaseException) -> str:
    """An exception that came up through the command, and the last line of the package in it."""
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if "/doo_ti/" in frame.filename]
    place = f"{frames[-1].filename.rpartition('/doo_ti/')[2]}:{frames[-1].lineno} {frames[-1].name}" if frames else "?"
    return f"traceback: {type(error).__name__} in {place}: {' '.join(str(error).split())[:160]}"


@contextmanager
def _captured(folder: Path):
    """What the process writes to its standard output and error inside, by whichever way, as a list of two texts."""
    kept, found = [os.dup(1), os.dup(2)], []
    files = [open(folder / name, "w+b") for name in ("stdout", "stderr")]
    for number, file in enumerate(files, 1):
        os.dup2(file.fileno(), number)
    try:
        yield found
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        for number, (before, file) in enumerate(zip(kept, files, strict=True), 1):
            os.dup2(before, number)
            os.close(before)
            file.seek(0)
            found.append(file.read().decode(errors="replace"))
            file.close()


def _everything(folder: Path) -> dict[str, object]:
    """Kind, size and time of each file in the working directory, at home and among the temporary files."""
    found = {}
    for part in ("case", "home", "temporary"):
        for root, folders, files in os.walk(folder / part):
            for name in (*folders, *files):
                path = os.path.join(root, name)
                stat = os.lstat(path)
                found[os.path.relpath(path, folder)] = (
                    (stat.st_mode, stat.st_size, stat.st_mtime_ns) if name in files else stat.st_mode
                )
    return found


def _peak() -> int:
    """Bytes held at most since the case began."""
    found = re.search(r"VmHWM:\s+(\d+) kB", Path("/proc/self/status").read_text())
    return 1024 * int(found[1])


if __name__ == "__main__":
    main()
