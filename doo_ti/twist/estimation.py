"""Eq. 4: how far a rod is twisted that was seen and not felt (§IV-B).

A round rod's vertices say nothing of its material frames, but twist bends it out of the shape it would have. So every whole
angle φ that the end frame may be turned by is tried: start from Γ^i, relax with the end frame turned by φ, and see how far the
rod moves away from what was observed.

    min_φ Σ_i d(F(Γ^i, E_Θ, T_φ(C^i)), Γ^i)                                                              (Eq. 4)

One configuration: its end frame is the last Bishop frame turned by φ, so φ is the total twist. Several, in one grasp: each
shape has a last Bishop frame of its own, and the gripper's motion ties them together. With τ_i the angle, whole turns
included, from the last Bishop frame of Γ^i to the known end frame, its total twist is φ + τ_i, and φ is the one unknown turn
of the rod in the gripper. Each new grasp has a φ of its own (footnote 4).

Axes: N observations, K groups that share a φ, F sampled angles, M minima of a group.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from doo_ti.errors import InputError
from doo_ti.frames import angle_about
from doo_ti.io.observations import Observations
from doo_ti.relaxation.newton import Newton
from doo_ti.twist.curves import TwistCurves, without_twist
from doo_ti.types import Material


class Verdict(IntEnum):
    """What a group's curve says of its minimum."""

    CLEAR = 0
    AMBIGUOUS = 1
    AT_BORDER = 2
    UNDETERMINED = 3


@dataclass(frozen=True)
class TwistOptions:
    """How Eq. 4 is searched.

    span, step   φ is sampled over [−span, span] by ``step``, rad (§V-F)
    minima       local minima of the samples that are looked at more closely
    halvings     of the step around each of them; then a parabola through the last three values
    near, apart  ambiguous is a minimum where an angle farther off than ``apart``, rad, is at most ``near`` times as bad.
                 Rods that are a little curved at rest put the true angle at up to 1.5 times the least in six of seven cases
    solver, precision  as :func:`doo_ti.relaxation.relax.relax` takes them
    """

    span: float = 2 * np.pi
    step: float = np.pi / 12
    minima: int = 3
    halvings: int = 3
    near: float = 1.5
    apart: float = np.pi / 3
    solver: Newton = Newton()
    precision: str = "f32"

    def __post_init__(self):
        for name in ("span", "step"):
            if not 0 < getattr(self, name) < np.inf:
                raise InputError("twist", name, f"{getattr(self, name)} is no angle", "give a positive number of radians")
        if self.span < self.step or self.minima < 1 or self.halvings < 0 or self.near < 1:
            raise InputError("twist", "options", "nothing to search",
                             "give step <= span, minima >= 1, halvings >= 0, near >= 1")

    @property
    def angles(self) -> np.ndarray:
        """(F,) rad."""
        count = int(np.floor(self.span / self.step + 1e-9))
        return self.step * np.arange(-count, count + 1)


@dataclass(frozen=True)
class TwistEstimate:
    """What Eq. 4 says of K groups, angles in rad.

    phi        (K,) where the objective is least; NaN where no rod came to rest
    least      (K,) mm, the objective there
    verdict    (K,) Verdict
    low, high  (K,) the outermost samples that are at most ``near`` times as bad
    minima     (K, M) the local minima, the best first, NaN where there are fewer; minima_objective (K, M) mm
    angles     (F,) the samples
    objective  (K, F) mm, the curve of Eq. 4, a sum over the group; NaN where a rod came to nothing
    unsound    (K, F) rods of each sum that came to no certified minimum: such samples are shown and not chosen
    group      (N,) of each observation
    offset     (N,) τ of each observation
    """

    phi: np.ndarray
    least: np.ndarray
    verdict: np.ndarray
    low: np.ndarray
    high: np.ndarray
    minima: np.ndarray
    minima_objective: np.ndarray
    angles: np.ndarray
    objective: np.ndarray
    unsound: np.ndarray
    group: np.ndarray
    offset: np.ndarray

    @property
    def total_twist(self) -> np.ndarray:
        """(N,) φ + τ_i, rad, whole turns included."""
        return self.phi[self.group] + self.offset


def estimate_twist(
    observations: Observations, material: Material, group=None, offset=None, options: TwistOptions = TwistOptions(),
    advance: Callable[[int], None] = lambda rods: None,
) -> TwistEstimate:
    """Eq. 4 for all groups at once.

    observations  N of them, of which vertices, rest lengths, start frames and the end frames' tangents count
    material      Θ, one for all or one for each observation
    group         (N,) 0, 0, …, 1, …, K − 1: whose φ each observation shares; by default each has its own
    offset        (N,) τ in rad, as :func:`end_offsets` finds them; zero by default
    advance       is told of rods as they are done; in all there are at least N·F

    Raises InputError where the arguments do not match, and for a rod that is not round while the start's spin is unknown.
    """
    curves = TwistCurves.of(observations, material, group, offset, options.solver, options.precision, advance)
    angles = options.angles
    objective, unsound = curves.at(np.arange(curves.count), np.tile(angles, (curves.count, 1)))
    value = np.where((unsound == 0) & np.isfinite(objective), objective, np.inf)
    place = _lowest(value, options.minima)
    phi, least = _refined(curves, angles, value, place, options)
    order = np.argsort(least, axis=1, kind="stable")
    phi, least = np.take_along_axis(phi, order, axis=1), np.take_along_axis(least, order, axis=1)
    limit = options.near * least[:, :1]
    near = np.isfinite(value) & (value <= limit)
    low = np.fmin(phi[:, 0], np.where(near.any(axis=1), angles[np.argmax(near, axis=1)], np.nan))
    high = np.fmax(phi[:, 0], np.where(near.any(axis=1), angles[-1 - np.argmax(near[:, ::-1], axis=1)], np.nan))
    verdict = _verdict(phi, least, near, angles, options)
    least = np.where(np.isfinite(least), least, np.nan)
    return TwistEstimate(phi[:, 0], least[:, 0], verdict, low, high, phi, least, angles, objective, unsound, curves.group,
                         curves.offset)


def consecutive_groups(count: int, together: int, regrasps=()) -> np.ndarray:
    """(count,) groups of ``together`` observations in succession; a new grasp begins at each of the rows ``regrasps``, and
    the last group before it may be smaller."""
    begins = np.zeros(count, dtype=np.int64)
    begins[np.array([0, *regrasps], dtype=np.int64)] = 1
    first = np.maximum.accumulate(np.where(begins == 1, np.arange(count), 0))
    starts = (np.arange(count) - first) % together == 0
    return np.cumsum(starts) - 1


def end_offsets(observations: Observations, group: np.ndarray) -> np.ndarray:
    """(N,) τ: the angle in rad from the last Bishop frame of each shape to its known end frame.

    Its whole turns are the nearest to ``total_twist`` where that is given. Else the first of each group is within half a
    turn, and each of the others within half a turn of the one before it.

    Raises InputError where ``end_frame`` is missing.
    """
    if observations.end_frame is None:
        raise InputError(observations.source, "end_frame", "missing, so that the angles between the end frames are unknown",
                         "give end_frame or `offset`, or put each observation in a `group` of its own")
    free, clamps = without_twist(observations)
    last = free.frames[:, -1]
    angle = angle_about(last[..., 0], last[..., 1], clamps.end_frame[..., 1])
    if observations.total_twist is not None:
        return angle + 2 * np.pi * np.round((observations.total_twist - angle) / (2 * np.pi))
    unwrapped = np.unwrap(angle)
    first = np.flatnonzero(np.concatenate([[True], np.diff(group) != 0]))
    return unwrapped - (unwrapped - angle)[first][group]


def _lowest(value: np.ndarray, most: int) -> np.ndarray:
    """(K, M) places of the smallest local minima of (K, F) curves, the smallest first, −1 where there are fewer."""
    wall = np.full((len(value), 1), np.inf)
    left, right = np.hstack([wall, value[:, :-1]]), np.hstack([value[:, 1:], wall])
    depth = np.where((value < left) & (value <= right), value, np.inf)
    place = np.argsort(depth, axis=1, kind="stable")[:, :most]
    return np.where(np.isfinite(np.take_along_axis(depth, place, axis=1)), place, -1)


def _refined(curves: TwistCurves, angles, value, place, options: TwistOptions) -> tuple[np.ndarray, np.ndarray]:
    """(K, M) angles and values of the minima between the samples, NaN and infinite where there is none."""
    groups = np.repeat(np.arange(len(place)), place.shape[1])
    padded = np.pad(value, ((0, 0), (1, 1)), constant_values=np.inf)
    spot = place.ravel()
    none = spot < 0
    phi = np.where(none, np.nan, angles[spot])
    before, least, after = (np.where(none, np.inf, padded[groups, spot + shift]) for shift in range(3))
    step = options.step
    for _ in range(options.halvings):
        step /= 2
        tried = phi[:, None] + np.array([-step, step])
        sums, unsound = curves.at(groups, np.where(np.abs(tried) <= angles[-1] + 1e-9, tried, np.nan))
        lower, upper = np.where((unsound == 0) & np.isfinite(sums), sums, np.inf).T
        down, up = (lower < least) & (lower <= upper), (upper < least) & (upper < lower)
        phi = phi + np.where(down, -step, np.where(up, step, 0.0))
        before, least, after = (
            np.where(down, before, np.where(up, least, lower)), np.where(down, lower, np.where(up, upper, least)),
            np.where(down, least, np.where(up, after, upper)))
    with np.errstate(invalid="ignore", divide="ignore"):
        bend = before - 2 * least + after
        inside = np.isfinite(bend) & (bend > 0)
        shift = np.where(inside, 0.5 * step * (before - after) / bend, 0.0)
    return (phi + shift).reshape(place.shape), least.reshape(place.shape)


def _verdict(phi, least, near, angles, options: TwistOptions) -> np.ndarray:
    """(K,) from the minima, best first, and the samples that are near the best."""
    off = np.abs(angles - phi[:, :1])
    rival = (near & (off > options.apart)).any(axis=1)
    with np.errstate(invalid="ignore"):
        rival |= ((np.abs(phi - phi[:, :1]) > options.apart) & (least <= options.near * least[:, :1])).any(axis=1)
    border = np.abs(phi[:, 0]) > angles[-1] - 1e-6
    verdict = np.where(border, Verdict.AT_BORDER, np.where(rival, Verdict.AMBIGUOUS, Verdict.CLEAR))
    return np.where(np.isfinite(least[:, 0]), verdict, Verdict.UNDETERMINED).astype(np.int8)
