"""Motion files: poses over time from npz and CSV, and errors in them."""

import numpy as np
import pytest

from doo_ti import Clamp, Clamps, InputError
from doo_ti.io.motion_file import ClampPath, load_path, path_of_marks

QUARTER = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])


def held(count: int = 1) -> Clamps:
    places = np.zeros((count, 3)), np.tile([50.0, 0, 0], (count, 1))
    return Clamps(Clamp.FRAME, Clamp.FRAME, *places, np.tile(np.eye(3), (count, 1, 1)), np.tile(np.eye(3), (count, 1, 1)))


def test_npz(tmp_path):
    file = tmp_path / "motion.npz"
    end = np.array([[50.0, 0, 0], [45.0, 1, 0], [40.0, 2, 0]])
    np.savez(file, time_s=[0.0, 0.5, 2.0], end_position_mm=end, end_frame=np.stack([np.eye(3), QUARTER, QUARTER @ QUARTER]))
    path = load_path(file)
    assert path.moments == 3 and path.count == 1 and path.time.tolist() == [0, 0.5, 2] and not path.tangents_only
    clamps = path.at(1, held(2))
    np.testing.assert_array_equal(clamps.end_position, np.tile(end[1], (2, 1)))
    np.testing.assert_array_equal(clamps.end_frame, np.tile(QUARTER, (2, 1, 1)))
    np.testing.assert_array_equal(clamps.start_position, held(2).start_position)


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


def test_a_rotation_alone_turns_the_frame_it_finds(tmp_path):
    file = tmp_path / "motion.csv"
    file.write_text("end_rotation_deg\n0\n840\n", encoding="utf-8")
    path = load_path(file)
    assert path.time.tolist() == [0, 1]
    frame = path.at(1, held()).end_frame[0]
    np.testing.assert_allclose(frame[:, 1], [0, np.cos(np.radians(120)), np.sin(np.radians(120))], atol=1e-12)
    assert np.degrees(path.rotation(0, 1)) == pytest.approx([840])


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
    with pytest.raises(InputError, match="coincide"):
        path_of_marks(np.zeros((2, 1, 3, 3)))


@pytest.mark.parametrize("keys, word", [
    ({"time_s": [0.0, 0.0], "end_rotation_deg": [0.0, 1.0]}, "rising"),
    ({"end_rotation_deg": [0.0]}, "two or more"),
    ({"time_s": [0.0, 1.0]}, "nothing moves"),
    ({"end_position_mm": np.zeros((3, 2))}, "shape"),
    ({"end_position_mm": np.zeros((3, 3)), "time_s": np.arange(2.0)}, "shape"),
    ({"end_position_mm": np.array([[0.0, 0, np.nan], [0, 0, 0]])}, "finite"),
    ({"end_frame": np.ones((2, 3, 3))}, "not a rotation"),
    ({"end_frame": np.stack([np.eye(3), np.diag([1.0, -1, -1])])}, "half a turn"),
    ({"end_frame": np.stack([np.eye(3), np.eye(3)]), "end_rotation_deg": [0.0, 90.0]}, "end_frame turns by 0"),
    ({"positions_mm": np.zeros((2, 2, 3))}, "positions_mm"),
    ({"positions_mm": np.arange(36.0).reshape(3, 4, 3), "time_s": np.arange(2.0)}, "time_s"),
    ({"else": np.zeros(3)}, "end_position_mm"),
    ({"end_position_mm": np.array(["a"])}, "numeric"),
])
def test_wrong_files_are_named(tmp_path, keys, word):
    file = tmp_path / "motion.npz"
    np.savez(file, **keys)
    with pytest.raises(InputError, match=word) as raised:
        load_path(file)
    assert "motion.npz" in str(raised.value)


def test_half_a_turn_is_determined_by_the_given_rotation():
    frames = np.stack([np.eye(3), np.diag([1.0, -1, -1])])[:, None]
    path = ClampPath(np.arange(2.0), end_frame=frames, end_rotation=np.array([[0.0], [-np.pi]]))
    assert path.rotation(0, 1) == pytest.approx([-np.pi])
