"""A recording in the viewer."""

import os
import sys
from argparse import Namespace
from pathlib import Path
from tempfile import TemporaryDirectory

from doo_ti import options as given
from doo_ti.commands.printing import busy, theta_text
from doo_ti.errors import InputError, InterruptedRunError
from doo_ti.learning.summary import SUMMARY, changed_files, read_summary

RECORDING, PLAN = "run.rrd", "cells/plan.json"


def declare(add) -> None:
    parser = add("view", allow_abbrev=False, help="open a run's recording in the rerun viewer")
    parser.add_argument("recording", metavar="RUN", help="folder of a run, finished or not, or an .rrd file")
    parser.add_argument("--out", metavar="FOLDER", help="of an unfinished sweep: folder for landscape.png and run.rrd of the "
                                                        "cells so far, instead of a window")
    parser.set_defaults(run=run)


def run(options: Namespace, words: list[str]) -> int:
    """Open the rerun viewer on a run: of a sweep that is not finished, on what is stored of it so far."""
    path = Path(options.recording)
    if not path.exists() or (path.is_file() and path.suffix != ".rrd"):
        problem = "not a recording" if path.exists() else "no such file or directory"
        raise InputError(path, "run", problem, "name the folder of a run, or an .rrd file")
    unfinished = path.is_dir() and not (path / RECORDING).exists() and (path / PLAN).exists()
    if options.out is not None:
        out = given.output_folder(options.out)
        if not unfinished:
            raise InputError(path, "--out", "given, but there is a recording", "leave --out away, or copy the recording")
        if out.resolve().is_relative_to(path.resolve()):
            raise InputError(out, "--out", "is in the run itself, which only the sweep writes", "name another folder")
        _draw_unfinished(path, out)
        print(f"  written to  {out}")
        return 0
    if (path / RECORDING).exists() and (path / SUMMARY).exists() and changed_files(path, read_summary(path), (RECORDING,)):
        raise InputError(path / RECORDING, "file", "not what the sweep wrote", "run the sweep again: it is made anew")
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        instead = "--out FOLDER writes what there is so far" if unfinished else "tools/screenshot.py saves a picture"
        raise InterruptedRunError(f"view: there is no display here; {instead}")
    from doo_ti.record import open_viewer

    if not unfinished:
        open_viewer(path)
        return 0
    with TemporaryDirectory() as folder:
        _draw_unfinished(path, Path(folder))
        open_viewer(folder)
    return 0


def _draw_unfinished(run: Path, folder: Path) -> None:
    """Write the pictures of a sweep so far into ``folder``, and print how far it has come."""
    from doo_ti.learning.drawing import read_unfinished

    with busy("reading cells"):
        found = read_unfinished(run)
    overview = found.overview
    theta = {name: value[0] for name, value in overview.grid.cell_values([overview.best]).items()}
    print(f"{overview.name}: {found.done} stored, the last of them {found.age:,.0f} s ago")
    print(f"  best so far {theta_text(theta | {'bend_12': overview.grid.bend_12}, overview.grid.is_isotropic)}")
    print(f"  distance    mean {overview.mean_distance[overview.best]:.4g} mm (Eq. 1)")
    with busy("drawing"):
        folder.mkdir(parents=True, exist_ok=True)
        found.draw(folder)
