"""The bytes of files that a user names, within bounds: what is no file has no end, and may never begin."""

import os
import stat
from pathlib import Path

from doo_ti.errors import InputError, system_reason

MOST_BYTES = 1 << 30
MOST_TEXT_BYTES = 1 << 26
"""Of what becomes Python's own lists, which take many times as much."""


def read_content(path: Path, most: int = MOST_BYTES, remedy: str = "name a readable file") -> bytes:
    """The bytes of a file. Raises InputError for what cannot be read, for devices and pipes, and for more than ``most``."""
    try:
        found = os.stat(path)
        if stat.S_ISREG(found.st_mode) and found.st_size <= most:
            return Path(path).read_bytes()
    except (OSError, ValueError) as error:  # a name that holds a null byte
        raise InputError(path, "file", system_reason(error), remedy) from None
    if stat.S_ISDIR(found.st_mode):
        raise InputError(path, "file", "is a directory", remedy)
    if not stat.S_ISREG(found.st_mode):
        raise InputError(path, "file", "a device or a pipe, no file", remedy)
    raise InputError(path, "file", f"{found.st_size:,} bytes", f"give a file of at most {most:,}")
