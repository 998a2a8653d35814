"""Ctrl-C, and being told to end, as a KeyboardInterrupt that comes up where commands expect one.

Raised wherever the program happens to be it could be taken for a failed import, or be lost in a destructor.
"""

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Timer, current_thread, main_thread
from types import FrameType

AGAIN_SECONDS = 0.05
"""After which a signal that cannot be used where it came is sent again."""
MOST_POSTPONED = 200
"""Times in succession: no import takes so long, but one that runs the program."""

_postponed = 0


def before_anything_is_begun() -> bool:
    """Have Ctrl-C end the process on the spot; False where whoever started this process has it ignored."""
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        return False
    signal.signal(signal.SIGINT, _end)
    return True


def while_running(interruptible: bool) -> None:
    """Have both signals raise KeyboardInterrupt: what is done is kept, and the way to go on is printed."""
    if interruptible:
        signal.signal(signal.SIGINT, _interrupt)
    signal.signal(signal.SIGTERM, _interrupt)
    sys.unraisablehook = _not_lost


def when_all_is_done() -> None:
    """Have Ctrl-C do nothing any more: the process is about to end."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def kept_from_children() -> Iterator[None]:
    """Start processes inside: Ctrl-C, which a terminal sends to them as well, is for their parent alone, who ends them.

    The parent hears of it, and of being told to end, afterwards: whatever thread of its own receives a signal, Python raises in
    the main one, and there in the midst of starting a process, which then ends with a traceback or is never heard of again.
    """
    postponed: list[int] = []
    before = {}
    if current_thread() is main_thread():
        for number in (signal.SIGINT, signal.SIGTERM):
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
    """As Python's own hook, for what cannot be raised where it came up, but for an interruption."""
    if issubclass(unraisable.exc_type, KeyboardInterrupt):
        _send_again(signal.SIGINT)
    else:
        sys.__unraisablehook__(unraisable)


def _send_again(number: int) -> None:
    later = Timer(AGAIN_SECONDS, os.kill, (os.getpid(), number))
    later.daemon = True
    later.start()
