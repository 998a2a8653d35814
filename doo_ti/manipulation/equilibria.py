"""The equilibria of a rod between grippers, ways in them, and trees of such ways: shapes are interpolated, and each is let go
where grippers hold its ends (projection to the manifold of certified equilibria: Berenson, Srinivasa, Ferguson and Kuffner,
*Manipulation planning on constraint manifolds*, ICRA 2009). Axes: R rods or ways, S states of all ways, E edges, V vertices."""

from dataclasses import dataclass, replace

import numpy as np

from doo_ti.contact.surroundings import Surroundings
from doo_ti.manipulation.model import change_between, moved
from doo_ti.relaxation.newton import Newton
from doo_ti.relaxation.relax import relax
from doo_ti.rod.frames import conjugate, matrix_from_quaternion, quaternion_of_turn, quaternion_product, rotation_vector
from doo_ti.rod.types import Clamps, Configuration, Material, finite_rods, put_rods

BENDING, WAVES = 1.5, 3
"""rad, standard deviation of what each cosine along the rod adds to each component of a random rod's rotations."""
CLEAR = 2e-3  # of the rod's length, to obstacles: as near as equilibria are told apart
NEAR = 0.03  # of the rod's length: gaps that are larger are measured at vertices only, as a lower bound
STEP = 0.03  # of the rod's length, between two states of a way, turns times the lever
ABRUPT = 4.0  # times as far as their interpolated shapes may two successive states be apart; further, and the rod has jumped
SAME = 2e-3
"""Of the rod's length, between two shapes of one equilibrium: a tenth of what branches differ by, a thousand times rounding."""


@dataclass(frozen=True)
class Shapes:
    """R rods."""

    place: np.ndarray  # (R, 3) mm, the middle of the anchor
    frame: np.ndarray  # (R, 4) its frame
    joints: np.ndarray  # (R, E−1, 3) rad, rotation vectors from each edge to the next, in the axes of the edge
    rest_length: np.ndarray  # (E,) mm
    anchor: int  # number of an edge

    @classmethod
    def of(cls, rods: Configuration, anchor: int) -> "Shapes":
        """Those of ``rods``, which turn by less than half a turn from each edge to the next."""
        frames = rods.quaternions
        joints = rotation_vector(quaternion_product(conjugate(frames[:, :-1]), frames[:, 1:]))
        place = rods.vertices[:, anchor : anchor + 2].mean(axis=1)
        return cls(place, frames[:, anchor], joints, rods.rest_length, anchor)

    @classmethod
    def at_random(cls, count: int, low: np.ndarray, high: np.ndarray, rest_length: np.ndarray, anchor: int,
                  random: np.random.Generator) -> "Shapes":
        """``count`` of them between the corners ``low`` and ``high`` (3,) mm, in all directions, bent and twisted by
        cosines."""
        joints = len(rest_length) - 1
        waves = np.cos(np.pi * np.arange(WAVES)[:, None] * np.linspace(0.0, 1.0, joints)) / joints
        frame = random.normal(size=(count, 4))
        return cls(random.uniform(low, high, (count, 3)), frame / np.linalg.norm(frame, axis=1, keepdims=True),
                   np.einsum("rkc,kj->rjc", BENDING * random.normal(size=(count, WAVES, 3)), waves), rest_length, anchor)

    @property
    def rods(self) -> Configuration:
        """The R rods of these shapes."""
        turns, edges = quaternion_of_turn(self.joints), len(self.rest_length)
        frames = np.empty((len(turns), edges, 4))
        frames[:, self.anchor] = self.frame
        for edge in range(self.anchor + 1, edges):
            frames[:, edge] = quaternion_product(frames[:, edge - 1], turns[:, edge - 1])
        for edge in range(self.anchor - 1, -1, -1):
            frames[:, edge] = quaternion_product(frames[:, edge + 1], conjugate(turns[:, edge]))
        rods = Configuration(np.zeros((len(turns), 3)), frames / np.linalg.norm(frames, axis=-1, keepdims=True),
                             self.rest_length)
        middle = rods.vertices[:, self.anchor : self.anchor + 2].mean(axis=1)
        return Configuration(self.place - middle, rods.quaternions, self.rest_length)

    def take(self, rows: np.ndarray) -> "Shapes":
        """The shapes named by ``rows``."""
        return Shapes(self.place[rows], self.frame[rows], self.joints[rows], self.rest_length, self.anchor)

    def towards(self, other: "Shapes", share: np.ndarray) -> "Shapes":
        """After ``share`` (R,) of the way to the R others, all numbers uniformly, the anchor turning the shortest way."""
        share = share[:, None]
        turn = rotation_vector(quaternion_product(conjugate(self.frame), other.frame))
        return Shapes(self.place + share * (other.place - self.place),
                      quaternion_product(self.frame, quaternion_of_turn(share * turn)),
                      self.joints + share[..., None] * (other.joints - self.joints), self.rest_length, self.anchor)

    def apart(self, other: "Shapes", lever: float) -> np.ndarray:
        """(R,) mm: shift and turn of the anchor and the turns of all joints on the way to the R others, added; a radian counts
        as much as ``lever`` mm."""
        shift = np.linalg.norm(self.place - other.place, axis=-1)
        turn = 2 * np.arccos(np.minimum(np.abs(np.sum(self.frame * other.frame, axis=-1)), 1.0))
        return shift + lever * (turn + np.linalg.norm(self.joints - other.joints, axis=-1).sum(axis=-1))


@dataclass(frozen=True)
class Clearance:
    """What is around rods of one kind, ``surroundings`` of one row, and their ``length`` in mm and ``edges``."""

    surroundings: Surroundings
    length: float
    edges: int

    def around(self, count: int) -> Surroundings:
        """The surroundings of ``count`` rods."""
        return self.surroundings.take(np.zeros(count, dtype=np.int64))

    def of(self, vertices: np.ndarray) -> np.ndarray:
        """(R,) mm by which rods (R, V, 3) are further than CLEAR from all obstacles, at least; infinite without any."""
        if not self.surroundings:
            return np.full(len(vertices), np.inf)
        margin = CLEAR * self.length
        gap = self._gap(vertices, places=2) - 0.5 * self.length / self.edges - margin
        near = np.flatnonzero(gap < NEAR * self.length)
        if len(near):
            gap[near] = self._gap(vertices[near]) - margin
        return gap

    def between(self, before: np.ndarray, after: np.ndarray, gap_before: np.ndarray, gap_after: np.ndarray) -> np.ndarray:
        """(R,) bool: whether rods that move from ``before`` to ``after`` (R, V, 3), each vertex along a line, keep clear; gaps
        (R,) of both.

        A rod that moves by less than both gaps together touches nothing; else it is halved (conservative advancement).
        """
        clear = (gap_before > 0) & (gap_after > 0)
        travel = np.linalg.norm(after - before, axis=-1).max(axis=1)
        rows = np.flatnonzero(clear & (travel > gap_before + gap_after + 2 * CLEAR * self.length))
        if len(rows):
            middle = 0.5 * (before[rows] + after[rows])
            gap = self.of(middle)
            clear[rows] = (self.between(before[rows], middle, gap_before[rows], gap)
                           & self.between(middle, after[rows], gap, gap_after[rows]))
        return clear

    def _gap(self, vertices: np.ndarray, **places: int) -> np.ndarray:
        return np.nan_to_num(self.around(len(vertices)).smallest_gap(vertices, **places), nan=-np.inf)


@dataclass(frozen=True)
class States:
    """S rods at rest, and the grippers' poses."""

    rods: Configuration
    clamps: Clamps
    touching: np.ndarray  # (S,) bool: they may touch obstacles, and on the way from the one before as well

    def take(self, rows: np.ndarray) -> "States":
        """The states named by ``rows``."""
        return States(self.rods.take(rows), self.clamps.take(rows), self.touching[rows])


def joined_states(parts: list[States]) -> States:
    """The states of several, one after the other."""
    return States(Configuration.concatenate([part.rods for part in parts]), Clamps.concatenate([part.clamps for part in parts]),
                  np.concatenate([part.touching for part in parts]))


@dataclass(frozen=True)
class PathChecks:
    """Quasi-static states of the rod along R candidate paths of the grippers: S of all paths, one path after the other, each
    without its first state."""

    states: States  # S
    way: np.ndarray  # (S,) of which it is
    reach: np.ndarray  # (R,) states that follow each other continuously, stable and clear, from the first on
    is_clear: np.ndarray  # (R,) bool: whether these are all, up to the path's end

    def rows(self, number: int) -> np.ndarray:
        """The continuous states of one way."""
        return np.searchsorted(self.way, number) + np.arange(self.reach[number])


@dataclass(frozen=True)
class Equilibria:
    """What is constant: one material, what surrounds the rod, the direction against gravity, and the grippers."""

    material: Material
    clearance: Clearance
    up: np.ndarray
    home: Clamps  # one row: coordinates that are not free stay so
    moves: np.ndarray  # (12,) bool, the free ones of the grippers' coordinates
    lever: float  # mm that count as much as a radian

    @property
    def length(self) -> float:
        """Length of the rod, mm."""
        return self.clearance.length

    @property
    def anchor(self) -> int:
        """The edge whose pose is interpolated: one that is held, or the middle one."""
        start, end = self.moves[:6].any(), self.moves[6:].any()
        return 0 if not start else self.clearance.edges - 1 if not end else self.clearance.edges // 2

    def shapes(self, rods: Configuration) -> Shapes:
        """The shapes of R rods."""
        return Shapes.of(rods, self.anchor)

    def grippers(self, rods: Configuration) -> Clamps:
        """The grippers' poses at the ends of R rods, coordinates that are not free as at home."""
        home, ends = self.home.take(np.zeros(rods.count, dtype=np.int64)), rods.vertices[:, [0, -1]]
        frames = matrix_from_quaternion(rods.quaternions[:, [0, -1]])
        clamps = Clamps(home.start, home.end, *(part[:, end].copy() for part in (ends, frames) for end in (0, 1)))
        return clamps if self.moves.all() else moved(home, change_between(home, clamps) * self.moves)

    def at_rest(self, shapes: Shapes, touching: np.ndarray) -> tuple[States, np.ndarray]:
        """The rods that grippers hold at the ends of R ``shapes``, those that are ``touching`` (R,) among the obstacles, and
        which (R,) are at certified rest."""
        rods = shapes.rods
        clamps, sound = self.grippers(rods), np.zeros(rods.count, dtype=bool)
        for own in (False, True):
            rows = np.flatnonzero(touching == own)
            if len(rows):
                around = self.clearance.around(len(rows)).arguments if own else {}
                solution = relax(rods.take(rows), self.material, clamps.take(rows), Newton.careful(), up=self.up, **around)
                rods = put_rods(rods, rows, finite_rods(solution.configuration, rods.take(rows)))
                sound[rows] = solution.converged & solution.stable
        return States(rods, clamps, touching), sound

    def touch(self, rods: Configuration) -> np.ndarray:
        """(R,) bool: whether rods touch obstacles, or are nearly so near."""
        return self.clearance.of(rods.vertices) <= 0

    def same(self, vertices: np.ndarray, others: np.ndarray) -> np.ndarray:
        """(…) bool: whether shapes (…, V, 3) are those of one equilibrium."""
        return _travel(vertices, others) < SAME * self.length

    def ways(self, begin: Configuration, end: Configuration) -> PathChecks:
        """From R rods at rest to R others; in contact where one of both is."""
        here, there, touching = self.shapes(begin), self.shapes(end), self.touch(begin) | self.touch(end)
        one = np.arange(begin.count)
        pieces = np.maximum(np.ceil(here.apart(there, self.lever) / (STEP * self.length)), 1).astype(int)
        way = np.repeat(one, pieces)
        first = np.cumsum(pieces) - pieces
        share = (np.arange(len(way)) - first[way] + 1) / pieces[way]
        guessed = here.take(way).towards(there.take(way), share)
        states, sound = self.at_rest(guessed, touching[way])
        after, guess = states.rods.vertices, guessed.rods.vertices
        before, guess_before = np.roll(after, 1, axis=0), np.roll(guess, 1, axis=0)
        before[first] = guess_before[first] = begin.vertices
        sound &= _travel(before, after) <= ABRUPT * _travel(guess_before, guess) + SAME * self.length
        sound[first + pieces - 1] &= self.same(after[first + pieces - 1], end.vertices)
        going = np.flatnonzero(self._unbroken(sound, first, way))
        clear = np.zeros(len(way), dtype=bool)
        clear[going] = self._clear(before[going], after[going], np.isin(going, first))
        reach = np.add.reduceat(self._unbroken(sound & (clear | touching[way]), first, way), first)
        return PathChecks(replace(states, touching=~clear), way, reach, reach == pieces)

    def _clear(self, before: np.ndarray, after: np.ndarray, first: np.ndarray) -> np.ndarray:
        """(S,) bool: whether rods keep clear from each state to the next; ``first`` (S,) of its way."""
        gap = self.clearance.of(after)
        gap_before = np.roll(gap, 1)
        gap_before[first] = self.clearance.of(before[first])
        return self.clearance.between(before, after, gap_before, gap)

    @staticmethod
    def _unbroken(sound: np.ndarray, first: np.ndarray, way: np.ndarray) -> np.ndarray:
        """(S,) whether a state and all before it in its way are sound."""
        broken = np.cumsum(~sound)
        return broken == (broken - ~sound)[first][way]


class Tree:
    """Nodes that ways from the roots lead to.

    rods     N rods at rest, the roots first
    parent   (N,) of each, -1 of the roots
    alive    (N,) bool: ways to the others turned out to be broken
    """

    def __init__(self, roots: Configuration, space: Equilibria):
        self.rods, self.parent, self.alive = roots, np.full(roots.count, -1), np.ones(roots.count, dtype=bool)
        self._space, self._shapes = space, space.shapes(roots)

    def nearest(self, rods: Configuration) -> np.ndarray:
        """(M,) the nodes that are nearest to M rods."""
        apart = self._apart(self._space.shapes(rods))
        return np.argmin(np.where(self.alive, apart, np.inf), axis=1)

    def pairs(self, other: "Tree") -> np.ndarray:
        """(2, N·M) all pairs of a node and one of the other tree's M, the nearest first."""
        apart = other._apart(self._shapes)
        return np.stack(np.unravel_index(np.argsort(apart, axis=None, kind="stable"), apart.shape))

    def _apart(self, shapes: Shapes) -> np.ndarray:
        """(M, N) mm between M shapes and the nodes."""
        return shapes.take(np.s_[:, None]).apart(self._shapes, self._space.lever)

    def extend(self, nodes: np.ndarray, goals: Configuration) -> tuple[np.ndarray, np.ndarray]:
        """Ways from ``nodes`` (M,) towards M rods: (M,) the new nodes where they end, -1 where that is at once; and which (M,)
        of them come to the goals."""
        ways = self._space.ways(self.rods.take(nodes), goals)
        rows = np.flatnonzero(ways.reach)
        found = np.full(len(nodes), -1)
        found[rows] = len(self.parent) + np.arange(len(rows))
        rods = ways.states.rods.take(np.array([ways.rows(row)[-1] for row in rows], dtype=np.int64))
        parts = self._shapes, self._space.shapes(rods)
        self._shapes = replace(parts[0], **{name: np.concatenate([getattr(part, name) for part in parts])
                                            for name in ("place", "frame", "joints")})
        self.rods = Configuration.concatenate([self.rods, rods])
        self.parent = np.concatenate([self.parent, nodes[rows]])
        self.alive = np.concatenate([self.alive, self.alive[nodes[rows]]])
        return found, ways.is_clear

    def branch(self, node: int) -> list[int]:
        """The nodes from a root to ``node``."""
        found = [node]
        while self.parent[found[-1]] >= 0:
            found.append(int(self.parent[found[-1]]))
        return found[::-1]

    def cut(self, node: int) -> None:
        """Mark ``node`` and what it leads to as broken."""
        self.alive[node] = False
        for later in range(node + 1, len(self.parent)):
            self.alive[later] &= self.parent[later] < 0 or self.alive[self.parent[later]]


def _travel(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """(…) mm, the farthest that a vertex moves."""
    return np.linalg.norm(after - before, axis=-1).max(axis=-1)
