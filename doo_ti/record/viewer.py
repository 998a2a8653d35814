"""Starting the rerun viewer, as one process that ends with the command."""

import os
import socket
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryFile

from doo_ti.record.web_page import local_page
from doo_ti.system.errors import InputError, InterruptedRunError
from doo_ti.system.interruption import ended, kept_from_children

FILE = "run.rrd"
PROGRAMS = ("Rerun.app/Contents/MacOS/Rerun", "rerun.exe", "rerun")
"""Where the package of the viewer may have its program."""
NOWHERE = "http://127.0.0.1:9"
"""A proxy that nobody runs."""
ALONE = {"CI": "true", **{name: NOWHERE for name in ("ALL_PROXY", "HTTPS_PROXY", "HTTP_PROXY")}}
"""The viewer's environment. By default it reports its use, which CI=true stops, and asks a server for new versions, which no
option stops: its requests go to a proxy, and there is none."""


def open_viewer(path) -> None:
    """Open a run's recording (the run's folder or the .rrd file) in the rerun viewer, and wait until its window is closed.

    Raises InputError where there is no recording, InterruptedRunError where the viewer fails, as without a window.
    """
    with TemporaryFile() as log:
        with running_viewer(path, "--port", "auto", log=log) as viewer:
            if not viewer.wait():
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
    try:
        with (running_viewer(path, "--serve-web", "--web-viewer-port", str(web), "--port", str(data)) as server,
              local_page(web, data) as page):
            announce(f"http://127.0.0.1:{page}?url=rerun%2Bhttp://127.0.0.1:{data}/proxy")
            if server.wait():
                raise InterruptedRunError(f"view: the server ended with exit code {server.returncode}")
    except KeyboardInterrupt:  # the way to end it
        pass


def free_port() -> int:
    """A port of this machine that no program uses."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


@contextmanager
def running_viewer(path, *options: str, log=subprocess.DEVNULL) -> Iterator[subprocess.Popen]:
    """The process of the viewer on a recording, as a context that ends it; errors go to the file ``log``. Raises InputError
    where there is no recording."""
    file = Path(path) / FILE if os.path.isdir(path) else Path(path)
    if not os.path.isfile(file):
        raise InputError(path, FILE, "there is no recording", "name a folder that doo-ti sweep has written")
    # By default the viewer listens on every network interface.
    command = [_program(), "--bind", "127.0.0.1", *options, str(file)]
    environment = {name: value for name, value in os.environ.items() if name.upper() not in (*ALONE, "NO_PROXY")} | ALONE
    process = None
    try:
        with kept_from_children():
            process = subprocess.Popen(command, env=environment, stderr=log)
        yield process
    finally:
        if process is not None:
            ended(process)


def _program() -> str:
    """The viewer itself: the program that its package starts would have to be ended, too."""
    if own := os.environ.get("RERUN_CLI_PATH"):  # as that package does
        return own
    import rerun_cli

    folder = Path(rerun_cli.__file__).parent
    found = [str(folder / name) for name in PROGRAMS if (folder / name).is_file()]
    if not found:
        raise InterruptedRunError(f"view: {folder} has no viewer; install rerun-sdk again")
    return found[0]
