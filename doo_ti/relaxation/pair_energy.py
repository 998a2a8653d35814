"""The energy of two neighbouring edges of a chain and its derivatives, by the formulas for its material (§III-C)."""

import taichi as ti

from doo_ti.physics import pair


@ti.data_oriented
class PairEnergy:
    """Of round rods that are straight at rest where ``isotropic``, else of all."""

    isotropic: bool

    @ti.func
    def stiffness(self, left, right, material):
        """Stiffness tuple of :mod:`doo_ti.physics.pair` for the vertex between two neighbouring edges."""
        inverse = right.inverse_length
        if ti.static(self.isotropic):
            return (material[0] * inverse, material[1] * inverse)
        else:
            return (left.bend, right.bend, inverse, right.twist * inverse) + self.rest(right)

    @ti.func
    def rest(self, edge):
        """What stiffness ends with, of the vertex where an edge begins: u̅, the same for both frames."""
        return (edge.rest,)

    @ti.func
    def bent(self, b):
        """(X, Y, 1/s, m, e^{im}) of the numbers ``bent`` of an edge: see :mod:`doo_ti.physics.pair`."""
        return ((b[0], b[1]), (b[2], b[3]), b[4], b[5], (b[6], b[7]))

    @ti.func
    def energy_of(self, bent, s):
        if ti.static(self.isotropic):
            return pair.isotropic_energy(bent[0], bent[3], s)
        else:
            return pair.general_energy(bent[0], bent[1], bent[3], s)

    @ti.func
    def gradient_of(self, bent, s):
        x, y, inverse, m, turn = bent
        if ti.static(self.isotropic):
            return pair.isotropic_gradient(x, y, inverse, m, s)
        else:
            return pair.general_gradient(x, y, inverse, turn, m, s)

    @ti.func
    def derivatives(self, bent, s):
        """(g_left, g_right, H_left, H_right, H_across) of a pair."""
        x, y, inverse, m, turn = bent
        if ti.static(self.isotropic):
            return self.gradient_of(bent, s) + pair.isotropic_hessian(x, y, inverse, turn, m, s)
        else:
            return self.gradient_of(bent, s) + pair.general_hessian(x, y, inverse, turn, m, s)

    @ti.func
    def keep_pair(self, rod, joint, derivatives):
        """Called with the :meth:`derivatives` of each pair during elimination; here it keeps nothing."""
        pass
