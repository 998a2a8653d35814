"""The ties of a group, where the numbers of a group lie in scratch, behind those of a rod that may touch itself
(docs/groups.md), and those that a time step gives to its joints.

The rods of a group are one chain, one after the other. Between two of them one edge more, a break, takes the place in the chain
that an edge has: it has no length, and instead of a rotation its unknowns are the place where the next rod begins.

A tie holds a vertex at another one or, as a clamp does, at a place. Steps are judged by the energy

    λ · d + κ |d|²/2

of the miss d. A first round with the same λ ends with λ ← λ + κ d; from then on λ changes with every step
(:mod:`.group_elimination`), until it grows beyond bounds, as where other rods are in the way of a tie. λ is exact where no tie
misses, for any κ.
"""

from typing import ClassVar

import taichi as ti

from doo_ti.physics.algebra import absolute, identity, largest_of
from doo_ti.physics.number import Layout, device_functions
from doo_ti.physics.tuples import choose, dot, minus, negated, picked, plus, scaled, variable
from doo_ti.relaxation.contact_table import matrix_items
from doo_ti.relaxation.external import ExternalFunctions, Nothing

# Of a group: κ of its ties and ε of the border; by how much the energy would be higher if the forces of ties had not changed,
# now and before the step; one where the next step changes them; their bound; and the unit of length.
GROUP = Layout(stiffness=1, give=1, work=1, work_standing=1, stepping=1, bound=1, unit=1)
# Whether an edge may spin and tilt, and the gradient of its welds; of a break the first two say whether the rod behind it may
# move its first vertex.
EDGE = Layout(spin=1, tilt=1, moment=3)
# Of a vertex its weight, a length that gravity multiplies; one where a clamp holds it; by how much its rod is thicker than the
# thinnest; and the point and the stiffness of a spring.
VERTEX = Layout(weight=1, held=1, thicker=1, spring_point=3, spring=1)
# Where a rod begins, also before the step, the step of that place, and where the rod ends.
MEMBER = Layout(begin=3, begin_standing=3, begin_step=3, tip=3)
# A force or a moment, that before the step, and its step.
FORCE = Layout(now=3, standing=3, step=3)
# Of a tie the place that it holds a vertex at, its force, and one where there is this tie; of a weld the rest rotation, its
# moment, by how much it misses, and its second derivatives by the later edge, by the earlier one, and by both. Then by what κ
# and 1/ε are multiplied.
TIE = Layout(target=3, force=FORCE, active=1, rest=4, moment=FORCE, turned=3, of_late=6, of_early=6, mixed=9, scale=1)
# Of a joint for a time step: u̅ of the left frame and of the right one, and m̅ (:mod:`doo_ti.physics.pair`).
JOINT = Layout(left=2, right=2, twist=1)
TWIST, JOINT_ITEMS = JOINT.at("twist"), len(JOINT)
STIFFNESS_OF_TIES, MOST_TIE_STIFFNESS, STIFFER_TIES = 1e4, 1e7, 10.0
"""κ of ties at first and at most, over B/L³ of the softer rod or what the weight makes of that, and its growth."""
GIVE, NO_BORDER = 1e-8, 1e8
"""ε over 1/κ, and in rounds in which forces do not change: points far apart are drawn together by κ alone."""
MOST_GROWTH, NOTABLE_MISS = 10.0, 1e-2
"""By steps forces of ties grow to at most so many times the largest at the end of such a round, and what κ makes of a miss of
that share of the length."""
TIE_TOLERANCE, CLOSED = 1e-10, 1e-2  # of the longest rod: how far tied points may be apart, in the end and in a closed start


@picked
def group_items(edges, rods, ties, borders):
    """Numbers of a group in scratch, with those of its Newton system."""
    return (len(GROUP) + edges * len(EDGE) + (edges + 1) * len(VERTEX) + rods * len(MEMBER) + ties * len(TIE)
            + matrix_items(edges + 1 + borders))


class JointRest(Nothing):
    """Rest curvature and twist, besides the material's, that damping draws the joints where edges begin towards
    (docs/dynamics.md). They are read in the place that an external energy has, and have no energy by themselves."""

    layout: ClassVar[Layout] = JOINT

    @staticmethod
    def functions(number) -> ExternalFunctions:
        @ti.func
        def load(own, numbers: ti.template(), row, edge, scale):
            for k in ti.static(range(JOINT_ITEMS)):
                own[k] = numbers[row, edge, k]

        return Nothing.functions(number)._replace(load=load)


@device_functions
class Ties:
    """The ties of :class:`.GroupContacts`: a class to derive from before the contacts. A force of the border
    (:class:`.GroupElimination`) is that of a tie or the moment of a weld."""

    def bordered_force(self, rod, index):
        """The view of the force, or of a weld the moment, that belongs to three rows of the border."""
        place = ti.select(rod.borders[index, 1] > 0, TIE.at("moment"), TIE.at("force"))
        return self.tie(rod, rod.borders[index, 0]).part(FORCE, place)

    def bordered_miss(self, rod, index):
        """How far that tie misses, or its weld."""
        miss = variable(self.tie(rod, rod.borders[index, 0]).turned)
        if rod.borders[index, 1] == 0:
            miss = self.missed(rod, rod.borders[index, 0])
        return miss

    def lever(self, rod, index):
        """By what a miss of those rows is multiplied for that of a place."""
        return ti.select(rod.borders[index, 1] > 0, rod.total, 0.0 * rod.total + 1.0)

    def miss(self, rod):
        """The largest miss of a tie, over the length of the longest rod."""
        most = 0.0 * rod.total
        for b in range(rod.borders.shape[0]):
            miss = scaled(self.bordered_miss(rod, b), self.lever(rod, b) / rod.total)
            most = largest_of(most, self.tie(rod, rod.borders[b, 0]).active * dot(miss, miss))
        return ti.sqrt(most)

    def missed(self, rod, k):
        """How far a tie misses."""
        place, second = variable(self.tie(rod, k).target), rod.ties[k, 1]
        if second >= 0:
            place = self.vertex(rod, second).place
        return minus(self.vertex(rod, rod.ties[k, 0]).place, place)

    def bind(self, rod):
        """Add the ties to the energy, the gradient and the second derivatives."""
        head = self.group(rod)
        whole = head.stiffness
        self.add_penalty(rod, 0.0 - head.work, 0.0 * whole)
        for k in range(rod.ties.shape[0]):
            at, first, second = self.tie(rod, k), rod.ties[k, 0], rod.ties[k, 1]
            active = at.active
            stiffness = whole * at.scale
            miss, force = self.missed(rod, k), at.force.now
            work, stretch = active * dot(force, miss), 0.5 * active * stiffness * dot(miss, miss)
            self.add_penalty(rod, work + stretch, absolute(work) + stretch)
            pull = scaled(plus(force, scaled(miss, stiffness)), active)
            block = scaled(identity(0.0 * stiffness), active * stiffness)
            self.add_load(rod, first, pull)
            self.add_diagonal(rod, first, block)
            if second >= 0:
                self.add_load(rod, second, negated(pull))
                self.add_diagonal(rod, second, block)
                self.add_block(rod, first, second, negated(block))

    # --- their forces ---

    def step_forces(self, rod, scale, stepping):
        """Take the step of the forces of ties. What this does to the energy, λ · d of the misses before, is no way downhill.

        Forces that would grow beyond their bound stay as they are until another round has drawn points together."""
        head = self.group(rod)
        work = variable((head.work,))
        beyond = stepping & (self.largest_force(rod, scale) > head.bound)
        choose(head, beyond, give=NO_BORDER / head.stiffness)
        stepping = stepping & ~beyond
        for b in range(rod.borders.shape[0]):
            at = self.bordered_force(rod, b)
            change = scaled(at.step, scale)
            work = (ti.select(stepping, work[0] + dot(change, self.bordered_miss(rod, b)), work[0]),)
            choose(at, stepping, now=plus(at.now, change))
        head.work = work[0]

    def largest_force(self, rod, scale):
        """The largest force of a tie, or moment of a weld over the length of the longest rod, after that share of a step; each
        over what its κ is multiplied by."""
        most = 0.0 * rod.total
        for b in range(rod.borders.shape[0]):
            at = self.bordered_force(rod, b)
            force = plus(at.now, scaled(at.step, scale))
            unit = self.lever(rod, b) * self.tie(rod, rod.borders[b, 0]).scale
            most = largest_of(most, dot(force, force) / (unit * unit))
        return ti.sqrt(most)

    def draws(self, rod):
        """The lanes in which ties draw points together without changing their forces: those of a first round."""
        head = self.group(rod)
        return head.give * head.stiffness > 1.0

    def begin_ties(self, rod):
        """Where all ties are closed at the start forces change from the first step on: nothing has to be drawn together."""
        head = self.group(rod)
        closed = self.draws(rod) & (head.bound <= 0.0) & (self.miss(rod) <= CLOSED)
        bound = (MOST_GROWTH * NOTABLE_MISS) * rod.total * head.stiffness
        choose(head, closed, bound=bound, give=GIVE / head.stiffness)

    def update_ties(self, rod, due):
        """New forces of the ties in the lanes in which they draw points together, and a larger κ where they had to do so again.
        From then on forces change with every step."""
        head = self.group(rod)
        stiffness, first = head.stiffness, due & self.draws(rod)
        for b in range(rod.borders.shape[0]):
            tie, at, lever = self.tie(rod, rod.borders[b, 0]), self.bordered_force(rod, b), self.lever(rod, b)
            change = scaled(self.bordered_miss(rod, b), stiffness * (tie.active * tie.scale) * lever * lever)
            choose(at, first, now=plus(at.now, change))
        again = first & (head.bound > 0.0)
        # The bound of forces until the next such round ends.
        least = NOTABLE_MISS * rod.total * head.stiffness
        choose(head, first, bound=MOST_GROWTH * (self.largest_force(rod, 0.0 * rod.total) + least))
        most = MOST_TIE_STIFFNESS / (rod.total * rod.total * rod.total)
        stiffness = ti.select(again, ti.min(STIFFER_TIES * stiffness, most), stiffness)
        head.stiffness = stiffness
        choose(head, first, give=GIVE / stiffness)
