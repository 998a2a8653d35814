"""The curve of Eq. 4, and the offsets τ between the observations of a group (§IV-B).

    Σ_i d(F(Γ^i, E_Θ, T_{φ+τ_i}(C^i)), Γ^i)      over φ, the rotation of the end frame

Axes: N observations, K groups that share a φ, n of them, f angles.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np

from doo_ti.contact.surroundings import Surroundings
from doo_ti.io.arrays import frame_columns, read_arrays
from doo_ti.relaxation.contact_table import require_clear
from doo_ti.relaxation.newton import Newton
from doo_ti.relaxation.relax import relax
from doo_ti.rod.frames import angle_about, matrix_from_quaternion, transported
from doo_ti.rod.metric import distance
from doo_ti.rod.observations import Observations
from doo_ti.rod.start import observation_clamps, start_configuration, twist_shares
from doo_ti.rod.types import Clamp, Clamps, Configuration, Material
from doo_ti.system.arguments import typed
from doo_ti.system.errors import InputError, require_whole

MOST_OBSERVATIONS = 10_000_000
RODS_AT_ONCE = 1 << 15  # rods of one launch, which bounds the memory for their frames


@dataclass(frozen=True)
class TwistCurves:
    """Σ d of Eq. 4 for K groups of N observations, at any angles."""

    observations: Observations
    material: Material
    free: Configuration  # (N) shapes without twist
    clamps: Clamps  # (N) of these
    group: np.ndarray  # (N,) of each observation
    first: np.ndarray  # (K + 1,) rows at which groups begin, and N
    offset: np.ndarray  # (N,) τ, rad
    solver: Newton
    precision: str
    surroundings: Surroundings  # what the rods touch, with one row for all observations or one for each
    advance: Callable[[int], None]  # called with the number of rods done

    @classmethod
    def of(cls, observations: Observations, material: Material, group, offset, solver: Newton, precision: str,
           surroundings: Surroundings, advance: Callable[[int], None]) -> "TwistCurves":
        """Raises InputError where arguments do not match, for a rod that is not round while its first roll is unknown, and for
        rods inside obstacles."""
        count = observations.count
        group = np.arange(count) if group is None else np.array(group)
        offset = np.zeros(count) if offset is None else np.array(offset, dtype=np.float64)
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
                             "give start_frame, or an isotropic material")
        free, clamps = without_twist(observations, group)
        if surroundings:
            require_clear(observations.source, surroundings, clamps, free, np.arange(count))
        first = np.append(np.flatnonzero(steps), count)
        return cls(replace(observations, frames=None), material, free, clamps, group, first, offset, solver, precision,
                   surroundings, advance)

    @property
    def count(self) -> int:
        """K, the number of groups that share a φ."""
        return len(self.first) - 1

    def at(self, groups: np.ndarray, phi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
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
        solution = relax(turned, self.material, held, self.solver, up=self.observations.up,
                         precision=self.precision, configuration_index=np.arange(len(rows)),
                         material_index=rows % self.material.count, **self.surroundings.take(rows).arguments)
        off = distance(solution.configuration, self.observations, rows)
        self.advance(len(rows))
        unsound = ~(solution.converged & solution.stable)
        return np.add.reduceat(off, begin), np.add.reduceat(unsound.astype(np.int32), begin)

    def _turned(self, rows: np.ndarray, twist: np.ndarray) -> Configuration:
        """The shapes of ``rows`` with a total twist (n,) rad, distributed in proportion to l̄_i."""
        shape = self.free.take(rows)
        half = 0.5 * twist[:, None] * twist_shares(self.observations.rest_length)
        cosine, sine = np.cos(half), np.sin(half)
        w, x, y, z = np.moveaxis(shape.quaternions, -1, 0)
        turned = np.stack([w * cosine - x * sine, w * sine + x * cosine, y * cosine + z * sine, z * cosine - y * sine], axis=-1)
        return replace(shape, quaternions=turned)


def without_twist(observations: Observations, group: np.ndarray) -> tuple[Configuration, Clamps]:
    """The observed shapes with their Bishop frames, and clamps on whole frames: the last one if known, else the Bishop frame.

    Where start frames are unknown, their rolls are those of the first observation of the ``group`` (N,), parallel transported:
    the clip at the start does not turn.
    """
    observations = replace(observations, frames=None, total_twist=None)
    clamps = observation_clamps(observations)
    if observations.start_frame is None:
        frame = clamps.start_frame
        clamps = replace(clamps, start_frame=transported(frame[np.searchsorted(group, group)], frame[..., 0]))
    clamps = replace(clamps, start=Clamp.FRAME, end=Clamp.TANGENT)
    free = start_configuration(observations, clamps)
    known = observations.end_frame is not None
    return free, replace(clamps, end=Clamp.FRAME, end_frame=clamps.end_frame if known else free.frames[:, -1])


# --- groups and offsets τ -------------------------------------------------------------------------------------------------

MOST_DEG = 36_000.0  # largest |τ|
FIELDS = {"start_frame": "start_frame", "end_frame": "end_frame", "total_twist_deg": "total_twist"}
KNOWN = {"offset_deg": ((), ("offset_deg",)), "total_twist_deg": ((), ("total_twist_deg",)),
         "start_frame": ((3, 3), frame_columns("start_frame")), "end_frame": ((3, 3), frame_columns("end_frame"))}


@typed
def consecutive_groups(count: int, together: int, regrasps: Sequence[int] = ()) -> np.ndarray:
    """(count,) groups of ``together`` consecutive observations; a new grasp begins at each of the rows ``regrasps``, and the
    last group before it may be smaller. Raises InputError for numbers and rows that are none of observations."""
    require_whole("consecutive_groups", "count", count, 1, MOST_OBSERVATIONS)
    require_whole("consecutive_groups", "together", together, 1)
    if any(not 0 <= row < count for row in regrasps):
        raise InputError("consecutive_groups", "regrasps", f"{list(regrasps)}", f"give rows from 0 to {count - 1}")
    begins = np.zeros(count, dtype=np.int64)
    begins[np.array([0, *regrasps], dtype=np.int64)] = 1
    first = np.maximum.accumulate(np.where(begins == 1, np.arange(count), 0))
    starts = (np.arange(count) - first) % together == 0
    return np.cumsum(starts) - 1


@typed
def end_offsets(observations: Annotated[Observations, "N"], group: Annotated[np.ndarray, "N"]) -> np.ndarray:
    """(N,) τ: the angle in rad from the last Bishop frame of each shape to its known end frame.

    Whole turns are chosen nearest to ``total_twist`` if that is given. Else the first τ of each group is within half a turn of
    zero, and each of the others within half a turn of the one before it.

    Raises InputError where ``end_frame`` is missing.
    """
    if observations.end_frame is None:
        raise InputError(observations.source, "end_frame", "missing, so that the angles between the end frames are unknown",
                         "give end_frame or offsets, or one observation per group")
    free, clamps = without_twist(observations, group)
    last = free.frames[:, -1]
    angle = angle_about(last[..., 0], last[..., 1], clamps.end_frame[..., 1])
    if observations.total_twist is not None:
        return angle + 2 * np.pi * np.round((observations.total_twist - angle) / (2 * np.pi))
    unwrapped = np.unwrap(angle)
    first = np.flatnonzero(np.concatenate([[True], np.diff(group) != 0]))
    return unwrapped - (unwrapped - angle)[first][group]


def load_offsets(path: Path, observations: Observations) -> tuple[Observations, np.ndarray | None]:
    """The observations with frames from a file, and τ (N,) in rad if the file holds it. The file is npz or CSV, with a row per
    observation, and holds

        offset_deg        τ, whole turns included; or
        end_frame         frames of the last edge, columns t, m1, m2 (in CSV nine columns end_frame_t_x, end_frame_m1_x, …), and
        start_frame       the same of the first edge, where the near end moves
        total_twist_deg   to choose the whole turns of the end frames

    Raises InputError for files that cannot be read, hold neither, or hold other than a row for each observation.
    """
    arrays = read_arrays(Path(path), KNOWN)
    for key, value in arrays.items():
        wanted = (observations.count, *KNOWN[key][0])
        if value.shape != wanted:
            raise InputError(path, key, f"shape {value.shape}", f"make it {wanted}, one for each observation")
    if "offset_deg" in arrays:
        if not (np.abs(arrays["offset_deg"]) <= MOST_DEG).all():
            raise InputError(path, "offset_deg", "not finite, or more than 100 turns", "give degrees, whole turns included")
        return observations, np.radians(arrays["offset_deg"])
    if "end_frame" not in arrays:
        raise InputError(path, "end_frame", "missing", "give offset_deg or end_frame")
    if "total_twist_deg" in arrays:
        arrays["total_twist_deg"] = np.radians(arrays["total_twist_deg"])
    known = {FIELDS[key]: value for key, value in arrays.items()}
    return replace(observations, source=str(path), **known), None
