"""Lengths of a rod's edges as ``--rest-length`` gives them: so many of a length, or a file."""

import os
import re
from pathlib import Path

import numpy as np

from doo_ti.commands import options as given
from doo_ti.io.arrays import read_npz
from doo_ti.io.csv_table import decoded
from doo_ti.system.errors import InputError
from doo_ti.system.files import MOST_TEXT_BYTES, read_content

MOST_EDGES = 2000
LEAST_MM, MOST_MM = 1e-3, 1e4
"""Of an edge."""


def read_rest_length(text: str) -> np.ndarray:
    """(E,) mm, from ``3:33`` or a file."""
    option, remedy = "--rest-length", "give MM:COUNT, such as 3:33, or a file of lengths in mm"
    length, _, count = text.partition(":")
    if count and not os.path.exists(text):
        edges, each = given.whole(option, count, 2, MOST_EDGES), given.length(option, length)
        if not LEAST_MM <= each <= MOST_MM:
            raise InputError(given.SOURCE, option, f"edges of {each:g} mm", f"give {LEAST_MM:g} to {MOST_MM:g} mm")
        return np.full(edges, each)
    path = Path(text)
    try:
        content = read_content(path, MOST_TEXT_BYTES, remedy)
    except InputError as error:
        raise InputError(given.SOURCE, option, f"{text!r}: {error.problem}", remedy) from None
    try:
        values = read_npz(path, content, ("rest_length_mm",)).get("rest_length_mm") if path.suffix == ".npz" else \
            np.array(_words(path, decoded(content)), dtype=np.float64)
    except ValueError as error:
        if isinstance(error, InputError):
            raise
        raise InputError(path, "file", "holds something that is not a number", remedy) from None
    if values is None or values.dtype.kind not in "fiu" or values.ndim != 1 or not 2 <= len(values) <= MOST_EDGES \
            or not ((values >= LEAST_MM) & (values <= MOST_MM)).all():
        raise InputError(path, "rest_length_mm", f"missing, or not 2 or more numbers from {LEAST_MM:g} to {MOST_MM:g}",
                         "give one for each edge, in mm")
    return values.astype(np.float64)


def _words(path: Path, text: str) -> list[str]:
    """The numbers of a text, between commas, semicolons or spaces. Raises InputError where commas may also be in them."""
    words = text.replace(";", " ").split()
    if len(words) > 1 and all(re.fullmatch(r"\d+,\d+", word) for word in words):
        raise InputError(path, "rest_length_mm", f"{words[0]!r} is one number, or two", "write decimals behind a point, and "
                         "numbers between spaces")
    return " ".join(words).replace(",", " ").split()
