"""Curves from files of other programs, as their readers return them, and what a user may say about such files.

    optitrack_csv, vicon_csv    motion capture: markers at every frame
    mujoco_xml, usd             cables of simulators and editors
    polyline_text               plain numbers

Axes: D curves, or frames of one; V points.
"""

from dataclasses import dataclass

import numpy as np

from doo_ti.rod.types import LARGEST
from doo_ti.system.errors import InputError


@dataclass(frozen=True)
class Curves:
    """D curves of V points.

    points  (D, V, 3) in ``unit``; NaN where a marker was not seen
    unit    mm in one unit of length, as the file states it
    up      (3,) direction against gravity in the coordinates of the file
    rate    frames per second, where the curves are the frames of one recording, else None
    labels  (D,) whole numbers that the file gives the curves, or None
    facts   what else the file states about the rod, for the user: ``EI 0.98 N m²``
    """

    points: np.ndarray
    unit: float = 1.0
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)
    rate: float | None = None
    facts: str = ""
    labels: np.ndarray | None = None

    def keys(self) -> dict[str, np.ndarray]:
        """The keys of the npz format; frames in which fewer than two points were seen are left out."""
        seen = np.isfinite(self.points).all(axis=-1)
        kept = seen.sum(axis=1) >= 2
        keys = {"vertices_mm": self.points[kept] * self.unit, "up": np.array(self.up)}
        if self.labels is not None:
            keys["observation"] = self.labels[kept]
        return keys if seen[kept].all() else keys | {"valid": seen[kept]}


def chosen_names(path, field: str, found: list[str], wanted: list[str] | None) -> list[str]:
    """The names of markers or curves to read, in the order ``wanted``, where that is given. Raises InputError for one that the
    file does not have."""
    if wanted is None:
        return found
    missing = next((name for name in wanted if name not in found), None)
    if missing is not None:
        raise InputError(path, field, f"{missing!r} is not in the file", f"give some of {', '.join(found[:20])}")
    return wanted


def checked_points(path, points: np.ndarray) -> np.ndarray:
    """``points``, finite and within bounds. Raises InputError where they are not, or fewer than three of a curve."""
    if points.ndim != 3 or points.shape[1] < 3:
        raise InputError(path, "points", f"{points.shape[-2]} points in a curve", "give three or more")
    if not (np.abs(points) <= LARGEST).all():
        raise InputError(path, "points", "not finite", "give finite numbers")
    return points
