"""From triangulated marks to observations (§V-A).

A ribbon has marks on both edges. Its centre line is half way between them, and m1 of an edge points across the ribbon from its
left to its right edge: the mean of the directions at both ends of the edge, made orthogonal to t; m2 = t × m1 is the normal.

Axes: C cameras, D observations, V vertices, E edges, S sides: one, or both edges of a ribbon.
"""

from dataclasses import dataclass, replace

import numpy as np

from doo_ti.io.marks import Marks
from doo_ti.rod.frames import matrix_from_quaternion, smallest_rotation
from doo_ti.rod.observations import Observations
from doo_ti.rod.start import fill_missing
from doo_ti.system.errors import InputError
from doo_ti.vision.reprojection.triangulation import Points


@dataclass(frozen=True)
class MarkedRods:
    """Observations of D rods, and how their frames came about.

    frames_filled  (D, E) bool: frames carried over from the nearest measured one, because a mark beside them has no position
    """

    observations: Observations
    frames_filled: np.ndarray


def observe(marks: Marks, points: Points, rest_length: float | None = None, up=(0.0, 0.0, 1.0), name: str = "observations",
            **labels) -> MarkedRods:
    """The rods that ``points``, the triangulated ``marks.pixels`` as (C, P, 2), are marks of.

    rest_length  mm from each mark to the next along the rod; by default each edge's median over the observations
    up           (3,) against gravity
    labels       fields of Observations: end_distance, end_rotation, total_twist (D,)

    Sigma is the root mean square over the three axes. A ribbon gets ``frames``; and ``start_frame`` and ``end_frame`` where all
    marks at both vertices of that end's edge have positions in all observations. Raises InputError for an observation with
    fewer than two vertices that have a position, and for whatever Observations refuses.
    """
    shape = marks.pixels.shape[1:4]
    position, valid = points.position.reshape(*shape, 3), points.valid.reshape(shape).all(axis=-1)
    variance = np.trace(points.covariance, axis1=-2, axis2=-1).reshape(shape) / 3
    few = np.flatnonzero(valid.sum(axis=1) < 2)
    if len(few):
        problem = f"{marks.names[few[0]]!r} has {valid[few[0]].sum()} vertices with a position"
        raise InputError(marks.source, "observation", problem, "label more of its marks in two images or more, or leave it out")
    unseen = np.flatnonzero(~(valid[:, 1:] & valid[:, :-1]).any(axis=0))
    if rest_length is None and len(unseen):
        raise InputError(marks.source, "mark", f"no observation has positions for both {unseen[0]} and {unseen[0] + 1}",
                         "label them in two images or more, or give `rest_length`")
    lengths = None if rest_length is None else np.full(shape[1] - 1, rest_length)
    observations = Observations(position.mean(axis=2), valid, lengths, up=up, sigma=np.sqrt(variance.sum(axis=-1)) / shape[2],
                                name=name, source=marks.source, labels=marks.labels, **labels)
    filled = np.zeros((shape[0], shape[1] - 1), dtype=bool)
    if marks.is_ribbon:
        frames, filled = _ribbon_frames(observations, position[:, :, 1] - position[:, :, 0], marks)
        ends = {"start_frame": frames[:, 0], "end_frame": frames[:, -1]}
        known = {"start_frame": not filled[:, 0].any(), "end_frame": not filled[:, -1].any()}
        observations = replace(observations, frames=frames, **{end: frame for end, frame in ends.items() if known[end]})
    return MarkedRods(observations, filled)


def _ribbon_frames(observations: Observations, across: np.ndarray, marks: Marks) -> tuple[np.ndarray, np.ndarray]:
    """(D, E, 3, 3) frames of ribbons with ``across`` (D, V, 3) from left to right edge, and (D, E) where they are filled."""
    edges = np.diff(fill_missing(observations), axis=1)
    tangent = edges / np.linalg.norm(edges, axis=-1, keepdims=True)
    valid = observations.valid
    unit = np.where(valid[..., None], across, 0.0)
    unit = unit / np.maximum(np.linalg.norm(unit, axis=-1, keepdims=True), np.finfo(float).tiny)
    director = unit[:, :-1] + unit[:, 1:]
    director = director - np.sum(director * tangent, axis=-1, keepdims=True) * tangent
    length = np.linalg.norm(director, axis=-1)
    # Less than a tenth is left of a width that runs along the rod, or that turns half round from one vertex to the next.
    measured = valid[:, :-1] & valid[:, 1:] & (length > 0.1)
    none = np.flatnonzero(~measured.any(axis=1))
    if len(none):
        raise InputError(marks.source, "observation", f"{marks.names[none[0]]!r} shows the ribbon's width at no two neighbours",
                         "label more of its marks, or leave it out")
    director = director / np.where(measured, length, 1.0)[..., None]
    nearest = _nearest(measured)
    source = np.take_along_axis(tangent, nearest[..., None], axis=1)
    carried = matrix_from_quaternion(smallest_rotation(source, tangent))
    director = np.einsum("deij,dej->dei", carried, np.take_along_axis(director, nearest[..., None], axis=1))
    return np.stack([tangent, director, np.cross(tangent, director)], axis=-1), ~measured


def _nearest(there: np.ndarray) -> np.ndarray:
    """(D, E) the nearest place in the same row that is ``there`` (D, E), itself if it is."""
    place = np.arange(there.shape[1])
    before = np.maximum.accumulate(np.where(there, place, -there.shape[1]), axis=1)
    after = np.minimum.accumulate(np.where(there, place, 2 * there.shape[1])[:, ::-1], axis=1)[:, ::-1]
    return np.where(place - before <= after - place, before, after)
