"""Hypothesis strategies that change one thing about a good file or command line."""

import io
import zipfile

import numpy as np
from hypothesis import strategies as st

from tests.fuzz.commands import PATHS

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
    """Bytes flipped, cut off, left out, repeated or put in."""
    at = draw(st.integers(0, len(content)))
    length = draw(st.sampled_from([1, 2, 16, 256]))
    way = draw(st.sampled_from(["flip", "cut", "remove", "repeat", "insert", "empty"]))
    if way == "flip" and content:
        at = min(at, len(content) - 1)
        return content[:at] + bytes([content[at] ^ 1 << draw(st.integers(0, 7))]) + content[at + 1:]
    middle = {"cut": b"", "remove": content[at + length:], "repeat": content[at : at + length] + content[at:],
              "insert": draw(st.binary(max_size=length)) + content[at:], "empty": b"", "flip": b""}[way]
    return (b"" if way == "empty" else content[:at]) + middle


@st.composite
def text_changed(draw, content: bytes) -> bytes:
    """A word, a line or a cell replaced, left out or repeated."""
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
    """An array of another shape, type or value, left out, or under another name."""
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
    """The content of a file of that format with one change."""
    of_format = {".npz": npz_changed, **dict.fromkeys((".toml", ".csv", ".yaml", ".json", ".txt"), text_changed)}.get(suffix)
    return bytes_changed(content) if of_format is None or not content else of_format(content) | bytes_changed(content)


@st.composite
def words_changed(draw, words: tuple[str, ...]) -> tuple[str, ...]:
    """A word of a command line replaced, left out, repeated, or an option put in."""
    at = draw(st.integers(1, len(words) - 1))
    way = draw(st.sampled_from(["value", "value", "drop", "twice", "option"]))
    value, option = draw(st.sampled_from((*NUMBERS, *TEXTS, "1:2:3", "1,2", "x:y"))), draw(st.sampled_from(OPTIONS))
    new = {"value": (value,), "drop": (), "twice": words[at : at + 1] * 2, "option": (words[at], option)}[way]
    if words[at - 1] in PATHS:  # outputs stay below the working folder
        return words
    return words[:at] + new + words[at + 1:]
