"""Frames and curves on the host, in NumPy: unit quaternions, rotations, a rod as a chain of them (§III-A), curves of points.

Quaternions are (..., 4) with the scalar first; the columns of a rotation matrix are t, m1, m2.
"""

import numpy as np
from numpy.typing import ArrayLike

from doo_ti.rod.material import LARGEST
from doo_ti.system.errors import InputError, real_array

FRAME_TOLERANCE = 1e-3  # largest allowed `orthonormality_error` of an input frame
HALF_TURN = np.radians(179.0)


def matrix_from_quaternion(quaternion: np.ndarray) -> np.ndarray:
    """(..., 4) unit quaternions to (..., 3, 3) rotation matrices."""
    q = np.asarray(quaternion, dtype=np.float64)
    w, x, y, z = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    matrix = np.empty((*w.shape, 3, 3))
    matrix[..., 0, 0], matrix[..., 1, 1], matrix[..., 2, 2] = (
        1 - 2 * (y * y + z * z), 1 - 2 * (x * x + z * z), 1 - 2 * (x * x + y * y))
    matrix[..., 1, 0], matrix[..., 0, 1] = 2 * (x * y + w * z), 2 * (x * y - w * z)
    matrix[..., 2, 0], matrix[..., 0, 2] = 2 * (x * z - w * y), 2 * (x * z + w * y)
    matrix[..., 2, 1], matrix[..., 1, 2] = 2 * (y * z + w * x), 2 * (y * z - w * x)
    return matrix


def tangent_from_quaternion(quaternion: np.ndarray) -> np.ndarray:
    """(..., 4) unit quaternions to (..., 3) tangents, the first columns of their rotations."""
    q = np.asarray(quaternion, dtype=np.float64)
    w, x, y, z = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    return np.stack([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)], axis=-1)


def quaternion_from_matrix(matrix: np.ndarray) -> np.ndarray:
    """(..., 3, 3) rotation matrices to (..., 4) unit quaternions, the largest component positive, or the scalar one where it
    exceeds a half."""
    m = np.asarray(matrix, dtype=np.float64)
    trace = m[..., 0, 0] + m[..., 1, 1] + m[..., 2, 2]
    # Each row of 4 q qᵀ is q up to length. The first serves unless the scalar component is small, the largest always.
    row = np.stack([1 + trace, m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]], axis=-1)
    small = ~(trace > 0)
    if small.any():
        row[small] = _largest_row(m[small])
    return row / np.linalg.norm(row, axis=-1, keepdims=True)


def _largest_row(m: np.ndarray) -> np.ndarray:
    """(N, 4) the row of 4 q qᵀ with the largest diagonal entry, without cancellation."""
    xx, yy, zz = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    outer = np.empty((len(m), 4, 4))
    outer[:, 0, 0], outer[:, 1, 1] = 1 + xx + yy + zz, 1 + xx - yy - zz
    outer[:, 2, 2], outer[:, 3, 3] = 1 - xx + yy - zz, 1 - xx - yy + zz
    off = {(0, 1): m[..., 2, 1] - m[..., 1, 2], (0, 2): m[..., 0, 2] - m[..., 2, 0], (0, 3): m[..., 1, 0] - m[..., 0, 1],
           (1, 2): m[..., 0, 1] + m[..., 1, 0], (1, 3): m[..., 0, 2] + m[..., 2, 0], (2, 3): m[..., 1, 2] + m[..., 2, 1]}
    for (i, j), value in off.items():
        outer[:, i, j] = outer[:, j, i] = value
    best = np.argmax(np.diagonal(outer, axis1=-2, axis2=-1), axis=-1)
    return outer[np.arange(len(m)), best]


def orthonormality_error(frames: np.ndarray) -> np.ndarray:
    """(...) how far (..., 3, 3) frames are from orthonormal columns: the largest entry of |FᵀF − I|."""
    # Columns and components first: sums over a last axis of few take NumPy several times as long.
    columns = np.ascontiguousarray(np.moveaxis(frames, (-2, -1), (0, 1)))
    lengths = np.sum(columns * columns, axis=0) - 1.0
    angles = np.sum(columns * columns[:, [1, 2, 0]], axis=0)
    return np.maximum(np.abs(lengths), np.abs(angles)).max(axis=0)


def is_rotation(frames: np.ndarray) -> np.ndarray:
    """(...) bool: whether (..., 3, 3) frames are orthonormal, within FRAME_TOLERANCE, and right-handed."""
    return (orthonormality_error(frames) <= FRAME_TOLERANCE) & (np.linalg.det(frames) > 0)


def is_half_turn(before: np.ndarray, after: np.ndarray, whole: np.ndarray | bool) -> np.ndarray:
    """(...) bool: whether frames (..., 3, 3) turn by HALF_TURN or more, so that they may have turned in either sense; where not
    ``whole`` (...), their tangents."""
    along = np.sum(before[..., 0] * after[..., 0], axis=-1)
    turned = 0.5 * (np.sum(before * after, axis=(-2, -1)) - 1)  # the trace of a rotation is 1 + 2 cos of its angle
    return np.where(whole, turned, along) < np.cos(HALF_TURN)


def quaternion_product(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Hamilton product of (..., 4) quaternions."""
    a, b = np.asarray(left), np.asarray(right)
    a0, a1, a2, a3 = (a[..., k] for k in range(4))
    b0, b1, b2, b3 = (b[..., k] for k in range(4))
    return np.stack([a0 * b0 - (a1 * b1 + a2 * b2 + a3 * b3), a0 * b1 + b0 * a1 + (a2 * b3 - a3 * b2),
                     a0 * b2 + b0 * a2 + (a3 * b1 - a1 * b3), a0 * b3 + b0 * a3 + (a1 * b2 - a2 * b1)], axis=-1)


def of_like_signs(quaternions: np.ndarray) -> np.ndarray:
    """(..., T, 4) the same rotations, each with the sign that is the nearer one to the rotation before it."""
    turned = np.sum(quaternions[..., 1:, :] * quaternions[..., :-1, :], axis=-1) < 0
    signs = np.cumprod(np.where(turned, -1.0, 1.0), axis=-1)
    return np.concatenate([quaternions[..., :1, :], signs[..., None] * quaternions[..., 1:, :]], axis=-2)


def conjugate(quaternion: np.ndarray) -> np.ndarray:
    """(..., 4) the inverse rotations of unit quaternions."""
    return quaternion * np.array([1.0, -1.0, -1.0, -1.0])


def quaternion_about(axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Rotation by ``angle`` (rad) about the unit ``axis`` (..., 3)."""
    half = 0.5 * np.asarray(angle)[..., None]
    return np.concatenate([np.cos(half) * np.ones_like(axis[..., :1]), np.sin(half) * axis], axis=-1)


def smallest_rotation(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Quaternion of the parallel transport P with P(source) = target, about source × target (§III-C).

    Unit vectors (..., 3). Opposite vectors have no unique one: then a half turn about some perpendicular axis.
    """
    source, target = np.broadcast_arrays(np.asarray(source, float), np.asarray(target, float))
    scalar = 1 + np.sum(source * target, axis=-1, keepdims=True)
    vector = np.cross(source, target)
    opposite = scalar[..., 0] < 1e-14
    if opposite.any():
        helper = np.where(np.abs(source[..., :1]) < 0.9, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
        scalar = np.where(opposite[..., None], 0.0, scalar)
        vector = np.where(opposite[..., None], np.cross(source, helper), vector)
    quaternion = np.concatenate([scalar, vector], axis=-1)
    return quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True)


def unit_direction(source: str, name: str, vector: ArrayLike) -> np.ndarray:
    """(3,) the unit vector along ``vector``, the argument or key ``name`` of ``source``. Raises InputError where it is not a
    direction."""
    direction = real_array(source, name, vector, "give a direction of three numbers").astype(np.float64)
    usable = direction.shape == (3,) and all(abs(number) <= LARGEST for number in direction.tolist())
    if not usable or not (length := np.linalg.norm(direction)) > 0:
        raise InputError(source, name, f"no direction in {direction.tolist()}", "give three finite numbers, not all zero")
    return direction / length


def unit_vectors(vectors: np.ndarray) -> np.ndarray:
    """(…, n) vectors of length one along ``vectors``; zero where these are."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-300)


def across(tangent: np.ndarray) -> np.ndarray:
    """(..., 3) unit vectors across unit tangents: the coordinate axis least along each, made orthogonal."""
    axis = np.eye(3)[np.argmin(np.abs(tangent), axis=-1)]
    perpendicular = axis - np.sum(axis * tangent, axis=-1, keepdims=True) * tangent
    return perpendicular / np.linalg.norm(perpendicular, axis=-1, keepdims=True)


def some_frames(tangent: np.ndarray) -> np.ndarray:
    """(..., 3, 3) frames with unit tangents (..., 3) and any m1 across them."""
    return bishop_frames(tangent[..., None, :], across(tangent))[..., 0, :, :]


def vertices_from_quaternions(start: np.ndarray, quaternions: np.ndarray, rest_length: np.ndarray) -> np.ndarray:
    """x_{i+1} = x_i + l_i t_i: (R, V, 3) vertices of the chain."""
    tangents = tangent_from_quaternion(quaternions)
    count, edges = tangents.shape[:2]
    result = np.empty((count, edges + 1, 3))
    result[:, 0] = start
    result[:, 1:] = np.asarray(rest_length)[..., None] * tangents
    return np.cumsum(result, axis=1, out=result)


def bishop_frames(tangents: np.ndarray, first: np.ndarray) -> np.ndarray:
    """Bishop frames of §III-C: ``first`` (..., 3) is u⁰ ⟂ t⁰; returns (..., E, 3, 3), columns t, u, v.

    u^j = P u^{j−1}, P the smallest rotation from t^{j−1} to t^j (parallel transport), and v = t × u. Material frames are turned
    against these by θ: m1 = cos θ u + sin θ v, m2 = −sin θ u + cos θ v.
    """
    tangents = np.asarray(tangents, dtype=np.float64)
    frames = np.empty((*tangents.shape, 3))
    u = first / np.linalg.norm(first, axis=-1, keepdims=True)
    for j in range(tangents.shape[-2]):
        t = tangents[..., j, :]
        if j:
            u = np.einsum("...ij,...j->...i", matrix_from_quaternion(smallest_rotation(tangents[..., j - 1, :], t)), u)
        u = u - np.sum(u * t, axis=-1, keepdims=True) * t
        u = u / np.linalg.norm(u, axis=-1, keepdims=True)
        frames[..., j, :, 0], frames[..., j, :, 1], frames[..., j, :, 2] = t, u, np.cross(t, u)
    return frames


def edge_frames(edges: np.ndarray, first: np.ndarray) -> np.ndarray:
    """(S, T, 3, 3) frames of an edge at T instants (S, T, 3), parallel-transported from each to the next, as a Bishop frame is
    along a rod: the edge does not turn about itself.

    first  (S, 3) m1 of the first instant, made orthogonal

    Raises InputError for an edge without length.
    """
    length = np.linalg.norm(edges, axis=-1, keepdims=True)
    if not (length > 0).all():
        raise InputError("edge_frames", "edges", "an edge without length", "give two distinct points of each gripper")
    return bishop_frames(edges / length, first)


def angle_about(tangent: np.ndarray, source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Angle in (−π, π] that turns ``source`` into ``target`` about ``tangent``, all unit (..., 3), rad."""
    sine = np.sum(np.cross(source, target) * tangent, axis=-1)
    return np.arctan2(sine, np.sum(source * target, axis=-1))


def transported(frame: np.ndarray, tangent: np.ndarray) -> np.ndarray:
    """(..., 3, 3) frames turned by the smallest rotation to the unit ``tangent`` (..., 3)."""
    return matrix_from_quaternion(smallest_rotation(frame[..., 0], tangent)) @ frame


def turn_about_tangent(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Angle (...) in (−π, π] between frames ``before``, transported, and ``after`` (..., 3, 3), rad."""
    return angle_about(after[..., 0], transported(before, after[..., 0])[..., 1], after[..., 1])


def quaternion_of_turn(turn: np.ndarray) -> np.ndarray:
    """(..., 4) rotations by the length of ``turn`` (..., 3), rad, about its direction."""
    angle = np.linalg.norm(turn, axis=-1)
    return quaternion_about(turn / np.where(angle > 0, angle, 1.0)[..., None], angle)


def rotation_vector(quaternion: np.ndarray) -> np.ndarray:
    """(..., 3) rad, of unit quaternions (..., 4), at most half a turn."""
    q = np.where(quaternion[..., :1] < 0, -quaternion, quaternion)
    sine = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    return 2 * np.arctan2(sine, q[..., :1]) * q[..., 1:] / np.maximum(sine, 1e-300)


def turn_between(frame: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """(..., 3) rad, the shortest rotation vector in the world from frames to goals (..., 3, 3)."""
    return rotation_vector(quaternion_product(quaternion_from_matrix(goal), conjugate(quaternion_from_matrix(frame))))


def rotation_matrix(turn: np.ndarray) -> np.ndarray:
    """(..., 3, 3) the same as :func:`quaternion_of_turn`."""
    return matrix_from_quaternion(quaternion_of_turn(turn))


def cross_matrix(vector: np.ndarray) -> np.ndarray:
    """(..., 3, 3) matrix of u → ``vector`` × u."""
    return np.swapaxes(np.cross(vector[..., None, :], np.eye(3)), -1, -2)


def right_jacobian(turn: np.ndarray) -> np.ndarray:
    """(..., 3, 3) J of Exp(turn + d) = Exp(turn) Exp(J d) to first order, of rotation vectors (..., 3)."""
    angle, cross = np.linalg.norm(turn, axis=-1)[..., None, None], cross_matrix(turn)
    small = angle < 1e-4
    safe = np.where(small, 1.0, angle)
    first = np.where(small, 0.5 - angle**2 / 24, (1 - np.cos(safe)) / safe**2)
    second = np.where(small, 1 / 6 - angle**2 / 120, (safe - np.sin(safe)) / safe**3)
    return np.eye(3) - first * cross + second * cross @ cross


def turned_about_tangent(frame: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """(..., 3, 3) frames turned about their tangents by angles (...), rad."""
    turn = quaternion_about(frame[..., 0], angle)
    return matrix_from_quaternion(quaternion_product(turn, quaternion_from_matrix(frame)))


def total_twist(quaternions: np.ndarray) -> np.ndarray:
    """(...) Σ m_i in rad of chains of frames (..., E, 4): of each from the one before, transported, at most half a turn."""
    before, after = quaternions[..., :-1, :], quaternions[..., 1:, :]
    scalar = np.sum(before * after, axis=-1)
    (a, b, c, d), (w, x, y, z) = np.moveaxis(before, -1, 0), np.moveaxis(after, -1, 0)
    along = a * x - b * w - c * z + d * y
    return np.sum(2 * np.arctan2(np.where(scalar < 0, -along, along), np.abs(scalar)), axis=-1)


def tilt_axes(up: np.ndarray) -> np.ndarray:
    """(2, 3) unit axes across ``up`` about which it is tilted: x and y of the world, turned as z must turn to ``up``."""
    return matrix_from_quaternion(smallest_rotation(np.array([0.0, 0.0, 1.0]), up))[:, :2].T


def tilts_between(origin: np.ndarray, up: np.ndarray) -> np.ndarray:
    """(2,) the tilts of ``up`` that lead from ``origin`` to ``up``."""
    return tilt_axes(origin) @ rotation_vector(smallest_rotation(origin, up))


# --- curves of points, in an image or in space --------------------------------------------------------------------------

def arc_lengths(points: np.ndarray) -> np.ndarray:
    """(N,) length of the curve from the first of ``points`` (N, d) to each."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def curve_length(points: np.ndarray) -> float:
    """Length of the curve through ``points`` (N, d)."""
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def placed(place: np.ndarray, arc: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(..., d) points at lengths ``place`` (...) along a curve whose ``points`` (N, d) are at the lengths ``arc`` (N,)."""
    return np.stack([np.interp(place, arc, column) for column in points.T], axis=-1)


def normal_to(direction: np.ndarray) -> np.ndarray:
    """(..., 2) vectors across ``direction`` (..., 2), as long as these."""
    return np.stack([-direction[..., 1], direction[..., 0]], axis=-1)
