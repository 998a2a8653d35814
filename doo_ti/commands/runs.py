"""Finished sweeps: Θ and how well it fits other observations (``learn``, §III-E, §V-B, §V-C), the landscapes as pictures
(``figures``, Fig. 3, 4, 5), and the recording in the viewer (``view``), of an unfinished sweep too."""

import os
import sys
from argparse import Namespace
from pathlib import Path
from shutil import get_terminal_size
from tempfile import TemporaryDirectory

from doo_ti.commands import given, results
from doo_ti.learning.cross_validation import FACTORS, check_comparable, cross_validate, partition, usual_factors
from doo_ti.learning.landscape import Landscape, read_landscape
from doo_ti.learning.score_table import caption, comma_separated, entries, file_stem, markdown, text
from doo_ti.system.errors import InputError, InterruptedRunError, require
from doo_ti.system.files import write_text
from doo_ti.system.terminal import busy, in_line

RECORDING, PLAN = "run.rrd", "cells/plan.json"
MOST_CELLS = 700  # a recording of so many cells of 60 rods holds 17 MB of vertices


def declare(add) -> None:
    parser = given.command(add, "learn", run_learn,
                           "print the best parameters of finished sweeps over one grid, and leave-one-out tables")
    parser.add_argument("runs", nargs="+", metavar="RUN", help="folders that sweep wrote")
    parser.add_argument("--by", action="append", metavar="FACTORS",
                        help=f"a table by one or more of {', '.join(FACTORS)}, joined by commas; repeat for further tables "
                             "(default: those of the paper that the runs allow)")
    given.add(parser, "--end-distances", "MM,MM", given.NUMBERS, "end distances to compare in tables by end distance (default: "
              "all)")
    given.add(parser, "--out", "FOLDER", given.folder, "folder for learn.json and the tables as .csv and .md (default: not "
              "written)")
    parser = given.command(add, "figures", run_figures, "draw and record the landscapes of finished sweeps")
    parser.add_argument("runs", nargs="+", metavar="RUN", help="folders that sweep wrote, over one grid")
    given.add(parser, "--out", "FOLDER", given.folder, "folder to write", required=True)
    given.add(parser, "--by", None, ("end-distance",), "also draw a landscape for each end distance", dest="by_end_distance")
    parser.add_argument("--cells", metavar="all|N", type=given.either({"all": None}, given.COUNT), default=MOST_CELLS,
                        help=f"how many cells of the grid to record, evenly spread (default: at most {MOST_CELLS})")
    given.add(parser, "--observation", "N", given.FROM_ZERO, "the observation whose ribbon is drawn in each regime (default: "
              "the one where the regimes differ most)")
    parser = given.command(add, "view", run_view, "open a run's recording in the rerun viewer", json=False)
    parser.add_argument("recording", metavar="RUN", help="folder of a run, finished or not, or an .rrd file")
    given.add(parser, "--out", "FOLDER", given.folder, "for an unfinished sweep: folder for landscape.png and run.rrd of the "
              "cells so far, instead of a window")
    shown = parser.add_mutually_exclusive_group()
    shown.add_argument("--web", action="store_true",
                       help="serve the viewer to a browser on this machine until Ctrl-C, instead of opening a window")
    given.add_file(shown, "--screenshot", "FILE.png",
                   "save a picture of the viewer, without a display (needs a Vulkan driver: docs/recording.md)")


def run_learn(options: Namespace) -> int:
    """The best Θ of each run with the ranges that fit nearly as well (§III-E), then leave-one-out tables of all runs."""
    out, distances = options.out, options.end_distances or ()
    asked = [tuple(factor.strip() for factor in by.split(",")) for by in options.by or []]
    with busy("reading runs"):
        landscapes = [read_landscape(Path(run)) for run in options.runs]
    check_comparable(landscapes)
    partitions = {found[0].by: found for found in
                  (partition(landscapes, by, distances) for by in asked or usual_factors(landscapes))}
    if distances and not any("end-distance" in by for by in partitions):
        raise InputError(given.SOURCE, "--end-distances", "no table is by end distance", "add --by end-distance")
    with busy("cross-validating"):
        tables = {by: [cross_validate(one) for one in found] for by, found in partitions.items()}
    every = [scores for found in tables.values() for scores in found]
    summary = {"runs": [_best_of(landscape) for landscape in landscapes], "tables": [{
        "caption": caption(scores), "by": scores.partition.by, "within": scores.partition.within,
        "unlabelled": scores.partition.unlabelled,
        "training_error_mm": dict(zip((part.label for part in scores.partition.parts), scores.training, strict=True)),
        "entries": entries(scores)} for scores in every]}
    if out is not None:
        results.save_json(out / "learn.json", summary)
        for by, found in tables.items():
            write_text(out / f"{file_stem(by)}.csv", comma_separated(found))
            write_text(out / f"{file_stem(by)}.md", "\n".join(markdown(scores) for scores in found))

    def lines() -> list[str]:
        found = [line for landscape in landscapes for line in results.run_lines(landscape.as_dict())]
        found += [f"\n{text(scores, get_terminal_size((120, 24)).columns)}" for scores in every]
        return found if out is None else [*found, f"\nwritten to {in_line(out)}"]

    results.report(options, summary, lines)
    return 0


def _best_of(landscape: Landscape) -> dict:
    """The best Θ of a run, as JSON holds it."""
    result = landscape.as_dict()
    status = result.pop("rods")
    del status["count"]
    return {"run": str(landscape.run), **{name: result[name] for name in ("material", "objective", "jumps") if name in result},
            **result["best"], "intervals": result["intervals_within_5_percent"], "stable": status.pop("stable"),
            "status": status, **landscape.competition}


def run_figures(options: Namespace) -> int:
    """Pictures of the landscapes, a recording with one step per cell, and for ribbons one of each regime."""
    given.require_recorder("figures")
    from doo_ti.learning.figures import draw_landscapes, draw_ribbons, read, record_cells

    with busy("reading runs"):
        study = read([Path(run) for run in options.runs], by_end_distance=options.by_end_distance is not None,
                     observation=options.observation, most_cells=options.cells)
    with busy("drawing landscapes"):
        files = draw_landscapes(study, options.out)
    files += record_cells(study, options.out)
    with busy("drawing ribbons"):
        files += draw_ribbons(study, options.out)
    names, cells, recorded = study.names, study.landscapes[0].grid.size, study.cells.grid.size

    def lines() -> list[str]:
        found = [f"{'; '.join(names)}: {cells} cells"]
        if recorded < cells:
            parts = ", ".join(f"{count} of {of} values of {name}" for name, (count, of) in study.recorded_values.items())
            found.append(f"  recorded    {recorded} cells: {parts}; each run's best cell is included; --cells all records all")
        return found + [f"  written     {in_line(file['path'])} ({file['bytes'] / 1e6:.1f} MB, {file['seconds']:.1f} s)"
                        for file in files]

    results.report(options, {"runs": names, "cells": cells, "recorded_cells": recorded,
                             "recorded_values": study.recorded_values, "files": files}, lines)
    return 0


def run_view(options: Namespace) -> int:
    """Open the rerun viewer on a run, serve it, or save its picture; of an unfinished sweep with the cells stored so far."""
    path = Path(options.recording)
    if not os.path.exists(path) or (os.path.isfile(path) and path.suffix != ".rrd"):
        problem = "not a recording" if os.path.exists(path) else "no such file or directory"
        raise InputError(path, "run", problem, "name the folder of a run, or an .rrd file")
    unfinished = path.is_dir() and not (path / RECORDING).exists() and (path / PLAN).exists()
    out, picture = options.out, options.screenshot
    if out is not None:
        require(unfinished, path, "--out", "given, but there is a recording", "leave --out out, or copy the recording")
        if out.resolve().is_relative_to(path.resolve()):
            raise InputError(out, "--out", "is inside the run, where only the sweep writes", "name another folder")
        _draw_unfinished(path, out)
        print(f"  written to  {in_line(out)}")
        return 0
    given.require_recorder("view")
    if not (options.web or picture) and sys.platform == "linux" and not (
            os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        instead = "--out FOLDER writes the pictures so far" if unfinished else "--screenshot FILE.png saves a picture"
        raise InterruptedRunError(f"view: this machine has no display; --web serves a browser, {instead}")
    if not unfinished:
        return _show(options, path, picture)
    with TemporaryDirectory() as folder:
        _draw_unfinished(path, Path(folder))
        return _show(options, Path(folder), picture)


def _show(options: Namespace, recording: Path, picture: Path | None) -> int:
    """The viewer as the options ask for it."""
    from doo_ti.record.viewer import open_viewer, save_screenshot, serve_viewer

    if picture is not None:
        with busy("drawing"):
            save_screenshot(recording, picture)
        print(f"written to {in_line(picture)}")
    elif options.web:
        serve_viewer(recording, lambda address: print(f"open {address}\nCtrl-C ends", flush=True))
    else:
        open_viewer(recording)
    return 0


def _draw_unfinished(run: Path, folder: Path) -> None:
    """Write the pictures of a sweep so far into ``folder``, and print how far it has come."""
    from doo_ti.learning.sweeps import read_unfinished

    with busy("reading cells"):
        found = read_unfinished(run)
    landscape = found.landscape
    print(f"{in_line(landscape.name)}: {found.done} stored, the last of them {found.age:,.0f} s ago")
    print(f"  best so far {results.theta_text(results.theta_of(landscape.grid, landscape.best), landscape.grid.is_isotropic)}")
    print(f"  distance    mean {landscape.mean_distance[landscape.best]:.4g} mm (Eq. 1)")
    with busy("drawing"):
        found.draw(folder)
