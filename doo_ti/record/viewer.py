"""Opening the rerun viewer, with a window or without."""

import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

from rerun.experimental import ViewerClient

from doo_ti.errors import InputError

FILE = "run.rrd"


def open_viewer(path) -> int:
    """Open a run's recording (the run's folder or the .rrd file) in the rerun viewer; returns the viewer's exit code.

    Raises InputError where there is no recording.
    """
    return _viewer(path, "--port", "auto").wait()


def save_screenshot(path, picture, size=(1600, 900)) -> None:
    """Write what the viewer shows as a PNG, without a display (needs a Vulkan driver; mesa's in software will do).

    Raises InputError where there is no recording, RuntimeError where the viewer does not start.
    """
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    viewer = _viewer(path, "--headless", "--port", str(port), "--window-size", "{}x{}".format(*size), own_group=True)
    try:
        client = _connect(viewer, port)
        client.run_command("ui.toggle_top_panel")
        time.sleep(12)  # the viewer's notices fade and its plots fill
        client.save_screenshot(str(Path(picture).resolve()))
    finally:
        os.killpg(viewer.pid, signal.SIGTERM)  # the command and the viewer it started
        viewer.wait()


def _connect(viewer: subprocess.Popen, port: int) -> ViewerClient:
    """The viewer on ``port``, once it has the recording open."""
    client, deadline = None, time.monotonic() + 60
    while viewer.poll() is None and time.monotonic() < deadline:
        try:
            client = client or ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
            if client.get_state().active_recording:
                return client
        except ConnectionError:  # not listening yet
            pass
        time.sleep(0.5)
    raise RuntimeError("the rerun viewer did not start; is a Vulkan driver installed?")


def _viewer(path, *options: str, own_group: bool = False) -> subprocess.Popen:
    file = Path(path) / FILE if Path(path).is_dir() else Path(path)
    if not file.is_file():
        raise InputError(path, FILE, "there is no recording", "name a folder that doo-ti sweep has written")
    # Left alone the viewer listens on every network interface and reports its use; CI=true stops the reports.
    command = [sys.executable, "-m", "rerun_cli", "--bind", "127.0.0.1", *options, str(file)]
    return subprocess.Popen(command, env=os.environ | {"CI": "true"}, start_new_session=own_group)
