"""Scratch memory by name: what a thread of a kernel keeps of its rods.

A :class:`Layout` declares names of numbers that follow each other. In a kernel a :class:`View` of a place in scratch has them
as attributes: ``edge.length`` is a number, ``edge.frame`` a tuple of four, and either may be assigned; ``view[k]`` is number
``k``. :class:`Scratch` alone knows how far apart numbers lie. All of this happens while a kernel is compiled; what is left of
it in the kernel are reads and writes.
"""

import taichi as ti
from taichi.lang.expr import Expr
from taichi.lang.impl import expr_init, subscript

from doo_ti.physics.number import Number
from doo_ti.physics.tuples import picked, traced


class Layout:
    """Names of numbers that follow each other, each with how many numbers it has, or with the layout of a part that has names
    of its own. A pair (other, count) names once more what begins where the name ``other`` does.

    ``size``, or len(layout), is how many numbers there are; ``first + then`` are those of both, one after the other.
    """

    def __init__(self, **shapes):
        self.shapes, self.places, self.size = shapes, {}, 0
        for name, shape in shapes.items():
            if isinstance(shape, tuple):
                self.places[name] = self.places[shape[0]][0], shape[1]
            else:
                self.places[name] = self.size, shape
                self.size += shape if isinstance(shape, int) else len(shape)

    def __len__(self) -> int:
        return self.size

    def __add__(self, then: "Layout") -> "Layout":
        return Layout(**self.shapes, **then.shapes)

    @picked
    def at(self, name: str) -> int:
        """The place of the first number of that name."""
        return self.places[name][0]


NUMBERS = Layout(one=1, two=("one", 2), three=("one", 3), four=("one", 4))
"""Of numbers without names: the first ones."""


class _Stored(tuple):
    """Numbers in scratch. Taichi reads them where they are given a name."""

    def _assign(self, values):
        for item, value in zip(self, values, strict=True):
            item._assign(value)


class _LaneNumber(Expr):
    """A number of one lane; what is assigned to it takes its precision."""

    scalar = None

    def _assign(self, value):
        return super()._assign(ti.cast(value, self.scalar))


class Scratch:
    """How the numbers of a thread lie in scratch: values of that ``number`` (:mod:`.physics.number`), one ``stride`` apart."""

    def __init__(self, number: Number, stride: int):
        self.width, self.scalar, self.stride = number.width, number.scalar, stride

    def further(self, at, numbers):
        """The place so many numbers after ``at``."""
        if isinstance(numbers, int) and numbers == 0:
            return at
        return at + (numbers if isinstance(numbers, Expr) and self.stride == 1 else numbers * self.stride)

    @picked
    def view(self, array, at, layout: Layout) -> "View":
        """What lies in ``array`` from place ``at`` on."""
        return View(self, array, expr_init(at), layout)

    @picked
    def of_thread(self, array, thread, layout: Layout, numbers) -> "View":
        """What begins where the scratch of a thread does, where every thread has so many numbers."""
        return self.view(array, thread * numbers if self.stride == 1 else thread, layout)

    @picked
    def behind(self, array, threads, thread, before, layout: Layout, numbers) -> "View":
        """What begins where ``numbers`` more of a thread do, behind as many as ``before`` of each of all ``threads``."""
        return self.of_thread(array, thread, layout, numbers).part(layout, before * threads if self.stride == 1 else before)


def _unrelated(place):
    """``place``, which is not negative, unchanged, but computed so that the compiler no longer sees a multiple of a loop's
    counter in it.

    Where it does, LLVM optimises how the places of a loop are counted (loop strength reduction). The time for that grows faster
    than their number: a kernel of groups took four times as long to load, in every process.
    """
    return expr_init(place ^ (place >> 31))


class View:
    """The numbers of a layout at a place in scratch, of all rods in a pack or, with a ``slot``, of the rod in that lane."""

    _data_oriented = True  # so that Taichi passes it on as it is

    def __init__(self, scratch: Scratch, array, at, layout: Layout, slot=None):
        self._scratch, self._array, self._at, self._layout, self._slot = scratch, array, at, layout, slot

    def __getattr__(self, name: str):
        if name.startswith("_") or name not in self._layout.places:
            raise AttributeError(name)
        first, shape = self._layout.places[name]
        if isinstance(shape, Layout):
            return self.part(shape, first)
        if shape == 1:
            return self[first]
        return _Stored(self[first + k] for k in range(shape))

    def __getitem__(self, k):
        """Number ``k``."""
        value = subscript(None, self._array, self._scratch.further(self._at, k))
        if self._slot is None:
            return value
        if self._scratch.width > 1:
            value = subscript(None, value, self._slot)
        value = _LaneNumber(value)
        value.scalar = self._scratch.scalar
        return value

    @picked
    def part(self, layout: Layout, numbers) -> "View":
        """What begins so many numbers after this, in the same lane."""
        at = expr_init(self._scratch.further(self._at, numbers))
        if isinstance(numbers, Expr):
            at = _unrelated(at)
        return View(self._scratch, self._array, at, layout, self._slot)

    @picked
    def of(self, name: str) -> "View":
        """The numbers of that name as a view, in which they are called ``value``."""
        first, count = self._layout.places[name]
        return self.part(Layout(value=count), first)

    @picked
    def lane(self, slot) -> "View":
        """The same of the rod in one lane."""
        return View(self._scratch, self._array, self._at, self._layout, slot)


@traced
def read(array, *place, count: int = 3) -> tuple:
    """``count`` numbers of an array that follow each other from ``place`` on."""
    return tuple(subscript(None, array, *place[:-1], place[-1] + k if k else place[-1]) for k in range(count))


@picked
def write(array, *place, values) -> None:
    """Store ``values`` in an array, one after the other from ``place`` on."""
    for k, value in enumerate(values):
        subscript(None, array, *place[:-1], place[-1] + k if k else place[-1])._assign(value)


@traced
def in_f64(values):
    """A number, or several, in f64."""
    return tuple(ti.cast(value, ti.f64) for value in values) if isinstance(values, tuple) else ti.cast(values, ti.f64)
