"""Jumps: a rod whose clamps move loses its equilibrium and snaps to another one (§III-D).

A rod that stays on its branch changes by nearly as much in one sub-step as in the next. Where it does not, the sub-step is
repeated in eighths, and their result replaces it: a branch that still exists is then followed, not skipped. A continuous
change spreads over the eighths, even in front of a fold, where the last eighth holds a third of it, two and a half times the
one before. A jump lies within one eighth, and of two jumps in a sub-step each exceeds the eighths beside it.

Axes: R rods, E edges.
"""

from collections.abc import Callable, Iterator

import numpy as np

from doo_ti.rod.types import Solution

PARTS = 8
OUT_OF_PROPORTION = 0.5
"""A sub-step is repeated where the difference of two successive changes exceeds this share of the larger one: 0.1 on smooth
motions, 1 at a jump."""
UNDIVIDED = 0.5
"""A part that holds more than this share of the change of all parts is a jump."""
ABRUPT = 6.0
"""A part that changes this many times as much as the parts beside it is a jump, too."""
NOTABLE = 0.01
"""rad, root mean square over the frames: smaller changes are no jumps."""
EVERY = 4
"""Every fourth edge is compared: that suffices for the change of a shape."""


class JumpCount:
    """Counts the jumps of R rods, sub-step by sub-step, and corrects sub-steps that skipped a branch.

    frames  (R, E, 4) before the first sub-step
    finely  function of rows (n,), their frames (n, E, 4), a sub-step, counted from zero, and a number of sub-steps: yields the
            solution of the n rods after each part of these, with status and iterations since the first part
    watch   False: nothing is counted or corrected
    count   (R,) jumps so far
    """

    def __init__(self, frames: np.ndarray, finely: Callable[..., Iterator[Solution]], watch: bool = True):
        self.watch = watch
        self.count = np.zeros(len(frames), dtype=np.int32)
        self._finely = finely
        self._states, self._before = [frames], None
        self._change = self._size = self._judged = None
        self._step = 0

    def see(self, solution: Solution) -> None:
        """Take in the R rods after the next sub-step; where it is repeated in parts, their result is written into it."""
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
                    self._repeat(rows, steps, solution)
            rows = np.flatnonzero(judged)
            change[rows] = _sample(frames[rows]) - _sample(self._states[-1][rows])
            size[rows] = _size(change[rows])
        self._states, self._before = [self._states[-1], frames], solution
        self._change, self._size, self._judged = change, size, judged
        self._step += 1

    def _repeat(self, rows: np.ndarray, steps: int, solution: Solution) -> None:
        """Repeat the last ``steps`` sub-steps of some rods in parts, and count the jumps in them."""
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
