"""Eq. 4: the twist of a rod from its observed shape (§IV-B).

    min_φ Σ_i d(F(Γ^i, E_Θ, T_φ(C^i)), Γ^i)                                                              (Eq. 4)

The vertices of a round rod do not show its material frames, but twist changes its shape. So the rod is relaxed from Γ^i with
its end frame rotated by φ, for φ over several turns; the best φ is the one for which it moves least away from the observation.

One configuration: its end frame is the last Bishop frame rotated by φ, so φ is the total twist. Several, in one grasp: with
τ_i the angle, whole turns included, from the last Bishop frame of Γ^i to the known frame of the gripper, the total twist is
φ + τ_i, and φ is the unknown rotation of the rod in the gripper. Each new grasp has its own φ (footnote 4).

The interval reaches as far as the objective is small. Where frames were not reported, ends are held along noisy marks, which
tilts them: then the estimate is repeated with more noise in the marks, and the interval widened by how much it moves (a
parametric bootstrap).

Axes: N observations, K groups that share a φ, F sampled angles, M minima of a group.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike

from doo_ti.contact.surroundings import Surroundings
from doo_ti.perception.twist_curves import TwistCurves
from doo_ti.relaxation.newton import Newton
from doo_ti.rod.material import doubt_angle
from doo_ti.rod.observations import Observations
from doo_ti.rod.types import Material
from doo_ti.system.arguments import short_repr, typed
from doo_ti.system.errors import InputError

REPEATS, STUDENT, SEED = 6, 2.45, 2011
"""Estimates with more noise, Student's factor of 95 % for as many, and the seed of that noise."""
FARTHEST, PLACES = np.pi / 2, 13
"""rad from a minimum as far as which it is sought again, and at how many angles."""


class TwistVerdict(IntEnum):
    """How certain the minimum of a group's curve is.

    CLEAR         the whole 95 % interval is within 60° of it
    AMBIGUOUS     the interval contains angles that are farther off
    AT_BORDER     the minimum is where the samples end
    UNDETERMINED  no rod reached a certified minimum
    """

    CLEAR = 0
    AMBIGUOUS = 1
    AT_BORDER = 2
    UNDETERMINED = 3


@typed
@dataclass(frozen=True)
class TwistOptions:
    """Options of the search of Eq. 4.

    span, step   φ is sampled over [−span, span] by ``step``, rad (§V-F)
    minima       number of local minima of the samples that are refined
    halvings     of the step around each of them; then a parabola through the last three values
    rise         the interval holds the angles at which the objective of D observations is at most 1 + rise/∜D times the
                 least. It is calibrated: with 2 it contains the true angle of 95 % of simulated rods (docs/twist.md)
    apart        a minimum is ambiguous if the interval contains angles farther off than this, rad
    solver, precision  as :func:`doo_ti.relaxation.relax.relax` takes them
    surroundings what the rods touch, without friction; with one row for all observations or one for each
    """

    span: float = 2 * np.pi
    step: float = np.pi / 12
    minima: int = 3
    halvings: int = 3
    rise: float = 2.0
    apart: float = np.pi / 3
    solver: Newton = Newton()
    precision: str = "f32"
    surroundings: Surroundings = Surroundings()

    def __post_init__(self) -> None:
        for name in ("span", "step"):
            if not 0 < getattr(self, name) < np.inf:
                raise InputError("twist", name, f"{getattr(self, name)} is no angle", "give a positive number of radians")
        if self.span < self.step or self.minima < 1 or self.halvings < 0 or self.rise < 0:
            raise InputError("twist", "options", "nothing to search",
                             "give step <= span, minima >= 1, halvings >= 0, rise >= 0")

    @property
    def angles(self) -> np.ndarray:
        """(F,) rad."""
        count = int(np.floor(self.span / self.step + 1e-9))
        return self.step * np.arange(-count, count + 1)


@dataclass(frozen=True)
class TwistEstimate:
    """Twist of K groups by Eq. 4, angles in rad.

    phi        (K,) where the objective is least; NaN where no rod reached a certified minimum
    least      (K,) mm, the objective there
    verdict    (K,) TwistVerdict
    low, high  (K,) ends of the 95 % interval: the outermost angles at which the objective is at most 1 + rise/∜D times the
               least, and farther where ends are held along noisy marks
    minima     (K, M) the local minima, the best first, NaN where there are fewer; minima_objective (K, M) mm
    angles     (F,) the samples
    objective  (K, F) mm, the curve of Eq. 4, a sum over the group; NaN where a rod failed
    unsound    (K, F) rods of each sum that reached no certified minimum: such samples are reported but not chosen
    group      (N,) of each observation
    offset     (N,) τ of each observation
    """

    __repr__ = short_repr

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


@typed
def estimate_twist(
    observations: Observations, material: Material, group: ArrayLike | None = None, offset: ArrayLike | None = None,
    options: TwistOptions = TwistOptions(), advance: Callable[[int], None] = lambda rods: None,
) -> TwistEstimate:
    """Estimate the twist of K groups of observations by Eq. 4, all at once.

    observations  N observations; vertices, rest lengths, start frames and the tangents of the end frames are used
    material      Θ, one for all or one for each observation
    group         (N,) 0, 0, …, 1, …, K − 1: observations of one group share φ; by default each has its own
    offset        (N,) τ in rad, from :func:`doo_ti.perception.twist_curves.end_offsets`; zero by default
    advance       called with the number of rods relaxed since the last call; N·F for the samples, and more to refine minima

    Raises InputError where the arguments do not match, for a rod that is not round while the start's roll is unknown, and for
    rods inside obstacles.
    """
    doubt_angle("estimate_twist", "offset", offset)
    curves = TwistCurves.of(observations, material, group, offset, options.solver, options.precision, options.surroundings,
                            advance)
    angles = options.angles
    objective, unsound = curves.at(np.arange(curves.count), np.tile(angles, (curves.count, 1)))
    value = np.where((unsound == 0) & np.isfinite(objective), objective, np.inf)
    place = _lowest(value, options.minima)
    phi, least = _refined(curves, angles, value, place, options)
    order = np.argsort(least, axis=1, kind="stable")
    phi, least = np.take_along_axis(phi, order, axis=1), np.take_along_axis(least, order, axis=1)
    limit = least[:, 0] * (1 + options.rise / np.diff(curves.first) ** 0.25)
    low, high = _interval(np.hstack([np.broadcast_to(angles, value.shape), phi]), np.hstack([value, least]), limit)
    if observations.start_frame is None or observations.end_frame is None:
        moved = STUDENT * _moved_by_noise(curves, phi[:, 0])
        low, high = phi[:, 0] - np.hypot(phi[:, 0] - low, moved), phi[:, 0] + np.hypot(high - phi[:, 0], moved)
    rival, border = np.fmax(phi[:, 0] - low, high - phi[:, 0]) > options.apart, np.abs(phi[:, 0]) > angles[-1] - 1e-6
    verdict = np.where(border, TwistVerdict.AT_BORDER, np.where(rival, TwistVerdict.AMBIGUOUS, TwistVerdict.CLEAR))
    verdict = np.where(np.isfinite(least[:, 0]), verdict, TwistVerdict.UNDETERMINED).astype(np.int8)
    least = np.where(np.isfinite(least), least, np.nan)
    return TwistEstimate(phi[:, 0], least[:, 0], verdict, low, high, phi, least, angles, objective, unsound, curves.group,
                         curves.offset)


def _moved_by_noise(curves: TwistCurves, phi: np.ndarray) -> np.ndarray:
    """(K,) rad: how far the minima at ``phi`` (K,) move with more noise in the marks, root mean square. The noise of an
    observation depends on its place in its group alone."""
    seen, count, shape = curves.observations, curves.observations.count, curves.observations.vertices.shape[1:]
    place, rows = np.arange(count) - curves.first[curves.group], np.tile(np.arange(count), REPEATS)
    sigma = mark_noise(seen.vertices) if seen.sigma is None else np.nan_to_num(seen.sigma)
    noise = np.random.default_rng(SEED).normal(size=(place.max() + 1, REPEATS, *shape))[place].swapaxes(0, 1)
    noisy = replace(seen.take(rows), vertices=(seen.vertices + noise * sigma.reshape(count, -1, 1)).reshape(-1, *shape))
    material = curves.material if curves.material.count == 1 else curves.material.take(rows)
    groups = (curves.group + curves.count * np.arange(REPEATS)[:, None]).ravel()
    repeated = TwistCurves.of(noisy, material, groups, curves.offset[rows], curves.solver, curves.precision,
                              curves.surroundings.take(rows), curves.advance)
    shifts = np.linspace(-FARTHEST, FARTHEST, PLACES)
    value, unsound = repeated.at(np.arange(repeated.count), np.tile(phi, REPEATS)[:, None] + shifts)
    value = np.where((unsound == 0) & np.isfinite(value), value, np.inf)
    place = value.argmin(axis=1)
    before, least, after = (np.pad(value, ((0, 0), (1, 1)), constant_values=np.inf)[np.arange(len(place)), place + k]
                            for k in range(3))
    with np.errstate(invalid="ignore"):
        inside = 0.5 * (before - after) / (before - 2 * least + after)
    shift = shifts[place] + np.where(np.isfinite(inside), inside, 0.0) * (shifts[1] - shifts[0])
    shift = np.where(np.isfinite(least), shift, FARTHEST)
    return np.sqrt((shift.reshape(REPEATS, -1) ** 2).mean(axis=0))


def mark_noise(vertices: np.ndarray) -> np.ndarray:
    """(N,) mm: standard deviation of each coordinate of the marks (N, V, 3), from fourth differences, in which smooth curves
    hardly count; zero with fewer than five marks in a row."""
    fourth = np.diff(vertices, 4, axis=1)
    counts = np.isfinite(fourth).sum(axis=(1, 2))
    return np.sqrt(np.nansum(fourth**2, axis=(1, 2)) / np.maximum(70 * counts, 1))


def _lowest(value: np.ndarray, most: int) -> np.ndarray:
    """(K, M) places of the smallest local minima of (K, F) curves, the smallest first, −1 where there are fewer."""
    border = np.full((len(value), 1), np.inf)
    left, right = np.hstack([border, value[:, :-1]]), np.hstack([value[:, 1:], border])
    depth = np.where((value < left) & (value <= right), value, np.inf)
    place = np.argsort(depth, axis=1, kind="stable")[:, :most]
    return np.where(np.isfinite(np.take_along_axis(depth, place, axis=1)), place, -1)


def _refined(curves: TwistCurves, angles, value, place, options: TwistOptions) -> tuple[np.ndarray, np.ndarray]:
    """(K, M) refined angles and values of the minima, NaN and infinite where there are fewer."""
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


def _interval(angle: np.ndarray, value: np.ndarray, limit: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(K,) twice: the outermost angles at which curves, known at (K, n) angles and linear between them, are at most ``limit``
    (K,); NaN where they never are. Beside a value that is infinite the interval reaches to its angle."""
    order = np.argsort(np.where(np.isnan(angle), np.inf, angle), axis=1)
    angle, value = np.take_along_axis(angle, order, axis=1), np.take_along_axis(value, order, axis=1)
    return _first_within(angle, value, limit), _first_within(angle[:, ::-1], value[:, ::-1], limit)


def _first_within(angle: np.ndarray, value: np.ndarray, limit: np.ndarray) -> np.ndarray:
    """(K,) where curves fall to ``limit`` first, in the order of their angles."""
    rows, within = np.arange(len(angle)), value <= limit[:, None]
    place = np.argmax(within, axis=1)
    before = np.maximum(place - 1, 0)
    here, there = value[rows, place], value[rows, before]
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.where(np.isfinite(there) & (there > here), (limit - here) / (there - here), 1.0)
    known = np.isfinite(angle[rows, before])
    reach = np.where(known, share * (np.where(known, angle[rows, before], 0.0) - angle[rows, place]), 0.0)
    return np.where(within.any(axis=1), angle[rows, place] + reach, np.nan)
