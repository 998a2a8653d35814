"""L D Lᵀ of a dense symmetric matrix of 3×3 blocks in scratch, whose lower triangle lies there row by row (docs/contact.md)."""

import taichi as ti

from doo_ti.physics.algebra import factor_in_turn
from doo_ti.physics.tuples import minus, plus, repeated, scaled, traced, variable

COLUMNS = 4
"""Of the right-hand side: that of the step and the three of closure."""


@traced
def minus_product(m, a, b) -> tuple:
    """M − a bᵀ, row by row."""
    return tuple(m[3 * r + c] - a[r] * b[c] for r in range(3) for c in range(3))


@ti.data_oriented
class DenseFactors:
    """The matrix, its factors and the right-hand sides of rods whose contacts are :class:`.SelfContacts`: a class to derive
    from beside a :class:`.Chain`."""

    # --- places in scratch, behind the matrix ---

    @ti.func
    def lines(self, rod):
        """Of 3×3 blocks: one for the place of vertex 0 and one for the rotation of each edge."""
        return rod.edges + 1

    @ti.func
    def unknowns(self, rod):
        """Numbers of a step."""
        return 3 * self.lines(rod)

    @ti.func
    def behind_matrix(self, rod):
        size = self.unknowns(rod)
        return self.contacts.matrix_at(rod) + size * (size + 1) // 2 * self.stride

    @ti.func
    def eliminated(self, rod, column):
        """Three numbers of the three rows that are being eliminated, in one column."""
        return self.behind_matrix(rod) + 3 * column * self.stride

    @ti.func
    def pivot(self, rod, line):
        """The inverse of a pivot."""
        return self.behind_matrix(rod) + (3 * self.unknowns(rod) + line) * self.stride

    @ti.func
    def side(self, rod, line):
        """A row of the right-hand side."""
        return self.behind_matrix(rod) + (4 * self.unknowns(rod) + COLUMNS * line) * self.stride

    @ti.func
    def load_block(self, rod, line, column):
        """Block of the lower triangle, off the diagonal, row by row."""
        first, second, third = (self.contacts.block(rod, line, column, 0), self.contacts.block(rod, line, column, 1),
                                self.contacts.block(rod, line, column, 2))
        return self.load3(rod.scratch, first) + self.load3(rod.scratch, second) + self.load3(rod.scratch, third)

    @ti.func
    def load_diagonal(self, rod, line):
        """Block on the diagonal, six numbers."""
        first, second, third = (self.contacts.block(rod, line, line, 0), self.contacts.block(rod, line, line, 1),
                                self.contacts.block(rod, line, line, 2))
        last = self.load3(rod.scratch, third)
        below = rod.scratch[second]
        return (rod.scratch[first], below, last[0], rod.scratch[second + self.stride], last[1], last[2])

    @ti.func
    def store_block(self, rod, line, column, values):
        for r in ti.static(range(3)):
            at = self.contacts.block(rod, line, column, r)
            self.store(rod.scratch, at, (values[3 * r], values[3 * r + 1], values[3 * r + 2]))

    @ti.func
    def store_diagonal(self, rod, line, values):
        self.store(rod.scratch, self.contacts.block(rod, line, line, 0), (values[0],))
        self.store(rod.scratch, self.contacts.block(rod, line, line, 1), (values[1], values[3]))
        self.store(rod.scratch, self.contacts.block(rod, line, line, 2), (values[2], values[4], values[5]))

    # --- the factors ---

    @ti.func
    def factor_rows(self, rod, found):
        """L D Lᵀ in the place of the matrix, three rows after three."""
        for p in range(self.lines(rod)):
            for q in range(p):
                self.eliminate_block(rod, p, q)
            rest = variable(self.load_diagonal(rod, p))
            lines = (self.contacts.block(rod, p, 0, 0), self.contacts.block(rod, p, 0, 1), self.contacts.block(rod, p, 0, 2))
            for k in range(3 * p):
                own = self.load3(rod.scratch, self.eliminated(rod, k))
                low = scaled(own, rod.scratch[self.pivot(rod, k)])
                for r in ti.static(range(3)):
                    rod.scratch[lines[r] + k * self.stride] = low[r]
                rest = (rest[0] - own[0] * low[0], rest[1] - own[0] * low[1], rest[2] - own[0] * low[2],
                        rest[3] - own[1] * low[1], rest[4] - own[1] * low[2], rest[5] - own[2] * low[2])
            f = factor_in_turn(rest)
            found.negative = found.negative + f[6]
            for r in ti.static(range(3)):
                rod.scratch[self.pivot(rod, 3 * p + r)] = f[r]
            self.store_diagonal(rod, p, (f[0], f[3], f[4], f[1], f[5], f[2]))

    @ti.func
    def eliminate_block(self, rod, p, q):
        """L D of block (p, q)."""
        rest = variable(self.load_block(rod, p, q))
        lines = (self.contacts.block(rod, q, 0, 0), self.contacts.block(rod, q, 0, 1), self.contacts.block(rod, q, 0, 2))
        for k in range(3 * q):
            own = self.load3(rod.scratch, self.eliminated(rod, k))
            low = (rod.scratch[lines[0] + k * self.stride], rod.scratch[lines[1] + k * self.stride],
                   rod.scratch[lines[2] + k * self.stride])
            rest = minus_product(rest, own, low)
        f = self.load_diagonal(rod, q)  # (1/d1, l21, l31, 1/d2, l32, 1/d3)
        for r in ti.static(range(3)):
            first = rest[3 * r]
            second = rest[3 * r + 1] - first * f[1]
            third = rest[3 * r + 2] - first * f[2] - second * f[4]
            at = self.eliminated(rod, 3 * q) + r * self.stride
            rod.scratch[at] = first
            rod.scratch[at + 3 * self.stride] = second
            rod.scratch[at + 6 * self.stride] = third

    @ti.func
    def entry(self, rod, line, column):
        """Where an entry of L is."""
        return self.contacts.matrix_at(rod) + (line * (line + 1) // 2 + column) * self.stride

    @ti.func
    def solve_forward(self, rod):
        """L⁻¹ of the right-hand sides, in their place; returns what closure needs: Aᵀ H⁻¹ A and Aᵀ H⁻¹ b."""
        zero = 0.0 * rod.total
        schur, right = variable(repeated(zero, 6)), variable(repeated(zero, 3))
        for line in range(self.unknowns(rod)):
            y = variable(self.load4(rod.scratch, self.side(rod, line)))
            at = self.entry(rod, line, 0)
            for k in range(line):
                y = minus(y, scaled(self.load4(rod.scratch, self.side(rod, k)), rod.scratch[at + k * self.stride]))
            self.store(rod.scratch, self.side(rod, line), y)
            inverse = rod.scratch[self.pivot(rod, line)]
            a = (y[1], y[2], y[3])
            d = scaled(a, inverse)
            schur = plus(schur, (a[0] * d[0], a[0] * d[1], a[0] * d[2], a[1] * d[1], a[1] * d[2], a[2] * d[2]))
            right = plus(right, scaled(d, y[0]))
        return schur, right

    @ti.func
    def solve_backward(self, rod, change):
        """L⁻ᵀ D⁻¹ of the right-hand side of the step less those of closure times ``change``, in its place. Returns the Newton
        decrement."""
        size = self.unknowns(rod)
        decrement = 0.0 * rod.total
        for line in range(size):
            y = self.load4(rod.scratch, self.side(rod, line))
            closed = y[0] - y[1] * change[0] - y[2] * change[1] - y[3] * change[2]
            solved = closed * rod.scratch[self.pivot(rod, line)]
            decrement = decrement + closed * solved
            rod.scratch[self.side(rod, line)] = solved
        for back in range(size):
            line = size - 1 - back
            solved = rod.scratch[self.side(rod, line)]
            at = self.entry(rod, line, 0)
            for k in range(line):
                place = self.side(rod, k)
                rod.scratch[place] = rod.scratch[place] - solved * rod.scratch[at + k * self.stride]
        return decrement

    @ti.func
    def solution(self, rod, block):
        """Three of the unknowns."""
        return (rod.scratch[self.side(rod, 3 * block)], rod.scratch[self.side(rod, 3 * block + 1)],
                rod.scratch[self.side(rod, 3 * block + 2)])
