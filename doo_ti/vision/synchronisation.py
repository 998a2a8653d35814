"""Whether cameras of a video took their images at the same instants, by where the thread is between epipolar planes, and
whether one moved between views of a board.

Planes through the centres of two cameras have the same angle about the line between these in both. So the least and the largest
angle of the planes through points of the thread are the same in both images, of the same instant. Of a moving thread in images
that are s frames apart, those of one camera in frame t are the same as those of the other in frame t + s:

    s = argmin mean |x_a(t) − x_b(t + s)|      over frames t; the fifth that differs most, and a constant difference, left out

Motion along epipolar planes shows nothing. Axes: T frames, C cameras, P pairs of them, 2 extremes.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from doo_ti.rod.frames import across, unit_vectors
from doo_ti.vision.cameras import Rig
from doo_ti.vision.triangulation import rays

if TYPE_CHECKING:  # SciPy's trees take long to import, and calibration needs none
    from doo_ti.vision.detection import Detection

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


def epipolar_extremes(rig: Rig, detected: "Sequence[Detection]") -> np.ndarray:
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


# --- a camera that moves between views of a board ---------------------------------------------------------------------------

FEWEST_BESIDE = 3  # views before a move and after it: a single one may be bad itself
FALSE_ALARMS = 0.01  # share of the calibrations without a move, over all cameras and views
UNSEEN = 1e-9  # eigenvalue over the largest one of what no image shows
POSED = slice(9, 15)  # the camera's pose behind its lens, among the slopes


@dataclass(frozen=True)
class Moved:
    """A camera that moved before a ``view``, by ``shift`` px of the board's corners; both ``cameras`` of two."""

    cameras: tuple[int, ...]
    view: int
    shift: float


def moved_camera(sightings: list[tuple], covariance: np.ndarray) -> Moved | None:
    """The camera that has one pose up to a view and another from there on, by an analysis of variance: what a step of its pose
    takes from the sum of squares, beside what poses of its own in each view take further. Boards that are moved between the
    images of a view may scatter along one direction mostly: of the six a view counts as one.

    sightings   view, camera, (2n,) px errors, (2n, K) their slopes by lens and poses, (K,) places of these among the P unknowns
    covariance  (P, P) of the unknowns for errors of one pixel, at their best values

    With extra poses e of slopes E beside unknowns x of slopes J the sum of squares falls by gᵀ K⁻¹ g; g = Eᵀ r, and
    K = Eᵀ E − Eᵀ J (JᵀJ)⁻¹ Jᵀ E.
    """
    from scipy.special import fdtrc

    seeing = {view: {camera for at, camera, *_ in sightings if at == view} for view, *_ in sightings}
    cameras, found = max(max(own) for own in seeing.values()) + 1, []
    for camera in range(cameras):
        own = sorted((one for one in sightings if one[1] == camera and len(seeing[one[0]]) > 1), key=lambda one: one[0])
        count, few = len(own), FEWEST_BESIDE
        if count < 2 * few:
            continue
        crossed, square = np.zeros((count, 6, len(covariance))), np.zeros((count, 6, count, 6))
        slope = np.array([jacobian[:, POSED].T @ residual for *_, residual, jacobian, _ in own])
        for k, (*_, jacobian, at) in enumerate(own):
            crossed[k][:, at] = jacobian[:, POSED].T @ jacobian
            square[k, :, k] = crossed[k][:, at][:, POSED]
        alone, crossed = square[np.arange(count), :, np.arange(count)], crossed.reshape(6 * count, -1)
        square -= (crossed @ covariance @ crossed.T).reshape(square.shape)
        scale = 1 / np.sqrt(np.einsum("kii->i", alone))  # radians beside mm
        slope, square, alone = slope * scale, scale[:, None, None] * square * scale, scale[:, None] * alone * scale
        # Inverses of what is seen only: a pose more in all views is that of the camera itself.
        every = slope.ravel() @ np.linalg.pinv(square.reshape(2 * (6 * count,)), UNSEEN, hermitian=True) @ slope.ravel()
        for k in range(few, count - few + 1):
            step = np.linalg.pinv(square[k:, :, k:].sum(axis=(0, 2)), UNSEEN, hermitian=True) @ slope[k:].sum(axis=0)
            gain, freedom = slope[k:].sum(axis=0) @ step, count - 2
            ratio = gain * freedom / max(every - gain, UNSEEN * abs(gain), np.finfo(float).tiny)
            shift = np.sqrt(step @ alone[k:].sum(axis=0) @ step / sum(len(one[2]) / 2 for one in own[k:]))
            found.append((gain, fdtrc(1, freedom, ratio), (camera,) if cameras > 2 else (0, 1), own[k][0], float(shift)))
    sure = [(gain, *move) for gain, chance, *move in found if chance * len(found) < FALSE_ALARMS]
    return Moved(*max(sure)[1:]) if sure else None
