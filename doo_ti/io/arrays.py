"""Files of named arrays: npz, one array per key, or CSV, one row per entry of the first axis; and the one reader for every CSV
table that users write, with one form of error message.

A message about a table names file, column, the cell's text, its line (the header is line 1) and the remedy:

    sets.csv: seed_y: 'x' in line 2 is not a finite number; give decimal numbers

Cells are between commas, or between the semicolons or tabs that spreadsheets write where decimals are behind a comma: if any
cell of such a file is a number with a comma, all numbers have one. Text is UTF-8, UTF-16 with its mark, or of Windows.
"""

import csv
import io
import math
import re
import zipfile
import zlib
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from difflib import get_close_matches
from io import StringIO
from itertools import islice, pairwise, zip_longest
from pathlib import Path
from tokenize import TokenError

import numpy as np

from doo_ti.rod.material import LARGEST, UNITS_IN_MM
from doo_ti.system.errors import InputError, real_array, require
from doo_ti.system.files import MOST_TEXT_BYTES, read_content

AXES = ("x", "y", "z")
LENGTH_ENDINGS = {**{f"_{unit}": factor for unit, factor in UNITS_IN_MM.items()}, "": 1.0}
"""What the name of a column of lengths ends with: mm in the unit that this states, mm where it states none."""
MOST_LISTED = 20  # names in a message
MOST_UNPACKED_BYTES = 1 << 30  # of the arrays or columns of a file
MOST_UNPACKED_RATIO = 1100  # of these bytes to those of the file: what NumPy compresses shrinks to a thousandth at best
NEARLY = 0.88  # least similarity of two keys (difflib) at which one counts as a misspelling of the other
# What reading a damaged npz may raise.
_UNREADABLE = (ValueError, OSError, EOFError, KeyError, RuntimeError, MemoryError, OverflowError, SyntaxError,
               TypeError, TokenError, zipfile.BadZipFile, zlib.error)


def frame_columns(name: str) -> tuple[str, ...]:
    """Of a frame with the columns t, m1, m2, row by row: ``NAME_t_x``, ``NAME_m1_x``, …"""
    return tuple(f"{name}_{director}_{axis}" for axis in AXES for director in ("t", "m1", "m2"))


def read_npz(path: Path, content: bytes, known: tuple[str, ...]) -> dict[str, np.ndarray]:
    """The arrays of the ``known`` keys from the bytes of an npz file, never unpickled; ``path`` names it in messages. Raises
    InputError for whatever is not an npz of plain arrays, and for a misspelt key."""
    remedy = "write it with numpy.savez from plain numeric arrays"
    require(content[:6] != b"\x93NUMPY", path, "file", "holds one bare array, not named ones", remedy)
    try:
        archive = zipfile.ZipFile(io.BytesIO(content))
    except _UNREADABLE as error:
        kind = "truncated" if content[:2] == b"PK" else "pickled" if content[:1] == b"\x80" else "not an npz"
        raise InputError(path, "file", f"{kind} file ({first_line(error)})", remedy) from None
    keys = {}
    with archive:
        entries = [(entry.filename.removesuffix(".npy"), entry) for entry in archive.infolist()]
        members = dict(entries)
        if len(members) < len(entries):
            name, _ = next(entry for entry in entries if members[entry[0]] is not entry[1])
            raise InputError(path, name, "the key is there twice", remedy)
        check_unpacked(path, content, sum(entry.file_size for name, entry in entries if name in known))
        for key in known:
            if key not in members:
                # Files may hold unknown keys, but one that is nearly a known key is a mistake.
                if alike := get_close_matches(key, members.keys() - set(known), 1, NEARLY):
                    raise InputError(path, alike[0], "unknown key", f"name it {key}, or otherwise if it is something else")
                continue
            try:
                keys[key] = _member(archive, members[key])
            except _UNREADABLE as error:
                raise InputError(path, key, f"cannot be read ({first_line(error)})", remedy) from None
    return keys


def _member(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> np.ndarray:
    """An array of an npz. Raises an error unless it is as long as its header says, before there is an array of that size."""
    if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ValueError("compressed as NumPy does not")
    with archive.open(entry) as file:
        version = np.lib.format.read_magic(file)
        read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = read_header(file)
        size = entry.file_size - file.tell()
        if not dtype.itemsize or not dtype.hasobject and math.prod(shape) * dtype.itemsize != size:
            raise ValueError(f"{size} bytes for shape {str(shape)[:80]} of {dtype}")
        file.seek(0)
        return np.lib.format.read_array(file, allow_pickle=False)


def check_unpacked(path: Path, content: bytes, size: int) -> None:
    """Raise InputError where the bytes of a file unpack to a size that is too large, or that no data of its size unpack to."""
    most = min(MOST_UNPACKED_BYTES, MOST_UNPACKED_RATIO * len(content))
    require(size <= most, path, "file", f"unpacks to {size:,} bytes", f"give arrays of at most {most:,}")


def read_arrays(path: Path, known: dict[str, tuple[tuple[int, ...], tuple[str, ...]]]) -> dict[str, np.ndarray]:
    """The arrays of a file, those of a CSV file (N, \\*shape), as float64.

    known  of each key the shape of an entry, and the columns that hold it in CSV: {"place_mm": ((3,), ("x_mm", …))}

    Raises InputError for files that cannot be read, unknown columns, entries that are not finite numbers, and where none of
    the known keys is there.
    """
    if path.suffix != ".csv":
        return read_numbers(path, tuple(known))
    columns = tuple(name for _, owned in known.values() for name in owned)
    table = read_csv(path, (), columns, form=f"some of {', '.join(columns)}")
    given = {key: given_columns(path, owned, table.columns) for key, (_, owned) in known.items()}
    return checked_arrays(path, {key: np.stack([table.numbers(name) for name in names], axis=-1).reshape(
        table.count, *known[key][0]) for key, names in given.items() if names})


def read_numbers(path: Path, known: tuple[str, ...]) -> dict[str, np.ndarray]:
    """The arrays of an npz file as float64. Raises InputError as :func:`read_arrays` does."""
    require(path.suffix == ".npz", path, "file", f"suffix {path.suffix!r}", "name a .npz or .csv file")
    arrays = read_npz(path, read_content(path), known)
    require(arrays, path, "file", "has none of the known keys", f"give some of {', '.join(known)}")
    return checked_arrays(path, arrays)


def checked_arrays(path: Path, arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """``arrays``, changed to float64. Raises InputError for those that are not finite numbers."""
    for key, value in arrays.items():
        arrays[key] = value = real_array(path, key, value, "store real numbers").astype(np.float64)
        require((np.abs(value) <= LARGEST).all(), path, key, "not finite", "give finite numbers")
    return arrays


def given_columns(path: Path, columns: tuple[str, ...], names) -> tuple[str, ...]:
    """The ``columns`` of one key, or none. Raises InputError where a table with the columns ``names`` has only some of them."""
    present = [name for name in columns if name in names]
    if present and len(present) < len(columns):
        missing = next(name for name in columns if name not in names)
        raise InputError(path, missing, f"the column is missing beside {present[0]}", f"give {', '.join(columns)}")
    return tuple(present)


def listed(names: Iterable[str]) -> str:
    """The first of the ``names`` in a file, in a message."""
    return ", ".join(islice(names, MOST_LISTED))


def first_line(error: BaseException) -> str:
    """Of an error's message, as part of one line."""
    return (str(error) or type(error).__name__).strip().splitlines()[0]


EMPTY = frozenset({"", "na", "n/a", "nan", "null"})  # texts for a missing number, in lower case
TRUTH = {"true": "1", "false": "0"}
SEPARATORS = ",;\t"
_QUOTED = re.compile(r'"[^"\n]*"')
_WITH_COMMA = re.compile(r'(?:^|[;\t"]) *[-+]?\d*,\d+(?:[eE][-+]?\d+)? *(?:$|[\r;\t"])', re.MULTILINE)


@dataclass(frozen=True)
class CsvTable:
    """The cells of a CSV file, stripped of spaces.

    columns  name: N texts
    lines    N: the line of the file on which a row ends
    decimal  the sign before decimals
    """

    path: Path
    columns: dict[str, list[str]]
    lines: list[int]
    decimal: str = "."

    @property
    def count(self) -> int:
        """N, the number of rows."""
        return len(self.lines)

    def rows(self, chosen: np.ndarray) -> "CsvTable":
        """The rows that are ``chosen`` (N,)."""
        columns = {name: [cells[row] for row in np.flatnonzero(chosen)] for name, cells in self.columns.items()}
        return CsvTable(self.path, columns, [self.lines[row] for row in np.flatnonzero(chosen)], self.decimal)

    def refuse(self, name: str, wrong: np.ndarray, problem: str, remedy: str) -> None:
        """Raise InputError for the first cell of column ``name`` that is ``wrong`` (N,), if there is one."""
        if np.any(wrong):
            row = int(np.argmax(wrong))
            raise InputError(self.path, name, f"{self.columns[name][row]!r} in line {self.lines[row]} {problem}", remedy)

    def numbers(self, name: str, *, may_be_empty: bool = False) -> np.ndarray:
        """(N,) f64: the finite numbers of a column; NaN where it may be empty and is. Raises InputError for anything else."""
        cells = self.columns[name]
        if may_be_empty:
            cells = ["nan" if cell.lower() in EMPTY else TRUTH.get(cell.lower(), cell) for cell in cells]
        values = np.array([number_in(cell, self.decimal) for cell in cells])
        allowed = np.isfinite(values) | (np.isnan(values) if may_be_empty else False)
        self.refuse(name, ~allowed, "is not a finite number", "give decimal numbers")
        return values

    def texts(self, name: str) -> np.ndarray | None:
        """(N,) texts of a column that has one, and no number, in every row; else None."""
        cells = self.columns[name]
        if any(cell.lower() in EMPTY or np.isfinite(number_in(cell, self.decimal)) for cell in cells):
            return None
        return np.array(cells)

    def whole(self, name: str) -> np.ndarray:
        """(N,) int64: the whole numbers of a column. Raises InputError for anything else."""
        values = self.numbers(name)
        broken = (values != np.round(values)) | (np.abs(values) >= 2**53)
        self.refuse(name, broken, "is not a whole number", "give whole numbers")
        return values.astype(np.int64)


def number_in(cell: str, decimal: str = ".") -> float:
    """The number in a cell with that sign before decimals; infinity where there is none, as in Python's 1_000."""
    if decimal != ".":
        cell = "" if "." in cell else cell.replace(decimal, ".")
    try:
        return np.inf if "_" in cell else float(cell)
    except ValueError:
        return np.inf


def read_csv(path: Path, needed: tuple[str, ...], optional: tuple[str, ...] | None = None, *, form: str | None = None,
             short_lines: bool = False, content: bytes | None = None) -> CsvTable:
    """The table in a CSV file, or in its ``content`` where that has been read; lines without any text are left out.

    needed       columns that must be there
    optional     columns that may be there, any other is an error; None: other columns are read too
    form         which columns to give, for messages; by default ``needed``
    short_lines  whether a line may end before the last columns, whose cells are then empty

    Raises InputError for a file that cannot be read or is not CSV, for columns that are missing, unknown or given twice, for
    lines with more or fewer cells than the header, for cells that hold a line break, as after a quote that is not closed, and
    for a file without rows.
    """
    remedy = f"give the columns {form or ', '.join(needed)}"
    content = read_content(path, MOST_TEXT_BYTES, "name a readable CSV file") if content is None else content
    lines, decimal = csv_rows(path, content, remedy)
    rows = [(line, row) for line, row in lines if any(row) and any(map(str.strip, row))]
    names = [name.strip() for name in rows[0][1]] if rows else []
    for name in needed:
        require(name in names, path, name, "the column is missing", remedy)
    for name, count in Counter(names).items():
        require(count <= 1, path, name or "header", f"the column {name!r} is there twice", "keep one of them")
        require(optional is None or name in (*needed, *optional), path, name or "header", f"unknown column {name!r}", remedy)
    require(len(rows) >= 2, path, "file", "holds no rows", "write one line or more below the names of the columns")
    for line, row in rows[1:]:
        if len(row) > len(names) or len(row) < len(names) and not short_lines:
            raise InputError(path, f"line {line}", f"{len(row)} cells under {len(names)} columns", "give one for each column")
    columns = zip_longest(*(row for _, row in rows), fillvalue="")
    return CsvTable(path, {name.strip(): [cell.strip() for cell in cells] for name, *cells in columns},
                    [line for line, _ in rows[1:]], decimal)


def decoded(content: bytes, errors: str = "strict") -> str:
    """The text of a file that a spreadsheet may have written. Raises UnicodeDecodeError for what is no text, if ``errors`` are
    strict."""
    if content.startswith((BOM_UTF16_LE, BOM_UTF16_BE)):
        return content.decode("utf-16", errors)
    try:
        return content.decode("utf-8-sig", errors)
    except UnicodeDecodeError:
        return content.decode("cp1252")


def csv_rows(path: Path, content: bytes, remedy: str) -> tuple[list[tuple[int, list[str]]], str]:
    """Each line of a CSV file, (its number from 1, its cells), and the sign before decimals. Raises InputError, with that
    ``remedy``, for bytes that are not CSV, and for cells that hold a line break, as after a quote that is not closed. Lines
    at the top that begin with # are left out."""
    try:
        text = decoded(content)
        # What separates the cells, by the first line that has several.
        unquoted = (_QUOTED.sub("", line) for line in StringIO(text))
        first = next((line for line in unquoted if any(sign in line for sign in SEPARATORS)), ",")
        separator = max(SEPARATORS, key=first.count)
        reader = csv.reader(StringIO(text, newline=""), strict=True, delimiter=separator)
        ends = [(reader.line_num, row) for row in reader]  # the line on which each row ends
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(path, "file", f"is not a CSV table ({str(error)[:80]})", remedy) from None
    for (before, _), (line, _) in pairwise([(0, []), *ends]):
        require(line <= before + 1, path, f"line {line}", "a line break within a cell", "close the quote")
    if ends and "".join(ends[0][1]).strip() == "sep=":  # by which spreadsheets are told the separator
        ends = ends[1:]
    comments = next((k for k, (_, row) in enumerate(ends) if not "".join(row).lstrip().startswith("#")), 0)
    return ends[comments:], "," if separator != "," and _WITH_COMMA.search(text) else "."
