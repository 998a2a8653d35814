"""The values that kernels compute with, one number for each of one or several rods, and scratch memory by name, which is what a
thread of a kernel keeps of its rods.

On a CPU a value is a pack of lanes, one rod in each, so that the vector unit works on all of them at once; on a GPU, and as
the fallback, it is a scalar and every thread has a rod of its own. The rest of the kernels is the same for both.

A :class:`Layout` declares names of numbers that follow each other. In a kernel a :class:`View` of a place in scratch has them
as attributes: ``edge.length`` is a number, ``edge.frame`` a tuple of four, and either may be assigned; ``view[k]`` is number
``k``. :class:`Scratch` alone knows how far apart numbers lie. All of this happens while a kernel is compiled; what is left of
it in the kernel are reads and writes.
"""

from dataclasses import dataclass
from functools import cache, wraps

import taichi as ti
from taichi.lang.expr import Expr
from taichi.lang.impl import expr_init, subscript
from taichi.lang.kernel_impl import Func

from doo_ti.physics.tuples import picked, traced


@dataclass(frozen=True)
class Number:
    """``width`` rods in a value of ``bits``-bit floating point; its methods are functions of values in kernels."""

    width: int
    bits: int

    @property
    def scalar(self):
        """The Taichi type of one lane."""
        return ti.f32 if self.bits == 32 else ti.f64

    @property
    def type(self):
        """The Taichi type of a value."""
        return self.scalar if self.width == 1 else _pack(self.width, self.scalar)

    @traced
    def largest(self, value):
        """The largest lane of numbers above -1e30. NaN is ignored: use it for flags only."""
        if self.width == 1:
            return value
        # By halves: a pack's own ``max`` goes from lane to lane, which takes four times as long.
        value, width = expr_init(value), self.width
        value = expr_init(ti.select(value == value, value, self.type(-1e30)))
        while width > 2:
            width //= 2
            half = _pack(width, self.scalar)
            first, second = (half([subscript(None, value, begin + k) for k in range(width)]) for begin in (0, width))
            value = expr_init(ti.select(first < second, second, first))
        first, second = subscript(None, value, 0), subscript(None, value, 1)
        return ti.select(first < second, second, first)

    @traced
    def lane(self, value, index):
        """The number in one lane."""
        return value if self.width == 1 else subscript(None, value, index)

    @traced
    def with_lane(self, value, index, new):
        """The value with one lane replaced."""
        if self.width == 1:
            return ti.cast(new, self.scalar)
        # Not by a store into that lane: to read the pack back would wait for it.
        numbered = self.type([float(place) for place in range(self.width)])
        return ti.select(numbered == ti.cast(index, self.scalar), self.constant(new), value)

    @traced
    def constant(self, value):
        """The same number in every lane."""
        value = ti.cast(value, self.scalar)
        return value if self.width == 1 else self.type(value)


@cache
def _pack(width: int, scalar):
    return ti.types.vector(width, scalar)


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


NUMBERS = Layout(one=1, two=("one", 2), three=("one", 3), four=("one", 4))  # of numbers without names: the first ones


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
    """How the numbers of a thread lie in scratch: values of that ``number``, one ``stride`` apart."""

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


def device_functions(cls):
    """``cls`` for kernels: its methods are Taichi functions, as by ``ti.func``, but for those that are :func:`picked` or
    :func:`traced`, and for those that Python itself calls."""
    for name, method in list(vars(cls).items()):
        if isinstance(method, type(picked)) and not name.startswith("__") and not hasattr(method, "_is_wrapped_kernel"):
            setattr(cls, name, _device_function(method))
    return ti.data_oriented(cls)


def _device_function(method):
    """What ``ti.func`` makes of a method; that looks for the class where it is called."""
    compiled = Func(method, _classfunc=True)

    @wraps(method)
    def call(*arguments, **options):
        return compiled(*arguments, **options)

    call._is_taichi_function, call._is_real_function, call.func = True, False, compiled
    return call
