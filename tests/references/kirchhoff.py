"""The continuum rod: Kirchhoff's equations between two clamps, under weight, by collocation.

    r' = t        d_k' = u × d_k        n' = w up        M' = −t × n
    M·m2 = (B(ω − ω̄))₁,   −M·m1 = (B(ω − ω̄))₂,   M·t = β u·t,   ω = (u·m2, −u·m1)

with EI = B, GJ = β and weight per length w = 2μ. Unknowns: r, the frame as a quaternion, force n and moment M.
"""

from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_bvp

from doo_ti.rod.frames import matrix_from_quaternion, quaternion_product


@dataclass(frozen=True)
class ContinuumRod:
    """Length in mm; bend (2, 2), twist and weight μ as in the package; rest_curvature (2,) in 1/mm."""

    length: float
    bend: np.ndarray
    twist: float
    weight: float
    rest_curvature: np.ndarray

    def darboux(self, frame: np.ndarray, moment: np.ndarray) -> np.ndarray:
        """u (n, 3) in world axes from frames (n, 3, 3) and moments (n, 3)."""
        t, m1, m2 = np.moveaxis(frame, -1, 0)
        pair = np.stack([np.sum(moment * m2, axis=-1), -np.sum(moment * m1, axis=-1)], axis=-1)
        omega = pair @ np.linalg.inv(self.bend) + self.rest_curvature
        along = np.sum(moment * t, axis=-1) / self.twist
        return along[:, None] * t + omega[:, :1] * m2 - omega[:, 1:] * m1

    def derivative(self, s, y):
        quaternion, force, moment = y[3:7].T, y[7:10].T, y[10:13].T
        frame = matrix_from_quaternion(quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True))
        spin = np.concatenate([0 * s[:, None], self.darboux(frame, moment)], axis=1)
        tangent = frame[..., 0]
        weight = np.broadcast_to([0.0, 0.0, 2 * self.weight], force.shape)
        rows = [tangent, 0.5 * quaternion_product(spin, quaternion), weight, -np.cross(tangent, force)]
        return np.concatenate(rows, axis=1).T

    def solve(self, positions, quaternions, guess):
        """y(s) between clamps: positions (2, 3), quaternions (2, 4); ``guess``: (s, r, quaternion) along the rod."""
        def ends(left, right):
            turn = quaternion_product(quaternions[1] * [1, -1, -1, -1], right[3:7])
            begin, end = left[:7] - np.append(positions[0], quaternions[0]), right[:3] - positions[1]
            return np.concatenate([begin, end, turn[1:]])

        s, r, frames = guess
        frames = np.array(frames)
        for j in range(1, len(frames)):  # one sign along the rod
            frames[j] *= np.sign(frames[j] @ frames[j - 1])
        frames *= np.sign(frames[0] @ quaternions[0])
        state = np.concatenate([r, frames, np.zeros((len(s), 6))], axis=1).T
        answer = solve_bvp(self.derivative, ends, s, state, tol=1e-8, max_nodes=5000)
        assert answer.success, answer.message
        return answer.sol
