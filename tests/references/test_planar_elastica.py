"""The planar elastica between clamps and between hinges, buckled by a span shorter than its length (Euler 1744).

With k = sin(α/2), α the slope at the inflections, and K, E complete elliptic integrals of modulus k, a hinged elastica
of length ℓ has  ℓ√(P/EI) = 2K,  span/ℓ = 2E/K − 1,  height 2k/√(P/EI),  and a clamped one of length L is four quarters:
the same span/L, L√(P/EI) = 4K, height 4k/√(P/EI). As k → 0 the loads are Euler's, π²EI/ℓ² and 4π²EI/L².
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import ellipe, ellipk

from doo_ti import Clamp, Configuration, Material, relax
from tests.references.rods import clamps_at, orders, planar

ALPHA, BETA, LENGTH = 6e5, 4e5, 100.0
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
