"""The rods that all peers relax: hanging between two ends held by position and tangent, free to roll, so without twist.

Peers without material frames can relax them, too. Weight 1, 99 mm in 33 edges, six end distances.

Axes: R rods, V vertices.
"""

from dataclasses import dataclass

import numpy as np

from doo_ti import Clamp, Clamps, Configuration, Material, relax
from doo_ti.rod.frames import bishop_frames, quaternion_from_matrix

LENGTH, EDGES, BEND, LIMP = 99.0, 33, 6e5, 1.5e5
DISTANCES = (40.0, 50.0, 60.0, 70.0, 80.0, 88.0)
FINER = 15  # pieces of an edge in the mesh that stands for the continuous rod


@dataclass(frozen=True)
class Problem:
    """R rods: a start (R, V, 3), equilibria of a limp rod; the clamps; and two references in f64, on this mesh and on one
    whose edges are 15 times shorter."""

    start: Configuration
    clamps: Clamps
    same_mesh: np.ndarray
    continuum: np.ndarray

    def apart(self, vertices: np.ndarray) -> tuple[float, float]:
        """mm: mean distance of vertices (R, V, 3) from both references."""
        return tuple(float(np.linalg.norm(vertices - each, axis=-1).mean()) for each in (self.same_mesh, self.continuum))


def strain(vertices: np.ndarray) -> float:
    """The largest change of an edge's length, over the length."""
    edge = LENGTH / EDGES
    return float(np.abs(np.linalg.norm(np.diff(vertices, axis=1), axis=-1) / edge - 1).max())


def problem() -> Problem:
    start, clamps, same = _relaxed(1)
    _, _, fine = _relaxed(FINER)
    frames = same.configuration.frames  # of a rod without twist: whole frames hold it as well
    held = Clamps(Clamp.FRAME, Clamp.FRAME, clamps.start_position, clamps.end_position, frames[:, 0], frames[:, -1])
    continuum = same.configuration.vertices.copy()
    continuum[:, 1:-1] = fine.configuration.vertices[:, (FINER + 1) // 2 :: FINER]
    return Problem(start, held, same.configuration.vertices, continuum)


def _relaxed(pieces: int):
    """The start, its clamps and the solution, each edge in ``pieces``, an odd number. A clamped edge clamps at its middle
    (tests/references): a finer rod begins and ends half an edge of its own beyond the middles of the outer edges."""
    edge, count = LENGTH / EDGES / pieces, len(DISTANCES)
    edges = EDGES * pieces - (pieces - 1)
    near, far = (np.array(d) / np.linalg.norm(d) for d in ((0.94, 0.0, 0.34), (0.85, 0.22, -0.48)))
    reach = edge * (pieces - 1) / 2
    held = Clamps(Clamp.TANGENT, Clamp.TANGENT, np.tile(reach * near, (count, 1)),
                  np.array([[distance, 0.0, 0.0] for distance in DISTANCES]) - reach * far,
                  *(np.tile(_frame(t), (count, 1, 1)) for t in (near, far)))
    along = np.linspace(0.0, 1.0, edges)[:, None]
    tangents = (1 - along) * near + along * far + np.sin(2 * np.pi * along) * [0.0, 0.0, 1.0]
    one = Configuration(np.zeros((1, 3)), _quaternions(tangents)[None], np.full(edges, edge))
    limp = relax(one.take(np.zeros(count, dtype=int)), Material(LIMP, LIMP), held)
    solution = relax(limp, Material(BEND, BEND), held)
    if not (solution.converged & solution.stable).all():
        raise RuntimeError("a reference did not converge")
    return limp.configuration, held, solution


def _frame(tangent: np.ndarray) -> np.ndarray:
    across = np.cross([0.0, 1.0, 0.0], tangent)
    across /= np.linalg.norm(across)
    return np.stack([tangent, across, np.cross(tangent, across)], axis=-1)


def _quaternions(tangents: np.ndarray) -> np.ndarray:
    tangents = tangents / np.linalg.norm(tangents, axis=1, keepdims=True)
    return quaternion_from_matrix(bishop_frames(tangents, _frame(tangents[0])[:, 1]))
