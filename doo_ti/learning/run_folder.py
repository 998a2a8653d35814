"""The folder of a run: whose it is, its cells chunk by chunk, where its numbers come from, and the experiment itself.

    RUN/observations.npz, RUN/pairs.csv   what was observed, and the pairs of Eq. 3
    RUN/hypotheses/*.parquet              a row for each hypothesis, where there are several, until they are resolved
    RUN/cells/*.parquet                   one row per cell and observation, or pair

A chunk's file is written whole or not at all, so a sweep that was stopped finds what it had.
"""

import hashlib
import json
import os
import platform
import time
from contextlib import suppress
from dataclasses import fields, replace
from importlib.metadata import version
from pathlib import Path

import numpy as np

from doo_ti import __version__
from doo_ti.dataset import load_observations, save_observations
from doo_ti.errors import InputError
from doo_ti.grid import Grid
from doo_ti.learning.experiment import Experiment, SweepOptions
from doo_ti.learning.hypotheses import Hypotheses
from doo_ti.learning.pairs import load_pairs, save_pairs
from doo_ti.learning.summary import read_summary
from doo_ti.types import Clamp
from doo_ti.whole_file import remove_leftovers, write_whole

OBSERVATIONS, PAIRS, IDENTITY = "observations.npz", "pairs.csv", "identity.txt"


def identity_of(experiment: Experiment, *more) -> str:
    """sha256 of everything the cells depend on."""
    digest = hashlib.sha256()
    for content in (experiment.observations, experiment.pairs, experiment.hypotheses):
        for field in () if content is None else fields(content):
            value = getattr(content, field.name)
            if isinstance(value, np.ndarray):
                digest.update(field.name.encode() + str(value.shape).encode() + np.ascontiguousarray(value).tobytes())
    digest.update(json.dumps([experiment.grid.as_dict(), experiment.options.as_dict(), *more]).encode())
    return digest.hexdigest()


def claim(run: Path, identity: str, experiment: Experiment) -> None:
    """Make the folder this sweep's, or raise InputError where it holds another one's cells; of sweeps that begin at one moment
    one gets it. What killed processes left half written goes."""
    path = run / "cells" / IDENTITY
    for folder in (run, path.parent, run / "hypotheses"):
        remove_leftovers(folder)
    if not path.exists():
        if not _is_free(run) and not path.exists():  # looked at again: another process may have claimed and filled it
            raise InputError(run, "--out", "the folder holds something else than a sweep", "name another folder")
        path.parent.mkdir(parents=True, exist_ok=True)
        with suppress(FileExistsError):  # another process was faster: whose the folder is now is seen below
            write_whole(path, lambda file: file.write(f"{identity}\n".encode()), first=True)
    if path.read_bytes().strip() != identity.encode():
        raise InputError(run, "cells", "holds another sweep (other observations, grid or options)",
                         "name another folder with --out, or delete this one")
    if not (run / OBSERVATIONS).exists():
        save_observations(run / OBSERVATIONS, experiment.observations)
    if experiment.pairs is not None and not (run / PAIRS).exists():
        save_pairs(run / PAIRS, experiment.pairs)


def _is_free(run: Path) -> bool:
    """Whether a folder holds nothing but what a claim leaves that came to no end."""
    cells = run / "cells"
    return all(path == cells for path in _inside(run)) and all(path.name.startswith(f".{IDENTITY}.") for path in _inside(cells))


def _inside(folder: Path) -> list[Path]:
    return list(folder.iterdir()) if folder.exists() else []


def finished(run: Path, identity: str) -> dict | None:
    """The summary of a sweep that was finished before, or None."""
    path = run / "summary.json"
    if not (path.exists() and (run / "run.rrd").exists()):
        return None
    try:
        summary = json.loads(path.read_text(encoding="utf-8"))
        return summary if summary["provenance"]["sweep_sha256"] == identity else None
    except (ValueError, KeyError, TypeError, RecursionError):  # damaged: it is made again from the cells
        return None


def read_experiment(run: Path) -> Experiment:
    """The experiment of a finished sweep, from its folder alone: with each observation's resolved hypothesis, so that its
    cells come out as they are stored. Raises InputError where the folder holds none."""
    path, summary = Path(run) / "summary.json", read_summary(run)
    try:
        told = summary["provenance"]
        options = SweepOptions.from_dict(told["options"])
        options = replace(options, seed=told["seed"])
        kept = summary["hypotheses"]
        hypotheses = None if kept is None else Hypotheses.from_dict(kept["kept"])
        material, digest = summary["material"], told["input_sha256"]
    except InputError as error:
        raise InputError(path, error.field, "is none that a sweep can have", "run the sweep again") from None
    except (ValueError, KeyError, TypeError, AttributeError):
        raise InputError(path, "file", "does not describe a sweep", "run the sweep again") from None
    observations = replace(load_observations(Path(run) / OBSERVATIONS), name=material, sha256=digest)
    pairs = load_pairs(Path(run) / PAIRS, observations) if options.objective == "dynamic" else None
    return Experiment(observations, Grid.from_dict(summary.get("grid"), str(path)), options, pairs, hypotheses)


def provenance(experiment: Experiment, identity: str, command) -> dict:
    """What a reader needs to get the same numbers again."""
    packages = ("taichi", "numpy", "rerun-sdk", "pyarrow")
    observations, clamps = experiment.observations, experiment.clamps
    return {
        "command": list(command),
        "input": Path(observations.source).name,
        "input_sha256": observations.sha256,
        "sweep_sha256": identity,
        "seed": experiment.options.seed,
        "options": {**experiment.options.as_dict(), "clamp_start": Clamp(clamps.start).name.lower(),
                    "clamp_end": Clamp(clamps.end).name.lower(), "up": observations.up.tolist()},
        "versions": {"doo_ti": __version__, "python": platform.python_version(), **{name: version(name) for name in packages}},
        "machine": f"{platform.system()} {platform.machine()}, {os.cpu_count()} processors",
        "finished": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
    }
