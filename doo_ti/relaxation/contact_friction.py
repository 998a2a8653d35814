"""Friction of a chain on obstacles in a motion: an augmented Lagrangian of how far contacts have slid (docs/contact.md).

At a contact of force λ whose friction was q in the round before, and which has moved by u since the instant before, friction is
z = q + κ u along the surface where |z| ≤ μ λ, else of that size along z. It is the derivative of |z|²/2κ, or of
μ λ (|z| − μ λ/2)/κ.
"""

import taichi as ti

from doo_ti.contact.distance import outer
from doo_ti.physics.tuples import add, chosen, dot, full, minus, plus, record, repeated, scaled
from doo_ti.relaxation.contact_places import ContactPlaces


@ti.data_oriented
class ContactFriction(ContactPlaces):
    """The friction of the contacts of the rods in a pack."""

    @ti.func
    def rub_vertex(self, rod, o, at, contact):
        """Add the friction of the vertex."""
        limit = self.limit(rod, o, contact.force)
        rubbed = self.rubbed(rod, limit, contact.friction, contact.rubbed_normal, self.slid(rod, at, o))
        self.add_penalty(rod, rubbed.energy, dot(rubbed.pull, rubbed.pull) / rod.contacts.stiffness)
        add(rod.contacts, end_gradient=rubbed.pull, end_curvatures=rubbed.stiffness)

    @ti.func
    def rub_between(self, rod, o, index, contact, counts):
        """Add the friction at the nearest point of an edge in the lanes where it ``counts``."""
        zero = 0.0 * rod.total
        s, u = contact.rubbed_place, self.slid_between(rod, index, contact, o)
        limit = self.limit(rod, o, contact.force_between)
        rubbed = self.rubbed(rod, limit, contact.friction_between, contact.rubbed_normal_between, u)
        pull, bent = chosen(counts, rubbed.pull, repeated(zero, 3)), chosen(counts, rubbed.stiffness, repeated(zero, 6))
        self.add_penalty(rod, ti.select(counts, rubbed.energy, zero), dot(pull, pull) / rod.contacts.stiffness)
        add(rod.contacts, gradient=pull, gradient_s=scaled(pull, s), curvatures=bent, curvatures_s=scaled(full(bent), s),
            curvatures_ss=scaled(bent, s * s))

    @ti.func
    def limit(self, rod, o, force):
        """μ λ, the largest friction of a contact with obstacle ``o``."""
        return self.obstacle(rod, o).friction * force

    @ti.func
    def rubbed(self, rod, limit, friction, gradient, u):
        """Friction of a contact that has moved by ``u``: its energy, its derivative and its stiffness."""
        stiffness = rod.contacts.stiffness
        normal = self.distance.unit(gradient)
        whole = plus(friction, scaled(u, stiffness))
        z = minus(whole, scaled(normal, dot(normal, whole)))
        size = ti.sqrt(dot(z, z) + 1e-30)
        slips = size > limit
        share = ti.select(slips, limit / size, 0.0 * limit + 1.0)
        energy = ti.select(slips, limit * (size - 0.5 * limit), 0.5 * size * size) / stiffness
        across = scaled(plus(outer(normal), scaled(outer(z), ti.select(slips, 1.0 / (size * size), 0.0 * size))), 0.0 - 1.0)
        flat = (1.0 + across[0], across[1], across[2], 1.0 + across[3], across[4], 1.0 + across[5])
        return record(energy=energy, pull=scaled(z, share), stiffness=scaled(flat, stiffness * share))
