"""Whether cameras of a video took their images at the same instants, by where the thread is between epipolar planes.

Planes through the centres of two cameras have the same angle about the line between these in both. So the least and the largest
angle of the planes through points of the thread are the same in both images, of the same instant. Of a moving thread in images
that are s frames apart, those of one camera in frame t are the same as those of the other in frame t + s:

    s = argmin mean |x_a(t) − x_b(t + s)|      over frames t; the fifth that differs most, and a constant difference, left out

Motion along epipolar planes shows nothing. Axes: T frames, C cameras, P pairs of them, 2 extremes.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from doo_ti.rod.frames import across, unit_vectors
from doo_ti.vision.cameras import Rig
from doo_ti.vision.detection import Detection
from doo_ti.vision.triangulation import rays

FEWEST_FRAMES = 12
MOST_APART, STEP = 3.0, 0.5  # frames: the largest shift that is tried, and the steps to it
KEPT = 0.8  # share of the differences that counts
MUCH_BETTER, LEAST_PX, LEAST_EVIDENCE = 0.5, 0.5, 20.0
"""Bounds of the mean difference over the one without a shift, of its decrease, and of the logarithm of the likelihood ratio
of Laplacian noise. With these, noise of 1 px looked like a shift in 4 of 240 simulated videos of 20 frames, 0.3 px in none."""


@dataclass(frozen=True)
class Apart:
    """Two cameras whose images are not of the same instants.

    cameras  their numbers
    frames   the images of the second in frame t + frames fit those of the first in frame t
    off      px, mean difference of the extremes in images of the same row, and shifted so
    """

    cameras: tuple[int, int]
    frames: float
    off: tuple[float, float]


def epipolar_extremes(rig: Rig, detected: Sequence[Detection]) -> np.ndarray:
    """(P, 2, 2) px: of each pair of cameras, in each of both, the least and the largest angle of epipolar planes through the
    thread, times the focal length of the first. NaN where one sees none, or both are at the same place."""
    extremes = np.full((len(detected) * (len(detected) - 1) // 2, 2, 2), np.nan)
    ways = [rays(camera, found.points) if found.count else None for camera, found in zip(rig.cameras, detected, strict=True)]
    for own, pair in zip(extremes, combinations(range(len(detected)), 2), strict=True):
        cameras = [rig.cameras[camera] for camera in pair]
        base = cameras[1].centre - cameras[0].centre
        if not base.any() or not all(detected[camera].count for camera in pair):
            continue
        base = unit_vectors(base)
        sight = cameras[0].rotation[2] + cameras[1].rotation[2]
        sight = sight - (sight @ base) * base
        ahead = unit_vectors(sight) if np.linalg.norm(sight) > 1e-6 else across(base)
        for angles, camera in zip(own, pair, strict=True):
            every = np.arctan2(ways[camera] @ np.cross(base, ahead), ways[camera] @ ahead) * cameras[0].lens[:2].mean()
            angles[:] = every.min(), every.max()
    return extremes


def frames_apart(extremes: np.ndarray) -> list[Apart]:
    """The pairs of cameras whose images are much more alike when shifted in time, by their ``extremes`` (T, P, 2, 2) px of
    :func:`epipolar_extremes` in T consecutive frames at equal intervals. None of fewer than FEWEST_FRAMES frames."""
    cameras = int(round((1 + np.sqrt(1 + 8 * extremes.shape[1])) / 2))
    shifts = np.arange(-MOST_APART, MOST_APART + STEP / 2, STEP)
    found = []
    for own, pair in zip(np.moveaxis(extremes, 1, 0), combinations(range(cameras), 2), strict=True):
        differences = [_differences(own[:, 0], own[:, 1], shift) for shift in shifts]
        if min(map(len, differences)) < 2 * (FEWEST_FRAMES - MOST_APART):
            continue
        off = np.array([one[: int(KEPT * len(one))].mean() for one in differences])
        best, same = int(off.argmin()), float(off[np.argmin(np.abs(shifts))])
        evidence = len(differences[best]) * np.log(same / max(off[best], 1e-12))
        if off[best] < MUCH_BETTER * same and same - off[best] > LEAST_PX and evidence > LEAST_EVIDENCE:
            found.append(Apart(pair, float(shifts[best]), (same, float(off[best]))))
    return found


def _differences(one: np.ndarray, other: np.ndarray, shift: float) -> np.ndarray:
    """Sorted |differences|, px, of the extremes ``one`` (T, 2) from those of the ``other`` so many frames later, less their
    medians; of the frames in which both are known."""
    frames = np.arange(len(one))
    kept = frames[(frames + shift >= 0) & (frames + shift <= len(one) - 1)]
    apart = np.array([one[kept, k] - np.interp(kept + shift, frames, other[:, k]) for k in range(2)])
    apart = apart[:, np.isfinite(apart).all(axis=0)]
    if not apart.size:
        return np.zeros(0)
    return np.sort(np.abs(apart - np.median(apart, axis=1, keepdims=True)).ravel())
