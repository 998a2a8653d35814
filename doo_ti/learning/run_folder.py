"""The folder of a run: which sweep it belongs to, and the experiment from which its cells can be computed again.

    RUN/observations.npz, RUN/pairs.csv   the observations, and the pairs of Eq. 3
    RUN/obstacles.npz                     what the rods may touch, where there is anything
    RUN/hypotheses/*.parquet              a row for each hypothesis, where there are several, until they are resolved
    RUN/cells/*.parquet                   one row per cell and observation, or pair
    RUN/cells/identity.txt, plan.json     which sweep claimed the folder; its grid and options, for `view` until it is finished

Files are written whole or not at all, so a sweep that was stopped can resume.
"""

import hashlib
import json
import os
import platform
import time
from contextlib import suppress
from dataclasses import fields, replace
from importlib.metadata import distributions
from pathlib import Path

import numpy as np

from doo_ti import __version__
from doo_ti.contact.obstacle_file import load_surroundings, save_surroundings
from doo_ti.io.observation_files import load_observations, save_observations
from doo_ti.learning.chunks import maker, maker_text, read_summary, read_table, sweep_identity
from doo_ti.learning.experiment import Experiment, SweepOptions
from doo_ti.learning.terms import Hypotheses, load_pairs, save_pairs
from doo_ti.rod.grid import Grid
from doo_ti.rod.types import Clamp
from doo_ti.system.errors import InputError
from doo_ti.system.files import MOST_TEXT_BYTES, read_content, remove_leftovers, write_text, write_whole

OBSERVATIONS, PAIRS, OBSTACLES = "observations.npz", "pairs.csv", "obstacles.npz"
IDENTITY, PLAN = "identity.txt", "plan.json"


def identity_of(experiment: Experiment, *more) -> str:
    """sha256 of everything that cells depend on, their maker included."""
    digest = hashlib.sha256()
    for content in (experiment.observations, experiment.pairs, experiment.hypotheses):
        for field in () if content is None else fields(content):
            value = getattr(content, field.name)
            if isinstance(value, np.ndarray):
                digest.update(field.name.encode() + str(value.shape).encode() + np.ascontiguousarray(value).tobytes())
    digest.update(json.dumps([experiment.grid.as_dict(), experiment.options.as_dict(), maker(), *more]).encode())
    return digest.hexdigest()


def claim(run: Path, identity: str, experiment: Experiment) -> None:
    """Claim the folder for this sweep. Raises InputError where it holds another sweep's cells; of sweeps that begin at the same
    time one gets the folder. Partial files of killed processes are removed."""
    path, made = run / "cells" / IDENTITY, maker_text(maker())
    for folder in (run, path.parent, run / "hypotheses"):
        remove_leftovers(folder)
    if not os.path.exists(path):
        others = [other for other in run.rglob("*") if other != path.parent and not (  # than an interrupted claim leaves
            other.parent == path.parent and other.name.startswith(f".{IDENTITY}."))]
        if others and not path.exists():  # checked again: another process may have claimed and filled it
            raise InputError(run, "run", "the folder holds something else than a sweep", "name another folder")
        with suppress(FileExistsError):  # another process was faster: the identity is compared below
            write_whole(path, lambda file: file.write(f"{identity}\n{made}\n".encode()), first=True)
    found, _, by = read_content(path, MOST_TEXT_BYTES, "name another folder").decode(errors="replace").strip().partition("\n")
    if found != identity:
        if by and by != made:
            raise InputError(run, "cells", f"holds cells that {by} made, this is {made}",
                             "resume it with that version, or name another folder")
        raise InputError(run, "cells", "holds another sweep (other observations, grid or options)",
                         "name another folder, or delete this one")
    save_observations(run / OBSERVATIONS, experiment.observations)
    if experiment.pairs is not None:
        save_pairs(run / PAIRS, experiment.pairs)
    if experiment.options.surroundings:
        save_surroundings(run / OBSTACLES, experiment.options.surroundings)
    plan = {"material": experiment.observations.name, "grid": experiment.grid.as_dict(), "hypotheses": None,
            "provenance": {**_inputs(experiment), "sweep_sha256": identity}}
    write_text(path.with_name(PLAN), json.dumps(plan, indent=2) + "\n")


def finished(run: Path, identity: str, chunks: int) -> dict | None:
    """The summary of a sweep of so many ``chunks`` that was finished before, or None where it, a picture or a recording is
    missing: they are written again from the cells."""
    try:
        summary = read_summary(run)
    except InputError:
        return None
    shown = summary.get("shown")
    is_whole = isinstance(shown, list) and all((run / str(name)).is_file() for name in shown) and len(
        list((run / "cells").glob("*.parquet"))) == chunks
    return summary if is_whole and sweep_identity(summary) == identity else None


def read_experiment(run: Path) -> Experiment:
    """The experiment of a finished sweep, from its folder alone, with each observation's resolved hypothesis, so that it gives
    the stored cells again. Raises InputError where the folder holds none."""
    return _experiment(Path(run), Path(run) / "summary.json", read_summary(run))


def read_plan(run: Path) -> tuple[Experiment, str]:
    """The experiment and the identity of a sweep that may not be finished. Raises InputError where the folder holds none."""
    path = Path(run) / "cells" / PLAN
    plan = read_table(path)
    experiment, identity = _experiment(Path(run), path, plan), sweep_identity(plan)
    if identity is None:
        raise InputError(path, "file", "does not describe a sweep", "run the sweep again")
    return experiment, identity


def _experiment(run: Path, path: Path, described: dict) -> Experiment:
    """The experiment that ``path``, a summary or a plan, describes."""
    try:
        inputs, resolution = described["provenance"], described["hypotheses"]
        options = replace(SweepOptions.from_dict(inputs["options"]), seed=inputs["seed"])
        touched = inputs["options"].get("obstacles")
        hypotheses = None if resolution is None else Hypotheses.from_dict(resolution["kept"])
        material, digest = described["material"], inputs["input_sha256"]
        surroundings = None if touched is None else load_surroundings(run / OBSTACLES, touched)
    except InputError as error:
        if error.source == str(run / OBSTACLES):
            raise
        raise InputError(path, error.field, "not a value that a sweep can have", "run the sweep again") from None
    except (ValueError, KeyError, TypeError, AttributeError):
        raise InputError(path, "file", "does not describe a sweep", "run the sweep again") from None
    if surroundings is not None:
        options = replace(options, surroundings=surroundings)
    observations = replace(load_observations(run / OBSERVATIONS), name=material, sha256=digest)
    pairs = load_pairs(run / PAIRS, observations) if options.objective == "dynamic" else None
    return Experiment(observations, Grid.from_dict(described.get("grid"), str(path)), options, pairs, hypotheses)


def _inputs(experiment: Experiment) -> dict:
    """A sweep's input besides its grid, as JSON holds it."""
    observations, clamps = experiment.observations, experiment.clamps
    return {
        "input": Path(observations.source).name,
        "input_sha256": observations.sha256,
        "seed": experiment.options.seed,
        "options": {**experiment.options.as_dict(), "clamp_start": Clamp(clamps.start).name.lower(),
                    "clamp_end": Clamp(clamps.end).name.lower(), "up": observations.up.tolist()},
    }


def provenance(experiment: Experiment, identity: str, command) -> dict:
    """All that is needed to compute the same numbers again, as JSON holds it."""
    packages = {name: next((found.version for found in distributions(name=name)), None)  # rerun-sdk need not be installed
                for name in ("taichi", "numpy", "rerun-sdk", "pyarrow")}
    return {
        "command": list(command),
        **_inputs(experiment),
        "sweep_sha256": identity,
        "maker": maker(),
        "versions": {"doo_ti": __version__, "python": platform.python_version(), **packages},
        "machine": f"{platform.system()} {platform.machine()}, {os.cpu_count()} processors",
        "finished": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
    }
