"""Welds of two edges of a group: these keep the rotation that they had to each other (docs/groups.md).

With r = conj(q) p conj(p₀), where q and p are the frames of both edges and p₀ is what conj(q) p is to be, of the sign that
makes its scalar positive, u = 2 vec r is zero where the weld holds, and the turn by which it misses where that is small. As
for a tie the energy is μ·u + κ |u|²/2, with the moment μ.
"""

import taichi as ti

from doo_ti.groups.layout import (
    ACTIVE,
    MIXED,
    MOMENT,
    OF_EARLY,
    OF_LATE,
    REST,
    TIE_MOMENT,
    TIE_SCALE,
    TIE_STIFFNESS,
    TURNED,
)
from doo_ti.physics.algebra import absolute
from doo_ti.physics.quaternion import first_director, product, relative_rotation, second_director, tangent
from doo_ti.physics.tuples import (
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
            self.store(rod.scratch, self.contacts.edge(rod, e) + MOMENT * self.stride, repeated(zero, 3))
        stiffness = rod.scratch[self.contacts.group(rod) + TIE_STIFFNESS * self.stride] * rod.total * rod.total
        for k in range(rod.ties.shape[0]):
            if rod.ties[k, 2] >= 0:
                self.weld_edges(rod, self.contacts.tie(rod, k), rod.ties[k, 2], rod.ties[k, 3], stiffness)

    @ti.func
    def weld_edges(self, rod, at, late, early, whole):
        """The same of one weld, whose items begin ``at``."""
        stiffness = whole * rod.scratch[at + ACTIVE * self.stride] * rod.scratch[at + TIE_SCALE * self.stride]
        rest = self.load4(rod.scratch, at + REST * self.stride)
        turn = relative_rotation(self.load4(rod.scratch, rod.origin + late * self.edge_stride),
                                 self.load4(rod.scratch, rod.origin + early * self.edge_stride))
        r = variable(product(turn, (rest[0], 0.0 - rest[1], 0.0 - rest[2], 0.0 - rest[3])))
        sign = ti.select(r[0] < 0.0, 0.0 * r[0] - 1.0, 0.0 * r[0] + 1.0)
        s, v = sign * r[0], scaled((r[1], r[2], r[3]), sign)
        u = scaled(v, 2.0)
        moment = scaled(self.load3(rod.scratch, at + TIE_MOMENT * self.stride), rod.scratch[at + ACTIVE * self.stride])
        p = plus(moment, scaled(u, stiffness))
        self.store(rod.scratch, at + TURNED * self.stride, u)
        work, stretch = dot(moment, u), 0.5 * stiffness * dot(u, u)
        self.contacts.add_penalty(rod, work + stretch, absolute(work) + stretch)
        columns = (tangent(rest), first_director(rest), second_director(rest))
        before, after = plus(scaled(p, s), cross(v, p)), minus(scaled(p, s), cross(v, p))
        self.contacts.add_to(rod.scratch, self.contacts.edge(rod, late) + MOMENT * self.stride, negated(before))
        self.contacts.add_to(rod.scratch, self.contacts.edge(rod, early) + MOMENT * self.stride,
                             (dot(columns[0], after), dot(columns[1], after), dot(columns[2], after)))
        own = own_block(v, stiffness, 0.0 - 0.25 * dot(p, u))
        self.store(rod.scratch, at + OF_LATE * self.stride, own)
        self.store(rod.scratch, at + OF_EARLY * self.stride, seen_from(columns, own))
        self.store(rod.scratch, at + MIXED * self.stride, against_columns(mixed_block(s, v, p, stiffness), columns))

    @ti.func
    def add_welds(self, rod):
        """Add the second derivatives of all welds to H."""
        for k in range(rod.ties.shape[0]):
            late, early = rod.ties[k, 2], rod.ties[k, 3]
            if late >= 0:
                at = self.contacts.tie(rod, k)
                free, other = self.freedom(rod, late), self.freedom(rod, early)
                for_late, for_early = self.load6(rod.scratch, at + OF_LATE * self.stride), self.load6(
                    rod.scratch, at + OF_EARLY * self.stride)
                self.contacts.add_diagonal(rod, late + 1, column_scaled(row_scaled(full(for_late), free), free))
                self.contacts.add_diagonal(rod, early + 1, column_scaled(row_scaled(full(for_early), other), other))
                mixed = self.load9(rod.scratch, at + MIXED * self.stride)
                self.contacts.add_block(rod, late + 1, early + 1, column_scaled(row_scaled(mixed, free), other))
