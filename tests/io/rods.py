"""Small observations for the tests of the data side."""

import numpy as np

from doo_ti.rod.frames import bishop_frames, matrix_from_quaternion, quaternion_about


def wavy_vertices(rng: np.random.Generator, count: int = 3, marks: int = 9) -> np.ndarray:
    """(D, V, 3) gently curved rods of about 3 mm edges, mm."""
    tangent = np.array([1.0, 0.2, 0.1]) + 0.5 * rng.normal(0, 0.15, (count, marks - 1, 3)).cumsum(axis=1)
    tangent /= np.linalg.norm(tangent, axis=-1, keepdims=True)
    steps = rng.uniform(2.0, 4.0, marks - 1)[:, None] * tangent
    return rng.normal(0, 20, (count, 1, 3)) + np.concatenate([np.zeros((count, 1, 3)), steps.cumsum(axis=1)], axis=1)


def twisted_frames(vertices: np.ndarray, total_twist: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(D, E, 3, 3) material frames along rods whose joints together twist by ``total_twist`` (D,), rad, evenly."""
    edges = np.diff(vertices, axis=1)
    tangent = edges / np.linalg.norm(edges, axis=-1, keepdims=True)
    bishop = bishop_frames(tangent, np.cross(tangent[:, 0], rng.normal(size=(len(vertices), 3))))
    return matrix_from_quaternion(quaternion_about(tangent, total_twist[:, None] * np.linspace(0, 1, edges.shape[1]))) @ bishop


def joint_twist(quaternions: np.ndarray) -> np.ndarray:
    """(D, E−1) m_i = 2 atan2(q1, q0) of q = conj(Q_{i−1}) Q_i, written out, rad."""
    a, b = np.moveaxis(quaternions[:, :-1], -1, 0), np.moveaxis(quaternions[:, 1:], -1, 0)
    scalar = a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]
    along, sign = a[0] * b[1] - a[1] * b[0] - a[2] * b[3] + a[3] * b[2], np.where(scalar < 0, -1.0, 1.0)
    return 2 * np.arctan2(sign * along, sign * scalar)
