"""What a servo and a plan say where they cannot know, or do not know exactly."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import doo_ti as d
from doo_ti.rod.shapes import with_half_edges

THETA = d.Material(6e5, 6e5)
LENGTH, EDGES, NOISE = 330.0, 33, 0.3


@pytest.fixture(scope="module")
def hung():
    """A rod between two grippers, these, and its shape after they have moved."""
    rod, clamps = d.hanging(LENGTH, EDGES, start=(0, 0, 0), end=(200, 0, 0), clamp=d.Clamp.FRAME)
    begin = d.relax(rod, THETA, clamps).configuration
    moved = replace(clamps, end_position=clamps.end_position + [-30, 40, 20])
    return begin, clamps, d.Simulation(begin, THETA, clamps).step(moved).configuration.vertices


def marks(vertices: np.ndarray, rows, random: np.random.Generator) -> np.ndarray:
    seen = np.full_like(vertices, np.nan)
    seen[:, rows] = vertices[:, rows] + random.normal(0, NOISE, vertices[:, rows].shape)
    return seen


@pytest.mark.parametrize("axes", [
    pytest.param(np.diag([1.0, -1.0, 1.0]), id="mirrored"),
    pytest.param(np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), id="turned")])
def test_grippers_rest_where_no_model_explains_the_marks(hung, axes):
    """Cameras whose axes are not the robot's: grippers used to go on for ever, half a metre."""
    begin, clamps, goal = hung
    servo, simulation = d.Servo(begin, THETA, clamps, d.Targets(goal)), d.Simulation(begin, THETA, clamps)
    random = np.random.default_rng(0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for _ in range(25):
            held = servo.step(marks(simulation.state.configuration.vertices @ axes.T, slice(0, None, 3), random))
            simulation.step(held)
        low, high = servo.material.bend_interval[0]
    assert servo.status[0] == d.ServoStatus.LOST
    assert np.linalg.norm(held.start_position - clamps.start_position) < 60.0
    assert high / low <= np.exp(8 * d.ServoOptions().bend) * 1.001  # not beyond what is possible at all


@pytest.mark.parametrize("seen, status", [(slice(0, 16, 3), d.ServoStatus.NEAREST), (slice(0, None, 3), d.ServoStatus.REACHED)])
def test_a_target_that_no_mark_shows_is_not_reached(hung, seen, status):
    """Marks on one half of the rod, the target on the other."""
    begin, clamps, goal = hung
    asked = np.full_like(goal, np.nan)
    asked[:, 24] = goal[:, 24]
    servo, simulation = d.Servo(begin, THETA, clamps, d.Targets(asked)), d.Simulation(begin, THETA, clamps)
    random = np.random.default_rng(1)
    for _ in range(25):
        simulation.step(servo.step(marks(simulation.state.configuration.vertices, seen, random)))
    assert servo.distance[0] < 1.0 and servo.status[0] == status


@pytest.mark.parametrize("unit", [1e-3, 0.1])
@pytest.mark.parametrize("every", [1, 3])
def test_marks_and_targets_in_another_unit_are_warned_of(hung, unit, every):
    begin, clamps, goal = hung
    some = np.full_like(goal, np.nan)
    some[:, ::every] = goal[:, ::every]
    with pytest.warns(UserWarning, match="give mm"):
        d.Servo(begin, THETA, clamps, d.Targets(unit * some))
    servo = d.Servo(begin, THETA, clamps, d.Targets(some))
    with pytest.warns(UserWarning, match="give mm"):
        servo.step(unit * some)


def halved(rod: d.Configuration) -> d.Configuration:
    """The rod at rest with half as long edges that its grippers hold as before."""
    held, first, last = d.end_clamps(rod, d.Clamp.FRAME, d.Clamp.FRAME), rod.rest_length[0] / 4, rod.rest_length[-1] / 4
    held = replace(held, start_position=held.start_position + first * held.start_frame[..., 0],
                   end_position=held.end_position - last * held.end_frame[..., 0])
    return d.relax(with_half_edges(rod), THETA, held).configuration


@pytest.mark.sampled(1)
@pytest.mark.parametrize("shift, turn", [((-60, 30, 20), 2.0), ((-30, 40, 20), 0.0)])
def test_the_mesh_error_of_a_plan_is_how_far_a_finer_rod_ends_from_it(hung, shift, turn):
    """A rod of 129 edges, at the arc lengths of the vertices of 33."""
    begin, clamps, _ = hung
    roll = np.array([[1, 0, 0], [0, np.cos(turn), -np.sin(turn)], [0, np.sin(turn), np.cos(turn)]])
    ends = replace(clamps, end_position=clamps.end_position + shift, end_frame=clamps.end_frame @ roll)
    goal = d.Simulation(begin, THETA, clamps).step(ends).configuration
    path = d.plan_manipulation(begin, THETA, clamps, d.Targets(goal.vertices))
    finest, edge = halved(halved(goal)), LENGTH / EDGES
    at = CubicSpline(edge * 3 / 8 + edge / 4 * np.arange(finest.edges + 1), finest.vertices[0])(edge * np.arange(1, EDGES))
    apart = np.sqrt(np.sum((at - goal.vertices[0, 1:-1]) ** 2) / (EDGES + 1))
    assert path.reached and path.mesh_error == pytest.approx(apart, rel=0.25) and path.mesh_error > 0.02
    fine = d.rod_along(goal.vertices[0], 4 * EDGES, vertex_clamps=True)
    held = replace(ends, **{name: getattr(d.end_clamps(goal, d.Clamp.FRAME, d.Clamp.FRAME), name) for name in (
        "start_position", "start_frame", "end_position", "end_frame")})
    bent = d.relax(fine, THETA, held).configuration.vertices[0, 1:-1:4]
    apart = np.sqrt(np.mean(np.sum((bent - goal.vertices[0]) ** 2, axis=-1)))
    assert path.clamp_error == pytest.approx(apart, rel=0.25)
