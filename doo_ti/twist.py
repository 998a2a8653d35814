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
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np

from doo_ti.dataset import Observations
from doo_ti.errors import InputError
from doo_ti.frames import angle_about, matrix_from_quaternion, smallest_rotation
from doo_ti.metric import distance
from doo_ti.newton import Newton
from doo_ti.relaxation import relax
from doo_ti.start import observation_clamps, start_configuration
from doo_ti.types import Clamp, Clamps, Configuration, Material

RODS_AT_ONCE = 1 << 15
"""Rods of one launch, which bounds the memory for their frames."""


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
    solver, precision  as :func:`doo_ti.relaxation.relax` takes them
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
    search = _Search.of(observations, material, group, offset, options, advance)
    angles = options.angles
    objective, unsound = search.curves(np.arange(search.count), np.tile(angles, (search.count, 1)))
    value = np.where((unsound == 0) & np.isfinite(objective), objective, np.inf)
    place = _lowest(value, options.minima)
    phi, least = _refined(search, angles, value, place, options)
    order = np.argsort(least, axis=1, kind="stable")
    phi, least = np.take_along_axis(phi, order, axis=1), np.take_along_axis(least, order, axis=1)
    limit = options.near * least[:, :1]
    near = np.isfinite(value) & (value <= limit)
    low = np.fmin(phi[:, 0], np.where(near.any(axis=1), angles[np.argmax(near, axis=1)], np.nan))
    high = np.fmax(phi[:, 0], np.where(near.any(axis=1), angles[-1 - np.argmax(near[:, ::-1], axis=1)], np.nan))
    verdict = _verdict(phi, least, near, angles, options)
    least = np.where(np.isfinite(least), least, np.nan)
    return TwistEstimate(phi[:, 0], least[:, 0], verdict, low, high, phi, least, angles, objective, unsound, search.group,
                         search.offset)


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
        raise InputError(observations.source, "end_frame", "missing, so that nobody knows how the end frames lie to each other",
                         "give end_frame or --offsets, or --observations 1")
    free, clamps = _without_twist(observations)
    last = free.frames[:, -1]
    angle = angle_about(last[..., 0], last[..., 1], clamps.end_frame[..., 1])
    if observations.total_twist is not None:
        return angle + 2 * np.pi * np.round((observations.total_twist - angle) / (2 * np.pi))
    unwrapped = np.unwrap(angle)
    first = np.flatnonzero(np.concatenate([[True], np.diff(group) != 0]))
    return unwrapped - (unwrapped - angle)[first][group]


@dataclass(frozen=True)
class _Search:
    """What every rod of Eq. 4 starts from: N shapes ``free`` of twist and their clamps, ``first`` (K + 1,) rows of groups."""

    observations: Observations
    material: Material
    free: Configuration
    clamps: Clamps
    group: np.ndarray
    first: np.ndarray
    offset: np.ndarray
    options: TwistOptions
    advance: Callable[[int], None]

    @classmethod
    def of(cls, observations, material, group, offset, options, advance) -> "_Search":
        count = observations.count
        group = np.arange(count) if group is None else np.asarray(group)
        offset = np.zeros(count) if offset is None else np.asarray(offset, dtype=np.float64)
        steps = np.diff(group, prepend=-1) if group.shape == (count,) else np.array([-1])
        if group.dtype.kind not in "iu" or steps[0] != 1 or not np.isin(steps, (0, 1)).all():
            raise InputError(observations.source, "group", "not 0, 0, …, 1, …, one for each observation",
                             "number the groups in order")
        if offset.shape != (count,) or not np.isfinite(offset).all():
            raise InputError(observations.source, "offset", f"shape {offset.shape}", f"give ({count},) finite angles")
        if material.count not in (1, count):
            raise InputError(observations.source, "material", f"{material.count} rows for {count} observations",
                             "give one, or one each")
        if observations.start_frame is None and not material.is_isotropic:
            raise InputError(observations.source, "start_frame", "missing, and the rod is not round",
                             "give start_frame, or a scalar --bend")
        free, clamps = _without_twist(observations)
        first = np.append(np.flatnonzero(steps), count)
        return cls(replace(observations, frames=None), material, free, clamps, group, first, offset, options, advance)

    @property
    def count(self) -> int:
        """K."""
        return len(self.first) - 1

    def curves(self, groups: np.ndarray, phi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Σ d in mm, and how many rods of it are no certified minima, (n, f) each, for some groups (n,) at angles (n, f).

        Where an angle is NaN nothing is relaxed and the sum is infinite.
        """
        objective, unsound = np.full(phi.shape, np.inf), np.zeros(phi.shape, dtype=np.int32)
        which, angle = np.nonzero(np.isfinite(phi))
        size = np.diff(self.first)[groups[which]]
        chunk = (np.cumsum(size) - size) // RODS_AT_ONCE
        for part in np.split(np.arange(len(which)), np.flatnonzero(np.diff(chunk)) + 1) if len(which) else []:
            sums = self._sums(groups[which[part]], phi[which[part], angle[part]])
            objective[which[part], angle[part]], unsound[which[part], angle[part]] = sums
        return objective, unsound

    def _sums(self, groups: np.ndarray, phi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Σ d and the number of unsound rods of each pair of a group and an angle (n,)."""
        size = np.diff(self.first)[groups]
        begin = np.cumsum(size) - size
        rows = np.arange(size.sum()) + np.repeat(self.first[groups] - begin, size)
        turned = self._turned(rows, np.repeat(phi, size) + self.offset[rows])
        last = matrix_from_quaternion(turned.quaternions[:, -1])
        held = replace(self.clamps.take(rows), end_frame=last)
        solution = relax(turned, self.material, held, self.options.solver, up=self.observations.up,
                         precision=self.options.precision, configuration_index=np.arange(len(rows)),
                         material_index=rows % self.material.count)
        off = distance(solution.configuration, self.observations, rows)
        self.advance(len(rows))
        unsound = ~(solution.converged & solution.stable)
        return np.add.reduceat(off, begin), np.add.reduceat(unsound.astype(np.int32), begin)

    def _turned(self, rows: np.ndarray, twist: np.ndarray) -> Configuration:
        """The shapes of ``rows`` with so much total twist (n,), rad, spread in proportion to l̄_i."""
        shape, length = self.free.take(rows), self.observations.rest_length
        spread = length[:-1] + length[1:]
        share = np.concatenate([[0.0], np.cumsum(spread) / spread.sum()])
        half = 0.5 * twist[:, None] * share
        cosine, sine = np.cos(half), np.sin(half)
        w, x, y, z = np.moveaxis(shape.quaternions, -1, 0)
        turned = np.stack([w * cosine - x * sine, w * sine + x * cosine, y * cosine + z * sine, z * cosine - y * sine], axis=-1)
        return replace(shape, quaternions=turned)


def _without_twist(observations: Observations) -> tuple[Configuration, Clamps]:
    """The observed shapes with their Bishop frames, and clamps on whole frames: the last one as known, else the Bishop frame.

    Where start frames are unknown their spins are those of the first observation, transported: its clip does not turn.
    """
    observations = replace(observations, frames=None, total_twist=None)
    clamps = observation_clamps(observations)
    if observations.start_frame is None:
        frame = clamps.start_frame
        transport = matrix_from_quaternion(smallest_rotation(frame[0, :, 0], frame[..., 0]))
        clamps = replace(clamps, start_frame=np.einsum("nij,jk->nik", transport, frame[0]))
    clamps = replace(clamps, start=Clamp.FRAME, end=Clamp.TANGENT)
    free = start_configuration(observations, clamps)
    known = observations.end_frame is not None
    return free, replace(clamps, end=Clamp.FRAME, end_frame=clamps.end_frame if known else free.frames[:, -1])


def _lowest(value: np.ndarray, most: int) -> np.ndarray:
    """(K, M) places of the smallest local minima of (K, F) curves, the smallest first, −1 where there are fewer."""
    wall = np.full((len(value), 1), np.inf)
    left, right = np.hstack([wall, value[:, :-1]]), np.hstack([value[:, 1:], wall])
    depth = np.where((value < left) & (value <= right), value, np.inf)
    place = np.argsort(depth, axis=1, kind="stable")[:, :most]
    return np.where(np.isfinite(np.take_along_axis(depth, place, axis=1)), place, -1)


def _refined(search: _Search, angles, value, place, options: TwistOptions) -> tuple[np.ndarray, np.ndarray]:
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
        sums, unsound = search.curves(groups, np.where(np.abs(tried) <= angles[-1] + 1e-9, tried, np.nan))
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
