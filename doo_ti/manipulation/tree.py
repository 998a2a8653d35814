"""Trees of rods at rest, joined by legs on which they stay on their branch of equilibria (Kuffner and LaValle, *RRT-Connect*,
ICRA 2000).

Axes: N nodes, M samples.
"""

import numpy as np

from doo_ti.manipulation.legs import Carrier
from doo_ti.manipulation.poses import change_between, joined, moved
from doo_ti.rod.types import Clamps, Configuration

REACH = 0.6
"""Of the rod's length, the longest leg of a tree, shifts in mm and turns times the lever."""
SHAPE = 1.0
"""Weight of the mean distance of two shapes beside that of their grippers' poses, in the distance of nodes."""


class Tree:
    """Nodes that the roots lead to.

    rods, clamps  N nodes, ``roots`` roots first
    parent        (N,) of each, -1 of the roots
    back          legs lead back to their parents as well: the tree is that of goals
    """

    def __init__(self, rods: Configuration, clamps: Clamps, carrier: Carrier, lever: float, back: bool = False):
        self._back = back
        self.rods, self.clamps, self.parent = rods, clamps, np.full(rods.count, -1)
        self.roots = rods.count
        self._carrier, self._scale = carrier, np.repeat([1.0, lever, 1.0, lever], 3)

    @property
    def count(self) -> int:
        """N."""
        return len(self.parent)

    def nearest(self, clamps: Clamps, vertices: np.ndarray | None = None) -> np.ndarray:
        """(M,) the nodes that are nearest to M poses of the grippers, and shapes (M, V, 3) where given."""
        samples = np.repeat(np.arange(clamps.count), self.count)
        nodes = np.tile(np.arange(self.count), clamps.count)
        change = change_between(self.clamps.take(nodes), clamps.take(samples)) * self._scale
        apart = np.linalg.norm(change, axis=1).reshape(clamps.count, self.count)
        if vertices is not None:
            own = self.rods.vertices
            apart = apart + SHAPE * np.linalg.norm(vertices[:, None] - own, axis=-1).mean(axis=-1)
        return np.argmin(apart, axis=1)

    def extend(self, nodes: np.ndarray, goal: Clamps, whole: bool = False) -> np.ndarray:
        """Legs from ``nodes`` (M,) towards poses of the grippers, as far as REACH or the ``whole`` way: (M,) the new nodes, -1
        where a rod does not stay on its branch."""
        begin = self.clamps.take(nodes)
        change = change_between(begin, goal)
        size = np.linalg.norm(change * self._scale, axis=1)
        if not whole:
            change = change * np.minimum(1.0, REACH * self._carrier.length / np.maximum(size, 1e-12))[:, None]
            goal = moved(begin, change)
        rods, sound = self._carrier.carry(self.rods.take(nodes), begin, goal)
        rows = np.flatnonzero(sound)
        if self._back and len(rows):
            home, sound = self._carrier.carry(rods.take(rows), goal.take(rows), begin.take(rows))
            rows = rows[sound & self._carrier.same(home, self.rods.take(nodes[rows]))]
        found = np.full(len(nodes), -1)
        found[rows] = self.count + np.arange(len(rows))
        self._add(rods.take(rows), goal.take(rows), nodes[rows])
        return found

    def way(self, node: int) -> list[int]:
        """The nodes from a root to ``node``."""
        found = [node]
        while self.parent[found[-1]] >= 0:
            found.append(int(self.parent[found[-1]]))
        return found[::-1]

    def _add(self, rods: Configuration, clamps: Clamps, parents: np.ndarray) -> None:
        self.rods = Configuration.concatenate([self.rods, rods])
        self.clamps = joined([self.clamps, clamps])
        self.parent = np.concatenate([self.parent, parents])
