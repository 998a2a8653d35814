"""A rod in the paper's own variables, vertices and material frames, in scratch: the step and the fast projection (§III-D).

The counterpart of :mod:`doo_ti.relaxation.chain` for :mod:`doo_ti.relaxation.descent`. Scratch holds, per vertex and the edge
that leaves it, the items named below; ``number`` says how many rods a value holds and ``stride`` how far apart the items of a
vertex lie. :mod:`doo_ti.relaxation.vertex_energy` has the energy.
"""

import taichi as ti

from doo_ti.physics import vertex_form
from doo_ti.physics.tuples import dot, minus, plus, record, repeated, scaled, variable
from doo_ti.relaxation import tables as of

# Items in scratch, per vertex (with the edge that leaves it; the last vertex has a row of its own).
POSITION = 0
DIRECTOR = 3
FORCE = 6  # projected gradient at the vertex
TRIAL_POSITION = 9
TRIAL_DIRECTOR = 12
TRIAL_FORCE = 15
RATIO = 18  # elimination factor and right-hand side of the tridiagonal systems
RIGHT = 19
LENGTH = 20
INVERSE_LENGTH = 21
BEND = 22
TWIST = 25
REST = 26
ITEMS = 28

PROJECTION_ROUNDS = 2


@ti.func
def direction(v):
    """v/|v|."""
    return scaled(v, 1.0 / ti.sqrt(dot(v, v)))


@ti.data_oriented
class VertexChain:
    """The sweeps over vertices, for one kind of number; materials are always general.

    Its functions take a record ``rod`` of the rods in one pack:

    scratch, origin   the array, and the place of vertex 0 in it
    edges             number of edges
    held              (vertex 0, vertex 1, vertex E−1, vertex E, all): one where the vertex is held, else zero
    spin              (first frame, last frame): one where it may spin, else zero
    gravity           μ times the unit vector up
    """

    def __init__(self, number, stride: int):
        self.number = number
        self.stride = stride
        self.row = ITEMS * stride
        self.put = number.lanes().put

    # --- access to scratch ---

    @ti.func
    def load(self, rod, at, item: ti.template()):
        """One number of the vertex at ``at``, or of the edge that leaves it."""
        return rod.scratch[at + item * self.stride]

    @ti.func
    def load3(self, rod, at, item: ti.template()):
        return (self.load(rod, at, item), self.load(rod, at, item + 1), self.load(rod, at, item + 2))

    @ti.func
    def store3(self, rod, at, item: ti.template(), values):
        for k in ti.static(range(3)):
            rod.scratch[at + (item + k) * self.stride] = values[k]

    @ti.func
    def edge_vector(self, rod, at, item: ti.template()):
        """x_{j+1} − x_j of the edge that leaves the vertex at ``at``, of the positions from ``item`` on."""
        return minus(self.load3(rod, at + self.row, item), self.load3(rod, at, item))

    @ti.func
    def mobility(self, rod, vertex):
        """One where the vertex may move."""
        free = 1.0 - rod.held[4]
        if vertex == 0:
            free = free * (1.0 - rod.held[0])
        if vertex == 1:
            free = free * (1.0 - rod.held[1])
        if vertex == rod.edges - 1:
            free = free * (1.0 - rod.held[2])
        if vertex == rod.edges:
            free = free * (1.0 - rod.held[3])
        return free

    # --- sweeps ---

    @ti.func
    def move(self, rod, step):
        """Trial vertices: the step down the gradient, the projection, and the frames carried along."""
        at = rod.origin
        for _ in range(rod.edges + 1):
            x, g = self.load3(rod, at, POSITION), self.load3(rod, at, FORCE)
            self.store3(rod, at, TRIAL_POSITION, minus(x, scaled(g, step)))
            at += self.row
        for _ in ti.static(range(PROJECTION_ROUNDS)):
            self.eliminate_lengths(rod, False)
            self.apply_lengths(rod, False)
        at = rod.origin
        for _ in range(rod.edges):
            old = direction(self.edge_vector(rod, at, POSITION))
            new = direction(self.edge_vector(rod, at, TRIAL_POSITION))
            m1 = vertex_form.transported(old, new, self.load3(rod, at, DIRECTOR))
            self.store3(rod, at, TRIAL_DIRECTOR, vertex_form.across(m1, new))
            at += self.row

    @ti.func
    def eliminate_lengths(self, rod, of_gradient: ti.template()):
        """Fast projection, the forward half (§III-D; Goldenthal 2007):

            c_j(x) = (|e_j|² − l_j²)/(2 l_j) = 0,    (J Jᵀ) y = c(x),    x ← x − Jᵀ y,

        J the Jacobian of c at the trial vertices, its columns zero at held vertices. J Jᵀ is tridiagonal. Of the gradient g
        the part that would change lengths is removed likewise: c(x) is replaced by J g, and g ← g − Jᵀ y.
        """
        one = 0.0 * rod.held[0] + 1.0
        zero = 0.0 * one
        before = variable(repeated(one, 3))  # e/l of the edge before
        ratio, right = (zero, zero)
        at = rod.origin
        for e in range(rod.edges):
            length = self.load(rod, at, LENGTH)
            v = self.edge_vector(rod, at, TRIAL_POSITION)
            u = (v[0] / length, v[1] / length, v[2] / length)
            here, there = self.mobility(rod, e), self.mobility(rod, e + 1)
            value = 0.5 * (dot(u, v) - length)
            if ti.static(of_gradient):
                g0, g1 = self.load3(rod, at, TRIAL_FORCE), self.load3(rod, at + self.row, TRIAL_FORCE)
                value = there * dot(u, g1) - here * dot(u, g0)
            off = zero
            if e > 0:
                off = 0.0 - here * dot(before, u)
            movable = here + there > 0.5
            pivot = ti.select(movable, (here + there) * dot(u, u) - off * ratio, one)
            right = ti.select(movable, (value - off * right) / pivot, zero)
            rod.scratch[at + RIGHT * self.stride] = right
            # Coupling to the next edge, needed here so that the ratio is known going back.
            ratio = zero
            if e < rod.edges - 1:
                after = at + self.row
                coupling = 0.0 - there * dot(u, self.edge_vector(rod, after, TRIAL_POSITION)) / self.load(rod, after, LENGTH)
                ratio = ti.select(movable, coupling / pivot, zero)
            rod.scratch[at + RATIO * self.stride] = ratio
            before = u
            at += self.row

    @ti.func
    def apply_lengths(self, rod, of_gradient: ti.template()):
        """Fast projection, the backward half: subtract Jᵀ y from the trial vertices, or from the trial gradient, which is also
        set to zero at held vertices. Returns Σ |gradient| over the vertices (zero for positions)."""
        item = ti.static(TRIAL_FORCE if of_gradient else TRIAL_POSITION)
        zero = 0.0 * rod.held[0]
        y, total = (zero, zero)
        after = variable(repeated(zero, 3))  # y e/l of the edge after
        at = rod.origin + (rod.edges - 1) * self.row
        for k in range(rod.edges):
            length = self.load(rod, at, LENGTH)
            v = self.edge_vector(rod, at, TRIAL_POSITION)
            y = self.load(rod, at, RIGHT) - self.load(rod, at, RATIO) * y
            n = (v[0] * y / length, v[1] * y / length, v[2] * y / length)
            there = self.mobility(rod, rod.edges - k)
            x = variable(self.load3(rod, at + self.row, item))
            change = scaled(minus(n, after), there)
            if ti.static(of_gradient):
                x = minus(scaled(x, there), change)
                total = total + ti.sqrt(dot(x, x))
            else:
                x = minus(x, change)
            self.store3(rod, at + self.row, item, x)
            after = n
            at -= self.row
        here = self.mobility(rod, 0)
        x = variable(self.load3(rod, rod.origin, item))
        if ti.static(of_gradient):
            x = scaled(plus(x, after), here)
            total = total + ti.sqrt(dot(x, x))
        else:
            x = plus(x, scaled(after, here))
        self.store3(rod, rod.origin, item, x)
        return total

    @ti.func
    def adopt(self, rod, accepted):
        """Make the trial the state where accepted. Returns a record: ``ss``, ``sy``, ``yy`` of the change s of the vertices and
        y of the gradient, and ``top``, the largest gradient of any vertex."""
        zero = 0.0 * accepted
        change = record(ss=zero, sy=zero, yy=zero, top=zero)
        at = rod.origin
        for _ in range(rod.edges + 1):
            for k in ti.static(range(3)):
                dx = self.load(rod, at, TRIAL_POSITION + k) - self.load(rod, at, POSITION + k)
                dg = self.load(rod, at, TRIAL_FORCE + k) - self.load(rod, at, FORCE + k)
                change.ss = change.ss + dx * dx
                change.sy = change.sy + dx * dg
                change.yy = change.yy + dg * dg
                for item, trial in ti.static(((POSITION, TRIAL_POSITION), (FORCE, TRIAL_FORCE), (DIRECTOR, TRIAL_DIRECTOR))):
                    rod.scratch[at + (item + k) * self.stride] = ti.select(
                        accepted > 0.5, self.load(rod, at, trial + k), self.load(rod, at, item + k))
            f = self.load3(rod, at, FORCE)
            change.top = ti.max(change.top, dot(f, f))
            at += self.row
        change.top = ti.sqrt(change.top)
        return change

    @ti.func
    def load_rod(self, tables, scratch: ti.template(), origin, slot, s, g):
        """Start s and material g into lane ``slot``; returns (longest edge, shortest edge)."""
        edges = tables.directors.shape[1]
        row = ti.min(s, tables.rest_length.shape[0] - 1)
        longest, shortest = (ti.cast(0.0, ti.f64), ti.cast(1e30, ti.f64))
        at = origin
        for v in range(edges + 1):
            for k in ti.static(range(3)):
                self.put(scratch, at + (POSITION + k) * self.stride, slot, tables.vertices[s, v, k])
                self.put(scratch, at + (FORCE + k) * self.stride, slot, 0.0)
            if v < edges:
                longest = ti.max(longest, tables.rest_length[row, v])
                shortest = ti.min(shortest, tables.rest_length[row, v])
                self.put(scratch, at + LENGTH * self.stride, slot, tables.rest_length[row, v])
                column = ti.min(of.STIFFNESS + v * of.STIFFNESS_COLUMNS, tables.material.shape[1] - of.STIFFNESS_COLUMNS)
                for k in ti.static(range(3)):
                    self.put(scratch, at + (DIRECTOR + k) * self.stride, slot, tables.directors[s, v, k])
                    self.put(scratch, at + (BEND + k) * self.stride, slot, tables.material[g, column + (of.BEND + k)])
                if v > 0:
                    both = tables.rest_length[row, v - 1] + tables.rest_length[row, v]
                    self.put(scratch, at + INVERSE_LENGTH * self.stride, slot, 1.0 / both)
                    self.put(scratch, at + TWIST * self.stride, slot, tables.material[g, column + of.TWIST])
                    for k in ti.static(range(2)):
                        rest = 0.5 * both * tables.material[g, column + (of.REST + k)]
                        self.put(scratch, at + (REST + k) * self.stride, slot, rest)
            at += self.row
        return longest, shortest
