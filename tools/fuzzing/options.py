"""How the options of a command line are spoilt: wrong, extreme, unknown and contradictory ones."""

import random
import re
from contextlib import redirect_stdout
from functools import cache
from io import StringIO

from tools.fuzzing.commands import PATHS

NUMBERS = (
    "nan",
    "inf",
    "-inf",
    "1e300",
    "-1e300",
    "1e-300",
    "0",
    "-1",
    "-0.0",
    "4294967296",
    "9223372036854775808",
    "1e400",
    "",
    " ",
    "x",
    "1,2",
    "1,2,3",
    "1,2,3,4",
    "1:2:3:lin",
    "1e5:1e6:2",
    "2:1:3",
    "1::3",
    "1:2:3:cubic",
    "0:0:2",
    "1:1e300:3",
    "1:2:1000000000",
    "٣",
    "0x10",
    "1e5mm",
    "1,,2",
    "none",
    "true",
    "-",
    "1e5 ",
    "+5",
    "1/0",
    "0.5",
    "1e9",
)
NAMES = (
    "$\\frac{$",
    "$x_{1$",
    "\x1b[2J",
    "a\nb",
    "a\rb",
    "[bold]x[/bold]",
    "[/]",
    "\u202etxt",
    "ß" * 300,
    "%s%n",
    "{0}",
    "../x",
    "nul\\",
    "\u2028",
    "\x07",
    "name",
    "seed_x",
    "a,b",
    '"',
    "'",
)
FILES = (
    "absent.npz",
    "",
    ".",
    "/",
    "/dev/null",
    "/dev/zero",
    "/proc/self/mem",
    "out",
    "rods.npz",
    "scene.toml",
    "rig.yaml",
    "run",
    "images",
    "marks.csv",
    "a\nb.npz",
    "$x$.toml",
    "\x1b[31m.csv",
    "rods.npz/x",
    "~",
    "a" * 300 + ".npz",
    "ß.yaml",
)
OUTPUTS = (
    "out/F.txt",
    "out",
    "",
    "rods.npz",
    "scene.toml",
    "rods.npz/F.npz",
    "/proc/F.npz",
    "/dev/null",
    "/dev/full",
    "out/new/F.npz",
    "out/$x_{.npz",
    "out/a\nb.npz",
    "out/\x1b[31m.npz",
    "out/[bold].npz",
    "out/F.csv",
    "out/F.parquet",
    "out/F.rrd",
    "out/F.png",
    "out/F.json",
    "out/F.yaml",
    "out/" + "a" * 300 + ".npz",
    "out/.npz",
    "out/-.npz",
)
FEW = ("0", "-1", "x", "", "1e300", "nan", "1.5", "9223372036854775808")
"""For options that ask for as much work as their number says, or for other processes and machines: refused all."""
READ = {"--motion", "--pairs", "--offsets", "--rig", "--sets", "--truth", "--frames", "--labels", "--groups", "--rest-length"}
SMALL = {
    "--workers",
    "--rods",
    "--rounds",
    "--threads",
    "--roll-hypotheses",
    "--folds",
    "--starts",
    "--recorded",
    "--hypotheses",
    "--steps-between",
}
BESIDE = {"--dask": ("tcp://", "", "missing", "tcp://127.0.0.1:x", "http://127.0.0.1:1", "tcp://127.0.0.1:99999")}
CONTRADICTIONS = (
    "--bend 1e5 --bend-1 1e5",
    "--twist 1e5 --twist-ratio 1",
    "--bend-2 1e5",
    "--bend 1e5,1e5,2e5",
    "--workers 2 --dask tcp://x:1",
    "--sets images/sets.csv --seed-point 0,0,0",
    "--motion path.npz",
    "--relative",
    "--offsets offsets.npz --observations 3",
    "--regrasp 0 1 1",
    "--regrasp 99",
    "--observations 99",
    "--end-distances 1,2,3",
    "--by spin",
    "--by material,material",
    "--parameters bend,bend",
    "--parameters twist-ratio",
    "--parameters ,",
    "--groups groups.npz",
    "--groups groups.npz:absent",
    "--objective dynamic",
    "--clamp-start free --clamp-end free",
    "--clamp-start free",
    "--measured 0,0",
    "--measured 99",
    "--render noise=1e300",
    "--render blur=-1",
    "--render occluders=1000000",
    "--render jpeg_quality=none",
    "--render x=1",
    "--render",
    "--truth rods.npz",
    "--board charuco:5x4:8:6",
    "--board charuco:5x4:8:9",
    "--board chessboard:100000x99999:1",
    "--board chessboard:4x3:1e300",
    "--board chessboard:4x3:nan",
    "--distortion 0",
    "--sigma-px 1e-300",
    "--sigma-px nan",
    "--threshold 1e300",
    "--cells all",
    "--cells 0",
    "--observation 99",
    "--clip 1e300",
    "--clip 1e-300",
    "--sigma 1e-300",
    "--linear-density 1e300",
    "--curvature-spread 1e-300 --rest-curvature field",
    "--precision f32",
    "--solver descent",
    "--help",
    "--version",
    "--json --json",
    "--up 0,0,0",
    "--up nan,0,1",
    "--up 1e-320,0,0",
    "--weight 0",
    "--weight 1e30",
    "--frame-weight 1e300",
    "--nu 1e-300",
    "--nu 1e300",
    "--width 1e300",
    "--width 1e-3",
    "--diameter 1e-300",
    "--diameter 1e9",
    "--seed-point 1e300,0,0",
    "--seed-direction 0,0,0",
    "--seed-direction 1e-320,0,0",
    "--bend 1e-300",
    "--bend 1e300",
    "--twist 1e300",
    "--twist 1e-300",
    "--bend 1e5,1e5,99999.9999",
    "--sub-step 31",
    "--rest-length 1e300:8",
    "--rest-length 3:2001",
    "--rest-length 1e-300:8",
    "--rest-length 3:8:2",
    "--polarity light",
    "--detector canny",
)


@cache
def options_of(command: str) -> tuple[tuple[str, bool], ...]:
    """The options that ``--help`` of a command names, and whether each takes a value."""
    from doo_ti.cli import main

    with redirect_stdout(StringIO()) as printed:
        main([command, "--help-all"])
    usage = printed.getvalue().split("\n\n")[0]
    found = dict(re.findall(r"(--[a-z][\w-]*)([ \n]+[A-Z{])?", usage))
    return tuple((name, bool(value)) for name, value in sorted(found.items()))


def spoilt(words: list[str], chance: random.Random) -> tuple[list[str], str]:
    """A command line with something wrong, extreme or contradictory about its options, and what that is."""
    way = chance.choice(
        ("value", "value", "value", "add", "add", "contradict", "contradict", "drop", "twice", "unknown", "position")
    )
    at = [index for index, word in enumerate(words[:-1]) if word.startswith("--") and not words[index + 1].startswith("--")]
    if way == "value" and at:
        index = chance.choice(at)
        value = chance.choice(_values(words[index]))
        return [*words[: index + 1], value, *words[index + 2 :]], f"{words[index]} {value[:40]!r}"
    if way == "contradict":
        more = chance.choice(CONTRADICTIONS)
        return [*words, *more.split(" ")], more
    if way == "drop" and at:
        index = chance.choice(at)
        count = chance.choice((1, 2))
        return [*words[:index], *words[index + count :]], f"without {' '.join(words[index : index + count])}"
    if way == "twice" and at:
        index = chance.choice(at)
        return [*words, *words[index : index + 2]], f"{words[index]} twice"
    if way == "unknown":
        word = chance.choice(
            ("--stretch", "-x", "--bendd=3", "--", "---", "-", "--out=", "--json=yes", "", "\x1b[2J", "a\nb", "--=1")
        )
        return [*words, word], f"also {word!r}"
    if way == "position":
        index = chance.choice([index for index in range(1, len(words)) if index - 1 not in at])
        value = chance.choice(FILES)
        return [*words[:index], value, *words[index + 1 :]], f"{words[index]} as {value[:40]!r}"
    option, takes = chance.choice(options_of(words[0]) or (("--help", False),))
    value = [chance.choice(_values(option))] if takes else []
    return [*words, option, *value], f"also {option} {value[0][:40]!r}" if value else f"also {option}"


def _values(option: str) -> tuple[str, ...]:
    if option in BESIDE:
        return BESIDE[option]
    if option in SMALL:
        return FEW
    return OUTPUTS if option in PATHS else FILES if option in READ else NUMBERS + NAMES
