"""Provenance of a run: the maker of its cells, and summary.json, with the sha256 of each file of the folder and of the
summary itself.

The maker is the code that computes cells: this package's version, the sources that cells depend on, and Taichi. A run has one
maker: cells of several makers would differ, and a reader could not distinguish them.
"""

import hashlib
import json
import os
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from importlib.metadata import version
from pathlib import Path

from doo_ti import __version__
from doo_ti.system.errors import InputError
from doo_ti.system.files import MOST_TEXT_BYTES, read_content, write_whole

SOURCES = ("contact", "motion", "physics", "relaxation", "rod", "system/runtime.py", "learning/cells.py",
           "learning/experiment.py", "learning/hypotheses.py", "learning/pairs.py")
"""Files and folders of the package that cells depend on."""
SUMMARY, SEAL = "summary.json", "sha256"
DENSITY = "linear_density_g_per_m"
"""Key of the summary: the rod's linear density, where it was given."""
REMADE = ("landscape.png", "run.rrd", "observations.npz", "pairs.csv", "obstacles.npz")
"""Files that a sweep can write again from its cells and its input."""


@cache
def maker() -> dict[str, str]:
    """Versions, and sha256 of the sources, as JSON holds them."""
    package, digest = Path(__file__).parents[1], hashlib.sha256()
    for source in SOURCES:
        for path in sorted((package / source).rglob("*.py")) or [package / source]:
            digest.update(path.relative_to(package).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return {"doo_ti": __version__, "sources_sha256": digest.hexdigest(), "taichi": version("taichi")}


def maker_text(made: dict[str, str]) -> str:
    """``doo_ti 0.1.0 (sources 1a2b3c4d), taichi 1.7.4``."""
    return f"doo_ti {made['doo_ti']} (sources {made['sources_sha256'][:8]}), taichi {made['taichi']}"


def write_summary(run: Path, summary: dict) -> dict:
    """Write the summary, with the digests of the files that are there now; returns it as it is written."""
    summary = summary | {"files": file_digests(run)}
    summary[SEAL] = _seal(summary)
    text = json.dumps(summary, indent=2) + "\n"
    write_whole(run / SUMMARY, lambda file: file.write(text.encode()))
    return summary


def read_summary(run: Path) -> dict:
    """The summary of a finished sweep. Raises InputError where the folder holds none that can be read, or a changed one."""
    path = Path(run) / SUMMARY
    summary = read_table(path)
    if SEAL in summary and summary[SEAL] != _seal(summary):
        raise InputError(path, "file", "is not what the sweep wrote", "run the sweep again")
    return summary


def read_table(path: Path) -> dict:
    """The JSON object in a file of a sweep. Raises InputError where it holds none."""
    content = read_content(path, MOST_TEXT_BYTES, "name the folder of a finished sweep")
    try:
        table = json.loads(content.decode())
    except (ValueError, RecursionError) as error:
        raise InputError(path, "file", f"not JSON ({error})", "run the sweep again") from None
    if not isinstance(table, dict):
        raise InputError(path, "file", "holds no table", "run the sweep again")
    return table


def sweep_identity(summary: dict) -> str | None:
    """The identity of the sweep that a summary is of; None where it names none."""
    provenance = summary.get("provenance")
    identity = provenance.get("sweep_sha256") if isinstance(provenance, dict) else None
    return identity if isinstance(identity, str) else None


def file_digests(run: Path) -> dict[str, str]:
    """sha256 of each file that belongs to a run, by its path in the folder."""
    names = [name for name in REMADE if (run / name).is_file()]
    return _digests(run, names + [f"cells/{path.name}" for path in sorted((run / "cells").glob("*.parquet"))])


def changed_files(run: Path, summary: dict, names: tuple[str, ...] | None = None) -> list[str]:
    """Those files of a finished run, or those of them called ``names``, that are missing or not what the sweep wrote."""
    digests = summary.get("files")
    written = {name: digest for name, digest in (digests if isinstance(digests, dict) else {}).items()
               if names is None or name in names}
    found = _digests(run, list(written))
    return [name for name, digest in written.items() if found[name] != digest]


def check_cells(run: Path, changed: list[str]) -> None:
    """Raise InputError where cells are among the ``changed`` files of a finished run."""
    for name in changed:
        if name not in REMADE:
            problem, remedy = "gone", "run the sweep again"
            if (run / name).exists():
                problem, remedy = "not what the sweep wrote", "delete it and run the sweep again"
            raise InputError(run / name, "cells", problem, remedy)


def _digests(run: Path, names: list[str]) -> dict[str, str | None]:
    """sha256 of files by their names, None where there is none; they are read on all processors at once."""
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        return dict(zip(names, threads.map(lambda name: _digest(run / name), names), strict=True))


def _digest(path: Path) -> str | None:
    if not os.path.isfile(path):
        return None
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _seal(summary: dict) -> str:
    """sha256 of a summary without itself, whatever the order of its keys."""
    content = {key: value for key, value in summary.items() if key != SEAL}
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
