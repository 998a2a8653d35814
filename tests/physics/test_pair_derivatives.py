"""Closed-form gradients and Hessians of every energy term against hyper-dual numbers, in the hard places too."""

import numpy as np
import pytest
import taichi as ti
from scipy.spatial.transform import Rotation

from doo_ti import runtime
from doo_ti.physics import closure, pair, quaternion
from doo_ti.physics.angle import twist_angle_function
from doo_ti.physics.number import Number
from tests.oracle.pair import linear_gradient_hessian, pair_energy, pair_gradient_hessian

SYMMETRIC = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
NUMBER = Number(1, 64)
twist_angle = twist_angle_function(NUMBER)
table = ti.types.ndarray(dtype=ti.f64, ndim=2)


@ti.func
def put(row, out: ti.template(), at: ti.template(), values):
    for k in ti.static(range(len(values))):
        out[row, at + k] = values[k]


def derivatives_kernel(isotropic: bool):
    """Kernel that fills rows of (energy, 6 gradient, 6 + 6 + 9 Hessian entries) from rows of (p, q, stiffness)."""

    @ti.kernel
    def fill(frames: table, stiffness: table, out: table):
        for row in range(frames.shape[0]):
            p = (frames[row, 0], frames[row, 1], frames[row, 2], frames[row, 3])
            q = (frames[row, 4], frames[row, 5], frames[row, 6], frames[row, 7])
            x, y, inverse, turn, relative, root = pair.curvature(p, q)
            m = twist_angle(relative, root)
            if ti.static(isotropic):
                s = (stiffness[row, 0], stiffness[row, 1])
                out[row, 0] = pair.isotropic_energy(x, m, s)
                left, right = pair.isotropic_gradient(x, y, inverse, m, s)
                h_left, h_right, h_across = pair.isotropic_hessian(x, y, inverse, turn, m, s)
                put(row, out, 1, left + right + h_left + h_right + h_across)
            else:
                b_left = (stiffness[row, 0], stiffness[row, 1], stiffness[row, 2])
                b_right = (stiffness[row, 3], stiffness[row, 4], stiffness[row, 5])
                g = (b_left, b_right, stiffness[row, 6], stiffness[row, 7], (stiffness[row, 8], stiffness[row, 9]))
                out[row, 0] = pair.general_energy(x, y, m, g)
                left, right = pair.general_gradient(x, y, inverse, turn, m, g)
                h_left, h_right, h_across = pair.general_hessian(x, y, inverse, turn, m, g)
                put(row, out, 1, left + right + h_left + h_right + h_across)

    return fill


@ti.kernel
def fill_linear(frames: table, force: table, out: table):
    for row in range(frames.shape[0]):
        q = (frames[row, 0], frames[row, 1], frames[row, 2], frames[row, 3])
        c = (force[row, 0], force[row, 1], force[row, 2])
        m1 = quaternion.first_director(q)
        m2 = quaternion.second_director(q)
        put(row, out, 0, closure.linear_gradient(c, force[row, 3], m1, m2))
        put(row, out, 2, closure.linear_hessian(c, force[row, 3], quaternion.tangent(q), m1, m2))


def joints(rng, where: str, count: int = 40) -> tuple[np.ndarray, np.ndarray]:
    """Frames (count, 4) on both sides of joints that bend and twist as ``where`` says; quaternions of either sign."""
    bend, twist = {
        "gentle": (rng.uniform(0, 0.5, count), rng.uniform(-0.5, 0.5, count)),
        "straight": (np.zeros(count), rng.uniform(-1, 1, count)),
        "twist near pi": (rng.uniform(0, 1, count), np.pi - 10.0 ** -rng.uniform(1, 6, count)),
        "twist near -pi": (rng.uniform(0, 1, count), 10.0 ** -rng.uniform(1, 6, count) - np.pi),
        "nearly antiparallel": (np.pi - 10.0 ** -rng.uniform(0.5, 3, count), rng.uniform(-2, 2, count)),
    }[where]
    azimuth = rng.uniform(-np.pi, np.pi, count)
    across = np.stack([0 * azimuth, np.cos(azimuth), np.sin(azimuth)], axis=1)
    spin = Rotation.from_rotvec(twist[:, None] * [1.0, 0.0, 0.0])
    first = Rotation.random(count, random_state=rng)
    second = first * Rotation.from_rotvec(bend[:, None] * across) * spin
    signs = rng.choice([-1.0, 1.0], size=(2, count, 1))
    return signs[0] * first.as_quat(scalar_first=True), signs[1] * second.as_quat(scalar_first=True)


def unpacked(out: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Energy (n,), gradient (n, 6) and Hessian (n, 6, 6) from the kernel's rows."""
    hessian = np.empty((len(out), 6, 6))
    hessian[:, :3, :3], hessian[:, 3:, 3:] = out[:, 7:13][:, SYMMETRIC], out[:, 13:19][:, SYMMETRIC]
    hessian[:, :3, 3:] = out[:, 19:28].reshape(-1, 3, 3)
    hessian[:, 3:, :3] = np.swapaxes(hessian[:, :3, 3:], 1, 2)
    return out[:, 0], out[:, 1:7], hessian


@pytest.mark.parametrize("kind", ["isotropic", "general"])
@pytest.mark.parametrize("where", ["gentle", "straight", "twist near pi", "twist near -pi", "nearly antiparallel"])
def test_pair_is_the_oracles(rng, where, kind):
    runtime.start()
    q0, q1 = joints(rng, where)
    count = len(q0)
    lengths, twist = rng.uniform(1, 5, (2, count)), rng.uniform(1e4, 1e6, count)
    total = lengths.sum(axis=0)
    if kind == "isotropic":
        alpha, rest = rng.uniform(1e4, 1e6, count), np.zeros((count, 2))
        bend = np.broadcast_to(alpha[:, None, None] * np.eye(2), (2, count, 2, 2))
        stiffness = np.stack([alpha / total, twist / total], axis=1)
    else:
        root = rng.normal(size=(2, count, 2, 2)) * 500
        bend, rest = root @ np.swapaxes(root, -1, -2) + 1e4 * np.eye(2), 0.05 * rng.normal(size=(count, 2))
        entries = [bend[side][:, a, b] for side in (0, 1) for a, b in ((0, 0), (1, 1), (0, 1))]
        stiffness = np.stack([*entries, 1 / total, twist / total, *(0.5 * total * rest.T)], axis=1)
    out = np.zeros((count, 28))
    derivatives_kernel(kind == "isotropic")(np.hstack([q0, q1]), np.ascontiguousarray(stiffness), out)
    arguments = (q0, q1, *lengths, *bend, twist, rest)
    energy, gradient, hessian = unpacked(out)
    np.testing.assert_allclose(energy, pair_energy(*arguments), rtol=1e-9)
    for value, expected in zip((gradient, hessian), pair_gradient_hessian(*arguments), strict=True):
        axes = tuple(range(1, value.ndim))
        error = np.abs(value - expected).max(axis=axes) / np.abs(expected).max(axis=axes)
        print(f"{where}, {kind}: largest error over the largest entry {error.max():.1e}")
        assert error.max() < (1e-10 if where == "nearly antiparallel" else 1e-12)


def test_linear_potential_is_the_oracles(rng):
    runtime.start()
    frames = Rotation.random(30, random_state=rng).as_quat(scalar_first=True)
    force = np.hstack([rng.normal(size=(30, 3)), rng.uniform(1, 5, (30, 1))])
    out = np.zeros((30, 5))
    fill_linear(frames, force, out)
    gradient, hessian = linear_gradient_hessian(force[:, :3], frames, force[:, 3])
    np.testing.assert_allclose(np.pad(out[:, :2], ((0, 0), (1, 0))), gradient, atol=1e-14)
    c1, c2, ct = out[:, 2:].T
    zero = 0 * ct
    expected = np.array([[zero, c1, c2], [c1, ct, zero], [c2, zero, ct]]).transpose(2, 0, 1)
    np.testing.assert_allclose(expected, hessian, atol=1e-14)
