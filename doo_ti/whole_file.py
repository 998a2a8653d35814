"""Files that are whole or not there at all, whatever happens while they are written, and whoever else writes them too.

A file is filled under a name of its own, ``.NAME.<random>.part`` beside it, and then takes its place. It is locked while it is
filled, so that those left by a process that was killed are known and removed when the same file is written again.
"""

import glob
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from errno import EEXIST
from pathlib import Path
from secrets import token_hex
from typing import BinaryIO

try:
    from fcntl import LOCK_EX, LOCK_NB, flock
except ImportError:  # Windows: what a killed process left stays
    flock = None


def write_whole(path: Path, write: Callable[[BinaryIO], object], first: bool = False) -> None:
    """Let ``write`` fill the file ``path``, as :func:`whole_file` does."""
    with whole_file(path, first) as file:
        write(file)


@contextmanager
def whole_file(path: Path, first: bool = False) -> Iterator[BinaryIO]:
    """An empty file, whose ``name`` is its path, that becomes ``path`` where the block ends well, and else goes.

    first  whether it must be the first: of several processes one writes ``path``, the others find FileExistsError. Else it
           takes the place of a file that is there, which stays until then
    """
    remove_leftovers(path.parent, path.name)
    file = _new_part(path)
    try:
        with file:
            yield file
            file.flush()
            if flock is None:
                file.close()  # Windows moves no open file
            # Still locked: another process would take it for a leftover.
            (_put_first if first else os.replace)(file.name, path)
    finally:
        Path(file.name).unlink(missing_ok=True)


def remove_leftovers(folder: Path, name: str | None = None) -> None:
    """Remove the parts of the file ``name`` in ``folder``, or of any, that nobody fills any more."""
    for part in folder.glob(f".{'*' if name is None else glob.escape(name)}.*.part"):
        try:
            with open(part, "rb") as file:
                if _locked(file, wait=False):
                    part.unlink(missing_ok=True)
        except OSError:  # another process's, which alone may touch it, or gone by now
            continue


def _put_first(part: str, path: Path) -> None:
    """Give ``part`` its name unless there is such a file."""
    try:
        os.link(part, path)
    except FileExistsError:
        raise
    except OSError:  # a file system without links
        if path.exists():
            raise FileExistsError(EEXIST, os.strerror(EEXIST), str(path)) from None
        os.replace(part, path)


def _new_part(path: Path) -> BinaryIO:
    """A new file beside ``path``, locked. It is made, never found: a link of its name would lead elsewhere."""
    while True:
        file = open(path.with_name(f".{path.name}.{token_hex(4)}.part"), "xb")
        # Who looked for leftovers between the two steps may have removed it.
        if not _locked(file, wait=True) or os.fstat(file.fileno()).st_nlink:
            return file
        file.close()


def _locked(file: BinaryIO, wait: bool) -> bool:
    """Whether this process has locked ``file`` now: not where the system cannot, nor where another has and it does not wait."""
    if flock is None:
        return False
    try:
        flock(file, LOCK_EX if wait else LOCK_EX | LOCK_NB)
    except OSError:
        return False
    return True
