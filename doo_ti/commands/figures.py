"""The paper's landscapes from finished sweeps (Fig. 3, 4, 5)."""

import json
from argparse import Namespace
from pathlib import Path

from doo_ti import options as given
from doo_ti.commands.arguments import add_json
from doo_ti.commands.printing import busy
from doo_ti.terminal import in_line

PARTS = ("end-distance",)
MOST_CELLS = 700
"""A recording of so many cells of 60 rods holds 17 MB of vertices."""


def declare(add) -> None:
    parser = add("figures", allow_abbrev=False, help="landscapes of finished sweeps as pictures and recordings")
    parser.add_argument("runs", nargs="+", metavar="RUN", help="folders that sweep wrote, over one grid")
    parser.add_argument("--out", required=True, metavar="FOLDER", help="folder to write")
    parser.add_argument("--by", choices=PARTS, help="also a landscape for each end distance beside all together")
    parser.add_argument("--cells", metavar="all|N",
                        help=f"cells of the grid to record, evenly spread (default: at most {MOST_CELLS})")
    parser.add_argument("--observation", metavar="N",
                        help="whose ribbon stands for each regime (default: the one where they differ most)")
    add_json(parser)
    parser.set_defaults(run=run)


def run(options: Namespace, words: list[str]) -> int:
    """Pictures of the landscapes, a recording with one step per cell, and for ribbons one of each regime."""
    out = given.output_folder(options.out)
    whole_grid = options.cells == "all"
    most = None if whole_grid else given.whole("--cells", options.cells, 1) or MOST_CELLS
    observation = given.whole("--observation", options.observation, 0)

    from doo_ti.learning import figures as study

    with busy("reading runs"):
        asked = study.read([Path(run) for run in options.runs], by_end_distance=options.by is not None,
                           observation=observation, most_cells=most)
    with busy("drawing landscapes"):
        files = study.draw_landscapes(asked, out)
    files += study.record_cells(asked, out)
    with busy("drawing ribbons"):
        files += study.draw_ribbons(asked, out)
    _tell(options, asked, files)
    return 0


def _tell(options: Namespace, asked, files: list[dict]) -> None:
    """The files, and which cells were recorded where not all were."""
    names, cells, recorded = asked.names, asked.landscapes[0].grid.size, asked.cells.grid.size
    if options.json:
        print(json.dumps({"runs": names, "cells": cells, "recorded_cells": recorded,
                          "recorded_values": asked.recorded_values, "files": files}))
        return
    print(f"{'; '.join(names)}: {cells} cells")
    if recorded < cells:
        parts = ", ".join(f"{count} of {of} values of {name}" for name, (count, of) in asked.recorded_values.items())
        print(f"  recorded    {recorded} cells: {parts}; each run's best cell is among them; --cells all records all")
    for file in files:
        print(f"  written     {in_line(file['path'])} ({file['bytes'] / 1e6:.1f} MB, {file['seconds']:.1f} s)")
