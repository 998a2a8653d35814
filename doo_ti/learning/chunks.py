"""The results of a run on disk: its cells, Parquet files of chunks of them, a row per cell and observation, or pair; its
summary; and who made them.

A chunk is written whole or not at all. Its pages carry checksums, and its metadata say which sweep it belongs to and what
computed it. Chunks are read one at a time, whatever cells they hold and in whatever order.

The maker is the code that computes cells: this package's version, the sources that cells depend on, and Taichi. A run has one
maker: cells of several makers would differ, and a reader could not distinguish them.

Axes: G grid cells, N terms of the objective: observations under Eq. 2, pairs of observations under Eq. 3; n rows of a file.
"""

import hashlib
import json
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path

import numpy as np

from doo_ti import __version__
from doo_ti.io.arrays import first_line
from doo_ti.rod.grid import Grid
from doo_ti.rod.types import LARGEST, Status
from doo_ti.system.errors import InputError
from doo_ti.system.files import MOST_TEXT_BYTES, read_content, write_whole

SOURCES = ("contact", "motion", "physics", "relaxation", "rod", "system/runtime.py", "learning/experiment.py",
           "learning/terms.py")
"""Files and folders of the package that cells depend on."""
SUMMARY = "summary.json"
DENSITY = "linear_density_g_per_m"  # key of the summary: the rod's linear density, where it was given


@cache
def maker() -> dict[str, str]:
    """Versions, and sha256 of the sources, as JSON holds them."""
    package, digest = Path(__file__).parents[1], hashlib.sha256()
    for source in SOURCES:
        for path in sorted((package / source).rglob("*.py")) or [package / source]:
            digest.update(path.relative_to(package).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return {"doo_ti": __version__, "sources_sha256": digest.hexdigest(), "taichi": version("taichi")}


def maker_text(made: dict[str, str]) -> str:
    """``doo_ti 0.1.0 (sources 1a2b3c4d), taichi 1.7.4``."""
    return f"doo_ti {made['doo_ti']} (sources {made['sources_sha256'][:8]}), taichi {made['taichi']}"


def read_summary(run: Path) -> dict:
    """The summary of a finished sweep. Raises InputError where the folder holds none."""
    return read_table(Path(run) / SUMMARY)


def read_table(path: Path) -> dict:
    """The JSON object in a file of a sweep. Raises InputError where it holds none."""
    content = read_content(path, MOST_TEXT_BYTES, "name the folder of a finished sweep")
    try:
        table = json.loads(content.decode())
    except (ValueError, RecursionError) as error:
        raise InputError(path, "file", f"not JSON ({error})", "run the sweep again") from None
    if not isinstance(table, dict):
        raise InputError(path, "file", "holds no table", "run the sweep again")
    return table


def sweep_identity(summary: dict) -> str | None:
    """The identity of the sweep that a summary is of; None where it names none."""
    provenance = summary.get("provenance")
    identity = provenance.get("sweep_sha256") if isinstance(provenance, dict) else None
    return identity if isinstance(identity, str) else None


IDENTITY, MAKER = "doo_ti_sweep", "doo_ti_maker"  # keys of a file's metadata
REMEDY = "delete it and run the sweep again"
PARAMETERS = ("bend_1", "bend_2", "twist", "weight")
RODS = ("distance_mm", "status", "stable")
RODS_OF_PAIRS = (*RODS, "jumps", "pair_weight")
LABELS = ("end_distance_mm", "end_rotation_deg")
MOST_OBSERVATIONS = 1 << 31  # more than the column ``observation`` can number

# Of a column: the kinds of its dtype as NumPy abbreviates them, and whether each value is possible.
_POSSIBLE = {
    **dict.fromkeys(("distance_mm", "start_distance_mm"), ("f", lambda x: np.isnan(x) | ((x >= 0) & (x <= LARGEST)))),
    "status": ("iu", lambda x: np.isin(x, list(Status))),
    "stable": ("b", lambda x: x | True),
    "jumps": ("iu", lambda x: x >= 0),
    "pair_weight": ("f", lambda x: (x > 0) & (x <= LARGEST)),
    **dict.fromkeys(("observation", "from_observation"), ("iu", lambda x: (x >= 0) & (x < MOST_OBSERVATIONS))),
    **dict.fromkeys(("end_distance_mm", "end_rotation_deg"), ("f", lambda x: ~np.isinf(x))),
}


def chunk_path(run: Path, part: str, first: int, last: int) -> Path:
    """The file of the cells ``first`` to ``last`` in the folder's ``part``, "cells" or "hypotheses"."""
    return run / part / f"{first:09d}-{last:09d}.parquet"


def write_chunk(path: Path, columns: dict, material: str, identity: str) -> None:
    """Write the rows of a chunk of the sweep ``identity``, whole or not at all."""
    import pyarrow

    count = len(columns["observation"])
    names = pyarrow.DictionaryArray.from_arrays(np.zeros(count, dtype=np.int8), [material])
    write_rows(path, pyarrow.table({**columns, "material": names}, metadata={IDENTITY: identity, MAKER: json.dumps(maker())}))


def write_rows(path: Path, table) -> None:
    """Write a pyarrow table of a chunk's rows, with its metadata."""
    import pyarrow.parquet

    write_whole(path, lambda file: pyarrow.parquet.write_table(table, file, write_page_checksum=True))


def read_rows(path: Path, names: list[str] | None = None):
    """The rows of a chunk as a pyarrow table, or their columns ``names``. Raises InputError where they cannot be read."""
    import pyarrow.parquet

    table = _parsed(path, lambda file: pyarrow.parquet.read_table(file, columns=names, page_checksum_verification=True))
    for name in names or ():
        if name not in table.column_names:
            raise InputError(path, name, "the column is missing", REMEDY)
    return table


def read_columns(path: Path, names: list[str]) -> dict[str, np.ndarray]:
    """The columns ``names`` of a chunk. Raises InputError where they cannot be read, and for values that no sweep writes."""
    table = read_rows(path, names)
    columns = {}
    for name in names:
        column = table.column(name)
        if column.null_count:
            raise InputError(path, name, "a value is missing", REMEDY)
        values = columns[name] = column.to_numpy()
        kinds, is_possible = _POSSIBLE.get(name, ("f", np.isfinite))
        if values.dtype.kind not in kinds:
            raise InputError(path, name, f"type {column.type}", REMEDY)
        wrong = np.flatnonzero(~is_possible(values))
        if len(wrong):
            raise InputError(path, name, f"{values[wrong[0]]} in row {wrong[0]}", REMEDY)
    return columns


def check_identity(paths: list[Path], identity: str | None) -> None:
    """Raise InputError where a chunk belongs to another sweep than ``identity``, or than the other chunks.

    identity  None where the run does not name it; chunks of older runs do not either
    """
    found = [(_schema(path).metadata or {}).get(IDENTITY.encode(), b"").decode(errors="replace") for path in paths]
    wanted = identity if any(found) else None
    for path, own in zip(paths, found, strict=True):
        if own != (wanted or found[0]):
            raise InputError(path, "cells", "belongs to another sweep", REMEDY)


@dataclass(frozen=True)
class Terms:
    """The terms of the objective that occur in some files, by the observations that they start from, then end at."""

    key: np.ndarray  # (N,) one number for each
    dynamic: bool  # whether they are pairs

    @property
    def objective(self) -> str:
        return "dynamic" if self.dynamic else "static"

    @property
    def observation(self) -> np.ndarray:
        """(N,) the observation that each compares with: y of Eq. 3."""
        return self.key % MOST_OBSERVATIONS

    @property
    def from_observation(self) -> np.ndarray:
        """(N,) the one that each starts from, x of Eq. 3: under Eq. 2 the same."""
        return self.key // MOST_OBSERVATIONS if self.dynamic else self.key

    @property
    def ends(self) -> tuple[str, ...]:
        """The columns that name a term."""
        return ("from_observation", "observation") if self.dynamic else ("observation",)

    def of(self, columns: dict[str, np.ndarray]) -> np.ndarray:
        """(n,) the term of each row."""
        return np.searchsorted(self.key, _keys(columns, self.ends))


def cell_files(run: Path, identity: str | None, part: str = "cells") -> list[Path]:
    """The files of a run's ``part``. Raises InputError where there are none, and where they are another sweep's.

    identity  of the sweep that they belong to, None where the run does not name it
    """
    paths = sorted((run / part).glob("*.parquet"))
    if not paths:
        raise InputError(run / part, "cells", "no Parquet files", "run the sweep to its end")
    check_identity(paths, identity)
    return paths


def terms_in(paths: list[Path]) -> Terms:
    """The terms in some files."""
    dynamic = "from_observation" in _schema(paths[0]).names
    ends = Terms(np.empty(0), dynamic).ends
    found = np.empty(0, dtype=np.int64)
    for path in paths:
        found = np.union1d(found, _keys(read_columns(path, list(ends)), ends))
    return Terms(found, dynamic)


def rods_in(paths: list[Path], grid: Grid, terms: Terms) -> Iterator[tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]]:
    """Of each file the cell (n,) of its rods, −1 where the grid has none, their term (n,), and their columns: RODS or
    RODS_OF_PAIRS, and LABELS."""
    names = [*PARAMETERS, *terms.ends, *(RODS_OF_PAIRS if terms.dynamic else RODS), *LABELS]
    for path in paths:
        columns = read_columns(path, names)
        yield grid.cells_of(columns), terms.of(columns), columns


def whole_rods_in(run: Path, paths: list[Path], grid: Grid, terms: Terms) -> Iterator[tuple]:
    """As :func:`rods_in`. Raises InputError, after the last file or before, unless the files hold each cell and term exactly
    once, and no others."""
    rods = grid.size * len(terms.key)
    seen, count = np.zeros(rods, dtype=bool), 0
    fits = terms.dynamic or bool((terms.key == np.arange(len(terms.key))).all())
    for found in rods_in(paths, grid, terms):
        cell, term, _ = found
        fits &= bool((cell >= 0).all())
        if not fits:
            break
        rod = cell * np.int64(len(terms.key)) + term
        seen[rod] = True
        count += len(rod)
        yield found
    if not fits or not count == seen.sum() == rods:
        term = "pair" if terms.dynamic else "observation"
        raise InputError(run, "cells", f"do not hold each cell and {term} of the grid once", "run the sweep to its end")


def _keys(columns: dict[str, np.ndarray], ends: tuple[str, ...]) -> np.ndarray:
    last = columns[ends[-1]].astype(np.int64)
    return last if len(ends) == 1 else columns[ends[0]].astype(np.int64) * MOST_OBSERVATIONS + last


def _schema(path: Path):
    import pyarrow.parquet

    return _parsed(path, pyarrow.parquet.read_schema)


def _parsed(path: Path, parse):
    """``parse(path)``. Raises InputError where that fails, and for a pipe, whose reader would wait for ever."""
    import pyarrow

    if path.exists() and not path.is_file():
        raise InputError(path, "cells", "a folder, a device or a pipe, no file", REMEDY)
    try:
        return parse(path)
    except (pyarrow.ArrowException, OSError) as error:
        raise InputError(path, "cells", f"cannot be read ({first_line(error)})", REMEDY) from None
