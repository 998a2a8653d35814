"""The border of a group's Newton system: what ties and welds hold, with their multipliers as unknowns (docs/groups.md).

With the misses d of all ties, their derivatives A, and their forces λ, a step is that of

    | H + κ AᵀA   Aᵀ | | ω  |     | −g − Aᵀ(λ + κ d) |
    | A           −ε | | δλ |  =  | −d               |

so that forces are exact as soon as shapes are. ε makes ties that say the same thing twice determinate; the κ terms, which do
not change the step, are those of the energy by which it is judged. Of as many pivots as there are rows of A, and of no others,
the sign is negative where H is positive along all motions that keep the ties, also where it is zero along one that moves
others against their forces, as a loop turns about a nail.

A weld keeps the rotation that its two edges had to each other. With r = conj(q) p conj(p₀), where q and p are the frames of
both edges and p₀ is what conj(q) p is to be, of the sign that makes its scalar positive, u = 2 vec r is zero where the weld
holds, and the turn by which it misses where that is small. As for a tie the energy is μ·u + κ |u|²/2, with the moment μ.
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
class Border:
    """The border of a :class:`.GroupElimination`, whose ``rod.borders`` are, of every three rows of A, the tie, and one where
    they are its weld's: rotations instead of places. Ties that are welds have two edges besides their vertices, the later
    first; the others -1."""

    @ti.func
    def lines(self, rod):
        return rod.edges + 1 + rod.borders.shape[0]

    @ti.func
    def add_border(self, rod, search, found):
        """Store A, ε and the right-hand side. Inverse iterations, the ``search`` off a saddle, leave forces as they are."""
        zero = 0.0 * rod.total
        head = self.contacts.group(rod)
        head.stepping = ti.select(search[0] + search[1] > 0.0, zero, zero + 1.0)
        for b in range(rod.borders.shape[0]):
            k, line = rod.borders[b, 0], rod.edges + 1 + b
            at = self.contacts.tie(rod, k)
            active = at.active
            give = head.give / at.scale
            if rod.borders[b, 1] == 0:
                self.add_way(rod, line, rod.ties[k, 0], active)
                if rod.ties[k, 1] >= 0:
                    self.add_way(rod, line, rod.ties[k, 1], 0.0 - active)
            else:
                give = give / (rod.total * rod.total)
                self.add_turns(rod, line, rod.ties[k, 2], rod.ties[k, 3], at, active)
            diagonal = 0.0 - active * give - (1.0 - active)
            self.store_diagonal(rod, line, (diagonal, zero, zero, diagonal, zero, diagonal))
            self.store_side(rod, line, scaled(self.contacts.bordered_miss(rod, b), 0.0 - active), repeated(zero, 9))
            found.negative = found.negative - 3.0

    @ti.func
    def add_way(self, rod, line, vertex, sign):
        """Add the derivatives of a vertex's place, times ``sign``, by all that moves it."""
        q, begin = vertex, 0
        while q >= begin:
            a, b, c = self.levers(rod, q)
            self.contacts.add_block(rod, line, q, scaled((a[0], b[0], c[0], a[1], b[1], c[1], a[2], b[2], c[2]), sign))
            if q > 0:
                if rod.begins[q - 1] > 0:
                    begin = q
            q -= 1

    @ti.func
    def add_turns(self, rod, line, late, early, at, sign):
        """The same of a weld's rotation u = 2 v by those of both edges: −(s − [v]×) and (s + [v]×) R, with s² = 1 − |v|² and
        the rest rotation R."""
        v = scaled(at.turned, 0.5)
        s = ti.sqrt(ti.max(1.0 - dot(v, v), 0.0 * sign))
        rest = at.rest
        after = (s, 0.0 - v[2], v[1], v[2], s, 0.0 - v[0], 0.0 - v[1], v[0], s)
        before = (0.0 - s, 0.0 - v[2], v[1], v[2], 0.0 - s, 0.0 - v[0], 0.0 - v[1], v[0], 0.0 - s)
        turned = against_columns(after, (tangent(rest), first_director(rest), second_director(rest)))
        self.contacts.add_block(rod, line, late + 1, scaled(column_scaled(before, self.freedom(rod, late)), sign))
        self.contacts.add_block(rod, line, early + 1, scaled(column_scaled(turned, self.freedom(rod, early)), sign))

    @ti.func
    def keep_forces(self, rod):
        """Keep δλ for the next step. Returns d · δλ, what the border takes from the Newton decrement of H alone."""
        taken = 0.0 * rod.total
        for b in range(rod.borders.shape[0]):
            stepping = self.contacts.group(rod).stepping
            change = self.solution(rod, rod.edges + 1 + b)
            active = self.contacts.tie(rod, rod.borders[b, 0]).active
            taken = taken + active * dot(self.contacts.bordered_miss(rod, b), change)
            self.contacts.bordered_force(rod, b).step = scaled(change, stepping)
        return taken

    # --- welds ---

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
