"""Save a screenshot of the viewer with a run as a PNG: ``python tools/screenshot.py RUN OUT.png``.

Needs no display but a Vulkan driver; on Debian: ``apt-get install mesa-vulkan-drivers libvulkan1``.
"""

import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

from rerun.experimental import ViewerClient

from doo_ti.errors import InputError
from doo_ti.record.viewer import start_viewer


def main(arguments: list[str]) -> int:
    if len(arguments) != 2:
        print("usage: python tools/screenshot.py RUN OUT.png", file=sys.stderr)
        return 2
    try:
        save_screenshot(*arguments)
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


def save_screenshot(path, picture, size=(1600, 900)) -> None:
    """Write what the viewer shows as a PNG, without a display (needs a Vulkan driver; the software driver of Mesa suffices).

    Raises InputError where there is no recording, RuntimeError where the viewer does not start.
    """
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    viewer = start_viewer(path, "--headless", "--port", str(port), "--window-size", "{}x{}".format(*size), own_group=True)
    try:
        client = _connect(viewer, port)
        client.run_command("ui.toggle_top_panel")
        time.sleep(12)  # until the viewer's notices disappear and its plots are drawn
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


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
