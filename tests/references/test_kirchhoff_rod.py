"""A twisted rod between two clamps under its weight against Kirchhoff's equations: second order in edge length.

    r' = t        d_k' = u × d_k        n' = w up        M' = −t × n
    M·m2 = (B(ω − ω̄))₁,   −M·m1 = (B(ω − ω̄))₂,   M·t = β u·t,   ω = (u·m2, −u·m1)

with EI = B, GJ = β and weight per length w = 2μ. Unknowns: r, the frame as a quaternion, force n and moment M.
"""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.integrate import solve_bvp
from scipy.spatial.transform import Rotation

from doo_ti import Material, Newton, relax
from doo_ti.rod.frames import matrix_from_quaternion, quaternion_product
from tests.references.rods import certified, chain, clamps_at, orders

FREE_LENGTH = 90.0
BEND = {
    "isotropic": (4e5 * np.eye(2), [0.0, 0.0]),
    "general B, curved at rest": (np.array([[6e5, 1e5], [1e5, 2e5]]), [0.006, -0.004])}


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


def first_guess(edges: int, graded: bool):
    """A hanging bow that leaves its plane, twisted by 2 rad; FREE_LENGTH from middle to middle of the end edges."""
    along = np.arange(edges) / (edges - 1)
    lengths = 1 + (0.5 * np.sin(np.pi * along) if graded else 0 * along)
    lengths *= FREE_LENGTH / (lengths.sum() - 0.5 * (lengths[0] + lengths[-1]))
    middles = np.cumsum(lengths) - lengths / 2 - lengths[0] / 2
    s = middles / FREE_LENGTH
    tangents = np.stack([np.ones(edges), 0.8 * np.sin(2 * np.pi * s) + 0.3 * s, -1.1 * np.cos(np.pi * s)], axis=1)
    return chain(tangents, [0, 1, 0], lengths, spin=2.0 * s), middles


def clamped_like(fine, edges: int, graded: bool):
    """A coarser or finer rod whose clamped edges have the frames and, at their middles, the positions of ``fine``'s."""
    rod, middles = first_guess(edges, graded)
    clamps = clamps_at(rod)
    for position, frame, sign, length in (
        (clamps.start_position, clamps.start_frame, -1, rod.rest_length[0]),
        (clamps.end_position, clamps.end_frame, 1, rod.rest_length[-1])):
        middle, orientation = fine[sign]
        frame[0] = orientation
        position[0] = middle + sign * 0.5 * length * orientation[:, 0]
    return rod, middles, clamps


def clamped_middles(rod):
    """{−1: first, 1: last}: middle point and frame of the clamped edges."""
    middles = 0.5 * (rod.vertices[0, 1:] + rod.vertices[0, :-1])
    return {-1: (middles[0], rod.frames[0, 0]), 1: (middles[-1], rod.frames[0, -1])}


@pytest.mark.sampled(1)
@pytest.mark.parametrize("graded", [False, True], ids=["even", "graded"])
@pytest.mark.parametrize("kind", BEND)
def test_rod_converges_to_kirchhoffs_with_second_order(kind, graded):
    bend, rest = BEND[kind]
    material = Material(bend, 3e5, 1.0, None if kind == "isotropic" else np.array(rest))
    ends = clamped_middles(first_guess(97, False)[0])
    joints, errors, curve = [64, 32, 16], [], None
    for count in joints:
        rod, middles, clamps = clamped_like(ends, count + 1, graded)
        solution = certified(relax(rod, material, clamps, Newton(tolerance=1e-9)))
        vertices, quaternions = solution.configuration.vertices[0], solution.configuration.quaternions[0]
        if curve is None:  # the finest chain is where the collocation starts from, no more
            continuum = ContinuumRod(FREE_LENGTH, bend, 3e5, 1.0, np.array(rest))
            held = Rotation.from_matrix([ends[-1][1], ends[1][1]]).as_quat(scalar_first=True)
            curve = continuum.solve(
                [ends[-1][0], ends[1][0]], held, (middles, 0.5 * (vertices[1:] + vertices[:-1]), quaternions))
        along = np.cumsum(rod.rest_length)[:-1] - 0.5 * rod.rest_length[0]
        away = np.linalg.norm(vertices[1:-1] - curve(along)[:3].T, axis=1).max() / FREE_LENGTH
        frames = np.abs(np.sum(quaternions * curve(middles)[3:7].T, axis=1))
        errors.append([away, 2 * np.arccos(np.clip(frames, -1, 1)).max()])
    errors = np.array(errors)[::-1]
    for away in errors.T:
        assert (orders(joints[::-1], away) > 1.8).all()
    assert errors[-1, 0] < 1e-3
