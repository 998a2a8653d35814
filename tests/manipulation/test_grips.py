"""Rods that grippers hold between their ends: the planar elastica, loads as derivatives of the energy, re-grasping, steps."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.integrate import solve_bvp

from doo_ti import Grip, Itself, Simulation, end_loads, hanging, predict_step, relax, relax_held, straight_rod
from doo_ti.manipulation.model import moved
from doo_ti.rod.types import Clamp, Clamps, Material, Status
from tests.conftest import check_refused
from tests.references.rods import certified
from tools.studies.servo_tasks import tasks

LENGTH, SPAN, RAISED, IN_PLANE = 400.0, 380.0, 40.0, 1e5
FRAME = np.eye(3)[None]


def raised(edges: int):
    """A weightless ribbon between level clamps whose middle a gripper raises."""
    rod = straight_rod(LENGTH, edges, (0, 0, 0), (1, 0, 0), vertex_clamps=True)
    clamps = Clamps(Clamp.FRAME, Clamp.FRAME, np.zeros((1, 3)), np.array([[SPAN, 0, 0]]), FRAME, FRAME)
    grip = Grip(rod.edges // 2, np.array([[SPAN / 2, 0, RAISED]]), FRAME)
    return relax_held(rod, Material.diagonal(1e7, IN_PLANE, 1e6, weight=0.0), clamps, [grip])


def elastica(guess: np.ndarray, force: np.ndarray) -> np.ndarray:
    """The force on the raised end of half the ribbon over its stiffness: EI θ'' = F_x sin θ − F_z cos θ, θ = 0 at both ends."""
    s = np.linspace(0, LENGTH / 2, 200)
    angle = np.interp(s, np.linspace(0, LENGTH / 2, len(guess)), guess)
    start = np.array([angle, np.gradient(angle, s), np.cumsum(np.cos(angle)) * s[1], np.cumsum(np.sin(angle)) * s[1]])
    found = solve_bvp(
        lambda s, y, f: np.array([y[1], f[0] * np.sin(y[0]) - f[1] * np.cos(y[0]), np.cos(y[0]), np.sin(y[0])]),
        lambda a, b, f: np.array([a[0], a[2], a[3], b[0], b[2] - SPAN / 2, b[3] - RAISED]), s, start, p=force, tol=1e-8)
    assert found.success, found.message
    return found.p


def test_a_raised_middle_is_the_elastica_to_second_order():
    off = []
    for edges in (40, 80, 160):
        held = raised(edges)
        certified(held.solution)
        tangents = held.parts[0].configuration.frames[0, :, :, 0]
        own = end_loads(held.parts[0]).end_force[0, [0, 2]] / IN_PLANE
        force = 2 * IN_PLANE * elastica(np.arctan2(tangents[:, 2], tangents[:, 0]), own)[1]
        off.append(abs(held.grip_loads().force[0, 0, 2] / force - 1))
    assert off[-1] < 1e-3 and off[0] / off[1] > 3.5 and off[1] / off[2] > 3.5


@pytest.fixture(scope="module")
def rope():
    rod, clamps = hanging(300.0, 30, (0, 0, 0), ((180, 0, 0), (200, 30, 0), (220, 0, 40)), clamp=Clamp.FRAME)
    along = np.linspace(1.0, 2.0, rod.edges)[None, :, None, None] * 4e5 * np.eye(2)
    material = Material(along, np.linspace(3e5, 5e5, rod.edges - 1)[None], rest_curvature=(1e-3, 2e-3))
    return certified(relax(rod, material, clamps)), material, clamps


def test_taking_hold_moves_little_and_loads_balance(rope):
    solution, material, clamps = rope
    grips = [Grip.where(solution.configuration, vertex) for vertex in (9, 20)]
    held = certified(relax_held(solution.configuration, material, clamps, grips).solution)
    assert np.linalg.norm(held.configuration.vertices - solution.configuration.vertices, axis=2).max() < 0.05
    np.testing.assert_allclose(held.energy, solution.energy, rtol=1e-3)
    raised = [replace(grip, position=grip.position + [0, 0, 5.0]) for grip in grips]
    lifted = relax_held(held.configuration, material, clamps, raised)
    first, last = end_loads(lifted.parts[0]), end_loads(lifted.parts[-1])
    whole = first.start_force + last.end_force + lifted.grip_loads().force.sum(axis=1)
    np.testing.assert_allclose(whole, [[0, 0, 2 * 300.0]] * 3, atol=1e-5)


def test_loads_are_the_derivatives_of_the_energy(rope):
    solution, material, clamps = rope
    grip = Grip.where(solution.configuration, 12)
    grip = replace(grip, position=grip.position + [3.0, -4.0, 6.0])
    held = relax_held(solution.configuration, material, clamps, [grip])
    loads, step = held.grip_loads(), 1e-3
    for axis, move in enumerate(step * np.eye(3)):
        shifted = [relax_held(held.solution.configuration, material, clamps, [replace(grip, position=moved_to)]).solution.energy
                   for moved_to in (grip.position + move, grip.position - move)]
        np.testing.assert_allclose((shifted[0] - shifted[1]) / (2 * step), loads.force[:, 0, axis], rtol=1e-5, atol=1e-3)


def test_grippers_take_hold_and_let_go(rope):
    solution, material, clamps = rope
    simulation = Simulation(solution.configuration, material, clamps)
    at_rest = simulation.state
    grip = Grip.where(at_rest.configuration, 15)
    up = replace(grip, position=grip.position + [0, 0, 20.0])
    lifted = certified(simulation.step(clamps, [up]))
    np.testing.assert_allclose(lifted.configuration.vertices[:, 15], up.position, atol=1e-6)
    certified(simulation.step(clamps, [Grip.where(lifted.configuration, 8), up]))
    assert simulation.held.grip_loads().force.shape == (3, 2, 3)
    back = certified(simulation.step(clamps))
    np.testing.assert_allclose(back.configuration.vertices, at_rest.configuration.vertices, atol=1e-4)


def test_a_rod_has_the_status_of_its_worst_stretch(rope):
    solution, material, clamps = rope
    grip = Grip.where(solution.configuration, 15)
    away = replace(grip, position=grip.position + np.array([0, 500.0, 0]) * np.array([[0], [1], [0]]))
    held = relax_held(solution.configuration, material, clamps, [away])
    assert held.solution.status.tolist() == [Status.CONVERGED, Status.INFEASIBLE, Status.CONVERGED]
    assert np.isnan(held.grip_loads().force[1]).all() and np.isfinite(held.grip_loads().force[[0, 2]]).all()


@pytest.mark.parametrize(("vertices", "obstacles", "words"), [
    ((1,), (), "2 edges"), ((9, 10), (), "2 edges"), ((20, 9), (), "order of their vertices"),
    ((9,), (Itself(),), "Itself beside grips")])
def test_grips_that_do_not_suit_are_refused(rope, vertices, obstacles, words):
    solution, material, clamps = rope
    grips = [Grip.where(solution.configuration, vertex) for vertex in vertices]
    check_refused(words, relax_held, solution.configuration, material, clamps, grips, obstacles=obstacles,
                  radius=1.0 if obstacles else None)
    check_refused("between the ends", Grip.where, solution.configuration, 30)


@pytest.mark.parametrize("change", [2 * np.eye(3), np.diag([1.0, 1, -1]), np.array([[1.0, 0.5, 0], [0, 1, 0], [0, 0, 1]])])
def test_goals_whose_frames_are_no_rotations_are_refused(rope, change):
    solution, material, clamps = rope
    wrong, rods = replace(clamps, end_frame=clamps.end_frame @ change), solution.configuration
    one = [part.take([0]) for part in (rods, material, clamps)]
    for call in (Simulation(rods, material, clamps).step, partial(predict_step, *one)):
        check_refused("end_frame", call, wrong)
    check_refused("kind of clamp", Simulation(rods, material, clamps).step, replace(clamps, end=Clamp.POSITION))


def test_a_rod_takes_its_own_sub_steps_whatever_the_others_need():
    own = tasks(6, 9)
    alone = own.take(np.array([2]))
    change = np.random.default_rng(3).normal(size=(6, 12)) * np.repeat([8.0, 0.1, 8.0, 0.1], 3)
    change[4] *= 6.0
    together, one = (Simulation(part.rods, part.nominal, part.clamps) for part in (own, alone))
    for _ in range(3):
        state = together.step(moved(together.clamps, change))
        mine = one.step(moved(one.clamps, change[[2]]))
        assert np.array_equal(state.configuration.quaternions[2], mine.configuration.quaternions[0])
        assert state.iterations[2] == mine.iterations[0] and state.energy[2] == mine.energy[0]


def test_a_failure_on_the_way_stays_in_the_status():
    rods, clamps = hanging(300.0, 20, np.zeros((1, 3)), [[150.0, 0, 0]])
    simulation = Simulation(rods, Material(1e5, 1e5), clamps)
    assert simulation.step(moved(clamps, np.array([[0.0] * 6 + [400.0] + [0.0] * 5]))).status[0] == Status.INFEASIBLE
    assert simulation.step(clamps).status[0] == Status.INFEASIBLE  # still apart on most of the way back
    assert simulation.step(clamps).converged.all() and simulation.reset().converged.all()
