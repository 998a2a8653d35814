"""The folder of a run: whose it is, its cells chunk by chunk, and where its numbers come from.

A chunk's file is written whole or not at all, so a sweep that was stopped finds what it had.
"""

import hashlib
import json
import os
import platform
import time
from dataclasses import fields
from importlib.metadata import version
from pathlib import Path

import numpy as np

from doo_ti import __version__
from doo_ti.dataset import Observations, write_whole
from doo_ti.errors import InputError
from doo_ti.grid import Grid
from doo_ti.types import Clamp, Clamps


def identity_of(observations: Observations, grid: Grid, options, *more) -> str:
    """sha256 of everything the cells depend on."""
    digest = hashlib.sha256()
    for field in fields(observations):
        value = getattr(observations, field.name)
        if isinstance(value, np.ndarray):
            digest.update(field.name.encode() + str(value.shape).encode() + np.ascontiguousarray(value).tobytes())
    digest.update(json.dumps(grid.as_dict()).encode())
    digest.update(repr([options.frame_weight, options.clamp_start, options.clamp_end, options.solver, options.precision,
                        options.objective, *more]).encode())
    return digest.hexdigest()


def claim(run: Path, identity: str) -> None:
    """Make the folder this sweep's, or raise InputError where it holds another one's cells."""
    path = run / "cells" / "identity.txt"
    if path.exists():
        if path.read_text(encoding="utf-8").strip() != identity:
            raise InputError(run, "cells", "holds another sweep (other observations, grid or options)",
                             "name another folder with --out, or delete this one")
        return
    if run.exists() and any(run.iterdir()):
        raise InputError(run, "--out", "the folder holds something else than a sweep", "name another folder")
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, lambda file: file.write(f"{identity}\n".encode()))


def finished(run: Path, identity: str) -> dict | None:
    """The summary of a sweep that was finished before, or None."""
    path = run / "summary.json"
    if not (path.exists() and (run / "run.rrd").exists()):
        return None
    summary = json.loads(path.read_text(encoding="utf-8"))
    return summary if summary["provenance"]["sweep_sha256"] == identity else None


def chunk_path(run: Path, first: int, last: int) -> Path:
    """The file of the cells ``first`` to ``last``."""
    return run / "cells" / f"{first:09d}-{last:09d}.parquet"


def store(path: Path, columns: dict, material: str) -> None:
    """Write the rows of a chunk as Parquet."""
    import pyarrow
    import pyarrow.parquet

    count = len(columns["observation"])
    names = pyarrow.DictionaryArray.from_arrays(np.zeros(count, dtype=np.int8), [material])
    table = pyarrow.table({**columns, "material": names})
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, lambda file: pyarrow.parquet.write_table(table, file))


def provenance(observations: Observations, clamps: Clamps, options, identity: str, command) -> dict:
    """What a reader needs to get the same numbers again."""
    packages = ("taichi", "numpy", "rerun-sdk", "pyarrow")
    return {
        "command": list(command),
        "input": Path(observations.source).name,
        "input_sha256": observations.sha256,
        "sweep_sha256": identity,
        "seed": options.seed,
        "options": {"frame_weight_mm": options.frame_weight, "precision": options.precision,
                    "objective": options.objective, "solver": repr(options.solver), "up": observations.up.tolist(),
                    "clamp_start": Clamp(clamps.start).name.lower(), "clamp_end": Clamp(clamps.end).name.lower()},
        "versions": {"doo_ti": __version__, "python": platform.python_version(), **{name: version(name) for name in packages}},
        "machine": f"{platform.system()} {platform.machine()}, {os.cpu_count()} processors",
        "finished": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
    }
