"""Starting the rerun viewer."""

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryFile

from doo_ti.errors import InputError, InterruptedRunError

FILE = "run.rrd"
PROGRAM = "import sys; from rerun_cli.__main__ import main; sys.exit(main())"
"""``python -m rerun_cli`` ends with 0 even where the viewer fails."""


def open_viewer(path) -> None:
    """Open a run's recording (the run's folder or the .rrd file) in the rerun viewer, and wait until its window is closed.

    Raises InputError where there is no recording, InterruptedRunError where the viewer fails, as without a window.
    """
    with TemporaryFile() as log:
        if not start_viewer(path, "--port", "auto", log=log).wait():
            return
        log.seek(0)
        reasons = [line for line in log.read().decode(errors="replace").splitlines() if line.startswith("Error: ")]
    reason = reasons[-1].removeprefix("Error: ") if reasons else "without a reason"
    raise InterruptedRunError(f"view: the viewer opened no window, or failed ({reason}); set DISPLAY or WAYLAND_DISPLAY to a "
                              "display that answers, or give --screenshot FILE.png or --web")


def serve_viewer(path, announce: Callable[[str], None]) -> None:
    """Serve a run's recording (the run's folder or the .rrd file) to browsers on this machine until interrupted; ``announce``
    gets the address. Raises InputError where there is no recording, InterruptedRunError where the server fails."""
    web, data = free_port(), free_port()
    server = start_viewer(path, "--serve-web", "--web-viewer-port", str(web), "--port", str(data), own_group=True,
                          log=subprocess.DEVNULL)
    announce(f"http://127.0.0.1:{web}?url=rerun%2Bhttp://127.0.0.1:{data}/proxy")
    try:
        if server.wait():
            raise InterruptedRunError(f"view: the server ended with exit code {server.returncode}")
    except KeyboardInterrupt:  # the way to end it
        pass
    finally:
        end_viewer(server)


def end_viewer(process: subprocess.Popen) -> None:
    """End a viewer that has a process group of its own: the command, and the program that it started."""
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGTERM)
    process.wait()


def free_port() -> int:
    """A port of this machine that no program uses."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


def start_viewer(path, *options: str, own_group: bool = False, log=None) -> subprocess.Popen:
    """The process of the viewer on a recording, in a process group of its own if ``own_group``; errors go to the file ``log``.
    Raises InputError where there is no recording."""
    file = Path(path) / FILE if Path(path).is_dir() else Path(path)
    if not file.is_file():
        raise InputError(path, FILE, "there is no recording", "name a folder that doo-ti sweep has written")
    # By default the viewer listens on every network interface and reports its use; CI=true stops the reports.
    command = [sys.executable, "-c", PROGRAM, "--bind", "127.0.0.1", *options, str(file)]
    return subprocess.Popen(command, env=os.environ | {"CI": "true"}, start_new_session=own_group, stderr=log)
