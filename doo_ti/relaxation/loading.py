"""A rod's start, clamps and material into one lane of a pack in scratch (§III-A, §III-B)."""

import taichi as ti

from doo_ti.physics.number import device_functions, in_f64, read
from doo_ti.physics.quaternion import normalised, tangent, turned_to
from doo_ti.physics.tuples import record, scaled, variable
from doo_ti.relaxation import chain
from doo_ti.relaxation import tables as of
from doo_ti.relaxation.newton_policy import MOST_SHIFT

REFERENCE_LENGTH = 99.0  # mm: rods of about this length are computed in mm, others in units in which they have it

# Entries of a launch's queue: the next rod that is not yet taken, the trips of all packs, and from LANES on every lane's rod.
NEXT, TRIPS, LANES = 0, 1, 2


@ti.func
def stiffness_scale(material: ti.template(), clamp: ti.template(), g, s):
    """Stiffness, mm³, by which the residual of the rod (configuration s, material g) is measured: the largest eigenvalue of B,
    or where a hundredth of its weight's moment about the clamp, times the length, or a thousandth of β is more, that: of a rod
    that twists much harder than it bends, rounding of a joint's twist is a moment."""
    weight = material[g, of.WEIGHT] * clamp[s, of.HANGING] * (clamp[s, of.TOTAL] / REFERENCE_LENGTH)
    return ti.max(ti.max(material[g, of.LARGEST_BEND], weight), 1e-3 * material[g, of.STIFFEST])


@ti.func
def length_unit(total):
    """The power of two, in mm, that is nearest to ``total`` over REFERENCE_LENGTH: in it rods of any size are alike, to the
    last bit where their sizes differ by a power of two."""
    unit = ti.cast(1.0, ti.f64)
    while total > ti.static(REFERENCE_LENGTH * 2**0.5) * unit and unit < 1e30:
        unit *= 2.0
    while total <= ti.static(REFERENCE_LENGTH * 0.5**0.5) * unit and unit > 1e-30:
        unit *= 0.5
    return unit


@ti.func
def stiffness_column(material: ti.template(), e):
    """Where the stiffness of edge ``e`` begins in a row of a table of materials."""
    return ti.min(of.STIFFNESS + e * of.STIFFNESS_COLUMNS, material.shape[1] - of.STIFFNESS_COLUMNS)


@ti.func
def load_stiffness(view, material: ti.template(), g, rest_length: ti.template(), row, e, scale):
    """B of edge ``e`` and, of the joint where it begins, β and ω̄ l̄/2 into their places in a ``view``, from row ``g`` of a table
    of materials and from ``row`` of the lengths, stiffness times ``scale``."""
    column = stiffness_column(material, e)
    view.bend = scaled(read(material, g, column + of.BEND), scale)
    if e > 0:
        view.twist = material[g, column + of.TWIST] * scale
        both = rest_length[row, e - 1] + rest_length[row, e]
        view.rest = scaled(read(material, g, column + of.REST, count=2), 0.5 * both)


@device_functions
class Loading:
    """Loading of rods into lanes of ``sweep`` (:class:`.Chain`).

    ``tables`` is a record of the arrays that host and kernels share: start, rest_length, clamp, material, up, rods, frames,
    results, and ``numbers`` of the external energy (see :mod:`doo_ti.relaxation.tables`). ``in_millimetres``: lengths stay in
    mm.
    """

    def __init__(self, sweep: chain.Chain, in_millimetres: bool = False):
        self.edge, self.isotropic, self.has_border = sweep.edge, sweep.isotropic, sweep.has_border
        self.functions, self.in_millimetres = sweep.functions, in_millimetres
        self.touches, self.pulls_start = sweep.touches, sweep.pulls_start
        if self.touches:
            self.contacts = sweep.contacts
        self.loaded = self.functions is not None

    def load(self, tables, head, slot, rod, lengths_known):
        """Row ``rod`` of the rods into lane ``slot``. Lengths that all rods share are loaded once per lane.

        Lengths are in a unit u in which all rods are about equally long, energies in that of a stiffness over u, so that
        rounding and tolerances do not depend on a rod's size.
        """
        lane = head.lane(slot)
        s, g = tables.rods[rod, of.CLAMP_ROW], tables.rods[rod, of.MATERIAL_ROW]
        row_e = tables.rods[rod, of.EXTERNAL_ROW]
        divisor = stiffness_scale(tables.material, tables.clamp, g, s)
        unit = ti.cast(1.0, ti.f64)
        if ti.static(not self.in_millimetres):
            unit = length_unit(tables.clamp[s, of.TOTAL])
        if tables.rods[rod, of.START_ROW] == of.FROM_RESULTS:
            self.load_frames(tables, tables.frames, tables.rods[rod, of.RESULT_ROW], lane, s)
        else:
            self.load_frames(tables, tables.start, tables.rods[rod, of.START_ROW], lane, s)
        row = ti.min(s, tables.rest_length.shape[0] - 1)
        if lengths_known < 0.5 or tables.rest_length.shape[0] > 1:
            for e in range(tables.rest_length.shape[1]):
                edge, length = self.edge(lane, e), tables.rest_length[row, e] / unit
                edge.length = length
                if e > 0:
                    edge.inverse_length = 1.0 / (tables.rest_length[row, e - 1] / unit + length)
        if ti.static(not self.isotropic):
            for e in range(tables.rest_length.shape[1]):
                edge = self.edge(lane, e)
                load_stiffness(edge, tables.material, g, tables.rest_length, row, e, 1.0 / divisor)
                edge.shift_shares = (self.shift_share(tables, g, e, 0), self.shift_share(tables, g, e, 1))
        if ti.static(self.loaded):
            for e in range(tables.rest_length.shape[1]):
                self.functions.load(self.edge(lane, e).external, tables.numbers, row_e, e, 1.0 / divisor * unit)
        self.load_parameters(tables, lane, s, g, divisor, unit)
        if ti.static(self.touches):
            total = tables.clamp[s, of.TOTAL] / unit
            scale = record(
                bend=tables.material[g, of.LARGEST_BEND] / divisor, total=total, length=total / tables.rest_length.shape[1],
                longest=tables.clamp[s, of.LONGEST] / unit,
                weight=2.0 * tables.material[g, of.WEIGHT] / divisor * (unit * unit * unit))
            self.contacts.load(tables, slot, rod, unit, scale)
        if ti.static(self.has_border):
            lane.loose = tables.clamp[s, of.LOOSE]
            lane.drift = scaled(read(tables.results, tables.rods[rod, of.RESULT_ROW], of.DRIFT), 1.0 / unit)
            if ti.static(self.loaded and self.pulls_start):
                self.functions.load(lane.external, tables.numbers, row_e, -1, 1.0 / divisor * unit)

    def load_frames(self, tables, source: ti.template(), row, lane, s):
        """The frames of ``source``'s row into a lane, clamp s holding the ends. A first step of length zero normalises them."""
        edges = tables.rest_length.shape[1]
        place = row * edges * 4
        for e in range(edges):
            self.edge(lane, e).frame = read(source, place, count=4)
            place += 4
        self.load_end(tables.clamp, s, 0, source, row * edges * 4, self.edge(lane, 0))
        self.load_end(tables.clamp, s, 1, source, place - 4, self.edge(lane, edges - 1))

    def load_end(self, clamp: ti.template(), s, end: ti.template(), source: ti.template(), place, edge):
        """What clamp s holds of the first frame or the last, which is at ``place`` of ``source``, into that edge of a lane."""
        if clamp[s, of.TILT_START + end] == 0.0:
            held = variable(read(clamp, s, of.ENDS + 4 * end, count=4))
            if clamp[s, of.SPIN_START + end] > 0.0:  # a tangent alone
                held = turned_to(normalised(read(source, place, count=4)), tangent(held))
            edge.frame = held

    def force_unit(self, lane):
        """The lane's unit of force, energy per mm."""
        return in_f64(lane.energy_unit) / in_f64(lane.length_unit)

    def shift_share(self, tables, g, e, tilt: ti.template()):
        """The share of a shift that an edge's spin or ``tilt`` has: all of it, unless that is more than MOST_SHIFT times what
        is stiff in it at its two joints."""
        stiff = ti.cast(0.0, ti.f64)
        last = tables.rest_length.shape[1] - 1
        for beside in ti.static(range(-1 if tilt else 0, 2)):
            column = stiffness_column(tables.material, ti.min(ti.max(e + beside, 0 if tilt else 1), last))
            own = tables.material[g, column + of.TWIST]
            if ti.static(tilt):
                b = (tables.material[g, column], tables.material[g, column + 1], tables.material[g, column + 2])
                own = (b[0] * b[1] - b[2] * b[2]) / ti.max(b[0] + b[1], 1e-300)  # between half the smaller eigenvalue and it
            stiff = ti.max(stiff, own)
        return ti.min(1.0, MOST_SHIFT * stiff / tables.material[g, of.STIFFEST])

    def load_parameters(self, tables, lane, s, g, divisor, unit):
        """Parameters of a rod (configuration s, material g) into a lane, stiffness over ``divisor``, lengths over ``unit``."""
        lane.target = scaled(read(tables.clamp, s, of.TARGET), 1.0 / unit)
        lane.anchor = scaled(read(tables.clamp, s, of.ANCHOR), 1.0 / unit)
        for k in ti.static(range(3)):
            lane.gravity[k] = tables.material[g, of.WEIGHT] * tables.up[k] / divisor * (unit * unit * unit)
        # A round rod with both spins free turns about itself at no cost: hold its first spin.
        spin_start = tables.clamp[s, of.SPIN_START] * (1.0 - tables.material[g, of.ROUND] * tables.clamp[s, of.SPIN_END])
        lane.free = (spin_start, tables.clamp[s, of.TILT_START], tables.clamp[s, of.SPIN_END], tables.clamp[s, of.TILT_END],
                     tables.clamp[s, of.TILT_INNER])
        lane.closed, lane.released = tables.clamp[s, of.CLOSED], tables.clamp[s, of.RELEASED]
        lane.total, lane.longest = tables.clamp[s, of.TOTAL] / unit, tables.clamp[s, of.LONGEST] / unit
        lane.energy_unit, lane.length_unit = divisor / unit, unit
        bend, twist = tables.material[g, of.STIFFNESS + of.BEND], tables.material[g, of.STIFFNESS + of.TWIST]
        lane.stiffness = (bend / divisor, twist / divisor)
        lane.softest = tables.material[g, of.SOFTEST] / divisor
        lane.evenness = tables.material[g, of.SOFTEST] / tables.material[g, of.STIFFEST]
        if ti.static(not self.isotropic):
            bend, twist = tables.material[g, of.SOFTEST], tables.material[g, of.SOFTEST]
        most = MOST_SHIFT / tables.material[g, of.STIFFEST]
        lane.shift_shares = (ti.min(1.0, most * twist), ti.min(1.0, most * bend))
        # A first guess of H's largest diagonal entry.
        lane.scale = 4.0 * tables.material[g, of.STIFFEST] / divisor / (tables.clamp[s, of.SHORTEST_PAIR] / unit)
