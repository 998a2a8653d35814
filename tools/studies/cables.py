"""The public cable data (docs/cables.md): from its pickles to the files that the studies read, and the studies on it.

    python tools/studies/cables.py make DATA_SET --out FOLDER      # DATA_SET/DLO1/train/*.pkl … DLO5
    python tools/studies/cables.py results FOLDER                  # every figure of docs/ on real cables

Only the training part is read. ``results`` ends with exit code 1 where a file is missing or a study fails.
"""

import argparse
import csv
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from doo_ti import InputError
from doo_ti.system.files import write_whole

RATE_HZ = 100.0  # of the published recordings; their files do not contain it
CABLES = tuple(f"dlo{number}" for number in range(1, 6))
STRETCH, APART, SLOWEST = 150, 50, 6  # frames of a stretch of motion, frames from one to the next, and how many are kept
STILL = Path(__file__).with_name("still_frames.csv")
"""Recording and frame of 60 nearly still frames of dlo1 and dlo3: those that had changed least."""


class ArrayReader(pickle.Unpickler):
    """Reads arrays and lists of them. A pickle names what its reader calls, which may be anything: here those names alone
    are looked up that make arrays of NumPy."""

    def find_class(self, module: str, name: str):
        if (module.replace("numpy._core", "numpy.core"), name) not in (
                ("numpy", "ndarray"), ("numpy", "dtype"), ("numpy.core.multiarray", "_reconstruct"),
                ("numpy.core.numeric", "_frombuffer"), ("_codecs", "encode")):
            raise pickle.UnpicklingError(f"it names {module}.{name}")
        return super().find_class(module.replace("numpy.core", "numpy._core"), name)


def read_recordings(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """Positions (R, T, V, 3) float32 in mm, and the numbers (R,), of the pickles of a cable: T frames (3, V) in m each. Raises
    InputError for other files."""
    paths = sorted(folder.glob("*.pkl"), key=lambda path: int(path.stem))
    if not paths:
        raise InputError(folder, "folder", "no files *.pkl", "name the data set")
    found = []
    for path in paths:
        try:
            with path.open("rb") as file:
                found.append(1e3 * np.swapaxes(np.array(ArrayReader(file).load(), dtype=np.float64), 1, 2))
        except (pickle.UnpicklingError, EOFError, ValueError, TypeError, AttributeError) as error:
            raise InputError(path, "file", f"no list of frames ({error})", "download it again") from None
    return np.stack(found).astype(np.float32), np.array([int(path.stem) for path in paths])


def slowest(positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The slowest stretches (6, 150, V, 3) of recordings (R, T, V, 3), and their speeds (6,) m/s: of the fastest marker in each
    frame, mean over the stretch. Stretches of one recording may overlap."""
    speed = np.linalg.norm(np.gradient(positions.astype(np.float64), axis=1), axis=-1).max(axis=-1) * RATE_HZ * 1e-3
    begins = np.arange(0, positions.shape[1] - STRETCH + 1, APART)
    mean = np.stack([speed[:, begin : begin + STRETCH].mean(axis=1) for begin in begins], axis=1)
    order = np.argsort(mean, axis=None)[:SLOWEST]
    rows, columns = np.unravel_index(order, mean.shape)
    return np.stack([positions[row, begins[column] :][:STRETCH] for row, column in zip(rows, columns, strict=True)]), \
        mean.ravel()[order]


def make(source: Path, out: Path) -> None:
    """Raises InputError for missing or damaged recordings."""
    with STILL.open(encoding="utf-8", newline="") as file:
        still = [(row["cable"], int(row["recording"]), int(row["frame"])) for row in csv.DictReader(file)]
    folder = out / "cables"
    for cable in CABLES:
        positions, names = read_recordings(source / cable.upper() / "train")
        write_whole(folder / "motion" / f"{cable}_train.npz", lambda file: np.savez_compressed(
            file, positions_mm=positions, rate_hz=RATE_HZ, recording=names))
        stretches, speed = slowest(positions)
        write_whole(folder / f"{cable}_motion.npz", lambda file: np.savez_compressed(
            file, positions_mm=stretches.astype(np.float64), rate_hz=RATE_HZ, mean_speed_m_per_s=speed))
        places = [(names.tolist().index(recording), frame) for name, recording, frame in still if name == cable]
        if places:
            recording, frame = np.array(places).T
            vertices = positions[recording, frame].astype(np.float64)
            edges = np.linalg.norm(np.diff(vertices, axis=1), axis=-1)
            write_whole(folder / f"{cable}.npz", lambda file: np.savez_compressed(
                file, vertices_mm=vertices, rest_length_mm=np.median(edges, axis=0), source_trajectory=recording,
                source_frame=frame))


def results(data: Path) -> int:
    """Runs the studies one after the other; returns the number of those that failed."""
    files = [data / "cables" / "motion" / f"{cable}_train.npz" for cable in CABLES]
    missing = [path for path in (*files, data / "cables" / "dlo1.npz", data / "cables" / "dlo3.npz") if not path.is_file()]
    if missing:
        raise InputError(missing[0], "file", "missing", "make it: python tools/studies/cables.py make DATA_SET --out FOLDER")
    predict = ["tools/studies/prediction_study.py", "cables", "--data", data]
    identify = [["-m", "doo_ti", "identify", path, "--folds", "4", "--out", data / f"{path.stem}_theta.json"] for path in files]
    failed = 0
    for words in (predict, *identify):
        print(f"\n## {' '.join(str(word) for word in words)}\n", flush=True)
        failed += subprocess.run([sys.executable, *map(str, words)], cwd=ROOT).returncode != 0
    return failed


def main(words: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    commands = parser.add_subparsers(dest="command", required=True)
    one = commands.add_parser("make", help="convert the pickles")
    one.add_argument("source", type=Path, metavar="DATA_SET")
    one.add_argument("--out", type=Path, required=True, metavar="FOLDER")
    commands.add_parser("results", help="the studies on the converted data").add_argument("data", type=Path, metavar="FOLDER")
    options = parser.parse_args(words)
    try:
        if options.command == "make":
            make(options.source, options.out)
            return 0
        return int(results(options.data.resolve()) > 0)
    except InputError as error:
        print(error, file=sys.stderr)
        return 2 if options.command == "make" else 1


if __name__ == "__main__":
    sys.exit(main())
