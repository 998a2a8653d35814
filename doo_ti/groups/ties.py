"""The ties of a group (docs/groups.md).

A tie holds a vertex at another one or, as a clamp does, at a place. Steps are judged by the energy

    λ · d + κ |d|²/2

of the miss d. A first round with the same λ ends with λ ← λ + κ d; from then on λ changes with every step
(:mod:`doo_ti.groups.border`), until it grows beyond bounds, as where other rods are in the way of a tie. λ is exact where no
tie misses, for any κ.
"""

import taichi as ti

from doo_ti.groups.layout import (
    ACTIVE,
    FORCE_STANDING,
    FORCE_STEP,
    GIVE,
    MOST_GROWTH,
    MOST_TIE_STIFFNESS,
    NO_BORDER,
    NOTABLE_MISS,
    STIFFER_TIES,
    TARGET,
    TIE_BOUND,
    TIE_FORCE,
    TIE_GIVE,
    TIE_MOMENT,
    TIE_SCALE,
    TIE_STIFFNESS,
    TIE_WORK,
    TIE_WORK_STANDING,
    TURNED,
)
from doo_ti.physics.algebra import absolute, largest_of
from doo_ti.physics.tuples import chosen, dot, identity, minus, negated, plus, scaled, variable


@ti.data_oriented
class Ties:
    """The ties of :class:`.GroupContacts`: a class to derive from before the contacts. A force of the border
    (:class:`.Border`) is that of a tie or the moment of a weld."""

    @ti.func
    def bordered_force(self, rod, index):
        """Where the force, or of a weld the moment, is that belongs to three rows of the border."""
        at = self.tie(rod, rod.borders[index, 0]) + TIE_FORCE * self.stride
        if rod.borders[index, 1] > 0:
            at += (TIE_MOMENT - TIE_FORCE) * self.stride
        return at

    @ti.func
    def bordered_miss(self, rod, index):
        """How far that tie misses, or its weld."""
        miss = variable(self.load3(rod.scratch, self.tie(rod, rod.borders[index, 0]) + TURNED * self.stride))
        if rod.borders[index, 1] == 0:
            miss = self.missed(rod, rod.borders[index, 0])
        return miss

    @ti.func
    def lever(self, rod, index):
        """By what a miss of those rows is multiplied for that of a place."""
        lever = 0.0 * rod.total + 1.0
        if rod.borders[index, 1] > 0:
            lever = rod.total
        return lever

    @ti.func
    def miss(self, rod):
        """The largest miss of a tie, over the length of the longest rod."""
        most = 0.0 * rod.total
        for b in range(rod.borders.shape[0]):
            miss = scaled(self.bordered_miss(rod, b), self.lever(rod, b) / rod.total)
            most = largest_of(most, rod.scratch[self.tie(rod, rod.borders[b, 0]) + ACTIVE * self.stride] * dot(miss, miss))
        return ti.sqrt(most)

    @ti.func
    def missed(self, rod, k):
        """How far a tie misses."""
        place, second = variable(self.load3(rod.scratch, self.tie(rod, k) + TARGET * self.stride)), rod.ties[k, 1]
        if second >= 0:
            place = self.place(rod, second)
        return minus(self.place(rod, rod.ties[k, 0]), place)

    @ti.func
    def bind(self, rod):
        """Add the ties to the energy, the gradient and the second derivatives."""
        head = self.group(rod)
        whole = rod.scratch[head + TIE_STIFFNESS * self.stride]
        self.add_penalty(rod, 0.0 - rod.scratch[head + TIE_WORK * self.stride], 0.0 * whole)
        for k in range(rod.ties.shape[0]):
            at, first, second = self.tie(rod, k), rod.ties[k, 0], rod.ties[k, 1]
            active = rod.scratch[at + ACTIVE * self.stride]
            stiffness = whole * rod.scratch[at + TIE_SCALE * self.stride]
            miss, force = self.missed(rod, k), self.load3(rod.scratch, at + TIE_FORCE * self.stride)
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

    @ti.func
    def stand_forces(self, rod):
        """Keep the forces of ties before a step."""
        head = self.group(rod)
        rod.scratch[head + TIE_WORK_STANDING * self.stride] = rod.scratch[head + TIE_WORK * self.stride]
        for b in range(rod.borders.shape[0]):
            at = self.bordered_force(rod, b)
            self.store(rod.scratch, at + FORCE_STANDING * self.stride, self.load3(rod.scratch, at))

    @ti.func
    def step_forces(self, rod, scale, stepping):
        """Take the step of the forces of ties. What this does to the energy, λ · d of the misses before, is no way downhill.

        Forces that would grow beyond their bound stay as they are until another round has drawn points together."""
        head = self.group(rod)
        work = variable((rod.scratch[head + TIE_WORK * self.stride],))
        beyond = stepping & (self.largest_force(rod, scale) > rod.scratch[head + TIE_BOUND * self.stride])
        give = rod.scratch[head + TIE_GIVE * self.stride]
        drawing = NO_BORDER / rod.scratch[head + TIE_STIFFNESS * self.stride]
        rod.scratch[head + TIE_GIVE * self.stride] = ti.select(beyond, drawing, give)
        stepping = stepping & ~beyond
        for b in range(rod.borders.shape[0]):
            at = self.bordered_force(rod, b)
            old = self.load3(rod.scratch, at)
            change = scaled(self.load3(rod.scratch, at + FORCE_STEP * self.stride), scale)
            work = (ti.select(stepping, work[0] + dot(change, self.bordered_miss(rod, b)), work[0]),)
            self.store(rod.scratch, at, chosen(stepping, plus(old, change), old))
        rod.scratch[head + TIE_WORK * self.stride] = work[0]

    @ti.func
    def largest_force(self, rod, scale):
        """The largest force of a tie, or moment of a weld over the length of the longest rod, after that share of a step; each
        over what its κ is multiplied by."""
        most = 0.0 * rod.total
        for b in range(rod.borders.shape[0]):
            at = self.bordered_force(rod, b)
            force = plus(self.load3(rod.scratch, at), scaled(self.load3(rod.scratch, at + FORCE_STEP * self.stride), scale))
            unit = self.lever(rod, b) * rod.scratch[self.tie(rod, rod.borders[b, 0]) + TIE_SCALE * self.stride]
            most = largest_of(most, dot(force, force) / (unit * unit))
        return ti.sqrt(most)

    @ti.func
    def bound_forces(self, rod, where):
        """Give forces in the lanes ``where`` the bound that they have until the next such round ends."""
        head, zero = self.group(rod), 0.0 * rod.total
        least = NOTABLE_MISS * rod.total * rod.scratch[head + TIE_STIFFNESS * self.stride]
        bound = MOST_GROWTH * (self.largest_force(rod, zero) + least)
        kept = rod.scratch[head + TIE_BOUND * self.stride]
        rod.scratch[head + TIE_BOUND * self.stride] = ti.select(where, bound, kept)

    @ti.func
    def restore_forces(self, rod, lost):
        """Restore them in the lanes that reject the step."""
        head = self.group(rod)
        work, before = rod.scratch[head + TIE_WORK * self.stride], rod.scratch[head + TIE_WORK_STANDING * self.stride]
        rod.scratch[head + TIE_WORK * self.stride] = ti.select(lost > 0.5, before, work)
        for b in range(rod.borders.shape[0]):
            at = self.bordered_force(rod, b)
            old, new = self.load3(rod.scratch, at + FORCE_STANDING * self.stride), self.load3(rod.scratch, at)
            self.store(rod.scratch, at, chosen(lost > 0.5, old, new))

    @ti.func
    def draws(self, rod):
        """The lanes in which ties draw points together without changing their forces: those of a first round."""
        head = self.group(rod)
        return rod.scratch[head + TIE_GIVE * self.stride] * rod.scratch[head + TIE_STIFFNESS * self.stride] > 1.0

    @ti.func
    def settle_ties(self, rod, due):
        """New forces of the ties in the lanes in which they draw points together, and a larger κ where they had to do so again.
        From then on forces change with every step, unless contacts have a barrier yet."""
        head = self.group(rod)
        stiffness, first = rod.scratch[head + TIE_STIFFNESS * self.stride], due & self.draws(rod)
        for b in range(rod.borders.shape[0]):
            tie, at, lever = self.tie(rod, rod.borders[b, 0]), self.bordered_force(rod, b), self.lever(rod, b)
            old, scale = self.load3(rod.scratch, at), rod.scratch[tie + ACTIVE * self.stride] * rod.scratch[
                tie + TIE_SCALE * self.stride]
            new = plus(old, scaled(self.bordered_miss(rod, b), stiffness * scale * lever * lever))
            self.store(rod.scratch, at, chosen(first, new, old))
        again = first & (rod.scratch[head + TIE_BOUND * self.stride] > 0.0) & ~self.behind(rod)
        self.bound_forces(rod, first)
        most = MOST_TIE_STIFFNESS / (rod.total * rod.total * rod.total)
        stiffness = ti.select(again, ti.min(STIFFER_TIES * stiffness, most), stiffness)
        rod.scratch[head + TIE_STIFFNESS * self.stride] = stiffness
        give = rod.scratch[head + TIE_GIVE * self.stride]
        rod.scratch[head + TIE_GIVE * self.stride] = ti.select(first & ~self.behind(rod), GIVE / stiffness, give)
