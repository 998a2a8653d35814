"""What a step resolves: forces that act on the rod, whatever its inertia and its stiffness; else it says that it does not."""

from types import SimpleNamespace

import numpy as np
import pytest

from doo_ti import Clamp, Configuration, Dynamics, Grippers, Material, Status, Stepping, relax, simulate
from tests.dynamics.motions import GRAVITY, planar, resting
from tests.relaxation.test_stiffness_ratios import KINDS, LENGTH, RATIOS, SHAPE, SOFT, material, poses, resolved

ASIDE = np.radians(60.0)
"""Of a rod that is let go, from hanging straight down."""


def aside(length: float, edges: int, count: int = 1) -> Configuration:
    """Straight rods that are let go."""
    return planar(np.full(edges, ASIDE - np.pi / 2), length / edges).take(np.zeros(count, dtype=int))


def turned(positions: np.ndarray) -> np.ndarray:
    """(T,) by which the tip of a rod that hangs from the origin has come nearer to hanging, rad."""
    return ASIDE - np.arctan2(positions[:, -1, 0], -positions[:, -1, 2])


@pytest.mark.parametrize("ratio, rate", [(1e4, 2000.0), (1e2, 1000.0), (1e4, 100.0), (0.0, 80_000.0)])
@pytest.mark.sampled(1)
def test_payloads_and_short_steps(ratio, rate):
    """A limp cable with so many times its own mass at its end starts as a pendulum does; and any does in short steps."""
    length, edges, steps = 1500.0, 30, 40
    mass = np.zeros((1, edges + 1))
    mass[0, -1] = ratio * length
    grippers = resting(aside(length, edges), Clamp.POSITION, Clamp.FREE, steps + 1)
    dynamics = Dynamics(point_mass=mass)
    found = simulate(aside(length, edges), Material(1e5, 1e5), grippers, dynamics, Stepping(rate, scheme="bdf2"))
    assert found.converged.all()
    time = np.arange(1, steps + 1) / rate
    if ratio:
        rates = np.sqrt(GRAVITY / length)
        # θ̈ = −ω² sin θ to fourth order in time
        expected = 0.5 * np.sin(ASIDE) * (rates * time) ** 2 * (1.0 - np.cos(ASIDE) * (rates * time) ** 2 / 12.0)
        assert np.abs(turned(found.positions[0]) / expected - 1.0)[4:].max() < 0.03
    else:  # its tip falls freely, but for what the next edges hold
        assert np.abs(found.positions[0, :, -1, 2] - found.positions[0, 0, -1, 2]).max() > 0.2 * 0.5 * GRAVITY * time[-1] ** 2


@pytest.mark.parametrize("bend", [1e9, 1e13])
def test_a_stiff_rod_falls_as_a_light_pendulum(bend):
    """However small its weight is beside its stiffness: θ̈ = −(3/2) g/L sin θ."""
    length, edges, rate, steps = 300.0, 10, 1000.0, 100
    grippers = resting(aside(length, edges), Clamp.POSITION, Clamp.FREE, steps + 1)
    found = simulate(aside(length, edges), Material(bend, bend), grippers, Dynamics(), Stepping(rate))
    rates = np.sqrt(1.5 * GRAVITY / length / (1.0 + 0.5 / edges**2)) * steps / rate
    expected = 0.5 * np.sin(ASIDE) * rates**2 * (1.0 - np.cos(ASIDE) * rates**2 / 12.0)
    assert found.converged.all() and abs(turned(found.positions[0])[-1] / expected - 1.0) < 0.01


@pytest.mark.thorough
@pytest.mark.parametrize("rate", [2000.0, 300.0, 100.0])
def test_f32_is_near_f64_or_stalls(rate):
    """Ropes from limp to stiff, side by side as alone; what f32 stops is repeated in f64."""
    bends = np.logspace(1, 9, 9)
    steps = int(0.4 * rate)
    rods = aside(300.0, 10)
    grippers = resting(rods, Clamp.POSITION, Clamp.FREE, steps + 1)

    def moved(precision: str, bend=bends):
        return simulate(rods, Material(bend, bend), grippers, Dynamics(), Stepping(rate, precision=precision))

    exact, single, mixed = moved("f64"), moved("f32"), moved("mixed")
    good = single.converged
    print(f"{rate:g} steps/s: {good.sum()} of {len(bends)} converge in f32")
    assert exact.converged.all() and mixed.converged.all() and good.any() == (rate < 400)
    assert (single.status[~good, -1] == Status.STALLED).all()
    moves = np.linalg.norm(exact.positions - rods.vertices, axis=-1).max()
    assert np.linalg.norm(single.positions - exact.positions, axis=-1)[good].max(initial=0.0) < 5e-3 * moves
    np.testing.assert_array_equal(mixed.positions[~good], exact.positions[~good])
    for k in (0, 6):
        np.testing.assert_array_equal(moved("f32", bends[k : k + 1]).positions[0], single.positions[k])


@pytest.mark.parametrize("pose", range(6))
@pytest.mark.thorough
def test_a_motion_comes_to_rest_where_the_scaled_solve_does(pose):
    """Rods whose stiffness differs by up to 1e9: there a dense Newton's method, in which every unknown is scaled by its own
    stiffness, has nothing left to do; or they say that they failed."""
    rod, held = poses()
    clamps = held[pose]
    begun = relax(rod, Material(SOFT, SOFT), clamps).configuration
    cases = [(kind, ratio) for kind in KINDS for ratio in RATIOS[::3]]
    materials = [material(*case) for case in cases]
    edges = rod.edges
    bend = np.concatenate([np.broadcast_to(one.bend, (1, edges, 2, 2)) for one in materials])
    twist = np.concatenate([np.broadcast_to(one.twist, (1, edges - 1)) for one in materials])
    still = Grippers.resting(clamps, 61)
    motion = simulate(begun, Material(bend, twist), still, Dynamics(drag=20.0), Stepping(10.0))
    failed = ~motion.converged
    assert np.isnan(motion.positions[failed, -1]).all(), "a rod that failed has no place"
    off = []
    for row in np.flatnonzero(~failed):
        ended = Configuration(motion.positions[row : row + 1, -1, 0], motion.memory.frames[row : row + 1], begun.rest_length)
        apart = resolved(SimpleNamespace(configuration=ended), materials[row], clamps) - ended.vertices[0]
        off.append(np.linalg.norm(apart, axis=-1).max() / LENGTH)
    print(f"pose {pose}: {failed.sum()} of {len(cases)} failed and say so, the others are off by {max(off):.1e} of the length")
    assert max(off) < SHAPE
    ratios = np.array([ratio for _, ratio in cases])
    assert not failed[ratios <= 1e3].any()
    assert failed.mean() < 0.5
