"""Paths of both grippers that bring a rod to a shape far away, or on another branch of equilibria (§VI).

    path = plan_manipulation(rod, material, clamps, Targets(vertices))
    path.reached, path.distance          # mm; a target out of reach: the nearest that was found
    predict(rod, material, clamps, path)

The target's equilibria are found first (:mod:`.targets`). Two trees of equilibria (:mod:`.equilibria`), from the start and from
the goals, grow towards random ones and towards each other, by many ways at once (Kuffner and LaValle, *RRT-Connect*, ICRA
2000). The way that is found is shortened, and followed in sub-steps by :func:`~doo_ti.motion.predict.predict`: where the rod
loses its stability, or jumps, the search goes on without that leg.

Axes: N nodes, M samples, T moments and states, R rods.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from doo_ti.contact.obstacles import Obstacle
from doo_ti.contact.surroundings import Surroundings
from doo_ti.io.motion_file import ClampPath
from doo_ti.manipulation.equilibria import CLEAR, Clearance, Equilibria, Shapes, States, Tree, joined_states
from doo_ti.manipulation.model import Model, change_between
from doo_ti.manipulation.targets import ServoOptions, Targets, fitted_guesses, require_free, require_places
from doo_ti.motion.predict import predict
from doo_ti.relaxation.relax import clamp_change, mesh_change
from doo_ti.rod.material import Material
from doo_ti.rod.types import POSES, Clamp, Clamps, Configuration, unit_up
from doo_ti.system.arguments import owning, typed
from doo_ti.system.errors import InputError, require_whole
from doo_ti.system.runtime import working_time

SAMPLES = 32  # random rods that a tree grows towards at once, and ways that are tried for a shortcut
AROUND = 0.5  # of the rod's length: random rods are at most so far outside the box around the rod and its goals
SHORTCUTS = 4  # rounds in which a way is shortened
DETOUR, SHARE = 2.0, 0.1  # goals so many times farther away than the nearest are tried after that share of the time
NEARLY = 1.2  # goals that are so many times further from the target than the nearest one count as well
LEAST = 1e-2  # mm, between two moments
SECOND = 10.0  # mm that the grippers move in a second of the path's time


@typed
@dataclass(frozen=True)
class PlanOptions:
    """How a plan is made.

    free        which grippers' coordinates move, as in :class:`~doo_ti.manipulation.targets.ServoOptions`
    reached_mm  distance to the target, weighted root mean square, at which it is reached
    lever_mm    mm that count as much as a radian
    seconds     longest search, without the time that kernels take to compile; the way that was found is then followed once
                more
    seed        of the samples

    Raises InputError for numbers that are not positive.
    """

    free: tuple[str, ...] = ServoOptions.free
    reached_mm: float = 0.5
    lever_mm: float = 60.0
    seconds: float = 10.0
    seed: int = 0

    def __post_init__(self) -> None:
        require_free("PlanOptions", self.free)
        require_whole("PlanOptions", "seed", self.seed, 0)
        for name in ("reached_mm", "lever_mm", "seconds"):
            if not 0 < getattr(self, name) < 1e6:
                raise InputError("PlanOptions", name, f"{getattr(self, name):g}", "give a positive number")


@owning
@dataclass(frozen=True)
class ManipulationPath(ClampPath):
    """A path of both grippers on which a rod stays at certified rest.

    distance    mm, weighted root mean square, of the rod at its end from the target
    reached     whether that is within ``reached_mm``
    mesh_error  mm by which a rod of many edges ends elsewhere, about, by one whose edges are half as long; infinite where that
                one does not come to rest there
    clamp_error  mm by which one ends elsewhere whose clamps end at its end vertices instead of in the middle of its outer
                edges; or infinite
    smallest_gap  mm from obstacles to the rod's surface, on all of the path; zero where it touches, infinite without obstacles
    smallest_radius  mm, of the rod's curvature at a joint, on all of the path
    """

    distance: float = np.inf
    reached: bool = False
    mesh_error: float = np.nan
    clamp_error: float = np.nan
    smallest_gap: float = np.inf
    smallest_radius: float = np.inf


@typed
def plan_manipulation(rod: Configuration, material: Material, clamps: Clamps, targets: Targets,
                      options: PlanOptions | None = None, *, up: ArrayLike = (0.0, 0.0, 1.0),
                      obstacles: Sequence[Obstacle] = (), radius: ArrayLike | None = None) -> ManipulationPath:
    """The path of the grippers of one rod from ``clamps`` to where the rod is nearest to its target; every state of it is
    certified stable, and the rod jumps nowhere.

    rod, clamps  one row, at or near rest
    material     one row, round
    targets      one row
    obstacles, radius  as in :func:`doo_ti.relaxation.relax.relax`, at rest and without friction

    Where no way to the target is found in ``seconds``, the path ends at the nearest state that was; ``reached`` says so. A path
    whose rod does not move has two equal moments. Raises InputError for more than one rod, a rod that is not at rest under its
    clamps, and clamps that hold no frame.
    """
    options = PlanOptions() if options is None else options
    ends = working_time() + options.seconds
    surroundings = Surroundings.checked("plan_manipulation", obstacles, radius, 1)
    up = unit_up(up, "plan_manipulation")
    _check(rod, material, clamps, targets, surroundings)
    moves = ServoOptions(free=options.free).moves
    space = Equilibria(material, Clearance(surroundings, float(rod.rest_length.sum()), rod.edges), up, clamps, moves,
                       options.lever_mm)
    return _Planner(space, rod, clamps, targets, options, ends).path()


class _Planner:
    """One plan: where it begins, what it may lead to, and the ways between. Nothing is searched after ``ends`` of
    :func:`.working_time`."""

    def __init__(self, space: Equilibria, rod: Configuration, clamps: Clamps, targets: Targets, options: PlanOptions,
                 ends: float):
        self._space, self._targets, self._options, self._ends = space, targets, options, ends
        self._begin, goals = self._begin_and_goals(rod, clamps)
        self._start, self._goals, self._every = Tree(self._begin.rods, space), Tree(goals, space), goals
        self._random = np.random.default_rng(options.seed)
        places = np.concatenate([tree.rods.vertices.reshape(-1, 3) for tree in (self._start, self._goals)])
        self._low, self._high = places.min(axis=0) - AROUND * space.length, places.max(axis=0) + AROUND * space.length

    def _begin_and_goals(self, rod: Configuration, clamps: Clamps) -> tuple[States, Configuration]:
        """The rod at rest, and its goals. These touch obstacles only where none that is as near as is asked does not. Raises
        InputError for a rod that is not at rest."""
        options, space = self._options, self._space
        servo = ServoOptions(free=options.free, lever_mm=options.lever_mm, reached_mm=options.reached_mm)
        model = Model(space.material, np.zeros((1, 12)), space.up, space.clearance.surroundings)
        begin = model.relaxed(rod, clamps)
        if not (begin.converged & begin.stable).all():
            raise InputError("plan_manipulation", "rod", "no stable equilibrium under its clamps",
                             "give a rod at rest under them")
        for around in (Surroundings(), model.surroundings)[: 1 + bool(model.surroundings)]:
            goals = fitted_guesses(begin.configuration, clamps, replace(model, surroundings=around), self._targets, servo)
            clear = np.isfinite(goals.distance) & (bool(around) | (space.clearance.of(goals.rods.vertices) > 0))
            nearest_first = np.argsort(goals.distance, kind="stable")
            goals = goals.take(nearest_first[clear[nearest_first]])
            if goals.distance.min(initial=np.inf) <= options.reached_mm:
                break
        here = self._targets.distance(begin.configuration.vertices)[0]
        nearest = goals.distance.min(initial=here)
        near = np.flatnonzero((goals.distance <= max(options.reached_mm, NEARLY * nearest)) & (goals.distance < here))
        near = self._different(begin.configuration, goals.rods, near)
        return States(begin.configuration, clamps, np.zeros(1, dtype=bool)), goals.rods.take(near)

    def _different(self, begin: Configuration, rods: Configuration, rows: np.ndarray) -> np.ndarray:
        """Those ``rows`` of which no other has the same shape and needs the grippers to roll less from ``begin`` on."""
        shapes, away = rods.vertices[rows], self._away(begin, rods.take(rows))
        same = self._space.same(shapes[:, None], shapes)
        return rows[(away[:, None] <= np.where(same, away, np.inf)).all(axis=1)]

    def path(self) -> ManipulationPath:
        """The path to a goal, or to the nearest node; at first to goals near the start: others may be easier to reach, by ways
        that nobody would go."""
        away, ends, every = self._away(self._begin.rods, self._every), self._ends, self._every
        near = np.flatnonzero(away <= DETOUR * away.min(initial=np.inf))
        if len(near) < every.count:
            self._goals, self._ends = Tree(every.take(near), self._space), working_time() + SHARE * self._options.seconds
            path = self._path()
            if path.reached:
                return path
            self._start, self._goals, self._ends = Tree(self._begin.rods, self._space), Tree(every, self._space), ends
        return self._path()

    def _away(self, begin: Configuration, rods: Configuration) -> np.ndarray:
        """(N,) mm from the rod ``begin`` to N others."""
        shapes, space = self._space.shapes(rods), self._space
        return space.shapes(begin).take(np.zeros(rods.count, dtype=int)).apart(shapes, space.lever)

    def _path(self) -> ManipulationPath:
        """The path to one of the present goals, or to the nearest node."""
        start, goals, best = self._start, self._goals, None
        if not goals.rods.count:
            return self._followed(joined_states([self._begin, self._begin]))[0]
        # What was joined from states may part where branches are near each other: the search then goes on.
        for first, last in self._found():
            states, leg = self._states(first, last)
            for own in (self._shortened(states), states):
                path, broken = self._followed(own)
                if broken == own.rods.count:
                    return path
                best = path if best is None or path.distance < best.distance else best
            if leg[broken] < len(first) - 1:
                start.cut(first[leg[broken] + 1])
            else:
                goals.cut(last[max(leg[broken] - len(first), 0)])
        every = np.zeros(start.rods.count, dtype=int)
        distance = np.where(start.alive, self._targets.take(every).distance(start.rods.vertices), np.inf)
        path, _ = self._followed(self._states(start.branch(int(np.argmin(distance))), [])[0])
        return path if best is None or path.distance < best.distance else best

    def _found(self) -> Iterator[tuple[list[int], list[int]]]:
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

    def _shortened(self, states: States) -> States:
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
            saved = np.where(ways.is_clear, pairs[:, 1] - pairs[:, 0] - ways.reach, 0)
            best = int(np.argmax(saved))
            if saved[best] > 0:
                first, last = pairs[best]
                states = joined_states([states.take(np.arange(first + 1)), ways.states.take(ways.rows(best)),
                                        states.take(np.arange(last + 1, count))])
        return states

    def _samples(self) -> Configuration:
        """Random rods at rest that touch nothing, as a way may touch obstacles where one of its ends does."""
        rest_length, anchor = self._start.rods.rest_length, self._space.anchor
        shapes = Shapes.at_random(SAMPLES, self._low, self._high, rest_length, anchor, self._random)
        if not (self._space.moves[:6].any() and self._space.moves[6:].any()):  # a gripper that does not move holds the anchor
            first = self._space.shapes(self._start.rods.take(np.zeros(len(shapes.place), dtype=int)))
            shapes = replace(shapes, place=first.place, frame=first.frame)
        states, sound = self._space.at_rest(shapes, np.zeros(SAMPLES, dtype=bool))
        return states.rods.take(np.flatnonzero(sound & ~self._space.touch(states.rods)))

    def _states(self, first: list[int], last: list[int]) -> tuple[States, np.ndarray]:
        """All states of the way through nodes of both trees, and after which of these, in that order, each comes."""
        nodes = Configuration.concatenate([tree.rods.take(np.array(own, dtype=np.int64))
                                           for tree, own in ((self._start, first), (self._goals, last))])
        if nodes.count < 2:
            return joined_states([self._begin, self._begin]), np.zeros(2, dtype=int)
        own = np.arange(nodes.count - 1)
        ways = self._space.ways(nodes.take(own), nodes.take(own + 1))
        return joined_states([self._begin, ways.states]), np.append(0, ways.way)

    def _followed(self, states: States) -> tuple[ManipulationPath, int]:
        """The path through T states as far as the rod follows it, certified, without a jump and clear of obstacles; and the
        number of states that it comes to."""
        clamps, rods = states.clamps, self._begin.rods
        change = change_between(clamps.take(np.arange(clamps.count - 1)), clamps.take(np.arange(1, clamps.count)))
        size = np.linalg.norm(change * np.repeat([1.0, self._space.lever] * 2, 3), axis=1)
        time = np.append(0.0, np.cumsum(np.maximum(size, LEAST))) / SECOND
        arrays = {name: getattr(clamps, name)[:, None] for name in POSES}
        shapes, passed = states.rods.vertices, []
        reached, turns = 0, 1 + np.flatnonzero(np.diff(states.touching[1:]))
        for first, last in pairwise([0, *turns, clamps.count - 1]):
            rows, touches = slice(first, last + 1), states.touching[last]
            part = ClampPath(time[rows], **{name: values[rows] for name, values in arrays.items()})
            around = self._space.clearance.surroundings.arguments if touches else {}
            seen = predict(rods, self._space.material, clamps.take([first]), part, up=self._space.up, **around)
            sound = seen.followed[:, 0] & (np.cumsum(seen.jumps[:, 0]) == 0)
            sound[1:] &= touches | self._clear(seen.vertices[:, 0])
            sound &= self._space.same(seen.vertices[:, 0], shapes[rows])
            count = len(sound) if sound.all() else max(int(np.argmin(sound)), 1)
            passed.append(Configuration(seen.start[:count, 0], seen.quaternions[:count, 0], seen.rest_length))
            rods, reached = seen.at(count - 1), first + count - 1
            if count < len(sound):
                break
        distance = float(self._targets.distance(rods.vertices)[0])
        rows = np.arange(reached + 1) if reached else [0, 0]
        held, touches = clamps.take([reached]), bool(states.touching[reached])
        mesh, clamp = (self._error(change, rods, held, touches) for change in (mesh_change, clamp_change))
        arrays, every = {name: values[rows] for name, values in arrays.items()}, Configuration.concatenate(passed)
        around = self._space.clearance.around(every.count)
        gap = float(around.smallest_gap(every.vertices).min()) if around else np.inf
        return ManipulationPath(
            time[: len(rows)], source="plan", distance=distance, mesh_error=mesh, clamp_error=clamp,
            smallest_gap=max(gap, 0.0), smallest_radius=float(1 / max(every.curvature.max(), 1e-12)), **arrays,
            reached=distance <= self._options.reached_mm), reached + 1

    def _error(self, change: Callable, rod: Configuration, clamps: Clamps, touches: bool) -> float:
        """mm, weighted root mean square, by which ``change`` has a rod rest elsewhere; infinite where it says nothing."""
        around = self._space.clearance.surroundings if touches else Surroundings()
        found = change(rod, self._space.material, clamps, self._space.up, around)[0]
        error = np.sqrt(self._targets.shares[0] @ np.sum(found**2, axis=-1))
        return float(error) if np.isfinite(error) else np.inf

    def _clear(self, vertices: np.ndarray) -> np.ndarray:
        """(T − 1,) bool: whether a rod of vertices (T, V, 3) touches nothing until each moment, from the one before."""
        gap = self._space.clearance.of(vertices) + CLEAR * self._space.length
        return self._space.clearance.between(vertices[:-1], vertices[1:], gap[:-1], gap[1:])


def _check(rod: Configuration, material: Material, clamps: Clamps, targets: Targets, surroundings: Surroundings) -> None:
    """Raise InputError for what cannot be planned."""
    for name, rows in (("rod", rod.count), ("material", material.count), ("clamps", clamps.count), ("targets", targets.count)):
        if rows != 1:
            raise InputError("plan_manipulation", name, f"{rows} rows", "give one rod")
    require_places("plan_manipulation", rod, targets)
    if surroundings.rub:
        raise InputError("plan_manipulation", "obstacles", "with friction", "give obstacles without friction")
    if not all((np.asarray(kind) >= Clamp.TANGENT).all() for kind in (clamps.start, clamps.end)):
        raise InputError("plan_manipulation", "clamps", "that hold no direction", "give clamps that hold tangents or frames")
