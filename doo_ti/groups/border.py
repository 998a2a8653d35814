"""The border of a group's Newton system: what ties and welds hold, with their multipliers as unknowns (docs/groups.md).

With the misses d of all ties, their derivatives A, and their forces λ, a step is that of

    | H + κ AᵀA   Aᵀ | | ω  |     | −g − Aᵀ(λ + κ d) |
    | A           −ε | | δλ |  =  | −d               |

so that forces are exact as soon as shapes are. ε makes ties that say the same thing twice determinate; the κ terms, which do
not change the step, are those of the energy by which it is judged. Of as many pivots as there are rows of A, and of no others,
the sign is negative where H is positive along all motions that keep the ties, also where it is zero along one that moves
others against their forces, as a loop turns about a nail.
"""

import taichi as ti

from doo_ti.groups.welds import against_columns
from doo_ti.physics.quaternion import first_director, second_director, tangent
from doo_ti.physics.tuples import column_scaled, dot, repeated, scaled


@ti.data_oriented
class Border:
    """The border of a :class:`.GroupElimination`, whose ``rod.borders`` are, of every three rows of A, the tie, and one where
    they are its weld's: rotations instead of places."""

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
