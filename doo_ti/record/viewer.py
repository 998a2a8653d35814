"""A recording while it is written, what all recordings have in common, and the rerun viewer that shows them, as one process
that ends with the command: its window, its page for a browser, and screenshots.

As the viewer serves it, the page reports its use, asks for new versions, and takes its fonts from another server. A header that
browsers obey forbids all of that; the viewer cannot send it, so that its page goes through a server that adds it.

Screenshots need no display, but a Vulkan driver; on Debian: ``apt-get install mesa-vulkan-drivers libvulkan1``.

Axes: D observations, N rods, V vertices.
"""

import os
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.client import HTTPConnection
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from threading import Thread
from typing import BinaryIO

import numpy as np
import pyarrow
import rerun
import rerun.blueprint as blueprint
from rerun.experimental import ViewerClient

from doo_ti.report.canvas import GridView, Observed
from doo_ti.system.errors import InterruptedRunError, require
from doo_ti.system.files import whole_file, write_whole
from doo_ti.system.terminal import ended, kept_from_children

DESCRIPTORS = Path("/proc/self/fd")  # where Linux lists the open files of a process
PIECE_BYTES = 1 << 16
OBSERVED, FAILED, TEXT = (235, 235, 235), (255, 46, 99), (175, 175, 175)
BACKGROUND = (16, 18, 22)
points = rerun.Radius.ui_points  # widths on the screen, however near


@contextmanager
def recording(path, run_id: str, name: str, layout: blueprint.Blueprint) -> Iterator[rerun.RecordingStream]:
    """The stream of the file ``path``, which contains its layout. The file appears when it is complete, and not at all where
    the recording fails. Raises OSError where it cannot be written."""
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
    """The path rerun writes to instead of ``file``: a pipe, since on a full disk rerun reports no error and waits for ever.
    Raises OSError, naming ``path``, where the content of the pipe cannot be written."""
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
        os.close(inlet)  # rerun opened the pipe itself, and has closed it
        copying.join()
    if failures:
        raise OSError(failures[0].errno, failures[0].strerror, str(path))


def _copy(outlet: int, file: BinaryIO, failures: list[OSError]) -> None:
    """Write the content of the pipe ``outlet`` to ``file``; after a failure only read it, so that rerun does not wait."""
    with open(outlet, "rb", buffering=0) as pipe:
        while piece := pipe.read(PIECE_BYTES):
            if not failures:
                try:
                    file.write(piece)
                    file.flush()
                except OSError as error:
                    failures.append(error)


def panels(timeline: str) -> tuple:
    """The viewer's own panels collapsed, and its cursor on the last step of ``timeline``."""
    return (blueprint.BlueprintPanel(state="collapsed"), blueprint.SelectionPanel(state="collapsed"),
            blueprint.TimePanel(state="collapsed", timeline=timeline, play_state="following"))


def entity_name(title: str) -> str:
    """``title`` in letters, digits and underscores, as a part of an entity's path."""
    return "".join(letter if letter.isalnum() else "_" for letter in title)


def log_up(stream, entity: str, up) -> None:
    """The coordinate axis nearest to ``up`` as the viewer's vertical."""
    axis = int(np.argmax(np.abs(up)))
    name = f"RIGHT_HAND_{'XYZ'[axis]}_{'UP' if up[axis] > 0 else 'DOWN'}"
    stream.log(entity, getattr(rerun.ViewCoordinates, name), static=True)


def log_observations(stream, world: str, grid: GridView, observed: Observed) -> None:
    """Observed marks and the lines through them in their places of the grid view, below the entity ``world``; a missing mark is
    left out."""
    present = np.isfinite(observed.vertices).all(axis=-1)
    placed = (observed.vertices + grid.offset[:, None]).astype(np.float32)
    log_up(stream, world, grid.basis[2])
    strips = [rod[mask] for rod, mask in zip(placed, present, strict=True)]
    stream.log(f"{world}/observations", rerun.LineStrips3D(
        strips, colors=OBSERVED, radii=points(0.5), labels=observed.names, show_labels=False),
        rerun.AnyValues(offset_mm=vectors(grid.offset)), static=True)
    stream.log(f"{world}/observations/marks", rerun.Points3D(placed[present], colors=OBSERVED, radii=points(1.0)), static=True)
    if grid.headings:
        texts, places = zip(*grid.headings, strict=True)
        stream.log(f"{world}/headings", rerun.Points3D(
            places, labels=texts, show_labels=True, colors=TEXT, radii=points(0)), static=True)


def drawn_strips(rods: np.ndarray):
    """(N, V, 3) rods as the viewer takes them: a rod with a NaN in it is an empty strip, which keeps its instance index and
    draws nothing."""
    rods = rods.astype(np.float32)
    if np.isfinite(rods).all():
        return rods
    return [rod if np.isfinite(rod).all() else rod[:0] for rod in rods]


def send_rods(stream, entity: str, times: list[rerun.TimeColumn], rods: np.ndarray, **colors: np.ndarray) -> None:
    """Rods or lines (T, N, V, 3) of the ``entity`` at T ``times``, and their ``colors`` (T, N, 3) where these change."""
    moments, count = rods.shape[:2]
    stream.send_columns(entity, times, rerun.LineStrips3D.columns(
        strips=drawn_strips(rods.reshape(-1, *rods.shape[2:])),
        **{name: values.reshape(-1, 3) for name, values in colors.items()}).partition([count] * moments))


def vectors(array: np.ndarray) -> pyarrow.Array:
    """(N, 3) numbers as rerun stores them."""
    return pyarrow.FixedSizeListArray.from_arrays(pyarrow.array(array.astype(np.float32).reshape(-1)), 3)


def space_view(name: str, origin: str, eye: tuple | None = None, **options) -> blueprint.Spatial3DView:
    """A view of the entity ``origin`` in space; ``eye`` are the position to look from, the point looked at, and up."""
    if eye is not None:
        position, target, up = eye
        options["eye_controls"] = blueprint.EyeControls3D(
            kind=blueprint.Eye3DKind.Orbital, position=position, look_target=target, eye_up=up)
    return blueprint.Spatial3DView(name=name, origin=origin, line_grid=False, background=BACKGROUND, **options)


def log_view(name: str, timeline: str) -> blueprint.TextLogView:
    """The lines of the entity ``log`` with their place on ``timeline``, and nothing else."""
    columns = blueprint.TextLogColumns(timeline_columns=[blueprint.encodings.TimelineColumn(timeline)],
                                       text_log_columns=[blueprint.encodings.TextLogColumn("Body")])
    return blueprint.TextLogView(name=name, origin="log", columns=columns)


def front_view(grid: GridView, world: str, name: str, aspect: float = 1.35) -> blueprint.Spatial3DView:
    """The grid view from the front, far enough away to fit into a view ``aspect`` times as wide as high."""
    width, height = grid.extent
    away = 0.52 * max(height, width / aspect) / np.tan(np.radians(27.5))
    return space_view(name, world, (grid.centre - away * grid.basis[1], grid.centre, grid.basis[2]))


# --- the viewer ----------------------------------------------------------------------------------------------------------

FILE = "run.rrd"
PROGRAMS = ("Rerun.app/Contents/MacOS/Rerun", "rerun.exe", "rerun")
"""Where the package of the viewer may have its program."""
NOWHERE = "http://127.0.0.1:9"  # a proxy that nobody runs
ALONE = {"CI": "true", **{name: NOWHERE for name in ("ALL_PROXY", "HTTPS_PROXY", "HTTP_PROXY")}}
"""The viewer's environment. By default it reports its use, which CI=true stops, and asks a server for new versions, which no
option stops: its requests go to a proxy, and there is none."""


def open_viewer(path) -> None:
    """Open a run's recording (the run's folder or the .rrd file) in the rerun viewer, and wait until its window is closed.
    Raises InputError where there is no recording, InterruptedRunError where the viewer fails, as without a window."""
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
    require(os.path.isfile(file), path, FILE, "there is no recording", "name a folder that doo-ti sweep has written")
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


HEADER = "Content-Security-Policy"
POLICY = "default-src 'self' http://127.0.0.1:{data} 'unsafe-inline' 'unsafe-eval' data: blob:"
KEPT = ("Content-Type", "rerun-final-length")
ANSWER_SECONDS = 60.0


@contextmanager
def local_page(web: int, data: int) -> Iterator[int]:
    """The port at which the page of the viewer at port ``web`` is served, as a context; the page may ask it and port ``data``,
    where the viewer has its recording."""

    class Page(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            viewer = HTTPConnection("127.0.0.1", web, timeout=ANSWER_SECONDS)
            try:
                viewer.request("GET", self.path)
                answer = viewer.getresponse()
                content = answer.read()
            except OSError:
                self.send_error(502)
                return
            finally:
                viewer.close()
            self.send_response(answer.status)
            for name in KEPT:
                if answer.getheader(name):
                    self.send_header(name, answer.getheader(name))
            self.send_header("Content-Length", str(len(content)))
            self.send_header(HEADER, POLICY.format(data=data))
            self.end_headers()
            self.wfile.write(content)

        def log_message(self, *parts) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Page)
    thread = Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield server.server_address[1]
    finally:
        server.shutdown()
        server.server_close()


def save_screenshot(path: str | Path, picture: str | Path) -> None:
    """Write what the viewer shows of a run (its folder or the .rrd file) as a PNG; the software driver of Mesa suffices. Raises
    InputError where there is no recording, InterruptedRunError where the viewer does not start."""
    port = free_port()
    with running_viewer(path, "--headless", "--port", str(port), "--window-size", "1600x900") as viewer:
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
