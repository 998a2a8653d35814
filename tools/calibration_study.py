"""Coverage of the 95 % intervals of the default pipeline: ``python tools/calibration_study.py [OPTION ...]``.

Draws specimens of the virtual lab with all parameters random, fits each with ``doo-ti sweep`` and ``doo-ti refine
RUN``, and prints a Markdown table of coverage, bias and width for bend, twist and their ratio. FOLDER/calibration_….png shows
every interval over the truth. Exit code 1 where a coverage is outside 90–99 % or a fit failed.

Rows go to FOLDER/specimens.csv. Rows that are already there, failed ones included, are not computed again: after a change of
the estimator use another folder, or delete them.

    --observations 10   keeps as many of the 60, chosen at random
    --missing 0.2       makes that share of the marks invalid
    --wrong-branch 2    puts that many observations of each specimen on an equilibrium that contradicts their total twist
"""

import argparse
import os
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import partial
from multiprocessing import get_context, parent_process
from pathlib import Path
from threading import Thread

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the commands set it, before NumPy reads it

import numpy as np  # noqa: E402

ROOT = Path(__file__).resolve().parents[1]
if not __package__:
    sys.path.insert(0, str(ROOT))

from doo_ti.system import runtime  # noqa: E402
from doo_ti.system.errors import InputError  # noqa: E402
from doo_ti.system.files import write_whole  # noqa: E402
from doo_ti.system.terminal import progress  # noqa: E402
from tools.calibration.coverage import NAMES, coverage, table  # noqa: E402
from tools.calibration.fit import fitted  # noqa: E402
from tools.calibration.picture import calibration_picture  # noqa: E402
from tools.calibration.rows import Row, load_rows, row_of, save_rows  # noqa: E402
from tools.calibration.specimens import Variant, specimen  # noqa: E402

SEED = 2011
ALL = 60  # observations of a specimen
LISTED = 10  # failures named one by one


def main(words: list[str] | None = None) -> int:
    options = _parsed(words)
    variant = Variant(options.observations, options.missing, options.wrong_branch)
    seeds = range(options.seed, options.seed + options.specimens)
    options.out.mkdir(parents=True, exist_ok=True)
    file = options.out / "specimens.csv"
    try:
        rows = completed(file, seeds, variant, options.workers)
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    picture = options.out / f"calibration_{variant.slug}.png"
    code = report(rows, variant, picture)
    print(f"\nrows in {file}, picture in {picture}")
    return code


def completed(file: Path, seeds: range, variant: Variant, workers: int) -> list[Row]:
    """The row of each seed, from the file where it is there, else computed and added to it at once."""
    known = load_rows(file)
    there = {row.key for row in known}
    todo = [seed for seed in seeds if (seed, variant) not in there]
    if todo:
        with progress(keep=True) as bar, process_pool(min(workers, len(todo))) as pool:
            task = bar.add_task(variant.label, total=len(seeds), completed=len(seeds) - len(todo), unit="specimens")
            futures = [pool.submit(studied, seed, variant) for seed in todo]
            try:
                for future in as_completed(futures):
                    known.append(future.result())
                    save_rows(file, known)
                    bar.advance(task)
            except BaseException:
                pool.shutdown(cancel_futures=True)
                raise
    by_key = {row.key: row for row in known}
    return [by_key[seed, variant] for seed in seeds]


def studied(seed: int, variant: Variant) -> Row:
    """One specimen, made and fitted."""
    made = specimen(seed, variant)
    parameters, failure = [], ""
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        try:
            parameters = fitted(made.observations, Path(folder))
        except Exception as error:  # after any error the other specimens are still fitted
            failure = " ".join(f"{type(error).__name__}: {error}".replace(folder, "").split())
    return row_of(seed, variant, made, parameters, time.perf_counter() - began, failure)


def report(rows: list[Row], variant: Variant, picture: Path) -> int:
    """Print the table and its notes, draw the picture; the exit code."""
    sound, failed = [row for row in rows if not row.failure], [row for row in rows if row.failure]
    intervals = {name: [one for row in sound if (one := row.interval(name)) is not None] for name in NAMES}
    found = {name: coverage(some) for name, some in intervals.items()}
    redrawn = sum(row.redrawn for row in rows)
    print(f"{len(rows)} specimens, seeds {rows[0].seed} … {rows[-1].seed}; {variant.label}; {redrawn} draws could not be "
          f"synthesised and were replaced; 'n of m': n of m such intervals hold the truth\n")
    print(table(found))
    seconds = np.array([row.seconds for row in rows])
    print(f"\nwall time per specimen, sweep and refinement: median {np.median(seconds):.1f} s, largest {seconds.max():.1f} s")
    for row in failed[:LISTED]:
        print(f"failed: seed {row.seed}: {row.failure}")
    if len(failed) > LISTED:
        print(f"and {len(failed) - LISTED} more failed")
    drawn = {name: some for name, some in intervals.items() if some}
    if drawn:
        title = f"95 % intervals of {len(sound)} specimens, {variant.label}"
        write_whole(picture, lambda out: calibration_picture(out, drawn, title=title))
    # A ratio that is not reported does not affect the exit code; bend and twist always do.
    judged = [one for name, one in found.items() if one.all.total or name != "twist_ratio"]
    return int(bool(failed) or not all(one.accepted for one in judged))


def _parsed(words: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--specimens", type=int, default=100, metavar="N", help="how many (default 100)")
    parser.add_argument("--seed", type=int, default=SEED, metavar="S", help=f"of the first; the others follow (default {SEED})")
    parser.add_argument("--observations", type=int, default=ALL, metavar="K", help=f"kept of each specimen (default {ALL})")
    parser.add_argument("--missing", type=float, default=0.0, metavar="SHARE", help="of the marks (default 0)")
    parser.add_argument("--wrong-branch", type=int, default=0, metavar="K", help="observations of each specimen (default 0)")
    parser.add_argument("--workers", type=int, default=1, metavar="N", help="processes that share the processors (default 1)")
    parser.add_argument("--out", type=Path, default=Path("runs/calibration"), metavar="FOLDER", help="default runs/calibration")
    options = parser.parse_args(words)
    for holds, message in (
        (options.specimens >= 1, "--specimens: give 1 or more"), (options.seed >= 0, "--seed: give 0 or more"),
        (1 <= options.observations <= ALL, f"--observations: give 1 to {ALL}"),
        (0 <= options.missing < 1, "--missing: give a share from 0 to below 1"),
        (0 <= options.wrong_branch <= options.observations, "--wrong-branch: give 0 to the number of observations"),
        (options.workers >= 1, "--workers: give 1 or more"),
    ):
        if not holds:
            parser.error(message)
    return options


def process_pool(workers: int) -> ProcessPoolExecutor:
    """Spawned processes, also if it is one: the output of the commands is kept separate from this process's progress."""
    threads = max(1, len(runtime.processors()) // workers)
    return ProcessPoolExecutor(workers, get_context("spawn"), initializer=partial(_start_worker, threads))


def _start_worker(threads: int) -> None:
    """Start Taichi on that many threads; a worker ends with its parent."""
    def end_with_parent() -> None:
        parent_process().join()
        os._exit(1)

    Thread(target=end_with_parent, daemon=True).start()
    runtime.start(threads=threads, pinned=False)


if __name__ == "__main__":
    raise SystemExit(main())
