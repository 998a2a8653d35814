"""Tables of observations and results, CSV and Parquet; the reader of CSV files and the names in its messages."""

import re

import numpy as np
import pyarrow
import pyarrow.csv
import pyarrow.parquet
import pytest
from scipy.spatial.transform import Rotation

from doo_ti import InputError, Observations, load_observations, save_observations
from doo_ti.commands.loading import read_rest_length
from doo_ti.io.arrays import read_csv
from doo_ti.io.observation_tables import write_rod_table
from tests.conftest import check_refused
from tests.io.rods import wavy_vertices
from tests.io.test_observations import full_keys, same

SUFFIXES = (".csv", ".parquet")


def write(path, columns: dict) -> None:
    (pyarrow.csv.write_csv if path.suffix == ".csv" else pyarrow.parquet.write_table)(pyarrow.table(columns), str(path))


@pytest.mark.parametrize("suffix", (*SUFFIXES, ".npz"))
def test_files_are_lossless(tmp_path, rng, suffix):
    for _ in range(5):
        np.savez(tmp_path / "x.npz", **full_keys(rng))
        observations = load_observations(tmp_path / "x.npz")
        save_observations(tmp_path / f"y{suffix}", observations)
        assert same(observations, load_observations(tmp_path / f"y{suffix}"), 1e-14)
        assert sorted(path.name for path in tmp_path.iterdir()) == ["x.npz", f"y{suffix}"]


def test_one_sigma_stays_one_number(tmp_path, rng):
    save_observations(tmp_path / "x.csv", Observations(wavy_vertices(rng), sigma=0.12))
    assert load_observations(tmp_path / "x.csv").sigma.shape == ()


def test_frames_may_be_quaternions(tmp_path, rng):
    """Against SciPy, in a table and in an npz; not beside frames."""
    turns, marks = Rotation.random(2, rng=rng), wavy_vertices(rng)[:2]
    scalar_first = turns.as_quat()[:, [3, 0, 1, 2]]
    np.savez(tmp_path / "x.npz", vertices_mm=marks, start_quaternion=scalar_first)
    first = np.arange(marks.shape[1]) == 0
    columns = {"observation": np.repeat([0, 1], len(first)), "vertex": np.tile(np.arange(len(first)), 2)}
    columns |= {f"{axis}_mm": marks[..., k].ravel() for k, axis in enumerate("xyz")}
    columns |= {f"start_q{part}": np.where(first, scalar_first[:, k, None], np.nan).ravel() for k, part in enumerate("wxyz")}
    write(tmp_path / "x.csv", columns)
    for name in ("x.npz", "x.csv"):
        np.testing.assert_allclose(load_observations(tmp_path / name).start_frame, turns.as_matrix(), atol=1e-12)
    np.savez(tmp_path / "y.npz", vertices_mm=marks, start_quaternion=scalar_first, start_frame=turns.as_matrix())
    check_refused("start_quaternion", load_observations, tmp_path / "y.npz")


def test_a_plain_csv_written_by_hand(tmp_path):
    rows = ["vertex,observation,z_mm,x_mm,y_mm,valid,total_twist_deg,comment"]
    rows += ["2,7,0.5,6,0,1,90,x", "1,7,,,,0,,missing", "0,7,0,0,0,1,90,", "3,7,0,9,0,true,90,"]
    rows += [f"{v},3,0,{3 * v},0,1,-30," for v in range(4)]
    (tmp_path / "x.csv").write_text("\n".join(rows).replace("true", "1"))
    observations = load_observations(tmp_path / "x.csv")
    np.testing.assert_array_equal(observations.vertices[0, :, 0], [0, 3, 6, 9])
    np.testing.assert_array_equal(observations.valid[1], [True, False, True, True])
    np.testing.assert_allclose(observations.total_twist, np.radians([-30, 90]))
    np.testing.assert_array_equal(observations.vertices[1, 2], [6, 0, 0.5])


def table(rng) -> dict[str, list]:
    vertices = wavy_vertices(rng, count=2, marks=4)
    columns = {"observation": [0] * 4 + [1] * 4, "vertex": [0, 1, 2, 3] * 2}
    columns |= {f"{axis}_mm": vertices[..., k].ravel().tolist() for k, axis in enumerate("xyz")}
    return columns | {"rest_length_mm": [3.0, 3.0, 3.0, None] * 2, "total_twist_deg": [10.0] * 8}


def change(columns: dict, name: str, row: int, value) -> None:
    columns[name] = [*columns[name][:row], value, *columns[name][row + 1 :]]


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("edit, field, problem", [
    (lambda c: c.pop("y_mm"), "y_mm", "the column is missing"),
    (lambda c: change(c, "vertex", 2, 1), "vertex", "observation 0"),
    (lambda c: change(c, "vertex", 0, -1), "vertex", "observation 0"),
    (lambda c: change(c, "vertex", 2, 1.5), "vertex", "not a whole number"),
    (lambda c: c.update(x_mm=["three"] * 8), "x_mm", "'three' in"),
    (lambda c: [change(c, "x_mm", row, None) for row in (4, 5, 6)], "vertices_mm", "observation 1"),
    (lambda c: (c.update(valid=[1] * 8), change(c, "x_mm", 6, None)), "vertices_mm", "observation 1, vertex 2"),
    (lambda c: change(c, "vertex", 7, 10**12), "vertex", "1000000000000"),
    (lambda c: (c.pop("vertex"), [values.pop() for values in c.values()]), "vertex", "observation 1"),
    (lambda c: change(c, "total_twist_deg", 6, 11.0), "total_twist_deg", "observation 1"),
    (lambda c: change(c, "rest_length_mm", 5, 4.0), "rest_length_mm", "observation 1"),
    (lambda c: c.update(start_frame_t_x=[1.0] * 8), "start_frame_m1_x", "missing beside")])
def test_wrong_tables_are_named(tmp_path, rng, edit, field, problem, suffix):
    columns, path = table(rng), tmp_path / f"bad{suffix}"
    edit(columns)
    write(path, columns)
    check_refused(f"^{re.escape(f'{path}: {field}: ')}.*{re.escape(problem)}", load_observations, path)


def remove(columns: dict) -> None:
    """The rows of two marks: the first of one observation, the last of the other."""
    for values in columns.values():
        del values[7], values[0]


GAPS = {"no row": remove, "empty": lambda c: [change(c, f"{axis}_mm", row, None) for row in (0, 7) for axis in "xyz"],
        "one coordinate": lambda c: [change(c, "y_mm", row, None) for row in (0, 7)],
        "nan": lambda c: [change(c, "y_mm", row, np.nan) for row in (0, 7)],
        "no row, valid": lambda c: (c.update(valid=[1] * 8), remove(c)),
        "empty, valid": lambda c: (c.update(valid=[None, *[1] * 6, None]), GAPS["one coordinate"](c))}


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("case", GAPS)
def test_marks_may_be_missing_in_any_usual_way(tmp_path, rng, case, suffix):
    """Without a column `valid`, or beside it; values of an observation are in the rows that are left."""
    columns = table(rng)
    whole = np.stack([np.reshape(columns[f"{axis}_mm"], (2, 4)) for axis in "xyz"], axis=-1)
    GAPS[case](columns)
    path = tmp_path / f"gaps{suffix}"
    write(path, columns)
    found = load_observations(path)
    np.testing.assert_array_equal(found.valid, [[False, True, True, True], [True, True, True, False]])
    assert np.isnan(found.vertices[~found.valid]).all() and (found.vertices[found.valid] == whole[found.valid]).all()
    np.testing.assert_allclose(found.total_twist, np.radians([10, 10]))
    np.testing.assert_array_equal(found.rest_length, 3.0)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_observations_keep_what_the_file_calls_them(tmp_path, rng, suffix):
    """In messages, and in files that are written from them."""
    columns, path = table(rng) | {"observation": [8] * 4 + [3] * 4}, tmp_path / f"frames{suffix}"
    write(path, columns)
    found = load_observations(path)
    assert found.labels.tolist() == [3, 8] and found.take([1]).labels.tolist() == [8]
    for other in (".npz", ".csv", ".parquet"):
        save_observations(tmp_path / f"again{other}", found)
        assert load_observations(tmp_path / f"again{other}").labels.tolist() == [3, 8]
    with pytest.raises(InputError, match="vertices 0 and 1 of observation 8 coincide"):
        Observations(np.where(np.arange(2)[:, None, None] == 1, 0.0, found.vertices), labels=found.labels)


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


def test_cells_are_read_as_written(tmp_path):
    """Spaces, quotes, blank lines, a byte order mark and lines at the top that begin with a number sign are no part of the
    cells; lines count as in an editor."""
    path = tmp_path / "x.csv"
    path.write_bytes('\ufeffname, x \r\n"a, b",1\r\n\r\n,\r\n c ,2e3\r\n'.encode())
    table = read_csv(path, ("name", "x"))
    assert table.columns["name"] == ["a, b", "c"] and table.lines == [2, 5]
    np.testing.assert_array_equal(table.numbers("x"), [1, 2000])
    np.testing.assert_array_equal(table.whole("x"), [1, 2000])
    table = read_csv(path, ("a", "b"), content=b"# written by some tool, in mm\n#\na,b\n1,2\n")
    assert table.numbers("b").tolist() == [2.0] and table.lines == [4]


def test_missing_numbers_truth_and_short_lines_where_they_are_allowed(tmp_path):
    table = read_csv(tmp_path / "x.csv", ("x",), content=b"x\n1.5\nNA\ntrue\nFalse\nNaN\n")
    np.testing.assert_array_equal(table.numbers("x", may_be_empty=True), [1.5, np.nan, 1, 0, np.nan])
    assert read_csv(tmp_path / "x.csv", ("a",), short_lines=True, content=b"a,b\n1\n").columns == {"a": ["1"], "b": [""]}


SPREADSHEET = "name;x;maße\nsilk;1,5;-2e-3\n\"a;b\";-,25;3,0\n"


@pytest.mark.parametrize("content", [
    SPREADSHEET.encode(), SPREADSHEET.encode("utf-8-sig"), SPREADSHEET.encode("cp1252"), SPREADSHEET.encode("utf-16"),
    b"sep=;\r\n" + SPREADSHEET.encode("cp1252"), SPREADSHEET.replace(";", "\t").replace("a\tb", "a;b").encode("utf-16")])
def test_spreadsheets_with_decimal_commas(tmp_path, content):
    """As they are written where decimals are behind a comma: cells between semicolons or tabs, in several encodings."""
    table = read_csv(tmp_path / "x.csv", ("name", "x", "maße"), content=content)
    assert table.columns["name"] == ["silk", "a;b"]
    np.testing.assert_array_equal(table.numbers("x"), [1.5, -0.25])
    np.testing.assert_array_equal(table.rows(np.array([False, True])).numbers("maße"), [3.0])


def test_points_and_commas_before_decimals_are_not_mixed(tmp_path):
    """1.234 beside 1,5 is one thousand, or a mistake."""
    check_refused("y: '1.234' in line 2", read_csv(tmp_path / "x.csv", ("x", "y"), content=b"x;y\n1,5;1.234\n").numbers, "y")
    np.testing.assert_array_equal(read_csv(tmp_path / "x.csv", ("x",), content=b"x;y\n1.5;1.234\n").numbers("y"), [1.234])


@pytest.mark.parametrize("content, field", [
    (b"\xff\xfe\xfa", "file"), (b"a,b\n", "file"), (b"", "a"), (b"a\n1\n", "b"), (b"a,b,d\n1,2,3\n", "d"),
    (b"a,b,b\n1,2,3\n", "b"), (b"a,b\n1,2\n1,2,3\n", "line 3"), (b"a,b\n1,2\n1\n", "line 3"),
    (b'a,b\n1,"2\n3,4\n', "file"), (b'a,b\n1,"2\n3"\n', "line 3")])
def test_wrong_files_are_named(tmp_path, content, field):
    check_refused(f"x.csv: {field}: ", read_csv, tmp_path / "x.csv", ("a", "b"), ("c",), content=content)


@pytest.mark.parametrize("cell", ["", "x", "nan", "inf", "1,5"])
def test_a_cell_that_is_no_number_is_named_with_its_line(tmp_path, cell):
    table = read_csv(tmp_path / "x.csv", ("a",), content=f'a\n1\n\n"{cell}"\n'.encode() if cell else b"a,b\n1,\n\n,2\n")
    check_refused(f": a: {cell!r}.* line 4", table.numbers, "a")
    check_refused("'1.5' in line 3", read_csv(tmp_path / "x.csv", ("a",), content=b"a\n1\n1.5\n").whole, "a")


def test_lengths_with_decimal_commas_are_not_taken_for_two(tmp_path):
    (tmp_path / "x.txt").write_text("2,5\n2,5\n")
    check_refused("'2,5' is one number, or two", read_rest_length, str(tmp_path / "x.txt"))
    for text in ("2.5 3\n2.5", "2.5;3;2.5", "2.5,3,2.5", "2.5, 3\n2.5"):
        (tmp_path / "x.txt").write_text(text)
        assert read_rest_length(str(tmp_path / "x.txt")).tolist() == [2.5, 3, 2.5]
