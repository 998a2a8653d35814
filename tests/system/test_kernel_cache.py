"""The folder of compiled kernels: every process succeeds, and damaged files are replaced."""

import hashlib
import os
import time
from pathlib import Path

import pytest

from doo_ti.system.taichi_internals import ENTRY, HEADER, LOCK, TABLE, mend
from tests.processes import python

ONE_KERNEL = """
import tempfile
from doo_ti.system import runtime
import taichi as ti

tempfile.tempdir = TEMPORARY

@ti.kernel
def three() -> ti.i32:
    return 3

runtime.start()
print(three())
"""
pytestmark = pytest.mark.skipif(os.name != "posix", reason="takes a home that can be taken away")


def run_kernel(folder: Path, temporary=None, **environment) -> None:
    """A process that compiles a kernel, or loads it, and uses it; None takes a variable out of its environment."""
    script = folder / "kernel.py"
    script.write_text(ONE_KERNEL.replace("TEMPORARY", repr(temporary and str(temporary))))
    done = python(script, **{"TI_OFFLINE_CACHE_FILE_PATH": None, **environment})
    assert (done.returncode, done.stdout, done.stderr) == (0, "3\n", "")


@pytest.mark.thorough
@pytest.mark.parametrize(("temporary", "home"), [(None, None), ("/proc/self", "/proc/self")])
def test_a_process_without_a_home_or_writable_folders_succeeds(tmp_path, temporary, home):
    run_kernel(tmp_path, temporary, HOME=home, XDG_CACHE_HOME=None)


@pytest.mark.thorough
def test_nothing_lies_among_the_temporary_files_where_the_home_does(tmp_path):
    (tmp_path / "temporary").mkdir()
    run_kernel(tmp_path, tmp_path / "temporary", XDG_CACHE_HOME=tmp_path)
    assert list((tmp_path / "temporary").iterdir()) == [] and list(tmp_path.glob("taichi/ticache/*.tic"))


@pytest.mark.thorough
@pytest.mark.parametrize("home", ["file", "/proc/self"])
def test_where_the_home_cannot_be_written_kernels_are_kept_among_the_temporary_files(tmp_path, home):
    (tmp_path / "file").write_text("")
    run_kernel(tmp_path, tmp_path, HOME=None, XDG_CACHE_HOME=tmp_path / home)
    kept, = tmp_path.glob("doo_ti_kernels_*")
    assert kept.stat().st_mode & 0o077 == 0 and list(kept.glob("*.tic"))


@pytest.mark.thorough
def test_kernels_are_not_taken_from_a_folder_that_is_another_ones(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / f"doo_ti_kernels_{os.getuid()}").symlink_to(tmp_path / "elsewhere")
    run_kernel(tmp_path, tmp_path, HOME=None, XDG_CACHE_HOME="/proc/self")
    assert not list((tmp_path / "elsewhere").iterdir())


@pytest.fixture(scope="module")
def kept(tmp_path_factory) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("kept")
    run_kernel(folder, XDG_CACHE_HOME=folder)
    return {path.name: path.read_bytes() for path in (folder / "taichi" / "ticache").iterdir()}


def flipped(content: bytes, place: int) -> bytes:
    return content[:place] + bytes([content[place] ^ 0xFF]) + content[place + 1 :]


DAMAGE = {
    "a flipped bit": lambda name, content: content if name == TABLE else flipped(content, len(content) // 2),
    "a cut kernel": lambda name, content: content if name == TABLE else content[:-100],
    "no kernel": lambda name, content: content if name == TABLE else None,
    "a table of too many": lambda name, content: flipped(content, HEADER.size - 3) if name == TABLE else content,
    "a table of long names": lambda name, content: flipped(content, HEADER.size + 4) if name == TABLE else content,
    "a cut table": lambda name, content: content[:-10] if name == TABLE else content,
    "no table": lambda name, content: None if name == TABLE else content,
    "the lock of a killed process": lambda name, content: content}


@pytest.mark.sampled(1)
@pytest.mark.parametrize("damage", DAMAGE)
def test_damage_is_replaced(tmp_path, kept, damage):
    folder = tmp_path / "taichi" / "ticache"
    folder.mkdir(parents=True)
    for name, content in kept.items():
        content = DAMAGE[damage](name, content)
        if content is not None:
            (folder / name).write_bytes(content)
    if damage == "the lock of a killed process":
        (folder / LOCK).write_bytes(b"")
        os.utime(folder / LOCK, 2 * (time.time() - 3600,))
    run_kernel(tmp_path, XDG_CACHE_HOME=tmp_path)
    assert {path.name for path in folder.iterdir()} == kept.keys()
    table = (folder / TABLE).read_bytes()
    names = {ENTRY.unpack_from(table, at)[1].decode() + ".tic" for at in range(HEADER.size, len(table), ENTRY.size)}
    assert names == kept.keys() - {TABLE}
    for name in names:
        content = (folder / name).read_bytes()
        assert hashlib.sha256(content[24:-64]).hexdigest().encode() == content[-64:]


def test_a_table_that_another_process_is_writing_stays(tmp_path):
    """Half of it may be there: without it all kernels were compiled again."""
    for name in (TABLE, LOCK):
        (tmp_path / name).write_bytes(b"")
    mend(tmp_path)
    assert (tmp_path / TABLE).exists() and (tmp_path / LOCK).exists()
    (tmp_path / LOCK).unlink()
    mend(tmp_path)
    assert not list(tmp_path.iterdir())
