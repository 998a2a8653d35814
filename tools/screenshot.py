"""Save what the viewer shows of a run as a PNG: ``python tools/screenshot.py RUN OUT.png``.

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
from doo_ti.record.viewer import viewer


def save_screenshot(path, picture, size=(1600, 900)) -> None:
    """Write what the viewer shows as a PNG, without a display (needs a Vulkan driver; mesa's in software will do).

    Raises InputError where there is no recording, RuntimeError where the viewer does not start.
    """
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    process = viewer(path, "--headless", "--port", str(port), "--window-size", "{}x{}".format(*size), own_group=True)
    try:
        client = _connect(process, port)
        client.run_command("ui.toggle_top_panel")
        time.sleep(12)  # the viewer's notices fade and its plots fill
        client.save_screenshot(str(Path(picture).resolve()))
    finally:
        os.killpg(process.pid, signal.SIGTERM)  # the command and the viewer it started
        process.wait()


def _connect(process: subprocess.Popen, port: int) -> ViewerClient:
    """The viewer on ``port``, once it has the recording open."""
    client, deadline = None, time.monotonic() + 60
    while process.poll() is None and time.monotonic() < deadline:
        try:
            client = client or ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
            if client.get_state().active_recording:
                return client
        except ConnectionError:  # not listening yet
            pass
        time.sleep(0.5)
    raise RuntimeError("the rerun viewer did not start; is a Vulkan driver installed?")


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


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
