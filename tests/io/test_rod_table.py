"""Results as CSV: every array in its column, in the row of the vertex, edge, rod or moment that it belongs to."""

import numpy as np
import pyarrow.csv

from doo_ti.io.observation_files import load_observations
from doo_ti.io.observation_tables import write_rod_table


def written(path, arrays: dict, axes: tuple[str, ...]) -> tuple[dict, list[str]]:
    with open(path, "wb") as file:
        left_out = write_rod_table(file, arrays, axes)
    table = pyarrow.csv.read_csv(path)
    return {name: table.column(name).to_numpy(zero_copy_only=False) for name in table.column_names}, left_out


def test_rods_of_one_axis_are_observations_again(tmp_path, rng):
    """As many rods as edges: names, not shapes alone, tell what an array belongs to."""
    rods, marks = 4, 5
    turns = np.linalg.qr(rng.normal(size=(rods, marks - 1, 3, 3)))[0]
    turns[..., 2] *= np.linalg.det(turns)[..., None]
    arrays = {
        "vertices_mm": rng.normal(size=(rods, marks, 3)), "rest_length_mm": rng.uniform(1, 2, 4), "frames": turns,
        "valid": rng.random((rods, marks)) < 0.9, "up": np.array([0.0, 1.0, 0.0]), "energy": rng.normal(size=rods),
        "camera_error_px": rng.random((rods, 3)), "unsupported": rng.random((rods, marks - 1)) < 0.5,
        "runner_up_mm": rng.normal(size=(rods, 2, marks, 3)), "name": np.array([f"rod {k}" for k in range(rods)])}
    columns, left_out = written(tmp_path / "x.csv", arrays, ("observation",))
    assert left_out == ["runner_up_mm"] and len(columns["x_mm"]) == rods * marks
    np.testing.assert_array_equal(columns["energy"], np.repeat(arrays["energy"], marks))
    np.testing.assert_array_equal(columns["name"][::marks], arrays["name"])
    np.testing.assert_array_equal(columns["camera_error_px_1"][::marks], arrays["camera_error_px"][:, 1])
    np.testing.assert_array_equal(columns["unsupported"].reshape(rods, marks)[:, :-1], arrays["unsupported"])
    observations = load_observations(tmp_path / "x.csv")
    for name, key in (("vertices", "vertices_mm"), ("rest_length", "rest_length_mm"), ("up", "up"), ("valid", "valid"),
                      ("frames", "frames")):
        np.testing.assert_array_equal(getattr(observations, name), arrays[key])


def test_rods_at_moments(tmp_path, rng):
    """(T, R): times belong to moments, materials to rods."""
    shape = (3, 3, 4)
    arrays = {"time_s": np.array([0.0, 0.5, 2.0]), "vertices_mm": rng.normal(size=(*shape, 3)),
              "energy": rng.normal(size=shape[:2]), "bend": np.array([1.0, 2, 3]), "end_force": rng.normal(size=(3, 3, 3))}
    columns, left_out = written(tmp_path / "x.csv", arrays, ("moment", "rod"))
    assert not left_out
    grid = {name: values.reshape(shape) for name, values in columns.items()}
    for moment, rod, vertex in np.ndindex(*shape):
        at = moment, rod, vertex
        assert (grid["moment"][at], grid["rod"][at], grid["vertex"][at]) == at
        assert grid["time_s"][at] == arrays["time_s"][moment] and grid["bend"][at] == arrays["bend"][rod]
        assert grid["energy"][at] == arrays["energy"][moment, rod] and grid["y_mm"][at] == arrays["vertices_mm"][at][1]
        assert grid["end_force_z"][at] == arrays["end_force"][moment, rod, 2]
