"""Closed-form derivatives of bending and twist, on packs of lanes as the kernels run them, against hyper-dual numbers.

Hard places: twist next to ±π, joints of 1.5 to 3 rad, off-diagonals of B that differ on the two edges, rest curvature.
"""

from functools import cache

import numpy as np
import pytest
import taichi as ti
from scipy.spatial.transform import Rotation

from doo_ti.physics import pair
from doo_ti.physics.number import Number
from doo_ti.physics.quaternion import twist_angle_function
from tests.oracle.algebra import spun_and_tilted
from tests.oracle.pair import pair_energy, pair_gradient_hessian
from tests.physics.columns import ROWS, columns_kernel, every_number
from tests.relaxation.rods import definite

SYMMETRIC = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])


@cache
def pair_kernel(number: Number, isotropic: bool):
    """Rows of (p, q, stiffness) to rows of (energy, 6 gradient entries, 6 + 6 + 9 Hessian entries)."""
    twist_angle = twist_angle_function(number)

    @ti.func
    def function(v: ti.template()):
        x, y, inverse, turn, relative = pair.curvature((v[0], v[1], v[2], v[3]), (v[4], v[5], v[6], v[7]))
        m = twist_angle(relative)
        if ti.static(isotropic):
            s = (v[8], v[9])
            left, right = pair.isotropic_gradient(x, y, inverse, m, s)
            h_left, h_right, h_across = pair.isotropic_hessian(x, y, inverse, turn, m, s)
            return (pair.isotropic_energy(x, m, s),) + left + right + h_left + h_right + h_across
        else:
            s = ((v[8], v[9], v[10]), (v[11], v[12], v[13]), v[14], v[15], (v[16], v[17]), (v[16], v[17]), 0.0)
            left, right = pair.general_gradient(x, y, inverse, turn, m, s)
            h_left, h_right, h_across = pair.general_hessian(x, y, inverse, turn, m, s)
            return (pair.general_energy(x, y, m, s),) + left + right + h_left + h_right + h_across

    return columns_kernel(number, 10 if isotropic else 18, 28, function)


def joints(rng, where: str) -> tuple[np.ndarray, np.ndarray]:
    """(ROWS, 4) frames on both sides of joints; quaternions of either sign."""
    half_turn = rng.choice([-1, 1], ROWS) * (np.pi - 10 ** -rng.uniform(1, 6, ROWS))
    bend, twist = {
        "lab": (rng.uniform(0, 0.3, ROWS), rng.uniform(-0.3, 0.3, ROWS)),
        "1.5 to 3 rad": (rng.uniform(1.5, 3.0, ROWS), rng.uniform(-2, 2, ROWS)),
        "twist next to ±π": (rng.uniform(0, 1, ROWS), half_turn)}[where]
    azimuth = rng.uniform(-np.pi, np.pi, ROWS)
    across = np.stack([0 * azimuth, np.cos(azimuth), np.sin(azimuth)], axis=1)
    first = Rotation.random(ROWS, random_state=rng)
    spin = Rotation.from_rotvec(twist[:, None] * [1.0, 0.0, 0.0])
    second = first * Rotation.from_rotvec(bend[:, None] * across) * spin
    signs = rng.choice([-1.0, 1.0], (2, ROWS, 1))
    return signs[0] * first.as_quat(scalar_first=True), signs[1] * second.as_quat(scalar_first=True)


def unpacked(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Energy (n,), gradient (n, 6) and Hessian (n, 6, 6)."""
    hessian = np.empty((len(rows), 6, 6))
    hessian[:, :3, :3], hessian[:, 3:, 3:] = rows[:, 7:13][:, SYMMETRIC], rows[:, 13:19][:, SYMMETRIC]
    hessian[:, :3, 3:] = rows[:, 19:].reshape(-1, 3, 3)
    hessian[:, 3:, :3] = np.swapaxes(hessian[:, :3, 3:], 1, 2)
    return rows[:, 0], rows[:, 1:7], hessian


def relative_error(value: np.ndarray, expected: np.ndarray) -> float:
    axes = tuple(range(1, expected.ndim))
    return float((np.abs(value - expected).max(axis=axes) / np.abs(expected).max(axis=axes)).max())


@pytest.mark.parametrize("kind", ["isotropic", "general"])
@every_number
def test_pair_on_packs_is_the_oracles(rng, kind, number):
    """To 1e-13 of the largest entry in f64; in f32 to its rounding, the frames being rounded too."""
    fill = pair_kernel(number, kind == "isotropic")
    for where in ("lab", "1.5 to 3 rad", "twist next to ±π"):
        q0, q1 = joints(rng, where)
        lengths, twist = rng.uniform(1, 5, (2, ROWS)), rng.uniform(1e4, 1e6, ROWS)
        total, alpha = lengths.sum(axis=0), rng.uniform(1e4, 1e6, ROWS)
        if kind == "isotropic":
            bend, rest = np.broadcast_to(alpha[:, None, None] * np.eye(2), (2, ROWS, 2, 2)), np.zeros((ROWS, 2))
            stiffness = np.column_stack([alpha / total, twist / total])
        else:
            bend, rest = definite(rng, 2, ROWS), 0.05 * rng.normal(size=(ROWS, 2))
            entries = [bend[side][:, a, b] for side in (0, 1) for a, b in ((0, 0), (1, 1), (0, 1))]
            stiffness = np.column_stack([*entries, 1 / total, twist / total, 0.5 * total[:, None] * rest])
        energy, gradient, hessian = unpacked(fill(np.hstack([q0, q1, stiffness])))
        arguments = (q0, q1, *lengths, *bend, twist, rest)
        expected = pair_gradient_hessian(*arguments, turned=spun_and_tilted)
        errors = [np.abs(energy / pair_energy(*arguments) - 1).max(),
                  relative_error(gradient, expected[0]), relative_error(hessian, expected[1])]
        assert max(errors) < (1e-13 if number.bits == 64 else 1e-5)
