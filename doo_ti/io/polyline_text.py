"""Plain polylines: numbers in lines, without names of columns, between commas, spaces, tabs or semicolons; also with decimals
behind a comma, where something else separates them.

    three numbers in a line    a point; an empty line begins the next curve
    more, three for each point a whole curve in a line
"""

import re
from pathlib import Path

import numpy as np

from doo_ti.io.csv_table import decoded
from doo_ti.io.curves import Curves, checked_points
from doo_ti.system.errors import InputError

FORM = "give lines of X Y Z, with an empty line between curves, or all numbers of a curve in one line"

_DECIMAL = re.compile(r"[-+]?\d+(?:,\d+)?(?:[eE][-+]?\d+)?")
"""A number with decimals behind a comma, or a whole one."""


def is_polyline(content: bytes) -> bool:
    """Whether the first line with text holds nothing but numbers."""
    text = decoded(content[: 1 << 16], "replace")
    return _numbers(next((line for line in text.splitlines() if line.strip() and not line.startswith("#")), "")) is not None


def read_polylines(path: Path, content: bytes, names: list[str] | None = None) -> Curves:
    """The curves of a file of numbers, in mm. Raises InputError for anything else, and for curves of different sizes."""
    if names is not None:
        raise InputError(path, "columns", "the file has no names", "leave `columns` out")
    lines, breaks = [], [0]
    try:
        whole = decoded(content)
    except UnicodeDecodeError:
        raise InputError(path, "file", "is no text", FORM) from None
    for number, text in enumerate(whole.splitlines(), start=1):
        text = text.partition("#")[0].strip()
        if not text:
            breaks += [len(lines)] * (len(lines) > breaks[-1])
            continue
        values = _numbers(text)
        if values is None or lines and len(values) != len(lines[0]) or len(values) % 3:
            raise InputError(path, f"line {number}", f"{text[:40]!r}", FORM)
        lines.append(values)
    if not lines:
        raise InputError(path, "file", "holds no numbers", FORM)
    if len(lines[0]) > 3:
        return Curves(checked_points(path, np.array(lines).reshape(len(lines), -1, 3)))
    counts = np.diff([*breaks, len(lines)] if breaks[-1] < len(lines) else breaks)
    if len(set(counts)) > 1:
        raise InputError(path, "points", f"curves of {counts.min()} to {counts.max()} points", "give equally many in each")
    return Curves(checked_points(path, np.array(lines).reshape(len(counts), -1, 3)))


def _numbers(text: str) -> list[float] | None:
    """The numbers of a line, or None where there is anything else."""
    words = text.replace(";", " ").split()
    if len(words) % 3 == 0 and all(map(_DECIMAL.fullmatch, words)) and "," in text:
        words = [word.replace(",", ".") for word in words]
    else:
        words = text.replace(",", " ").replace(";", " ").split()
    try:
        return [float(word) for word in words] or None
    except ValueError:
        return None
