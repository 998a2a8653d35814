"""Trees of rods at rest (Kuffner and LaValle, *RRT-Connect*, ICRA 2000). Axes: N nodes, M samples."""

import numpy as np

from doo_ti.manipulation.equilibria import Equilibria
from doo_ti.manipulation.shapes import Shapes
from doo_ti.rod.types import Configuration


class Tree:
    """Nodes that the roots lead to.

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
        """(M, N) mm."""
        return shapes.take(np.s_[:, None]).apart(self._shapes, self._space.lever)

    def extend(self, nodes: np.ndarray, goals: Configuration) -> tuple[np.ndarray, np.ndarray]:
        """Ways from ``nodes`` (M,) towards M rods: (M,) the new nodes where they end, -1 where that is at once; and which (M,)
        of them come to the goals."""
        ways = self._space.ways(self.rods.take(nodes), goals)
        rows = np.flatnonzero(ways.reach)
        found = np.full(len(nodes), -1)
        found[rows] = len(self.parent) + np.arange(len(rows))
        self._add(ways.states.rods.take(np.array([ways.rows(row)[-1] for row in rows], dtype=np.int64)), nodes[rows])
        return found, ways.whole

    def branch(self, node: int) -> list[int]:
        """The nodes from a root to ``node``."""
        found = [node]
        while self.parent[found[-1]] >= 0:
            found.append(int(self.parent[found[-1]]))
        return found[::-1]

    def cut(self, node: int) -> None:
        """Without ``node`` and what it leads to."""
        self.alive[node] = False
        for later in range(node + 1, len(self.parent)):
            self.alive[later] &= self.parent[later] < 0 or self.alive[self.parent[later]]

    def _add(self, rods: Configuration, parents: np.ndarray) -> None:
        self.rods = Configuration.concatenate([self.rods, rods])
        own = self._space.shapes(rods)
        self._shapes = Shapes(*(np.concatenate([getattr(part, name) for part in (self._shapes, own)])
                                for name in ("place", "frame", "joints")), own.rest_length, own.anchor)
        self.parent = np.concatenate([self.parent, parents])
        self.alive = np.concatenate([self.alive, self.alive[parents]])
