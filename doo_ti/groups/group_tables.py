"""A group as one chain of edges and breaks: the tables that its kernel reads, and which edges may touch (docs/groups.md). Axes:
N groups, G rods, V vertices of all rods, E edges of their chain, breaks included.
"""

from dataclasses import replace
from itertools import permutations

import numpy as np

from doo_ti.contact.surroundings import LEAST_ARC, Itself, Surroundings, smallest_of_pairs
from doo_ti.dynamics.parameters import vertex_lengths
from doo_ti.groups.group import Group
from doo_ti.groups.group_newton import GroupTables
from doo_ti.groups.ties import CLOSED, JOINT_ITEMS, STIFFNESS_OF_TIES
from doo_ti.relaxation import input_tables
from doo_ti.relaxation import tables as of
from doo_ti.relaxation.bows import projectable
from doo_ti.relaxation.clamp_table import INFEASIBLE, STRAIGHT, clamp_table
from doo_ti.relaxation.contact_table import DEEPEST_STEP, contact_table, require_margin
from doo_ti.relaxation.input_tables import along_rods
from doo_ti.rod.frames import conjugate, quaternion_product, vertices_from_quaternions
from doo_ti.rod.types import Clamp, Clamps, Configuration, Material
from doo_ti.system.errors import InputError

CLOSE_ENOUGH = 1e-9  # of the way between two clamps, by which they may be farther apart
AT_ITS_CLAMP = 1e-8  # of a rod's length: a start no further from its clamp is there


class Member:
    """A rod of N groups as rows of tables: ``start`` (N, E, 4) with the frames that clamps hold, ``begin`` (N, 3),
    ``lengths`` (1 or N, E), ``clamp`` (N, CLAMP_COLUMNS), ``feasible`` (N,), ``material`` (1 or N, STIFFNESS +
    E · STIFFNESS_COLUMNS); of both ends ``held`` (N, 2) whether they are, ``places`` (N, 2, 3) where, and ``drawn`` (N, 2)
    whether a tie draws them there: far ends, and starts that are somewhere else; ``loose`` (N,) one where vertex 0 may move."""

    def __init__(self, start: Configuration, material: Material, clamps: Clamps, up: np.ndarray, bodies):
        input_tables.check_shapes(start, clamps)
        input_tables.check_material(material, start.edges, False)
        count = start.count
        self.lengths = input_tables.rest_lengths(start)
        kinds = input_tables.clamp_kinds(clamps, count)
        self.held = kinds >= Clamp.POSITION
        self.clamp, found = clamp_table(start, self.lengths, kinds, clamps)
        self.feasible = found != INFEASIBLE
        frames = np.ascontiguousarray(start.quaternions, dtype=np.float64)
        straight = np.where(found == STRAIGHT, found, 0)
        bowed = projectable(frames, self.lengths, self.clamp, straight, up, bodies, np.arange(count), beside_others=True)
        self.start = of.whole_start(bowed, self.clamp)
        self.begin = np.array(start.start, dtype=np.float64)
        self.places = np.where(self.held[..., None], np.stack([clamps.start_position, clamps.end_position], axis=1), 0.0)
        away = np.linalg.norm(self.places[:, 0] - self.begin, axis=1) > AT_ITS_CLAMP * self.clamp[:, of.TOTAL]
        self.drawn = np.stack([self.held[:, 0] & away, self.held[:, 1]], axis=1)
        fixed = self.held[:, 0] & ~away
        self.begin[fixed] = self.places[fixed, 0]
        self.loose = 1.0 - fixed
        self.material = input_tables.material_table(material, start.edges, each_edge=True)

    @property
    def free(self) -> np.ndarray:
        """(N, E, 2) one where an edge may spin, and tilt."""
        free = np.ones((*self.start.shape[:2], 2))
        clamp = self.clamp
        free[:, 0], free[:, -1] = clamp[:, [of.SPIN_START, of.TILT_START]], clamp[:, [of.SPIN_END, of.TILT_END]]
        return free

    @property
    def stiffness(self) -> np.ndarray:
        """(1 or N,) mm³ of the rod as a whole: of its joints one after the other, each bent its softer way."""
        softest = input_tables.bending_range(along_rods(self.material))[0]
        return self.lengths.sum(axis=1) / (self.lengths / softest).sum(axis=1)

    @property
    def weights(self) -> np.ndarray:
        """(1 or N, V) energy per mm by which the weight pulls at each vertex."""
        return 2.0 * self.material[:, of.WEIGHT, None] * vertex_lengths(self.lengths)

    @property
    def clamped(self) -> np.ndarray:
        """(N, V) one where clamps hold a vertex."""
        clamped = np.zeros((len(self.start), self.start.shape[1] + 1))
        for end, inner, kind, tilt in ((0, 1, 0, of.TILT_START), (-1, -2, 1, of.TILT_END)):
            clamped[:, end] = self.held[:, kind]
            clamped[:, inner] = np.maximum(clamped[:, inner], self.held[:, kind] * (1.0 - self.clamp[:, tilt]))
        return clamped


def group_tables(group: Group, up: np.ndarray, obstacles, radius, contact: bool, moving: bool = False) -> GroupTables:
    """The tables of a group; with ``contact`` its rods touch each other and themselves, where ``radius`` is given. The radius
    of its contacts is that of the thinnest rod.

    Raises InputError as ``relax`` does and, unless the rods are ``moving`` with inertia, where they have weight and nothing
    holds them.
    """
    bodies = [obstacle for obstacle in obstacles if not isinstance(obstacle, Itself)]
    itself = [obstacle for obstacle in obstacles if isinstance(obstacle, Itself)] or [Itself()]
    members = []
    for number, parts in enumerate(zip(group.rods, group.each_material, group.clamps, strict=True)):
        try:
            members.append(Member(*parts, up, bodies))
        except InputError as wrong:
            field = f"{wrong.source}.{wrong.field}"
            raise InputError(f"relax_group: rod {number}", field, wrong.problem, wrong.remedy) from None
    if not moving:
        _check_held(group, members)
    lengths = _joined([member.lengths for member in members], 0.0)
    begins = np.zeros(lengths.shape[1], dtype=np.int32)
    begins[group.first_vertices[1:-1] - 1] = np.arange(1, len(members))
    free = np.concatenate([part for member in members for part in (
        np.repeat(member.loose[:, None, None], 2, axis=2), member.free)], axis=1)[:, 1:]
    _hold_spins(group, members, free)
    pull = _pulls(group, members)
    material, burden = _materials(group, members, pull)
    clamp = _clamps(members, material)
    if radius is None and obstacles:
        raise InputError("relax_group", "radius", "missing beside obstacles", "give the rods' radius in mm")
    radii = group.radii(1.0 if radius is None else radius)
    require_margin(bodies, radii.max())
    around = Surroundings.checked("contact", [*bodies, *itself], radii.min(axis=1), group.count)
    rows = np.arange(group.count)
    table = contact_table(around, group.count, lengths.shape[1], clamp, rows, in_motion=True).touching(rows)
    thicker = group.at_vertices(radii - table.radius[:, None])
    springs = np.zeros((*burden.shape[:2], 4))  # none
    burden = np.concatenate([burden, np.broadcast_to(thicker, burden.shape[:2])[..., None], springs], axis=-1)
    touch = contact and radius is not None
    ties, targets = _ties(group, members)
    apart = edges_apart(group, lengths, begins, radii, touch)
    begins_at = np.stack([member.begin for member in members], axis=1)
    starts = [vertices_from_quaternions(member.begin, member.start, member.lengths) for member in members]
    # Where centrelines nearly cross, the start does not say which rod is on which side.
    start = np.concatenate(starts, axis=1)
    targets[..., 8] = _stiffness_of_ties(group, members, ties, targets, pull, start, clamp[:, of.TOTAL])
    crossing = smallest_gap(start, apart, np.zeros((1, start.shape[1]))) < DEEPEST_STEP * table.radius
    return GroupTables(
        start=_joined([member.start for member in members], 1.0), rest_length=lengths, clamp=clamp,
        material=material, up=up, contact=table, touching=touch or bool(bodies), begins=begins,
        begins_at=begins_at, ties=ties, targets=targets, free=np.ascontiguousarray(free), burden=burden,
        rest=np.zeros((1, lengths.shape[1], JOINT_ITEMS)), apart=apart, radii=radii,
        feasible=np.all([member.feasible for member in members], axis=0) & _reachable(group, members) & ~crossing)


def _hold_spins(group: Group, members: list[Member], free: np.ndarray) -> None:
    """Hold the first spin of round rods that turn about themselves at no cost, in place: of those whose spins are free at both
    ends, and that are not welded to another one."""
    welded = {group.rod_of[edge] for edges in group.welded.values() for edge in edges}
    for number, (member, first) in enumerate(zip(members, group.first_vertices[:-1], strict=True)):
        if number not in welded:
            free[:, first, 0] *= 1.0 - member.material[:, of.ROUND] * member.clamp[:, of.SPIN_END]


def _check_held(group: Group, members: list[Member]) -> None:
    """Raise InputError where rods with weight, and all that are tied to them, are held nowhere."""
    part = tied_together(group)
    held = np.array([member.held.any(axis=1) for member in members])  # (G, N)
    for rod, member in enumerate(members):
        if (member.weights > 0).any() and not held[part == part[rod]].any(axis=0).all():
            raise InputError("relax_group", "clamps", f"rod {rod} has weight and nothing holds it, nor rods tied to it",
                             "hold an end (with inertia the first moment is enough), or set weight 0")


def _reachable(group: Group, members: list[Member]) -> np.ndarray:
    """(N,) bool: no two ends that clamps hold are farther apart than the shortest way between them along rods and ties."""
    first, last = group.first_vertices[:-1], group.first_vertices[1:] - 1
    nodes = np.unique(np.concatenate([first, last, group.tied.reshape(-1)]))
    rod_of = np.searchsorted(last, nodes)
    arc = np.concatenate([np.broadcast_to(np.pad(np.cumsum(member.lengths, axis=1), ((0, 0), (1, 0))),
                                          (group.count, member.lengths.shape[1] + 1)) for member in members], axis=1)[:, nodes]
    way = np.where(rod_of[:, None] == rod_of, np.abs(arc[:, :, None] - arc[:, None]), np.inf)
    one, other = np.searchsorted(nodes, group.tied).T
    way[:, one, other] = way[:, other, one] = 0.0
    for node in range(len(nodes)):
        way = np.minimum(way, way[:, :, [node]] + way[:, [node]])
    ends = np.searchsorted(nodes, np.stack([first, last], axis=1)).reshape(-1)
    places, held = (np.concatenate([getattr(member, name) for member in members], axis=1) for name in ("places", "held"))
    apart = np.linalg.norm(places[:, :, None] - places[:, None], axis=-1)
    beyond = apart > (1.0 + CLOSE_ENOUGH) * way[:, ends][:, :, ends]
    return ~(beyond & held[:, :, None] & held[:, None]).any(axis=(1, 2))


def _joined(parts: list[np.ndarray], between: float) -> np.ndarray:
    """Rows of edges (1 or N, E, ...) one after the other, ``between`` in breaks."""
    rows = max(len(part) for part in parts)
    found = []
    for part in parts:
        found += [np.full((rows, 1, *part.shape[2:]), between), np.broadcast_to(part, (rows, *part.shape[1:]))]
    return np.ascontiguousarray(np.concatenate(found[1:], axis=1))


def _clamps(members: list[Member], material: np.ndarray) -> np.ndarray:
    """(N, CLAMP_COLUMNS) with what the kernel reads of a chain as a whole: sizes as of the largest rod, and where the first
    begins. How ends are held is in other tables."""
    every = np.array([member.clamp for member in members])
    clamp = np.zeros_like(every[0])
    clamp[:, of.SPIN_START : of.TILT_INNER + 1] = 1.0
    for column in (of.TOTAL, of.LONGEST):
        clamp[:, column] = every[..., column].max(axis=0)
    clamp[:, of.SHORTEST_PAIR] = every[..., of.SHORTEST_PAIR].min(axis=0)
    moments = np.max([member.material[:, of.WEIGHT] * member.clamp[:, of.HANGING] for member in members], axis=0)
    weight = np.broadcast_to(material[:, of.WEIGHT], moments.shape)
    clamp[:, of.HANGING] = np.divide(moments, weight, out=np.zeros_like(moments), where=weight > 0)
    clamp[:, of.ANCHOR : of.ANCHOR + 3], clamp[:, of.LOOSE] = members[0].begin, members[0].loose
    return clamp


def _pulls(group: Group, members: list[Member]) -> np.ndarray:
    """(N, V) energy per mm by which the weights of rods and ties pull at each vertex."""
    pull = np.concatenate([np.repeat(member.weights, group.count // len(member.weights), axis=0) for member in members], axis=1)
    for tie, (vertex, _) in zip(group.ties, group.tied, strict=True):
        pull[:, vertex] += tie.weight
    return pull


def _materials(group: Group, members: list[Member], pull: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The table of materials, (1 or N, -), and the first two columns of the burden (N, V, 2) of vertices, at which weights
    ``pull``."""
    rows = max(len(member.material) for member in members)
    every = np.array([np.broadcast_to(member.material[:, : of.STIFFNESS], (rows, of.STIFFNESS)) for member in members])
    head = every.max(axis=0)
    edges = [along_rods(member.material) for member in members]
    head[:, of.SOFTEST] = every[..., of.SOFTEST].min(axis=0)
    head[:, of.ROUND] = 0.0
    # The material's weight is any that is of this size; of the vertices a length is given that it multiplies.
    total = sum(member.lengths.sum(axis=1).min() for member in members)
    head[:, of.WEIGHT] = np.maximum(head[:, of.WEIGHT], sum(tie.weight for tie in group.ties) / total)
    weight = np.broadcast_to(head[:, of.WEIGHT, None], pull.shape)
    lengths = np.divide(pull, weight, out=np.zeros_like(pull), where=weight > 0)
    clamped = np.concatenate([member.clamped for member in members], axis=1)
    stiffness = _joined([np.broadcast_to(part, (rows, *part.shape[1:])) for part in edges], 0.0)
    burden = np.ascontiguousarray(np.stack([lengths, clamped], axis=-1))
    return np.concatenate([head, stiffness.reshape(rows, -1)], axis=1), burden


def evened_group(table: GroupTables, most: float) -> tuple[GroupTables, np.ndarray]:
    """The same groups, each uneven rod's stiffness made even (:func:`.evened`), and (N,) bool of those that this changes."""
    material = table.material.copy()
    along = along_rods(material)
    heads, changed = [], np.zeros(len(material), dtype=bool)
    ends = np.append(np.flatnonzero(table.begins), len(table.begins))
    for first, end in zip(np.append(0, ends[:-1] + 1), ends, strict=True):
        own = along[:, first:end]
        rod = np.concatenate([material[:, : of.STIFFNESS], own.reshape(len(own), -1)], axis=1)
        input_tables.put_extremes(rod)
        even, uneven = input_tables.evened_materials(rod, most)
        own[...] = along_rods(even)
        heads.append(even[:, : of.STIFFNESS])
        changed |= uneven
    for column, whole in ((of.LARGEST_BEND, np.max), (of.STIFFEST, np.max), (of.SOFTEST, np.min)):
        material[:, column] = whole([head[:, column] for head in heads], axis=0)
    return replace(table, material=material), np.broadcast_to(changed, len(table.start))


def _ties(group: Group, members: list[Member]) -> tuple[np.ndarray, np.ndarray]:
    """The ties of the kernel, first the group's own, then those that draw the rods' far ends and then their starts to the
    clamps, see :class:`.GroupTables`, all but their stiffness."""
    own = np.sort(group.tied, axis=1)[:, ::-1]
    first = group.first_vertices
    ends = np.concatenate([first[1:] - 1, first[:-1]])
    ties = np.full((len(own) + len(ends), 4), -1, dtype=np.int32)
    ties[: len(own), :2], ties[len(own):, 0] = own, ends
    targets = np.zeros((group.count, len(ties), 9))
    targets[:, : len(own), 3] = 1.0
    # Not as the members have them: of straight rods these are bowed.
    frames = _joined([rod.quaternions / np.linalg.norm(rod.quaternions, axis=-1, keepdims=True) for rod in group.rods], 1.0)
    for number, (late, early) in group.welded.items():
        ties[number, 2:] = late, early
        targets[:, number, 4:8] = quaternion_product(conjugate(frames[:, late]), frames[:, early])
    for number, (end, member) in enumerate(((1 - late, member) for late in (0, 1) for member in members), start=len(own)):
        targets[:, number, :3], targets[:, number, 3] = member.places[:, end], member.drawn[:, end]
    return ties, targets


def _stiffness_of_ties(group: Group, members: list[Member], ties: np.ndarray, targets: np.ndarray, pull: np.ndarray,
                       start: np.ndarray, longest: np.ndarray) -> np.ndarray:
    """(N, ties) mm³ that κ is over: the stiffness of the softer rod, or what the weight of all rods tied together makes of it,
    which a tie may carry. Under that weight κ gives way by the length of a rod while points are still drawn together, and by
    CLOSED of it where they are together at the start: a soft rope would let go of what hangs on it.

    pull     (N, V) weight at each vertex
    start    (N, V, 3) mm
    longest  (N,) mm, length of the longest rod
    """
    one, other, alone = ties[:, 0], ties[:, 1], ties[:, 1] < 0
    missed = start[:, one] - np.where(alone[:, None], targets[..., :3], start[:, other])
    closed = (targets[..., 3] * np.linalg.norm(missed, axis=-1) <= CLOSED * longest[:, None]).all(axis=1, keepdims=True)
    stiffness = group.at_vertices(np.stack([member.stiffness for member in members], axis=1))
    part = tied_together(group)[group.rod_of]
    carried = pull @ (part[:, None] == part[one])
    by_weight = carried * longest[:, None] ** 2 / (STIFFNESS_OF_TIES * np.where(closed, CLOSED, 1.0))
    return np.maximum(np.minimum(stiffness[:, one], stiffness[:, np.where(alone, one, other)]), by_weight)


# --- which edges may touch, and how near they are ---


def connected(count: int, pairs: np.ndarray) -> np.ndarray:
    """(count,) the least number that each is connected with by ``pairs`` (K, 2)."""
    part = np.arange(count)
    for first, second in pairs:
        least, other = sorted((part[first], part[second]))
        part[part == other] = least
    return part


def tied_together(group: Group) -> np.ndarray:
    """(G,) of each rod the least number of those that it is tied with, also through others."""
    return connected(len(group.rods), group.rod_of[group.tied])


def edges_apart(group: Group, lengths: np.ndarray, begins: np.ndarray, radii: np.ndarray, touch: bool) -> np.ndarray:
    """(1 or N, pairs) int32: one where two edges may touch. Edges of one rod may with :data:`LEAST_ARC` radii of it between
    them, those of two unless both are within as much, of the mean of their ``radii`` (1 or N, G), of points that are tied to
    each other."""
    edges = lengths.shape[1]
    late, early = np.tril_indices(edges, -1)
    rows = max(len(lengths), len(radii)) if touch else 1
    if not touch:
        return np.zeros((rows, len(late)), dtype=np.int32)
    least = LEAST_ARC * np.broadcast_to(radii, (rows, len(group.rods)))
    arc = np.broadcast_to(np.pad(np.cumsum(lengths, axis=1), ((0, 0), (1, 0))), (rows, edges + 1))
    rod_of = group.rod_of
    of_edge = np.where(begins > 0, -1, rod_of[:-1])
    apart = np.where(of_edge[late] == of_edge[early], arc[:, late] - arc[:, early + 1] > least[:, of_edge[late]], True)
    apart &= (of_edge[late] >= 0) & (of_edge[early] >= 0)
    place = connected(edges + 1, group.tied)
    for first in np.unique(place[group.tied]):
        tied = np.flatnonzero(place == first)
        away = np.full((len(tied), rows, edges), np.inf)  # along the tied rod
        for number, vertex in enumerate(tied):
            own = of_edge == rod_of[vertex]
            away[number][:, own] = np.maximum(arc[:, :-1] - arc[:, [vertex]], arc[:, [vertex]] - arc[:, 1:])[:, own]
        for a, b in permutations(range(len(tied)), 2):
            mean = 0.5 * (least[:, rod_of[tied[[a]]]] + least[:, rod_of[tied[[b]]]])
            apart &= ~((away[a][:, late] <= mean) & (away[b][:, early] <= mean))
    return np.ascontiguousarray(apart, dtype=np.int32)


def smallest_gap(vertices: np.ndarray, apart: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """(N,) mm between the surfaces of edges of the groups (N, V, 3) that may touch, see :func:`edges_apart`, with the
    ``radius`` (1 or N, V) of the rod at each vertex; infinite where there are none."""
    late, early = np.tril_indices(vertices.shape[1] - 1, -1)
    used = apart.any(axis=0)
    late, early = late[used], early[used]
    touch, radius = (np.broadcast_to(values, (len(vertices), values.shape[1])) for values in (apart[:, used], radius))

    def gaps(groups: slice, distance: np.ndarray) -> np.ndarray:
        return np.where(touch[groups] > 0, distance - radius[groups, late] - radius[groups, early], np.inf)

    return smallest_of_pairs(vertices, early, late, gaps)
