"""Short commands over the corpus with one thing changed about a file or a word: they succeed, or refuse in one line."""

import io
import os
import re
import shutil
import zipfile
from pathlib import Path

import hypothesis
import numpy as np
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

from doo_ti.commands.cli import main
from tests.fuzz.corpus import BOARD, MATERIAL

MADE_OF = " ".join(MATERIAL)
SEEN = "--rig rig.yaml --rest-length 3:8"
PERCEIVE = f"perceive {SEEN} --sets images/sets.csv {MADE_OF} --hypotheses 4 --out out/F.npz"
SINGLE = (f"perceive {' '.join(f'images/silk_14mm_000deg_cam{camera}.jpg' for camera in range(3))} {SEEN} --seed-point 0,0,0 "
          f"--seed-direction 0.94,0,0.34 {MADE_OF} --hypotheses 4 --out out/F.npz --no-picture --no-recording")
BRIEFLY = "--no-models --rest-curvature none --parameters bend --edges 8"
PATHS = {"--out", "--images", "--picture", "--recording", "--animation"}  # options that name outputs
COMPANIONS = {"dynamic.toml": ("pairs.csv",), "file.toml": ("rods.npz",), "images/sets.csv": ("images",),
              "frames.csv": ("images",), "views.csv": ("boards",)}
"""What a file of the corpus names itself."""


def read_by(words: tuple[str, ...]) -> tuple[str, ...]:
    found = [word.partition(":")[0] for word in words[1:] if not word.startswith("out/")]
    found = [name for name in found if re.fullmatch(r"\w*run|[\w/]+\.[a-z]+", name)]
    return tuple(dict.fromkeys([*found, *(name for each in found for name in COMPANIONS.get(each, ()))]))


_RODS = "rods.npz", "rods.csv", "rods.parquet", "ribbons.npz", "labs.npz"
_LINES = (
    *(f"relax {name} {MADE_OF} --out out/F.npz" for name in _RODS),
    *(f"convert {name} out/F{suffix}" for name, suffix in zip(_RODS, (".csv", ".npz", ".npz", ".parquet"))),
    "sweep scene.toml --out out/run", "sweep file.toml --out out/run", "sweep dynamic.toml --out out/run",
    "sweep scene.toml --out run", "sweep dynamic.toml --out dynamic_run",
    "sweep rods.npz --bend 2e5:8e5:2 --out out/run --json",
    "sweep labs.npz --bend 4e5 --clamp-end position --roll-hypotheses 2 --out out/run",
    "sweep rods.npz --bend 4e5 --objective dynamic --pairs pairs.csv --out out/run",
    "learn run", "learn dynamic_run --json", "learn run ribbon_run", "learn run --by end-distance --out out/tables",
    f"refine run --starts 1 {BRIEFLY}", f"refine rods.npz {MADE_OF} {BRIEFLY} --out out/F.json",
    f"refine rods.npz {MADE_OF} --no-models --rest-curvature none --parameters bend --folds 2 --edges 8 --json",
    f"predict rods.npz --motion path.npz --relative {MADE_OF} --sub-step 30 --out out/F.npz",
    f"predict rods.npz --motion path.csv {MADE_OF} --sub-step 30 --out out/F.npz --json",
    f"predict rods.npz --motion marks_path.npz {MADE_OF} --sub-step 30 --out out/F.npz",
    "predict loop.toml --sub-step 30 --out out/F.npz",
    "predict loop.toml --sub-step 30 --out out/F.npz --picture out/F.png --recording out/F.rrd",
    "group tied.toml --out out/F.npz", "group tied.toml --out out/F.npz --picture out/F.png --recording out/F.rrd --json",
    "simulate swing.toml --out out/F.npz",
    "simulate swing.toml --out out/F.npz --picture out/F.png --recording out/F.rrd --animation out/F.gif",
    "simulate recorded.npz --theta theta.json --out out/F.npz --json",
    "simulate recorded.npz --theta theta.json --out out/F.npz --substeps 2 --scheme euler --fill-gaps",
    "identify recorded.npz --modes 1 --bend 1e6 --out out/F.json",
    "identify recorded.npz --modes 0 --fit friction --bend 1e6 --smoothing 3 --obstacles table.toml --radius 1 "
    "--out out/F.json",
    "identify recorded.npz recorded.npz --modes 0 --fit drag --folds 2 --out out/F.json --json",
    "relax rods.npz --theta theta.json --out out/F.npz", f"twist rods.npz {MADE_OF} --out out/F.npz --picture out/F.png",
    f"twist perceived.npz {MADE_OF} --out out/F.npz --json",
    f"twist labs.npz {MADE_OF} --offsets offsets.npz --out out/F.npz",
    f"twist labs.npz {MADE_OF} --offsets offsets.csv --regrasp 2 --out out/F.npz",
    "figures run --out out/figures --cells 2", "figures dynamic_run --out out/figures", "figures ribbon_run --out out/figures",
    "plan scene.toml --picks 2", "plan rods.npz --bend 2e5:8e5:2 --picks 2 --out out/plan", "plan labs.npz --bend 4e5 --json",
    "view run", "view run/run.rrd", "synth scene.toml --out out/F.npz", "synth ribbon.toml --out out/F.csv",
    "synth scene.toml --images out/images --rig rig.yaml --render noise=2", "bench --rods 8 --rounds 0",
    f"calibrate views.csv --board {BOARD} --out out/rig.yaml",
    f"calibrate views.csv --board {BOARD} --out out/rig.yaml --json --distortion 2 --world camera",
    "triangulate marks.csv --rig rig.yaml --labels labels.csv --out out/F.npz",
    "triangulate marks.csv --rig rig.yaml --rest-length 3 --out out/F.csv --json",
    PERCEIVE, f"{PERCEIVE} --no-picture --no-recording --truth images/truth.npz --json",
    f"{PERCEIVE} --no-picture --no-recording --detector canny".replace("3:8", "lengths.npz"), SINGLE,
    f"track {SEEN} --frames frames.csv {MADE_OF} --out out/F.npz --no-recording",
    f"track {SEEN} --frames frames.csv {MADE_OF} --out out/F.npz".replace("3:8", "lengths.txt"))
"""Sweeps whose folder is not below ``out`` are finished before."""
RECIPES = [tuple(line.split()) for line in _LINES]
NUMBERS = ("nan", "inf", "-inf", "1e400", "-1", "0", "1e300", "1e-300", "5e-324", "2147483648", "9" * 400, "", "None", "true")
"""What stands for a number where one is expected."""
TEXTS = ("", " ", "\x1b[2J", "a\nb", "\u202e", "../x", "/dev/zero", "=1+1", "x" * 5000, "\ufeff", "null", "é")
OPTIONS = ("--json", "--bend", "--up", "--unit", "--no-such", "--precision", "--help")
ARRAYS = {
    "empty": lambda a: a[:0], "one axis more": lambda a: a[None], "transposed": lambda a: a.T, "flat": np.ravel,
    "a row less": lambda a: a[:-1], "a column less": lambda a: a[..., :-1], "twice": lambda a: np.concatenate([a, a]),
    "a scalar": lambda a: a.ravel()[0], "zeros": np.zeros_like, "rows backwards": lambda a: a[::-1],
    "objects": lambda a: a.astype("O"), "texts": lambda a: a.astype("U9"), "halves": lambda a: a.astype("f2"),
    "complex": lambda a: a.astype("c16"), "flags": lambda a: a.astype("?"), "huge": lambda a: a * 1e300,
    "with NaN": lambda a: np.where(np.arange(a.size).reshape(a.shape) == a.size // 2, np.nan, a)}


@st.composite
def bytes_changed(draw, content: bytes) -> bytes:
    at, length = draw(st.integers(0, len(content))), draw(st.sampled_from([1, 2, 16, 256]))
    way = draw(st.sampled_from(["flip", "cut", "remove", "repeat", "insert", "empty"]))
    if way == "flip" and content:
        at = min(at, len(content) - 1)
        return content[:at] + bytes([content[at] ^ 1 << draw(st.integers(0, 7))]) + content[at + 1:]
    middle = {"cut": b"", "remove": content[at + length:], "repeat": content[at : at + length] + content[at:],
              "insert": draw(st.binary(max_size=length)) + content[at:], "empty": b"", "flip": b""}[way]
    return (b"" if way == "empty" else content[:at]) + middle


@st.composite
def text_changed(draw, content: bytes) -> bytes:
    lines = content.decode().split("\n")
    row = draw(st.integers(0, len(lines) - 1))
    separator = "," if "," in lines[row] else " "
    cells = lines[row].split(separator)
    column = draw(st.integers(0, len(cells) - 1))
    way = draw(st.sampled_from(["number", "number", "text", "no cell", "two cells", "no line", "two lines", "no ends"]))
    if way in ("number", "text"):
        cells[column] = draw(st.sampled_from(NUMBERS if way == "number" else TEXTS))
    elif way in ("no cell", "two cells"):
        cells[column : column + 1] = cells[column : column + 1] * (2 if way == "two cells" else 0)
    lines[row] = separator.join(cells)
    if way in ("no line", "two lines"):
        lines[row : row + 1] = lines[row : row + 1] * (2 if way == "two lines" else 0)
    return ("" if way == "no ends" else "\n").join(lines).encode(errors="surrogatepass")


@st.composite
def npz_changed(draw, content: bytes) -> bytes:
    arrays = dict(np.load(io.BytesIO(content)))
    key = draw(st.sampled_from(sorted(arrays)))
    way = draw(st.sampled_from(["array", "array", "array", "drop", "rename", "member"]))
    if way == "array":
        try:
            with np.errstate(all="ignore"):
                arrays[key] = ARRAYS[draw(st.sampled_from(sorted(ARRAYS)))](arrays[key])
        except (IndexError, TypeError, ValueError):
            arrays[key] = arrays[key][None]
    elif way == "drop":
        del arrays[key]
    elif way == "rename":
        arrays[draw(st.sampled_from([key + "_", key.upper(), "$" + key, key.removesuffix("_mm")]))] = arrays.pop(key)
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for name, array in arrays.items():
            member = io.BytesIO()
            np.lib.format.write_array(member, np.asanyarray(array))
            stored = member.getvalue()
            if way == "member" and name == key:
                stored = draw(bytes_changed(stored))
            archive.writestr(zipfile.ZipInfo(f"{name}.npy"), stored)
    return file.getvalue()


def changed(content: bytes, suffix: str) -> st.SearchStrategy[bytes]:
    of_format = {".npz": npz_changed, **dict.fromkeys((".toml", ".csv", ".yaml", ".json", ".txt"), text_changed)}.get(suffix)
    return bytes_changed(content) if of_format is None or not content else of_format(content) | bytes_changed(content)


@st.composite
def words_changed(draw, words: tuple[str, ...]) -> tuple[str, ...]:
    at, way = draw(st.integers(1, len(words) - 1)), draw(st.sampled_from(["value", "value", "drop", "twice", "option"]))
    value, option = draw(st.sampled_from((*NUMBERS, *TEXTS, "1:2:3", "1,2", "x:y"))), draw(st.sampled_from(OPTIONS))
    new = {"value": (value,), "drop": (), "twice": words[at : at + 1] * 2, "option": (words[at], option)}[way]
    if words[at - 1] in PATHS:  # outputs stay below the working folder
        return words
    return words[:at] + new + words[at + 1:]


FREE = {"suppress_health_check": list(HealthCheck), "deadline": None, "derandomize": True, "database": None}
PROGRESS = re.compile(r"━|\d+/\d+ \w+ .*:")


def files(folder: Path) -> dict[str, tuple]:
    """Kind, size and time of everything below a folder."""
    return {str(path): (path.lstat().st_mode, path.lstat().st_size * path.is_file(), path.lstat().st_mtime_ns * path.is_file())
            for path in folder.rglob("*")}


def judged(code: int, out: str, err: str) -> None:
    lines = [line for line in err.splitlines() if not PROGRESS.search(line) and not line.startswith("doo-ti: warning: ")]
    assert code in (0, 1, 2) and "Traceback" not in err
    assert all(line.startswith("doo-ti: ") for line in lines), err
    assert (out + err).replace("\n", "").isprintable()
    if code == 2:
        assert len(lines) == 1 and "; " in lines[0] and not out, (out, err)


def one_case(data, names: set[str] | None, source: Path, folder: Path, capfd) -> None:
    """A command of those ``names`` with one thing wrong about its files or its words, run in ``folder``."""
    words = data.draw(st.sampled_from([words for words in RECIPES if (names is None or words[0] in names)
                                       and all((source / name).exists() for name in read_by(words))]))
    for name in read_by(words):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        if (source / name).is_dir():
            shutil.copytree(source / name, folder / name, dirs_exist_ok=True)
        else:
            shutil.copyfile(source / name, folder / name)
    targets = sorted(path for path in folder.rglob("*") if path.is_file())
    if targets and data.draw(st.booleans()):
        target = data.draw(st.sampled_from(targets))
        target.write_bytes(data.draw(changed(target.read_bytes(), target.suffix)))
    else:
        words = data.draw(words_changed(words))
    before = files(folder)
    try:
        code = main(list(words))
    finally:
        out, err = capfd.readouterr()
    judged(code, out, err)
    if code == 2:
        assert files(folder) == before, "written though refused"


def trials(count: int, *given) -> None:
    """So many of :func:`trial`."""
    @settings(max_examples=count, **FREE)
    @hypothesis.given(data=st.data())
    def one(data):
        trial(data, *given)

    one()


def trial(data, names, source, tmp_path_factory, capfd) -> None:
    folder, here = tmp_path_factory.mktemp("case"), Path.cwd()
    os.chdir(folder)
    try:
        one_case(data, names, source, folder, capfd)
    finally:
        os.chdir(here)
        shutil.rmtree(folder, ignore_errors=True)
