"""What the annotations of arguments ask of values (:mod:`doo_ti.system.arguments`).

An array may have a shape, ``Annotated[np.ndarray, "R E 4"]``, or several, ``"E | 1R E"``. A letter is one number for all fields
of an object or arguments of a call; ``1R`` is that or one, ``V-1`` one less, and ``()`` a scalar. Of an object with a ``count``
the shape is that many rows, ``Annotated[Clamps, "R"]``. Entries may have a kind, ``Annotated[np.ndarray, "R", int]``.
"""

from collections.abc import Callable, Iterable, Mapping
from enum import Enum
from numbers import Integral, Real
from types import NoneType, UnionType
from typing import Annotated, Any, Union, get_args, get_origin

import numpy as np
from numpy.typing import ArrayLike

KINDS = {None: "fiub", float: "fiu", int: "iu", bool: "b"}
"""NumPy's letters of the kinds of dtype of numbers and flags, or of numbers, whole ones or flags alone."""
NUMERIC = KINDS[None]
MOST_SHOWN = 40  # characters of a value in a message
INDEX_BITS = 63

ARRAY_PARTS = set(get_args(ArrayLike)) or {ArrayLike}  # a union before NumPy 2.5, a name for one since
_WORDS = {bool: "True or False", int: "a whole number", float: "a number", str: "text", NoneType: "None", Mapping: "a dict",
          Callable: "a function"}


class Mismatch(Exception):
    """What is wrong with a value, and what to give instead."""

    def __init__(self, problem: str, remedy: str):
        super().__init__(problem)
        self.problem, self.remedy = problem, remedy


class Rule:
    """What an annotation asks of a value.

    known   classes of which every instance will do as it is
    wanted  the annotation in words
    shapes  of arrays; any where there are none
    arrays  NumPy's letters of the kinds of dtype of which every array will do as it is
    """

    known: tuple[type, ...] = ()
    wanted = ""
    shapes: tuple["_Shape", ...] = ()
    arrays = ""

    def take(self, value: Any) -> Any:
        """``value``, or what stands for it. Raises Mismatch."""
        return value if isinstance(value, self.known) else self.adapted(value)

    def adapted(self, value: Any) -> Any:
        """What stands for a value of no known class. Raises Mismatch."""
        raise Mismatch(_shown(value), self.wanted)


class _Shape:
    """The words of a shape: numbers, and letters with what is to be added to them."""

    def __init__(self, words: str):
        axes = words.replace("()", "").split()
        self.words = f"({', '.join(axes)})"
        self.axes = [int(axis) if axis.isdigit() else (
            axis.startswith("1"), axis.lstrip("1")[0], int(axis.lstrip("1")[1:] or 0)) for axis in axes]

    def fits(self, shape: tuple[int, ...], sizes: dict[str, int]) -> bool:
        """Whether an array of that ``shape`` will do, beside the ``sizes`` of letters, to which then its own are added."""
        if len(self.axes) != len(shape):
            return False
        found = dict(sizes)
        for axis, size in zip(self.axes, shape, strict=True):
            if isinstance(axis, int):
                if axis != size:
                    return False
                continue
            or_one, letter, more = axis
            if not (or_one and size == 1) and found.setdefault(letter, size - more) != size - more:
                return False
        sizes.update(found)
        return True


def shape_of(value: Any) -> tuple[int, ...]:
    """The shape of an array; of an object with a ``count``, that many rows."""
    if isinstance(value, np.ndarray):
        return value.shape
    return (value.count,) if isinstance(getattr(type(value), "count", None), property) else np.shape(value)


class _Number(Rule):
    """A real number, but no flag, as a float: arrays that are filled with it take fractions. ``whole``: a whole one."""

    def __init__(self, whole: bool):
        self.whole, self.wanted = whole, _WORDS[int if whole else float]

    def take(self, value: Any) -> Any:
        if isinstance(value, np.ndarray) and value.ndim == 0 and value.dtype.kind in NUMERIC:
            value = value.item()
        if isinstance(value, bool | np.bool_) or not isinstance(value, Integral if self.whole else Real):
            raise Mismatch(_shown(value), self.wanted)
        if isinstance(value, Integral) and not -(1 << INDEX_BITS) <= value < 1 << INDEX_BITS:
            raise Mismatch(f"a number of {len(hex(value)) - 2} hexadecimal digits", "a smaller one")
        return value if self.whole else float(value)


class _Flag(Rule):
    known, wanted = (bool, np.bool_), _WORDS[bool]

    def adapted(self, value: Any) -> Any:
        if isinstance(value, Integral) and value in (0, 1):
            return bool(value)
        return super().adapted(value)


class _Instance(Rule):
    def __init__(self, kind: type):
        article = "an" if kind.__name__[0] in "AEIO" else "a"
        self.kind, self.known, self.wanted = kind, (kind,), _WORDS.get(kind, f"{article} {kind.__name__}")

    def adapted(self, value: Any) -> Any:
        if issubclass(self.kind, Enum) and isinstance(value, Integral | str) and not isinstance(value, bool):
            try:
                return self.kind(value)
            except ValueError:
                pass
        return super().adapted(value)


class _Interface(Rule):
    """A class that is a Protocol: every object with its members will do."""

    def __init__(self, kind: type):
        self.wanted = f"a {kind.__name__}"
        self.members = [name for name in {**kind.__annotations__, **vars(kind)} if not name.startswith("_")]

    def take(self, value: Any) -> Any:
        return value if all(hasattr(value, name) for name in self.members) else self.adapted(value)


class _Array(Rule):
    """Numbers or flags, in an array or in lists; of a ``kind``, only those."""

    wanted = "numbers"
    kind: type | None = None
    arrays = KINDS[None]

    def take(self, value: Any) -> Any:
        if isinstance(value, np.ndarray):
            array = value
        elif isinstance(value, Real):
            return _WHOLE.take(value) if isinstance(value, int) and not isinstance(value, bool) else value
        else:
            try:
                array = np.asarray(value)
            except (TypeError, ValueError, OverflowError):
                raise Mismatch("rows of different lengths, or not numbers", self.wanted) from None
        if array.dtype.kind not in self.arrays and (array.size or array.dtype.kind not in NUMERIC):
            problem = _shown(value) if array.dtype.kind == "O" or not array.ndim else f"dtype {array.dtype}"
            raise Mismatch(problem, {int: "whole numbers", bool: "flags"}.get(self.kind, self.wanted))
        return array


class _Items(Rule):
    """Several values, each as ``rule`` has it, or by turns as ``each`` have them: a tuple where one is declared, no array."""

    def __init__(self, kind: type, rule: Rule | None = None, each: tuple[Rule | None, ...] | None = None):
        self.kind, self.rule, self.each = kind, rule, each
        inner = rule or (each and each[0])
        what = f"each {inner.wanted}" if inner else "of values"
        self.wanted = f"{len(each)} values, {what}" if each is not None else f"a list, {what}"

    def take(self, value: Any) -> Any:
        if isinstance(value, str | bytes | Mapping) or not isinstance(value, Iterable) or getattr(value, "shape", None) == ():
            raise Mismatch(_shown(value), self.wanted)
        items = value if hasattr(value, "__len__") and hasattr(value, "__getitem__") else list(value)
        if self.each is not None and len(items) != len(self.each):
            raise Mismatch(f"{len(items)} values", self.wanted)
        rules = self.each or (self.rule,) * len(items)
        found = [item if rule is None else rule.take(item) for rule, item in zip(rules, items, strict=True)]
        if self.kind is tuple:
            return tuple(found)
        same = all(new is old for new, old in zip(found, items, strict=True)) and not isinstance(items, np.ndarray)
        return items if same else tuple(found) if isinstance(items, tuple) else found


class _Either(Rule):
    def __init__(self, rules: list[Rule]):
        self.rules = rules
        self.known = tuple(kind for rule in rules if type(rule).take is Rule.take for kind in rule.known)
        self.wanted = " or ".join(dict.fromkeys(rule.wanted for rule in rules))
        self.shapes = next((rule.shapes for rule in rules if rule.shapes), ())
        self.array = next((rule for rule in rules if isinstance(rule, _Array)), None)
        self.arrays = "" if self.array is None else self.array.arrays

    def adapted(self, value: Any) -> Any:
        # Their words only: an exception that is kept holds its frames, and with them the caller's arrays and results, until the
        # garbage collector comes.
        problems: list[str] = []
        for rule in self.rules:
            try:
                return rule.take(value)
            except Mismatch as wrong:
                problems.append(wrong.problem)
        raise Mismatch(max(problems, key=lambda problem: problem != _shown(value)), self.wanted)  # that says most


_NUMBER, _WHOLE = _Number(False), _Number(True)


def rule_of(annotation: Any) -> Rule | None:
    """None where any value will do."""
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _shaped(rule_of(parts[0]), parts[1].split("|"), *parts[2:])
    if origin in (Union, UnionType):
        every = set(parts)
        rules = [_Array()] if every >= ARRAY_PARTS or np.ndarray in every else []
        plain = [rule_of(part) for part in parts
                 if part is not np.ndarray and (part not in ARRAY_PARTS or not every >= ARRAY_PARTS)]
        return None if None in plain else _Either([rule for rule in plain if rule is not None] + rules)
    if annotation in (np.ndarray, ArrayLike):
        return _Array()
    if annotation in (Any, object):
        return None
    if annotation in (int, float):
        return _WHOLE if annotation is int else _NUMBER
    if annotation is bool:
        return _Flag()
    if origin is not None:
        return _of_several(origin, parts)
    return _Interface(annotation) if getattr(annotation, "_is_protocol", False) else _Instance(annotation)


def _of_several(origin: type, parts: tuple) -> Rule:
    if origin is Callable:
        return _Instance(Callable)
    if issubclass(origin, Mapping):
        return _Instance(Mapping)
    if origin is tuple and not (len(parts) == 2 and parts[1] is Ellipsis):
        return _Items(origin, each=tuple(rule_of(part) for part in parts))
    return _Items(origin, rule_of(parts[0])) if issubclass(origin, Iterable) else _Instance(origin)


def _shaped(rule: Rule, shapes: list[str], kind: type | None = None) -> Rule:
    """``rule`` with those shapes for its arrays, and their entries of that ``kind``."""
    if kind is not None:
        array = rule.array if isinstance(rule, _Either) else rule
        array.kind, array.arrays, rule.arrays = kind, KINDS[kind], KINDS[kind]
    rule.shapes = tuple(_Shape(words) for words in shapes)
    return rule


def _shown(value: Any) -> str:
    """A value in a message: itself where it is short, else its type."""
    if value is None or isinstance(value, str | Real):
        text = repr(value) if not isinstance(value, Integral) or abs(int(value)) < 1 << 200 else "a huge number"
        return text if len(text) <= MOST_SHOWN else f"{text[:MOST_SHOWN]}…"
    return f"a {type(value).__name__}"
