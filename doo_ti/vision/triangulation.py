"""Marks labelled in several images to points in the world, with their uncertainty and outliers among the labels (§V-A).

    x = argmin Σ_c |u_c − p_c(x)|²      over the cameras c that see the mark at u_c, in px through the distorted lenses,

starting from the point nearest to all rays. The noise of the labels is learned: Q, the least squares of a mark in n images, are
σ² times χ² of 2n − 3 degrees of freedom, so that σ² is first the median of Q over that of χ², then the mean of all Q up to the
97.5 % quantile over that of χ², again and again (Rousseeuw and Leroy). Axes: C cameras, P points.

Least squares are by Levenberg–Marquardt, P problems of K unknowns each, all at once:

    x ← x − (JᵀJ + λ diag(JᵀJ))⁻¹ Jᵀr,    λ ← λ/10 where |r|² decreased, else the step is undone and λ ← 10 λ
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np

from doo_ti.rod.frames import unit_vectors
from doo_ti.rod.types import LARGEST
from doo_ti.system.errors import InputError
from doo_ti.vision.cameras import Camera, Rig

SMALLEST_ANGLE = np.radians(0.5)  # rays closer to parallel than this have no point nearest to them
MOST_STEPS = 30
FINE_MM = 1e-9
AMBIGUITY = 9.0  # χ² by which leaving out one label must be better than leaving out another: three standard deviations


class MarkStatus(IntEnum):
    """Result of the triangulation of a mark. The first two have a position; degenerate: rays that are parallel or intersect
    behind a camera."""

    TRIANGULATED = 0
    OUTLIER_LEFT_OUT = 1
    CONTRADICTORY = 2
    FEW_VIEWS = 3
    DEGENERATE = 4


MOST = 1e9  # of options: squares of much larger numbers overflow
FEWEST_MARKS = 10  # from which noise is learned
WITHIN = 10.0  # Labels have the stated noise to this factor: what scatters more are no labels of these cameras
BEYOND = 0.025  # share of the marks whose sums of squares are left out where noise is learned
ODD, SURE = 2.0, 1e-4  # A camera is odd without which labels scatter this much less, and how often by chance


@dataclass(frozen=True)
class TriangulationOptions:
    """sigma_px   standard deviation of each coordinate of a label, px, where it cannot be learned
    threshold     the labels of a mark contradict each other if their residuals are as improbable as a normal variable this many
                  standard deviations from its mean; a larger threshold tolerates more

    Raises InputError for values that are not positive, or beyond MOST.
    """

    sigma_px: float = 0.5
    threshold: float = 5.0

    def __post_init__(self) -> None:
        for name in ("sigma_px", "threshold"):
            if not 0 < getattr(self, name) <= MOST:
                raise InputError("options", name, f"{getattr(self, name)!r}", f"give a positive number up to {MOST:g}")


@dataclass(frozen=True)
class Points:
    """P triangulated marks."""

    position: np.ndarray  # (P, 3) mm, NaN where ``status`` says there is none
    covariance: np.ndarray  # (P, 3, 3) mm², for labels with the noise ``sigma_px``; NaN likewise
    status: np.ndarray  # (P,) :class:`MarkStatus`
    used: np.ndarray  # (C, P) bool: labels from which the position was computed
    # (C, P) px: distance of each label, also outliers, from the projection of the position; NaN without a label. Of
    # contradictory labels: from the point with the least squared distances to all of them
    residual: np.ndarray
    label_sigma: float  # px: standard deviation of one coordinate of a label as learned; NaN of too few marks
    sigma_px: float  # px: that, or the stated one where it cannot be learned

    @property
    def valid(self) -> np.ndarray:
        """(P,) bool: marks with a position."""
        return self.status <= MarkStatus.OUTLIER_LEFT_OUT


def triangulate(rig: Rig, pixels: np.ndarray, options: TriangulationOptions = TriangulationOptions()) -> Points:
    """The points whose projections are ``pixels`` (C, P, 2), NaN where a camera has no label.

    Of three labels or more that contradict each other, the one is left out without which the others agree; where several
    labels could be the outlier, or where only two labels contradict each other, the mark has no position. All labels of a
    camera are left out without which those of the others scatter far less.

    Raises InputError for fewer than two cameras and for other shapes.
    """
    pixels = np.asarray(pixels, dtype=np.float64)
    if len(rig.cameras) < 2:
        raise InputError(rig.source, "cameras", f"{len(rig.cameras)} of them", "triangulation needs two or more")
    if pixels.ndim != 3 or pixels.shape[0] != len(rig.cameras) or pixels.shape[2] != 2:
        raise InputError(rig.source, "pixels", f"shape {pixels.shape}", f"make it ({len(rig.cameras)}, P, 2)")
    labelled = np.isfinite(pixels).all(axis=-1)
    seen, position, cost, learned = _agreeing(rig, pixels, labelled)
    sigma = float(np.maximum(learned, options.sigma_px / WITHIN)) if learned <= WITHIN * options.sigma_px else options.sigma_px
    options = replace(options, sigma_px=sigma)
    status = np.where(seen.sum(axis=0) < 2, MarkStatus.FEW_VIEWS, MarkStatus.TRIANGULATED)
    used = seen.copy()
    doubtful = np.flatnonzero((status == MarkStatus.TRIANGULATED) & ~(cost <= sigma**2 * _tolerated(seen, options.threshold)))
    if len(doubtful):
        status[doubtful], used[:, doubtful] = _without_outliers(rig, pixels[:, doubtful], seen[:, doubtful], options)
        again = doubtful[status[doubtful] == MarkStatus.OUTLIER_LEFT_OUT]
        position[again], _ = _fitted(rig, pixels[:, again], used[:, again])
    status[(status == MarkStatus.CONTRADICTORY) & ~np.isfinite(cost)] = MarkStatus.DEGENERATE
    status[(status == MarkStatus.TRIANGULATED) & (labelled & ~seen).any(axis=0)] = MarkStatus.OUTLIER_LEFT_OUT
    residual = np.linalg.norm(rig.project(position) - pixels, axis=-1)
    good = status <= MarkStatus.OUTLIER_LEFT_OUT
    used[:, ~good] = False
    covariance = np.full((len(status), 3, 3), np.nan)
    normal = _linearised(rig, pixels[:, good], used[:, good], position[good])[1]
    covariance[good] = sigma**2 * np.linalg.inv(normal)
    return Points(np.where(good[:, None], position, np.nan), covariance, status, used, residual, learned, sigma)


def _agreeing(rig: Rig, pixels: np.ndarray, seen: np.ndarray):
    """The labels ``seen`` (C, P) without those of an odd camera, their points and sums of squares as :func:`_fitted`, and px,
    their scatter."""
    from scipy.special import fdtri

    best = seen, *_fitted(rig, pixels, seen)
    square, whole = _scatter(seen, best[2])
    least = square
    for camera in range(len(rig.cameras) if np.isfinite(best[2]).sum() >= 2 * FEWEST_MARKS else 0):
        rest = seen & (np.arange(len(rig.cameras)) != camera)[:, None]
        fitted = _fitted(rig, pixels, rest)
        own, left = _scatter(rest, fitted[1])
        # F: what the camera's labels add to the sum of squares, over the others' scatter.
        added = max(whole - left, 1)
        by_chance = (left + added * fdtri(added, max(left, 1), 1 - SURE / len(rig.cameras))) / whole
        if own < least and square > max(ODD**2, by_chance) * own:
            best, least = (rest, *fitted), own
    return *best, float(np.sqrt(least))


def label_scatter(rig: Rig, pixels: np.ndarray) -> float:
    """px, the noise of labels ``pixels`` (C, P, 2) as :func:`triangulate` learns it from all cameras; infinite if it cannot."""
    seen = np.isfinite(pixels).all(axis=-1)
    return float(np.nan_to_num(np.sqrt(_scatter(seen, _fitted(rig, pixels, seen)[1])[0]), nan=np.inf))


def _scatter(used: np.ndarray, cost: np.ndarray) -> tuple[float, float]:
    """px², the variance of a coordinate of the labels ``used`` (C, P), by the sums of squares ``cost`` (P,) of marks, but those
    that rarely are so large at that noise; and their degrees of freedom. NaN and 0 of too few marks."""
    from scipy.special import chdtr, chdtri

    known = np.isfinite(cost) & (used.sum(axis=0) > 1)
    if known.sum() < FEWEST_MARKS:
        return np.nan, 0
    cost, freedom = cost[known], 2 * used[:, known].sum(axis=0) - 3
    square, most = float(np.median(cost / chdtri(freedom, 0.5))), chdtri(freedom, BEYOND)
    expected = freedom * chdtr(freedom + 2, most) / (1 - BEYOND)  # mean of χ² below ``most``
    for _ in range(MOST_STEPS):
        kept = cost <= square * most
        before, square = square, float(cost[kept].sum() / max(expected[kept].sum() - 2, 1))  # −2: errors² over it average 1
        if square == before:
            break
    return square, int(freedom[kept].sum())


def _tolerated(used: np.ndarray, threshold: float) -> np.ndarray:
    """(P,) the largest sum of squares over σ² that noise explains, of marks with the labels ``used`` (C, P): χ² of 2n − 3
    degrees of freedom, by Wilson and Hilferty."""
    freedom = np.maximum(2 * used.sum(axis=0) - 3, 1)
    spread = 2 / (9 * freedom)
    return freedom * (1 - spread + threshold * np.sqrt(spread)) ** 3


def _without_outliers(rig: Rig, pixels: np.ndarray, seen: np.ndarray, options: TriangulationOptions):
    """(P,) status and (C, P) labels to use, of marks whose labels contradict each other.

    Labels are left out one after the other, each time the one without which the others agree best, until the others no longer
    contradict each other. The mark stays contradictory if leaving out another label would be nearly as good.
    """
    used, count = seen.copy(), seen.shape[1]
    status = np.full(count, MarkStatus.CONTRADICTORY)
    while len(rows := np.flatnonzero((status == MarkStatus.CONTRADICTORY) & (used.sum(axis=0) > 2))):
        cost = np.full((len(rig.cameras), len(rows)), np.inf)
        for camera in range(len(rig.cameras)):
            there = used[camera, rows]
            fewer = used[:, rows[there]].copy()
            fewer[camera] = False
            # Finite, so that a label without a point is preferred to a camera without a label: each round removes a label.
            cost[camera, there] = np.minimum(_fitted(rig, pixels[:, rows[there]], fewer)[1], LARGEST)
        order = np.sort(cost, axis=0)
        used[np.argmin(cost, axis=0), rows] = False
        agree = order[0] <= options.sigma_px**2 * _tolerated(used[:, rows], options.threshold)
        clear = order[1] > order[0] + AMBIGUITY * options.sigma_px**2
        status[rows[agree & clear]] = MarkStatus.OUTLIER_LEFT_OUT
        used[:, rows[agree & ~clear]] = False
    return status, used


def _fitted(rig: Rig, pixels: np.ndarray, used: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(P, 3) mm points with the least squares for the labels ``used`` (C, P), and (P,) px² their sums of squares.

    NaN and infinite for fewer than two labels, parallel rays, and points that are not in front of their cameras.
    """
    position, sound = _nearest_to_rays(rig, pixels, used)

    def linearised(trial):
        cost, normal, slope = _linearised(rig, pixels, used, trial)
        return np.where(sound & (np.linalg.det(normal) > 0), cost, np.inf), normal, slope  # far off, rays are parallel

    position, cost, _ = least_squares(
        position, linearised, np.add, lambda better, trial, before: np.where(better[:, None], trial, before),
        lambda step, gain, cost: np.linalg.norm(step, axis=-1) <= FINE_MM, 1e-6, MOST_STEPS)
    return np.where(np.isfinite(cost)[:, None], position, np.nan), cost


def _linearised(rig: Rig, pixels: np.ndarray, used: np.ndarray, position: np.ndarray):
    """(P,) sum of squares, infinite behind a camera, (P, 3, 3) normal matrix JᵀJ and (P, 3) Jᵀr, of the labels ``used``."""
    count = len(position)
    cost, normal, slope = np.zeros(count), np.zeros((count, 3, 3)), np.zeros((count, 3))
    for camera, labels, there in zip(rig.cameras, pixels, used):
        front = there & (camera.depth(position) > 0)
        pixel, by_point, _ = camera.project_with_jacobian(position[front])
        residual, jacobian = pixel - labels[front], by_point @ camera.rotation
        cost[front] += np.sum(residual**2, axis=-1)
        cost[there & ~front] = np.inf
        normal[front] += np.swapaxes(jacobian, 1, 2) @ jacobian
        slope[front] += np.einsum("pki,pk->pi", jacobian, residual)
    return cost, normal, slope


def _nearest_to_rays(rig: Rig, pixels: np.ndarray, used: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(P, 3) mm points with the least sum of squared distances from the rays of the labels ``used``, and (P,) whether the
    rays are two or more and not parallel: Σ (1 − d dᵀ)(x − c) = 0."""
    count = pixels.shape[1]
    matrix, right = np.zeros((count, 3, 3)), np.zeros((count, 3))
    for camera, labels, there in zip(rig.cameras, pixels, used):
        ray = rays(camera, labels[there])
        across = np.eye(3) - ray[:, :, None] * ray[:, None, :]
        matrix[there] += across
        right[there] += across @ camera.centre
    # Two rays at an angle φ make the smallest eigenvalue 1 − cos φ.
    sound = (used.sum(axis=0) >= 2) & (np.linalg.eigvalsh(matrix)[:, 0] > 1 - np.cos(SMALLEST_ANGLE))
    matrix[~sound] = np.eye(3)
    return np.linalg.solve(matrix, right[..., None])[..., 0], sound


def rays(camera: Camera, pixels: np.ndarray) -> np.ndarray:
    """(P, 3) unit directions in the world in which ``camera`` sees (P, 2) pixels."""
    import cv2

    if not len(pixels):
        return np.zeros((0, 3))
    flat = cv2.undistortPoints(np.ascontiguousarray(pixels)[:, None], np.array(camera.matrix), np.array(camera.distortion))
    return unit_vectors(np.column_stack([np.asarray(flat).reshape(-1, 2), np.ones(len(pixels))]) @ camera.rotation)


# --- least squares -------------------------------------------------------------------------------------------------------

WORST_DAMPING = 1e12  # with more damping steps are too short to lower a sum of squares


def least_squares(start, linearised: Callable, moved: Callable, chosen: Callable, settled: Callable, damping: float,
                  most_steps: int) -> tuple:
    """(the unknowns with the least sums of squares that are reached from ``start``, the (P,) sums, and (P, K, K) JᵀJ there).

    linearised  (unknowns) → (P,) sums of squares, infinite for invalid unknowns, (P, K, K) JᵀJ and (P, K) Jᵀr
    moved       (unknowns, steps (P, K)) → unknowns
    chosen      ((P,) bool, unknowns, other unknowns) → the first where true, else the second
    settled     (steps (P, K), (P,) decrease of the sums, (P,) new sums) → (P,) bool: done
    damping     λ of the first step

    Raises LinAlgError where a damped JᵀJ is singular.
    """
    place = start
    cost, normal, slope = linearised(place)
    identity, damping = np.eye(slope.shape[1]), np.full(len(cost), damping)
    for _ in range(most_steps):
        lost = ~np.isfinite(cost)[:, None]
        damped = np.where(lost[..., None], identity, normal * (1 + damping[:, None, None] * identity))
        step = -np.linalg.solve(damped, np.where(lost, 0.0, slope)[..., None])[..., 0]
        trial = moved(place, step)
        trial_cost, trial_normal, trial_slope = linearised(trial)
        better = trial_cost <= cost
        gain = np.full(len(cost), -np.inf)
        np.subtract(cost, trial_cost, out=gain, where=better & np.isfinite(cost))
        place = chosen(better, trial, place)
        cost = np.where(better, trial_cost, cost)
        normal = np.where(better[:, None, None], trial_normal, normal)
        slope = np.where(better[:, None], trial_slope, slope)
        damping = np.where(better, damping / 10, damping * 10)
        if (settled(step, gain, cost) | (damping >= WORST_DAMPING)).all():
            break
    return place, cost, normal
