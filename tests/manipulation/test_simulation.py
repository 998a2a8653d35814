"""Rods stepped by their grippers."""

import numpy as np

import doo_ti as d
from doo_ti.manipulation.poses import moved
from tools.studies.servo_tasks import tasks


def test_a_rod_takes_its_own_sub_steps_whatever_the_others_need():
    own = tasks(6, 9)
    alone = own.take(np.array([2]))
    change = np.random.default_rng(3).normal(size=(6, 12)) * np.repeat([8.0, 0.1, 8.0, 0.1], 3)
    change[4] *= 6.0
    together, one = (d.Simulation(part.rods, part.nominal, part.clamps) for part in (own, alone))
    for _ in range(3):
        state = together.step(moved(together.clamps, change))
        mine = one.step(moved(one.clamps, change[[2]]))
        assert np.array_equal(state.configuration.quaternions[2], mine.configuration.quaternions[0])
        assert state.iterations[2] == mine.iterations[0] and state.energy[2] == mine.energy[0]


def test_a_failure_on_the_way_stays_in_the_status():
    rods, clamps = d.hanging(300.0, 20, np.zeros((1, 3)), [[150.0, 0, 0]])
    simulation = d.Simulation(rods, d.Material(1e5, 1e5), clamps)
    apart = moved(clamps, np.array([[0.0] * 6 + [400.0] + [0.0] * 5]))
    assert simulation.step(apart).status[0] == d.Status.INFEASIBLE
    assert simulation.step(clamps).status[0] == d.Status.INFEASIBLE  # still apart on most of the way back
    assert simulation.step(clamps).converged.all()
    assert simulation.reset().converged.all()
