"""The pairs of neighbouring edges of an isotropic rod in JAX: energy, gradient and Hessian in the two edges' rotations.

Twice, with the same arguments and results: by the formulas of docs/chain.md, and by automatic differentiation of the energy.
"""

import jax
import jax.numpy as jnp
from jax import lax

from doo_ti.physics.angle import ARCTANGENT_32, ARCTANGENT_64
from tools.bench.chain_in_jax import UPPER, Task, normalised, product

ALL = tuple(range(6))  # the rotations (a, w2, w3) of the left edge, then of the right one


def written_out(bits: int, task: Task, frames: tuple) -> tuple:
    """(energy, g_left, g_right, H_left, H_right, H_across) of each pair, all of (E−1, W), from explicit formulas."""
    x, y, inverse, (cosine, sine), m = _bent(bits, frames)
    (xr, xi), (yr, yi) = x, y
    n = 4 * task.joint * inverse
    b = 2 * task.twist * task.joint + jnp.zeros_like(m)
    t = b * m
    k, h, ht, hn = b - n / 2, 1.5 * n, t / 2, n / 2
    p, v = hn * cosine + ht * sine, hn * sine - ht * cosine
    energy = task.joint * (4 * (xr * xr + xi * xi) + task.twist * m * m)
    g_left = (-t, -n * xr - t * xi, t * xr - n * xi)
    g_right = (t, n * yr - t * yi, n * yi + t * yr)
    left = (b, ht * xr + k * xi, ht * xi - k * xr, h * xr * xr + t * xr * xi + k * xi * xi + hn,
            (h - k) * xr * xi - ht * (xr * xr - xi * xi), h * xi * xi - t * xr * xi + k * xr * xr + hn)
    right = (b, ht * yr - k * yi, ht * yi + k * yr, h * yr * yr - t * yr * yi + k * yi * yi + hn,
             (h - k) * yr * yi + ht * (yr * yr - yi * yi), h * yi * yi + t * yr * yi + k * yr * yr + hn)
    along, crosswise = xr * yr + xi * yi, xr * yi - xi * yr
    across = (-b, b * yi, -b * yr,
              -b * xi, ht * crosswise + k * xi * yi - h * xr * yr - p, v - h * xr * yi - ht * along - k * xi * yr,
              b * xr, ht * along - h * xi * yr - k * xr * yi - v, k * xr * yr - h * xi * yi + ht * crosswise - p)
    return energy, g_left, g_right, left, right, across


def by_autodiff(bits: int, task: Task, frames: tuple) -> tuple:
    """The same as :func:`written_out` from ``jax.value_and_grad`` and ``jax.hessian`` of one pair's energy, under vmap over the
    rods and over the joints, where in f64 ``lax.map`` takes these one by one.

    XLA tends to compute the energy's parts again for every entry of H. Also tried, µs a rod for g and H of all its pairs,
    f32, beside 1.3 for the formulas in the same run: the rotations as six arguments (so it is kept) 15, six jvp of the gradient
    13, the rotations as one array of six 160 to 370, that with numbers for the quaternions' parts above 1800. ``lax.map`` in
    f32: 6.8 thousand rods a second for 9.3; vmap in f64 takes twice the time of a trip.
    """
    left, right = _neighbours(frames)

    def of_one(twist, left, right, joint):
        def energy(*rotations):
            return _energy(_turned(left, rotations[:3]), _turned(right, rotations[3:]), joint, twist)

        still = (jnp.zeros_like(joint),) * len(ALL)
        return *jax.value_and_grad(energy, ALL)(*still), jax.hessian(energy, ALL)(*still)

    def of_joint(joint):
        return jax.vmap(of_one)(task.twist, *joint)

    joints = left, right, jnp.broadcast_to(task.joint, left[0].shape)
    energy, g, h = jax.vmap(of_joint)(joints) if bits == 32 else lax.map(of_joint, joints)
    diagonal = (tuple(h[first + i][first + k] for i, k in UPPER) for first in (0, 3))
    return energy, g[:3], g[3:], *diagonal, tuple(h[i][3 + k] for i in range(3) for k in range(3))


DERIVATIVES = {"explicit": written_out, "automatic": by_autodiff}


def _energy(left, right, joint, twist):
    """α(κ² + (β/α) m²)/l̄ of two frames, joint being 1/l̄ and twist β/α."""
    r0, r1, r2, r3 = _relative(left, right)
    m = 2 * jnp.arctan2(r1, r0)
    return joint * (4 * (r2 * r2 + r3 * r3) / (r0 * r0 + r1 * r1) + twist * m * m)


def _turned(frame, rotation):
    return normalised(product(frame, (jnp.ones_like(rotation[0]), *(0.5 * part for part in rotation))))


def _neighbours(frames: tuple):
    return (tuple(part[cut] for part in frames) for cut in (slice(None, -1), slice(1, None)))


def _relative(left, right):
    """conj(left) right, of its two signs the one with a real part that is not negative."""
    r = product((left[0], -left[1], -left[2], -left[3]), right)
    sign = jnp.where(r[0] < 0, -1, 1).astype(r[0].dtype)
    return tuple(sign * part for part in r)


def _bent(bits: int, frames: tuple) -> tuple:
    """(X, Y, 1/s, e^{im}, m) of neighbouring frames, complex numbers as two reals."""
    r0, r1, r2, r3 = _relative(*_neighbours(frames))
    s = r0 * r0 + r1 * r1
    inverse = 1 / s
    x = ((r0 * r2 - r1 * r3) * inverse, (r0 * r3 + r1 * r2) * inverse)
    y = ((r0 * r2 + r1 * r3) * inverse, (r0 * r3 - r1 * r2) * inverse)
    ratio = r1 / (jnp.sqrt(s) + r0)
    square, angle = ratio * ratio, jnp.zeros_like(ratio)
    for coefficient in reversed(ARCTANGENT_32 if bits == 32 else ARCTANGENT_64):
        angle = angle * square + coefficient
    return x, y, inverse, ((r0 * r0 - r1 * r1) * inverse, 2 * r0 * r1 * inverse), 4 * ratio * angle
