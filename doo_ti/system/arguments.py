"""Arguments of public functions and fields of public classes, checked by what their annotations say; and how objects that hold
arrays are printed, ``__repr__ = short_repr``: in one line, with shapes in place of numbers.

    @typed
    def straight_rod(length: float, edges: int, ...) -> Configuration:

    @typed
    @dataclass(frozen=True)
    class Configuration:
        start: Annotated[np.ndarray, "R 3"]
        rest_length: Annotated[np.ndarray, "E | R E"]

A wrong one raises InputError with the function or class, its name, its value and a remedy. Lists that are given for arrays
become arrays, numbers for members of an enumeration become these (:mod:`doo_ti.system.argument_rules`). Numbers out of range,
and shapes that need more than one object to judge, are for the function itself to refuse.
"""

from collections.abc import Callable
from dataclasses import fields
from functools import wraps
from inspect import Parameter, Signature, signature
from types import NoneType
from typing import Any, TypeVar, get_args, get_type_hints

import numpy as np

from doo_ti.system.argument_rules import ARRAY_PARTS, Mismatch, Rule, rule_of, shape_of
from doo_ti.system.errors import InputError

MOST_REMEMBERED = 1000  # sets of shapes of a function

_Target = TypeVar("_Target")


def typed(target: _Target, owned: bool = False) -> _Target:
    """``target`` with its arguments checked: a function, or a class, whose are those of its constructor."""
    if not isinstance(target, type):
        return _Checked(target, target.__qualname__, target, owned).wrapped
    # A dataclass's constructor has the annotations of its fields.
    annotated = target if hasattr(target, "__dataclass_fields__") else target.__init__
    target.__init__ = _Checked(target.__init__, target.__name__, annotated, owned).wrapped  # type: ignore[method-assign]
    return target


def owning(target: _Target) -> _Target:
    """A dataclass that is :func:`typed` and whose arrays are copies that cannot be written to."""
    return typed(target, True)


class _Checked:
    """A call whose arguments are checked; annotations are read with the first."""

    def __init__(self, call: Callable, source: str, annotated: Any, owned: bool):
        self.call, self.source, self.annotated = call, source, annotated
        self.rules: dict[str, Rule] = {}
        self.places: list[str] = []
        self.fitting: set[tuple] = set()  # of all shapes of a call, those that have been checked before

        @wraps(call)
        def wrapped(*arguments: Any, **options: Any) -> Any:
            if not self.places:
                self.read()
            shapes: list[tuple[str, tuple[int, ...]]] = []
            given = [self.taken(name, value, shapes) for name, value in zip(self.places, arguments, strict=False)]
            options = {name: self.taken(name, value, shapes) for name, value in options.items()}
            if shapes and (together := tuple(shapes)) not in self.fitting:
                self.check_shapes(together)
            result = call(*given, *arguments[len(given):], **options)
            if owned:
                _own_arrays(arguments[0])
            return result

        wrapped.__signature__ = _readable(signature(call))  # type: ignore[attr-defined]
        self.wrapped = wrapped

    def read(self) -> None:
        hints = get_type_hints(self.annotated, include_extras=True)
        parameters = signature(self.call).parameters.values()
        named = [one.name for one in parameters if one.kind in (Parameter.POSITIONAL_OR_KEYWORD, Parameter.KEYWORD_ONLY)]
        self.rules = {name: rule for name in named if name in hints and (rule := rule_of(hints[name])) is not None}
        self.places = [one.name for one in parameters if one.kind == Parameter.POSITIONAL_OR_KEYWORD] or [""]

    def check_shapes(self, shapes: tuple[tuple[str, tuple[int, ...]], ...]) -> None:
        """Raise InputError unless the arrays of a call have the shapes that their annotations state."""
        sizes: dict[str, int] = {}
        given = dict(shapes)
        for name, shape in ((name, given[name]) for name in self.rules if name in given):
            wanted = self.rules[name].shapes
            if not any(one.fits(shape, sizes) for one in wanted):
                known = ", ".join(f"{letter} = {size}" for letter, size in sizes.items())
                words = " or ".join(one.words for one in wanted)
                raise InputError(self.source, name, f"shape {shape}", f"give {words}" + f" with {known}" * bool(known))
        if len(self.fitting) < MOST_REMEMBERED:
            self.fitting.add(shapes)

    def taken(self, name: str, value: Any, shapes: list[tuple[str, tuple[int, ...]]]) -> Any:
        """What the call is given for ``value``, whose shape is added to ``shapes``. Raises InputError."""
        rule = self.rules.get(name)
        if rule is None:
            return value
        if type(value) is np.ndarray and value.dtype.kind in rule.arrays:  # as nearly always
            if rule.shapes:
                shapes.append((name, value.shape))
            return value
        try:
            value = rule.take(value)
        except Mismatch as wrong:
            raise InputError(self.source, name, wrong.problem, f"give {wrong.remedy}") from None
        if rule.shapes and value is not None:
            shapes.append((name, shape_of(value)))
        return value


def _own_arrays(made: Any) -> None:
    """Replace the arrays of a dataclass by copies that cannot be written to."""
    for name in made.__dataclass_fields__:
        value = getattr(made, name)
        if isinstance(value, np.ndarray):
            value = value.copy()
            value.setflags(write=False)
            object.__setattr__(made, name, value)


# --- printing ------------------------------------------------------------------------------------------------------------


def short_repr(self: object) -> str:
    """``EndLoads(start_force (60, 3), …, physical True)``: of each field of a dataclass the shape, or the value where it is
    short. Fields that are not printed by a dataclass are left out, and so are those that are None."""
    parts = []
    for entry in fields(self):  # type: ignore[arg-type]
        value = getattr(self, entry.name)
        if entry.repr and value is not None:
            parts.append(f"{entry.name} {_short(value)}")
    return f"{type(self).__name__}({', '.join(parts)})"


def _short(value: object) -> str:
    if isinstance(value, np.ndarray):
        return f"{value.shape}" if value.ndim else f"{value:g}"
    text = repr(value)
    return text if len(text) <= 60 else f"{len(value)} entries" if hasattr(value, "__len__") else type(value).__name__


class _Printed:
    """An annotation that is printed as this text."""

    def __init__(self, text: str):
        self.text = text

    def __repr__(self) -> str:
        return self.text


def _readable(found: Signature) -> Signature:
    """The signature with ``ArrayLike`` where the union stands that it is in some NumPy, and takes lines to print."""
    changed = []
    for one in found.parameters.values():
        parts = get_args(getattr(one.annotation, "__origin__", None)) or get_args(one.annotation)  # the first of Annotated
        if all(part in parts for part in ARRAY_PARTS):
            names = ("None" if part is NoneType else part.__name__ for part in parts if part not in ARRAY_PARTS)
            one = one.replace(annotation=_Printed(" | ".join(["ArrayLike", *names])))
        changed.append(one)
    return found.replace(parameters=changed)


def span_text(values: np.ndarray, unit: str = "") -> str:
    """``6e+05 mm³``, or ``1e+05 to 3e+05 mm³`` where values differ."""
    low, high = (f"{value:.4g}" for value in (np.min(values), np.max(values)))
    return (low if low == high else f"{low} to {high}") + f" {unit}" * bool(unit)


def counted(count: int, what: str) -> str:
    """``1 rod``, ``60 rods``."""
    return f"{count} {what}{'s' * (count != 1)}"
