"""Observations: labelled marks on clamped rods, in memory and in files (§V-A).

A file carries keys with their units in their names (``vertices_mm``); :class:`Observations` is the same checked, in
mm and rad. Axes: D observations, V vertices, E = V − 1 edges.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from doo_ti.rod.frames import FRAME_TOLERANCE, orthonormality_error
from doo_ti.rod.material import doubt_angle
from doo_ti.rod.types import LARGEST, Rows
from doo_ti.system.arguments import counted, typed
from doo_ti.system.errors import InputError, real_array

# Field of Observations: key of the file.
KEYS = {
    "vertices": "vertices_mm", "valid": "valid", "rest_length": "rest_length_mm", "start_frame": "start_frame",
    "end_frame": "end_frame", "frames": "frames", "total_twist": "total_twist_deg", "up": "up", "sigma": "sigma_mm",
    "end_distance": "end_distance_mm", "end_rotation": "end_rotation_deg", "labels": "observation",
    "spacing_error": "spacing_error",
}
LENGTHS = ("vertices", "rest_length", "sigma", "end_distance")  # fields in mm
UNKNOWN_SPACING = 0.1  # relative error of rest lengths that were not measured, but taken from the marks
LEAST_SIGMA_MM, MOST_SIGMA_MM = 1e-9, 1e6  # of labels: the information in them grows with the inverse square


@typed
@dataclass(frozen=True)
class Observations:
    """D observed configurations Γ^d of one rod, and how its ends were held.

    vertices     (D, V, 3) mm; NaN at marks that are not valid, whatever was given there
    valid        (D, V) bool: marks that were seen; by default those without NaN
    rest_length  (E,) mm; by default the median over D of the observed edge lengths
    start_frame  (D, 3, 3) columns t, m1, m2 of the first edge, or None: tangent as observed, roll unknown
    end_frame    the same for the last edge
    frames       (D, E, 3, 3) measured material frames (ribbons), or None
    total_twist  (D,) rad, sum of the twist angles, whole turns included, or None; only used to choose the whole turn
    up           (3,) unit vector against gravity
    sigma        label uncertainty in mm: None, () or (D, V)
    end_distance, end_rotation  (D,) labels to partition by, in mm and **degrees** as written in the file, or None
    name         name of the rod, used as the label of its material
    source       where it comes from, for messages
    sha256       hex digest of the file's bytes, or ""
    spacing_error  relative standard deviation of each rest length about the rod's own; by default 0, and 0.1 where rest lengths
                 are not given
    labels       (D,) whole numbers or texts: what the file calls each observation, for messages; 0, 1, … by default

    Raises InputError, naming ``source``, the file's key, the value and the remedy, for whatever breaks these shapes,
    for values that are not finite at valid marks, rest lengths that are not positive, coinciding neighbours, and
    frames that are not orthonormal and right-handed to 1e-3.
    """

    vertices: np.ndarray
    valid: np.ndarray | None = None
    rest_length: np.ndarray | None = None
    start_frame: np.ndarray | None = None
    end_frame: np.ndarray | None = None
    frames: np.ndarray | None = None
    total_twist: np.ndarray | None = None
    up: np.ndarray = (0.0, 0.0, 1.0)
    sigma: np.ndarray | None = None
    end_distance: np.ndarray | None = None
    end_rotation: np.ndarray | None = None
    name: str = "observations"
    source: str = "observations"
    sha256: str = ""
    labels: np.ndarray | Sequence[str] | None = None
    spacing_error: float | None = None

    if TYPE_CHECKING:  # what it takes; the fields are the arrays that it makes of them
        def __init__(self, vertices: ArrayLike, valid: ArrayLike | None = None, rest_length: ArrayLike | None = None,
                     start_frame: ArrayLike | None = None, end_frame: ArrayLike | None = None, frames: ArrayLike | None = None,
                     total_twist: ArrayLike | None = None, up: ArrayLike = (0.0, 0.0, 1.0), sigma: ArrayLike | None = None,
                     end_distance: ArrayLike | None = None, end_rotation: ArrayLike | None = None, name: str = "observations",
                     source: str = "observations", sha256: str = "", labels: ArrayLike | None = None,
                     spacing_error: float | None = None) -> None: ...

    def __repr__(self) -> str:
        return f"Observations({self.name}: {counted(self.count, 'rod')} of {self.edges + 1} marks, {self.length:.4g} mm long)"

    def __post_init__(self) -> None:
        vertices = self._numbers("vertices", ("D", "V", 3))
        count, marks = vertices.shape[:2]
        if count < 1 or marks < 3:
            raise self._error("vertices", f"shape {vertices.shape} holds no rod", "give D >= 1 rods of V >= 3 marks")
        size = {"D": count, "V": marks, "E": marks - 1}
        self._set(labels=self._checked_labels(count))
        valid = self._checked_valid(vertices)
        self._set(vertices=np.where(valid[..., None], vertices, np.nan), valid=valid)
        self._check_neighbours()
        self._set(spacing_error=self._checked_spacing_error())
        self._set(rest_length=self._checked_rest_length(size), up=self._checked_up(), sigma=self._checked_sigma(size))
        for name, axes in (("start_frame", ("D", 3, 3)), ("end_frame", ("D", 3, 3)), ("frames", ("D", "E", 3, 3))):
            if getattr(self, name) is not None:
                self._set(**{name: self._checked_frames(name, axes, size)})
        for name in ("total_twist", "end_distance", "end_rotation"):
            if getattr(self, name) is not None:
                self._set(**{name: self._finite(name, self._numbers(name, ("D",), size))})
        doubt_angle("Observations", "total_twist", self.total_twist)
        if self.end_distance is not None and (self.end_distance < 0).any():
            raise self._error("end_distance", f"{self.end_distance.min():g} mm", "give zero or positive distances in mm")

    @property
    def count(self) -> int:
        """D, the number of observations."""
        return len(self.vertices)

    @property
    def edges(self) -> int:
        """E, the number of edges."""
        return self.vertices.shape[1] - 1

    @property
    def place(self) -> np.ndarray:
        """(V,) mm of rod from the first mark to each."""
        return np.concatenate([[0.0], np.cumsum(self.rest_length)])

    @property
    def length(self) -> float:
        """mm of rod between the outer marks."""
        return float(self.rest_length.sum())

    def along_arcs(self) -> "Observations":
        """The same, with the lengths of arcs through the marks where rest lengths were not given. Marks on a rod of a material
        are joined by arcs; chords, the default, are those of a discrete rod whose vertices they are."""
        if not np.array_equal(self.rest_length, _chords(self.vertices)):
            return self
        return replace(self, rest_length=self.arcs)

    @property
    def arcs(self) -> np.ndarray:
        """(E,) mm, median lengths of arcs through the marks; the rest length of an edge that no observation shows.

        A chord is shorter than its arc by a share (κh)²/24, that of two edges by four times as much; so a third of what two
        chords exceed the chord of both by is added to them. Where a neighbour is missing the chord itself counts.
        """
        marks = self.vertices
        chords = np.linalg.norm(np.diff(marks, axis=1), axis=-1)
        both = chords[:, 1:] + chords[:, :-1]
        share = (both - np.linalg.norm(marks[:, 2:] - marks[:, :-2], axis=-1)) / (3 * both)
        joints = median_of_seen(share)
        at_edges = median_of_seen(np.stack([np.append(joints, np.nan), np.append(np.nan, joints)]))  # of those at either end
        arcs = _chords(marks) * (1 + np.nan_to_num(at_edges))
        return np.where(np.isnan(arcs), self.rest_length, arcs)

    def of_marks(self, kept: slice) -> "Observations":
        """The same rods by these of their marks, joined by the rest lengths between. Raises InputError for fewer than three,
        and where a frame or twist is that of edges that are no longer there."""
        index = np.arange(self.edges + 1)[kept]
        arcs = self.place[index]
        first, last = index[[0, -1]] if len(index) else (0, self.edges)
        lost = {"start_frame": first > 0, "end_frame": last < self.edges, "frames": len(index) <= self.edges,
                "total_twist": first > 0 or last < self.edges}
        for name, gone in lost.items():
            if gone and getattr(self, name) is not None:
                raise self._error(name, "is of edges whose marks are left out", "keep these marks, or leave the frames out")
        sigma = self.sigma[:, index] if self.sigma is not None and self.sigma.ndim else self.sigma
        return replace(self, vertices=self.vertices[:, index], valid=self.valid[:, index], sigma=sigma,
                       rest_length=np.diff(arcs))

    def require_frames(self, weight: float) -> None:
        """Raise InputError where Eq. 1 is to compare frames, by a ``weight`` w_m above zero, and none were measured."""
        if weight > 0 and self.frames is None:
            raise self._error("frames", "missing, but a frame weight is given", "give `frame_weight` 0")

    def take(self, index: Rows) -> "Observations":
        """The observations named by ``index``, in that order and as often."""
        per_observation = ("vertices", "valid", "labels", "start_frame", "end_frame", "frames", "total_twist", "end_distance",
                           "end_rotation")
        taken = {name: getattr(self, name)[index] for name in per_observation if getattr(self, name) is not None}
        if self.sigma is not None and self.sigma.ndim:
            taken["sigma"] = self.sigma[index]
        return replace(self, **taken)

    def _error(self, name: str, problem: str, remedy: str) -> InputError:
        return InputError(self.source, KEYS[name], problem, remedy)

    def _set(self, **values) -> None:
        for name, value in values.items():
            if value is not None:
                value.setflags(write=False)
            object.__setattr__(self, name, value)

    def _numbers(self, name: str, axes: tuple, size: dict[str, int] | None = None) -> np.ndarray:
        """A copy of the field in f64, its shape as ``axes`` with the letters' sizes put in."""
        size, array = size or {}, real_array(self.source, KEYS[name], getattr(self, name), "store real numbers")
        wanted = [size.get(axis, axis) for axis in axes]
        if array.ndim != len(axes) or any(w != n for w, n in zip(wanted, array.shape) if not isinstance(w, str)):
            shape = f"({', '.join(map(str, axes))}{',' * (len(axes) == 1)})"
            sizes = ", ".join(f"{axis} = {size[axis]}" for axis in axes if axis in size)
            raise self._error(name, f"shape {array.shape}", f"make it {shape}{' with ' + sizes if sizes else ''}")
        return array.astype(np.float64)

    def _finite(self, name: str, array: np.ndarray, needed=True) -> np.ndarray:
        """``array``, finite wherever ``needed``, which broadcasts to it."""
        bad = np.argwhere(~(np.abs(array) <= LARGEST) & needed)
        if len(bad):
            at = bad[0].tolist()
            where = f"observation {self.labels[at[0]]}, vertex {at[1]}" if name == "vertices" else str(at)
            remedy = "give finite numbers" + ", or false in `valid` where a mark is missing" * (name == "vertices")
            raise self._error(name, f"{array[tuple(at)]} at {where}", remedy)
        return array

    def _checked_labels(self, count: int) -> np.ndarray:
        labels = np.arange(count) if self.labels is None else np.array(self.labels)
        if labels.shape != (count,) or labels.dtype.kind not in "iuU":
            raise self._error("labels", f"shape {labels.shape} of {labels.dtype}", f"make it ({count},) whole numbers or texts")
        return labels

    def _checked_valid(self, vertices: np.ndarray) -> np.ndarray:
        if self.valid is None:
            valid = ~np.isnan(vertices).any(axis=-1)
        else:
            valid = real_array(self.source, "valid", self.valid, "store booleans", "biuf")
            if not np.isin(valid, (0, 1)).all():
                raise self._error("valid", f"dtype {valid.dtype} with other values than true and false", "store booleans")
            if valid.shape != vertices.shape[:2]:
                raise self._error("valid", f"shape {valid.shape}", f"make it (D, V) = {vertices.shape[:2]}")
            valid = valid.astype(bool)
        self._finite("vertices", vertices, valid[..., None])
        few = np.flatnonzero(valid.sum(axis=1) < 2)
        if len(few):
            field = "vertices" if self.valid is None else "valid"
            raise self._error(field, f"observation {self.labels[few[0]]} has fewer than two valid marks", "leave it out")
        return valid

    def _check_neighbours(self) -> None:
        """Raise InputError where a valid mark coincides with the valid mark before it: the edge would have no direction."""
        index = np.where(self.valid, np.arange(self.valid.shape[1]), -1)
        before = np.maximum.accumulate(index, axis=1)[:, :-1]
        previous = np.take_along_axis(self.vertices, np.maximum(before, 0)[..., None], axis=1)
        apart = (self.vertices[:, 1:] != previous).any(axis=-1) | ~self.valid[:, 1:] | (before < 0)
        if not apart.all():
            d, v = np.argwhere(~apart)[0]
            raise self._error("vertices", f"vertices {before[d, v]} and {v + 1} of observation {self.labels[d]} coincide at "
                              f"{self.vertices[d, v + 1].tolist()}", "correct them, or mark one false in `valid`")

    def _checked_rest_length(self, size: dict[str, int]) -> np.ndarray:
        if self.rest_length is None:
            seen = self.valid[:, 1:] & self.valid[:, :-1]
            if not seen.any(axis=0).all():
                edge = np.flatnonzero(~seen.any(axis=0))[0]
                raise self._error("rest_length", f"missing, and no observation shows marks {edge} and {edge + 1}, from 0, "
                                  "beside each other", "number marks without gaps, or give rest_length_mm (E,)")
            return _chords(self.vertices)
        length = self._finite("rest_length", self._numbers("rest_length", ("E",), size))
        if (length <= 0).any():
            edge = int(np.argmin(length))
            raise self._error("rest_length", f"{length[edge]:g} mm at edge {edge}", "give positive lengths in mm")
        return length

    def _checked_spacing_error(self) -> np.ndarray:
        if self.spacing_error is None:
            return np.array(UNKNOWN_SPACING if self.rest_length is None else 0.0)
        error = self._finite("spacing_error", self._numbers("spacing_error", ()))
        if not 0 <= error <= 1:
            raise self._error("spacing_error", f"{error:g}", "give a share of the spacing from 0 to 1, such as 0.02")
        return error

    def _checked_up(self) -> np.ndarray:
        up = self._finite("up", self._numbers("up", (3,)))
        length = np.linalg.norm(up)
        if not length > 0:
            raise self._error("up", f"{up.tolist()} has no direction", "give the vector against gravity")
        # A unit vector stays as it is, so that copies of observations agree bit for bit.
        return up if abs(length - 1) < 1e-12 else up / length

    def _checked_sigma(self, size: dict[str, int]) -> np.ndarray | None:
        if self.sigma is None:
            return None
        scalar = real_array(self.source, KEYS["sigma"], self.sigma, "store real numbers").ndim == 0
        sigma = self._numbers("sigma", () if scalar else ("D", "V"), size)
        needed = True if scalar else self.valid
        self._finite("sigma", sigma, needed)
        wrong = needed & ((sigma < LEAST_SIGMA_MM) | (sigma > MOST_SIGMA_MM))
        if wrong.any():
            raise self._error("sigma", f"{sigma[wrong].min():g} mm",
                              f"give positive uncertainties in mm, {LEAST_SIGMA_MM:g} to {MOST_SIGMA_MM:g}")
        return sigma

    def _checked_frames(self, name: str, axes: tuple, size: dict[str, int]) -> np.ndarray:
        frames = self._finite(name, self._numbers(name, axes, size))
        for bad, problem in ((orthonormality_error(frames) > FRAME_TOLERANCE, "not orthonormal"),
                             (np.linalg.det(frames) < 0, "left-handed")):
            if bad.any():
                at = tuple(np.argwhere(bad)[0].tolist())
                raise self._error(name, f"the frame at {list(at)} is {problem}: {np.round(frames[at], 4).tolist()}",
                                  "give unit, orthogonal columns t, m1, m2 with m2 = t x m1")
        return frames


def _chords(vertices: np.ndarray) -> np.ndarray:
    """(E,) median distance of neighbouring marks, from their places (D, V, 3), NaN where unseen."""
    return median_of_seen(np.linalg.norm(np.diff(vertices, axis=1), axis=-1))


def median_of_seen(values: np.ndarray) -> np.ndarray:
    """Median over the first axis without NaN; NaN where there is nothing else."""
    some = np.isfinite(values).any(axis=0)
    return np.where(some, np.nanmedian(np.where(some, values, 0.0), axis=0), np.nan)
