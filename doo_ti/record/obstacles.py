"""Obstacles and contact forces in recordings. Axes: R rods, T frames."""

import numpy as np
import rerun

from doo_ti.contact.moving import Moving, since_first
from doo_ti.report.touched import Touched

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
