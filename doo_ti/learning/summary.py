"""Provenance of a run: the maker of its cells, and summary.json.

The maker is the code that computes cells: this package's version, the sources that cells depend on, and Taichi. A run has one
maker: cells of several makers would differ, and a reader could not distinguish them.
"""

import hashlib
import json
from functools import cache
from importlib.metadata import version
from pathlib import Path

from doo_ti import __version__
from doo_ti.system.errors import InputError
from doo_ti.system.files import MOST_TEXT_BYTES, read_content

SOURCES = ("contact", "motion", "physics", "relaxation", "rod", "system/runtime.py", "learning/cells.py",
           "learning/experiment.py", "learning/hypotheses.py", "learning/pairs.py")
"""Files and folders of the package that cells depend on."""
SUMMARY = "summary.json"
DENSITY = "linear_density_g_per_m"
"""Key of the summary: the rod's linear density, where it was given."""


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


def read_summary(run: Path) -> dict:
    """The summary of a finished sweep. Raises InputError where the folder holds none."""
    return read_table(Path(run) / SUMMARY)


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
