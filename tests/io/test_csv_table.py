"""The reader of CSV files: accepted input, and the names in its messages."""

import numpy as np
import pytest

from doo_ti.commands.loading import read_rest_length
from doo_ti.io.arrays import read_csv
from tests.conftest import check_refused


def test_cells_are_read_as_written(tmp_path):
    """Spaces, quotes, blank lines and a byte order mark are no part of the cells; lines count as in an editor."""
    path = tmp_path / "x.csv"
    path.write_bytes('\ufeffname, x \r\n"a, b",1\r\n\r\n,\r\n c ,2e3\r\n'.encode())
    table = read_csv(path, ("name", "x"))
    assert table.columns["name"] == ["a, b", "c"] and table.lines == [2, 5]
    np.testing.assert_array_equal(table.numbers("x"), [1, 2000])
    np.testing.assert_array_equal(table.whole("x"), [1, 2000])


def test_missing_numbers_and_truth(tmp_path):
    table = read_csv(tmp_path / "x.csv", ("x",), content=b"x\n1.5\nNA\ntrue\nFalse\nNaN\n")
    np.testing.assert_array_equal(table.numbers("x", may_be_empty=True), [1.5, np.nan, 1, 0, np.nan])


def test_short_lines_where_they_are_allowed(tmp_path):
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
    table = read_csv(tmp_path / "x.csv", ("x", "y"), content=b"x;y\n1,5;1.234\n")
    check_refused("y: '1.234' in line 2", table.numbers, "y")
    np.testing.assert_array_equal(read_csv(tmp_path / "x.csv", ("x",), content=b"x;y\n1.5;1.234\n").numbers("y"), [1.234])


WRONG = {
    "not text": (b"\xff\xfe\xfa", "file"), "no rows": (b"a,b\n", "file"), "empty": (b"", "a"), "missing": (b"a\n1\n", "b"),
    "unknown": (b"a,b,d\n1,2,3\n", "d"), "twice": (b"a,b,b\n1,2,3\n", "b"), "long line": (b"a,b\n1,2\n1,2,3\n", "line 3"),
    "short line": (b"a,b\n1,2\n1\n", "line 3"), "open quote": (b'a,b\n1,"2\n3,4\n', "file"),
    "line break": (b'a,b\n1,"2\n3"\n', "line 3")}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_files_are_named(tmp_path, case):
    content, field = WRONG[case]
    check_refused(f"x.csv: {field}: ", read_csv, tmp_path / "x.csv", ("a", "b"), ("c",), content=content)


@pytest.mark.parametrize("cell", ["", "x", "nan", "inf", "1,5"])
def test_a_cell_that_is_no_number_is_named_with_its_line(tmp_path, cell):
    table = read_csv(tmp_path / "x.csv", ("a",), content=f'a\n1\n\n"{cell}"\n'.encode() if cell else b"a,b\n1,\n\n,2\n")
    check_refused(f": a: {cell!r}.* line 4", table.numbers, "a")


def test_lines_that_begin_with_a_number_sign_are_left_out_at_the_top(tmp_path):
    table = read_csv(tmp_path / "x.csv", ("a", "b"), content=b"# written by some tool, in mm\n#\na,b\n1,2\n")
    assert table.numbers("b").tolist() == [2.0] and table.lines == [4]


def test_incomplete_rows_are_named(tmp_path):
    check_refused("'1.5' in line 3", read_csv(tmp_path / "x.csv", ("a",), content=b"a\n1\n1.5\n").whole, "a")


def test_lengths_with_decimal_commas_are_not_taken_for_two(tmp_path):
    (tmp_path / "x.txt").write_text("2,5\n2,5\n")
    check_refused("'2,5' is one number, or two", read_rest_length, str(tmp_path / "x.txt"))
    for text in ("2.5 3\n2.5", "2.5;3;2.5", "2.5,3,2.5", "2.5, 3\n2.5"):
        (tmp_path / "x.txt").write_text(text)
        assert read_rest_length(str(tmp_path / "x.txt")).tolist() == [2.5, 3, 2.5]
