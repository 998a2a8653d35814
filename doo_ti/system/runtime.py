"""The one place that starts Taichi.

Started on first use, on the calling thread, so that importing the package costs nothing and worker processes (spawned, never
forked) start their own. The settings are measured ones: packs stay vectors in the generated code, and the loop over threads
is not cut into blocks. Where a program calls ``ti.init`` itself, before or after, what it began is used
(:mod:`doo_ti.system.taichi_internals`).
"""

import os
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, redirect_stdout, suppress
from functools import partial, wraps
from io import StringIO
from pathlib import Path
from threading import RLock, get_ident
from typing import Any, ParamSpec, TypeVar

from doo_ti.system import taichi_internals
from doo_ti.system.errors import require
from doo_ti.system.taichi_internals import TAICHI_NAMES, kernel_folder
from doo_ti.system.terminal import compiling

KERNELS = "TI_OFFLINE_CACHE_FILE_PATH"  # the environment variable with the folder of Taichi's compiled kernels
KERNELS_HELD = 1 << 30
"""Bytes of kernels that the folder holds. With Taichi's 100 MB all commands in turn would compile most of them again."""
TASKS = Path("/proc/self/task")  # where Linux lists the threads of a process

_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")

_architecture: str | None = None
_begun = False
_forked = False
_one_at_a_time = RLock()
_holder: int | None = None
_program: Any = None  # what taichi_internals.running says of the program that _architecture is of
_of_user = False  # whether the user's own code began it
_compiled_for = 0.0  # s, that first launches of kernels have taken
_settings_of_user: tuple | None = None  # while ours are in force
_arrays: dict[Any, Any] = {}


def _after_fork() -> None:
    """Note in a forked child that what it has of Taichi does not work: its threads stayed with the parent."""
    global _forked
    _forked = _begun
    if _begun:
        taichi_internals.leave_to_parent()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)


def start(threads: int | None = None, pinned: bool = True) -> str:
    """Start Taichi where DOO_TI_ARCHITECTURE says, or use the program that the user's own code has begun, and return the
    architecture that runs, "cpu" or "cuda"; later calls only return it, unless Taichi was started anew in the meantime.

    threads  on a CPU; by default one per processor
    pinned   whether threads may be kept on processors of their own: not in processes that share the machine out

    Raises InputError as :func:`check_architecture` does, in a process forked from one that had started Taichi, and where the
    user's program runs elsewhere or has fields without a place.
    """
    global _architecture, _begun, _program, _of_user, _settings_of_user
    _refuse_forked()
    with _one_at_a_time:
        state = taichi_internals.running()
        if _program is not state or state.prog is None:
            for array in _arrays.values():  # of a program that has ended: they would free themselves in the next one
                array.arr = None
            _arrays.clear()
            if state.prog is None:
                _architecture, _of_user = _started(check_architecture(), threads, pinned), False
            else:
                wanted = os.environ.get("DOO_TI_ARCHITECTURE")
                _architecture, _of_user = taichi_internals.architecture_of_user(wanted and check_architecture()), True
                taichi_internals.require_ready()
            if not _begun:
                taichi_internals.read_sources_once(lambda: _holder is None)
            _begun, _program = True, taichi_internals.running()
        if _of_user and _holder == get_ident() and _settings_of_user is None:
            _settings_of_user = taichi_internals.put(*taichi_internals.with_usual(_settings(_architecture)))
    return _architecture


def array_for(key: Any, size: int, kind: Any) -> Any:
    """An array of Taichi's of ``size`` values or more of that ``kind``, kept under ``key`` as long as the program.

    It at least doubles when it grows: Taichi never frees arrays of packs, and so all earlier ones together are smaller than the
    last.
    """
    import taichi as ti

    kept = _arrays.get(key)
    if kept is None or kept.shape[0] < size:
        kept = _arrays[key] = ti.ndarray(kind, size if kept is None else max(size, 2 * kept.shape[0]))
    return kept


def check_architecture() -> str:
    """The architecture to run on, of the environment. Raises InputError where it is unknown, where Taichi's own variable would
    have another one run, and where this machine does not have it."""
    architecture = os.environ.get("DOO_TI_ARCHITECTURE", "cpu")
    require(architecture in TAICHI_NAMES, "environment", "DOO_TI_ARCHITECTURE", f"{architecture!r} is unknown",
            "give cpu or cuda")
    instead = os.environ.get("TI_ARCH")
    require(instead in (None, *TAICHI_NAMES[architecture]), "environment", "TI_ARCH", f"{instead!r} would run instead of "
            f"{architecture}", "unset it; DOO_TI_ARCHITECTURE, cpu or cuda, says where to run")
    if architecture == "cuda":
        import taichi as ti

        ti.set_logging_level(ti.ERROR)  # it would say itself that it finds no driver
        require(ti.lang.misc.is_arch_supported(ti.cuda), "environment", "DOO_TI_ARCHITECTURE", "no CUDA device can be used",
                "unset it to run on the CPU")
    return architecture


def exclusive(function: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
    """``function``, which uses kernels, for one Python thread at a time: Taichi compiles for one only, and calls share the
    kernels' memory. A call takes all processors by itself."""
    @wraps(function)
    def alone(*arguments: _Arguments.args, **options: _Arguments.kwargs) -> _Result:
        global _holder, _settings_of_user
        _refuse_forked()
        with _one_at_a_time:
            before, _holder = _holder, get_ident()
            try:
                if before is None and _begun:
                    start()  # or what the user's code has begun since
                return function(*arguments, **options)
            finally:
                _holder = before
                if before is None and _settings_of_user is not None:
                    taichi_internals.put(*_settings_of_user)
                    _settings_of_user = None

    return alone


def kernel(function: Callable[_Arguments, None]) -> Callable[_Arguments, None]:
    """``function`` as a kernel of Taichi: the one door to kernels.

    A launch raises RuntimeError unless its thread is in an :func:`exclusive` function: one that could meet a launch of another
    thread fails at once and always, also where there is no other thread. The terminal shows when it compiles the kernel first.
    """
    import taichi as ti

    compiled, during_first = ti.kernel(function), ExitStack()
    compiled._primal.materialize = partial(_shown, during_first, compiled._primal)

    @wraps(function)
    def launch(*arguments: _Arguments.args, **options: _Arguments.kwargs) -> None:
        if _holder != get_ident():
            raise RuntimeError(f"the kernel {function.__name__} is launched outside of runtime.exclusive")
        try:
            compiled(*arguments, **options)
        finally:
            during_first.close()

    return launch


def _shown(during_first: ExitStack, primal, key=None, *rest, **options) -> None:
    """What Taichi does before it launches a kernel; where it has not been compiled before, the terminal shows until the end of
    that launch that it is."""
    if key not in primal.compiled_kernels:
        during_first.enter_context(_compiling())
    type(primal).materialize(primal, key, *rest, **options)


@contextmanager
def _compiling() -> Iterator[None]:
    """The first launch of a kernel: the terminal shows it, and :func:`working_time` stands still."""
    global _compiled_for
    began = time.monotonic()
    with compiling():
        yield
    _compiled_for += time.monotonic() - began


def working_time() -> float:
    """s, of a clock for limits of time: it stands still while kernels are compiled, which is not part of the work."""
    return time.monotonic() - _compiled_for


def compiled_briefly(kernel: Callable[_Arguments, None]) -> Callable[_Arguments, None]:
    """``kernel``, a long one, compiled on a CPU without Taichi's own optimization, so that LLVM alone optimizes it.

    The time of Taichi's passes grows with the square of a kernel's length. With them those of contact take 100 to 400 s to
    compile instead of 10 to 30, compute the same bits, and are 3 to 12 % faster. The environment variable
    DOO_TI_COMPILE=briefly, which the tests set, has all kernels compiled so.
    """
    @wraps(kernel)
    def call(*arguments: _Arguments.args, **options: _Arguments.kwargs) -> None:
        import taichi as ti

        settings = ti.lang.impl.current_cfg()
        usual, settings.advanced_optimization = settings.advanced_optimization, _architecture != "cpu"
        try:
            kernel(*arguments, **options)
        finally:
            settings.advanced_optimization = usual

    return call


def _refuse_forked() -> None:
    """Raise InputError in a process that would wait for its parent's threads for ever."""
    require(not _forked, "process", "fork", "forked from a process that had used the kernels, which do not work in a copy",
            "start processes by spawn or forkserver, or fork before the first use")


def _settings(architecture: str) -> dict[str, Any]:
    """How our kernels are compiled, in the words of ``ti.init``."""
    briefly = architecture == "cpu" and os.environ.get("DOO_TI_COMPILE") == "briefly"
    return {"fast_math": False, "real_matrix_scalarize": False, "make_cpu_multithreading_loop": False,
            "cpu_block_dim_adaptive": False, "advanced_optimization": not briefly}


def _started(architecture: str, threads: int | None, pinned: bool) -> str:
    """The architecture, after starting Taichi there."""
    import taichi as ti

    folder = kernel_folder(Path(os.environ.get(KERNELS) or Path(ti._lib.core.get_repo_dir()) / "ticache"))
    options = {} if threads is None else {"cpu_max_num_threads": threads}
    os.environ.pop(KERNELS, None)
    if folder is not None:
        os.environ[KERNELS] = str(folder)  # for the processes that this one starts, too
    else:
        # Even where it keeps no kernels Taichi makes that folder as it ends, and fails where it cannot: the root is there.
        options["offline_cache_file_path"] = os.sep
    others = _tasks()
    with redirect_stdout(StringIO()):  # it greets on standard output, which belongs to the commands' results
        ti.init(arch={"cpu": ti.cpu, "cuda": ti.cuda}[architecture], offline_cache=folder is not None,
                offline_cache_max_size_of_files=KERNELS_HELD, enable_fallback=False, log_level=ti.ERROR,
                **_settings(architecture), **options)
        # What only the thread that started Taichi may do, and would be done with the first kernel.
        taichi_internals.running().materialize()
    if architecture == "cpu" and pinned and os.environ.get("DOO_TI_PINNED") != "0":
        pin(sorted(_tasks() - others))
    return architecture


def _tasks() -> set[int]:
    """The threads of this process; none where the system does not list them."""
    return {int(task.name) for task in TASKS.iterdir()} if TASKS.is_dir() else set()


def pin(tasks: list[int]) -> None:
    """Give each of Taichi's ``tasks``, the threads it started, a processor of its own, in turn.

    Left alone the system often wakes two threads on one processor and parts them milliseconds later, when a call of a
    thousand rods is long over. Only where the threads are as many as the processors this process may use.
    DOO_TI_PINNED=0 leaves it to the system.
    """
    free = processors()
    if hasattr(os, "sched_setaffinity") and thread_count() == len(free) > 1:
        # Those that compile come before those that run kernels, which follow each other.
        for place, task in enumerate(tasks):
            with suppress(ProcessLookupError):  # a thread that has ended in the meantime needs no processor
                os.sched_setaffinity(task, {free[place % len(free)]})


def processors() -> list[int]:
    """The processors that this process may use."""
    return sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else list(range(os.cpu_count() or 1))


def thread_count() -> int:
    """How many threads the kernels use on a CPU."""
    import taichi as ti

    return ti.lang.impl.current_cfg().cpu_max_num_threads
