"""A straight rod, twisted: its energy, and where it buckles in the writhing mode (Greenhill 1883, Michell 1889).

A rod of length L between two clamps on one line, twisted by Φ, has the moment M = GJ Φ/L. A small displacement
w = y + iz and the compression P obey EI w'''' − iM w''' + P w'' = 0 with w = w' = 0 at both clamps. With P = 0 this has
a solution first where tan(θ/2) = θ/2, θ = ML/EI = 8.987: Φ_c = 8.987 EI/GJ.

An inextensible chain exactly as long as its span cannot move at all, so the threshold shows where it has a little slack
ε: then E = βΦ²/Σl̄ + P(Φ) ε + O(ε²). Below Φ_c the rod gains by straightening (P > 0), above it by writhing (P < 0).

Localised helical buckling of a long twisted rod under tension: the tanh² envelope (Bergou et al. 2008).

An isotropic rod with twisting moment M, straight at infinity; φ is the angle from axis to tangent, φ₀ its largest:

    (cos φ − cos φ₀)/(1 − cos φ₀) = tanh²(s/s*),   1/s* = M/(2 EI) tan(φ₀/2),   ψ' = M/(EI (1 + cos φ)),   τ = M/GJ

with ψ the tangent's azimuth. Clamps hold both ends as this solution has them there, so a piece of any length is exact.
"""

import numpy as np
import pytest
from scipy.optimize import brentq

from doo_ti import Clamp, Configuration, Material, Newton, PointLoads, end_clamps, relax, straight_rod
from tests.references.rods import certified, chain, clamps_at, orders, stacked

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
    """The 4×4 condition of a clamped rod with L = EI = 1: w is a sum of 1, s and e^{iρs}, ρ² − Mρ − P = 0.

    Purely imaginary with s = 0 at mid-span. Two equal ρ make it vanish without a solution: dividing by their distance
    takes that root out.
    """
    half_gap = np.sqrt(moment**2 / 4 + compression)
    waves = 1j * np.array([moment / 2 + half_gap, moment / 2 - half_gap])
    rows = [row for s in (-0.5, 0.5) for row in ([1, s, *np.exp(waves * s)], [0, 1, *(waves * np.exp(waves * s))])]
    return np.linalg.det(np.array(rows)).imag / half_gap


def least_compression(moment: float) -> float:
    """P L²/EI of the first mode at ML/EI = ``moment``: 4π² without twist, 0 at 8.987, tension (negative) beyond."""
    loads = np.linspace(1e-3 - moment**2 / 4, 4 * np.pi**2 + 1, 300)
    values = np.array([clamped_determinant(moment, load) for load in loads])
    first = np.flatnonzero(values[:-1] * values[1:] < 0)[0]
    return brentq(lambda load: clamped_determinant(moment, load), loads[first], loads[first + 1], xtol=1e-12)


THRESHOLD = 2 * brentq(lambda half: np.tan(half) - half, 4.4, 4.6)  # ML/EI of Φ_c


def slack_rod(edges: int, turn: float, slack: float) -> Configuration:
    """One wave of a cosine to one side, twisted evenly by ``turn``, so flat that it spans its length less ``slack``."""
    along = np.arange(edges) / (edges - 1)
    slope = np.sin(2 * np.pi * along)
    length = SPAN / (edges - 1)

    def missing(size):
        return np.sum(length * (1 - np.cos(np.arctan(size * slope)))) - slack

    angle = np.arctan(brentq(missing, 0, 3) * slope)
    tangents = np.stack([np.cos(angle), 0 * angle, -np.sin(angle)], axis=1)
    return chain(tangents, [0, 1, 0], length, spin=turn * along)


def measured_compression(edges: int, moments, slack_over_length: float) -> np.ndarray:
    """(E_relaxed − E_straight)/ε in units of EI/L², for several ML/EI; a trace of weight says which way to bend."""
    slack = slack_over_length * SPAN
    turns = np.asarray(moments) * ALPHA / BETA
    rods = stacked([slack_rod(edges, turn, slack) for turn in turns])
    solution = certified(relax(rods, Material(ALPHA, BETA, 1e-6 * ALPHA / SPAN**3), clamps_at(rods)))
    return (solution.energy - BETA * turns**2 / (2 * SPAN)) / slack * SPAN**2 / ALPHA


def test_reference_loads_are_the_known_ones():
    assert THRESHOLD == pytest.approx(8.986819, abs=1e-6)
    assert least_compression(0.0) == pytest.approx(4 * np.pi**2, rel=1e-9)
    assert least_compression(THRESHOLD) == pytest.approx(0.0, abs=1e-5)


def test_twisted_rod_buckles_at_the_clamped_writhing_threshold():
    """P(Φ) and its zero Φ_c, extrapolated to no slack, converge to the continuum's with second order."""
    moments = THRESHOLD * np.array([0.0, 0.5, 0.9, 0.97, 1.03, 1.1])
    expected = np.array([least_compression(moment) for moment in moments])
    joints, errors, crossings = [16, 32, 64], [], []
    for count in joints:
        measured = 2 * measured_compression(count + 1, moments, 1e-3) - measured_compression(count + 1, moments, 2e-3)
        errors.append(np.abs(measured - expected).max() / (4 * np.pi**2))
        crossings.append(abs(np.interp(0.0, -measured[3:5], moments[3:5]) / THRESHOLD - 1))
        # Just below and just above Φ_c the rod straightens and writhes; the coarsest chain is 3 % stiffer.
        assert measured[2] > 0 and (measured[5] < 0 or count == 16)
    assert (orders(joints, errors) > 1.8).all() and (orders(joints, crossings) > 1.8).all()
    assert crossings[-1] < 2e-3


TWIST, LENGTH, WAVES = 5e5, 100.0, 8.0


def buckled_rod(edges: int, largest: float, flatter: float = 0.0) -> tuple[Configuration, np.ndarray]:
    """The closed form at the edges' middles, and tanh² there; ``flatter`` takes that part of φ away in the middle."""
    length, decay = LENGTH / (edges - 1), LENGTH / WAVES
    moment = 2 * ALPHA / (decay * np.tan(largest / 2))
    s = (np.arange(edges) - 0.5 * (edges - 1)) * length
    envelope = np.tanh(s / decay) ** 2
    fine = np.linspace(s[0], s[-1], 20 * (edges - 1) + 1)
    cosine = np.cos(largest) + (1 - np.cos(largest)) * np.tanh(fine / decay) ** 2
    rate = moment / (ALPHA * (1 + cosine))
    azimuth = np.concatenate([[0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(fine))])[::20]
    angle = np.arccos(cosine[::20]) * (1 - flatter * (1 - envelope))
    tangents = np.stack([np.cos(angle), np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth)], axis=1)
    return chain(tangents, [0, 0, 1], length, spin=moment / TWIST * (s - s[0])), envelope


@pytest.mark.parametrize("largest", [0.7, 1.2])
def test_envelope_converges_to_tanh_squared(largest):
    joints, errors = [96, 192, 384], []
    for count in joints:
        exact, envelope = buckled_rod(count + 1, largest)
        start, _ = buckled_rod(count + 1, largest, flatter=0.2)
        solution = certified(relax(start, Material(ALPHA, TWIST, 0.0), clamps_at(exact), Newton(tolerance=1e-9)))
        cosine = solution.configuration.frames[0, :, 0, 0]
        errors.append(np.abs((cosine - np.cos(largest)) / (1 - np.cos(largest)) - envelope).max())
    assert (orders(joints, errors) > 1.8).all() and errors[-1] < 1e-2


@pytest.mark.sampled(1)
@pytest.mark.parametrize("aside", [1e-5, 1e-3])
def test_strips_just_beyond_their_buckling_load_converge(rng, aside):
    """Cantilevers that a force at their tip bends the stiff way, three tenths above the load at which they tip over sideways
    (Prandtl, 1899): beside that saddle the inertia is wrong for a long way."""
    count, length = 100, 300.0
    weak = 10.0 ** rng.uniform(5.0, 6.0, count)
    twist, strong = weak * rng.uniform(0.5, 1.5, count), weak * rng.uniform(50.0, 500.0, count)
    material = Material.diagonal(weak, strong, twist, weight=0.0)
    rods = straight_rod(length, 60, vertex_clamps=True)
    force = np.zeros((count, rods.edges + 1, 3))
    force[:, -1, 2] = -1.3 * 4.0126 * np.sqrt(weak * twist) / length**2
    force[:, -1, 1] = -aside * force[:, -1, 2]
    found = certified(relax(rods, material, end_clamps(rods, Clamp.FRAME, Clamp.FREE), external=PointLoads(force)))
    assert np.abs(found.configuration.vertices[..., 1]).max(axis=1).min() > 0.2 * length


STIFF, WEAK, STRONG, SOFT, REACH = 2e6, 2e6, 2e9, 1.5e6, 300.0
EULER = np.pi**2 * STIFF / (4 * REACH**2)
PRANDTL = 4.0126 * np.sqrt(WEAK * SOFT / ((1 - WEAK / STRONG) * (1 - SOFT / STRONG))) / REACH**2
STRIP = Material.diagonal(WEAK, STRONG, SOFT, weight=0.0)


@pytest.mark.parametrize("edges, material, axis, load", [
    *((edges, Material(STIFF, ratio * STIFF, weight=0.0), 0, EULER) for ratio in (1.0, 1e3) for edges in (40, 320)),
    *((edges, STRIP, 2, PRANDTL) for edges in (40, 160))])
def test_cantilevers_are_certified_up_to_the_load_at_which_they_buckle(edges, material, axis, load):
    """Columns at π²EI/4L² (Euler, 1744), however stiff they are against twisting, and strips, which tip over at 4.0126
    √(EI GJ)/L² over √((1 − EI/EI')(1 − GJ/EI')) with EI' the stiff way (Prandtl, 1899), however fine the mesh is."""
    rods = straight_rod(REACH, edges, vertex_clamps=True).take([0, 0])
    force = np.zeros((2, rods.edges + 1, 3))
    force[:, -1, axis] = np.array([-0.99, -1.01]) * load
    found = relax(rods, material, end_clamps(rods, Clamp.FRAME, Clamp.FREE), Newton(max_escapes=0), external=PointLoads(force))
    np.testing.assert_array_equal(found.stable, [True, False])
