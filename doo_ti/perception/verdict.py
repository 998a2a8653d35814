"""The rods that Algorithm 1 finds, and how certain they are (§IV-A).

Axes: A image sets, C cameras, E edges, V vertices, K runners-up.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from doo_ti.perception.posterior import COVERED
from doo_ti.perception.traced import SAME_LENGTH
from doo_ti.rod.types import Configuration, Status
from doo_ti.system.arguments import short_repr

CLEAR_PX, AMBIGUOUS_PX = 0.1, 0.02
"""Bounds of the gap: the first is larger than the mean error of detected lines; the second is smaller than the difference of
the rod's energy, which depends on an inexact Θ, between rods that fit the images equally."""
FITTING_PX = 1.0  # bound of the distance to the detection; with more in any camera, something else was detected
LEAST_COVERED = 0.5, 0.25  # bounds of the share of the detected line that a likely rod explains, and one that is shorter
MOST_SKIPPED = 3.0  # bound of the piece of line that a clear or likely rod leaves out, over its width; others may cut corners
UNCERTAIN, CERTAIN_MM = 0.1, 1.0  # bounds of the vertices' sigma: of a likely rod, over its length, and of a clear one
CERTAIN_LENGTH = 0.03
"""Bound of the uncertainty of a length that was found, that of its ends included, as a share of it. A rod that is too long by
that may be off the thread along the line of sight by some hundredths of its length."""
LOST_PX = 3.0  # bound of the largest distance where no two cameras fit: a rod farther off is not the thread in the images


class PerceptionVerdict(IntEnum):
    """How certain the best rod is, by its gap to the best runner-up and its distance to the detection.

    CLEAR      there are no :attr:`Perception.doubts`: images alone separate it from others, by a gap of 0.1 px, and it is a
               certified minimum within 1 px of the line in each camera, which explains 95 % of it and is certain to 1 mm
    LIKELY     a gap of at least 0.02 px, to which the rod's energy may help; or a wider gap, but the rod is off the line
    AMBIGUOUS  either of two may be the rod; or it has not converged, is shorter than its paths, or in all cameras but one
               explains less than half of the line, leaves a piece out or passes along it twice; or a vertex is uncertain by a
               tenth of the rod's length
    NOT_FOUND  not within 1 px of the line in two cameras, and 3 px off in one: other cameras, a wrong rig, seed or length
    """

    CLEAR = 0
    LIKELY = 1
    AMBIGUOUS = 2
    NOT_FOUND = 3


@dataclass(frozen=True)
class Perception:
    """The rods in A sets of images.

    vertices          (A, V, 3) mm: the best rod of each set at its marks, a certified minimum if there is one
    configuration     the same rod with every edge in pieces, as it was relaxed
    energy_vis        (A,) its E_vis, 1/mm
    camera_error      (A, C) px: its distance to the detection, mean along what is not hidden of it, in each camera; 0 is a
                      perfect fit
    hidden            (A, C) share of its image that is far from the detection there, while two other cameras see it
    status            (A,) Status of its last relaxation
    stable            (A,) bool: certified to be a minimum of E_vis
    sigma             (A, V) mm: uncertainty of its vertices by noise in the detection
                      (:mod:`doo_ti.perception.posterior`)
    runner_up         (A, K, V, 3) mm: the next best rods that differ from all better ones; NaN where there are fewer
    runner_up_energy  (A, K) their E_vis, infinite where there are fewer
    gap               (A,) px: E_vis of the best runner-up less that of the best rod, as a mean distance along all images;
                      infinite without one, negative where a rod that is no certified minimum scores better than this one
    edge_error        (A, C, E) px: mean distance to the detection along each edge of the best rod
    unsupported       (A, E) bool: edges that are far from the detection in all cameras
    coverage          (A, C) share of the line detected in each camera that the rod explains, of what lies in two images; NaN
                      where detections are unknown
    outside           (A, C) share of the line detected in each camera that lies outside all other images: no rod is there
    skipped           (A, C) longest piece of the line detected in each camera that the rod leaves out between its ends, over
                      the width of the thread there
    twice             (A, C) how much of its image passes along another part of it, over that width: it has turned back, or the
                      camera sees strands behind each other
    wider             (A, C) longest piece of line along the rod that is far wider than the thread, over that width: a needle
                      or what holds it
    thread_length     (A,) mm from the seed to where the thread ends in the images; NaN where rods were not traced. With rods of
                      another length, the best is part of the thread, or goes on beyond it
    left_over         (A,) mm of thread that the rod does not explain: beyond its end or, where rods were not traced, in the
                      camera where that is most
    length_range      (A, 2) mm: the shortest and the longest thread that explains the images as well; NaN where the length was
                      stated
    """

    __repr__ = short_repr

    vertices: np.ndarray
    configuration: Configuration
    energy_vis: np.ndarray
    camera_error: np.ndarray
    hidden: np.ndarray
    status: np.ndarray
    stable: np.ndarray
    sigma: np.ndarray
    runner_up: np.ndarray
    runner_up_energy: np.ndarray
    gap: np.ndarray
    edge_error: np.ndarray
    unsupported: np.ndarray
    coverage: np.ndarray
    outside: np.ndarray
    skipped: np.ndarray
    twice: np.ndarray
    wider: np.ndarray
    thread_length: np.ndarray
    left_over: np.ndarray
    length_range: np.ndarray

    @property
    def sound(self) -> np.ndarray:
        """(A,) bool: the best rod converged to a certified minimum."""
        return (self.status == Status.CONVERGED) & self.stable

    @property
    def doubts(self) -> dict[str, np.ndarray]:
        """(A,) bool by each reason why a rod is not clear."""
        length = self.configuration.rest_length.sum(axis=-1)
        return {
            "no certified minimum": ~self.sound, "a rival": ~(self.gap >= CLEAR_PX),
            "off the line": ~(self.camera_error <= FITTING_PX).all(axis=1),
            "a piece left out": (self.skipped > MOST_SKIPPED).any(axis=1), "a line twice": self._often(self.twice),
            "along something wider": (self.wider > MOST_SKIPPED).any(axis=1),
            "thread unexplained": (self.coverage < COVERED).any(axis=1) | (self.left_over > CERTAIN_LENGTH * length),
            "places uncertain": (self.sigma > CERTAIN_MM).any(axis=1), "one camera": np.full(len(self.gap), self._two == 0),
            "another length": np.abs(self.thread_length / length - 1) > SAME_LENGTH,
            "length uncertain": np.ptp(self.length_range, axis=1) > 2 * CERTAIN_LENGTH * length}

    @property
    def _two(self) -> int:
        """The place of the second best of all cameras, or of the only one."""
        return min(2, self.camera_error.shape[1]) - 1

    def _often(self, widths: np.ndarray) -> np.ndarray:
        """(A,) bool: in all cameras but one ``widths`` (A, C) are more than MOST_SKIPPED."""
        return np.sort(np.nan_to_num(widths), axis=1)[:, self._two] > MOST_SKIPPED

    @property
    def verdict(self) -> np.ndarray:
        """(A,) PerceptionVerdict."""
        clear, length, two = ~np.any([*self.doubts.values()], axis=0), self.configuration.rest_length.sum(axis=-1), self._two
        # A camera that does not see the rod counts as far off. Two cameras determine a rod: others may be occluded.
        error = np.sort(np.where(np.isfinite(self.camera_error), self.camera_error, np.inf), axis=1)
        lost = (error[:, two] > FITTING_PX) & (error[:, -1] > LOST_PX)
        lost &= ~(self.coverage >= COVERED).all(axis=1)  # a rod that goes on beyond the thread is far off there
        kinds = PerceptionVerdict.NOT_FOUND, PerceptionVerdict.CLEAR, PerceptionVerdict.LIKELY
        explained = np.sort(np.nan_to_num(self.coverage, nan=1.0), axis=1)[:, -1 - two]
        likely = (self.status == Status.CONVERGED) & (self.gap >= AMBIGUOUS_PX)
        # Of a longer thread a rod explains a part.
        whole, part = LEAST_COVERED
        likely &= explained >= np.maximum(whole * np.fmin(1.0, length / self.thread_length), part)
        likely &= ~(self.thread_length > self.length_range[:, 1])  # the length and the paths contradict each other
        likely &= ~self._often(self.skipped) & ~self._often(self.twice) & ~(self.sigma.max(axis=1) > UNCERTAIN * length)
        return np.select([lost, clear, likely], kinds, PerceptionVerdict.AMBIGUOUS).astype(np.int8)

    @classmethod
    def joined(cls, parts: list["Perception"]) -> "Perception":
        """Several of the same rig and rod, one after the other."""
        whole = Configuration.concatenate([part.configuration for part in parts])
        values = {name: np.concatenate([getattr(part, name) for part in parts]) for name in cls.__dataclass_fields__
                  if name != "configuration"}
        return cls(configuration=whole, **values)

    def among(self, rows: np.ndarray, count: int) -> "Perception":
        """The same as ``rows`` of ``count`` sets. In the others there is no rod: NaN, with the status INFEASIBLE."""
        def spread(values: np.ndarray, missing) -> np.ndarray:
            every = np.full((count, *values.shape[1:]), missing, dtype=values.dtype)
            every[rows] = values
            return every

        missing = {"status": Status.INFEASIBLE, "stable": False, "unsupported": False}
        values = {name: spread(getattr(self, name), missing.get(name, np.nan)) for name in self.__dataclass_fields__
                  if name != "configuration"}
        own = self.configuration
        lengths = own.rest_length if own.rest_length.ndim == 1 else spread(own.rest_length, np.nan)
        return Perception(configuration=Configuration(spread(own.start, np.nan), spread(own.quaternions, np.nan), lengths),
                          **values)
