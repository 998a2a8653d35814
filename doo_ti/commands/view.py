"""A recording in the viewer."""

import os
import sys
from argparse import Namespace
from pathlib import Path

from doo_ti.errors import InputError, InterruptedRunError
from doo_ti.learning.summary import SUMMARY, changed_files, read_summary

RECORDING = "run.rrd"


def declare(add) -> None:
    parser = add("view", allow_abbrev=False, help="open a run's recording in the rerun viewer")
    parser.add_argument("recording", metavar="RUN", help="folder of a run, or an .rrd file")
    parser.set_defaults(run=run)


def run(options: Namespace, words: list[str]) -> int:
    """Open the rerun viewer on a run."""
    path = Path(options.recording)
    if not path.exists() or (path.is_file() and path.suffix != ".rrd"):
        problem = "not a recording" if path.exists() else "no such file or directory"
        raise InputError(path, "run", problem, "name the folder of a run, or an .rrd file")
    if (path / SUMMARY).is_file() and changed_files(path, read_summary(path), (RECORDING,)):
        raise InputError(path / RECORDING, "file", "gone, or not what the sweep wrote", "run the sweep again: it is made anew")
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise InterruptedRunError("view: there is no display here; tools/screenshot.py saves a picture without one")
    from doo_ti.record import open_viewer

    open_viewer(path)
    return 0
