"""The terminal. Output: names from files with control characters escaped, progress bars, the current step. Signals: Ctrl-C,
SIGTERM and the end of the terminal (SIGHUP) as a KeyboardInterrupt that is raised where commands expect one; raised anywhere,
it could be mistaken for a failed import, or be lost in a destructor.

Names of materials, files and cameras come from others; an escape sequence in one could clear the screen or forge a line.
"""

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from threading import Timer, current_thread, main_thread
from types import FrameType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from subprocess import Popen

LINE_SECONDS = 30.0  # between two lines of a long run whose standard error is no terminal
COMPILING_SECONDS = 5.0  # that a kernel compiles before a line says so there: kernels that were kept are loaded sooner
COMPILING = "compiling …"
INSTALL_RECORDER = "pip install rerun-sdk"

_shown: list[Callable[[bool], None]] = []
"""Those that show the current step on a terminal; each is told whether kernels are being compiled."""


@contextmanager
def compiling() -> Iterator[None]:
    """What the terminal shows says inside that kernels are being compiled: the step takes long, at its first time on a machine,
    and is not to be seen to advance."""
    for show in _shown:
        show(True)
    try:
        yield
    finally:
        for show in _shown:
            show(False)


def visible(text: str) -> str:
    """``text`` with control characters, and those that turn the direction of writing, as ``\\x1b``; line ends stay."""
    if text.isprintable():
        return text
    return "".join(sign if sign.isprintable() or sign == "\n" else sign.encode("unicode_escape").decode() for sign in text)


def in_line(text: object) -> str:
    """A name or path as part of a line: :func:`visible`, and its line ends written as ``\\n``, lest it forge lines."""
    return visible(str(text)).replace("\n", "\\n")


class VisibleStream:
    """A stream that writes text as :func:`visible` returns it, and is otherwise the ``stream``."""

    def __init__(self, stream):
        self._stream = stream

    def write(self, text: str) -> int:
        self._stream.write(visible(text))
        return len(text)

    def __getattr__(self, name: str):
        return getattr(self._stream, name)


def has_recorder() -> bool:
    """Whether rerun is installed, which writes and shows recordings."""
    try:
        return find_spec("rerun") is not None
    except ValueError:  # somebody has put something else in its place
        return False


def can_record() -> bool:
    """Whether rerun is installed; if it is not, a line on standard error says that no recording is written."""
    if not has_recorder():
        warn(f"no recording: rerun is not installed; {INSTALL_RECORDER}")
        return False
    return True


def warn(text: str) -> None:
    """Print a warning on standard error, in one line."""
    print(f"doo-ti: warning: {in_line(text)}", file=sys.stderr)


def busy(doing: str):
    """A context in which a terminal shows the current step; elsewhere a line is printed every :data:`LINE_SECONDS`."""
    from rich.console import Console

    console = Console(stderr=True)
    return _status(console, visible(doing)) if console.is_terminal else _lines_meanwhile(doing)


@contextmanager
def _status(console, doing: str):
    from rich.text import Text

    with console.status(Text(doing)) as status:  # as Text: [markup] in a string would be obeyed
        def show(is_compiling: bool) -> None:  # naming the spinner has it drawn at once: Taichi keeps other threads waiting
            status.update(Text(f"{doing}: {COMPILING}" if is_compiling else doing), spinner="dots")

        _shown.append(show)
        try:
            yield
        finally:
            _shown.remove(show)


@contextmanager
def _lines_meanwhile(doing: str):
    ended = threading.Event()

    def report() -> None:
        began = time.monotonic()
        while not ended.wait(LINE_SECONDS):
            print(f"{in_line(doing)}: {time.monotonic() - began:.0f} s so far", file=sys.stderr, flush=True)

    thread = threading.Thread(target=report, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def _columns() -> tuple:
    """A task's name and its rate, as columns of :func:`progress`."""
    from rich.progress import ProgressColumn
    from rich.text import Text

    class Description(ProgressColumn):
        """A name may hold [markup] and escape sequences, which are shown as they are."""

        def render(self, task) -> Text:
            return Text(visible(task.description))

    class Rate(ProgressColumn):
        is_compiling = False

        def render(self, task) -> Text:
            if self.is_compiling and not task.finished:
                return Text(COMPILING)
            speed = task.finished_speed or task.speed
            speed = "" if speed is None else f"{speed:,.{0 if speed >= 10 else 2}f} {task.fields['unit']}/s"
            return Text(task.fields.get("rate", speed))

    return Description(), Rate()


class _CompilingNotice:
    """A line that says, once and where it takes long, that kernels are being compiled."""

    def __init__(self):
        self._timer, self._told = Timer(0.0, print), False

    def show(self, is_compiling: bool) -> None:
        self._timer.cancel()
        if is_compiling and not self._told:
            self._timer = Timer(COMPILING_SECONDS, self._tell)
            self._timer.daemon = True
            self._timer.start()

    def _tell(self) -> None:
        self._told = True
        print(f"{COMPILING} at its first use on a machine this takes minutes, later no time; then lines say what is done",
              file=sys.stderr, flush=True)


def progress(*, keep: bool = False):
    """A progress bar on standard error as a context: how much of how much is done, the rate and the time left. Work is added
    with ``bar.add_task("growth", total=320, unit="edges")``. Where standard error is no terminal, a line reports every
    :data:`LINE_SECONDS` instead.

    keep  True: the last state of the bar stays, also in a file. False: it is shown on a terminal only, and removed at the end

    The rate is in units per second, unless the task's field ``rate`` gives another text.
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    class Lines(Progress):
        """Reports in lines where there is no terminal."""

        reported = time.monotonic()
        notice = _CompilingNotice()

        def start(self) -> None:
            super().start()
            _shown.append(self.show)

        def stop(self) -> None:
            if self.show in _shown:
                _shown.remove(self.show)
            super().stop()

        def show(self, is_compiling: bool) -> None:
            rate.is_compiling = is_compiling
            self.refresh()
            self.notice.show(is_compiling and not console.is_terminal)

        def update(self, task_id, **changes) -> None:
            super().update(task_id, **changes)
            self.report(task_id)

        def advance(self, task_id, advance=1) -> None:
            super().advance(task_id, advance)
            self.report(task_id)

        def report(self, task_id) -> None:
            now = time.monotonic()
            if not console.is_terminal and now - self.reported >= LINE_SECONDS:
                self.reported = now
                task = next(task for task in self.tasks if task.id == task_id)
                of_all = "" if task.total is None else f" of {task.total:,.0f}"
                left = "" if task.time_remaining is None else f", about {task.time_remaining:.0f} s left"
                print(f"{in_line(task.description)}: {task.completed:,.0f}{of_all} {task.fields['unit']}{left}",
                      file=sys.stderr, flush=True)

    console, (description, rate) = Console(stderr=True), _columns()
    columns = BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[unit]}"), rate, TimeRemainingColumn()
    return Lines(description, *columns, console=console, transient=not keep, disable=not (keep or console.is_terminal))


# --- signals -------------------------------------------------------------------------------------------------------------

SECONDS_TO_END = 10.0  # that a process has to end by itself before it is killed
AGAIN_SECONDS = 0.05  # delay before a signal that was raised where it is lost is sent again
MOST_POSTPONED = 200  # times in succession: only an import that runs the program takes longer

HANGUP = getattr(signal, "SIGHUP", None)  # the terminal is closed; not on Windows

_postponed = 0


def before_anything_is_begun() -> bool:
    """Have Ctrl-C end the process immediately; False where the process was started with Ctrl-C ignored."""
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        return False
    signal.signal(signal.SIGINT, _end)
    return True


def while_running(interruptible: bool) -> None:
    """Have the signals raise KeyboardInterrupt: finished work is kept, what was started ends, and the way to resume is printed.
    Under nohup the end of the terminal stays ignored."""
    if interruptible:
        signal.signal(signal.SIGINT, _interrupt)
    signal.signal(signal.SIGTERM, _interrupt)
    if HANGUP is not None and signal.getsignal(HANGUP) is signal.SIG_DFL:
        signal.signal(HANGUP, _interrupt)
    sys.unraisablehook = _not_lost


def when_all_is_done() -> None:
    """Ignore Ctrl-C from now on: the process is about to end."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def ended(process: "Popen") -> None:
    """End a process that this one has started, should it still run, and wait for it."""
    from subprocess import TimeoutExpired

    if process.poll() is not None:
        return
    process.terminate()
    try:
        process.wait(SECONDS_TO_END)
    except TimeoutExpired:
        process.kill()
        process.wait()


@contextmanager
def kept_from_children() -> Iterator[None]:
    """Start processes inside: they ignore Ctrl-C, which a terminal sends to them too; their parent ends them.

    The parent handles the signals only when the block ends: Python would raise in its main thread while that starts a
    process, which would then end with a traceback or stay behind.
    """
    postponed: list[int] = []
    before = {}
    if current_thread() is main_thread():
        for number in (signal.SIGINT, signal.SIGTERM, *([] if HANGUP is None else [HANGUP])):
            if callable(signal.getsignal(number)):
                before[number] = signal.signal(number, lambda received, frame: postponed.append(received))
    masked = hasattr(signal, "pthread_sigmask")  # not on Windows
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}) if masked else None
    try:
        yield
    finally:
        if masked:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for number, handler in before.items():
            signal.signal(number, handler)
        if postponed:
            signal.raise_signal(postponed[0])


def _end(number: int, frame: FrameType | None) -> None:
    os.write(2, b"doo-ti: interrupted\n")
    os._exit(1)


def _interrupt(number: int, frame: FrameType | None) -> None:
    global _postponed
    if _is_importing(frame) and _postponed < MOST_POSTPONED:
        _postponed += 1
        _send_again(number)
    else:
        _postponed = 0
        raise KeyboardInterrupt


def _is_importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename == "<frozen importlib._bootstrap>":
            return True
        frame = frame.f_back
    return False


def _not_lost(unraisable) -> None:
    """Python's own hook for exceptions that cannot be raised, except that an interruption is sent again."""
    if issubclass(unraisable.exc_type, KeyboardInterrupt):
        _send_again(signal.SIGINT)
    else:
        sys.__unraisablehook__(unraisable)


def _send_again(number: int) -> None:
    later = Timer(AGAIN_SECONDS, os.kill, (os.getpid(), number))
    later.daemon = True
    later.start()
