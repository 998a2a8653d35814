"""Rods from images (§IV-A, Alg. 1)."""

import json
from argparse import Namespace
from pathlib import Path

import numpy as np

from doo_ti import options as given
from doo_ti.commands.arguments import add_json, add_material
from doo_ti.commands.printing import counted, plain
from doo_ti.dataset import write_whole
from doo_ti.errors import InputError
from doo_ti.learning import status_counts

MARGIN_PX = 60
"""Of the distance maps around what was detected."""


def declare(add) -> None:
    parser = add("perceive", allow_abbrev=False, help="recover rods from images")
    parser.add_argument("images", nargs="*", metavar="IMAGE", help="one image per camera of the rig, for a single set")
    parser.add_argument("--rig", required=True, metavar="RIG", help="cameras: OpenCV FileStorage YAML")
    parser.add_argument("--sets", metavar="SETS.csv", help="sets of images with their seeds, instead of IMAGEs")
    parser.add_argument("--seed-point", metavar="X,Y,Z", help="v⁰ of a single set, mm")
    parser.add_argument("--seed-direction", metavar="X,Y,Z", help="e⁰ of a single set")
    parser.add_argument("--rest-length", required=True, metavar="MM:COUNT|FILE", help="lengths of the rod's edges")
    parser.add_argument("--out", required=True, metavar="F.npz", help="file to write; pictures and a recording beside it")
    add_material(parser, "one number, --bend also A1,A2 or A1,A2,A12")
    parser.add_argument("--up", metavar="X,Y,Z", help="direction against gravity (default 0,0,1)")
    parser.add_argument("--nu", metavar="NU", help="ν, 1/(mm px²): weight of the images (default 0.005)")
    parser.add_argument("--hypotheses", metavar="H", help="kept for each set and step (default 40)")
    parser.add_argument("--detector", choices=("ridge", "canny"), default="ridge", help="default: ridge, to a fraction of a pixel")
    parser.add_argument("--polarity", choices=("dark", "light"), help="of the thread (default: whichever stands out)")
    parser.add_argument("--width", metavar="PX", help="of the thread in the images (default: as found)")
    add_json(parser)
    parser.set_defaults(run=run)
