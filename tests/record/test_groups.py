"""The recording of a group of rods."""

from dataclasses import replace

import numpy as np

from doo_ti import Group, GroupSolution, Material, Plane, Status, Surroundings, Tie, end_clamps, straight_rod
from doo_ti.record import FAILED, record_group
from tests.record.recordings import read


def test_rods_ties_and_forces_are_shown(tmp_path, rng):
    rods = [straight_rod(60.0, 6), straight_rod(40.0, 4, start=(0.0, 20.0, 0.0), direction=(0.0, 1.0, 0.0))]
    group = Group(rods, Material(1e5, 1e5), [end_clamps(rod) for rod in rods], [Tie((0, 3), (1, 0))])
    none, forces = np.zeros((1, 2, 3)), tuple(rng.normal(size=rod.vertices.shape) for rod in rods)
    good = GroupSolution(group, *np.zeros((4, 1)), np.ones(1, int), np.zeros(1, int), np.ones(1, bool), np.zeros((1, 1, 3)),
                         np.zeros((1, 1, 3)), none, none, forces, tuple(np.zeros((1, len(each[0]))) for each in forces),
                         np.zeros(1), np.zeros(1))
    moments = [good, replace(good, status=np.array([Status.STALLED]))]
    record_group(tmp_path / "bare.rrd", moments, name="without thickness")
    assert set(read(tmp_path / "bare.rrd")[1]) >= {"/world/rods/0", "/world/rods/1", "/world/ties"}
    record_group(tmp_path / "g.rrd", moments, name="made up", names=["trunk", "a branch"], rate=2.0,
                 surroundings=Surroundings([Plane((0, 0, -5), (0, 0, 1))], 1.5))
    static, moving = read(tmp_path / "g.rrd")
    places = ["/world/rods/0_trunk", "/world/rods/1_a_branch"]
    assert "/world/obstacles/0/0" in static and set(moving) == {*places, "/world/ties", "/world/forces"}
    drawn = [moving[place]["time"] for place in places]
    assert [len(rod["LineStrips3D:strips"][1][0]) for rod in drawn] == [7, 5]
    np.testing.assert_allclose(drawn[1]["LineStrips3D:strips"][0][0], rods[1].vertices[0], rtol=1e-6)
    colors = np.array([rod["LineStrips3D:colors"] for rod in drawn])[:, :, 0] >> 8
    assert len(set(colors[:, 0].tolist())) == 2 and set(colors[:, 1].tolist()) == {int.from_bytes(bytes(FAILED))}
    np.testing.assert_allclose(moving["/world/ties"]["time"]["Points3D:positions"][0], [[30.0, 0.0, 0.0]], atol=1e-5)
    assert len(moving["/world/forces"]["time"]["Arrows3D:vectors"][0]) == 12
