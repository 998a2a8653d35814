"""Paths of both grippers that bring a rod to a shape far away, or on another branch of equilibria (§VI).

    path = plan_manipulation(rod, material, clamps, Targets(vertices))
    path.reached, path.distance          # mm; a target out of reach: the nearest that was found
    predict(rod, material, clamps, path)

The target's equilibria are found first (:mod:`.goal`). A straight motion of the grippers to one of them is tried; then ways on
which the rod is unwound to one that is nearly straight, and wound up to the goal (:func:`.legs.unwound`); then two trees of
equilibria, from the start and from the goals, that grow towards each other (:mod:`.tree`). Every leg is followed on the model,
in sub-steps, by :class:`doo_ti.motion.journey.Journey`: a rod that loses its stability, or jumps, has not followed it. The way
that is found is shortened, and followed once more as a whole.

Axes: T moments, N nodes, M samples.
"""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from doo_ti.contact.obstacles import Obstacle
from doo_ti.contact.surroundings import Surroundings
from doo_ti.io.motion_file import ClampPath
from doo_ti.manipulation.goal import Goal, Model, all_goals
from doo_ti.manipulation.legs import Carrier, between, unwound
from doo_ti.manipulation.poses import change_between, joined, moved
from doo_ti.manipulation.targets import ServoOptions, Targets
from doo_ti.manipulation.tree import Tree
from doo_ti.prediction.predict import predict
from doo_ti.rod.material import Material
from doo_ti.rod.types import Clamp, Clamps, Configuration, unit_up
from doo_ti.system.arguments import owning, typed
from doo_ti.system.errors import InputError, require_whole

SAMPLES = 24
"""Poses that a tree grows towards at once."""
SPREAD_MM, SPREAD = 0.25, 0.8
"""Of samples about the line between two nodes: of the rod's length, and rad."""
WIDER = 2.0
"""Factor between the three spreads of rods that are shifted as one, which obstacles may be in the way of."""
MOMENT = 0.05
"""Of the rod's length, and as many rad times the lever: longest motion from one moment of the path to the next."""
SHORTCUTS = 3
"""Rounds in which the way is shortened."""
SECOND = 10.0
"""mm that the grippers move in a second of the path's time."""


@typed
@dataclass(frozen=True)
class PlanOptions:
    """How a plan is made.

    free        which grippers' coordinates move, as in :class:`~doo_ti.manipulation.targets.ServoOptions`
    reached_mm  distance to the target, weighted root mean square, at which it is reached
    lever_mm    mm that count as much as a radian
    seconds     longest search
    seed        of the samples

    Raises InputError for numbers that are not positive.
    """

    free: tuple[str, ...] = ServoOptions.free
    reached_mm: float = 0.5
    lever_mm: float = 60.0
    seconds: float = 10.0
    seed: int = 0

    def __post_init__(self) -> None:
        ServoOptions(free=self.free)
        require_whole("PlanOptions", "seed", self.seed, 0)
        for name in ("reached_mm", "lever_mm", "seconds"):
            if not 0 < getattr(self, name) < 1e6:
                raise InputError("PlanOptions", name, f"{getattr(self, name):g}", "give a positive number")


@owning
@dataclass(frozen=True)
class ManipulationPath(ClampPath):
    """A path of both grippers on which a rod stays at certified rest.

    distance  mm, weighted root mean square, of the rod at its end from the target
    reached   whether that is within ``reached_mm``
    """

    distance: float = np.inf
    reached: bool = False


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
    surroundings = Surroundings.checked("plan_manipulation", obstacles, radius, 1)
    up = unit_up(up, "plan_manipulation")
    _check(rod, material, clamps, targets, surroundings)
    carrier = Carrier(material, rod.rest_length, up, surroundings)
    begin, goals, carrier = _ends(rod, clamps, targets, options, carrier)
    search = _Search(begin, clamps, carrier, targets, goals, options)
    found = []
    # What was followed leg by leg may part as a whole where branches are near each other: the search then goes on.
    for rods, way in search.ways():
        for candidate in (search.shortened(rods, way), way):
            found.append(_path(rod, material, clamps, candidate, targets, options, carrier))
            if found[-1].reached:
                return found[-1]
    return min(found, key=lambda path: path.distance)


def _ends(rod: Configuration, clamps: Clamps, targets: Targets, options: PlanOptions, carrier: Carrier
          ) -> tuple[Configuration, Goal, Carrier]:
    """The rod at rest, its goals, and the carrier: rods touch obstacles only where the rod does at the beginning, or at its
    goal. Raises InputError for a rod that is not at rest."""
    servo = ServoOptions(free=options.free, lever_mm=options.lever_mm, reached_mm=options.reached_mm)
    for touches in (False, True) if carrier.surroundings else (False,):
        model = Model(carrier.material, np.zeros((1, 12)), carrier.up, carrier.surroundings if touches else Surroundings())
        begin = model.relaxed(rod, clamps)
        if (begin.converged & begin.stable).all():
            goals = all_goals(begin.configuration, clamps, model, targets, servo)
            if touches or not carrier.surroundings:
                break
            clear = carrier.clear(goals.rods.vertices)
            nearest = goals.distance[clear].min(initial=np.inf)
            if carrier.clear(begin.configuration.vertices).all() and nearest <= options.reached_mm:
                goals = goals.take(np.flatnonzero(clear))
                break
    if not (begin.converged & begin.stable).all():
        raise InputError("plan_manipulation", "rod", "no stable equilibrium under its clamps", "give a rod at rest under them")
    return begin.configuration, goals, replace(carrier, touches=touches)


class _Search:
    """The way from a rod to one of its goals."""

    def __init__(self, rod: Configuration, clamps: Clamps, carrier: Carrier, targets: Targets, goals: Goal,
                 options: PlanOptions):
        self._targets, self._carrier, self._options = targets, carrier, options
        self._random = np.random.default_rng(options.seed)
        self._ends = time.monotonic() + options.seconds
        found = np.flatnonzero(np.isfinite(goals.distance))
        near = found[goals.distance[found] <= max(options.reached_mm, 1.2 * goals.distance[found].min(initial=np.inf))]
        self._tree = Tree(rod, clamps, carrier, options.lever_mm)
        self._goals = None
        here = targets.distance(rod.vertices)[0]
        if len(near) and goals.distance[near[0]] < here:
            self._goals = Tree(goals.rods.take(near), goals.clamps.take(near), carrier, options.lever_mm, back=True)

    def ways(self) -> Iterator[tuple[Configuration, Clamps]]:
        """The rods and the grippers' poses at the ends of the legs of ways to the goals, from the first ones on; at last of the
        way to the nearest node."""
        if self._goals is not None:
            for attempt in (self._direct, self._unwinding):
                yield from attempt()
            while time.monotonic() < self._ends:
                yield from self._growing()
        nearest = int(np.argmin(self._targets_distance()))
        nodes = np.array(self._tree.way(nearest))
        yield self._tree.rods.take(nodes), self._tree.clamps.take(nodes)

    def shortened(self, rods: Configuration, way: Clamps) -> Clamps:
        """The way without poses that a straight motion can leave out: the longest that can, again and again."""
        for _ in range(SHORTCUTS):
            count = way.count
            if count < 3:
                break
            first, last = np.triu_indices(count, 2)
            chosen = self._random.permutation(len(first))[:SAMPLES]
            first, last = first[chosen], last[chosen]
            ends, sound = self._carrier.carry(rods.take(first), way.take(first), way.take(last))
            good = np.flatnonzero(sound & self._carrier.same(ends, rods.take(last)))
            if len(good):
                best = good[np.argmax((last - first)[good])]
                kept = np.concatenate([np.arange(first[best] + 1), np.arange(last[best], count)])
                rods, way = rods.take(kept), way.take(kept)
        return way

    def _direct(self) -> Iterator[tuple[Configuration, Clamps]]:
        """The straight motions to the goals."""
        yield from self._met(np.zeros(self._goals.count, dtype=int), np.arange(self._goals.count))

    def _unwinding(self) -> Iterator[tuple[Configuration, Clamps]]:
        """Both trees unwound as far as their rods follow, and straight motions between what they have become."""
        ends = [[0], [0]]
        for tree, found in zip((self._tree, self._goals), ends, strict=True):
            nodes = np.arange(tree.roots)
            ways = [list(unwound(tree.rods.take([root]), tree.clamps.take([root]))) for root in nodes]
            for pieces in zip(*ways, strict=True):
                going = nodes >= 0
                poses = self._fixed(joined([piece for piece, goes in zip(pieces, going, strict=True) if goes]))
                nodes[going] = tree.extend(nodes[going], poses, whole=True)
                found += [int(node) for node in nodes if node >= 0]
                if (nodes < 0).all():
                    break
        pairs = np.array([(one, other) for one in ends[0] for other in ends[1]])
        change = change_between(self._tree.clamps.take(pairs[:, 0]), self._goals.clamps.take(pairs[:, 1]))
        order = np.argsort(np.linalg.norm(change, axis=1))[:SAMPLES]
        yield from self._met(pairs[order, 0], pairs[order, 1])

    def _growing(self) -> Iterator[tuple[Configuration, Clamps]]:
        """Both trees grown towards samples and towards each other, by turns."""
        for tree, other in ((self._tree, self._goals), (self._goals, self._tree)):
            samples = self._fixed(self._samples())
            new = tree.extend(tree.nearest(samples), samples)
            new = new[new >= 0]
            if len(new):
                there = other.nearest(tree.clamps.take(new), tree.rods.take(new).vertices)
                yield from self._met(*((new, there) if tree is self._tree else (there, new)))

    def _met(self, nodes: np.ndarray, others: np.ndarray) -> Iterator[tuple[Configuration, Clamps]]:
        """The way over a straight motion from one of ``nodes`` to that of ``others`` among the goals' nodes, if a rod comes to
        the same equilibrium."""
        tree, goals = self._tree, self._goals
        new = tree.extend(nodes, goals.clamps.take(others), whole=True)
        rows = np.flatnonzero(new >= 0)
        same = self._carrier.same(tree.rods.take(new[rows]), goals.rods.take(others[rows]))
        if not same.any():
            return
        one = rows[np.argmax(same)]
        first, last = np.array(tree.way(int(new[one]))), np.array(goals.way(int(others[one]))[-2::-1], dtype=int)
        yield (Configuration.concatenate([tree.rods.take(first), goals.rods.take(last)]),
               joined([tree.clamps.take(first), goals.clamps.take(last)]))

    def _samples(self) -> Clamps:
        """Poses about the straight motions between nodes of both trees, and, as many, those of nodes shifted as one."""
        random, half = self._random, SAMPLES // 2
        one, other = (random.integers(tree.count, size=half) for tree in (self._tree, self._goals))
        begin, end, share = self._tree.clamps.take(one), self._goals.clamps.take(other), random.random(half)
        spread = np.repeat([SPREAD_MM * self._carrier.length, SPREAD] * 2, 3)
        apart = moved(between(begin, end, share), spread * random.normal(size=(half, 12)))
        way = 0.5 * (end.start_position + end.end_position - begin.start_position - begin.end_position)
        far = SPREAD_MM * self._carrier.length * WIDER ** random.integers(3, size=(half, 1))
        shift = share[:, None] * way + far * random.normal(size=(half, 3))
        return joined([apart, moved(begin, np.concatenate([shift, 0 * shift, shift, 0 * shift], axis=1))])

    def _fixed(self, poses: Clamps) -> Clamps:
        """``poses`` with the coordinates that are not free as at the beginning."""
        moves = ServoOptions(free=self._options.free).moves
        if moves.all():
            return poses
        root = self._tree.clamps.take(np.zeros(poses.count, dtype=int))
        return moved(root, change_between(root, poses) * moves)

    def _targets_distance(self) -> np.ndarray:
        every = np.zeros(self._tree.count, dtype=int)
        return self._targets.take(every).distance(self._tree.rods.vertices)


def _path(rod: Configuration, material: Material, clamps: Clamps, way: Clamps, targets: Targets, options: PlanOptions,
          carrier: Carrier) -> ManipulationPath:
    """The path along the legs of a way, and where the rod ends that follows it."""
    way = way if way.count > 1 else way.take([0, 0])
    change = change_between(way.take(np.arange(way.count - 1)), way.take(np.arange(1, way.count)))
    size = np.linalg.norm(change * np.repeat([1.0, options.lever_mm] * 2, 3), axis=1)
    moments = np.maximum(np.ceil(size / (MOMENT * carrier.length)), 1).astype(int)
    legs = np.concatenate([[0], np.repeat(np.arange(len(moments)), moments)])
    share = np.concatenate([[0.0], *(np.arange(1, count + 1) / count for count in moments)])
    poses = between(way.take(legs), way.take(legs + 1), share)
    seconds = np.concatenate([[0.0], np.cumsum(np.maximum(np.repeat(size / moments, moments), 1e-3))]) / SECOND
    arrays = dict(start_position=poses.start_position[:, None], end_position=poses.end_position[:, None],
                  start_frame=poses.start_frame[:, None], end_frame=poses.end_frame[:, None])
    path = ManipulationPath(seconds, source="plan", **arrays)
    around = carrier.surroundings.arguments if carrier.touches else {}
    followed = predict(rod, material, clamps, path, up=carrier.up, **around)
    distance = float(targets.distance(followed.vertices[-1])[0])
    sound = bool(followed.followed[-1].all()) and not followed.jumps.any()
    if carrier.surroundings and not carrier.touches:
        sound &= bool(carrier.clear(followed.vertices[:, 0]).all())
    reached = sound and distance <= options.reached_mm
    return ManipulationPath(seconds, source="plan", distance=distance, reached=reached, **arrays)


def _check(rod: Configuration, material: Material, clamps: Clamps, targets: Targets, surroundings: Surroundings) -> None:
    """Raise InputError for what cannot be planned."""
    for name, rows in (("rod", rod.count), ("material", material.count), ("clamps", clamps.count), ("targets", targets.count)):
        if rows != 1:
            raise InputError("plan_manipulation", name, f"{rows} rows", "give one rod")
    if targets.vertices.shape[1] != rod.edges + 1:
        raise InputError("plan_manipulation", "targets", f"{targets.vertices.shape[1]} vertices for a rod of {rod.edges + 1}",
                         "give a place, or NaN, for each vertex")
    if rod.rest_length.ndim != 1:
        raise InputError("plan_manipulation", "rod", "rest lengths (1, E)", "give (E,)")
    if surroundings.rub:
        raise InputError("plan_manipulation", "obstacles", "with friction", "give obstacles without friction")
    if not all((np.asarray(kind) >= Clamp.TANGENT).all() for kind in (clamps.start, clamps.end)):
        raise InputError("plan_manipulation", "clamps", "that hold no direction", "give clamps that hold tangents or frames")
