"""Changes of text files: tables, scenes, rigs, and JSON."""

import json
import random
import re
from pathlib import Path

from tools.fuzzing.options import NAMES

NUMBER = re.compile(rb"-?\d+\.?\d*(?:e[-+]?\d+)?")
WORD = re.compile(rb"[A-Za-z_][\w.]*")
NUMBERS = (
    "nan",
    "inf",
    "-inf",
    "1e300",
    "-1e300",
    "1e-300",
    "0",
    "-1",
    "1e400",
    "4294967296",
    "2147483647",
    "9223372036854775808",
    "1e6",
    "-1e6",
    "100000",
    "",
    " ",
    "x",
    "true",
    "[]",
    "{}",
    "[1, 2]",
    "0x10",
    "1_0",
    "٣",
    "1e",
    "--1",
    "1;2",
    '"1"',
    "5e-324",
    "9" * 400,
    "2024-01-01",
    "!!python/object:os.system",
    "&a",
    "*a",
    "null",
)
BAD_BYTES = (
    b"\xff",
    b"\xc3\x28",
    b"\x00",
    b"\xef\xbb\xbf",
    b"\r",
    b"\x1b[2J",
    b"\x0c",
    b"\xed\xa0\x80",
    b'"',
    b"'",
    b"[",
    b"{",
    b",",
    b"#",
    b"%YAML",
    b"---\n",
    b"\t",
    b"<?xml?>",
    b"[" * 20_000,
    b"a" * 200_000,
    b",\n" * 5_000,
)
JSON_VALUES = (
    None,
    True,
    0,
    -1,
    1e300,
    -1e300,
    1e-300,
    2**70,
    "",
    "x",
    "$x_{",
    "\x1b[2J",
    "a\nb",
    "nan",
    [],
    {},
    [1, 2],
    [[]],
    {"a": 1},
    float("nan"),
    float("inf"),
    "../x",
    0.5,
    ["a"] * 3,
    [None],
)


def spoil_text(path: Path, chance: random.Random) -> tuple[str, str]:
    """Change one thing about a file of text; returns the change's kind and what it is."""
    if path.suffix == ".json" and chance.random() < 0.8:
        return _spoil_json(path, chance)
    content = path.read_bytes()
    way = chance.choice(("number",) * 7 + ("word",) * 3 + ("line", "line", "cell", "cell", "bytes", "bytes", "form"))
    change = {"number": _number, "word": _word, "line": _line, "cell": _cell, "bytes": _bytes, "form": _form}[way]
    new, kind, described = change(content, chance)
    path.write_bytes(new)
    return kind, described


def _number(content: bytes, chance: random.Random) -> tuple[bytes, str, str]:
    found = list(NUMBER.finditer(content))
    if not found:
        return _bytes(content, chance)
    number, value = chance.choice(found), chance.choice(NUMBERS)
    line = content[content.rfind(b"\n", 0, number.start()) + 1 : number.start()].decode(errors="replace")[-20:].strip()
    return content[: number.start()] + value.encode() + content[number.end() :], "values", f"…{line} {value[:30]!r}"


def _word(content: bytes, chance: random.Random) -> tuple[bytes, str, str]:
    found = list(WORD.finditer(content))
    if not found:
        return _bytes(content, chance)
    word = chance.choice(found)
    others = [chance.choice(found).group(), *(name.encode() for name in NAMES), b"", word.group() + b"_", word.group().upper()]
    value = chance.choice(others)
    return (
        content[: word.start()] + value + content[word.end() :],
        "structure",
        f"{word.group().decode(errors='replace')} is {value.decode(errors='replace')[:30]!r}",
    )


def _line(content: bytes, chance: random.Random) -> tuple[bytes, str, str]:
    lines = content.splitlines(keepends=True)
    at, to = chance.randrange(len(lines)), chance.randrange(len(lines))
    way = chance.choice(("dropped", "twice", "moved", "joined", "in front", "blank"))
    line = lines[at]
    if way in ("dropped", "moved"):
        del lines[at]
    if way in ("twice", "moved"):
        lines.insert(to, line)
    elif way == "joined":
        lines[at] = line.rstrip(b"\r\n")
    elif way == "in front":
        lines[at] = b"  " + line
    elif way == "blank":
        lines[at] = b"\n"
    return b"".join(lines), "structure", f"line {at + 1} {way}"


def _cell(content: bytes, chance: random.Random) -> tuple[bytes, str, str]:
    """One column of a table, or the part of a line between commas, taken away or there twice."""
    lines = content.split(b"\n")
    at = chance.randrange(len(lines))
    cells = lines[at].split(b",")
    column = chance.randrange(len(cells))
    way = chance.choice(("cell dropped", "cell twice", "column dropped", "column twice", "column swapped"))
    for row in range(len(lines)) if way.startswith("column") else [at]:
        cells = lines[row].split(b",")
        if column < len(cells) and lines[row]:
            if way.endswith("dropped"):
                del cells[column]
            elif way.endswith("twice"):
                cells.insert(column, cells[column])
            else:
                cells[column], cells[0] = cells[0], cells[column]
            lines[row] = b",".join(cells)
    return b"\n".join(lines), "structure", f"{way}, {column + 1}"


def _bytes(content: bytes, chance: random.Random) -> tuple[bytes, str, str]:
    bad = chance.choice(BAD_BYTES)
    at = chance.choice((0, len(content), chance.randrange(len(content) + 1)))
    return content[:at] + bad + content[at:], "structure", f"with {bad[:12]!r}"


def _form(content: bytes, chance: random.Random) -> tuple[bytes, str, str]:
    forms = {
        "in UTF-16": lambda: content.decode(errors="replace").encode("utf-16"),
        "in CR LF": lambda: content.replace(b"\n", b"\r\n"),
        "in CR": lambda: content.replace(b"\n", b"\r"),
        "in semicolons": lambda: content.replace(b",", b";"),
        "without line ends": lambda: content.replace(b"\n", b""),
        "ten times": lambda: content * 10,
        "in capitals": content.upper,
        "blank": lambda: b"\n" * 9,
        "header only": lambda: content.split(b"\n")[0] + b"\n",
        "without a header": lambda: content.split(b"\n", 1)[-1],
    }
    way = chance.choice(sorted(forms))
    return forms[way](), "structure", way


def _spoil_json(path: Path, chance: random.Random) -> tuple[str, str]:
    """One value, somewhere within, replaced, dropped or renamed."""
    value = json.loads(path.read_text())
    places = []

    def walk(parent, described: str) -> None:
        for key in list(parent) if isinstance(parent, dict) else range(len(parent)):
            places.append((parent, key, f"{described}.{key}"))
            if isinstance(parent[key], (dict, list)):
                walk(parent[key], f"{described}.{key}")

    walk(value, "")
    parent, key, described = chance.choice(places)
    way = chance.choice(("replace",) * 4 + ("drop", "rename"))
    if way == "replace":
        parent[key] = chance.choice(JSON_VALUES)
        way = f"is {json.dumps(parent[key])[:40]}"
    elif way == "rename" and isinstance(parent, dict):
        parent[key + "_"] = parent.pop(key)
    else:
        del parent[key]
    path.write_text(json.dumps(value))
    return "values" if way.startswith("is ") else "structure", f"{described[1:]} {way}"
