"""The values that kernels compute with: one number for each of one or several rods.

On a CPU a value is a pack of lanes, one rod in each, so that the vector unit works on all of them at once; on a GPU, and as
the fallback, it is a scalar and every thread has a rod of its own. The rest of the kernels is the same for both.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import taichi as ti


@dataclass(frozen=True)
class Number:
    """``width`` rods in a value of ``bits``-bit floating point."""

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

    def lanes(self) -> "Lanes":
        """Access to single lanes, as Taichi functions."""
        return _scalar_lanes(self.scalar) if self.width == 1 else _pack_lanes(self.type, self.scalar)


@cache
def _pack(width: int, scalar):
    return ti.types.vector(width, scalar)


class Lanes(NamedTuple):
    """Functions of values and their lanes: see :func:`_pack_lanes`."""

    largest: Callable
    lane: Callable
    with_lane: Callable
    constant: Callable
    gather: Callable


def _scalar_lanes(scalar):
    @ti.func
    def largest(value):
        return value

    @ti.func
    def lane(value, index):
        return value

    @ti.func
    def with_lane(value, index, new):
        return ti.cast(new, scalar)

    @ti.func
    def constant(value):
        return ti.cast(value, scalar)

    @ti.func
    def gather(array: ti.template(), places):
        return ti.cast(array[places[0]], scalar)

    return Lanes(largest, lane, with_lane, constant, gather)


def _largest_of_halves(width: int, scalar):
    """The largest lane of a pack without NaN, by halves: its ``max`` goes from lane to lane, which takes four times as long."""

    @ti.func
    def of_two(value):
        return ti.select(value[0] < value[1], value[1], value[0])

    if width == 2:
        return of_two
    half = ti.types.vector(width // 2, scalar)
    of_half = _largest_of_halves(width // 2, scalar)

    @ti.func
    def of_halves(value):
        first = half([value[slot] for slot in ti.static(range(width // 2))])
        second = half([value[slot + width // 2] for slot in ti.static(range(width // 2))])
        return of_half(ti.select(first < second, second, first))

    return of_halves


def _pack_lanes(pack, scalar):
    numbered = tuple(float(place) for place in range(pack.n))
    least = -1e30
    of_halves = _largest_of_halves(pack.n, scalar)

    @ti.func
    def largest(value):
        """The largest lane of numbers above -1e30. NaN is ignored: use it for flags only."""
        return of_halves(ti.select(value == value, value, pack(least)))

    @ti.func
    def lane(value, index):
        """The number in one lane."""
        return value[index]

    @ti.func
    def with_lane(value, index, new):
        """The value with one lane replaced. Not by a store into that lane: to read the pack back would wait for it."""
        return ti.select(pack(numbered) == ti.cast(index, scalar), pack(ti.cast(new, scalar)), value)

    @ti.func
    def constant(value):
        """The same number in every lane."""
        return pack(value)

    @ti.func
    def gather(array: ti.template(), places):
        """The value whose lanes are an array's numbers at ``places``, one for each lane."""
        return pack([ti.cast(array[places[slot]], scalar) for slot in ti.static(range(pack.n))])

    return Lanes(largest, lane, with_lane, constant, gather)
