"""Screenshots of the viewer without a display. They need a Vulkan driver; on Debian: ``apt-get install mesa-vulkan-drivers
libvulkan1``."""

import subprocess
import time
from pathlib import Path
from tempfile import TemporaryDirectory

from rerun.experimental import ViewerClient

from doo_ti.record.viewer import free_port, running_viewer
from doo_ti.system.errors import InterruptedRunError
from doo_ti.system.files import write_whole


def save_screenshot(path: str | Path, picture: str | Path, size: tuple[int, int] = (1600, 900)) -> None:
    """Write what the viewer shows of a run (its folder or the .rrd file) as a PNG; the software driver of Mesa suffices.

    Raises InputError where there is no recording, InterruptedRunError where the viewer does not start.
    """
    port = free_port()
    with running_viewer(path, "--headless", "--port", str(port), "--window-size", "{}x{}".format(*size)) as viewer:
        client = _connect(viewer, port)
        client.run_command("ui.toggle_top_panel")
        time.sleep(12)  # until the viewer's notices disappear and its plots are drawn
        # The viewer writes a file by its name.
        with TemporaryDirectory() as folder:
            client.save_screenshot(str(Path(folder) / "view.png"))
            write_whole(Path(picture), lambda file: file.write((Path(folder) / "view.png").read_bytes()))


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
    raise InterruptedRunError("view: the viewer did not start; on Debian apt-get install mesa-vulkan-drivers libvulkan1")

