"""Localised helical buckling of a long twisted rod under tension: the tanh² envelope (Bergou et al. 2008).

An isotropic rod with twisting moment M, straight at infinity; φ is the angle from axis to tangent, φ₀ its largest:

    (cos φ − cos φ₀)/(1 − cos φ₀) = tanh²(s/s*),   1/s* = M/(2 EI) tan(φ₀/2),   ψ' = M/(EI (1 + cos φ)),   τ = M/GJ

with ψ the tangent's azimuth. Clamps hold both ends as this solution has them there, so a piece of any length is exact.
"""

import numpy as np
import pytest

from doo_ti import Configuration, Material, Newton, relax
from tests.references.rods import chain, clamps_at, orders, show

ALPHA, BETA, LENGTH, WAVES = 6e5, 5e5, 100.0, 8.0


def buckled_rod(edges: int, largest: float, flatter: float = 0.0) -> tuple[Configuration, np.ndarray]:
    """The closed form at the edges' middles, and tanh² there; ``flatter`` takes that part of φ away in the middle."""
    length = LENGTH / (edges - 1)
    decay = LENGTH / WAVES
    moment = 2 * ALPHA / (decay * np.tan(largest / 2))
    s = (np.arange(edges) - 0.5 * (edges - 1)) * length
    envelope = np.tanh(s / decay) ** 2
    fine = np.linspace(s[0], s[-1], 20 * (edges - 1) + 1)
    cosine = np.cos(largest) + (1 - np.cos(largest)) * np.tanh(fine / decay) ** 2
    rate = moment / (ALPHA * (1 + cosine))
    azimuth = np.concatenate([[0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(fine))])[::20]
    angle = np.arccos(cosine[::20]) * (1 - flatter * (1 - envelope))
    tangents = np.stack([np.cos(angle), np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth)], axis=1)
    return chain(tangents, [0, 0, 1], length, spin=moment / BETA * (s - s[0])), envelope


@pytest.mark.thorough
def test_reference_turns_by_twist_and_twice_the_largest_angle():
    """Known for the infinite rod: its ends turn by ML/GJ + 2φ₀ about the axis (van der Heijden and Thompson 2000)."""
    largest = 1.0
    moment = 2 * ALPHA / (LENGTH / WAVES * np.tan(largest / 2))
    rod, _ = buckled_rod(3001, largest)
    frames = rod.frames[0]
    turned = np.unwrap(np.arctan2(frames[:, 2, 1] - frames[:, 1, 2], frames[:, 1, 1] + frames[:, 2, 2]))
    assert turned[-1] - turned[0] == pytest.approx(moment * LENGTH / BETA + 2 * largest, abs=2e-3)


@pytest.mark.parametrize("largest", [0.7, 1.2])
def test_envelope_converges_to_tanh_squared(largest):
    joints, errors = [96, 192, 384], []
    for count in joints:
        exact, envelope = buckled_rod(count + 1, largest)
        start, _ = buckled_rod(count + 1, largest, flatter=0.2)
        solution = relax(start, Material(ALPHA, BETA, 0.0), clamps_at(exact), Newton(tolerance=1e-9))
        assert solution.converged.all() and solution.stable.all()
        cosine = solution.configuration.frames[0, :, 0, 0]
        errors.append(np.abs((cosine - np.cos(largest)) / (1 - np.cos(largest)) - envelope).max())
    show(f"localised buckling, largest angle {largest}: envelope", joints, errors)
    assert (orders(joints, errors) > 1.8).all() and errors[-1] < 1e-2
