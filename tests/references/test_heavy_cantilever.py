"""A cantilever under its own weight, from stiff to limp, and the column that buckles under it.

Slope θ(s) from the horizontal, free at s = L, w = 2μ:  EI θ'' = w (L − s) cos θ,  θ(0) = given,  θ'(L) = 0.
A standing column buckles first at wL³/EI = 7.837, the cube of the first zero of J_{−1/3} in its own variable
(Greenhill 1881): stable below, a saddle above.

The planar elastica between clamps and between hinges, buckled by a span shorter than its length (Euler 1744): with
k = sin(α/2), α the slope at the inflections, and K, E complete elliptic integrals of modulus k, a hinged elastica
of length ℓ has  ℓ√(P/EI) = 2K,  span/ℓ = 2E/K − 1,  height 2k/√(P/EI),  and a clamped one of length L is four quarters:
the same span/L, L√(P/EI) = 4K, height 4k/√(P/EI). As k → 0 the loads are Euler's, π²EI/ℓ² and 4π²EI/L².
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_bvp
from scipy.optimize import brentq
from scipy.special import ellipe, ellipk, jv

from doo_ti import Clamp, Configuration, Material, Newton, relax
from tests.references.rods import certified, chain, clamps_at, orders, planar, stacked

ALPHA, BETA, LENGTH = 6e5, 4e5, 100.0
UNIT = ALPHA / LENGTH**3 / 2  # the weight μ with which wL³/EI is 1


def drooping(ratio: float):
    """(θ, θ', x, z) of the continuum rod at s in [0, 1], lengths in L, for a horizontal clamp; loaded in steps."""
    s = np.linspace(0, 1, 200) ** 2  # finer at the clamp, where a limp rod bends
    state = np.stack([0 * s, 0 * s, s, 0 * s])
    for load in np.geomspace(0.1, ratio, 8):
        answer = solve_bvp(
            lambda s, y, load=load: np.array([y[1], load * (1 - s) * np.cos(y[0]), np.cos(y[0]), np.sin(y[0])]),
            lambda left, right: np.array([left[0], right[1], left[2], left[3]]),
            s, state, tol=1e-9, max_nodes=20_000)
        assert answer.success
        state = answer.sol(s)
    return answer.sol


@pytest.mark.parametrize("ratio", [0.1, 1.0, 10.0, 100.0])
def test_drooping_cantilever_converges_to_the_elastica(ratio):
    curve, edges, errors = drooping(ratio), [21, 41, 81], []
    for count in edges:
        length = LENGTH / (count - 0.5)
        rod = chain(np.tile([1.0, 0.0, 0.0], (count, 1)), [0, 1, 0], length, start=(-length / 2, 0, 0))
        material, clamps = Material(ALPHA, BETA, ratio * UNIT), clamps_at(rod, Clamp.FRAME, Clamp.FREE)
        solution = certified(relax(rod, material, clamps, Newton(tolerance=1e-10)))
        x, z = curve((np.arange(1, count + 1) - 0.5) / (count - 0.5))[2:]
        away = solution.configuration.vertices[0, 1:] / LENGTH - np.stack([x, 0 * x, z], axis=1)
        errors.append(np.linalg.norm(away, axis=1).max() / np.abs(z).max())
    assert (orders(edges, errors) > 1.8).all() and errors[-1] < 2e-3


def test_certificate_flips_at_greenhills_column():
    threshold = (1.5 * brentq(lambda x: jv(-1 / 3, x), 1.5, 2.2)) ** 2
    assert threshold == pytest.approx(7.8373, abs=1e-4)
    edges, errors = [10, 20, 40], []
    for count in edges:
        rod = chain(np.tile([0.0, 0.0, 1.0], (count, 1)), [1, 0, 0], LENGTH / (count - 0.5))
        low, high = 0.8 * threshold, 1.2 * threshold
        for _ in range(3):
            ratios = np.linspace(low, high, 21)
            columns, material = stacked([rod] * len(ratios)), Material(ALPHA, BETA, ratios * UNIT)
            solution = relax(columns, material, clamps_at(columns, Clamp.FRAME, Clamp.FREE), Newton(max_escapes=0))
            assert solution.converged.all()
            np.testing.assert_allclose(solution.configuration.vertices, columns.vertices, atol=1e-9)
            flip = np.flatnonzero(solution.stable)[-1]
            assert solution.stable[: flip + 1].all() and flip < 20
            low, high = ratios[flip], ratios[flip + 1]
        errors.append(abs(0.5 * (low + high) / threshold - 1))
    assert (orders(edges, errors) > 1.8).all() and errors[-1] < 2e-3


# A trace of weight makes the buckled rod hang: between clamps on one line it could turn about that line freely.
MATERIAL = Material(ALPHA, BETA, 1e-6 * ALPHA / LENGTH**3)


def elastica(span_over_length: float, quarters: int) -> tuple[float, float, float]:
    """Load P L²/EI, height/L and energy E L/EI of ``quarters`` quarter waves: 4 between clamps, 2 between hinges."""
    m = brentq(lambda m: 2 * ellipe(m) / ellipk(m) - 1 - span_over_length, 1e-12, 0.9)
    root = quarters * ellipk(m)
    # κ = 2k√(P/EI) cn, and cn² integrates to (E − (1 − m)K)/m over a quarter.
    return root**2, quarters * np.sqrt(m) / root, 2 * root * quarters * (ellipe(m) - (1 - m) * ellipk(m))


def bowed(kind: Clamp, joints: int, span_over_length: float) -> Configuration:
    """One wave between the middles of clamped edges, or half a wave between hinges; the free length is LENGTH."""
    length = LENGTH / joints
    if kind == Clamp.POSITION:
        return planar(np.cos(np.pi * (np.arange(joints) + 0.5) / joints), length, span_over_length * LENGTH)
    return planar(np.sin(2 * np.pi * np.arange(joints + 1) / joints), length, span_over_length * LENGTH + length)


def relaxed_at(rod: Configuration, kind: Clamp):
    """Height, energy, and load: minus the slope of the energy in the span, from two more copies."""
    step = 1e-4 * LENGTH
    held = clamps_at(rod, kind, kind).take([0, 0, 0])
    ends = held.end_position + step * np.array([[0, 0, 0], [1, 0, 0], [-1, 0, 0]])
    solution = relax(rod.take([0, 0, 0]), MATERIAL, replace(held, end_position=ends))
    assert solution.converged.all()
    vertices = solution.configuration.vertices[0]
    assert np.abs(vertices[:, 1]).max() < 1e-4 * LENGTH
    load = (solution.energy[2] - solution.energy[1]) / (2 * step)
    return np.ptp(vertices[:, 2]), solution.energy[0], load


@pytest.mark.parametrize("span_over_length", [0.95, 0.6])
@pytest.mark.parametrize("kind", [Clamp.FRAME, Clamp.POSITION], ids=["clamped", "hinged"])
def test_buckled_elastica_converges_to_the_elliptic_integrals(kind, span_over_length):
    joints, errors = [16, 32, 64], []
    load, height, energy = elastica(span_over_length, 4 if kind == Clamp.FRAME else 2)
    for count in joints:
        found = np.array(relaxed_at(bowed(kind, count, span_over_length), kind))
        errors.append(np.abs(found / (LENGTH * height, ALPHA / LENGTH * energy, ALPHA / LENGTH**2 * load) - 1))
    for off in np.transpose(errors):
        assert (orders(joints, off) > 1.8).all() and off[-1] < 5e-3
