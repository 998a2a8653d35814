"""A recording while it is written, and what all recordings have in common, obstacles and contact forces among it.

Axes: D observations, R rods, T frames, V vertices.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Thread
from typing import BinaryIO

import numpy as np
import pyarrow
import rerun
import rerun.blueprint as blueprint

from doo_ti.contact.surroundings import Moving, since_first
from doo_ti.report.contact import Touched
from doo_ti.report.grid_view import GridView, Observed
from doo_ti.system.files import whole_file

DESCRIPTORS = Path("/proc/self/fd")
"""Where Linux lists the open files of a process."""
PIECE_BYTES = 1 << 16
OBSERVED, FAILED, TEXT = (235, 235, 235), (255, 46, 99), (175, 175, 175)
BACKGROUND = (16, 18, 22)


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

    Raises OSError, naming ``path``, where the content of the pipe cannot be written.
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
        strips, colors=OBSERVED, radii=rerun.Radius.ui_points(0.5), labels=observed.names, show_labels=False),
        rerun.AnyValues(offset_mm=vectors(grid.offset)), static=True)
    stream.log(f"{world}/observations/marks", rerun.Points3D(
        placed[present], colors=OBSERVED, radii=rerun.Radius.ui_points(1.0)), static=True)
    if grid.headings:
        texts, places = zip(*grid.headings, strict=True)
        stream.log(f"{world}/headings", rerun.Points3D(
            places, labels=texts, show_labels=True, colors=TEXT, radii=rerun.Radius.ui_points(0)), static=True)


def drawn_strips(rods: np.ndarray):
    """(N, V, 3) rods as the viewer takes them: a rod with a NaN in it is an empty strip, which keeps its instance index and
    draws nothing."""
    rods = rods.astype(np.float32)
    if np.isfinite(rods).all():
        return rods
    return [rod if np.isfinite(rod).all() else rod[:0] for rod in rods]


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


OBSTACLE, FORCE = (130, 138, 150, 255), (110, 160, 255)


def log_obstacles(stream, entity: str, when: list, touched: Touched, offset: np.ndarray) -> None:
    """The obstacles around each rod, moved by the rod's ``offset`` (R, 3), below ``entity``; those that move at the T times
    ``when``."""
    for row, move in enumerate(offset):
        for number, (given, _, vertices, triangles, normals) in enumerate(touched.meshes(row, 0)):
            own, corners = f"{entity}/{row}/{number}", _outward(vertices[triangles], normals).reshape(-1, 3)
            if isinstance(given, Moving):
                rotation, shift = since_first(*given.path)
                stream.send_columns(own, when, rerun.Transform3D.columns(mat3x3=rotation[0], translation=shift[0] + move))
            else:
                corners = corners + move
            stream.log(own, rerun.Mesh3D(
                vertex_positions=corners, vertex_normals=np.repeat(normals, 3, axis=0), albedo_factor=OBSTACLE,
                # A table does not hide from below what lies on it.
                face_rendering=rerun.components.MeshFaceRendering.Front), static=True)


def _outward(corners: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Triangles (M, 3, 3) with their corners in the sense of their outward ``normals`` (M, 3)."""
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    turned = (across * normals).sum(axis=-1) < 0.0
    return np.where(turned[:, None, None], corners[:, ::-1], corners)


def log_forces(stream, entity: str, when: list, touched: Touched, offset: np.ndarray) -> None:
    """Contact forces on the rods that have an ``offset`` (R, 3), as arrows at the T times ``when``."""
    places, vectors, counts = [], [], []
    for frame in range(touched.force.shape[1]):
        found = [touched.arrows(row, frame) for row in range(len(offset))]
        places += [origin + move for (origin, _), move in zip(found, offset, strict=True)]
        vectors += [vector for _, vector in found]
        counts.append(sum(len(origin) for origin, _ in found))
    stream.log(entity, rerun.Arrows3D.from_fields(colors=FORCE, radii=rerun.Radius.ui_points(0.8)), static=True)
    stream.send_columns(entity, when, rerun.Arrows3D.columns(
        origins=np.concatenate(places), vectors=np.concatenate(vectors)).partition(counts))
