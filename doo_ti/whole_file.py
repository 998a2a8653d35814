"""Files that are whole or not there at all, whatever happens while they are written, and whoever else writes them too.

A file is filled under a name of its own, ``.NAME.<random>.part`` beside it, and then takes its place. It is locked while it is
filled, so that those left by a process that was killed are known and removed when the same file is written again.
"""

import glob
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from secrets import token_hex
from typing import BinaryIO

try:
    from fcntl import LOCK_EX, LOCK_NB, flock
except ImportError:  # Windows: what a killed process left stays
    flock = None


def write_whole(path: Path, write: Callable[[BinaryIO], object]) -> None:
    """Let ``write`` fill the file ``path``; a file that is already there stays until the new one is whole."""
    with whole_file(path) as file:
        write(file)


@contextmanager
def whole_file(path: Path) -> Iterator[BinaryIO]:
    """An empty file, whose ``name`` is its path, that takes the place of ``path`` where the block ends well, and else goes."""
    _remove_leftovers(path)
    file = _new_part(path)
    try:
        with file:
            yield file
        os.replace(file.name, path)
    finally:
        Path(file.name).unlink(missing_ok=True)


def _new_part(path: Path) -> BinaryIO:
    """A new file beside ``path``, locked. It is made, never found: a link of its name would lead elsewhere."""
    while True:
        file = open(path.with_name(f".{path.name}.{token_hex(4)}.part"), "xb")
        # Who looked for leftovers between the two steps may have removed it.
        if not _locked(file, wait=True) or os.fstat(file.fileno()).st_nlink:
            return file
        file.close()


def _remove_leftovers(path: Path) -> None:
    """Remove the parts of ``path`` that nobody fills any more."""
    for part in path.parent.glob(f".{glob.escape(path.name)}.*.part"):
        try:
            with open(part, "rb") as file:
                if _locked(file, wait=False):
                    part.unlink(missing_ok=True)
        except OSError:  # another process's, which alone may touch it, or gone by now
            continue


def _locked(file: BinaryIO, wait: bool) -> bool:
    """Whether this process has locked ``file`` now: not where the system cannot, nor where another has and it does not wait."""
    if flock is None:
        return False
    try:
        flock(file, LOCK_EX if wait else LOCK_EX | LOCK_NB)
    except OSError:
        return False
    return True
