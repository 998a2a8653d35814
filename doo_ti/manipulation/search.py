"""The search for a way from a rod at rest to one of its goals, by two trees that grow towards each other (Kuffner and LaValle,
*RRT-Connect*, ICRA 2000), many ways at once. Axes: N nodes, M samples, T states."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from doo_ti.manipulation.equilibria import Equilibria, Shapes, States, joined_states
from doo_ti.rod.types import Configuration
from doo_ti.system.runtime import working_time

SAMPLES = 32
"""Random rods that a tree grows towards at once, and ways that are tried for a shortcut."""
AROUND = 0.5
"""Of the rod's length: random rods are at most so far outside the box around the rod and its goals."""
SHORTCUTS = 4
"""Rounds in which a way is shortened."""


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
        """(M, N) mm between M shapes and the nodes."""
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
        """Mark ``node`` and what it leads to as broken."""
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


class Search:
    """The ways from ``begin``, one rod, to ``goals``.

    space    the equilibria
    ends     of :func:`.working_time`: nothing is searched later
    """

    def __init__(self, begin: Tree, goals: Tree, space: Equilibria, ends: float, seed: int):
        self._start, self._goals, self._space, self._ends = begin, goals, space, ends
        self._random = np.random.default_rng(seed)
        places = np.concatenate([tree.rods.vertices.reshape(-1, 3) for tree in (begin, goals)])
        self._low, self._high = places.min(axis=0) - AROUND * space.length, places.max(axis=0) + AROUND * space.length

    def found(self) -> Iterator[tuple[list[int], list[int]]]:
        """Ways to the goals as nodes of the tree of the start and then of that of the goals, as long as there is time.
        They meet in one rod, which is a node of both."""
        start, goals = self._start, self._goals
        yield from self._joined(start, goals, *start.pairs(goals))
        while working_time() < self._ends:
            for tree, other in ((start, goals), (goals, start)):
                samples = self._samples()
                new, _ = tree.extend(tree.nearest(samples), samples)
                new = new[new >= 0]
                if len(new):
                    yield from self._joined(tree, other, new, other.nearest(tree.rods.take(new)))

    def _joined(self, tree: Tree, other: Tree, nodes: np.ndarray, others: np.ndarray) -> Iterator[tuple[list[int], list[int]]]:
        """Ways through both trees, where the ``other`` comes from one of ``others`` (M,) to one of ``nodes``."""
        new, whole = other.extend(others, tree.rods.take(nodes))
        for row in np.flatnonzero(whole):
            if tree.alive[nodes[row]] and other.alive[new[row]]:
                own, rest = tree.branch(int(nodes[row])), other.branch(int(new[row]))
                yield (own, rest[::-1]) if tree is self._start else (rest, own[::-1])

    def shortened(self, states: States) -> States:
        """The states of a way without detours: a straight way between two of them, again and again."""
        for _ in range(SHORTCUTS):
            count = states.rods.count
            if working_time() > self._ends:
                break
            pairs = np.sort(self._random.integers(count, size=(SAMPLES, 2)), axis=1)
            pairs = pairs[pairs[:, 1] > pairs[:, 0] + 1]
            if not len(pairs):
                break
            ways = self._space.ways(states.rods.take(pairs[:, 0]), states.rods.take(pairs[:, 1]))
            saved = np.where(ways.whole, pairs[:, 1] - pairs[:, 0] - ways.reach, 0)
            best = int(np.argmax(saved))
            if saved[best] > 0:
                first, last = pairs[best]
                states = joined_states([states.take(np.arange(first + 1)), ways.states.take(ways.rows(best)),
                                        states.take(np.arange(last + 1, count))])
        return states

    def _samples(self) -> Configuration:
        """Random rods at rest."""
        rest_length, anchor = self._start.rods.rest_length, self._space.anchor
        shapes = Shapes.at_random(SAMPLES, self._low, self._high, rest_length, anchor, self._random)
        if self._space.held_anchor:
            first = self._space.shapes(self._start.rods.take(np.zeros(len(shapes.place), dtype=int)))
            shapes = replace(shapes, place=first.place, frame=first.frame)
        states, sound = self._space.at_rest(shapes, np.zeros(SAMPLES, dtype=bool))
        return states.rods.take(np.flatnonzero(sound))
