"""Observations from one format to another."""

from argparse import Namespace

from doo_ti.commands import options as given
from doo_ti.commands.experiment import save
from doo_ti.io.observations import load_observations


def declare(add) -> None:
    parser = add("convert", allow_abbrev=False, help="observations from one format to another")
    parser.add_argument("observations", metavar="IN", help=".npz, .csv or .parquet")
    parser.add_argument("out", metavar="OUT", help=".npz, .csv or .parquet")
    parser.set_defaults(run=run)


def run(options: Namespace, words: list[str]) -> int:
    """Observations from one format to another; keys that are not observations' are left behind."""
    out = given.output_file(options.out, option="OUT")
    given.refuse_overwriting(out, options.observations, "OUT")
    save(out, load_observations(options.observations))
    return 0
