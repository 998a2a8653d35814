"""Opening the rerun viewer, with a window or without."""

import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryFile

from rerun.experimental import ViewerClient

from doo_ti.errors import InputError, InterruptedRunError

FILE = "run.rrd"


PROGRAM = "import sys; from rerun_cli.__main__ import main; sys.exit(main())"
"""``python -m rerun_cli`` ends with 0 whatever became of the viewer."""


def open_viewer(path) -> None:
    """Open a run's recording (the run's folder or the .rrd file) in the rerun viewer, and wait until its window is closed.

    Raises InputError where there is no recording, InterruptedRunError where the viewer fails, as without a window.
    """
    with TemporaryFile() as log:
        if not _viewer(path, "--port", "auto", log=log).wait():
            return
        log.seek(0)
        reasons = [line for line in log.read().decode(errors="replace").splitlines() if line.startswith("Error: ")]
    reason = reasons[-1].removeprefix("Error: ") if reasons else "it does not say why"
    raise InterruptedRunError(f"view: the viewer opened no window, or failed ({reason}); set DISPLAY or WAYLAND_DISPLAY to a "
                              "display that answers, or save a picture without one: tools/screenshot.py")


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


def _viewer(path, *options: str, own_group: bool = False, log=None) -> subprocess.Popen:
    file = Path(path) / FILE if Path(path).is_dir() else Path(path)
    if not file.is_file():
        raise InputError(path, FILE, "there is no recording", "name a folder that doo-ti sweep has written")
    # Left alone the viewer listens on every network interface and reports its use; CI=true stops the reports.
    command = [sys.executable, "-c", PROGRAM, "--bind", "127.0.0.1", *options, str(file)]
    return subprocess.Popen(command, env=os.environ | {"CI": "true"}, start_new_session=own_group, stderr=log)
