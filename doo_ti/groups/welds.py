"""Welds of two edges of a group: these keep the rotation that they had to each other (docs/groups.md).

With r = conj(q) p conj(p₀), where q and p are the frames of both edges and p₀ is what conj(q) p is to be, of the sign that
makes its scalar positive, u = 2 vec r is zero where the weld holds, and the turn by which it misses where that is small. As
for a tie the energy is μ·u + κ |u|²/2, with the moment μ.
"""

import taichi as ti

from doo_ti.physics.algebra import absolute
from doo_ti.physics.quaternion import first_director, product, relative_rotation, second_director, tangent
from doo_ti.physics.tuples import (
    add,
    column_scaled,
    cross,
    dot,
    full,
    minus,
    negated,
    plus,
    repeated,
    row_scaled,
    scaled,
    traced,
    variable,
)


@traced
def against_columns(m, columns) -> tuple:
    """M R, where R has three ``columns``."""
    return tuple(m[3 * r] * c[0] + m[3 * r + 1] * c[1] + m[3 * r + 2] * c[2] for r in range(3) for c in columns)


@traced
def seen_from(columns, m) -> tuple:
    """Rᵀ M R of a symmetric M, six numbers, where R has three ``columns``."""
    turned = [(m[0] * c[0] + m[1] * c[1] + m[2] * c[2], m[1] * c[0] + m[3] * c[1] + m[4] * c[2],
               m[2] * c[0] + m[4] * c[1] + m[5] * c[2]) for c in columns]
    return tuple(columns[r][0] * turned[c][0] + columns[r][1] * turned[c][1] + columns[r][2] * turned[c][2]
                 for r in range(3) for c in range(r, 3))


@traced
def own_block(v, stiffness, bent) -> tuple:
    """κ (I − v vᵀ) + ``bent`` I, six numbers."""
    return tuple((stiffness + bent if r == c else 0.0 * bent) - stiffness * v[r] * v[c] for r in range(3) for c in range(r, 3))


@traced
def mixed_block(s, v, p, stiffness) -> tuple:
    """−κ (s + [v]×)² + (v pᵀ + p vᵀ + s [p]× − (p·v) I)/2, nine numbers: of the second derivatives by both edges what stands
    before the rest rotation, r = (s, v)."""
    across = {(0, 1): (2, -1.0), (0, 2): (1, 1.0), (1, 0): (2, 1.0), (1, 2): (0, -1.0), (2, 0): (1, -1.0), (2, 1): (0, 1.0)}
    inner = v[0] * p[0] + v[1] * p[1] + v[2] * p[2]
    square = s * s - v[0] * v[0] - v[1] * v[1] - v[2] * v[2]
    block = []
    for r in range(3):
        for c in range(3):
            value = 0.5 * (v[r] * p[c] + p[r] * v[c]) - stiffness * v[r] * v[c]
            if r == c:
                value = value - 0.5 * inner - stiffness * square
            else:
                k, sign = across[r, c]
                value = value + (0.5 * sign) * s * p[k] - (2.0 * sign) * stiffness * s * v[k]
            block.append(value)
    return tuple(block)


@ti.data_oriented
class Welds:
    """The welds of a :class:`.GroupElimination`, whose ties have two edges besides their vertices, the later first, or -1."""

    @ti.func
    def weld(self, rod):
        """Add the energy of all welds, and keep their derivatives."""
        zero = 0.0 * rod.total
        for e in range(rod.edges):
            self.contacts.edge(rod, e).moment = repeated(zero, 3)
        stiffness = self.contacts.group(rod).stiffness * rod.total * rod.total
        for k in range(rod.ties.shape[0]):
            if rod.ties[k, 2] >= 0:
                self.weld_edges(rod, self.contacts.tie(rod, k), rod.ties[k, 2], rod.ties[k, 3], stiffness)

    @ti.func
    def weld_edges(self, rod, at, late, early, whole):
        """The same of one weld, whose view is ``at``."""
        stiffness = whole * at.active * at.scale
        rest = at.rest
        turn = relative_rotation(self.edge(rod.head, late).frame, self.edge(rod.head, early).frame)
        r = variable(product(turn, (rest[0], 0.0 - rest[1], 0.0 - rest[2], 0.0 - rest[3])))
        sign = ti.select(r[0] < 0.0, 0.0 * r[0] - 1.0, 0.0 * r[0] + 1.0)
        s, v = sign * r[0], scaled((r[1], r[2], r[3]), sign)
        u = scaled(v, 2.0)
        moment = scaled(at.moment.now, at.active)
        p = plus(moment, scaled(u, stiffness))
        at.turned = u
        work, stretch = dot(moment, u), 0.5 * stiffness * dot(u, u)
        self.contacts.add_penalty(rod, work + stretch, absolute(work) + stretch)
        columns = (tangent(rest), first_director(rest), second_director(rest))
        before, after = plus(scaled(p, s), cross(v, p)), minus(scaled(p, s), cross(v, p))
        add(self.contacts.edge(rod, late), moment=negated(before))
        add(self.contacts.edge(rod, early), moment=(dot(columns[0], after), dot(columns[1], after), dot(columns[2], after)))
        own = own_block(v, stiffness, 0.0 - 0.25 * dot(p, u))
        at.of_late = own
        at.of_early = seen_from(columns, own)
        at.mixed = against_columns(mixed_block(s, v, p, stiffness), columns)

    @ti.func
    def add_welds(self, rod):
        """Add the second derivatives of all welds to H."""
        for k in range(rod.ties.shape[0]):
            late, early = rod.ties[k, 2], rod.ties[k, 3]
            if late >= 0:
                at = self.contacts.tie(rod, k)
                free, other = self.freedom(rod, late), self.freedom(rod, early)
                self.contacts.add_diagonal(rod, late + 1, column_scaled(row_scaled(full(at.of_late), free), free))
                self.contacts.add_diagonal(rod, early + 1, column_scaled(row_scaled(full(at.of_early), other), other))
                self.contacts.add_block(rod, late + 1, early + 1, column_scaled(row_scaled(at.mixed, free), other))
