"""Signed distances to a closed surface of triangles, by the library trimesh. Axes: N vertices, M triangles."""

from io import BytesIO
from pathlib import Path

import numpy as np

from doo_ti.io.arrays import first_line
from doo_ti.system.errors import InputError, real_array, require_number
from doo_ti.system.files import read_content

MOST_POINTS = 8_000_000
CHUNK = 20_000
"""Points whose distances are computed at a time."""
FORMATS = (".stl", ".ply", ".obj")
"""trimesh reads more: archives, which it unpacks, and files that name others."""
STL_HEADER, STL_TRIANGLE = 84, 50
"""Bytes of a binary STL file."""
MARGIN, MARGIN_SPACINGS = 0.1, 2.0
"""Of the surface's largest size, and besides so many spacings: grid around it."""


def sampled(mesh, spacing: float, margin: float | None) -> tuple[np.ndarray, float, np.ndarray]:
    """(values (X, Y, Z) mm, spacing, the first point (3,)) of the grid around a surface, as
    :meth:`.DistanceGrid.from_mesh` takes it. Raises InputError for what is no closed surface, and where trimesh is missing."""
    require_number("DistanceGrid", "spacing", spacing)
    if not spacing > 0:
        raise InputError("DistanceGrid", "spacing", f"{spacing:g}", "give a positive length in mm")
    surface, name = _surface(mesh)
    low, high = surface.bounds
    if margin is None:
        margin = MARGIN * (high - low).max() + MARGIN_SPACINGS * spacing
    require_number("DistanceGrid", "margin", margin)
    if not margin > 0:
        raise InputError("DistanceGrid", "margin", f"{margin:g}", "give a positive length in mm")
    counts = np.ceil((high - low + 2 * margin) / spacing) + 1
    if counts.prod() > MOST_POINTS:
        raise InputError(name, "spacing", f"{spacing:g} mm makes {counts.prod():.3g} points", "give a larger one")
    counts = counts.astype(np.int64)
    first = 0.5 * (low + high) - 0.5 * spacing * (counts - 1)
    points = first + spacing * np.indices(counts).reshape(3, -1).T
    return _distances(surface, points).reshape(counts), spacing, first


def _distances(surface, points: np.ndarray) -> np.ndarray:
    """(N,) signed distances, negative inside."""
    from trimesh.proximity import signed_distance

    parts = np.split(points, np.arange(CHUNK, len(points), CHUNK))
    return -np.concatenate([signed_distance(surface, part) for part in parts])


def _surface(mesh):
    """(the mesh of trimesh, its name for messages). Raises InputError."""
    try:
        import rtree  # noqa: F401  trimesh looks nearest triangles up with it
        import trimesh
    except ImportError:
        raise InputError("DistanceGrid", "mesh", "trimesh or rtree is not installed", "pip install 'doo_ti[mesh]'") from None
    if isinstance(mesh, str | Path):
        name, path = mesh, Path(mesh)
        if path.suffix.lower() not in FORMATS:
            raise InputError(path, "file", f"suffix {path.suffix!r} is not a format of meshes", f"give {', '.join(FORMATS)}")
        content = _readable(path, read_content(path, remedy="name a readable mesh"))
        try:
            with np.errstate(invalid="ignore"):  # numbers that no integer holds
                found = trimesh.load(BytesIO(content), file_type=path.suffix[1:].lower(), force="mesh")
            is_surface = len(found.faces) and np.isfinite(found.vertices).all()
        except Exception as error:  # trimesh has no exception of its own
            raise InputError(path, "file", f"no mesh ({first_line(error)})", "give STL, PLY or OBJ") from None
        if not is_surface:
            raise InputError(path, "file", "has no triangles, or points that are not finite", "give a closed surface")
    else:
        name = "DistanceGrid"
        vertices, triangles = (real_array(name, "mesh", part, "give vertices (N, 3) and triangles (M, 3)") for part in mesh)
        if vertices.ndim != 2 or triangles.ndim != 2 or vertices.shape[1] != 3 or triangles.shape[1] != 3:
            raise InputError(name, "mesh", f"shapes {vertices.shape} and {triangles.shape}",
                             "give vertices (N, 3) and triangles (M, 3)")
        if not np.isfinite(vertices).all() or not np.isin(triangles, np.arange(len(vertices))).all():
            raise InputError(name, "mesh", "points that are not finite, or triangles of points that are not there",
                             "give triangles by the numbers of their points, from 0")
        found = trimesh.Trimesh(vertices, triangles)
    if not len(found.faces) or not found.is_watertight:
        raise InputError(name, "mesh", "not a closed surface", "close its holes, with trimesh.repair for example")
    return found, name


def _readable(path: Path, content: bytes) -> bytes:
    """The bytes of a mesh, text among them in UTF-8. Raises InputError for a binary STL file that is not whole."""
    suffix = path.suffix.lower()
    if suffix == ".stl":
        whole = STL_HEADER + STL_TRIANGLE * int.from_bytes(content[STL_HEADER - 4 : STL_HEADER], "little")
        if len(content) == whole:
            return content
        if not content.lstrip().lower().startswith(b"solid"):
            raise InputError(path, "file", f"{len(content):,} bytes where its header says {whole:,}", "export the mesh again")
    try:
        content.decode()
    except UnicodeDecodeError:
        return content if suffix == ".ply" else content.decode("latin-1").encode()
    return content
