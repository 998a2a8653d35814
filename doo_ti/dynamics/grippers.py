"""Grippers: what holds the ends of rods at every instant of a motion (§III-B, moving)."""

from copy import copy
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from doo_ti.rod.frames import FRAME_TOLERANCE, matrix_from_quaternion, orthonormality_error, quaternion_from_matrix
from doo_ti.rod.types import POSES, Clamp, Clamps, Rows, require_kinds
from doo_ti.system.arguments import short_repr, typed
from doo_ti.system.errors import InputError, real_array, require_whole


@typed
@dataclass(frozen=True)
class Grippers:
    """The clamps of S rods at T instants, the first of which is where the motion starts.

    start, end                    Clamp, one for all rods or (S,) of them; they hold the same throughout
    start_position, end_position  (S, T, 3) mm; unused where the end is free
    start_frame, end_frame        (S, T, 3, 3) columns t, m1, m2; of a tangent clamp t only
    """

    __repr__ = short_repr

    start: Annotated[np.ndarray, "() | 1S"]
    end: Annotated[np.ndarray, "() | 1S"]
    start_position: Annotated[np.ndarray, "S T 3"]
    end_position: Annotated[np.ndarray, "S T 3"]
    start_frame: Annotated[np.ndarray, "S T 3 3"]
    end_frame: Annotated[np.ndarray, "S T 3 3"]

    def __post_init__(self) -> None:
        require_kinds("Grippers", self.start, self.end)
        if self.instants < 2:
            raise InputError("Grippers", "start_position", f"{self.instants} instants", "give two or more")
        for name in POSES:
            value = real_array("Grippers", name, getattr(self, name), "give real numbers").astype(np.float64)
            self._check(name, value)
            object.__setattr__(self, name, value)
        for name in ("start", "end"):
            object.__setattr__(self, name, copy(getattr(self, name)))

    def _check(self, name: str, value: np.ndarray) -> None:
        """Raise InputError where a position or frame that is held is not finite, or a frame no rotation."""
        end = name.split("_")[0]
        kind = np.broadcast_to(np.asarray(getattr(self, end)), (len(value),))
        held = value[kind >= (Clamp.TANGENT if name.endswith("frame") else Clamp.POSITION)]
        if not np.isfinite(held).all():
            raise InputError("Grippers", name, "not finite", "give finite numbers where the end is held")
        whole = value[kind == Clamp.FRAME]
        if name.endswith("frame") and len(whole) and orthonormality_error(whole.reshape(-1, 3, 3)).max() > FRAME_TOLERANCE:
            raise InputError("Grippers", name, "no rotations", "give unit, orthogonal columns t, m1, m2")

    @property
    def count(self) -> int:
        """S, the number of rods."""
        return len(self.start_position)

    @property
    def kinds(self) -> np.ndarray:
        """(2, S) Clamp of the starts and of the ends."""
        return np.stack([np.broadcast_to(np.asarray(kind), (self.count,)) for kind in (self.start, self.end)])

    @property
    def instants(self) -> int:
        """T, the number of instants."""
        return self.start_position.shape[1]

    @classmethod
    @typed
    def resting(cls, clamps: Clamps, instants: int) -> "Grippers":
        """Clamps that do not move, at two instants or more."""
        require_whole("Grippers.resting", "instants", instants, 2)
        def still(array):
            array = np.asarray(array, dtype=np.float64)
            return np.broadcast_to(array[:, None], (len(array), instants, *array.shape[1:]))
        return cls(clamps.start, clamps.end, *(still(getattr(clamps, name)) for name in POSES))

    def take(self, rows: Rows) -> "Grippers":
        """The grippers of the rods named by ``rows``."""
        held = [kind if np.ndim(kind) == 0 else np.asarray(kind)[rows] for kind in (self.start, self.end)]
        return Grippers(*held, *(getattr(self, name)[rows] for name in POSES))

    @typed
    def at(self, instant: int) -> Clamps:
        """The clamps at one instant."""
        return Clamps(self.start, self.end, *(np.ascontiguousarray(getattr(self, name)[:, instant]) for name in POSES))

    @typed
    def until(self, instant: int) -> "Grippers":
        """The motion up to ``instant``, which is the last."""
        return Grippers(self.start, self.end, *(getattr(self, name)[:, : instant + 1] for name in POSES))

    @typed
    def refined(self, parts: int) -> "Grippers":
        """With ``parts`` equal steps between neighbouring instants: positions and frames on cubics through their neighbours."""
        if parts == 1:
            return self
        share = np.arange(parts) / parts
        return Grippers(self.start, self.end, cubic(self.start_position, share), cubic(self.end_position, share),
                        turning(self.start_frame, share), turning(self.end_frame, share))


def cubic(points: np.ndarray, share: np.ndarray) -> np.ndarray:
    """(S, (T − 1) parts + 1, n) Catmull–Rom cubics through (S, T, n) points."""
    outer = np.concatenate([2 * points[:, :1] - points[:, 1:2], points, 2 * points[:, -1:] - points[:, -2:-1]], axis=1)
    before, here, there, after = (outer[:, k : k + points.shape[1] - 1, None] for k in range(4))
    u = share[:, None]
    curve = here + 0.5 * u * (there - before + u * (2 * before - 5 * here + 4 * there - after
                                                    + u * (3 * (here - there) + after - before)))
    return np.concatenate([curve.reshape(len(points), -1, points.shape[2]), points[:, -1:]], axis=1)


def turning(frames: np.ndarray, share: np.ndarray) -> np.ndarray:
    """(S, (T − 1) parts + 1, 3, 3) frames between (S, T, 3, 3): cubics through their quaternions, the shorter way from each to
    the next, normalised. A speed of turning that jumps would be a blow to the rod at every instant, however small the steps."""
    q = quaternion_from_matrix(frames)
    signs = np.cumprod(np.where((q[:, 1:] * q[:, :-1]).sum(axis=-1) < 0, -1.0, 1.0), axis=1)
    q[:, 1:] *= signs[..., None]
    between = cubic(q, share)
    return matrix_from_quaternion(between / np.linalg.norm(between, axis=-1, keepdims=True))
