"""The folder in which Taichi keeps compiled kernels between processes, and its repair.

Without this module Taichi ends in a segmentation fault where no folder is writable or its table is damaged, compiles a
damaged kernel again at every start without replacing it, and stores no further kernel once a process was killed while it wrote.

    FOLDER/ticache.tcb   the table: a header, then an entry for each kernel
    FOLDER/T….tic        a kernel: a header, its content, sha256 of the content in hexadecimal
    FOLDER/ticache.lock  exists while a process writes
"""

import hashlib
import os
import re
import stat
import tempfile
import time
from pathlib import Path
from struct import Struct

from doo_ti.system.files import write_whole

TABLE, LOCK = "ticache.tcb", "ticache.lock"
WRITING_SECONDS = 60
"""An older lock was left by a process that was killed."""

HEADER = Struct("<Q3HQQ")
"""Of the table: its length, Taichi's version, the length of all kernels, their number."""
ENTRY = Struct("<Q65sQ65sQ16x")
"""A kernel's name and again its name, each after its length, the length of its file, and two times."""
KNOWN_VERSION = (1, 7)
"""The table is read and repaired only for these versions of Taichi, whose layout is known."""
KERNEL_HEADER, DIGEST = 24, 64


def kernel_folder(usual: Path) -> Path | None:
    """The folder for kernels, repaired: ``usual``, or where it is not writable a private one among the temporary files;
    None where neither can be used."""
    folder = usual if _is_writable(usual) else _private()
    if folder is None or not _is_writable(folder):
        return None
    mend(folder)
    return folder


def mend(folder: Path) -> None:
    """Have the table of ``folder`` name sound kernels only, and remove the others: they are compiled and kept again."""
    try:
        if time.time() - (folder / LOCK).stat().st_mtime > WRITING_SECONDS:
            (folder / LOCK).unlink(missing_ok=True)
    except OSError:  # nobody writes
        pass
    try:
        _mend_table(folder / TABLE)
    except OSError:  # no table yet, or not ours to mend
        pass


def _mend_table(path: Path) -> None:
    table = path.read_bytes()
    if HEADER.size <= len(table) and HEADER.unpack_from(table)[1:3] != KNOWN_VERSION:
        return
    entries = _entries(table)
    if entries is None:
        path.unlink()
        return
    sound = []
    for entry in entries:
        _, name, _, _, size = ENTRY.unpack(entry)
        kernel = path.with_name(f"{name.decode()}.tic")
        if _is_sound(kernel, size):
            sound.append((entry, size))
        else:
            kernel.unlink(missing_ok=True)
    if len(sound) < len(entries):
        version = HEADER.unpack_from(table)[1:4]
        header = HEADER.pack(HEADER.size + len(sound) * ENTRY.size, *version, sum(size for _, size in sound), len(sound))
        write_whole(path, lambda file: file.write(header + b"".join(entry for entry, _ in sound)))


def _entries(table: bytes) -> list[bytes] | None:
    """The entries of a table, None where it is damaged."""
    if len(table) < HEADER.size:
        return None
    length, *_, count = HEADER.unpack_from(table)
    if length != len(table) or length != HEADER.size + count * ENTRY.size:
        return None
    entries = [table[at : at + ENTRY.size] for at in range(HEADER.size, length, ENTRY.size)]
    for entry in entries:
        first_length, first, second_length, second, _ = ENTRY.unpack(entry)
        if first_length != len(first) or second_length != len(second) or first != second or not re.fullmatch(
                rb"T[0-9a-f]{64}", first):
            return None
    return entries


def _is_sound(kernel: Path, size: int) -> bool:
    """Whether a kernel's file is there with the content that it was written with."""
    try:
        content = kernel.read_bytes()
    except OSError:
        return False
    return len(content) == size and hashlib.sha256(content[KERNEL_HEADER:-DIGEST]).hexdigest().encode() == content[-DIGEST:]


def _is_writable(folder: Path) -> bool:
    """Whether files can be made in ``folder``, which is made where it is absent: by trying, for a user may have a right that
    the file system does not grant."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(b"kernel")
    except OSError:
        return False
    return all(os.access(folder / name, os.W_OK) for name in (TABLE, LOCK) if (folder / name).exists())


def _private() -> Path | None:
    """A folder among the temporary files that only this user can write to: what lies there is run."""
    if not hasattr(os, "getuid"):
        return None
    try:
        folder = Path(tempfile.gettempdir()) / f"doo_ti_kernels_{os.getuid()}"
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
    except OSError:
        return None
    return folder if stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() and not found.st_mode & 0o022 else None
