"""Obstacles that a rod cannot reach, or not yet."""

import numpy as np
import pytest

from doo_ti import Clamp, Clamps, Configuration, Dynamics, Grippers, Material, Newton, Plane, Stepping, relax, simulate
from doo_ti.relaxation.contact_table import contact_table
from doo_ti.relaxation.input_tables import tables

LENGTH, RADIUS, FRAMES = 40.0, 1.0, 60
FAR = Plane((0, 0, -100.0), (0, 0, 1))


def held() -> tuple[Configuration, Clamps]:
    rod = Configuration.straight(np.array([0.0, 0.0, 10.0]), np.array([1.0, 0.0, 0.0]), LENGTH, 10)
    x, frames = rod.vertices, rod.frames
    return rod, Clamps(Clamp.FRAME, Clamp.FREE, x[:, 0], x[:, -1], frames[:, 0], frames[:, -1])


def test_rods_out_of_reach_have_no_memory_of_contacts_and_rods_in_motion_have():
    rod, clamps = held()
    clamp = tables(rod, Material(1e6, 1e6), clamps, np.array([0.0, 0.0, 1.0])).clamp
    still, moving = (contact_table([FAR], RADIUS, 1, rod.edges, clamp, np.zeros(1, dtype=int), in_motion)
                     for in_motion in (False, True))
    assert not still.near.any() and len(still.memory) == 0
    assert moving.near.all() and len(moving.memory) == 1


def test_a_rod_out_of_reach_that_f32_cannot_finish_is_finished():
    rod, clamps = held()
    found = relax(rod, Material(1e6, 1e6), clamps, Newton(max_iterations=1), precision="f32", obstacles=[FAR], radius=RADIUS)
    bare = relax(rod, Material(1e6, 1e6), clamps, Newton(max_iterations=1), precision="f32")
    assert np.array_equal(found.status, bare.status) and np.array_equal(found.iterations, bare.iterations)


@pytest.mark.slow
def test_grippers_carry_a_rod_to_an_obstacle_that_it_could_not_reach():
    rod, clamps = held()
    place = np.repeat(clamps.start_position[:, None], FRAMES, 1)
    place[0, :, 2] -= np.linspace(0.0, 107.5, FRAMES)
    frame = np.repeat(clamps.start_frame[:, None], FRAMES, 1)
    moved = simulate(rod, Material(3e5, 3e5), Grippers(Clamp.FRAME, Clamp.FREE, place, 0 * place, frame, frame),
                     Dynamics(drag=5.0, bend_damping=0.02), Stepping(50.0), obstacles=[FAR], radius=RADIUS)
    assert moved.converged.all()
    assert FAR.distance(moved.positions[0])[0].min() > RADIUS * (1 - 1e-3)
    assert moved.contact_force[0, -1, :, 2].sum() > 0
