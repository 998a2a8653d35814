"""Kernels of small dense problems, one for each rod: normal equations, inverses of positive definite matrices, and steps of
damped least squares.

Symmetric matrices lie in scratch as their lower triangles, row by row. Axes: B rods, K unknowns of each.
"""

from functools import cache, partial
from types import SimpleNamespace

import numpy as np
import taichi as ti

from doo_ti.physics.algebra import largest_of
from doo_ti.physics.number import NUMBERS, Number, Scratch
from doo_ti.physics.tuples import picked, record, variable
from doo_ti.relaxation.batch import laid_out, layout_for
from doo_ti.relaxation.kernel_factory import SCRATCH, TABLE1, loop_kernel
from doo_ti.system import runtime

LEAST_DAMPING = 1e-4
"""mm² by which the square of the rod's displacement must grow with a gripper's move of 1 mm: moves that change less are damped.
Ten times as much leaves small rotations undone, a tenth follows the noise of the marks."""
ITERATIONS, CLOSE = 50, 1e-6
"""The search for the damping ends when a step's length is right to the share CLOSE, usually within ten iterations, or after
ITERATIONS."""
LEAST_LENGTH = 1e-12  # mm, in place of zero in that search


@ti.data_oriented
class RodByRod:
    """What each thread does with its share of the rods, a pack at a time. ``given`` is the record of a kernel's arguments: the
    ``arrays``, which hold the numbers of one rod after those of the one before, and ``further`` whole numbers."""

    name: str
    arrays: tuple[str, ...]
    further: tuple[str, ...] = ()

    def __init__(self, number: Number, stride: int):
        self.width, self.scratch, lanes = number.width, Scratch(number, stride), number.lanes()
        self.gather, self.lane, self.largest, self.constant = lanes.gather, lanes.lane, lanes.largest, lanes.constant

    @ti.func
    def work(self, given, thread):
        packs = (given.count + self.width - 1) // self.width
        share = (packs + given.threads - 1) // given.threads
        for pack in range(thread * share, ti.min((thread + 1) * share, packs)):
            own = self.scratch.of_thread(given.scratch, thread, NUMBERS, self.needed(given.size))
            self.solve(given, own, self.rods(given, pack))

    @picked
    def rods(self, given, pack):
        """The numbers of the rods in the lanes of a pack; in lanes to spare that of the last one."""
        return variable(ti.min(pack * self.width + slot, given.count - 1) for slot in range(self.width))

    @picked
    def loaded(self, array, rods, size, k):
        """Number ``k`` of the ``size`` that each rod has."""
        return self.gather(array, variable(rod * size + k for rod in rods))

    @ti.func
    def stored(self, array: ti.template(), rods, size, k, value):
        for slot in ti.static(range(self.width)):
            array[rods[slot] * size + k] = self.lane(value, slot)

    @ti.func
    def load_matrix(self, array: ti.template(), own, rods, size):
        """The lower triangle of each rod's matrix (K, K) to the first place in scratch."""
        for i in range(size):
            line = self.line(own, i)
            for j in range(i + 1):
                line[j] = self.loaded(array, rods, size * size, size * i + j)

    @picked
    def line(self, own, i):
        """Row ``i`` of a triangle."""
        return own.part(NUMBERS, i * (i + 1) // 2)


@ti.data_oriented
class NormalEquations(RodByRod):
    """JᵀWJ and JᵀWr of rows that come in threes, the coordinates of a vertex, with one weight. J are the first ``size`` of the
    columns from ``first`` on; there are ``wide`` of them."""

    name, further = "normal_equations", ("vertices", "wide", "first")
    arrays = ("columns", "weight", "residual", "normal", "right")

    @picked
    def needed(self, size):
        """Numbers in scratch: the matrix, the right-hand side, and three rows of J."""
        return size * (size + 1) // 2 + 4 * size

    @ti.func
    def solve(self, given, own, rods):
        size, zero = given.size, self.constant(0.0)
        triangle = size * (size + 1) // 2
        right = own.part(NUMBERS, triangle)
        for k in range(triangle + size):
            own[k] = zero
        for v in range(given.vertices):
            weight = self.loaded(given.weight, rods, given.vertices, v)
            if self.largest(weight) > 0.0:
                self.add(given, own, right, rods, v, weight)
        for i in range(size):
            self.stored(given.right, rods, size, i, right[i])
            for j in range(i + 1):
                value = self.line(own, i)[j]
                self.stored(given.normal, rods, size * size, size * i + j, value)
                self.stored(given.normal, rods, size * size, size * j + i, value)

    @ti.func
    def add(self, given, own, right, rods, v, weight):
        """The three rows of vertex ``v``."""
        size, numbers = given.size, 3 * given.vertices
        x, y, z = right.part(NUMBERS, size), right.part(NUMBERS, 2 * size), right.part(NUMBERS, 3 * size)
        row = 3 * v * given.wide + given.first
        for k in range(size):
            x[k] = self.loaded(given.columns, rods, numbers * given.wide, row + k)
            y[k] = self.loaded(given.columns, rods, numbers * given.wide, row + given.wide + k)
            z[k] = self.loaded(given.columns, rods, numbers * given.wide, row + 2 * given.wide + k)
        apart = (self.loaded(given.residual, rods, numbers, 3 * v), self.loaded(given.residual, rods, numbers, 3 * v + 1),
                 self.loaded(given.residual, rods, numbers, 3 * v + 2))
        for i in range(size):
            line, a, b, c = self.line(own, i), weight * x[i], weight * y[i], weight * z[i]
            right[i] = right[i] + a * apart[0] + b * apart[1] + c * apart[2]
            for j in range(i + 1):
                line[j] = line[j] + a * x[j] + b * y[j] + c * z[j]


@ti.data_oriented
class Inverses(RodByRod):
    """A⁻¹ by sweeping one pivot after the other (Goodnight, *A tutorial on the SWEEP operator*, 1979)."""

    name, arrays = "invert", ("matrices", "inverses")

    @picked
    def needed(self, size):
        """Numbers in scratch."""
        return size * (size + 1) // 2 + size

    @ti.func
    def solve(self, given, own, rods):
        size = given.size
        self.load_matrix(given.matrices, own, rods, size)
        column = own.part(NUMBERS, size * (size + 1) // 2)
        for k in range(size):
            pivot = 1.0 / self.line(own, k)[k]
            for i in range(size):
                column[i] = self.line(own, ti.max(i, k))[ti.min(i, k)]
            column[k] = 0.0 * pivot
            for i in range(size):
                line, factor = self.line(own, i), column[i] * pivot
                for j in range(i + 1):
                    line[j] = line[j] - factor * column[j]
            for i in range(size):
                self.line(own, ti.max(i, k))[ti.min(i, k)] = column[i] * pivot
            self.line(own, k)[k] = 0.0 - pivot
        for i in range(size):
            for j in range(i + 1):
                value = 0.0 - self.line(own, i)[j]
                self.stored(given.inverses, rods, size * size, size * i + j, value)
                self.stored(given.inverses, rods, size * size, size * j + i, value)


@ti.data_oriented
class DampedLeastSquares(RodByRod):
    """u of min |e − J u|² + λ |u|², with λ so large that |u| is at most a given length, and with a·u = c where a·u would be
    more (one active constraint). JᵀJ is ``normal``, Jᵀe ``gradient``, a ``across`` and c ``room``.

    Newton's method on 1/|u| − 1/length, which is nearly linear in λ and grows with it (Hebden, 1973): from below it never steps
    too far. Where the constraint holds, only the part of u across it, r = u − c a/|a|², becomes shorter as λ grows.
    """

    name, arrays = "step", ("normal", "gradient", "length", "across", "room", "steps")

    @picked
    def needed(self, size):
        """Numbers in scratch: JᵀJ and its factors, Jᵀe, a, u, (JᵀJ + λ)⁻¹ a, and (JᵀJ + λ)⁻¹ u."""
        return size * (size + 1) + 5 * size

    @picked
    def vector(self, own, size, place):
        """One of the five vectors in scratch."""
        return own.part(NUMBERS, size * (size + 1) + place * size)

    @ti.func
    def solve(self, given, own, rods):
        size = given.size
        self.load_matrix(given.normal, own, rods, size)
        across = self.vector(own, size, 1)
        square = self.constant(0.0)
        for k in range(size):
            self.vector(own, size, 0)[k] = self.loaded(given.gradient, rods, size, k)
            across[k] = self.loaded(given.across, rods, size, k)
            square = square + across[k] * across[k]
        length, room = self.loaded(given.length, rods, 1, 0), self.loaded(given.room, rods, 1, 0)
        held = record(active=0.0 * length, place=room / largest_of(square, 0.0 * square + 1e-30), longest=length,
                      excess=0.0 * length)
        self.search(own, size, held)
        more = ti.select(self.dot(own, size, 1, 2) > room, 0.0 * length + 1.0, 0.0 * length)
        if self.largest(more) > 0.5:
            held.active = more
            held.longest = ti.sqrt(largest_of(length * length - more * held.place * room, 0.0 * length))
            self.search(own, size, held)
        for k in range(size):
            fixed = held.active * held.place * across[k]
            step = self.shortened(own, size, held, k) + fixed
            self.stored(given.steps, rods, size, k, ti.select(length > 0.0, step, 0.0 * step))

    @ti.func
    def search(self, own, size, held):
        """Find the damping; leave the step in the third vector, and how far it exceeds the longest in ``held.excess``."""
        longest = largest_of(held.longest, 0.0 * held.longest + LEAST_LENGTH)
        damping = 0.0 * longest + LEAST_DAMPING
        left, longer = ITERATIONS, 0.0 * longest + 1.0
        while left > 0 and self.largest(longer) > 0.5:
            left -= 1
            self.factor(own, size, damping)
            self.solved(own, size, 0, 2)
            self.solved(own, size, 1, 3)
            closed = self.dot(own, size, 1, 3)
            share = held.active / ti.select(closed > 0.0, closed, 0.0 * closed + 1.0)
            force = share * (self.dot(own, size, 1, 2) - held.place * self.dot(own, size, 1, 1))
            step, solved, along = self.vector(own, size, 2), self.vector(own, size, 4), self.vector(own, size, 3)
            for k in range(size):
                step[k] = step[k] - force * along[k]
                solved[k] = step[k]
            self.solved(own, size, 4, 4)
            force = share * self.dot(own, size, 1, 4)
            squared, slope = 0.0 * longest, 0.0 * longest
            for k in range(size):
                across_limit = step[k] - held.active * held.place * self.vector(own, size, 1)[k]
                squared = squared + across_limit * across_limit
                slope = slope + across_limit * (solved[k] - force * along[k])
            length = largest_of(ti.sqrt(squared), 0.0 * squared + 1e-30)
            longer = ti.select(length > (1.0 + CLOSE) * longest, 0.0 * length + 1.0, 0.0 * length)
            slope = ti.select(longer > 0.5, slope / (length * length), 0.0 * slope + 1.0)
            damping = damping + longer * (length / longest - 1.0) / slope
            held.excess = length / longest

    @ti.func
    def shortened(self, own, size, held, k):
        """Number ``k`` of the step across the constraint, no longer than it may be."""
        rest = self.vector(own, size, 2)[k] - held.active * held.place * self.vector(own, size, 1)[k]
        return rest / largest_of(held.excess, 0.0 * rest + 1.0)

    @ti.func
    def factor(self, own, size, damping):
        """L of L Lᵀ = JᵀJ + λ, with the inverses of its diagonal in their places."""
        factors = own.part(NUMBERS, size * (size + 1) // 2)
        for i in range(size):
            line, given = self.line(factors, i), self.line(own, i)
            for j in range(i + 1):
                other, value = self.line(factors, j), given[j]
                if i == j:
                    value = value + damping
                for k in range(j):
                    value = value - line[k] * other[k]
                if i == j:
                    line[j] = 1.0 / ti.sqrt(value)
                else:
                    line[j] = value * other[j]

    @ti.func
    def solved(self, own, size, source, target):
        """(L Lᵀ)⁻¹ of one vector into the place of another, or of itself."""
        factors = own.part(NUMBERS, size * (size + 1) // 2)
        right, x = self.vector(own, size, source), self.vector(own, size, target)
        for i in range(size):
            line, value = self.line(factors, i), right[i]
            for k in range(i):
                value = value - line[k] * x[k]
            x[i] = value * line[i]
        for back in range(size):
            i = size - 1 - back
            value = x[i]
            for k in range(i + 1, size):
                value = value - self.line(factors, k)[i] * x[k]
            x[i] = value * self.line(factors, i)[i]

    @ti.func
    def dot(self, own, size, first, second):
        """The product of two of the vectors."""
        total = self.constant(0.0)
        for k in range(size):
            total = total + self.vector(own, size, first)[k] * self.vector(own, size, second)[k]
        return total


@cache
def dense_kernel(kind: type[RodByRod], number: Number, stride: int, block: int):
    """The kernel of that ``kind``, as :func:`doo_ti.relaxation.newton.newton_kernel`."""
    rods, whole = kind(number, stride), ti.i32
    arguments = dict.fromkeys(kind.arrays, TABLE1) | {"count": whole, "size": whole, "threads": whole, "scratch": SCRATCH}
    arguments |= dict.fromkeys(kind.further, whole)
    return loop_kernel(kind.name, number, arguments, rods.work, block), lambda given: rods.needed(given.size)


@runtime.exclusive
def _run(kind: type[RodByRod], count: int, size: int, *arrays: np.ndarray, further: tuple[int, ...] = ()) -> None:
    """Launch the kernel of that ``kind`` over ``count`` rods."""
    kernel, threads, scratch, _ = laid_out(layout_for(count, 64), partial(dense_kernel, kind), SimpleNamespace(size=size))
    kernel(*(array.reshape(-1) for array in arrays), count, size, threads, scratch, *further)


def normal_equations(columns: np.ndarray, first: int, size: int, weight: np.ndarray, residual: np.ndarray
                     ) -> tuple[np.ndarray, np.ndarray]:
    """(B, K, K) JᵀWJ and (B, K) JᵀWr for the K = ``size`` columns from ``first`` on of ``columns`` (B, V, 3, C), ``weight``
    (B, V) and r = ``residual`` (B, V, 3)."""
    count, vertices, _, wide = columns.shape
    normal, right = np.empty((count, size, size)), np.empty((count, size))
    if right.size:
        arrays = map(np.ascontiguousarray, (columns, weight, residual))
        _run(NormalEquations, count, size, *arrays, normal, right, further=(vertices, wide, first))
    return normal, right


def inverses(matrices: np.ndarray) -> np.ndarray:
    """(B, K, K) inverses of symmetric, positive definite ``matrices`` (B, K, K)."""
    matrices = np.ascontiguousarray(matrices)
    found = np.empty_like(matrices)
    if matrices.size:
        _run(Inverses, *matrices.shape[:2], matrices, found)
    return found


def damped_steps(normal: np.ndarray, gradient: np.ndarray, length: np.ndarray, across: np.ndarray, room: np.ndarray
                 ) -> np.ndarray:
    """(B, K) u of :class:`DampedLeastSquares`, zero where ``length`` (B,) is; ``normal`` (B, K, K), ``gradient`` and ``across``
    (B, K), ``room`` (B,)."""
    steps = np.empty_like(gradient)
    if steps.size:
        _run(DampedLeastSquares, *gradient.shape, *map(np.ascontiguousarray, (normal, gradient, length, across, room)), steps)
    return steps
