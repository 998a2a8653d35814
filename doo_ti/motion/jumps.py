"""Jumps: where a rod that is carried loses its equilibrium and falls to another one (§III-D).

A rod that keeps to its branch changes by nearly as much in one sub-step as in the next. Where it does not, the sub-step is
made again in eighths, and what comes of those counts: a branch that is still there is then followed, not skipped. A continuous
change is spread over the eighths, even in front of a fold, whose last one holds a third of it, two and a half times the one
before; a fall stays whole in one, and of two falls in a sub-step each stands out from the eighths beside it.

Axes: R rods, E edges.
"""

from collections.abc import Callable, Iterator
from dataclasses import fields

import numpy as np

from doo_ti.types import Solution

PARTS = 8
OUT_OF_PROPORTION = 0.5
"""The change of the change over the change, above which a sub-step is made again: 0.1 on smooth ways, 1 at a fall."""
UNDIVIDED = 0.5
"""Of the way through all parts, in one of them: then it is a fall."""
ABRUPT = 6.0
"""Times what the parts beside it change: then it is a fall, too."""
NOTABLE = 0.01
"""rad that frames turn by, root mean square: less is no fall."""
EVERY = 4
"""Edges that are compared: each fourth tells the change of a shape."""


class JumpCount:
    """Counts the falls of R rods, sub-step by sub-step, and mends what a sub-step skipped.

    frames  (R, E, 4) where they set out
    finely  from rows (n,), their frames (n, E, 4), a sub-step, counted from zero, and how many of them, to the solution of the
            n rods after each of their parts, status and iterations since they began
    watch   whether it does; else it lets all pass
    count   (R,) falls so far
    """

    def __init__(self, frames: np.ndarray, finely: Callable[..., Iterator[Solution]], watch: bool = True):
        self.watch = watch
        self.count = np.zeros(len(frames), dtype=np.int32)
        self._finely = finely
        self._states, self._before = [frames], None
        self._change = self._size = self._judged = None
        self._step = 0

    def see(self, solution: Solution) -> None:
        """Take in the R rods after the next sub-step; where it was made again, put what came of that, in place."""
        if not self.watch:
            return
        frames = solution.configuration.quaternions
        change = _sample(frames) - _sample(self._states[-1])
        size, judged = _size(change), np.zeros(len(frames), dtype=bool)
        if self._change is not None:
            larger = np.maximum(size, self._size)
            judged = (_size(change - self._change) > OUT_OF_PROPORTION * larger) & (larger > NOTABLE)
            earlier = judged & (size < self._size) & ~self._judged
            judged &= (size >= self._size) | earlier
            for rows, steps in ((np.flatnonzero(judged & ~earlier), 1), (np.flatnonzero(earlier), 2)):
                if len(rows):
                    self._make_again(rows, steps, solution)
            rows = np.flatnonzero(judged)
            change[rows] = _sample(frames[rows]) - _sample(self._states[-1][rows])
            size[rows] = _size(change[rows])
        self._states, self._before = [self._states[-1], frames], solution
        self._change, self._size, self._judged = change, size, judged
        self._step += 1

    def _make_again(self, rows: np.ndarray, steps: int, solution: Solution) -> None:
        """The last ``steps`` sub-steps of some rods in parts."""
        before = self._states[-steps][rows]
        sizes = []
        for part, here in enumerate(self._finely(rows, before, self._step + 1 - steps, steps), 1):
            after = here.configuration.quaternions
            sizes.append(_size(_sample(after) - _sample(before)))
            before = after
            if part == PARTS * steps:
                _put(solution, rows, here)
            elif part == PARTS * (steps - 1):
                _put(self._before, rows, here)
        way = np.nan_to_num(np.array(sizes))
        around = np.pad(way, ((1, 1), (0, 0)))
        beside = np.maximum(around[:-2], around[2:])
        self.count[rows] += ((way > NOTABLE) & (way > np.minimum(UNDIVIDED * way.sum(axis=0), ABRUPT * beside))).sum(axis=0)


def _put(solution: Solution, rows: np.ndarray, other: Solution) -> None:
    """``other`` in the place of some rods, in all that a solution tells of them."""
    for name in (field.name for field in fields(Solution) if field.name not in ("configuration", "tables")):
        getattr(solution, name)[rows] = getattr(other, name)
    solution.configuration.start[rows] = other.configuration.start
    solution.configuration.quaternions[rows] = other.configuration.quaternions


def _sample(frames: np.ndarray) -> np.ndarray:
    """Some of the frames between the clamped ones, whose signs follow from one state to the next; of two edges both."""
    return frames[:, 1:-1:EVERY] if frames.shape[1] > 2 else frames


def _size(change: np.ndarray) -> np.ndarray:
    """(R,) rad, root mean square over the edges, of changes of quaternions."""
    return 2 * np.sqrt(np.einsum("rek,rek->r", change, change) / change.shape[1])
