"""``doo-ti predict``: output, files, refused input."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import doo_ti as d
from doo_ti.commands.results import force_rows, plain
from doo_ti.dynamics.theta import MotionTheta, load_theta, save_form
from doo_ti.rod.frames import quaternion_from_matrix
from tests.commands.calls import ended, made, refused, succeeded, written
from tests.references.rods import at_rest, bows, observed

MATERIAL = "--bend 6e5 --twist 1e5"


@pytest.fixture
def folder(tmp_path):
    """Two rods at rest, with and without their frames, and motions."""
    shape = at_rest(bows(0.6, 0.9, edges=20, rest_length=5.0), d.Material(6e5, 1e5))
    d.save_observations("seen.npz", observed(shape))
    d.save_observations("bare.npz", d.Observations(shape.vertices, rest_length=np.full(20, 5.0)))
    ends = shape.vertices[:1, -1] + np.linspace(0, 1, 3)[:, None] * [-6.0, 2.0, 0]
    np.savez("move.npz", end_position_mm=ends, time_s=[0.0, 1.0, 3.0])
    Path("turn.csv").write_text("time_s,end_rotation_deg\n0,0\n2,840\n", encoding="utf-8")
    turn = np.array([[1, 0, 0], [0, 0.5, -np.sqrt(0.75)], [0, np.sqrt(0.75), 0.5]])
    np.savez("frames.npz", start_frame=np.tile(shape.frames[0, 0], (2, 1, 1)),
             end_frame=np.stack([shape.frames[0, -1], shape.frames[0, -1] @ turn]))
    np.savez("marks.npz", positions_mm=shape.vertices[:, None] + np.linspace(0, 1, 5)[:, None, None] * [3.0, 0, 1.0])
    return tmp_path


def words(source: str, motion: str, more: str = "") -> str:
    return f"predict {source} --motion {motion} {MATERIAL} --out f.npz {more}"


def test_840_degrees_are_reported_as_840_degrees(folder, capsys):
    printed = succeeded(capsys, words("seen.npz", "turn.csv", "--between 4"))
    assert "2 rods of 20 edges" in printed and "5 moments" in printed and "840.0°" in printed
    found = written("f.npz")
    np.testing.assert_allclose(found["end_rotation_deg"][:, 0], [0, 210, 420, 630, 840], atol=1e-6)
    np.testing.assert_allclose(found["time_s"], [0, 0.5, 1, 1.5, 2])
    assert found["vertices_mm"].shape == (5, 2, 21, 3) and found["jumps"].shape == found["energy"].shape == (5, 2)


def test_the_mesh_error_is_that_of_relax(folder, capsys):
    """Of a motion that stays where it begins."""
    np.savez("still.npz", end_position_mm=np.zeros((2, 3)), time_s=[0.0, 1.0])
    moved, still = (json.loads(succeeded(capsys, f"{line} --json")) for line in (
        words("seen.npz", "still.npz", "--relative"), f"relax seen.npz {MATERIAL} --out r.npz"))
    for name in ("median_mesh_error_mm", "largest_mesh_error_mm", "median_clamp_error_mm", "largest_clamp_error_mm"):
        assert 0.01 < moved[name] == pytest.approx(still[name], rel=1e-2)


@pytest.mark.parametrize("clamps", ["", "--clamp-start free", "--clamp-end free"])
def test_both_clamps_bear_the_weight(folder, clamps):
    """Each alone where the other end is free; relax and predict agree."""
    np.savez("still.npz", end_position_mm=np.zeros((2, 3)), time_s=[0.0, 1.0])
    moved = made(words("seen.npz", "still.npz", f"--relative --linear-density 10 {clamps}"))
    still = made(f"relax seen.npz {MATERIAL} --linear-density 10 {clamps} --out r.npz")
    for name in ("start_force_N", "end_force_N"):
        np.testing.assert_allclose(moved[name][-1], still[name], atol=1e-6)
    np.testing.assert_allclose(still["start_force_N"] + still["end_force_N"], [[0, 0, 0.01 * 0.1 * 9.80665]] * 2, atol=1e-9)
    if clamps:
        assert (still[f"{clamps.split()[0].removeprefix('--clamp-')}_force_N"] == 0).all()


def log_of(poses, turn: np.ndarray, scale: float) -> str:
    """A robot's log of both grippers: metres, quaternions of tools whose z axes point along the rod, other columns."""
    names = ["stamp", "joint_1"]
    rows = [[f"{0.5 * k}", "0.1"] for k in range(len(poses["end_frame"]))]
    for end in ("start", "end"):
        names += [f"{end}/position/{axis}" for axis in "xyz"] + [f"{end}/orientation/{part}" for part in "xyzw"]
        quaternion = quaternion_from_matrix(turn @ poses[f"{end}_frame"][..., [1, 2, 0]])[:, [1, 2, 3, 0]]
        places = scale * poses[f"{end}_position_mm"] @ turn.T
        rows = [row + [repr(float(x)) for x in (*place, *q)] for row, place, q in zip(rows, places, quaternion, strict=True)]
    return "\n".join(map(",".join, [names, *rows]))


def test_logs_of_robots(folder):
    """In another unit, with y up, and grippers of other names: the same motion as in the keys of a motion file."""
    seen = d.load_observations("seen.npz").take([0])
    d.save_observations("one.npz", seen)
    poses = dict(np.load("frames.npz"))
    poses |= {f"{end}_position_mm": np.repeat(seen.vertices[:, k], 2, axis=0) for end, k in (("start", 0), ("end", -1))}
    np.savez("poses.npz", **poses, time_s=[0.0, 0.5])
    expected = made(words("one.npz", "poses.npz"))
    log = log_of(poses, np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]), 1e-3)  # z becomes y
    Path("log.csv").write_text(log)
    Path("sides.csv").write_text(log.replace("start/", "left/").replace("end/", "right/"))
    turned = "--motion-axis z --motion-up 0,1,0"
    for name, more in (("log.csv", ""), ("sides.csv", "--motion-columns start=left,end=right,time=stamp")):
        found = made(words("one.npz", name, f"{turned} --motion-unit m {more}"))
        np.testing.assert_allclose(found["vertices_mm"], expected["vertices_mm"], atol=1e-3)
        np.testing.assert_array_equal(found["time_s"], [0, 0.5])
    np.savez("metres.npz", vertices_mm=1e-3 * seen.vertices, rest_length_mm=1e-3 * seen.rest_length,
             start_frame=seen.start_frame, end_frame=seen.end_frame, total_twist_deg=np.degrees(seen.total_twist))
    found = made(words("metres.npz", "log.csv", f"{turned} --unit m"))
    np.testing.assert_allclose(found["vertices_mm"], expected["vertices_mm"], atol=1e-3)


def test_materials_and_starts_at_once(folder, capsys):
    found = made(words("seen.npz", "move.npz", "--relative --bend 3e5:2e6:3 --json"))
    summary = json.loads(capsys.readouterr().out)
    assert summary["rods"] == 6 and summary["moments"] == 3 and summary["followed"] == int(found["followed"][-1].sum())
    assert found["observation"].tolist() == [0, 1] * 3
    np.testing.assert_allclose(found["bend_1"], np.repeat(np.geomspace(3e5, 2e6, 3), 2))
    moved = found["vertices_mm"][-1, :, -1] - found["vertices_mm"][0, :, -1]
    np.testing.assert_allclose(moved, np.tile([-6.0, 2.0, 0], (6, 1)), atol=1e-5)


@pytest.mark.parametrize("command", ["relax", "predict"])
def test_a_stiffer_material_twists_no_rod(folder, command):
    """A hanging cable under a stiffer material is off by 1.2340 mm with a turn of twist, by 1.2403 mm without."""
    rod, clamps = d.hanging(330.0, 33, (0, 0, 0), (210, 0, 0), clamp=d.Clamp.FRAME)
    shape = d.relax(rod, d.Material(4e5, 4e5), clamps).configuration
    d.save_observations("cable.npz", d.Observations(shape.vertices, rest_length=np.full(33, 10.0),
                                                         start_frame=shape.frames[:, 0], end_frame=shape.frames[:, -1]))
    np.savez("held.npz", end_position_mm=np.tile(shape.vertices[:, -1], (2, 1)))
    motion = "--motion held.npz" if command == "predict" else ""
    found = made(f"{command} cable.npz {motion} --bend 4e7 --twist 4e7 --out f.npz")
    untwisted = d.relax(shape, d.Material(4e7, 4e7), clamps).energy
    np.testing.assert_allclose(np.reshape(found["energy"], -1), untwisted[0], rtol=1e-6)


@pytest.mark.thorough
def test_a_motion_that_begins_elsewhere_is_pointed_out(folder, capsys):
    """Displacements without --relative: one line on standard error; none with it, or where the motion begins at the clamp."""
    np.savez("moves.npz", end_position_mm=np.outer([0, 0.5, 1], [-6.0, 2.0, 0]))
    err = ended(capsys, words("seen.npz", "moves.npz"))[1]
    assert err.count("\n") == 1 and "doo-ti: warning:" in err and "moves.npz: end_position_mm" in err and "--relative" in err
    for more, motion in ("--relative", "moves.npz"), ("", "turn.csv"):
        assert "warning" not in ended(capsys, words("seen.npz", motion, more))[1]


def test_rods_without_frames_are_held_by_those_of_the_path_and_carried_by_marks_at_their_end_edges(folder):
    free = made(words("bare.npz", "frames.npz", "--relative"))
    assert (free["end_rotation_deg"] == 0).all(), "spins are free"
    d.save_observations("one.npz", d.load_observations("bare.npz").take([0]))
    np.testing.assert_allclose(made(words("one.npz", "frames.npz"))["end_rotation_deg"], [[0], [60]], atol=1e-6)
    vertices = made(words("bare.npz", "marks.npz"))["vertices_mm"]
    np.testing.assert_allclose(vertices[-1] - vertices[0], np.broadcast_to([3.0, 0, 1], (2, 21, 3)), atol=1e-3)


def test_a_scene_with_picture_and_recording(capsys):
    pytest.importorskip("rerun")
    out = succeeded(capsys, "predict pulled_straight --between 2 --out f.npz --picture f.png --recording f.rrd")
    assert "2 rods of 33 edges" in out
    assert Path("f.png").read_bytes().startswith(b"\x89PNG") and Path("f.rrd").stat().st_size > 10_000
    assert written("f.npz")["material_name"].tolist() == ["silk", "vicryl"]


def test_rods_that_are_far_from_their_marks_are_pointed_out(folder, capsys):
    assert "from its marks on average" in ended(capsys, words("seen.npz", "move.npz", "--relative --bend 6e3 --twist 1e3"))[1]
    assert "warning" not in ended(capsys, words("seen.npz", "move.npz", "--relative"))[1]


def test_a_rod_that_is_lost_is_reported(folder, capsys):
    np.savez("far.npz", end_position_mm=[[90.0, 0, 0], [300.0, 0, 0]])
    printed = ended(capsys, words("seen.npz", "far.npz"), 1)[0]
    assert "infeasible" in printed and "no prediction from 1 s on" in printed and not written("f.npz")["followed"][-1].any()


ROD, SCENE = f"predict seen.npz {MATERIAL}", "predict pulled_straight"
TURN, WITH_INERTIA = f"{ROD} --motion turn.csv", f"simulate seen.npz {MATERIAL} --motion"


@pytest.mark.parametrize("words, said", [
    (ROD, "--motion"), (f"{ROD} --motion none.npz", "none.npz"), (f"{TURN} --between 0", "--steps-between"),
    (f"{TURN} --sub-step 90", "--sub-step"), (f"{TURN} --sub-step 1e-300", "--sub-step"), (f"{TURN} --out f.txt", "--out"),
    (f"{TURN} --steps-between 100000000", "--steps-between"), (f"{TURN} --recording f.png", "ends in .rrd"),
    (f"{TURN} --bend -1", "--bend"), (f"{ROD} --motion metres.npz", "moment 1: the clamps are 9e+04 mm apart"),
    (f"{TURN} --motion-columns hand=left", "--motion-columns"), (f"{TURN} --motion-columns time=clock", "clock"),
    (f"{TURN} --motion-columns end=right", "none begins with 'right'"), (f"{TURN} --motion-axis w", "--motion-axis"),
    (f"{TURN} --motion-up 0,0,0", "up"), (f"{SCENE} --motion turn.csv", "--motion"),  # a scene says all of these itself
    (f"{SCENE} --bend 1e6", "--bend"), (f"{SCENE} --relative", "--relative"), (f"{WITH_INERTIA} marks.npz", "--rate"),
    (f"{WITH_INERTIA} marks.npz --rate 9 --drag -1", "--drag"), (f"{WITH_INERTIA} move.npz", "time_s"),
    (f"{WITH_INERTIA} turn.csv", "end_rotation"), (f"{WITH_INERTIA} marks.npz --rate 9 --smoothing 3", "--smoothing")])
def test_wrong_input_is_one_line(folder, capsys, words, said):
    np.savez("metres.npz", end_position_mm=[[90.0, 0, 0], [90000.0, 0, 0]])
    refused(capsys, folder, words if "--out" in words else f"{words} --out f.npz", said)


def write_theta(length: float = 100.0, **changes) -> None:
    """The file theta.json as doo-ti identify writes it, of a rod of twenty edges."""
    rest = 1e-3 * np.array([[1.5, -1.0], [0.8, 0.6]])
    theta = MotionTheta(6e5, 1 / 6, 0.02, 0.5, 1e-4, 0.0, rest, np.full(20, length / 20), np.array([0.0, 1.0, 0.0]))
    Path("theta.json").write_text(json.dumps(plain(save_form(replace(theta, **changes)))))


@pytest.mark.thorough
def test_rods_with_inertia(folder, capsys):
    """Are those of simulate: the same rods at the start, which are later elsewhere."""
    write_theta()
    given = "seen.npz --motion marks.npz --theta theta.json --out f.npz"
    still = made(f"predict {given}")["vertices_mm"]
    assert "damping, drag and markers are ignored" in capsys.readouterr().err
    found, (out, err) = made(f"simulate {given} --rate 2000"), capsys.readouterr()
    assert "at 2000 frames/s" in out and "damping, drag and markers are used" in err
    assert found["positions_mm"].shape == (2, 5, *still.shape[2:]) and (found["status"] == 0).all()
    np.testing.assert_allclose(found["positions_mm"][:, 0], still[0], atol=1e-3)
    assert np.abs(found["positions_mm"].swapaxes(0, 1) - still).max() > 0.1
    adapted = made(f"simulate {given} --rate 2000 --bend-damping 0.2 --tolerance 0.1")
    assert np.abs(adapted["positions_mm"] - found["positions_mm"]).max() > 0.01
    assert adapted["substeps"].shape == (2,) and (adapted["step_error_mm"] <= 0.1).all()


def test_times_of_a_motion_are_kept_and_forces_are_in_newton(folder, capsys):
    end = written("seen.npz")["vertices_mm"][0, -1]
    np.savez("slow.npz", time_s=[0.0, 1.0, 2.0], end_position_mm=end + np.array([[0, 0, 0], [-1.0, 0, 0], [-2.0, 0, 0]]))
    command = "predict seen.npz --motion slow.npz --EI 1e-4 --GJ 1e-4 --linear-density 10 --out f.npz"
    found, out = made(command), capsys.readouterr().out
    assert "inertia" not in out
    newton = 0.01 * 9.80665 / 2 / 1000  # half the weight of a millimetre
    np.testing.assert_allclose(found["end_force_N"], newton * found["end_force"], rtol=1e-9)
    assert f"{np.linalg.norm(found['end_force_N'][-1], axis=-1).min():.3g}" in out and " N on the rod at the end" in out
    (_, found), = force_rows({"end_force_N": np.array([[[0, 0, 0.1]], [[-0.5, 0, 0]]])}, 1)
    assert "0.5 N (-0.5, 0, 0) on the rod" in found, "a clamp that pushes"


def test_swift_motions_say_that_inertia_is_left_out(folder, capsys):
    """An end that moves by 5 mm (1 − cos) in half a second, at 20 rad/s at most: with 2 m/s², a fifth of gravity."""
    time, seen = np.arange(26) / 50.0, written("seen.npz")["vertices_mm"][0, -1]
    np.savez("swift.npz", time_s=time, end_position_mm=seen - 5.0 * (1 - np.cos(20 * time))[:, None] * [1, 0, 0])
    printed = succeeded(capsys, words("seen.npz", "swift.npz"))
    assert re.search(r"inertia +left out; rods accelerate by up to 0\.[12]\d? of gravity", printed)


def test_clamps_inside_an_obstacle_are_said(folder, capsys):
    Path("under.toml").write_text('obstacles = [{ kind = "plane", point = [0, 0, -900], normal = [0, 0, -1] }]')
    np.savez("still.npz", time_s=[0.0, 1.0], end_position_mm=np.load("seen.npz")["vertices_mm"][0, [-1, -1]])
    command = "predict seen.npz --motion still.npz --bend 1e5 --precision f64 --obstacles under.toml --radius 1 --out f.npz"
    assert "mm inside a Plane" in ended(capsys, command, 1)[0]


def test_rest_curvature_of_a_theta(folder, capsys):
    """relax uses it at the joints of the observed rods; a theta of another length is refused."""
    write_theta()
    found = made("relax seen.npz --theta theta.json --out r.npz")
    assert "rest curvature are used" in capsys.readouterr().err
    seen, theta = d.load_observations("seen.npz"), load_theta("theta.json")
    clamps = d.observation_clamps(seen)
    expected = d.relax(d.start_configuration(seen, clamps), d.Material(6e5, 1e5, 1.0, theta.rest_curvature[None]), clamps)
    np.testing.assert_allclose(found["vertices_mm"], expected.configuration.vertices, atol=1e-9)
    write_theta(130.0)
    refused(capsys, folder, "relax seen.npz --theta theta.json --out r.npz", "rest_length_mm")


def test_the_friction_of_theta_is_named(folder, capsys):
    write_theta(friction=0.3, rest=np.zeros((2, 1)))
    err = ended(capsys, "predict seen.npz --motion marks.npz --theta theta.json --out f.npz")[1]
    assert "markers are ignored; its friction of 0.3 is ignored without obstacles" in err
