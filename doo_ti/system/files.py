"""Reading files that a user names, within bounds, and writing files completely or not at all.

A file is written under a name of its own, ``.NAME.<random>.part`` beside it, and then renamed. The part is locked while it
is written: parts without a lock were left by a process that was killed, and are removed when the file is written again.
"""

import csv
import glob
import os
import stat
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from errno import EEXIST
from io import StringIO
from pathlib import Path
from secrets import token_hex
from typing import BinaryIO

from doo_ti.system.errors import InputError, require

try:
    from fcntl import LOCK_EX, LOCK_NB, flock
except ImportError:  # Windows: parts left by a killed process stay
    flock = None

MOST_BYTES = 1 << 30
MOST_TEXT_BYTES = 1 << 26
"""Limit for files that are parsed into Python lists, which take many times the memory of the text."""


def read_content(path: Path, most: int = MOST_BYTES, remedy: str = "name a readable file") -> bytes:
    """The bytes of a file. Raises InputError for a file that cannot be read, for devices and pipes, which may never end, and
    for more than ``most`` bytes."""
    try:
        found = os.stat(path)
        if stat.S_ISREG(found.st_mode) and found.st_size <= most:
            return Path(path).read_bytes()
    except (OSError, ValueError) as error:  # ValueError: a name that holds a null byte
        raise InputError(path, "file", (getattr(error, "strerror", None) or str(error)).lower(), remedy) from None
    require(not stat.S_ISDIR(found.st_mode), path, "file", "is a folder", remedy)
    require(stat.S_ISREG(found.st_mode), path, "file", "is a device or a pipe, not a file", remedy)
    raise InputError(path, "file", f"{found.st_size:,} bytes", f"give a file of at most {most:,}")


def write_whole(path: Path, write: Callable[[BinaryIO], object], first: bool = False) -> None:
    """Let ``write`` fill the file ``path``, as :func:`whole_file` does."""
    with whole_file(path, first) as file:
        write(file)


def write_text(path: Path, text: str) -> None:
    """Write ``text`` as UTF-8 to ``path``, completely or not at all."""
    write_whole(path, lambda file: file.write(text.encode()))


def csv_text(heads: Iterable, rows: Iterable[Iterable]) -> str:
    """A table as CSV: a line of the columns' names, and one of each of the ``rows``."""
    text = StringIO(newline="")
    csv.writer(text, lineterminator="\n").writerows([heads, *rows])
    return text.getvalue()


@contextmanager
def whole_file(path: Path, first: bool = False) -> Iterator[BinaryIO]:
    """An empty file, whose ``name`` is its path, that is renamed to ``path`` if the block ends without an error, else removed;
    the folder of ``path`` is made where it is missing.

    first  False: an existing file is replaced, at the end. True: it is never replaced; of several processes one writes
           ``path``, the others get FileExistsError
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    remove_leftovers(path.parent, path.name)
    file = _new_part(path)
    try:
        with file:
            yield file
            file.flush()
            if flock is None:
                file.close()  # Windows renames no open file
            # Still locked: else another process would take it for a leftover.
            (_put_first if first else os.replace)(file.name, path)
    finally:
        Path(file.name).unlink(missing_ok=True)


def remove_leftovers(folder: Path, name: str | None = None) -> None:
    """Remove the parts of the file ``name`` in ``folder``, or of every file, that no process holds a lock on."""
    for part in folder.glob(f".{'*' if name is None else glob.escape(name)}.*.part"):
        try:
            with open(part, "rb") as file:
                if _locked(file, wait=False):
                    part.unlink(missing_ok=True)
        except OSError:  # it belongs to another process, or is gone by now
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
    """A new file beside ``path``, locked. It is always created: an existing link of that name could lead elsewhere."""
    while True:
        file = open(path.with_name(f".{path.name}.{token_hex(4)}.part"), "xb")
        # Another process that removes leftovers may have removed it before it was locked.
        if not _locked(file, wait=True) or os.fstat(file.fileno()).st_nlink:
            return file
        file.close()


def _locked(file: BinaryIO, wait: bool) -> bool:
    """Whether this process now holds the lock on ``file``. False where the system has no locks, and, unless it waits, where
    another process holds it."""
    if flock is None:
        return False
    try:
        flock(file, LOCK_EX if wait else LOCK_EX | LOCK_NB)
    except OSError:
        return False
    return True
