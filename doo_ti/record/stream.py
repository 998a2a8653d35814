"""A recording while it is written."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import rerun
import rerun.blueprint as blueprint


@contextmanager
def recording(path, run_id: str, name: str, layout: blueprint.Blueprint) -> Iterator[rerun.RecordingStream]:
    """The stream of the file ``path``, its layout inside. Nobody meets a file that is still being written, and none stays
    of a recording that failed."""
    stream = rerun.RecordingStream("doo_ti", recording_id=run_id)
    stream.set_log_time_enabled(False)
    stream.set_log_tick_enabled(False)
    part = Path(path).with_name(Path(path).name + ".part")
    try:
        stream.save(part, default_blueprint=layout)
        stream.send_recording_name(name)
        yield stream
        stream.flush(timeout_sec=60)
        stream.disconnect()
        os.replace(part, path)
    finally:
        stream.disconnect()
        part.unlink(missing_ok=True)


def panels(timeline: str) -> tuple:
    """The viewer's own panels folded away, and its cursor on the last step of ``timeline``."""
    return (blueprint.BlueprintPanel(state="collapsed"), blueprint.SelectionPanel(state="collapsed"),
            blueprint.TimePanel(state="collapsed", timeline=timeline, play_state="following"))


def entity_name(title: str) -> str:
    """``title`` in letters, digits and underscores, as a part of an entity's path."""
    return "".join(letter if letter.isalnum() else "_" for letter in title)
