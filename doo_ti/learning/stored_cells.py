"""The rods of a run as they lie in its files, one file in memory at a time, whatever files they lie in and in whatever order.

Axes: G grid cells, N terms of the objective: observations under Eq. 2, pairs of observations under Eq. 3; n rods of a file.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from doo_ti.errors import InputError
from doo_ti.grid import Grid
from doo_ti.learning.chunk_file import check_identity, column_names, read_columns

PARAMETERS = ("bend_1", "bend_2", "twist", "weight")
RODS = ("distance_mm", "status", "stable")
RODS_OF_PAIRS = (*RODS, "jumps", "pair_weight")
MOST_OBSERVATIONS = 1 << 31
"""More than the column ``observation`` can number."""


@dataclass(frozen=True)
class Terms:
    """The terms of the objective that occur in some files, in the order of the observations that they start from, then end at.

    key      (N,) one number for each
    dynamic  whether they are pairs
    """

    key: np.ndarray
    dynamic: bool

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

    identity  of the sweep that they belong to, None where the run does not say
    """
    paths = sorted((run / part).glob("*.parquet"))
    if not paths:
        raise InputError(run / part, "cells", "no Parquet files", "run the sweep to its end")
    check_identity(paths, identity)
    return paths


def terms_in(paths: list[Path]) -> Terms:
    """The terms in some files."""
    dynamic = column_names(paths[0]) >= {"from_observation"}
    ends = Terms(np.empty(0), dynamic).ends
    found = np.empty(0, dtype=np.int64)
    for path in paths:
        found = np.union1d(found, _keys(read_columns(path, list(ends)), ends))
    return Terms(found, dynamic)


def rods_in(paths: list[Path], grid: Grid, terms: Terms,
            more: tuple[str, ...] = ()) -> Iterator[tuple[Path, np.ndarray, np.ndarray, dict[str, np.ndarray]]]:
    """Each file with the cell (n,) of its rods, −1 where the grid has none, their term (n,), and their columns: RODS or
    RODS_OF_PAIRS, and ``more``."""
    names = [*PARAMETERS, *terms.ends, *(RODS_OF_PAIRS if terms.dynamic else RODS), *more]
    for path in paths:
        columns = read_columns(path, names)
        yield path, grid.cells_of(columns), terms.of(columns), columns


def whole_rods_in(run: Path, paths: list[Path], grid: Grid, terms: Terms, more: tuple[str, ...] = ()) -> Iterator[tuple]:
    """As :func:`rods_in`. Raises InputError, at the latest after the last file, unless they hold each cell and term once, and
    nothing else."""
    rods = grid.size * len(terms.key)
    seen, count = np.zeros(-(-rods // 8), dtype=np.uint8), 0  # a bit for each rod
    fits = terms.dynamic or bool((terms.key == np.arange(len(terms.key))).all())
    for found in rods_in(paths, grid, terms, more):
        _, cell, term, _ = found
        fits &= bool((cell >= 0).all())
        if not fits:
            break
        rod = cell * np.int64(len(terms.key)) + term
        np.bitwise_or.at(seen, rod >> 3, np.uint8(1) << (rod & 7).astype(np.uint8))
        count += len(rod)
        yield found
    if not fits or not count == np.bitwise_count(seen).sum(dtype=np.int64) == rods:
        term = "pair" if terms.dynamic else "observation"
        raise InputError(run, "cells", f"do not hold each cell and {term} of the grid once", "run the sweep to its end")


def _keys(columns: dict[str, np.ndarray], ends: tuple[str, ...]) -> np.ndarray:
    last = columns[ends[-1]].astype(np.int64)
    return last if len(ends) == 1 else columns[ends[0]].astype(np.int64) * MOST_OBSERVATIONS + last
