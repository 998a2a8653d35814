"""The prims of a USD scene in text form, nested as they are, and where their transforms put them.

    def Xform "World" { double3 xformOp:translate = (0, 0, 1)   uniform token[] xformOpOrder = ["xformOp:translate"]
        def BasisCurves "rope" { … } }

References, payloads and variants are not composed: what counts is what the file itself says.
"""

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from doo_ti.rod.frames import matrix_from_quaternion, rotation_matrix
from doo_ti.rod.types import LARGEST
from doo_ti.system.errors import InputError

_TOKEN = re.compile(
    r'"""(?:[^"\\]|\\[\s\S]|"(?!""))*+"""|"(?:[^"\\\n]|\\.)*+"|' r"'(?:[^'\\\n]|\\.)*+'|@@@(?:[^@]|@(?!@@))*+@@@|@[^@\n]*+@"
    r"|#[^\n]*+|[{}()\[\]=]|[\"'@]")
_WORD = re.compile(r"\s*([^\s\"'@#()\[\]{}=;,]++)")
_HEADER = re.compile(r"\b(?:def|over|class)(?:\s+(\w+))?\s*$")
_RESET, _INVERT = "!resetXformStack!", "!invert!"
_LONGEST = 200
"""Characters before a name or an equals sign in which its statement is looked for."""
MOST_DEEP = 100
MOST_IN_OPERATION = 2000
"""Characters of the value of an operation: sixteen numbers need fewer."""


@dataclass
class Prim:
    """A prim: its type, its name, the prim around it, and the texts of its values by their names; those of time samples are
    called NAME.timeSamples. The outermost one is the file itself; its values are the metadata of the stage."""

    kind: str = ""
    name: str = ""
    parent: "Prim | None" = None
    values: dict[str, str] = field(default_factory=dict)
    matrix: np.ndarray | None = None

    @property
    def path(self) -> str:
        return "" if self.parent is None else f"{self.parent.path}/{self.name}"


def prims(path: Path, text: str) -> list[Prim]:
    """The file itself and all prims in it, each after the one around it. Raises InputError for a quote that is not closed, and
    for prims that are nested deeper than :data:`MOST_DEEP`."""
    found = [Prim()]
    scopes = [found[0]]  # of the open braces: the prim that they belong to
    named = name = None  # the prim whose braces come next, and what the next value is called
    begin, opened, depth = 0, 0, 0  # of the statement; of the value or metadata in brackets, and how deep these are nested
    for token in _TOKEN.finditer(text):
        sign = token[0]
        if sign in ("\"", "'", "@"):
            raise InputError(path, f"line {text.count(chr(10), 0, token.start()) + 1}", f"{sign} is not closed", "correct it")
        if depth:
            depth += (sign in "([{") - (sign in ")]}")
            if not depth:
                if name is not None:
                    scopes[-1].values[name] = text[opened : token.end()]
                name, begin = None, token.end()
        elif sign == "=":
            statement = text[max(begin, token.start() - _LONGEST) : token.start()].split()
            name = statement[-1] if statement and "variantSet" not in statement else None
            if name is not None and (word := _WORD.match(text, token.end())):
                scopes[-1].values[name] = word[1]
                name, begin = None, word.end()
        elif sign in "([{":
            is_stage = sign == "(" and name is None and named is None and len(scopes) == 1
            if sign == "{" and name is None or is_stage:
                if named is not None:
                    found.append(named)
                scopes.append(scopes[-1] if named is None else named)
                if len(scopes) > MOST_DEEP:
                    raise InputError(path, "file", f"nested deeper than {MOST_DEEP} prims", "export the rod alone")
                named, begin = None, token.end()
            else:
                opened, depth = token.start(), 1
        elif sign in ")]}":
            scopes = scopes[:-1] if len(scopes) > 1 else scopes
            begin = token.end()
        elif sign[0] in "\"'" and name is not None:
            scopes[-1].values[name] = sign
            name, begin = None, token.end()
        elif sign[0] == '"':
            if header := _HEADER.search(text, max(begin, token.start() - _LONGEST), token.start()):
                named = Prim(header[1] or "", sign.strip('"'), scopes[-1])
                begin = token.end()
    return found


def placement(path: Path, prim: Prim) -> np.ndarray:
    """(4, 4) from points of ``prim`` to the world. Raises InputError for operations that are unknown, change over time or are
    not finite."""
    if prim.matrix is None:
        local, alone = _local(path, prim)
        prim.matrix = local if alone or prim.parent is None else placement(path, prim.parent) @ local
        if not (np.abs(prim.matrix) <= LARGEST).all():
            raise InputError(path, "xformOp", "not finite", "give finite numbers")
    return prim.matrix


def _local(path: Path, prim: Prim) -> tuple[np.ndarray, bool]:
    """(4, 4) from the prim to the one around it, and whether the transforms around it do not count."""
    matrix, alone = np.eye(4), False
    for word in re.findall(r'"([^"\n]*+)"', prim.values.get("xformOpOrder", "")):
        if word == _RESET:
            matrix, alone = np.eye(4), True
            continue
        name = word.removeprefix(_INVERT)
        one = _operation(path, name, prim.values)
        if name != word:
            if not np.isfinite(np.linalg.cond(one)):
                raise InputError(path, name, "has no inverse", "correct it")
            one = np.linalg.inv(one)
        matrix = matrix @ one
    return matrix, alone


def _operation(path: Path, name: str, values: dict[str, str]) -> np.ndarray:
    """(4, 4) of one operation."""
    value = values.get(name)
    if value is None:
        changing = f"{name}.timeSamples" in values
        raise InputError(path, name, "changes over time" if changing else "has no value",
                         "apply the transforms to the points, and export again")
    kind = name.split(":")[1] if ":" in name else name
    try:
        numbers = np.array([float(word) for word in re.findall(r"[^\s(),]+", value[:MOST_IN_OPERATION])])
    except ValueError:
        numbers = np.array([])
    make, count = _KINDS.get(kind, (None, 0))
    if make is None or len(numbers) != count or len(value) > MOST_IN_OPERATION or not np.isfinite(numbers).all():
        raise InputError(path, name, f"{value[:40]!r}", f"give finite numbers to some of {', '.join(_KINDS)}")
    return make(numbers)


def _affine(linear: np.ndarray) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = linear
    return matrix


def _translate(shift: np.ndarray) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, 3] = shift
    return matrix


def _orient(quaternion: np.ndarray) -> np.ndarray:
    size = np.linalg.norm(quaternion)
    return _affine(matrix_from_quaternion(quaternion / size) if size > 0 else np.eye(3))


def _turns(axes: str):
    """The operation that turns about one axis of ``axes`` after the other, by degrees that are given as about X, Y, Z."""
    def turn(degrees: np.ndarray) -> np.ndarray:
        linear = np.eye(3)
        for axis in axes:
            about = "XYZ".index(axis)
            vector = np.zeros(3)
            vector[about] = np.radians(degrees[about if len(degrees) > 1 else 0])
            linear = rotation_matrix(vector) @ linear
        return _affine(linear)
    return turn


_KINDS = {
    "translate": (_translate, 3), "scale": (lambda factors: _affine(np.diag(factors)), 3), "orient": (_orient, 4),
    "transform": (lambda numbers: numbers.reshape(4, 4).T, 16),  # USD writes it for rows of points
    **{f"rotate{axes}": (_turns(axes), len(axes)) for axes in ("X", "Y", "Z", "XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX")},
}
"""Operations of a transform: the matrix from its numbers, and how many these are."""
