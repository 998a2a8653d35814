"""Vectors and matrices of up to nine numbers as tuples, with functions that Taichi runs while it compiles a kernel (those of
matrices: :mod:`.algebra`).

A kernel's numbers may be packs of lanes, of which Taichi builds no vectors. Vectors are therefore tuples of three numbers,
symmetric matrices of six, (11, 12, 13, 22, 23, 33), and matrices of nine, row by row. The functions here are plain Python: they
are called once, during compilation, and only what they build, expressions of single numbers, is part of the kernel.

A tuple cannot be assigned again, which loops need: :func:`variable` makes a :class:`Variable` of it that can, and
:func:`record` gives names to several.
"""

from collections.abc import Callable, Sequence
from functools import wraps

import taichi as ti
from taichi.lang.any_array import AnyArray
from taichi.lang.impl import expr_init


class _Numbers(Sequence):
    """Several numbers of a kernel, which names and functions share.

    (Not a ``tuple``: Taichi copies those number by number wherever one is given a name or passed to a function.)
    """

    _data_oriented = True  # so that Taichi passes it on as it is

    def __init__(self, items: tuple):
        self._items = items

    def __getitem__(self, place):
        return self._items[place]

    def __add__(self, other):
        return self._items + tuple(other)

    def __radd__(self, other):
        return tuple(other) + self._items

    def __len__(self):
        return len(self._items)


class _Evaluated(_Numbers):
    """Numbers that are variables of the kernel already and never change."""


class Variable(_Numbers):
    """Numbers that a kernel may assign again: ``g = plus(g, h)`` changes the items of ``g`` in place.

    To give it a second name copies nothing.
    """

    def _assign(self, values):
        if len(values) != len(self):
            raise ValueError(f"{len(values)} numbers for a variable of {len(self)}")
        # All values are read before the first is changed: they may be the variable's own, in another order.
        read = values if isinstance(values, _Evaluated) else expr_init(tuple(values))
        for item, value in zip(self._items, read, strict=True):
            item._assign(value)


def picked(function):
    """``function`` as one that kernels may call while they are compiled, for one that only arranges numbers."""
    function._is_wrapped_kernel = True  # so that Taichi calls it without a warning
    function._is_classkernel = False  # also where it is a method of a class of kernels
    return function


def traced(function):
    """``function`` as one that kernels may call while they are compiled; what it computes is evaluated once, in its place."""

    @picked
    @wraps(function)
    def call(*arguments, **options):
        value = expr_init(function(*arguments, **options))
        return _Evaluated(value) if isinstance(value, tuple) else value

    return call


def unevaluated(function):
    """A :func:`traced` function as one of expressions: what it computes is evaluated where it is used, each time."""
    return picked(function.__wrapped__)


@picked
def itemwise(*values) -> tuple:
    """``values`` to be assigned to a :class:`Variable` one by one: none depends on another item than its own."""
    return _Evaluated(values)


class Record:
    """Named variables of a kernel, numbers, :class:`Variable` and arrays, which are passed on and assigned by name."""

    _data_oriented = True

    def __init__(self, fields: dict):
        self.__dict__.update(fields)


@picked
def variable(values) -> Variable:
    """The tuple ``values``, to be assigned again."""
    return Variable(tuple(expr_init(value) for value in values))


@picked
def record(**fields) -> Record:
    """Variables named by the keywords; tuples among them may be assigned again."""
    kept = {}
    for name, value in fields.items():
        if isinstance(value, Sequence):
            kept[name] = Variable(tuple(expr_init(item) for item in value))
        else:
            kept[name] = value if isinstance(value, AnyArray) else expr_init(value)
    return Record(kept)


@picked
def extended(fields: Record, **more) -> Record:
    """``fields`` with more of them, arrays or numbers that do not change."""
    return Record({**fields.__dict__, **more})


def _reassign(fields, values: dict, changed: Callable) -> None:
    """Assign to the fields named in ``values`` what becomes of their numbers, one by one: ``changed`` (old, value)."""
    for name, value in values.items():
        field = getattr(fields, name)
        if isinstance(field, Sequence):
            field._assign(expr_init(tuple(changed(old, own) for old, own in zip(field, value, strict=True))))
        else:
            field._assign(changed(field, value))


@picked
def choose(fields, condition, **values) -> None:
    """Assign ``values`` to the fields of those names where the condition holds."""
    _reassign(fields, values, lambda old, new: ti.select(condition, new, old))


@picked
def add(fields, **values) -> None:
    """Add ``values`` to the fields of those names."""
    _reassign(fields, values, lambda old, more: old + more)


@picked
def put_lane(fields: Record, with_lane, slot, **values) -> None:
    """Lane ``slot`` of the fields of those names, by ``with_lane`` of :class:`doo_ti.physics.number.Number`."""
    _reassign(fields, values, lambda old, new: with_lane(old, slot, new))


# --- of any size ----------------------------------------------------------------------------------------------------


@picked
def repeated(value, count: int) -> tuple:
    """``count`` times the same number."""
    return (value,) * count


@traced
def plus(a, b) -> tuple:
    """a + b."""
    return tuple(x + y for x, y in zip(a, b, strict=True))


@traced
def minus(a, b) -> tuple:
    """a − b."""
    return tuple(x - y for x, y in zip(a, b, strict=True))


@traced
def negated(a) -> tuple:
    """−a."""
    return tuple(0.0 - x for x in a)


@traced
def scaled(a, s) -> tuple:
    """a s."""
    return tuple(x * s for x in a)


@traced
def chosen(condition, a, b) -> tuple:
    """The items of a where the condition holds, else those of b."""
    return tuple(ti.select(condition, x, y) for x, y in zip(a, b, strict=True))


@traced
def products(a, b) -> tuple:
    """The items of a times those of b."""
    return tuple(x * y for x, y in zip(a, b, strict=True))


# --- vectors of three -----------------------------------------------------------------------------------------------


@traced
def dot(a, b):
    """a·b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@traced
def cross(a, b) -> tuple:
    """a × b."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
