"""An observed rod between its clips, on a mesh of its own: finer than its marks, and clamped where the clips end.

A discrete rod whose first edge is held bends from the middle of that edge on. So the middle of the mesh's first edge is placed
at the end of the clip, ``clip`` mm from the first mark, and likewise at the other end. All edges have the length

    h = (L − c_0 − c_1)/(N − 1)        with both ends clamped, L the length between the outer marks.

Marks lie between the mesh's vertices, by cubic interpolation; inside a clip the rod is straight. A clamp may be off its
reported pose by six numbers: a rotation about the clip's end and a displacement, both in the axes of the reported frame.

Axes: D observations, M marks, N edges of the mesh, Q = 12 numbers of the two poses.
"""

from dataclasses import dataclass, replace

import numpy as np

from doo_ti.contact.surroundings import Surroundings
from doo_ti.frames import rotation_matrix
from doo_ti.io.observations import Observations
from doo_ti.relaxation.newton import Newton
from doo_ti.relaxation.relax import relax
from doo_ti.start import choose_hypothesis, fill_missing, start_configuration, turn_hypotheses
from doo_ti.types import Clamp, Clamps, Configuration, Material, Solution

POSE = 12
"""Numbers of two poses: rotation of the start clamp, of the end clamp, displacement of the start, of the end; rad and mm."""


@dataclass(frozen=True)
class Mesh:
    """The mesh for one pair of clip lengths.

    edge         h, mm
    place        (N + 1,) arc length of its vertices from the first mark, mm
    edge_slope   (2,) derivative of ``edge`` by each clip length
    first_slope  (2,) derivative of ``place[0]`` by each clip length
    """

    edge: float
    place: np.ndarray
    edge_slope: np.ndarray
    first_slope: np.ndarray

    @property
    def joints(self) -> np.ndarray:
        """(N − 1,) mm."""
        return self.place[1:-1]

    @property
    def joint_slope(self) -> np.ndarray:
        """(N − 1, 2) derivative of :attr:`joints` by each clip length."""
        steps = np.arange(1, len(self.place) - 1)[:, None]
        return self.first_slope + steps * self.edge_slope

    def at(self, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(X, N + 1) weights of the vertices at arc lengths ``place`` (X,), and their derivatives by u = (s − s_0)/h."""
        return _interpolation((place - self.place[0]) / self.edge, len(self.place))

    def at_edges(self, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(X, N) weights of the edges, each at its middle and linear in between, and their derivatives by u."""
        u = np.clip((place - self.place[0]) / self.edge - 0.5, 0.0, len(self.place) - 2)
        low = np.minimum(u.astype(int), len(self.place) - 3)
        weights, slopes = np.zeros((2, len(place), len(self.place) - 1))
        rows = np.arange(len(place))
        weights[rows, low], weights[rows, low + 1] = 1 - (u - low), u - low
        slopes[rows, low], slopes[rows, low + 1] = -1.0, 1.0
        return weights, slopes

    def slide(self, place: np.ndarray) -> np.ndarray:
        """(X, 2) derivative of u = (s − s_0)/h by each clip length at given arc lengths s."""
        u = (place - self.place[0]) / self.edge
        return -(self.first_slope + u[:, None] * self.edge_slope) / self.edge


@dataclass(frozen=True)
class HeldRod:
    """D observations of one rod, and the mesh that models them.

    observations  the marks
    clamps        of the ends, at the outer marks, as reported
    edges         N of the mesh
    surroundings  what the rods touch, with one row for all observations or one for each
    """

    observations: Observations
    clamps: Clamps
    edges: int
    surroundings: Surroundings = Surroundings()

    @property
    def mark_place(self) -> np.ndarray:
        """(M,) arc length of the marks, mm."""
        return np.concatenate([[0.0], np.cumsum(self.observations.rest_length)])

    @property
    def length(self) -> float:
        """L, mm."""
        return float(self.observations.rest_length.sum())

    @property
    def clamped(self) -> np.ndarray:
        """(2,) bool: ends with a clip, where the clamp holds at least the tangent."""
        return np.array([np.max(kind) >= Clamp.TANGENT for kind in (self.clamps.start, self.clamps.end)])

    def mesh(self, clip: np.ndarray) -> Mesh:
        """The mesh for clips of ``clip`` (2,) mm; the length at an end without clip is ignored."""
        held = self.clamped.astype(float)
        count = self.edges - 0.5 * held.sum()
        edge = (self.length - held @ clip) / count
        slope = -held / count
        first = held[0] * (clip[0] - 0.5 * edge)
        first_slope = held[0] * (np.array([1.0, 0.0]) - 0.5 * slope)
        return Mesh(edge, first + edge * np.arange(self.edges + 1), slope, first_slope)

    def mesh_clamps(self, clip: np.ndarray, pose: np.ndarray) -> Clamps:
        """The clamps of the mesh, off their reported poses by ``pose`` (D, Q)."""
        mesh = self.mesh(clip)
        positions, frames = [], []
        for end, (position, frame) in enumerate(self._reported):
            turned = frame @ rotation_matrix(pose[:, 3 * end : 3 * end + 3])
            position = position + np.einsum("dij,dj->di", frame, pose[:, 6 + 3 * end : 9 + 3 * end])
            if self.clamped[end]:
                inwards = 1.0 if end == 0 else -1.0
                position = position + inwards * (clip[end] * frame[..., 0] - 0.5 * mesh.edge * turned[..., 0])
            positions.append(position)
            frames.append(turned)
        return Clamps(self.clamps.start, self.clamps.end, *positions, *frames)

    def clamp_slopes(self, clip: np.ndarray, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of the clamps of the mesh by the clips and the poses: displacements (2, D, 3, 2 + Q) of the start's and
        the end's vertex, and rotations in the world (2, D, 3, 2 + Q)."""
        mesh, count = self.mesh(clip), self.observations.count
        moved, turned = np.zeros((2, 2, count, 3, 2 + POSE))
        for end, (_, frame) in enumerate(self._reported):
            rotation, offset = slice(2 + 3 * end, 5 + 3 * end), slice(8 + 3 * end, 11 + 3 * end)
            moved[end][..., offset] = frame
            turn = pose[:, 3 * end : 3 * end + 3]
            now = frame @ rotation_matrix(turn)
            turned[end][..., rotation] = now @ right_jacobian(turn)
            if not self.clamped[end]:
                continue
            inwards = 1.0 if end == 0 else -1.0
            tangent = now[..., 0]
            moved[end][..., end] += inwards * frame[..., 0]
            moved[end][..., :2] -= inwards * 0.5 * tangent[..., None] * mesh.edge_slope
            moved[end][..., rotation] -= inwards * 0.5 * mesh.edge * np.cross(
                turned[end][..., rotation], tangent[..., None], axis=1)
        return moved, turned

    @property
    def _reported(self):
        clamps = self.clamps
        return (clamps.start_position, clamps.start_frame), (clamps.end_position, clamps.end_frame)

    def relaxed(self, material: Material, clip: np.ndarray, pose: np.ndarray, solver: Newton, up: np.ndarray,
                rows: np.ndarray | None = None, any_turn: bool = False) -> Solution:
        """F from the observations, or from those of ``rows`` alone; of several whole turns the one nearest to the marks.

        any_turn  try a turn more and one less than the observed twist, too
        """
        rows = np.arange(self.observations.count) if rows is None else rows
        clamps = self.mesh_clamps(clip, pose).take(rows)
        seen = self._on_mesh(clip).take(rows)
        index, turns = turn_hypotheses(seen, clamps)
        if any_turn and seen.total_twist is not None and len(index) == len(rows):
            index, turns = np.repeat(index, 3), np.repeat(turns, 3) + np.tile([0, -1, 1], len(turns))
        starts = start_configuration(seen.take(index), clamps.take(index), turns)
        around = self.surroundings.take(rows[index])
        solution = relax(starts, material, clamps.take(index), solver, up=up, **around.arguments)
        if len(index) == len(rows):
            return solution
        apart = self.marks(solution, clip) - np.nan_to_num(self.observations.vertices[rows][index])
        error = np.where(self.observations.valid[rows][index], (apart**2).sum(axis=-1), 0.0).sum(axis=1)
        best = choose_hypothesis(index, error, solution.converged & solution.stable)
        around = self.surroundings.take(rows[index[best]])
        return relax(starts.take(best), material, clamps.take(index[best]), solver, up=up, **around.arguments)

    def followed(self, solution: Solution, material: Material, clip: np.ndarray, pose: np.ndarray, solver: Newton,
                 up: np.ndarray) -> Solution:
        """F from ``solution``, which keeps every rod on its branch."""
        clamps = self.mesh_clamps(clip, pose)
        lengths = np.full(self.edges, self.mesh(clip).edge)
        begin = Configuration(clamps.start_position, solution.configuration.quaternions, lengths)
        if (np.asarray(self.clamps.start) == Clamp.FREE).any():
            begin = replace(begin, start=solution.configuration.start)
        return relax(begin, material, clamps, replace(solver, first_shift=0.0), up=up, **self.surroundings.arguments)

    def marks(self, solution: Solution, clip: np.ndarray) -> np.ndarray:
        """(R, M, 3) places of the marks of relaxed rods, mm."""
        return self.mesh(clip).at(self.mark_place)[0] @ solution.configuration.vertices

    def directors(self, solution: Solution, clip: np.ndarray) -> np.ndarray:
        """(R, M − 1, 3) m1 of relaxed rods half-way between their marks."""
        place = self.mark_place
        return self.mesh(clip).at_edges(0.5 * (place[1:] + place[:-1]))[0] @ solution.configuration.frames[..., 1]

    def _on_mesh(self, clip: np.ndarray) -> Observations:
        """The observed curves, and frames if these were measured, on the mesh: the start of relaxations."""
        seen, mesh = self.observations, self.mesh(clip)
        marks = fill_missing(seen)
        place, last = np.clip(mesh.place, 0.0, self.length), len(self.mark_place) - 2
        low = np.clip(np.searchsorted(self.mark_place, place, side="right") - 1, 0, last)
        share = ((place - self.mark_place[low]) / seen.rest_length[low])[:, None]
        vertices = (1 - share) * marks[:, low] + share * marks[:, low + 1]
        # The mesh extends beyond the outer marks by half an edge at most.
        for end, inner in ((0, 1), (-1, -2)):
            direction = marks[:, end] - marks[:, inner]
            direction = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
            vertices[:, end] += direction * (abs(mesh.place[end] - place[end]))
        middles = 0.5 * (place[1:] + place[:-1])
        nearest = np.clip(np.searchsorted(self.mark_place, middles, side="right") - 1, 0, last)
        return Observations(
            vertices=vertices, rest_length=np.full(self.edges, mesh.edge), start_frame=seen.start_frame,
            end_frame=seen.end_frame, frames=None if seen.frames is None else seen.frames[:, nearest],
            total_twist=seen.total_twist, up=seen.up, name=seen.name, source=seen.source)


def right_jacobian(turn: np.ndarray) -> np.ndarray:
    """(D, 3, 3) J of Exp(turn + d) = Exp(turn) Exp(J d) to first order."""
    angle = np.linalg.norm(turn, axis=-1)[..., None, None]
    cross = np.cross(np.eye(3), turn[..., None, :])  # rows e_k × turn: the matrix of turn × once transposed
    cross = np.swapaxes(cross, -1, -2)
    small = angle < 1e-4
    safe = np.where(small, 1.0, angle)
    first = np.where(small, 0.5 - angle**2 / 24, (1 - np.cos(safe)) / safe**2)
    second = np.where(small, 1 / 6 - angle**2 / 120, (safe - np.sin(safe)) / safe**3)
    return np.eye(3) + first * cross + second * cross @ cross


def _interpolation(u: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Weights (X, count) of ``count`` evenly spaced values at the places u, and their derivatives: cubic, but linear in the
    outermost intervals and beyond, which a clip may hold."""
    weights, slopes = np.zeros((2, len(u), count))
    rows = np.arange(len(u))
    inner = (u > 1) & (u < count - 2) & (count >= 6)
    low = np.where(inner, np.clip(np.floor(u).astype(int) - 1, 1, max(count - 5, 1)), 0)
    t = u - low
    cubic = ((0, (1, 2, 3), -6.0), (1, (0, 2, 3), 2.0), (2, (0, 1, 3), -2.0), (3, (0, 1, 2), 6.0))
    for k, (a, b, c), scale in cubic:
        weights[rows[inner], (low + k)[inner]] = (((t - a) * (t - b) * (t - c)) / scale)[inner]
        slopes[rows[inner], (low + k)[inner]] = (((t - b) * (t - c) + (t - a) * (t - c) + (t - a) * (t - b)) / scale)[inner]
    outer = ~inner
    low = np.clip(np.floor(u).astype(int), 0, count - 2)
    weights[rows[outer], low[outer]], weights[rows[outer], low[outer] + 1] = (1 - (u - low))[outer], (u - low)[outer]
    slopes[rows[outer], low[outer]], slopes[rows[outer], low[outer] + 1] = -1.0, 1.0
    return weights, slopes
