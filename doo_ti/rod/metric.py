"""Eq. 1: how far a configuration is from an observed one, for many rods at once.

    d = (1/E) Σ_{i=0..E} ‖v_i − v_i'‖ + w_m/(E−1) Σ_{j=0..E−1} ‖m1_j − m1_j'‖

Missing marks are left out: the first sum then runs over the valid marks and divides by their number less one.
"""

import numpy as np
import taichi as ti
from numpy.typing import ArrayLike

from doo_ti.physics.quaternion import first_director, tangent
from doo_ti.rod.observations import Observations
from doo_ti.rod.types import Configuration
from doo_ti.system import runtime
from doo_ti.system.arguments import typed
from doo_ti.system.errors import InputError


@typed
@runtime.exclusive
def distance(configuration: Configuration, observations: Observations, index: ArrayLike | None = None,
             frame_weight: float = 0.0) -> np.ndarray:
    """(R,) Eq. 1 in mm between each rod and the observation it belongs to.

    index         (R,) row of ``observations`` for each rod; by default one to one
    frame_weight  w_m in mm: 0 where frames are not measured, the width for a ribbon

    NaN for rods that have no configuration (infeasible). Raises InputError for ``frame_weight`` without measured frames,
    and for numbers of edges or rods that do not match.
    """
    index = np.arange(observations.count) if index is None else np.asarray(index)
    if index.ndim != 1:
        raise InputError(observations.source, "index", f"shape {index.shape}", "give a row for each rod, (R,)")
    if configuration.edges != observations.edges or len(index) != configuration.count:
        raise InputError(observations.source, "vertices_mm", f"{observations.edges} edges in {len(index)} observations for "
                         f"{configuration.count} rods of {configuration.edges} edges", "compare rods with their observations")
    if index.dtype.kind not in "iu" or (index.size and not 0 <= index.min() <= index.max() < observations.count):
        raise InputError(observations.source, "index", "not rows of the observations",
                         f"give whole numbers below {observations.count}")
    if not 0 <= frame_weight < np.inf:
        raise InputError("distance", "frame_weight", f"{frame_weight!r} is no length", "give zero or a positive number of mm")
    observations.require_frames(frame_weight)
    runtime.start()
    result, frames = np.empty(configuration.count), observations.frames
    directors = np.zeros((1, 1, 3)) if frames is None else np.ascontiguousarray(frames[..., 1])
    rods = (np.ascontiguousarray(array, dtype=np.float64) for array in (
        configuration.start, configuration.quaternions, np.atleast_2d(configuration.rest_length)))
    _compare(*rods, np.nan_to_num(observations.vertices), directors, observations.valid.astype(np.int32),
             np.ascontiguousarray(index, dtype=np.int32), float(frame_weight), result)
    return result


@runtime.kernel
def _compare(
    start: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [rod, 3]
    quaternions: ti.types.ndarray(dtype=ti.f64, ndim=3),  # [rod, edge, 4]
    rest_length: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [1 or rod, edge]
    vertices: ti.types.ndarray(dtype=ti.f64, ndim=3),  # [observation, vertex, 3]
    directors: ti.types.ndarray(dtype=ti.f64, ndim=3),  # [observation, edge, 3]
    valid: ti.types.ndarray(dtype=ti.i32, ndim=2),  # [observation, vertex]
    index: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [rod]
    frame_weight: ti.f64,
    result: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [rod] out
):
    for rod in range(quaternions.shape[0]):
        d = index[rod]
        lengths = ti.min(rod, rest_length.shape[0] - 1)
        edges = quaternions.shape[1]
        x = ti.Vector([start[rod, 0], start[rod, 1], start[rod, 2]], dt=ti.f64)
        position_error = ti.cast(0.0, ti.f64)
        frame_error = ti.cast(0.0, ti.f64)
        marks = 0
        for v in range(edges + 1):
            if valid[d, v] == 1:
                marks += 1
                apart = ti.cast(0.0, ti.f64)
                for k in ti.static(range(3)):
                    apart += (x[k] - vertices[d, v, k]) ** 2
                position_error += ti.sqrt(apart)
            if v < edges:
                q = (quaternions[rod, v, 0], quaternions[rod, v, 1], quaternions[rod, v, 2], quaternions[rod, v, 3])
                t = tangent(q)
                for k in ti.static(range(3)):
                    x[k] += rest_length[lengths, v] * t[k]
                if frame_weight > 0.0:
                    m1 = first_director(q)
                    apart = ti.cast(0.0, ti.f64)
                    for k in ti.static(range(3)):
                        apart += (m1[k] - directors[d, v, k]) ** 2
                    frame_error += ti.sqrt(apart)
        result[rod] = position_error / (marks - 1) + frame_weight * frame_error / (edges - 1)
