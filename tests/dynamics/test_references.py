"""Motions against theory and independent integrators: falling, swinging, oscillating, whirling and coming to rest."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from doo_ti import Clamp, Dynamics, Material, MovingStart, Springs, Stepping, simulate
from tests.dynamics import motions


@pytest.mark.parametrize("scheme", ["bdf2", "euler"])
def test_free_fall(scheme):
    """Both ends free, straight, thrown without turning: the parabola, of backward Euler that of its own sum."""
    rods = motions.planar(np.full(8, 0.3), 10.0, (5.0, 6.0, 7.0))
    rate, thrown = 200.0, np.array([300.0, -200.0, 500.0])
    start = MovingStart(rods, np.broadcast_to(thrown, (1, 9, 3)))
    found = simulate(start, Material(1e5, 1e5), motions.resting(rods, Clamp.FREE, Clamp.FREE, 41), Dynamics(),
                     Stepping(rate, scheme=scheme))
    time = np.arange(1, 41)[:, None, None] / rate
    late = 0.0 if scheme == "bdf2" else 1.0 / rate
    expected = rods.vertices[0] + time * thrown - 0.5 * motions.GRAVITY * time * (time + late) * [0.0, 0.0, 1.0]
    assert found.converged.all() and np.abs(found.positions[0] - expected).max() < 1e-8


def test_tumbling_rod_turns_as_a_rigid_body():
    """A stiff rod without weight, thrown spinning about its middle across itself: angle and speed of turning, order 2."""
    rods, spin, apart = motions.planar(np.zeros(6), 10.0), 20.0, []
    middle = rods.vertices[0].mean(axis=0)
    velocity = np.cross([0.0, spin, 0.0], rods.vertices[0] - middle)[None]
    turned = Rotation.from_rotvec([0.0, spin * 0.2, 0.0]).apply(rods.vertices[0] - middle) + middle
    for substeps in (10, 20, 40):
        found = simulate(MovingStart(rods, velocity), Material(1e7, 1e7, 0.0), motions.resting(rods, Clamp.FREE, Clamp.FREE, 3),
                         Dynamics(density=1.0), Stepping(10.0, substeps))
        apart.append(np.abs(found.positions[0, -1] - turned).max())
    assert np.log2(apart[1] / apart[2]) > 1.8


def test_swinging_chain():
    """A rod that hangs from a point, soft and let go from the side, against an integrator of order eight in its angles."""
    angles, length, bend, rate = np.array([-0.3, -0.2, 0.1, 0.4]), 25.0, 5e3, 50.0
    rods, instants = motions.planar(angles, length), 14
    expected = motions.swinging_chain(angles, length, bend, np.arange(instants) / rate)[1:]
    found = []
    for substeps in (40, 80, 160):
        moved = simulate(rods, Material(bend, bend), motions.resting(rods, Clamp.POSITION, Clamp.FREE, instants), Dynamics(),
                         Stepping(rate, substeps))
        assert moved.converged.all()
        found.append(moved.positions[0])
    found.append((4.0 * found[2] - found[1]) / 3.0)
    error = np.array([np.abs(places - expected).max() / 100.0 for places in found])
    assert np.log2(error[:2] / error[1:3]).min() > 1.8 and error[3] < 1e-6


def frequency(mode, k: int, start: Clamp, steps: int) -> tuple[float, float]:
    """(rad/s measured, of theory) of mode ``k`` of a rod of 400 mm without weight, ``steps`` a period."""
    edges, length, bend, size = 40, 10.0, 1e7, 2e-5
    held = 0.5 * length if start == Clamp.FRAME else 0.0
    span = 400.0 - held
    middles = (np.arange(edges) + 0.5) * length - held
    ratio, slopes = mode(k, middles / span)
    rods = motions.planar(size * slopes * (middles > 0.0) if held else size * slopes, length)
    theory = (ratio / span) ** 2 * np.sqrt(bend / motions.MASS_PER_LENGTH)
    springs, every = None, max(1, steps // 20)
    if start == Clamp.POSITION:
        points, stiffness = np.zeros((1, edges + 1, 3)), np.zeros((1, edges + 1))
        points[0, -1], stiffness[0, -1] = [rods.vertices[0, -1, 0], 0.0, 0.0], 1e6 * bend / 400.0**3
        springs = Springs(points, stiffness)
    rate = steps / every * theory / (2 * np.pi)
    found = simulate(rods, Material(bend, bend, 0.0), motions.resting(rods, start, Clamp.FREE, 31), Dynamics(density=1.0),
                     Stepping(rate, every), springs=springs)
    assert found.converged.all()
    values = found.positions[0, :, :, 2] @ rods.vertices[0, :, 2]
    return motions.oscillation(values, 1.0 / rate), theory


@pytest.mark.parametrize("mode, start", [(motions.clamped_mode, Clamp.FRAME), (motions.pinned_mode, Clamp.POSITION)],
                         ids=["cantilever", "pinned at both ends"])
def test_natural_frequencies(mode, start):
    """The far pin is a stiff spring, so that the end may slide along the rod; the amplitude is small enough for no tension."""
    for k in range(3):
        found = [frequency(mode, k, start, steps) for steps in (60, 120, 240)]
        speeds, theory = np.array([pair[0] for pair in found]), found[0][1]
        order = np.log2((speeds[0] - speeds[1]) / (speeds[1] - speeds[2]))
        limit = (4.0 * speeds[2] - speeds[1]) / 3.0
        assert abs(limit / theory - 1) < 5e-3 and 1.8 < order < 2.2
