"""Commands killed at a random moment and repeated: the files must be those of an undisturbed run, or be refused.

    python tools/kill.py [--kills 100] [--seed 2011] [--case NAME ...] [--folder FOLDER]

Every long command, sweeps alone, with two workers and on a Dask cluster of two, is ended by SIGKILL, SIGTERM and Ctrl-C (SIGINT
to all processes of the command, as a terminal sends it), at a moment drawn evenly over the time that it takes undisturbed. Of a
cluster also a worker is killed, or the scheduler, or a worker with another version of the package joins. The same command is
then repeated, and its files are compared with those of the undisturbed run.
"""

import argparse
import hashlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path

try:
    from tools.dask_cluster import Cluster, another_version
except ImportError:  # called as a script
    from dask_cluster import Cluster, another_version

ROOT = Path(__file__).resolve().parents[1]
SIGNALS = {"SIGKILL": signal.SIGKILL, "SIGTERM": signal.SIGTERM, "Ctrl-C": signal.SIGINT}
ON_CLUSTER = ("worker killed", "scheduler killed", "other version joins")
LAB = """[synthesis]
bend = 4e5
twist = 4e5
end_distances_mm = {distances}
end_rotations_deg = {rotations}
[grid]
bend = "1e5:1e6:{bends}"
twist_ratio = "0.5:2:{ratios}"
"""
SCENES = {
    "scene": {"distances": [42.0, 54.0, 66.0], "rotations": [0.0, 60.0, 120.0], "bends": 120, "ratios": 100},
    "small": {"distances": [42.0, 54.0, 66.0], "rotations": [0.0, 60.0, 120.0], "bends": 12, "ratios": 10},
    "video": {"distances": [66.0], "rotations": [60.0, 66.0, 72.0, 78.0, 84.0, 90.0], "bends": 2, "ratios": 2},
}
"""``scene`` has 108 000 rods under Eq. 2, half of it 36 000 under Eq. 3: several chunks, for kills between them too."""
MATERIAL = "--bend 4e5 --twist 4e5"
SEEN = f"--rig ../inputs/video/rig.yaml --rest-length 3:33 {MATERIAL}"
SWEEP = "sweep ../inputs/scene.toml --out run"
DYNAMIC = SWEEP + " --objective dynamic --bend 1e5:1e6:60"
CASES = {
    "sweep static": SWEEP, "sweep static, 2 workers": f"{SWEEP} --workers 2", "sweep static, Dask": f"{SWEEP} --dask ADDRESS",
    "sweep dynamic": DYNAMIC, "sweep dynamic, 2 workers": f"{DYNAMIC} --workers 2",
    "sweep dynamic, Dask": f"{DYNAMIC} --dask ADDRESS",
    "learn": "learn ../inputs/run ../inputs/run2 --by end-distance --out tables",
    "refine": "refine ../inputs/run/observations.npz " + MATERIAL + " --out f.json",
    "perceive": f"perceive {SEEN} --sets ../inputs/video/sets.csv --out f.npz",
    "track": f"track {SEEN} --frames ../inputs/video/frames.csv --out f.npz",
    "predict": "predict ../inputs/motion.toml --out f.npz --picture f.png --recording f.rrd",
    "figures": "figures ../inputs/run --by end-distance --out figures",
    "synth": "synth ../inputs/video.toml --out f.npz --images images --rig ../inputs/video/rig.yaml",
}
"""Name and command of each case, given in a folder of its own."""
EARLY = 0.2
MOST_SECONDS = 300
MOST_SECONDS_TO_END = 1.0
"""A command that ends with 0 later than this after a signal has ignored it."""
MOST_SECONDS_ON_CLUSTER = 120
"""For the command to end once its scheduler has been killed, or to continue without a worker."""


@dataclass(frozen=True)
class Kill:
    """Which case is disturbed, by what, and at which share of the time that it takes undisturbed."""

    case: str
    how: str
    share: float


def drawn(count: int, seed: int, cases: list[str]) -> list[Kill]:
    """``count`` kills: every way to end every one of ``cases`` in turn, in an order and at moments that the seed says."""
    chance = random.Random(seed)
    ways = [(case, how) for case in cases for how in (*SIGNALS, *(ON_CLUSTER if "Dask" in case else ()))]
    chance.shuffle(ways)
    return [Kill(*ways[index % len(ways)], chance.random()) for index in range(count)]


def kept(folder: Path) -> dict[str, str]:
    """What must be equal for each file below ``folder``: the sha256 of tables; for pictures and recordings, which contain their
    time, and for a sweep's summary, which contains durations, only that they are intact."""
    whole = {".rrd": _recording, ".png": _picture, ".json": _summary}
    found = {}
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        try:
            found[path.relative_to(folder).as_posix()] = whole.get(path.suffix, _digest)(path)
        except Exception as error:
            found[path.relative_to(folder).as_posix()] = f"torn ({error})"
    return found


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _recording(path: Path) -> str:
    from rerun.chunk import RrdReader

    rows = sum(chunk.to_record_batch().num_rows for chunk in RrdReader(path).stream())
    return f"{rows} rows"


def _picture(path: Path) -> str:
    from matplotlib.image import imread

    return f"picture {imread(path).shape}"


def _summary(path: Path) -> str:
    """The digest of results; of a sweep's summary that its digests hold."""
    content = json.loads(path.read_text())
    if path.name != "summary.json":
        return _digest(path)
    from doo_ti.learning.summary import changed_files, read_summary

    changed = changed_files(path.parent, read_summary(path.parent))
    if changed:
        raise ValueError(f"other digests than of {', '.join(changed)}")
    return json.dumps(content["best"])


def judged(before: dict[str, str], after: dict[str, str], code: int) -> str:
    """``identical``, or the problem of a repeated command: differences from the undisturbed files, or its exit code."""
    if code:
        return f"refused to resume (exit code {code})"
    left = sorted(after.keys() - before.keys())
    different = sorted(name for name in before if before[name] != after.get(name))
    faults = [f"differs: {', '.join(different)}"] * bool(different) + [f"left over: {', '.join(left)}"] * bool(left)
    return "; ".join(faults) or "identical"


def started(case: str, folder: Path, cluster: Cluster | None) -> subprocess.Popen:
    """Start the command in a process group of its own, so that a signal reaches its workers and no other process."""
    folder.mkdir(exist_ok=True)
    words = [cluster.address if word == "ADDRESS" else word for word in CASES[case].split()]
    return subprocess.Popen([sys.executable, "-m", "doo_ti", *words], env={**os.environ, "PYTHONPATH": str(ROOT)}, cwd=folder,
                            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, start_new_session=True)


def finished(case: str, folder: Path) -> tuple[int, str, float]:
    """Exit code and messages of the undisturbed command, and the seconds that it took."""
    with ExitStack() as stack:
        cluster = stack.enter_context(Cluster(ROOT)) if "Dask" in case else None
        began, process = time.monotonic(), started(case, folder, cluster)
        message = process.communicate(timeout=MOST_SECONDS)[1]
        return process.returncode, message, time.monotonic() - began


def undisturbed(case: str, folder: Path) -> tuple[dict[str, str], float]:
    """The files of the whole run, and the seconds that it took."""
    code, message, seconds = finished(case, folder)
    if code:
        raise SystemExit(f"{case} failed undisturbed: {message}")
    return kept(folder), seconds


def disturbed(kill: Kill, folder: Path, seconds: float, other: Path) -> tuple[int, str]:
    """Exit code of the command, and the problem with its end, if any; ``other`` holds another version of the package."""
    with ExitStack() as stack:
        cluster = stack.enter_context(Cluster(ROOT)) if "Dask" in kill.case else None
        process = started(kill.case, folder, cluster)
        try:
            # A worker that joins late is given no work.
            message = process.communicate(timeout=kill.share * seconds * (EARLY if kill.how == ON_CLUSTER[-1] else 1))[1]
            return process.returncode, faults(process.returncode, message)
        except subprocess.TimeoutExpired:
            pass
        sent = time.monotonic()
        _ways(process, cluster, other)[kill.how]()
        try:
            message = process.communicate(timeout=MOST_SECONDS_ON_CLUSTER if kill.how in ON_CLUSTER else 60)[1]
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
            return process.returncode, "did not end"
        if kill.how in SIGNALS and process.returncode == 0 and time.monotonic() - sent > MOST_SECONDS_TO_END:
            return 0, "ignored the signal"
        return process.returncode, faults(process.returncode, message)


def _ways(process: subprocess.Popen, cluster: Cluster | None, other: Path) -> dict[str, Callable]:
    return {"SIGKILL": process.kill, "SIGTERM": process.terminate, "Ctrl-C": partial(os.killpg, process.pid, signal.SIGINT)} | (
        {} if cluster is None else {"worker killed": cluster.kill_worker, "scheduler killed": cluster.kill_scheduler,
                                    "other version joins": partial(cluster.add_worker, other)})


def faults(code: int, message: str) -> str:
    """The problem with the end of a command: more than one line, or a line that neither refuses nor says how to resume."""
    own = [line for line in message.splitlines() if line.startswith("doo-ti: ")]
    if "Traceback" in message:
        return "traceback"
    if code in (0, -signal.SIGKILL, -signal.SIGTERM, -signal.SIGINT):  # done before; or killed while the interpreter starts
        return ""
    if len(own) != 1:
        return f"{len(own)} lines of its own"
    says = code == 2 or own[0] == "doo-ti: interrupted" or any(
        words in own[0] for words in ("resume with", "resumes with", "starts from the"))
    return "" if says else f"does not say how to resume: {own[0]}"


def prepared(folder: Path, cases: list[str]) -> None:
    """Write what the commands read into ``folder``/inputs."""
    inputs = folder / "inputs"
    inputs.mkdir(parents=True)
    for name, values in SCENES.items():
        (inputs / f"{name}.toml").write_text(LAB.format(**values))
    shutil.copy(ROOT / "scenes" / "motion" / "three_materials.toml", inputs / "motion.toml")
    another_version(ROOT / "doo_ti", folder / "other")
    made = [] if all(case.startswith(("sweep", "predict")) for case in cases) else [
        "sweep small.toml --out run", "sweep small.toml --objective dynamic --out run2",
        f"synth video.toml --images video --rig {ROOT / 'scenes' / 'rig.yaml'}"]
    for words in made:
        subprocess.run([sys.executable, "-m", "doo_ti", *words.split()], cwd=inputs, check=True, stdout=sys.stderr,
                       env={**os.environ, "PYTHONPATH": str(ROOT)})
    if made:
        sets = (inputs / "video" / "sets.csv").read_text()
        (inputs / "video" / "frames.csv").write_text(sets.replace("name,", "frame,", 1))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--first", type=int, default=0, help="of them, in the seed's order")
    parser.add_argument("--seed", type=int, default=2011)
    parser.add_argument("--case", action="append", choices=CASES, help="as often as there are to be several (default: all)")
    parser.add_argument("--folder", type=Path, help="a new folder where runs are kept (default: a temporary one, which goes)")
    options = parser.parse_args()
    cases = options.case or list(CASES)
    signal.signal(signal.SIGINT, signal.default_int_handler)  # which a shell has a program in the background ignore
    began, whole, results, good = time.monotonic(), {}, {}, True
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary)
        prepared(folder, cases)
        print("| kill | case | by | after [s] | exit code | files kept | repeated |\n|--:|---|---|--:|--:|--:|---|")
        last = options.first + options.kills
        for number, kill in list(enumerate(drawn(last, options.seed, cases)))[options.first :]:
            if kill.case not in whole:
                whole[kill.case] = undisturbed(kill.case, folder / f"whole{len(whole)}")
            expected, seconds = whole[kill.case]
            run = folder / f"run{number}"
            code, fault = disturbed(kill, run, seconds, folder / "other")
            files = len(kept(run))
            result = "; ".join(filter(None, [fault, judged(expected, *reversed(repeated(kill.case, run)))]))
            good &= result == "identical"
            results.setdefault((kill.case, kill.how), []).append(result)
            print(f"| {number} | {kill.case} | {kill.how} | {kill.share * seconds:.2f} | {code} | {files} of {len(expected)} | "
                  f"{result} |", flush=True)
            print_progress(number + 1 - options.first, options.kills, time.monotonic() - began)
    print_counts(results)
    return 0 if good else 1


def repeated(case: str, run: Path) -> tuple[int, dict[str, str]]:
    """Exit code of the repeated command, and its files."""
    return finished(case, run)[0], kept(run)


def print_progress(done: int, count: int, seconds: float) -> None:
    print(f"{done} of {count} kills, {60 * done / seconds:.1f} a minute, {seconds / done * (count - done) / 60:.1f} min left",
          file=sys.stderr)


def print_counts(results: dict[tuple[str, str], list[str]]) -> None:
    """Print, for each case and way to end it, how many repeated commands were identical to the undisturbed one."""
    cases, ways = (list(dict.fromkeys(key[place] for key in sorted(results))) for place in (0, 1))
    print(f"\n| case | {' | '.join(ways)} |\n|---|{'--:|' * len(ways)}")
    counts = {key: f"{found.count('identical')} of {len(found)}" for key, found in results.items()}
    for case in cases:
        print(f"| {case} | {' | '.join(counts.get((case, how), '–') for how in ways)} |")
    total = [result for found in results.values() for result in found]
    print(f"\n{total.count('identical')} of {len(total)} identical")


if __name__ == "__main__":
    sys.exit(main())
