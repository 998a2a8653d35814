"""Files that are complete or absent, and the part files beside them. That commands write so: tests/commands/conftest.py."""

import os
from pathlib import Path

import pytest

from doo_ti.system.files import whole_file, write_whole
from tests.processes import python


def test_a_file_takes_its_place_when_it_is_whole_and_what_fails_leaves_the_one_before(tmp_path):
    """Of two that write it beside each other the one that is whole last stays."""
    path = tmp_path / "F.npz"
    write_whole(path, lambda file: file.write(b"first"))
    with whole_file(path) as file:
        file.write(b"second")
        file.flush()
        assert path.read_bytes() == b"first" and Path(file.name).read_bytes() == b"second"
    assert path.read_bytes() == b"second" and list(tmp_path.iterdir()) == [path]
    with pytest.raises(OSError, match="full"), whole_file(path) as file:
        file.write(b"thi")
        raise OSError("full")
    assert path.read_bytes() == b"second" and list(tmp_path.iterdir()) == [path]
    with whole_file(path) as first, whole_file(path) as second:
        first.write(b"first")
        second.write(b"second")
    assert path.read_bytes() == b"first" and list(tmp_path.iterdir()) == [path]


def test_a_link_of_the_files_name_is_replaced_and_not_followed(tmp_path):
    (tmp_path / "other").write_bytes(b"other")
    path = tmp_path / "F.npz"
    path.symlink_to(tmp_path / "other")
    write_whole(path, lambda file: file.write(b"mine"))
    assert path.read_bytes() == b"mine" and not path.is_symlink() and (tmp_path / "other").read_bytes() == b"other"


@pytest.mark.skipif(os.name != "posix", reason="Windows does not say whether a process still fills a file")
def test_what_a_killed_process_left_goes_and_what_another_fills_stays(tmp_path):
    path, beside = tmp_path / "F[1].npz", tmp_path / ".F2.npz.00.part"
    beside.write_bytes(b"another file's")
    script = ("import os, pathlib, sys; from doo_ti.system.files import whole_file\n"
              "with whole_file(pathlib.Path(sys.argv[1])) as file: os.kill(os.getpid(), 9)")
    python("-c", script, path)
    assert len(list(tmp_path.iterdir())) == 2
    with whole_file(path) as file:
        write_whole(path, lambda other: other.write(b"whole"))
        assert sorted(tmp_path.iterdir()) == sorted([path, beside, Path(file.name)])
