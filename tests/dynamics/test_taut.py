"""Rods whose grippers pull them taut and beyond their length; steps resolve all forces, or say that they do not."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti import Direction, Dynamics, Grippers, Plane, Stepping, relax, simulate, straight_rod
from doo_ti.rod.frames import matrix_from_quaternion, quaternion_of_turn
from doo_ti.rod.types import Clamp, Configuration, Material, Status
from tests.dynamics.motions import GRAVITY, planar, resting
from tests.references.rods import clamps_at
from tests.relaxation import test_stiffness_ratios as ratios

LENGTH, EDGES = 300.0, 30
ROD = straight_rod(LENGTH, EDGES)
MATERIAL = Material(1e6, 0.8e6)
KINDS = (Clamp.POSITION, Clamp.TANGENT, Clamp.FRAME)
TIMES = 6


def along(kind_start: Clamp, kind_end: Clamp, slack) -> Grippers:
    """Grippers on the line of ROD, nearer than it is long by ``slack`` (T,) mm."""
    still = Grippers.resting(clamps_at(ROD, kind_start, kind_end), len(slack))
    return replace(still, end_position=still.end_position - np.asarray(slack)[None, :, None] * [1.0, 0.0, 0.0])


def ways(*places) -> np.ndarray:
    """From place to place in TIMES equal steps each."""
    return np.concatenate([[places[0]], *(np.linspace(a, b, TIMES + 1)[1:] for a, b in zip(places, places[1:], strict=False))])


def missed(motion, grippers: Grippers) -> float:
    """mm by which the far end is off its gripper at most."""
    return float(np.abs(motion.positions[0, :, -1] - grippers.end_position[0, 1:]).max())


@pytest.mark.parametrize("quasi_static", [False, True])
@pytest.mark.parametrize("kinds", [(a, b) for a in KINDS for b in KINDS])
@pytest.mark.sampled(2)
def test_the_far_gripper_is_followed_into_and_out_of_taut_rods(kinds, quasi_static):
    """Taut at first, in the middle and at the end; its tension is not determined there, and only there."""
    slack = ways(0.0, 0.0, 60.0, 0.0, 0.0, 40.0, 0.0)
    grippers = along(*kinds, slack)
    motion = simulate(ROD, MATERIAL, grippers, Dynamics(), Stepping(20.0, quasi_static=quasi_static))
    assert motion.converged.all() and missed(motion, grippers) < 1e-9
    assert np.array_equal(np.isnan(motion.end_force[0]).all(axis=1), slack[1:] == 0)
    lengths = np.linalg.norm(np.diff(motion.positions[0], axis=1), axis=-1)
    assert np.abs(lengths - LENGTH / EDGES).max() < 1e-9
    assert motion.positions[0, 3 * TIMES - 7, :, 2].min() < -20.0, "it hangs"


@pytest.mark.parametrize("start", [0.0, 0.3])
def test_a_tangent_that_flips_is_met_or_the_step_fails(start):
    """There is no parallel transport to the opposite direction: the edge had stayed as it was, in steps that converged."""
    still = Grippers.resting(clamps_at(ROD, Clamp.TANGENT, Clamp.FREE), 4)
    turns = np.array([start, start + np.pi, start + np.pi])[:, None] * [0.0, 1.0, 0.0]
    frames = still.start_frame.copy()
    frames[:, 1:] = matrix_from_quaternion(quaternion_of_turn(turns))
    motion = simulate(ROD, MATERIAL, replace(still, start_frame=frames), Dynamics(), Stepping(1.0, quasi_static=True))
    along = np.diff(motion.positions[0], axis=1)[:, 0] / (LENGTH / EDGES)
    done = motion.status[0] == Status.CONVERGED
    assert np.abs(along - frames[0, 1:, :, 0])[done].max(initial=0.0) < 1e-9 and np.isfinite(along[done]).all()


@pytest.mark.parametrize("kind", KINDS)
def test_quasi_static_steps_out_of_taut_end_where_statics_does(kind):
    grippers = along(kind, kind, ways(0.0, 60.0))
    motion = simulate(ROD, MATERIAL, grippers, Dynamics(None, 0.5, 0.3, 5.0), Stepping(10.0, quasi_static=True))
    before = Configuration(motion.positions[:, -1, 0], motion.memory.frames, ROD.rest_length)
    still = relax(before, MATERIAL, grippers.at(TIMES), precision="f64")
    assert np.abs(still.configuration.vertices - motion.positions[:, -1]).max() < 1e-4


@pytest.mark.sampled(1)
@pytest.mark.parametrize("precision", ["f64", "f32", "mixed"])
def test_pulled_beyond_its_length_a_rod_is_infeasible_from_then_on(precision):
    slack = ways(30.0, 0.0, -20.0, 30.0)
    motion = simulate(ROD, MATERIAL, along(Clamp.FRAME, Clamp.POSITION, slack), Dynamics(), Stepping(20.0, precision=precision))
    last = np.flatnonzero(slack < 0)[0] - 1
    assert (motion.status[0, :last] == Status.CONVERGED).all() and (motion.status[0, last:] == Status.INFEASIBLE).all()
    for part in (motion.positions, motion.end_force[:, :, None]):
        assert np.isnan(part[0, last:]).all() and np.isfinite(part[0, : last - 1]).all()


def test_rods_of_a_batch_are_judged_by_their_own_grippers():
    every = [along(Clamp.FRAME, Clamp.FRAME, slack) for slack in (ways(0.0, 30.0), ways(30.0, 60.0), ways(0.0, -10.0))]
    both = Grippers(Clamp.FRAME, Clamp.FRAME, *(np.concatenate([getattr(one, name) for one in every]) for name in (
        "start_position", "end_position", "start_frame", "end_frame")))
    motion = simulate(ROD.take([0, 0, 0]), MATERIAL, both, Dynamics(), Stepping(20.0))
    assert motion.status[:, -1].tolist() == [Status.CONVERGED, Status.CONVERGED, Status.INFEASIBLE]
    for k, grippers in enumerate(every):
        alone = simulate(ROD, MATERIAL, grippers, Dynamics(), Stepping(20.0))
        assert np.array_equal(alone.positions[0], motion.positions[k], equal_nan=True)


def test_a_taut_rod_turns_with_its_grippers_which_stay_where_it_reaches_between_instants():
    """They stop abruptly where the rod is taut; a cubic would go beyond."""
    grippers = along(Clamp.TANGENT, Clamp.TANGENT, ways(30.0, 0.0, 0.0))
    motion = simulate(ROD, MATERIAL, grippers, Dynamics(), Stepping(20.0, substeps=3))
    assert motion.converged.all() and missed(motion, grippers) < 1e-9
    angle = np.linspace(0.0, 0.5, 11)
    axes = np.stack([np.cos(angle), 0 * angle, np.sin(angle)], axis=-1)[None]
    frames = np.stack([axes, np.broadcast_to([0.0, 1.0, 0.0], axes.shape), np.cross(axes, [0.0, 1.0, 0.0])], axis=-1)
    grippers = Grippers(Clamp.FRAME, Clamp.FRAME, 0 * axes, LENGTH * axes, frames, frames)
    motion = simulate(ROD, MATERIAL, grippers, Dynamics(), Stepping(20.0, detailed=True))
    assert motion.converged.all()
    assert np.abs(motion.positions[0] - np.linspace(0, 1, EDGES + 1)[:, None] * LENGTH * axes[0, 1:, None]).max() < 1e-9
    energies = motion.detail.energies
    assert np.abs(energies["work"] - (energies["sum"] - energies["sum"][:, :1])).max() < 1e-9 * energies["sum"].max()


@pytest.mark.parametrize("height", [-2.0, -20.0])
@pytest.mark.thorough
def test_out_of_taut_among_obstacles(height):
    """Pushed on a table a straight rod goes aside, or up; above it, down to it."""
    grippers = along(Clamp.FRAME, Clamp.FRAME, ways(0.0, 30.0, 0.0))
    for quasi_static in (True, False):
        motion = simulate(ROD, MATERIAL, grippers, Dynamics(), Stepping(20.0, quasi_static=quasi_static),
                          obstacles=[Plane((0.0, 0.0, height), (0.0, 0.0, 1.0))], radius=2.0)
        assert motion.converged.all() and missed(motion, grippers) < 1e-9
        assert motion.positions[..., 2].min() > height + 2.0 - 1e-3


@pytest.mark.thorough
def test_derivatives_out_of_taut_are_those_of_the_motion():
    grippers = along(Clamp.FRAME, Clamp.FRAME, ways(0.0, 0.0, 30.0))
    dynamics = Dynamics(bend_damping=0.02)

    def moved(bend: float, **more):
        return simulate(ROD, Material(bend, 0.8e6), grippers, dynamics, Stepping(20.0), **more)

    near = [(Material(1e6 * (1 + change), 0.8e6), dynamics) for change in (-1e-4, 1e-4)]
    slopes = moved(1e6, directions=[Direction(*near, 2e-4)]).slopes[0, :, 0]
    difference = (moved(1e6 * (1 + 1e-4)).positions[0] - moved(1e6 * (1 - 1e-4)).positions[0]) / 2e-4
    assert np.abs(slopes - difference).max() < 1e-4 * np.abs(difference).max() and np.abs(difference).max() > 1.0


ASIDE = np.radians(60.0)  # of a rod that is let go, from hanging straight down


def aside(length: float, edges: int) -> Configuration:
    return planar(np.full(edges, ASIDE - np.pi / 2), length / edges)


def let_go(rods: Configuration, bend, steps: int, stepping: Stepping, **dynamics):
    """The motion of rods that hang from the origin, aside at first."""
    grippers = resting(rods, Clamp.POSITION, Clamp.FREE, steps + 1)
    return simulate(rods, Material(bend, bend), grippers, Dynamics(**dynamics), stepping)


def over_pendulum(positions: np.ndarray, phase: np.ndarray) -> np.ndarray:
    """(T,) by which the tip has come nearer to hanging, over what θ̈ = −ω² sin θ says to fourth order in the phases ωt."""
    expected = 0.5 * np.sin(ASIDE) * phase**2 * (1.0 - np.cos(ASIDE) * phase**2 / 12.0)
    return (ASIDE - np.arctan2(positions[:, -1, 0], -positions[:, -1, 2])) / expected


@pytest.mark.parametrize("ratio, rate", [(1e4, 2000.0), (1e2, 1000.0), (1e4, 100.0), (0.0, 80_000.0)])
@pytest.mark.sampled(1)
def test_payloads_and_short_steps(ratio, rate):
    """A limp cable with so many times its own mass at its end starts as a pendulum does; and any does in short steps."""
    length, edges, steps = 1500.0, 30, 40
    mass = np.zeros((1, edges + 1))
    mass[0, -1] = ratio * length
    found = let_go(aside(length, edges), 1e5, steps, Stepping(rate, scheme="bdf2"), point_mass=mass)
    assert found.converged.all()
    time = np.arange(1, steps + 1) / rate
    if ratio:
        assert np.abs(over_pendulum(found.positions[0], np.sqrt(GRAVITY / length) * time) - 1.0)[4:].max() < 0.03
    else:  # its tip falls freely, but for what the next edges hold
        assert np.abs(found.positions[0, :, -1, 2] - found.positions[0, 0, -1, 2]).max() > 0.2 * 0.5 * GRAVITY * time[-1] ** 2


@pytest.mark.parametrize("bend", [1e9, 1e13])
def test_a_stiff_rod_falls_as_a_light_pendulum(bend):
    """However small its weight is beside its stiffness: θ̈ = −(3/2) g/L sin θ."""
    length, edges, rate, steps = 300.0, 10, 1000.0, 100
    found = let_go(aside(length, edges), bend, steps, Stepping(rate))
    phase = np.sqrt(1.5 * GRAVITY / length / (1.0 + 0.5 / edges**2)) * steps / rate
    assert found.converged.all() and abs(over_pendulum(found.positions[0], phase)[-1] - 1.0) < 0.01


@pytest.mark.thorough
@pytest.mark.parametrize("rate", [2000.0, 300.0, 100.0])
def test_f32_is_near_f64_or_stalls(rate):
    """Ropes from limp to stiff, side by side as alone; what f32 stops is repeated in f64."""
    bends, rods = np.logspace(1, 9, 9), aside(300.0, 10)

    def moved(precision: str, bend=bends):
        return let_go(rods, bend, int(0.4 * rate), Stepping(rate, precision=precision))

    exact, single, mixed = moved("f64"), moved("f32"), moved("mixed")
    good = single.converged
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
    """Rods whose stiffness differs by up to 1e9: there a dense Newton's method in the rotations of joints has nothing
    left to do; or they say that they failed."""
    rod, held = ratios.poses()
    clamps, edges = held[pose], rod.edges
    begun = relax(rod, Material(ratios.SOFT, ratios.SOFT), clamps).configuration
    cases = [(kind, ratio) for kind in ratios.KINDS for ratio in ratios.RATIOS[::3]]
    materials = [ratios.material(*case) for case in cases]
    bend = np.concatenate([np.broadcast_to(one.bend, (1, edges, 2, 2)) for one in materials])
    twist = np.concatenate([np.broadcast_to(one.twist, (1, edges - 1)) for one in materials])
    motion = simulate(begun, Material(bend, twist), Grippers.resting(clamps, 61), Dynamics(drag=20.0), Stepping(10.0))
    failed = ~motion.converged
    assert np.isnan(motion.positions[failed, -1]).all(), "a rod that failed has no place"
    off = []
    for row in np.flatnonzero(~failed):
        ended = Configuration(motion.positions[row : row + 1, -1, 0], motion.memory.frames[row : row + 1], begun.rest_length)
        apart = ratios.resolved(ended, materials[row], clamps) - ended.vertices[0]
        off.append(np.linalg.norm(apart, axis=-1).max() / ratios.LENGTH)
    print(f"pose {pose}: {failed.sum()} of {len(cases)} failed and say so, the others are off by {max(off):.1e} of the length")
    assert max(off) < ratios.SHAPE
    assert not failed[np.array([ratio for _, ratio in cases]) <= 1e3].any()
    assert failed.mean() < 0.5
