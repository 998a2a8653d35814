"""Ctrl-C, SIGTERM and the end of the terminal (SIGHUP) as a KeyboardInterrupt that is raised where commands expect one.

Raised anywhere, it could be mistaken for a failed import, or be lost in a destructor.
"""

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Timer, current_thread, main_thread
from types import FrameType
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # most commands start no process
    from subprocess import Popen

SECONDS_TO_END = 10.0
"""That a process has to end by itself before it is killed."""
AGAIN_SECONDS = 0.05
"""Delay before a signal that was raised where it is lost is sent again."""
MOST_POSTPONED = 200
"""Times in succession: only an import that runs the program takes longer."""

HANGUP = getattr(signal, "SIGHUP", None)
"""The terminal is closed; not on Windows."""

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
