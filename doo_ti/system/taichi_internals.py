"""What this package changes and mends inside Taichi, beyond its documented interface.

**The running program**, which the user's own code may have begun. Taichi has one at a time, and beginning another frees the
fields of the first. So our kernels run in the user's: they are compiled with our settings, and between our calls the user's are
in force.

**The source of kernels**, read once for all calls of a function. Before a kernel runs, in every process, Taichi translates its
functions. At each call of a function it searches, formats and parses the source again, and for every expression it prepares a
quotation for a possible error message. Our kernels have hundreds of functions and thousands of calls, so this takes half of the
time until a kernel runs. With DOO_TI_DEBUG set Taichi works as usual, and an error in a kernel is quoted.

**The folder of compiled kernels**, kept between processes, is repaired. Else Taichi ends in a segmentation fault where no
folder is writable or its table is damaged, compiles a damaged kernel again at every start without replacing it, and stores no
further kernel once a process was killed while it wrote.

    FOLDER/ticache.tcb   the table: a header, then an entry for each kernel
    FOLDER/T….tic        a kernel: a header, its content, sha256 of the content in hexadecimal
    FOLDER/ticache.lock  exists while a process writes
"""

import ast
import ctypes
import hashlib
import inspect
import linecache
import os
import re
import stat
import sys
import tempfile
import textwrap
import time
from collections import defaultdict
from collections.abc import Callable
from functools import cache
from pathlib import Path
from struct import Struct
from threading import current_thread, main_thread
from types import SimpleNamespace
from typing import Any

from doo_ti.system.errors import InputError, require
from doo_ti.system.files import write_whole

TAICHI_NAMES = {"cpu": ("x64", "arm64"), "cuda": ("cuda",)}  # architectures, and Taichi's names for them
COMPILED = (
    "advanced_optimization", "cache_loop_invariant_global_vars", "cfg_optimization", "check_out_of_bound",
    "cpu_block_dim_adaptive", "debug", "default_cpu_block_dim", "default_fp", "default_ip", "default_up",
    "demote_dense_struct_fors", "detect_read_only", "fast_math", "flatten_if", "force_scalarize_matrix", "half2_vectorization",
    "lower_access", "make_block_local", "make_cpu_multithreading_loop", "make_thread_local", "move_loop_invariant_outside_if",
    "opt_level", "real_matrix_scalarize", "simplify_after_lower_access", "simplify_before_lower_access")
"""Taichi's settings that say how kernels are compiled, not where they run."""
OF_PYTHON = ("short_circuit_operators", "print_full_traceback", "unrolling_limit")
"""The same, which its compiler in Python keeps beside the default kinds of numbers."""


def running() -> Any:
    """Taichi's state, another object after each ``ti.init`` and ``ti.reset``; its ``prog`` is None before ``ti.init``."""
    import taichi as ti

    return ti.lang.impl.get_runtime()


def architecture_of_user(wanted: str | None) -> str:
    """The architecture of the user's program. Raises InputError for one that our kernels do not run on, and for another than
    ``wanted``."""
    import taichi as ti

    name = ti._lib.core.arch_name(ti.lang.impl.current_cfg().arch)
    found = next((ours for ours, names in TAICHI_NAMES.items() if name in names), None)
    if found is None or wanted not in (None, found):
        raise InputError("Taichi", "arch", f"this process runs it on {name}" + f", not {wanted}" * (wanted is not None),
                         "call ti.init with arch=ti.cpu or ti.cuda" + ", as DOO_TI_ARCHITECTURE says" * (wanted is not None))
    return found


def require_ready() -> None:
    """Make the user's program ready for kernels, as its own next kernel would. Raises InputError, before anything is changed,
    where fields have no place, and where only another thread may do it."""
    import taichi as ti

    state, root = running(), ti.lang.impl.root
    try:
        state._check_field_not_placed()
    except RuntimeError:
        raise InputError("Taichi", "fields", "some have no place yet", "give them a shape, or place them, before this call"
                         ) from None
    if state.materialized and (root.finalized or root.empty):
        return
    require(current_thread() is main_thread(), "Taichi", "thread", "only the one that called ti.init can make its fields ready",
            "call ti.sync() there before this call")
    state.materialize()


def put(settings: dict[str, Any], of_python: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Put these settings of the program, and of Taichi's compiler in Python, in force; returns those that were."""
    import taichi as ti

    config, state = ti.lang.impl.current_cfg(), running()
    before = {name: getattr(config, name) for name in settings}, {name: getattr(state, name) for name in of_python}
    for target, values in ((config, settings), (state, of_python)):
        for name, value in values.items():
            setattr(target, name, value)
    return before


def with_usual(settings: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """``settings``, arguments of ``ti.init``, as :func:`put` takes them, beside Taichi's usual ones."""
    import taichi as ti

    usual, special = ti._lib.core.CompileConfig(), ti.lang.misc._SpecialConfig()
    of_python = {name: getattr(special, name) for name in OF_PYTHON}
    numbers = {"default_fp": ti.f32, "default_ip": ti.i32, "default_up": ti.u32}
    return {name: getattr(usual, name) for name in COMPILED} | settings | numbers, of_python | numbers


def leave_to_parent() -> None:
    """Keep a forked child from ending, as it exits, what it does not have: it would wait for the parent's threads for ever."""
    state = running() if "taichi" in sys.modules else None
    if state is not None and state.prog is not None:
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(state.prog))
        state.prog = None


PARTS = ("getsourcefile", "getsourcelines", "textwrap", "ast", "transform_tree")
"""What is replaced in Taichi's module; left as they are in a version that has others."""
OURS = str(Path(__file__).resolve().parents[1]) + os.sep
"""Files whose functions are found by their line: those of others may change while the process runs."""


def read_sources_once(quotes: Callable[[], bool]) -> None:
    """Have Taichi read each source once. ``quotes`` says whether it is still to quote, as in kernels that are not ours."""
    from taichi.lang import kernel_impl
    from taichi.lang.ast import ast_transformer_utils

    if os.environ.get("DOO_TI_DEBUG"):
        return
    if all(hasattr(kernel_impl, part) for part in PARTS):
        trees = _Trees(kernel_impl.transform_tree)
        for part, new in zip(PARTS, (
                cache(kernel_impl.getsourcefile), _lines_of(kernel_impl.getsourcelines),
                SimpleNamespace(fill=cache(textwrap.fill), dedent=cache(textwrap.dedent)),
                SimpleNamespace(parse=trees.parse), trees.transform), strict=True):
            setattr(kernel_impl, part, new)
    context = getattr(ast_transformer_utils, "ASTTransformerContext", None)
    if hasattr(context, "get_pos_info"):
        quoted = context.get_pos_info
        context.get_pos_info = lambda self, node: quoted(self, node) if quotes() else ""


class _Trees:
    """Parsed functions. A tree that is being traced is not given out again, as a function may be called in its own argument."""

    def __init__(self, transform: Callable):
        self._transform, self._idle, self._busy = transform, defaultdict(list), {}

    def parse(self, source: str) -> ast.Module:
        if self._idle[source]:
            tree, nodes = self._idle[source].pop()
        else:
            tree = ast.parse(source)
            nodes = list(ast.walk(tree))
        self._busy[id(tree)] = source, nodes
        return tree

    def transform(self, tree: ast.Module, context):
        """What Taichi does with a tree, which then is without what it has noted in it; that of a kernel is not used again."""
        found = self._transform(tree, context)
        source, nodes = self._busy.pop(id(tree), (None, ()))
        if source is not None and not context.is_kernel:
            for node in nodes:
                node.__dict__.pop("ptr", None)
                node.__dict__.pop("caller", None)
            self._idle[source].append((tree, nodes))
        return found


def _lines_of(otherwise: Callable) -> Callable:
    """What :func:`inspect.getsourcelines` returns, without its search: the lines of a function and the number of the first."""
    @cache
    def lines(function) -> tuple[list[str], int]:
        code = inspect.unwrap(function).__code__
        file, first = code.co_filename, code.co_firstlineno
        last = _last_lines(file).get(first) if file.startswith(OURS) else None
        return otherwise(function) if last is None else (linecache.getlines(file)[first - 1 : last], first)

    return lines


@cache
def _last_lines(file: str) -> dict[int, int]:
    """The last line of each function of a file, by its first, that of a decorator where it has any."""
    last, blocks = {}, [ast.parse("".join(linecache.getlines(file)))]
    while blocks:
        block = blocks.pop()
        blocks += [node for node in block.body if hasattr(node, "body")]
        if isinstance(block, ast.FunctionDef):
            last[min([block.lineno, *(mark.lineno for mark in block.decorator_list)])] = block.end_lineno
    return last


# --- the folder of compiled kernels --------------------------------------------------------------------------------------

TABLE, LOCK = "ticache.tcb", "ticache.lock"
WRITING_SECONDS = 60  # an older lock was left by a process that was killed

HEADER = Struct("<Q3HQQ")  # of the table: its length, Taichi's version, the length of all kernels, their number
ENTRY = Struct("<Q65sQ65sQ16x")
"""A kernel's name and again its name, each after its length, the length of its file, and two times."""
KNOWN_VERSION = (1, 7)  # the table is read and repaired only for these versions of Taichi, whose layout is known
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
    path = folder / TABLE
    try:
        _, entries, sound = _judged(path)
        if entries is not None and len(sound) == len(entries):
            return
        os.close(os.open(folder / LOCK, os.O_CREAT | os.O_EXCL))  # fails where another process writes: it may be half written
        try:
            _mend_table(path, *_judged(path))
        finally:
            (folder / LOCK).unlink()
    except OSError:  # no table yet, or not ours to mend
        pass


def _judged(path: Path) -> tuple[bytes, list[bytes] | None, list[bytes]]:
    """A table, its entries, None where it is damaged, and those whose kernels are sound."""
    table = path.read_bytes()
    if HEADER.size <= len(table) and HEADER.unpack_from(table)[1:3] != KNOWN_VERSION:
        return table, [], []
    entries = _entries(table)
    return table, entries, [entry for entry in entries or () if _is_sound(path.with_name(_file_of(entry)), _size(entry))]


def _mend_table(path: Path, table: bytes, entries: list[bytes] | None, sound: list[bytes]) -> None:
    if entries is None:
        path.unlink()
    elif len(sound) < len(entries):
        for entry in set(entries).difference(sound):
            path.with_name(_file_of(entry)).unlink(missing_ok=True)
        version = HEADER.unpack_from(table)[1:4]
        header = HEADER.pack(HEADER.size + len(sound) * ENTRY.size, *version, sum(map(_size, sound)), len(sound))
        write_whole(path, lambda file: file.write(header + b"".join(sound)))


def _file_of(entry: bytes) -> str:
    return f"{ENTRY.unpack(entry)[1].decode()}.tic"


def _size(entry: bytes) -> int:
    return ENTRY.unpack(entry)[4]


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
