"""What finished sweeps say about Θ (§III-E)."""

import json
from argparse import Namespace
from pathlib import Path

from doo_ti.commands.arguments import add_json
from doo_ti.commands.printing import best_of, plain, tell_landscape
from doo_ti.errors import InputError
from doo_ti.learning import read_landscape


def declare(add) -> None:
    parser = add("learn", allow_abbrev=False, help="best parameters of finished sweeps over the same grid")
    parser.add_argument("runs", nargs="+", metavar="RUN", help="folders that sweep wrote")
    add_json(parser)
    parser.set_defaults(run=run)


def run(options: Namespace, words: list[str]) -> int:
    """The best Θ of each run, with the ranges that fit nearly as well (§III-E); all runs over one grid."""
    landscapes = [read_landscape(Path(run)) for run in options.runs]
    for landscape in landscapes[1:]:
        if landscape.grid.as_dict() != landscapes[0].grid.as_dict():
            raise InputError(landscape.run, "grid", f"another grid than that of {landscapes[0].run}",
                             "sweep all runs over the same axes")
    if options.json:
        print(json.dumps(plain([best_of(landscape) for landscape in landscapes])))
    else:
        for landscape in landscapes:
            tell_landscape(landscape)
    return 0
