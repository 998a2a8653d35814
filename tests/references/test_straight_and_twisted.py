"""A straight rod, twisted: its energy, and where it buckles in the writhing mode (Greenhill 1883, Michell 1889).

A rod of length L between two clamps on one line, twisted by Φ, has the moment M = GJ Φ/L. A small displacement
w = y + iz and the compression P obey EI w'''' − iM w''' + P w'' = 0 with w = w' = 0 at both clamps. With P = 0 this has
a solution first where tan(θ/2) = θ/2, θ = ML/EI = 8.987: Φ_c = 8.987 EI/GJ.

An inextensible chain exactly as long as its span cannot move at all, so the threshold shows where it has a little slack
ε: then E = βΦ²/Σl̄ + P(Φ) ε + O(ε²). Below Φ_c the rod gains by straightening (P > 0), above it by writhing (P < 0).
"""

import numpy as np
import pytest
from scipy.optimize import brentq, minimize_scalar

from doo_ti.relax import relax
from doo_ti.types import Clamp, Clamps, Configuration, Material
from tests.references.rods import chain, clamps_at, orders, show, stacked

ALPHA, BETA, SPAN = 6e5, 4e5, 100.0


@pytest.mark.parametrize("uneven", [False, True])
def test_twist_of_a_taut_rod_spreads_evenly(rng, uneven):
    lengths = rng.uniform(1.0, 5.0, 20) if uneven else np.full(20, 3.0)
    turn = 2.5
    spin = np.sort(rng.uniform(0, turn, 20))
    spin[[0, -1]] = 0.0, turn
    rod = chain(np.tile([1.0, 0.0, 0.0], (20, 1)), [0, 1, 0], lengths, spin=spin)
    solution = relax(rod, Material(ALPHA, BETA, 0.0), clamps_at(rod))
    assert solution.converged.all()
    assert solution.energy[0] == pytest.approx(BETA * turn**2 / np.sum(lengths[1:] + lengths[:-1]), rel=1e-10)
    np.testing.assert_allclose(solution.configuration.vertices, rod.vertices, atol=1e-8)


def clamped_determinant(moment: float, compression: float) -> float:
    """The 4×4 condition of a clamped rod of length 1 and EI = 1, made real by putting s = 0 at mid-span."""
    root = np.sqrt(moment**2 / 4 + compression + 0j)
    waves = np.array([moment / 2 + root, moment / 2 - root])
    rows = []
    for s in (-0.5, 0.5):
        rows.append([1, s, *np.exp(1j * waves * s)])
        rows.append([0, 1, *(1j * waves * np.exp(1j * waves * s))])
    # Waves that meet at root = 0 make the determinant vanish without a solution; dividing by root takes that out.
    return (np.linalg.det(np.array(rows)) / (root * 1j)).real


def compression_of(moment: float) -> float:
    """The least load P L²/EI at which the rod of moment ML/EI buckles: 4π² without twist, 0 at 8.987, then negative."""
    loads = np.linspace(-moment**2 / 4 + 1e-6, 4 * np.pi**2 + 1, 400)
    values = [clamped_determinant(moment, load) for load in loads]
    first = np.flatnonzero(np.sign(values[:-1]) != np.sign(values[1:]))[0] if values else 0
    return brentq(lambda load: clamped_determinant(moment, load), loads[first], loads[first + 1], xtol=1e-13)
