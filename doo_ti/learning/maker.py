"""What computes cells: this package's version, the sources that cells depend on, and Taichi.

A run is made by one maker: cells of several would differ, and nobody could tell which are whose.
"""

import hashlib
from functools import cache
from importlib.metadata import version
from pathlib import Path

from doo_ti import __version__
from doo_ti.errors import InputError

SOURCES = ("frames.py", "metric.py", "motion", "physics", "relaxation", "runtime.py", "start.py", "types.py",
           "learning/cells.py", "learning/experiment.py", "learning/hypotheses.py", "learning/objective.py",
           "learning/pairs.py")
"""Files and folders of the package: what relaxes rods, compares them and says which."""


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


def as_made(expected: dict[str, str], work, *chunk):
    """``work(*chunk)``, where this process is the ``expected`` maker. Raises InputError where it is another one."""
    if maker() != expected:
        raise other_worker("a worker", maker(), expected)
    return work(*chunk)


def other_worker(name: str, made: dict[str, str], expected: dict[str, str]) -> InputError:
    return InputError("sweep", "workers", f"{name} runs {maker_text(made)}, this process {maker_text(expected)}",
                      "install the same on all, and start the workers anew")
