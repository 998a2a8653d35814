"""The default pipeline on one specimen, as a user runs it."""

import io
import json
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

from doo_ti import cli
from doo_ti.io.observation_files import save_observations
from doo_ti.rod.observations import Observations
from doo_ti.system import runtime

GRID = ("--bend", "5e4:1e7:25", "--twist-ratio", "0.1:6:25")


def fitted(observations: Observations, run_folder: Path) -> list[dict]:
    """``parameters`` of ``doo-ti sweep`` followed by ``doo-ti refine RUN --json``: name, value, low, high, unit of each.

    run_folder  an existing folder for the observations and the run

    Raises RuntimeError, with what the command reports, where one fails.
    """
    file, run = run_folder / f"{observations.name}.npz", run_folder / "run"
    save_observations(file, observations)
    _command("sweep", str(file), *GRID, "--out", str(run), "--json")
    return json.loads(_command("refine", str(run), "--no-models", "--json"))[0]["parameters"]


def _command(*words: str) -> str:
    """What ``doo-ti`` prints on standard output."""
    # When it starts, Taichi writes a notice where standard output is replaced: so it starts before.
    runtime.start()
    printed, reported = io.StringIO(), io.StringIO()
    with redirect_stdout(printed), redirect_stderr(reported):
        code = cli.main(words)
    if code:
        lines = reported.getvalue().strip().splitlines() or ["no message"]
        raise RuntimeError(f"doo-ti {words[0]} ended with {code}: {lines[-1]}")
    return printed.getvalue()
