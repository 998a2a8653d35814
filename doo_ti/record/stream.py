"""A recording while it is written."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Thread
from typing import BinaryIO

import rerun
import rerun.blueprint as blueprint

from doo_ti.io.files import whole_file

DESCRIPTORS = Path("/proc/self/fd")
"""Where Linux names what a process has open."""
PIECE_BYTES = 1 << 16


@contextmanager
def recording(path, run_id: str, name: str, layout: blueprint.Blueprint) -> Iterator[rerun.RecordingStream]:
    """The stream of the file ``path``, its layout inside. Nobody meets a file that is still being written, and none stays
    of a recording that failed. Raises OSError where it cannot be written."""
    path = Path(path)
    stream = rerun.RecordingStream("doo_ti", recording_id=run_id)
    stream.set_log_time_enabled(False)
    stream.set_log_tick_enabled(False)
    with whole_file(path) as file, _written(file, path) as target:
        try:
            stream.save(target, default_blueprint=layout)
            stream.send_recording_name(name)
            yield stream
            stream.flush(timeout_sec=60)
        finally:
            stream.disconnect()


@contextmanager
def _written(file: BinaryIO, path: Path) -> Iterator[str]:
    """What rerun writes to in place of ``file``: a pipe, since on a full disk rerun itself reports nothing and waits for ever.

    Raises OSError, naming ``path``, where what comes out of the pipe cannot be written.
    """
    if not DESCRIPTORS.is_dir():
        yield file.name
        return
    failures: list[OSError] = []
    outlet, inlet = os.pipe()
    copying = Thread(target=_copy, args=(outlet, file, failures))
    copying.start()
    try:
        yield str(DESCRIPTORS / str(inlet))
    finally:
        os.close(inlet)  # rerun has opened the pipe by itself, and has closed it by now
        copying.join()
    if failures:
        raise OSError(failures[0].errno, failures[0].strerror, str(path))


def _copy(outlet: int, file: BinaryIO, failures: list[OSError]) -> None:
    """Write what comes out of the pipe ``outlet`` to ``file``; from a failure on only empty it, so that nobody waits."""
    with open(outlet, "rb", buffering=0) as pipe:
        while piece := pipe.read(PIECE_BYTES):
            if not failures:
                try:
                    file.write(piece)
                    file.flush()
                except OSError as error:
                    failures.append(error)


def panels(timeline: str) -> tuple:
    """The viewer's own panels folded away, and its cursor on the last step of ``timeline``."""
    return (blueprint.BlueprintPanel(state="collapsed"), blueprint.SelectionPanel(state="collapsed"),
            blueprint.TimePanel(state="collapsed", timeline=timeline, play_state="following"))


def entity_name(title: str) -> str:
    """``title`` in letters, digits and underscores, as a part of an entity's path."""
    return "".join(letter if letter.isalnum() else "_" for letter in title)
