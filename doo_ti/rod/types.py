"""Inputs and results of F as NumPy arrays (§III-A, §III-B).

Axes, one letter each throughout the package:

    R rods   E edges   V = E + 1 vertices   D observations   G grid cells

Units are millimetres and radians; energies are relative to weight, so that with ``weight = 1``
bend and twist come out in mm³ (footnote 6: only ratios of the parameters matter).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from enum import IntEnum
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from numpy.typing import ArrayLike

from doo_ti.rod.frames import (
    across,
    bishop_frames,
    matrix_from_quaternion,
    quaternion_from_matrix,
    tangent_from_quaternion,
    unit_direction,
    vertices_from_quaternions,
)
from doo_ti.rod.material import LARGEST, Material, Rows, force_in_newton
from doo_ti.system.arguments import counted, span_text, typed
from doo_ti.system.errors import MOST_EDGES, InputError, require_whole

__all__ = ["LARGEST", "Clamp", "Clamps", "Configuration", "Material", "Rows", "Solution", "Status", "sticky", "unit_up"]


class Status(IntEnum):
    """How a relaxation ended, one per rod.

    CONVERGED        at rest: residual, closure, decrement and, in contact, gaps are within tolerance. Whether it is a minimum
                     says :attr:`Solution.stable`
    ITERATION_LIMIT  more iterations would be needed
    STALLED          neither energy nor residual decreases any more
    NOT_FINITE       a number overflowed or is undefined
    INFEASIBLE       the clamps are further apart than the free edges reach, fewer than two edges are free, or clamps or the
                     start are inside an obstacle
    """

    CONVERGED = 0
    ITERATION_LIMIT = 1
    STALLED = 2
    NOT_FINITE = 3
    INFEASIBLE = 4


class Clamp(IntEnum):
    """Constraint of one end of a rod (§III-B).

    FREE      none
    POSITION  the end vertex, as by a ball joint
    TANGENT   the end vertex and the direction of the end edge, which may roll
    FRAME     the end vertex and the whole frame of the end edge, as by a gripper
    """

    FREE = 0
    POSITION = 1
    TANGENT = 2
    FRAME = 3


def picked(values: np.ndarray, index: Rows) -> np.ndarray:
    """The rows named by ``index`` in an array of their own, for a slice too."""
    rows = values[index]
    return rows.copy() if rows.base is not None else rows


def sticky(before: np.ndarray, status: np.ndarray) -> np.ndarray:
    """(R,) sticky status of rods relaxed several times: the first status that is not CONVERGED, else CONVERGED."""
    return np.where(before == Status.CONVERGED, status, before)


@typed
@dataclass(frozen=True)
class Configuration:
    """Γ = (V, E, M) of §III-A for R rods, kept as a chain of frames so that edge lengths hold exactly. It refers to the arrays
    it is given; functions copy what their results keep.

    start        (R, 3) position of vertex 0, mm
    quaternions  (R, E, 4) material frame of each edge, scalar first: t, m1, m2 are the columns of its rotation
    rest_length  (E,) or (R, E), mm; zero for a first or last edge that only has a direction, see :class:`Clamps`
    """

    start: Annotated[np.ndarray, "R 3", float]
    quaternions: Annotated[np.ndarray, "R E 4", float]
    rest_length: Annotated[np.ndarray, "E | 1R E", float]

    @property
    def count(self) -> int:
        return len(self.quaternions)

    @property
    def edges(self) -> int:
        return self.quaternions.shape[1]

    @property
    def vertices(self) -> np.ndarray:
        """(R, V, 3) vertex positions, mm."""
        return vertices_from_quaternions(self.start, self.quaternions, self.rest_length)

    @property
    def curvature_binormal(self) -> np.ndarray:
        """(R, E−1, 3) curvature at the inner vertices in 1/mm, along the axis about which the rod bends there:
        κb/(l̄/2) of §III-C."""
        t = tangent_from_quaternion(self.quaternions)
        before, after = t[:, :-1], t[:, 1:]
        both = self.rest_length[..., :-1] + self.rest_length[..., 1:]
        share = 1.0 + np.sum(before * after, axis=-1)
        return np.cross(before, after) * (4.0 / (share * both))[..., None]

    @property
    def curvature(self) -> np.ndarray:
        """(R, E−1) curvature at the inner vertices, 1/mm: the length of :attr:`curvature_binormal`."""
        return np.linalg.norm(self.curvature_binormal, axis=-1)

    @property
    def frames(self) -> np.ndarray:
        """(R, E, 3, 3) material frames, columns t, m1, m2."""
        return matrix_from_quaternion(self.quaternions)

    def __repr__(self) -> str:
        length = span_text(self.rest_length.sum(axis=-1), "mm")
        return f"Configuration({counted(self.count, 'rod')} of {counted(self.edges, 'edge')}, {length} long)"

    def take(self, index: Rows) -> "Configuration":
        """The rods named by ``index``, in that order, in arrays of their own."""
        lengths = self.rest_length.copy() if self.rest_length.ndim == 1 else picked(self.rest_length, index)
        return Configuration(picked(self.start, index), picked(self.quaternions, index), lengths)

    @classmethod
    @typed
    def straight(cls, start: Annotated[np.ndarray, "3"], direction: Annotated[np.ndarray, "3"], length: float, edges: int
                 ) -> "Configuration":
        """One rod of that ``length`` in mm, straight from ``start`` (3,) in the unit ``direction`` (3,), without twist. Raises
        InputError for fewer than one edge."""
        require_whole("Configuration.straight", "edges", edges, 1, MOST_EDGES)
        frame = quaternion_from_matrix(bishop_frames(direction[None, None], across(direction[None])))
        return cls(np.array(start, dtype=np.float64)[None], np.tile(frame, (1, edges, 1)), np.full(edges, length / edges))

    @classmethod
    @typed
    def concatenate(cls, parts: Sequence["Configuration"]) -> "Configuration":
        """The rods of several, one after the other; their lengths are shared where all have the same."""
        first = parts[0].rest_length
        shared = all(part.rest_length.ndim == 1 and np.array_equal(part.rest_length, first) for part in parts)
        lengths = first.copy() if shared else np.concatenate(
            [np.broadcast_to(part.rest_length, (part.count, part.edges)) for part in parts])
        starts, frames = ([getattr(part, name) for part in parts] for name in ("start", "quaternions"))
        return cls(np.concatenate(starts), np.concatenate(frames), lengths)


def put_rods(rods: Configuration, rows: np.ndarray, other: Configuration) -> Configuration:
    """``rods`` with ``other`` in those rows."""
    start, frames = rods.start.copy(), rods.quaternions.copy()
    start[rows], frames[rows] = other.start, other.quaternions
    return Configuration(start, frames, rods.rest_length)


def finite_rods(rods: Configuration, otherwise: Configuration) -> Configuration:
    """``rods``, those that are not finite as they are in ``otherwise``."""
    lost = np.flatnonzero(~np.isfinite(rods.quaternions).all(axis=(1, 2)))
    return put_rods(rods, lost, otherwise.take(lost)) if len(lost) else rods


def require_kinds(source: str, start: Clamp | np.ndarray, end: Clamp | np.ndarray) -> None:
    """Raise InputError unless both are members of Clamp, or whole numbers of such."""
    for name, kind in (("start", start), ("end", end)):
        if not isinstance(kind, Clamp):
            kind = np.asarray(kind)
            if kind.dtype.kind not in "iuf" or not ((kind >= 0) & (kind < len(Clamp)) & (kind == np.round(kind))).all():
                raise InputError(source, name, f"{kind.tolist()!r:.60}", "give a Clamp, or one for each rod")


POSES = ("start_position", "end_position", "start_frame", "end_frame")
"""The arrays of :class:`Clamps`, besides the kinds."""


@typed
@dataclass(frozen=True)
class Clamps:
    """C of §III-B: how the two ends of R rods are held. Inextensibility needs no entry: the chain of frames is inextensible.

    start, end                    Clamp, one for all rods or (R,) of them
    start_position, end_position  (R, 3) mm; unused where the end is free
    start_frame, end_frame        (R, 3, 3) columns t, m1, m2; only t counts for a tangent clamp; unused below that

    A clamp that holds a direction holds the end edge, so that the rod begins to bend at that edge's middle: it acts there, half
    an edge from the end vertex, and forces and deflections converge with the first order of the edge. Where the end edge has a
    ``rest_length`` of zero the clamp acts at the end vertex itself, with second order: ``straight_rod(…, vertex_clamps=True)``.
    """

    start: Annotated[np.ndarray, "() | 1R"]
    end: Annotated[np.ndarray, "() | 1R"]
    start_position: Annotated[np.ndarray, "R 3", float]
    end_position: Annotated[np.ndarray, "R 3", float]
    start_frame: Annotated[np.ndarray, "R 3 3", float]
    end_frame: Annotated[np.ndarray, "R 3 3", float]

    if TYPE_CHECKING:  # one kind serves for all rods
        def __init__(self, start: Clamp | ArrayLike, end: Clamp | ArrayLike, start_position: np.ndarray,
                     end_position: np.ndarray, start_frame: np.ndarray, end_frame: np.ndarray) -> None: ...

    def __post_init__(self) -> None:
        require_kinds("Clamps", self.start, self.end)

    def __repr__(self) -> str:
        start, end = (" or ".join(Clamp(kind).name.lower() for kind in np.unique(kinds)) for kinds in (self.start, self.end))
        return f"Clamps({counted(self.count, 'rod')}: start {start}, end {end})"

    @property
    def count(self) -> int:
        """R, the number of rods."""
        return len(self.start_position)

    def take(self, index: Rows) -> "Clamps":
        """The clamps of the rods named by ``index``, in that order, in arrays of their own."""
        kinds = (np.array(kind) for kind in (self.start, self.end))
        return Clamps(*(kind if kind.ndim == 0 else kind[index] for kind in kinds),
                      *(picked(getattr(self, name), index) for name in POSES))

    @classmethod
    @typed
    def concatenate(cls, parts: Sequence["Clamps"]) -> "Clamps":
        """The clamps of several, one after the other; their kinds are shared where all have the same."""
        kinds = []
        for end in ("start", "end"):
            own = [getattr(part, end) for part in parts]
            shared = all(np.ndim(kind) == 0 and kind == own[0] for kind in own)
            kinds.append(own[0] if shared else np.concatenate([
                np.broadcast_to(kind, part.count) for kind, part in zip(own, parts, strict=True)]))
        return cls(*kinds, *(np.concatenate([getattr(part, name) for part in parts]) for name in POSES))


@typed
@dataclass(frozen=True)
class Solution:
    """The result of F: one entry per rod.

    configuration  the relaxed rods
    energy         (R,) E(Γ) of §III-C, gravity measured from z = 0
    residual       (R,) the largest moment left on a free edge, times the length, over the largest eigenvalue of B (no unit), or
                   over a thousandth of β; of a taut rod, whose edges cannot tilt, only moments about tangents count. Of soft
                   parts beside stiff ones it says little: converged rods also have a small Newton decrement (docs/chain.md)
    closure        (R,) distance by which the far end misses its clamp over the rod's length
    iterations     (R,) number of solver iterations
    status         (R,) Status
    stable         (R,) True where the inertia of the rod's KKT matrix certifies a minimum, not a saddle. Neutral motions, such
                   as the rotation of a weightless bow about its chord, are allowed
    end_force      (R, 3) force of the far clamp on the rod, mm (energy in mm² per mm): the energy grows by end_force · d when
                   the clamp moves by d. Zero where the far end is free. NaN in a taut rod, one that is straight because its
                   clamps are as far apart as it is long, to 1e-7: its tension is not determined
    precision      (R,) 32 or 64: the arithmetic that finished the rod
    contact_force  (R, V, 3) of obstacles on the vertices, energy (mm²) per mm; None without obstacles
    tables         the input, with which :func:`doo_ti.relaxation.relax.relax` can continue; None where solutions were joined
    """

    configuration: Configuration
    energy: Annotated[np.ndarray, "R"]
    residual: Annotated[np.ndarray, "R"]
    closure: Annotated[np.ndarray, "R"]
    iterations: Annotated[np.ndarray, "R", int]
    status: Annotated[np.ndarray, "R", int]
    stable: Annotated[np.ndarray, "R", bool]
    end_force: Annotated[np.ndarray, "R 3"]
    precision: Annotated[np.ndarray, "R", int]
    tables: object = field(default=None, repr=False)
    contact_force: Annotated[np.ndarray | None, "R V 3"] = None

    def __post_init__(self) -> None:
        if self.tables is not None and not hasattr(self.tables, "material_index"):
            raise InputError("Solution", "tables", f"a {type(self.tables).__name__}", "leave out what relax keeps for itself")
        table = getattr(self.tables, "contact", None)
        if self.contact_force is None and table is not None:
            object.__setattr__(self, "contact_force", table.forces)
        if self.status.size and not 0 <= self.status.min() <= self.status.max() < len(Status):
            raise InputError("Solution", "status", f"{self.status.min()} to {self.status.max()}", "give a Status for each rod")
        rods = self.configuration.count, self.configuration.edges
        if self.tables is not None and rods != (self.tables.count, self.tables.edges):
            raise InputError("Solution", "configuration", f"{rods[0]} rods of {rods[1]} edges beside other tables",
                             "give the configuration that was relaxed, or no tables")
        if rods[0] != len(self.status):
            raise InputError("Solution", "status", f"{len(self.status)} for {rods[0]} rods", "give one for each")

    @property
    def contact(self) -> Any:
        """Forces, gaps and touching vertices as :class:`doo_ti.contact.touch.Contacts`; None without obstacles, and without
        ``tables``."""
        table = getattr(self.tables, "contact", None)
        return None if table is None else table.contacts(self.configuration.vertices, self.contact_force)

    @property
    def converged(self) -> np.ndarray:
        """(R,) bool: whether each rod has converged."""
        return self.status == Status.CONVERGED

    @typed
    def end_force_in_newton(self, weight_per_length: ArrayLike, weight: ArrayLike = 1.0) -> np.ndarray:
        """(R, 3) ``end_force`` in N, of rods that weigh ``weight_per_length`` in N/m, a scalar or (R, 1), and whose material's
        weight μ is ``weight``, of the same shapes. Raises InputError where either is not positive."""
        for name, value in (("weight_per_length", np.asarray(weight_per_length)), ("weight", np.asarray(weight))):
            if value.shape not in ((), (1,), (1, 1), (len(self.end_force), 1)) or not ((value > 0) & (value <= LARGEST)).all():
                raise InputError("end_force_in_newton", name, f"{value.tolist()!r:.60}",
                                 "give a positive number, or (R, 1) of them")
        return force_in_newton(self.end_force, weight_per_length, weight)

    def __repr__(self) -> str:
        counts = [f"{count} {Status(kind).name.lower().replace('_', ' ')}"
                  for kind, count in zip(*np.unique(self.status, return_counts=True), strict=True)]
        of_edges = f"{counted(len(self.status), 'rod')} of {counted(self.configuration.edges, 'edge')}"
        return f"Solution({of_edges}: {', '.join(counts)}; {int(self.stable.sum())} certified stable)"

    def take(self, index: Rows) -> "Solution":
        """The rods named by ``index``, in that order and in arrays of their own, without their input."""
        rows = {name: picked(value, index) for name, value in self.per_rod.items()}
        return Solution(self.configuration.take(index), **rows)

    @property
    def per_rod(self) -> dict[str, np.ndarray]:
        """The arrays with a row for each rod, but for its configuration, by name."""
        every = {name: getattr(self, name) for name in _PER_ROD}
        return {name: value for name, value in every.items() if value is not None}

    @classmethod
    def concatenate(cls, parts: Sequence["Solution"]) -> "Solution":
        """The rods of several solutions one after the other, of equally many edges, without their input; a single solution as
        it is."""
        if len(parts) == 1:
            return parts[0]
        rods = Configuration.concatenate([part.configuration for part in parts])
        every = [part.per_rod for part in parts]
        return cls(rods, **{name: np.concatenate([part[name] for part in every]) for name in every[0]})


_PER_ROD = tuple(entry.name for entry in fields(Solution) if entry.name not in ("configuration", "tables"))


def unit_up(up: ArrayLike, function: str) -> np.ndarray:
    """(3,) the unit vector along ``up``, an argument of ``function``. Raises InputError where it is not a direction."""
    return unit_direction(function, "up", up)
