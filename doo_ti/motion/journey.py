"""Rods carried by moving clamps: relaxed after each sub-step, kept to their branch, and their jumps counted (§III-D).

Each motion takes as many sub-steps as it needs itself, whatever other motions are computed beside it.

A jump: a rod whose clamps move loses its equilibrium and snaps to another one. A rod that stays on its branch changes by nearly
as much in one sub-step as in the next. Where it does not, the sub-step is repeated in eighths, and their result replaces it: a
branch that still exists is then followed, not skipped. A continuous change spreads over the eighths, even in front of a fold,
where the last eighth holds a third of it, two and a half times the one before. A jump lies within one eighth, and of two jumps
in a sub-step each exceeds the eighths beside it.

Axes: G materials, N motions, R = G·N rods, material by material, E edges.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from doo_ti.contact.surroundings import Surroundings
from doo_ti.motion.path import Motion
from doo_ti.relaxation.descent import Descent
from doo_ti.relaxation.external import PointLoads
from doo_ti.relaxation.newton import Newton
from doo_ti.relaxation.relax import relax
from doo_ti.rod.types import Configuration, Material, Solution, sticky

FEWEST_STEPS = 2  # sub-steps of a motion: jumps are found by comparing a sub-step with the one before
PARTS = 8
OUT_OF_PROPORTION = 0.5
"""A sub-step is repeated where the difference of two successive changes exceeds this share of the larger one: 0.1 on smooth
motions, 1 at a jump."""
UNDIVIDED = 0.5  # a part that holds more than this share of the change of all parts is a jump
ABRUPT = 6.0  # a part that changes this many times as much as the parts beside it is a jump, too
NOTABLE = 0.01  # rad, root mean square over the frames: smaller changes are no jumps
EVERY = 4  # every fourth edge is compared: that suffices for the change of a shape


class JumpCount:
    """Counts the jumps of R rods, sub-step by sub-step, and corrects sub-steps that skipped a branch.

    begin   the rods before the first sub-step
    finely  function of rows (n,), these n rods before a sub-step, its number, counted from zero, and a number of sub-steps:
            yields the solution of the rods after each part of these, with status and iterations since the first part
    watch   False: nothing is counted or corrected
    count   (R,) jumps so far
    """

    def __init__(self, begin: Configuration, finely: Callable[..., Iterator[Solution]], watch: bool = True):
        self.watch = watch
        self.count = np.zeros(begin.count, dtype=np.int32)
        self._finely = finely
        self._states, self._before = [begin], None
        self._change = self._size = self._judged = None
        self._step = 0

    def see(self, solution: Solution) -> None:
        """Take in the R rods after the next sub-step; where it is repeated in parts, their result is written into it."""
        if not self.watch:
            return
        frames = solution.configuration.quaternions
        change = _sample(frames) - _sample(self._states[-1].quaternions)
        size, judged = _size(change), np.zeros(len(frames), dtype=bool)
        if self._change is not None:
            larger = np.maximum(size, self._size)
            judged = (_size(change - self._change) > OUT_OF_PROPORTION * larger) & (larger > NOTABLE)
            earlier = judged & (size < self._size) & ~self._judged
            judged &= (size >= self._size) | earlier
            for rows, steps in ((np.flatnonzero(judged & ~earlier), 1), (np.flatnonzero(earlier), 2)):
                if len(rows):
                    self._repeat(rows, steps, solution)
            rows = np.flatnonzero(judged)
            change[rows] = _sample(frames[rows]) - _sample(self._states[-1].quaternions[rows])
            size[rows] = _size(change[rows])
        self._states, self._before = [self._states[-1], solution.configuration], solution
        self._change, self._size, self._judged = change, size, judged
        self._step += 1

    def _repeat(self, rows: np.ndarray, steps: int, solution: Solution) -> None:
        """Repeat the last ``steps`` sub-steps of some rods in parts, and count the jumps in them."""
        begin = self._states[-steps].take(rows)
        before, sizes = begin.quaternions, []
        for part, here in enumerate(self._finely(rows, begin, self._step + 1 - steps, steps), 1):
            after = here.configuration.quaternions
            sizes.append(_size(_sample(after) - _sample(before)))
            before = after
            if part == PARTS * steps:
                _put(solution, rows, here)
            elif part == PARTS * (steps - 1):
                _put(self._before, rows, here)
        size = np.nan_to_num(np.array(sizes))
        around = np.pad(size, ((1, 1), (0, 0)))
        beside = np.maximum(around[:-2], around[2:])
        self.count[rows] += ((size > NOTABLE) & (size > np.minimum(UNDIVIDED * size.sum(axis=0), ABRUPT * beside))).sum(axis=0)


def _put(solution: Solution, rows: np.ndarray, other: Solution) -> None:
    """Write ``other`` into those ``rows`` of every array of a solution."""
    for name, value in solution.per_rod.items():
        if value.flags.writeable:  # zeros of rods out of reach of obstacles are not
            value[rows] = getattr(other, name)
    solution.configuration.start[rows] = other.configuration.start
    solution.configuration.quaternions[rows] = other.configuration.quaternions


def _sample(frames: np.ndarray) -> np.ndarray:
    """Some of the frames between the clamped ones, whose signs are continuous from one state to the next; of two edges both."""
    return frames[:, 1:-1:EVERY] if frames.shape[1] > 2 else frames


def _size(change: np.ndarray) -> np.ndarray:
    """(R,) rad, root mean square over the edges, of changes of quaternions."""
    return 2 * np.sqrt(np.einsum("rek,rek->r", change, change) / change.shape[1])


@dataclass(frozen=True)
class Journey:
    """Each of N motions under each of G materials.

    motion       what the clamps do
    sub_step     rad, the largest turn of a clamp in one sub-step; its shift is limited in proportion
    rest_length  (E,) mm, or a row for each motion
    up           (3,) direction against gravity
    solver       as :func:`doo_ti.relaxation.relax.relax` takes it; Newton runs without its first shift, which stays closest to
                 the branch
    precision    of the last state; sub-steps run in f64 if that is chosen, else in f32, with f64 where f32 does not converge
    surroundings the obstacles that the R rods may touch, without friction
    loads        on their vertices, of one row or R
    """

    motion: Motion
    material: Material
    sub_step: float
    rest_length: np.ndarray
    up: np.ndarray = (0.0, 0.0, 1.0)
    solver: Newton | Descent = Newton()
    precision: str = "mixed"
    surroundings: Surroundings = Surroundings()
    loads: PointLoads | None = None

    @property
    def sub_steps(self) -> np.ndarray:
        """(N,) of each motion: powers of two, so that few different numbers occur; motions of equal number run together."""
        need = np.maximum(self.motion.needed_steps(self.rest_length, self.sub_step), FEWEST_STEPS)
        need = np.maximum(need, self.surroundings.steps_for(self.motion.start_shift))
        return 2 ** np.ceil(np.log2(need)).astype(np.int64)

    def end(self, begin: Configuration, watch: bool = True) -> tuple[Solution, np.ndarray]:
        """The R rods at the end of their motions, and the number of jumps of each (R,), if ``watch``.

        A rod that does not converge in some sub-step keeps that status. Iterations are those of all sub-steps.
        """
        groups, ends, counts = list(self._groups()), [], []
        for rods, steps, group in groups:
            here = begin.take(rods)
            jumps = JumpCount(here, group._finely(steps), watch)
            ends.append(_last(group._states(here, steps, jumps)))
            counts.append(jumps.count)
        order = np.argsort(np.concatenate([rods for rods, _, _ in groups]))
        return _together(ends, order), np.concatenate(counts)[order]

    def follow(self, begin: Configuration) -> Iterator[Solution]:
        """The R rods after each sub-step of the motions that take most; the others are shown at the nearest of their own
        sub-steps ahead. At last the rods once more in ``precision``, where sub-steps run in another one."""
        groups = list(self._groups())
        order, most = np.argsort(np.concatenate([rods for rods, _, _ in groups])), max(steps for _, steps, _ in groups)
        ways = [(list(group._states(begin.take(rods), steps)), steps) for rods, steps, group in groups]
        for step in range(1, most + 1):
            yield _together([states[-(-step * steps // most) - 1] for states, steps in ways], order)
        if self.precision != self._step_precision:
            yield _together([states[-1] for states, _ in ways], order)

    def _groups(self) -> Iterator[tuple[np.ndarray, int, "Journey"]]:
        """The rods (r,) whose motions take equally many sub-steps, that number, and their journey."""
        need, motions = self.sub_steps, self._motions
        first = motions * np.arange(self.material.count)[:, None]
        for steps in np.unique(need) if motions else [FEWEST_STEPS]:
            rows = np.flatnonzero(need == steps)
            rods = (first + rows).ravel()
            part = replace(self, motion=self.motion.take(rows), surroundings=self.surroundings.take(rods),
                           loads=None if self.loads is None else self.loads.take(rods % self.loads.count))
            yield rods, int(steps), part

    def _states(self, configuration: Configuration, steps: int, jumps: JumpCount | None = None) -> Iterator[Solution]:
        """The rods after each of ``steps`` sub-steps, and in ``precision`` at the end where sub-steps run in another one."""
        jumps = jumps or JumpCount(configuration, self._finely(steps))
        rods = np.arange(configuration.count)
        for step in range(steps):
            solution = self._relaxed(rods, configuration, (step + 1) / steps, self._step_precision)
            configuration = solution.configuration
            jumps.see(solution)
            yield solution
        if self.precision != self._step_precision:
            yield self._relaxed(rods, configuration, 1.0, self.precision)

    def _finely(self, steps: int):
        """What :class:`JumpCount` calls to repeat sub-steps in smaller parts, of motions that take ``steps``."""
        def repeated(rods: np.ndarray, here: Configuration, step: int, repeats: int) -> Iterator[Solution]:
            status, iterations = np.zeros(len(rods), dtype=np.int8), np.zeros(len(rods), dtype=np.int32)
            for part in range(1, PARTS * repeats + 1):
                solution = self._relaxed(rods, here, (step + part / PARTS) / steps, self._step_precision)
                status, iterations = sticky(status, solution.status), iterations + solution.iterations
                here = solution.configuration
                yield replace(solution, status=status, iterations=iterations)
        return repeated

    def _relaxed(self, rods: np.ndarray, configuration: Configuration, share: float, precision: str) -> Solution:
        """``rods`` relaxed from ``configuration`` under the clamps after ``share`` of the motion."""
        solver = replace(self.solver, first_shift=0.0) if isinstance(self.solver, Newton) else self.solver
        return relax(configuration, self.material, self.motion.at(share).take(rods % self._motions), solver, up=self.up,
                     precision=precision, configuration_index=np.arange(len(rods)), material_index=rods // self._motions,
                     external=self.loads, external_index=None if self.loads is None else rods % self.loads.count,
                     **self.surroundings.take(rods).arguments)

    @property
    def _step_precision(self) -> str:
        """Precision of the sub-steps."""
        return "f64" if self.precision == "f64" else "f32"

    @property
    def _motions(self) -> int:
        """N, the number of motions."""
        return len(self.motion.clamps.start_position)


def _last(states: Iterator[Solution]) -> Solution:
    """The last of several states, with the first status that was not converged and the iterations of all."""
    status = iterations = 0
    for solution in states:
        status, iterations = sticky(status, solution.status), iterations + solution.iterations
    return replace(solution, status=status, iterations=iterations)


def _together(parts: list[Solution], order: np.ndarray) -> Solution:
    """One solution of several, its rods in ``order``."""
    return parts[0] if len(parts) == 1 else Solution.concatenate(parts).take(order)
