"""Options that several commands share."""

from argparse import ArgumentParser

from doo_ti.io.scene import CLAMPS, PRECISIONS

SOLVERS = ("newton", "descent")


MATERIAL = ("bend", "bend_1", "bend_2", "twist", "twist_ratio", "weight", "EI", "GJ")
"""What :func:`add_material` adds that says which Θ is meant."""


def add_material(parser: ArgumentParser, form: str) -> None:
    group = parser.add_argument_group("material", f"bend and twist in mm³; {form}")
    group.add_argument("--bend", metavar="A", help="isotropic bend stiffness α")
    group.add_argument("--bend-1", metavar="A1", help="stiffness against bending about m2")
    group.add_argument("--bend-2", metavar="A2", help="stiffness against bending about m1")
    group.add_argument("--twist", metavar="B", help="twist stiffness β")
    group.add_argument("--twist-ratio", metavar="R", help="β over α, or over A1 (default 1)")
    group.add_argument("--weight", metavar="M", help="half the weight per length, relative (default 1)")
    group.add_argument("--EI", metavar="NM2", help="bend stiffness in N m², instead of --bend; with --linear-density")
    group.add_argument("--GJ", metavar="NM2", help="twist stiffness in N m², instead of --twist; with --linear-density")
    group.add_argument("--linear-density", metavar="G_PER_M", help="of the rod in g/m: for --EI, --GJ and results in N m²")


def add_relaxation(parser: ArgumentParser, precision: str | None) -> None:
    parser.add_argument("--clamp-start", choices=CLAMPS, help="default: frame where it is given, else tangent")
    parser.add_argument("--clamp-end", choices=CLAMPS, help="default: frame where it is given, else tangent")
    parser.add_argument("--frame-weight", metavar="MM", help="w_m of Eq. 1 (default 0, or the scene's)")
    parser.add_argument("--up", metavar="X,Y,Z", help="direction against gravity (default: the file's, else 0,0,1)")
    parser.add_argument("--solver", choices=SOLVERS, default="newton")
    parser.add_argument("--precision", choices=PRECISIONS, default=precision,
                        help=f"default {precision or 'the scene' + chr(39) + 's, else mixed'}")
    add_json(parser)


def add_seen_rod(parser: ArgumentParser) -> None:
    """The cameras, and what is known of a rod before it is seen by them."""
    parser.add_argument("--rig", required=True, metavar="RIG", help="cameras: OpenCV FileStorage YAML")
    parser.add_argument("--rest-length", required=True, metavar="MM:COUNT|FILE",
                        help="of the rod's edges: so many of one length, or a .npz with rest_length_mm, or a text of numbers")
    parser.add_argument("--up", metavar="X,Y,Z", help="direction against gravity in the rig's world (default 0,0,1)")


def add_thread(parser: ArgumentParser) -> None:
    """What is known of how the rod looks in images; of a parser or a group of its arguments."""
    parser.add_argument("--polarity", choices=("dark", "light"), help="of the thread (default: whichever stands out)")
    parser.add_argument("--width", metavar="PX", help="of the thread in the images (default: as found)")


def add_json(parser: ArgumentParser) -> None:
    parser.add_argument("--json", action="store_true", help="print a summary for machines")
