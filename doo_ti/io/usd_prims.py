"""The prims of a USD scene in text form, nested as they are, and where their transforms put them.

    def Xform "World" { double3 xformOp:translate = (0, 0, 1)   uniform token[] xformOpOrder = ["xformOp:translate"]
        def BasisCurves "rope" { … } }

References, payloads and variants are not composed: what counts is what the file itself says.
"""

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from doo_ti.errors import InputError
from doo_ti.frames import matrix_from_quaternion, rotation_matrix
from doo_ti.types import LARGEST

_QUOTED = r'"""[\s\S]*?"""|"(?:\\.|[^"\\\n])*"' + r"|'(?:\\.|[^'\\\n])*'|@[^@\n]*@|#[^\n]*"
_TOKEN, _IN_PARENTHESES = re.compile(_QUOTED + "|[{}]"), re.compile(_QUOTED + "|[()]")
_HEADER = re.compile(r"\b(?:def|over|class)(?:\s+(\w+))?\s*$")
_ORDER = re.compile(r"\bxformOpOrder\s*=\s*\[([^\]]*)\]")
_VALUE = r"\s*=\s*(\(\s*(?:\([^()]*\)[\s,]*)+\)|\([^()]*\)|[^\s()]+)"
_RESET, _INVERT = "!resetXformStack!", "!invert!"
_LONGEST_HEADER = 200
"""Characters before a prim's name in which its type is looked for."""


@dataclass
class Prim:
    """A prim: its type, its name, the text between its braces without that of other prims in it, and the prim around it."""

    kind: str
    name: str
    parent: "Prim | None"
    pieces: list[str] = field(default_factory=list)

    @property
    def text(self) -> str:
        return " ".join(self.pieces)

    @property
    def path(self) -> str:
        return f"{'' if self.parent is None else self.parent.path}/{self.name}"


def prims(text: str) -> list[Prim]:
    """All prims of a file, each after the one around it."""
    found: list[Prim] = []
    scopes: list[Prim | None] = []  # of the open braces: the prim that they belong to, or None of values
    named, place, begin = None, 0, 0
    while token := _TOKEN.search(text, place):
        place = token.end()
        owner = next((scope for scope in reversed(scopes) if scope is not None), None)
        if token[0][0] == '"':
            if header := _HEADER.search(text, max(0, token.start() - _LONGEST_HEADER), token.start()):
                named = Prim(header[1] or "", token[0].strip('"'), owner)
                place = _behind_parentheses(text, place)
        elif token[0] == "{":
            if named is not None:
                if owner is not None:
                    owner.pieces.append(text[begin : token.start()])
                found.append(named)
                begin = place
            scopes.append(named)
            named = None
        elif token[0] == "}" and scopes:
            closed = scopes.pop()
            if closed is not None:
                closed.pieces.append(text[begin : token.start()])
                begin = place
    return found


def _behind_parentheses(text: str, place: int) -> int:
    """The place behind the parentheses that begin at ``place``, if any do."""
    begin = re.compile(r"\s*\(").match(text, place)
    if begin is None:
        return place
    place, depth = begin.end(), 1
    while depth and (token := _IN_PARENTHESES.search(text, place)):
        place = token.end()
        depth += {"(": 1, ")": -1}.get(token[0], 0)
    return place


def placement(path: Path, prim: Prim) -> np.ndarray:
    """(4, 4) from points of ``prim`` to the world. Raises InputError for operations that are unknown, change over time or are
    not finite."""
    matrix = np.eye(4)
    while prim is not None:
        local, alone = _local(path, prim)
        matrix = local @ matrix
        prim = None if alone else prim.parent
    if not (np.abs(matrix) <= LARGEST).all():
        raise InputError(path, "xformOp", "not finite", "give finite numbers")
    return matrix


def _local(path: Path, prim: Prim) -> tuple[np.ndarray, bool]:
    """(4, 4) from the prim to the one around it, and whether the transforms around it do not count."""
    order = _ORDER.search(prim.text)
    words = [] if order is None else re.findall(r'"([^"]*)"', order[1])
    matrix, alone = np.eye(4), False
    for word in words:
        if word == _RESET:
            matrix, alone = np.eye(4), True
            continue
        name = word.removeprefix(_INVERT)
        one = _operation(path, name, prim.text)
        if name != word:
            if not np.isfinite(np.linalg.cond(one)):
                raise InputError(path, name, "has no inverse", "correct it")
            one = np.linalg.inv(one)
        matrix = matrix @ one
    return matrix, alone


def _operation(path: Path, name: str, text: str) -> np.ndarray:
    """(4, 4) of one operation."""
    value = re.search(rf"{re.escape(name)}{_VALUE}", text)
    if value is None:
        changing = re.search(rf"{re.escape(name)}\.timeSamples", text)
        raise InputError(path, name, "changes over time" if changing else "has no value",
                         "apply the transforms to the points, and export again")
    kind = name.split(":")[1] if ":" in name else name
    try:
        numbers = np.array([float(word) for word in re.findall(r"[^\s(),]+", value[1])])
    except ValueError:
        numbers = np.array([])
    make, count = _KINDS.get(kind, (None, 0))
    if make is None or len(numbers) != count or not np.isfinite(numbers).all():
        raise InputError(path, name, f"{value[1][:40]!r}", f"give finite numbers to some of {', '.join(_KINDS)}")
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
