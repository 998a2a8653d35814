"""The command line ``doo-ti``: options to text, commands to exit codes.

0 done; 1 failed while running, what is done is kept; 2 wrong input: one line that names file or option, field and
remedy, and nothing written.
"""

import argparse
import os
import re
import signal
import sys
import threading
from collections.abc import Sequence
from typing import NoReturn

from doo_ti import __version__, commands
from doo_ti.errors import InputError, InterruptedRunError
from doo_ti.scene import CLAMPS, OBJECTIVES, PRECISIONS

SOLVERS = ("newton", "descent")


class _Parser(argparse.ArgumentParser):
    """Reports what argparse finds wrong as an InputError naming the option."""

    def error(self, message: str) -> NoReturn:
        found = re.match(r"argument (?P<option>[^:]+): (?P<problem>.*)", message, re.DOTALL)
        missing = re.match(r"the following arguments are required: (?P<option>[^,]+)", message)
        option = (found or missing)["option"].split("/")[0] if found or missing else "arguments"
        problem = found["problem"] if found else "missing" if missing else message
        raise InputError(self.prog, option, problem, f"see {self.prog} --help")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command that ``argv`` (without the program's name) spells out; returns the exit code."""
    argv = list(sys.argv[1:] if argv is None else argv)
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # a console that lacks Θ shows a question mark
            stream.reconfigure(errors="replace")
    try:
        return _run(argv)
    except InputError as error:
        return _report(error, 2)
    except BrokenPipeError:  # the reader, head or less, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except KeyboardInterrupt:
        return _report("interrupted", 1)
    except (InterruptedRunError, OSError, MemoryError) as error:
        return _report(error, 1)


def _run(argv: list[str]) -> int:
    if threading.current_thread() is threading.main_thread():
        # Being told to end is like Ctrl-C: what is done is kept and the way to go on is printed.
        signal.signal(signal.SIGTERM, signal.default_int_handler)
    parser = _parser()
    try:
        options, unknown = parser.parse_known_args(_joined(argv))
    except SystemExit as stop:  # --help
        return int(stop.code or 0)
    if unknown:
        option = next((word for word in unknown if word.startswith("-")), unknown[0])
        kind = "unknown option" if option.startswith("-") else "unexpected argument"
        prog = f"{parser.prog} {options.command}"
        raise InputError(prog, option.split("=")[0], kind, f"see {prog} --help")
    return options.run(options, ["doo-ti", *argv])


def _report(problem: object, code: int) -> int:
    # One line whatever the message holds.
    print(f"doo-ti: {' '.join((str(problem) or type(problem).__name__).split())}", file=sys.stderr)
    return code


def _joined(argv: list[str]) -> list[str]:
    """``--up -1,0,0`` as ``--up=-1,0,0``: argparse takes a value that starts with a minus for an option."""
    words: list[str] = []
    for word in argv:
        if re.match(r"-[\d.]", word) and words and re.fullmatch(r"--[\w-]+", words[-1]):
            words[-1] += f"={word}"
        else:
            words.append(word)
    return words


def _parser() -> _Parser:
    parser = _Parser(prog="doo-ti", allow_abbrev=False,
                     description="Fit discrete elastic rods to observed shapes (Javdani et al., ICRA 2011).")
    parser.add_argument("--version", action="version", version=f"doo-ti {__version__}")
    add = parser.add_subparsers(dest="command", required=True, metavar="COMMAND").add_parser

    relax = add("relax", allow_abbrev=False, help="relax each observation under one material")
    relax.add_argument("observations", metavar="OBS", help="observations: .npz, .csv or .parquet")
    relax.add_argument("--out", required=True, metavar="F.npz", help="file to write")
    _add_material(relax, "one number, --bend also A1,A2 or A1,A2,A12")
    _add_relaxation(relax, "f64")
    relax.set_defaults(run=commands.relax)

    sweep = add("sweep", allow_abbrev=False, help="search a parameter grid for what explains the observations")
    sweep.add_argument("source", metavar="SCENE.toml|OBS", help="a scene, or observations: .npz, .csv or .parquet")
    sweep.add_argument("--out", required=True, metavar="RUN", help="folder to write; a run begun there is resumed")
    _add_material(sweep, "a number or LO:HI:N[:log|:lin]; overrides the scene's axis")
    _add_relaxation(sweep, None)
    sweep.add_argument("--objective", choices=OBJECTIVES, help="static: Eq. 2 (default)")
    sweep.add_argument("--seed", metavar="N", help="of everything random (default: the scene's, else 0)")
    sweep.add_argument("--workers", metavar="N", help="processes to share the work (default: one)")
    sweep.set_defaults(run=commands.sweep)

    learn = add("learn", allow_abbrev=False, help="best parameters of finished sweeps over the same grid")
    learn.add_argument("runs", nargs="+", metavar="RUN", help="folders that sweep wrote")
    _add_json(learn)
    learn.set_defaults(run=commands.learn)

    view = add("view", allow_abbrev=False, help="open a run's recording in the rerun viewer")
    view.add_argument("recording", metavar="RUN", help="folder of a run, or an .rrd file")
    view.set_defaults(run=commands.view)

    convert = add("convert", allow_abbrev=False, help="observations from one format to another")
    convert.add_argument("observations", metavar="IN", help=".npz, .csv or .parquet")
    convert.add_argument("out", metavar="OUT", help=".npz, .csv or .parquet")
    convert.set_defaults(run=commands.convert)

    synth = add("synth", allow_abbrev=False, help="make a scene's observations in the virtual lab")
    synth.add_argument("scene", metavar="SCENE.toml")
    synth.add_argument("--out", required=True, metavar="OBS", help="file to write: .npz, .csv or .parquet")
    synth.set_defaults(run=commands.synth)

    bench = add("bench", allow_abbrev=False, help="throughput and accuracy on this machine, one table")
    bench.add_argument("--rods", metavar="N", help="rods in the large batches (default 65536)")
    bench.add_argument("--threads", metavar="N", help="threads of the kernels (default: one per processor)")
    bench.add_argument("--rounds", metavar="N", help="measurements of which the median counts (default 3)")
    bench.add_argument("--scaling", action="store_true", help="also over rods, edges and threads; takes minutes")
    bench.add_argument("--jax", action="store_true", help="also the same solver in JAX, which needs to be installed")
    bench.add_argument("--out", metavar="FOLDER", help="folder for bench.json and pictures (default: none)")
    _add_json(bench)
    bench.set_defaults(run=commands.bench)
    return parser


def _add_material(parser: argparse.ArgumentParser, form: str) -> None:
    group = parser.add_argument_group("material", f"bend and twist in mm³; {form}")
    group.add_argument("--bend", metavar="A", help="isotropic bend stiffness α")
    group.add_argument("--bend-1", metavar="A1", help="stiffness against bending about m2")
    group.add_argument("--bend-2", metavar="A2", help="stiffness against bending about m1")
    group.add_argument("--twist", metavar="B", help="twist stiffness β")
    group.add_argument("--twist-ratio", metavar="R", help="β over α, or over A1 (default 1)")
    group.add_argument("--weight", metavar="M", help="half the weight per length, relative (default 1)")


def _add_relaxation(parser: argparse.ArgumentParser, precision: str | None) -> None:
    parser.add_argument("--clamp-start", choices=CLAMPS, help="default: frame where it is given, else tangent")
    parser.add_argument("--clamp-end", choices=CLAMPS, help="default: frame where it is given, else tangent")
    parser.add_argument("--frame-weight", metavar="MM", help="w_m of Eq. 1 (default 0, or the scene's)")
    parser.add_argument("--up", metavar="X,Y,Z", help="direction against gravity (default: the file's, else 0,0,1)")
    parser.add_argument("--solver", choices=SOLVERS, default="newton")
    parser.add_argument("--precision", choices=PRECISIONS, default=precision,
                        help=f"default {precision or 'the scene' + chr(39) + 's, else mixed'}")
    _add_json(parser)


def _add_json(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", action="store_true", help="print a summary for machines")
