"""Rods whose grippers pull them taut, let them slack again, and pull beyond their length."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti import ClampPath, Direction, Dynamics, Grippers, Plane, Stepping, predict_moving, relax, simulate
from doo_ti.rod.shapes import straight_rod
from doo_ti.rod.types import Clamp, Configuration, Material, Status
from tests.references.rods import clamps_at

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


@pytest.mark.parametrize("kind", KINDS)
def test_quasi_static_steps_out_of_taut_end_where_statics_does(kind):
    grippers = along(kind, kind, ways(0.0, 60.0))
    motion = simulate(ROD, MATERIAL, grippers, Dynamics(), Stepping(10.0, quasi_static=True))
    before = Configuration(motion.positions[:, -1, 0], motion.memory.frames, ROD.rest_length)
    still = relax(before, MATERIAL, grippers.at(TIMES), precision="f64")
    assert np.abs(still.configuration.vertices - motion.positions[:, -1]).max() < 1e-4


@pytest.mark.sampled(2)
@pytest.mark.parametrize("precision", ["f64", "f32", "mixed"])
def test_pulled_beyond_its_length_a_rod_is_infeasible_from_then_on(precision):
    slack = ways(30.0, 0.0, -20.0, 30.0)
    motion = simulate(ROD, MATERIAL, along(Clamp.FRAME, Clamp.POSITION, slack), Dynamics(), Stepping(20.0, precision=precision))
    last = np.flatnonzero(slack < 0)[0] - 1
    assert (motion.status[0, :last] == Status.CONVERGED).all() and (motion.status[0, last:] == Status.INFEASIBLE).all()
    assert np.isnan(motion.positions[0, last:]).all() and np.isfinite(motion.positions[0, :last]).all()


def test_rods_of_a_batch_are_judged_by_their_own_grippers():
    """Taut, slack, and beyond its length, beside each other as alone."""
    every = [along(Clamp.FRAME, Clamp.FRAME, slack) for slack in (ways(0.0, 30.0), ways(30.0, 60.0), ways(0.0, -10.0))]
    both = Grippers(Clamp.FRAME, Clamp.FRAME, *(np.concatenate([getattr(one, name) for one in every]) for name in (
        "start_position", "end_position", "start_frame", "end_frame")))
    motion = simulate(ROD.take([0, 0, 0]), MATERIAL, both, Dynamics(), Stepping(20.0))
    assert motion.status[:, -1].tolist() == [Status.CONVERGED, Status.CONVERGED, Status.INFEASIBLE]
    for k, grippers in enumerate(every):
        alone = simulate(ROD, MATERIAL, grippers, Dynamics(), Stepping(20.0))
        assert np.array_equal(alone.positions[0], motion.positions[k], equal_nan=True)


def test_between_instants_a_gripper_stays_where_the_rod_reaches():
    """It stops abruptly where the rod is taut; a cubic would go beyond."""
    grippers = along(Clamp.TANGENT, Clamp.TANGENT, ways(30.0, 0.0, 0.0))
    motion = simulate(ROD, MATERIAL, grippers, Dynamics(), Stepping(20.0, substeps=3))
    assert motion.converged.all() and missed(motion, grippers) < 1e-9


def test_a_taut_rod_turns_with_its_grippers():
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


def test_predictions_with_inertia_follow_a_gripper_out_of_taut():
    clamps = clamps_at(ROD, Clamp.FRAME, Clamp.FRAME)
    end = clamps.end_position - np.array([0.0, 20.0, 60.0])[:, None, None] * [1.0, 0.0, 0.0]
    path = ClampPath(np.array([0.0, 0.1, 0.2]), end_position=end)
    found = predict_moving(ROD, MATERIAL, clamps, path, Dynamics(), Stepping(10.0))
    assert (found.status == Status.CONVERGED).all()
    assert np.abs(found.vertices[:, 0, -1] - end[:, 0]).max() < 1e-9
