"""How the clips of the virtual lab really hold a rod: tilted, and beside the pose that is reported.

With the ideal clip's frame F and the outer end x of the rod in it, the real clip has

    F' = F exp([0, a, b])    x' = x + F (0, c, d)

with tilts a, b (rad) about m1 and m2 and offsets c, d (mm) along them: the error turns with the clip.
"""

from dataclasses import dataclass, replace

import numpy as np

from doo_ti.frames import rotation_matrix
from doo_ti.types import Clamps

STREAM = 1
"""Spawn key of the generator: of its own, so that rest curvature and label noise of a seed do not depend on clip errors."""


@dataclass(frozen=True)
class ClipErrors:
    """Errors of the two clips, the start's before the end's, of D observations.

    tilt     (2, 2) rad, about m1 and m2, the same in all observations
    offset   (2, 2) mm, along m1 and m2, likewise
    scatter  (D, 2, 2) rad, added to ``tilt`` in each observation by itself
    """

    tilt: np.ndarray
    offset: np.ndarray
    scatter: np.ndarray

    @staticmethod
    def drawn(seed: int, count: int, *, tilt: float, offset: float, scatter: float) -> "ClipErrors":
        """Gaussian errors for ``count`` observations; standard deviations of each component in rad and mm."""
        random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(STREAM,)))
        return ClipErrors(tilt * random.normal(size=(2, 2)), offset * random.normal(size=(2, 2)),
                          scatter * random.normal(size=(count, 2, 2)))

    @property
    def vary(self) -> bool:
        """Whether they differ from observation to observation."""
        return bool(self.scatter.any())

    @property
    def any(self) -> bool:
        """Whether there are errors at all."""
        return bool(self.tilt.any() or self.offset.any()) or self.vary

    def held(self, ideal: Clamps, reach: tuple[float, float], rows: slice | None = None) -> Clamps:
        """The real clamps (R) of ideal ones (R).

        reach  mm from the rod's outer ends to the vertices that ``ideal`` names, along the rod
        rows   observations whose scatter is added, R of them; None: the constant errors alone
        """
        tilt = self.tilt if rows is None else self.tilt + self.scatter[rows]
        start = _real(ideal.start_position, ideal.start_frame, reach[0], tilt[..., 0, :], self.offset[0])
        end = _real(ideal.end_position, ideal.end_frame, -reach[1], tilt[..., 1, :], self.offset[1])
        return replace(ideal, start_position=start[0], start_frame=start[1], end_position=end[0], end_frame=end[1])


def _real(position: np.ndarray, frame: np.ndarray, reach: float, tilt: np.ndarray, offset: np.ndarray):
    """(R, 3) positions ``reach`` along the rod from its outer end, and (R, 3, 3) frames, of one clip."""
    vector = np.concatenate([np.zeros_like(tilt[..., :1]), tilt], axis=-1)
    outer = position - reach * frame[..., 0] + frame[..., 1:] @ offset
    turned = frame @ rotation_matrix(vector)
    return outer + reach * turned[..., 0], turned
