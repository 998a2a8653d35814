"""Motion files: poses over time from npz and tables, orientations in all usual forms, units, names, and errors in them."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from doo_ti import Clamp, Clamps, load_path
from doo_ti.io.motion_file import ClampPath, path_of_marks
from doo_ti.io.pose_table import holds_poses
from tests.conftest import check_refused

QUARTER = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])


def held(count: int = 1) -> Clamps:
    places = np.zeros((count, 3)), np.tile([50.0, 0, 0], (count, 1))
    return Clamps(Clamp.FRAME, Clamp.FRAME, *places, np.tile(np.eye(3), (count, 1, 1)), np.tile(np.eye(3), (count, 1, 1)))


def test_csv_holds_the_same(tmp_path):
    file = tmp_path / "motion.csv"
    columns = [f"end_frame_{director}_{axis}" for axis in "xyz" for director in ("t", "m1", "m2")]
    rows = [[0, 50, 0, 0, 0, *np.eye(3).ravel()], [1, 45, 1, 0, 360, *QUARTER.ravel()]]
    names = ["time_s", "end_x_mm", "end_y_mm", "end_z_mm", "end_rotation_deg", *columns]
    file.write_text("\n".join(",".join(map(str, row)) for row in [names, *rows]), encoding="utf-8")
    path = load_path(file)
    np.testing.assert_array_equal(path.end_frame[1, 0], QUARTER)
    np.testing.assert_array_equal(path.end_position[:, 0], [[50, 0, 0], [45, 1, 0]])
    assert path.rotation(0, 3) == pytest.approx([2 * np.pi] * 3)


def test_a_rotation_alone_turns_the_frame_it_finds_and_beside_frames_determines_half_a_turn(tmp_path):
    file = tmp_path / "motion.csv"
    file.write_text("end_rotation_deg\n0\n840\n", encoding="utf-8")
    path = load_path(file)
    assert path.time.tolist() == [0, 1]
    frame = path.at(1, held()).end_frame[0]
    np.testing.assert_allclose(frame[:, 1], [0, np.cos(np.radians(120)), np.sin(np.radians(120))], atol=1e-12)
    assert np.degrees(path.rotation(0, 1)) == pytest.approx([840])
    frames = np.stack([np.eye(3), np.diag([1.0, -1, -1])])[:, None]
    path = ClampPath(np.arange(2.0), end_frame=frames, end_rotation=np.array([[0.0], [-np.pi]]))
    assert path.rotation(0, 1) == pytest.approx([-np.pi])


def test_marks_give_positions_and_tangents(tmp_path):
    marks = np.zeros((4, 5, 3))
    marks[..., 0] = 10.0 * np.arange(5)
    marks[:, -1, 2] = np.arange(4)
    np.savez(tmp_path / "one.npz", positions_mm=marks, rate_hz=10.0)
    np.savez(tmp_path / "two.npz", positions_mm=np.stack([marks, marks + 1]))
    one, two = load_path(tmp_path / "one.npz"), load_path(tmp_path / "two.npz")
    assert one.tangents_only and one.count == 1 and two.count == 2 and two.moments == 4
    np.testing.assert_allclose(one.time, [0, 0.1, 0.2, 0.3])
    np.testing.assert_allclose(one.end_frame[2, 0, :, 0], np.array([10, 0, 2]) / np.hypot(10, 2))
    np.testing.assert_array_equal(two.end_position[:, 1], marks[:, -1] + 1)
    check_refused("coincide", path_of_marks, np.zeros((2, 1, 3, 3)))


@pytest.mark.parametrize("keys, word", [
    ({"time_s": [0.0, 0.0], "end_rotation_deg": [0.0, 1.0]}, "rising"), ({"end_rotation_deg": [0.0]}, "two or more"),
    ({"time_s": [0.0, 1.0]}, "nothing moves"), ({"end_position_mm": np.zeros((3, 2))}, "shape"),
    ({"end_position_mm": np.zeros((3, 3)), "time_s": np.arange(2.0)}, "shape"),
    ({"end_position_mm": np.array([[0.0, 0, np.nan], [0, 0, 0]])}, "finite"),
    ({"end_frame": np.ones((2, 3, 3))}, "not a rotation"),
    ({"end_frame": np.stack([np.eye(3), np.diag([1.0, -1, -1])])}, "half a turn"),
    ({"end_frame": np.stack([np.eye(3), np.eye(3)]), "end_rotation_deg": [0.0, 90.0]}, "end_frame turns by 0"),
    ({"positions_mm": np.zeros((2, 2, 3))}, "positions_mm"),
    ({"positions_mm": np.arange(36.0).reshape(3, 4, 3), "time_s": np.arange(2.0)}, "time_s"),
    ({"positions_mm": 1e6 * np.arange(36.0).reshape(3, 4, 3)}, "start_position.* within 1e\\+06 mm"),
    ({"end_rotation_deg": [0.0, 2.0**32]}, "end_rotation: .* rad"), ({"else": np.zeros(3)}, "end_position_mm"),
    ({"end_position_mm": np.array(["a"])}, "numeric")])
def test_wrong_files_are_named(tmp_path, keys, word):
    file = tmp_path / "motion.npz"
    np.savez(file, **keys)
    check_refused(f"motion.npz: .*{word}", load_path, file)


TURNS = Rotation.from_euler("xyz", [[0.1, -0.4, 0.9], [0.3, -0.2, 1.0], [0.5, 0.1, 1.4]])
PLACES = np.array([[50.0, 0, 1], [52, 3, 1], [54, 5, 0]])
FORMS = {
    "quaternion": (["qw", "qx", "qy", "qz"], np.roll(TURNS.as_quat(), 1, axis=1)),
    "messages": (["pose.orientation.x", "pose.orientation.y", "pose.orientation.z", "pose.orientation.w"], -TURNS.as_quat()),
    "rotation vector": (["rx", "ry", "rz"], TURNS.as_rotvec()),
    "degrees": (["rx_deg", "ry_deg", "rz_deg"], np.degrees(TURNS.as_rotvec())),
    "turns": (["Roll", "Pitch", "Yaw"], TURNS.as_euler("xyz")),
    "turns in degrees": (["roll_deg", "pitch_deg", "yaw_deg"], np.degrees(TURNS.as_euler("xyz")))}


def written(folder, names, values, name: str = "x.csv"):
    (folder / name).write_text("\n".join([",".join(names), *[",".join(map(repr, row)) for row in np.asarray(values).tolist()]]))
    return folder / name


@pytest.mark.parametrize("prefix", ["end_", "end.", ""])
@pytest.mark.parametrize("form", FORMS)
def test_orientations(tmp_path, form, prefix):
    names, values = FORMS[form]
    time = 10.0 + 0.5 * np.arange(3)[:, None]
    own = [f"{prefix}{name}" for name in ("x_m", "y_m", "z_m", *names)]
    file = written(tmp_path, ["Time", *own, "force"], np.hstack([time, 1e-3 * PLACES, values, 0 * time]))
    path = load_path(file)
    np.testing.assert_allclose(path.end_frame[:, 0], TURNS.as_matrix(), atol=1e-12)
    np.testing.assert_allclose(path.end_position[:, 0], PLACES)
    assert path.start_frame is None and path.time.tolist() == [10, 10.5, 11]
    np.testing.assert_allclose(load_path(file, unit="cm").end_position[:, 0], 1e-2 * PLACES)
    tool = load_path(file, axes=("x", "-y")).end_frame[:, 0]
    np.testing.assert_allclose(tool[..., 0], -TURNS.as_matrix()[..., 1], atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(tool), 1.0)
    quarter = Rotation.from_euler("x", 90, degrees=True).as_matrix()
    turned = load_path(file, turn=quarter)
    np.testing.assert_allclose(turned.end_position[:, 0], PLACES @ quarter.T, atol=1e-12)
    np.testing.assert_allclose(turned.end_frame[:, 0], quarter @ TURNS.as_matrix(), atol=1e-12)


def test_quaternions_of_an_npz(tmp_path):
    np.savez(tmp_path / "x.npz", end_quaternion=np.roll(TURNS.as_quat(), 1, axis=1))
    np.testing.assert_allclose(load_path(tmp_path / "x.npz").end_frame[:, 0], TURNS.as_matrix(), atol=1e-12)
    assert holds_poses(tmp_path / "x.npz")
    np.savez(tmp_path / "y.npz", positions_mm=np.zeros((3, 5, 3)), start_position_mm=PLACES)
    assert not holds_poses(tmp_path / "y.npz")


def test_a_path_at_equal_intervals(tmp_path):
    """Of positions that are linear in time, and turns about one axis."""
    time = np.array([0.0, 0.1, 0.35, 0.4, 1.0])
    values = np.hstack([time[:, None], np.outer(time, [10.0, -20.0, 5.0]), np.outer(time, [0, 0, 1.2])])
    path = load_path(written(tmp_path, ["time_s", "x", "y", "z", "rx", "ry", "rz"], values)).resampled(20.0)
    np.testing.assert_allclose(path.time, np.arange(21) / 20)
    np.testing.assert_allclose(path.end_position[:, 0], np.outer(path.time, [10.0, -20.0, 5.0]), atol=1e-9)
    np.testing.assert_allclose(Rotation.from_matrix(path.end_frame[:, 0]).as_rotvec()[:, 2], 1.2 * path.time, atol=5e-3)
    check_refused("time_s", path.resampled, 1e9)


@pytest.mark.parametrize("names, values, options, said", [
    (["end_qw", "end_qx", "end_qy", "end_qz"], [[1.0, 0, 0, 0], [2, 0, 0, 0]], {}, "row 1 has a quaternion of length 2"),
    (["end_qx", "end_qy", "end_qz"], np.zeros((2, 3)), {}, "end_qw: the column is missing"),
    (["end_x_m", "end_z_m"], np.zeros((2, 2)), {}, "end_y_m: the column is missing"),
    (["end_rx", "end_ry", "end_rz", "end_roll", "end_pitch", "end_yaw"], np.zeros((2, 6)), {}, "rotation vector and as turns"),
    (["end_roll", "end_pitch", "end_yaw"], [[0.0, 0, 0], [0, 0, 60]], {}, "end_yaw: 60 rad, more than a turn"),
    (["time", "speed"], np.zeros((2, 2)), {}, "speed"),
    (["end_x", "end_y", "end_z", "end_rotaton_deg"], np.zeros((2, 4)), {}, "rotaton"),
    (["x", "y", "z"], PLACES, {"unit": "inch"}, "load_path: unit: "),
    (["x", "y", "z"], PLACES, {"axes": ("x", "w")}, "load_path: axes: ")])
def test_what_does_not_fit_is_named(tmp_path, names, values, options, said):
    check_refused(said, load_path, written(tmp_path, names, values), **options)
