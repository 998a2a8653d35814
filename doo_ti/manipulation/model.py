"""Models of rods: at rest under their grippers, or drawn to marks; and poses of both grippers as twelve numbers: shift (mm) and
turn (rad) of the start, then of the end.

Axes: B rods, V vertices.
"""

from dataclasses import dataclass, replace

import numpy as np

from doo_ti.contact.surroundings import Surroundings
from doo_ti.relaxation.external import Springs
from doo_ti.relaxation.newton import Newton
from doo_ti.relaxation.relax import relax
from doo_ti.rod.frames import placed, rotation_matrix, turn_between, unit_vectors
from doo_ti.rod.types import POSES, Clamps, Configuration, Material, Solution, finite_rods

PULL = 30.0
"""Stiffness of a spring over B/s³, s the rod's length between marks: it draws a mark to a thirtieth of what bending between its
neighbours leaves. With 3 shapes of the old branch remain, with 300 noise bends the rod."""
EXACT = 1e-6  # of the rod's length, rounding of its slack


@dataclass(frozen=True)
class Model:
    """Models of B rods: what they are made of, how clips hold them (:func:`held`), and what surrounds them."""

    material: Material
    clip: np.ndarray
    up: np.ndarray
    surroundings: Surroundings

    def relaxed(self, rods: Configuration, clamps: Clamps, springs: Springs | None = None) -> Solution:
        """The rods at rest under the grippers' poses, and drawn by a row of ``springs`` each."""
        rows = None if springs is None else np.arange(rods.count)
        return relax(rods, self.material, held(clamps, self.clip), Newton.careful(), up=self.up, external=springs,
                     external_index=rows, **self.surroundings.arguments)

    def drawn(self, rods: Configuration, clamps: Clamps, places: np.ndarray, visible: np.ndarray) -> Configuration:
        """The rods drawn by springs to the ``places`` (B, V, 3) mm of the vertices that are ``visible`` (B, V)."""
        spacing = rods.rest_length.sum() / np.maximum(visible.sum(axis=1) - 1, 1)
        stiffness = PULL * self.material.bend[:, self.material.bend.shape[1] // 2, 0, 0] / spacing**3
        springs = Springs(np.where(visible[..., None], places, 0.0), visible * stiffness[:, None])
        return finite_rods(self.relaxed(rods, clamps, springs).configuration, rods)

    def take(self, rods: np.ndarray) -> "Model":
        """The models of the rods named by ``rods``."""
        return Model(self.material.take(rods), self.clip[rods], self.up, self.surroundings.take(rods))


def between_marks(values: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """(B, V, 3) ``values`` at vertices that are ``seen`` (B, V), linear between them, and constant beyond the outermost ones;
    zero where none is seen."""
    found, number = np.zeros(values.shape), np.arange(seen.shape[1])
    for rod in np.flatnonzero(seen.any(axis=1)):
        found[rod] = placed(number, number[seen[rod]], values[rod, seen[rod]])
    return found


def padded(vertices: np.ndarray) -> np.ndarray:
    """Places of vertices (B, V, 3), and none of the ends of two more edges."""
    return np.pad(vertices, ((0, 0), (1, 1), (0, 0)), constant_values=np.nan)


def size_of(vectors: np.ndarray, visible: np.ndarray | None = None) -> np.ndarray:
    """(B,) root mean square lengths of ``vectors`` (B, V, 3), zero where not ``visible``."""
    count = vectors.shape[1] if visible is None else np.maximum(visible.sum(axis=1), 1)
    return np.sqrt(np.sum(vectors**2, axis=(1, 2)) / count)


# --- poses of grippers ---------------------------------------------------------------------------------------------------

def moved(clamps: Clamps, change: np.ndarray) -> Clamps:
    """The clamps after ``change`` (B, 12): shifts and rotation vectors in the world."""
    start_turn, end_turn = rotation_matrix(change[:, 3:6]), rotation_matrix(change[:, 9:12])
    return replace(clamps, start_position=clamps.start_position + change[:, :3], start_frame=start_turn @ clamps.start_frame,
                   end_position=clamps.end_position + change[:, 6:9], end_frame=end_turn @ clamps.end_frame)


def change_between(clamps: Clamps, goal: Clamps) -> np.ndarray:
    """(B, 12) the change from ``clamps`` to ``goal``, frames turning the shortest way."""
    return np.concatenate([goal.start_position - clamps.start_position, turn_between(clamps.start_frame, goal.start_frame),
                           goal.end_position - clamps.end_position, turn_between(clamps.end_frame, goal.end_frame)], axis=1)


def held(clamps: Clamps, clip: np.ndarray) -> Clamps:
    """How clips hold rods whose reported clamps are ``clamps``: with a reported frame F and position x at F exp(r), x + F d;
    ``clip`` (B, 12) is d and r of both ends, constant in the gripper."""
    def put(position, frame, own):
        return position + (frame @ own[:, :3, None])[..., 0], frame @ rotation_matrix(own[:, 3:])
    start, end = (put(clamps.start_position, clamps.start_frame, clip[:, :6]),
                  put(clamps.end_position, clamps.end_frame, clip[:, 6:]))
    return replace(clamps, start_position=start[0], start_frame=start[1], end_position=end[0], end_frame=end[1])


def slack(clamps: Clamps, length: float, stiff: np.ndarray | float) -> np.ndarray:
    """(B,) mm by which rods of that ``length``, of which grippers hold ``stiff`` mm at each end, (B,) or one number, are longer
    between their grippers than these are apart."""
    stiff = np.broadcast_to(stiff, clamps.count)
    return length - 2 * stiff - np.linalg.norm(_way(clamps, stiff), axis=-1)


def slack_gradient(clamps: Clamps, stiff: np.ndarray) -> np.ndarray:
    """(B, 12) of :func:`slack` by the change of :func:`moved`."""
    along = -unit_vectors(_way(clamps, stiff))
    turns = [np.cross(frame[..., 0], along) * -stiff[:, None] for frame in (clamps.start_frame, clamps.end_frame)]
    return np.concatenate([-along, turns[0], along, turns[1]], axis=1)


def drawn_in(clamps: Clamps, excess: np.ndarray, stiff: np.ndarray, moves: np.ndarray) -> Clamps:
    """The clamps with grippers that are nearer to each other by ``excess`` (B,) mm: those whose shifts are free, of ``moves``
    (12,), by equal parts."""
    start, end = float(moves[0]), float(moves[6])
    part = unit_vectors(_way(clamps, stiff)) * (excess / max(start + end, 1.0))[:, None]
    return replace(clamps, start_position=clamps.start_position + start * part, end_position=clamps.end_position - end * part)


def gap_of_held(clamps: Clamps, edge: float, around: Surroundings) -> np.ndarray:
    """(B,) mm between obstacles and the outer edges, ``edge`` mm long, that grippers hold; zero without obstacles."""
    if not around.bodies:
        return np.zeros(clamps.count)
    ends = ((clamps.start_position, clamps.start_frame, edge), (clamps.end_position, clamps.end_frame, -edge))
    return np.minimum(*(around.smallest_gap(np.stack([place, place + length * frame[..., 0]], axis=1))
                        for place, frame, length in ends))


def shortened(vectors: np.ndarray, length: np.ndarray) -> np.ndarray:
    """``vectors`` (B, K), at most ``length`` (B,) long."""
    size = np.linalg.norm(vectors, axis=1)
    return vectors * np.minimum(1.0, length / np.maximum(size, 1e-300))[:, None]


def boxed(clamps: Clamps, before: Clamps, boxes: tuple) -> Clamps:
    """The clamps with each gripper in its box ((3,), (3,)) mm, or None: one that was outside before goes no farther out."""
    places = {}
    for name, box in zip(("start_position", "end_position"), boxes, strict=True):
        if box is not None:
            old = getattr(before, name)
            places[name] = np.clip(getattr(clamps, name), np.minimum(box[0], old), np.maximum(box[1], old))
    return replace(clamps, **places)


def _way(clamps: Clamps, stiff: np.ndarray) -> np.ndarray:
    """(B, 3) mm, between the ends of what grippers hold."""
    tangents = clamps.start_frame[..., 0] + clamps.end_frame[..., 0]
    return clamps.end_position - clamps.start_position - stiff[:, None] * tangents


def put_rows(clamps: Clamps, rods: np.ndarray, other: Clamps) -> Clamps:
    """``clamps`` with ``other`` in the rows ``rods``."""
    parts = {name: getattr(clamps, name).copy() for name in POSES}
    for name, values in parts.items():
        values[rods] = getattr(other, name)
    return replace(clamps, **parts)
