"""L D Lᵀ of a dense symmetric matrix of 3×3 blocks in scratch, whose lower triangle lies there row by row (docs/contact.md)."""

import taichi as ti

from doo_ti.physics.algebra import factor_in_turn, row
from doo_ti.physics.number import NUMBERS, device_functions
from doo_ti.physics.tuples import minus, plus, repeated, scaled, traced, variable

COLUMNS = 4  # of the right-hand side: that of the step and the three of closure


@traced
def minus_product(m, a, b) -> tuple:
    """M − a bᵀ, row by row."""
    return tuple(m[3 * r + c] - a[r] * b[c] for r in range(3) for c in range(3))


@device_functions
class DenseFactors:
    """The matrix, its factors and the right-hand sides of rods whose contacts are :class:`.SelfContacts`: a class to derive
    from beside a :class:`.Chain`."""

    # --- places in scratch, behind the matrix ---

    def lines(self, rod):
        """Of 3×3 blocks: one for the place of vertex 0 and one for the rotation of each edge."""
        return rod.edges + 1

    def unknowns(self, rod):
        """Numbers of a step."""
        return 3 * self.lines(rod)

    def behind_matrix(self, rod, numbers):
        """The view of what lies so many numbers behind the matrix."""
        size = self.unknowns(rod)
        return self.contacts.matrix(rod).part(NUMBERS, size * (size + 1) // 2 + numbers)

    def eliminated(self, rod, column):
        """Three numbers of the three rows that are being eliminated, in one column."""
        return self.behind_matrix(rod, 3 * column)

    def pivot(self, rod, line):
        """The inverse of a pivot."""
        return self.behind_matrix(rod, 3 * self.unknowns(rod) + line)

    def side(self, rod, line):
        """A row of the right-hand side."""
        return self.behind_matrix(rod, 4 * self.unknowns(rod) + COLUMNS * line)

    def rows_of(self, rod, line, column):
        """The three rows of a block of the lower triangle."""
        return (self.contacts.block(rod, line, column, 0), self.contacts.block(rod, line, column, 1),
                self.contacts.block(rod, line, column, 2))

    def load_block(self, rod, line, column):
        """Block of the lower triangle, off the diagonal, row by row."""
        first, second, third = self.rows_of(rod, line, column)
        return first.three + second.three + third.three

    def load_diagonal(self, rod, line):
        """Block on the diagonal, six numbers."""
        first, second, third = self.rows_of(rod, line, line)
        return (first[0], second[0], third[0], second[1], third[1], third[2])

    def store_block(self, rod, line, column, values):
        first, second, third = self.rows_of(rod, line, column)
        first.three, second.three, third.three = row(values, 0), row(values, 1), row(values, 2)

    def store_diagonal(self, rod, line, values):
        first, second, third = self.rows_of(rod, line, line)
        first.one = values[0]
        second.two = (values[1], values[3])
        third.three = (values[2], values[4], values[5])

    # --- the factors ---

    def factor_rows(self, rod, found):
        """L D Lᵀ in the place of the matrix, three rows after three."""
        for p in range(self.lines(rod)):
            for q in range(p):
                self.eliminate_block(rod, p, q)
            rest = variable(self.load_diagonal(rod, p))
            lines = self.rows_of(rod, p, 0)
            for k in range(3 * p):
                own = self.eliminated(rod, k).three
                low = scaled(own, self.pivot(rod, k).one)
                for r in ti.static(range(3)):
                    lines[r][k] = low[r]
                rest = (rest[0] - own[0] * low[0], rest[1] - own[0] * low[1], rest[2] - own[0] * low[2],
                        rest[3] - own[1] * low[1], rest[4] - own[1] * low[2], rest[5] - own[2] * low[2])
            f = factor_in_turn(rest)
            found.negative = found.negative + f[6]
            for r in ti.static(range(3)):
                self.pivot(rod, 3 * p + r).one = f[r]
            self.store_diagonal(rod, p, (f[0], f[3], f[4], f[1], f[5], f[2]))

    def eliminate_block(self, rod, p, q):
        """L D of block (p, q)."""
        rest = variable(self.load_block(rod, p, q))
        lines = self.rows_of(rod, q, 0)
        for k in range(3 * q):
            rest = minus_product(rest, self.eliminated(rod, k).three, (lines[0][k], lines[1][k], lines[2][k]))
        f = self.load_diagonal(rod, q)  # (1/d1, l21, l31, 1/d2, l32, 1/d3)
        for r in ti.static(range(3)):
            first = rest[3 * r]
            second = rest[3 * r + 1] - first * f[1]
            third = rest[3 * r + 2] - first * f[2] - second * f[4]
            columns = self.eliminated(rod, 3 * q)
            columns[r], columns[r + 3], columns[r + 6] = first, second, third

    def line(self, rod, line):
        """A row of L."""
        return self.contacts.matrix(rod).part(NUMBERS, line * (line + 1) // 2)

    def solve_forward(self, rod):
        """L⁻¹ of the right-hand sides, in their place; returns what closure needs: Aᵀ H⁻¹ A and Aᵀ H⁻¹ b."""
        zero = 0.0 * rod.total
        schur, right = variable(repeated(zero, 6)), variable(repeated(zero, 3))
        for line in range(self.unknowns(rod)):
            y, low = variable(self.side(rod, line).four), self.line(rod, line)
            for k in range(line):
                y = minus(y, scaled(self.side(rod, k).four, low[k]))
            self.side(rod, line).four = y
            inverse = self.pivot(rod, line).one
            a = (y[1], y[2], y[3])
            d = scaled(a, inverse)
            schur = plus(schur, (a[0] * d[0], a[0] * d[1], a[0] * d[2], a[1] * d[1], a[1] * d[2], a[2] * d[2]))
            right = plus(right, scaled(d, y[0]))
        return schur, right

    def solve_backward(self, rod, change):
        """L⁻ᵀ D⁻¹ of the step's right-hand side less ``change`` times closure's, in its place; returns the Newton decrement."""
        size = self.unknowns(rod)
        decrement = 0.0 * rod.total
        for line in range(size):
            y = self.side(rod, line).four
            closed = y[0] - y[1] * change[0] - y[2] * change[1] - y[3] * change[2]
            solved = closed * self.pivot(rod, line).one
            decrement = decrement + closed * solved
            self.side(rod, line).one = solved
        for back in range(size):
            line = size - 1 - back
            solved, low = self.side(rod, line).one, self.line(rod, line)
            for k in range(line):
                side = self.side(rod, k)
                side.one = side.one - solved * low[k]
        return decrement

    def solution(self, rod, block):
        """Three of the unknowns."""
        return (self.side(rod, 3 * block).one, self.side(rod, 3 * block + 1).one, self.side(rod, 3 * block + 2).one)
