"""The virtual lab (§V-A)."""

from argparse import Namespace

from doo_ti import options as given
from doo_ti.commands.experiment import observed, save
from doo_ti.scene import load_scene


def declare(add) -> None:
    parser = add("synth", allow_abbrev=False, help="make a scene's observations in the virtual lab")
    parser.add_argument("scene", metavar="SCENE.toml")
    parser.add_argument("--out", required=True, metavar="OBS", help="file to write: .npz, .csv or .parquet")
    parser.set_defaults(run=run)


def run(options: Namespace, words: list[str]) -> int:
    """The observations of a scene to a file."""
    out = given.output_file(options.out)
    save(out, observed(load_scene(options.scene), None))
    return 0
