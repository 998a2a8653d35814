"""An observed rod between its clips, on a mesh of its own: finer than its marks, and clamped where the clips end
(:mod:`doo_ti.refinement.mesh`).

A clamp may be off its reported pose by six numbers: a rotation about the clip's end and a displacement, both in the axes of the
reported frame. Where no frame was reported the pose is that of the outer two marks, and its roll is unknown: then the six
numbers are what holds the rod, and have no limits worth the name.

Axes: D observations, M marks, N edges of the mesh, Q = 12 numbers of the two poses.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from doo_ti.contact.surroundings import Surroundings
from doo_ti.refinement.mesh import GEOMETRY, Lengths, Mesh, values_at
from doo_ti.relaxation.external import PointLoads
from doo_ti.relaxation.newton import Newton
from doo_ti.relaxation.relax import relax
from doo_ti.rod.frames import right_jacobian, rotation_matrix, turned_about_tangent
from doo_ti.rod.observations import Observations
from doo_ti.rod.start import choose_hypothesis, fill_missing, held_spins, span_excess, start_configuration, turn_hypotheses
from doo_ti.rod.types import Clamp, Clamps, Configuration, Material, Solution

POSE = 12  # numbers of two poses: rotations of the start and end clamps, displacements of the start and the end; rad and mm
TURNS = 12  # numbers of the constant errors of clamps: rotations in the reported frames' axes, and in the world's
SHORTENED = (1.0, 0.5, 0.25, 0.0)  # shares of the expected length of a clip with which a fit may begin
TWIST = 3  # of these that which turns the end about its tangent
INWARDS = (1.0, -1.0)  # of the start's tangent and of the end's: into the rod


@dataclass(frozen=True)
class HeldRod:
    """D observations of one rod, and the mesh that models them."""

    observations: Observations  # the marks
    clamps: Clamps  # of the ends, at the outer marks, as reported
    edges: int  # N of the mesh
    surroundings: Surroundings = Surroundings()  # what the rods touch, with one row for all observations or one for each
    exact: bool = False  # whether the clamps are exactly where they were reported, and where the outer marks say
    # whether ends of unknown roll may roll freely, as a rod between fingers does; else they are held at that roll
    swivels: bool = False
    # (D, M) weights of bodies that hang at the marks, as :class:`.PointLoads` has them, or None
    loads: np.ndarray | None = None
    # (D,) rad, by which both ends are rolled further than the parallel frames that stand for unknown rolls
    rolled: np.ndarray | None = None
    copies: int = 1  # rows that stand for one observation, one after the other, at different rolls

    @property
    def length(self) -> float:
        """L as the observations state it, mm."""
        return self.observations.length

    @property
    def reported(self) -> tuple[bool, bool]:
        """Whether the frame of each end was reported."""
        seen = self.observations
        return tuple(frame is not None or seen.frames is not None for frame in (seen.start_frame, seen.end_frame))

    @cached_property
    def held(self) -> Clamps:
        """The clamps of the model. Where the frame was not reported the roll is unknown, not free, unless the rod swivels."""
        if self.exact or self.swivels:
            return self.clamps
        count = self.observations.count
        kinds, hidden = [], []
        for kind, reported in zip((self.clamps.start, self.clamps.end), self.reported, strict=True):
            kind = np.broadcast_to(np.asarray(kind), count)
            hidden.append(not reported and kind.max() >= Clamp.TANGENT)
            kinds.append(np.where(kind == Clamp.TANGENT, Clamp.FRAME, kind) if hidden[-1] else kind)
        clamps = replace(self.clamps, start=kinds[0], end=kinds[1])
        if any(hidden) and all(np.min(kind) == Clamp.FRAME for kind in kinds):
            # Begin without twist: an end of unknown roll follows the other.
            at = replace(self.clamps, start=np.full(count, Clamp.TANGENT if hidden[0] and not hidden[1] else Clamp.FRAME),
                         end=np.full(count, Clamp.TANGENT if hidden[1] else Clamp.FRAME))
            clamps = held_spins(self.observations, at, np.zeros(count))
        if self.rolled is not None:
            start, end = (turned_about_tangent(frame, self.rolled) for frame in (clamps.start_frame, clamps.end_frame))
            clamps = replace(clamps, start_frame=start, end_frame=end)
        return clamps

    def take(self, rows: np.ndarray, rolled: np.ndarray | None, copies: int = 1) -> "HeldRod":
        """The observations ``rows`` (R,), rolled by ``rolled`` (R,)."""
        return replace(self, observations=self.observations.take(rows), clamps=self.clamps.take(rows),
                       surroundings=self.surroundings.take(rows), loads=None if self.loads is None else self.loads[rows],
                       rolled=rolled, copies=copies)

    def by_observation(self, rows: np.ndarray) -> np.ndarray:
        """(D, copies, …) of what each row (D · copies, …) has."""
        return rows.reshape(-1, self.copies, *rows.shape[1:])

    @cached_property
    def pose_scales(self) -> tuple[str, ...]:
        """(POSE,) for each number of the clamps' poses the name of the size, in :mod:`doo_ti.refinement.theta`, of its error
        in one observation; "" where it has none."""
        turns, shifts = [], []
        for end, (kind, reported) in enumerate(zip((self.clamps.start, self.clamps.end), self.reported, strict=True)):
            held = np.max(kind)
            roll = "any_roll" if end == 0 and self.rolled_together or not self._both_hold_rolls else "any_twist"
            turn = ("turn_scatter",) * 3 if reported else ("" if self.swivels else roll, "any_turn", "any_turn")
            turns += ("",) * 3 if self.exact or held < Clamp.TANGENT else turn
            shifts += ("",) * 3 if self.exact or held < Clamp.POSITION else ("any_shift",) * 3
        return (*turns, *shifts)

    @cached_property
    def loose(self) -> np.ndarray:
        """(POSE,) one for each number of the clamps' poses that is unknown in each observation."""
        return (np.array(self.pose_scales) != "").astype(float)

    @cached_property
    def constant_slopes(self) -> np.ndarray:
        """(D, POSE, TURNS) derivatives of the poses by the constant errors of the reported frames."""
        slopes = np.zeros((self.observations.count, POSE, TURNS))
        for end, frame in enumerate((self.held.start_frame, self.held.end_frame)):
            rows = slice(3 * end, 3 * end + 3)
            slopes[:, rows, rows] = np.eye(3)
            slopes[:, rows, 6 + 3 * end : 9 + 3 * end] = np.swapaxes(frame, 1, 2)
        return slopes * (np.array(self.pose_scales) == "turn_scatter")[:, None]

    @cached_property
    def rolled_together(self) -> bool:
        """Whether the rolls of both ends are unknown: then the end's counts from the start's, and is the twist of the rod."""
        return not (self.exact or any(self.reported)) and self._both_hold_rolls

    @property
    def _both_hold_rolls(self) -> bool:
        return all(np.max(kind) == Clamp.FRAME for kind in (self.held.start, self.held.end))

    @property
    def direction_unknown(self) -> bool:
        """Whether marks alone say which way an end points."""
        return "any_turn" in self.pose_scales

    @property
    def twist_unknown(self) -> bool:
        """Whether marks alone say how far the rod is twisted."""
        return self.swivels or "any_twist" in self.pose_scales

    @property
    def rolls_known(self) -> bool:
        """Whether reported frames hold both ends' rolls."""
        return self._both_hold_rolls and not self.twist_unknown

    @property
    def turns_unknown(self) -> bool:
        """Whether frames hold both ends' rolls, but nothing says by how many whole turns the rod is twisted."""
        seen = self.observations
        return self.rolls_known and seen.total_twist is None and seen.frames is None

    @cached_property
    def clamped(self) -> np.ndarray:
        """(2,) bool: ends with a clip, where the clamp holds at least the tangent."""
        return np.array([np.max(kind) >= Clamp.TANGENT for kind in (self.clamps.start, self.clamps.end)])

    def mesh(self, lengths: Lengths) -> Mesh:
        """The mesh for ``lengths``; the length of a clip at an end without one is ignored."""
        return Mesh.between(self.clamped, self.edges, lengths)

    def clip_in_reach(self, clip: np.ndarray) -> np.ndarray:
        """(2,) ``clip``, shortened where the clamps of some observations would be further apart than the rod between them is
        long."""
        spacing, pose = self.observations.rest_length, np.zeros((self.observations.count, POSE))
        within = []
        for share in SHORTENED:
            lengths = Lengths(share * clip, spacing)
            free = np.full(self.edges, self.mesh(lengths).edge)
            within.append(int((span_excess(self.mesh_clamps(lengths, pose), free) <= 0).sum()))
        return SHORTENED[int(np.argmax(within))] * clip

    def ends(self, pose: np.ndarray):
        """Of each end: its reported position and frame, and the rotation of the clamp in that frame's axes, and the frame after
        it. The end rolls with the start where their rolls count together."""
        clamps = self.held
        for end, (position, frame) in enumerate(((clamps.start_position, clamps.start_frame),
                                                 (clamps.end_position, clamps.end_frame))):
            turn = pose[:, 3 * end : 3 * end + 3]
            rolled = end == 1 and self.rolled_together
            yield position, frame, turn, (turned_about_tangent(frame, pose[:, 0]) if rolled else frame) @ rotation_matrix(turn)

    def mesh_clamps(self, lengths: Lengths, pose: np.ndarray) -> Clamps:
        """The clamps of the mesh, off their reported poses by ``pose`` (D, Q), but outside of obstacles."""
        edge = self.mesh(lengths).edge
        frames = [now for *_, now in self.ends(pose)]
        positions = [place + self._push(end, place, frames[end], edge)[0]
                     for end, place in enumerate(self._places(lengths, pose))]
        return Clamps(self.held.start, self.held.end, *positions, *frames)

    def _places(self, lengths: Lengths, pose: np.ndarray) -> list[np.ndarray]:
        """(D, 3) of each clamp of the mesh, as it would be without obstacles."""
        edge, places = self.mesh(lengths).edge, []
        for end, (position, frame, _, now) in enumerate(self.ends(pose)):
            position = position + np.einsum("dij,dj->di", frame, pose[:, 6 + 3 * end : 9 + 3 * end])
            if self.clamped[end]:
                position = position + INWARDS[end] * (lengths.clip[end] * frame[..., 0] - 0.5 * edge * now[..., 0])
            places.append(position)
        return places

    def _push(self, end: int, place: np.ndarray, frame: np.ndarray, edge: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What moves the loosely held ``end`` out of obstacles: where it lies on one it cannot be held any deeper. (D, 3) the
        shift; its direction, zero where there is none; and (D,) the share of the held edge from ``place`` to its vertex that
        was deepest."""
        shift, normal, share = np.zeros_like(place), np.zeros_like(place), np.zeros(len(place))
        if self.loose[6 + 3 * end] == 0:
            return shift, normal, share
        along = INWARDS[end] * edge * frame[..., 0] * float(self.clamped[end])
        held, rows = np.stack([place, place + along], axis=1), np.arange(len(place))
        for obstacle in self.surroundings.bodies:
            distance, outward = obstacle.distance(held + shift[:, None])
            depth = np.reshape(self.surroundings.radius, (-1, 1)) - distance
            deepest = depth.argmax(axis=1)
            inside = depth[rows, deepest] > 0
            normal[inside], share[inside] = outward[rows, deepest][inside], deepest[inside]
            shift[inside] += (depth[rows, deepest][:, None] * normal)[inside]
        return shift, normal, share

    def clamp_slopes(self, lengths: Lengths, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of the clamps of the mesh by the lengths and the poses: displacements (2, D, 3, GEOMETRY + Q) of the
        start's and the end's vertex, and rotations in the world (2, D, 3, GEOMETRY + Q)."""
        mesh, count = self.mesh(lengths), self.observations.count
        moved, turned = np.zeros((2, 2, count, 3, GEOMETRY + POSE))
        for end, (place, (_, frame, turn, now)) in enumerate(zip(self._places(lengths, pose), self.ends(pose), strict=True)):
            first = GEOMETRY + 3 * end
            moved[end][..., first + 6 : first + 9] = frame
            turned[end][..., first : first + 3] = now @ right_jacobian(turn)
            if end == 1 and self.rolled_together:
                turned[end][..., GEOMETRY] = frame[..., 0]
            along = np.zeros_like(moved[end])  # of the held edge
            if self.clamped[end]:
                tangent = now[..., 0, None]
                along[..., :GEOMETRY] = tangent * mesh.edge_slope
                along += mesh.edge * np.cross(turned[end], tangent, axis=1)
                along *= INWARDS[end]
                moved[end][..., end] += INWARDS[end] * frame[..., 0]
                moved[end] -= 0.5 * along
            _, normal, share = self._push(end, place, now, mesh.edge)
            moved[end] -= normal[..., None] * (normal[:, None] @ (moved[end] + share[:, None, None] * along))
        return moved, turned

    def relaxed(self, material: Material, lengths: Lengths, pose: np.ndarray, up: np.ndarray, solver: Newton,
                rows: np.ndarray | None = None, any_turn: bool = False, turn: int | None = None) -> Solution:
        """F from the observations, or from those of ``rows`` alone; of several whole turns the one nearest to the marks.

        any_turn  try a turn more and one less than the observed twist, too
        turn      only the rods with so many whole turns more than their frames leave, of those that may have several
        """
        rows = np.arange(self.observations.count) if rows is None else rows
        clamps = self.mesh_clamps(lengths, pose).take(rows)
        seen = self._on_mesh(lengths).take(rows)
        index, turns = turn_hypotheses(seen, clamps)
        if any_turn and seen.total_twist is not None and len(index) == len(rows):
            index, turns = np.repeat(index, 3), np.repeat(turns, 3) + np.tile([0, -1, 1], len(turns))
        if turn is not None:
            index, turns = np.arange(len(rows)), np.full(len(rows), turn)
        starts = start_configuration(seen.take(index), clamps.take(index), turns)
        solution = relax(starts, material, clamps.take(index), solver, up=up, **self.around(lengths, rows[index]))
        if len(index) == len(rows):
            return solution
        apart = self.marks(solution, lengths) - np.nan_to_num(self.observations.vertices[rows][index])
        error = np.where(self.observations.valid[rows][index], (apart**2).sum(axis=-1), 0.0).sum(axis=1)
        best = choose_hypothesis(index, error, solution.converged & solution.stable)
        around = self.around(lengths, rows[index[best]])
        return relax(starts.take(best), material, clamps.take(index[best]), solver, up=up, **around)

    def followed(self, start: np.ndarray, quaternions: np.ndarray, material: Material, lengths: Lengths, pose: np.ndarray,
                 up: np.ndarray, solver: Newton) -> Solution:
        """F from relaxed rods with these frames (D, N, 4), and this ``start`` (D, 3) if that is free, each on its branch."""
        clamps, edges = self.mesh_clamps(lengths, pose), np.full(self.edges, self.mesh(lengths).edge)
        free = (np.asarray(self.clamps.start) == Clamp.FREE).any()
        begin = Configuration(start if free else clamps.start_position, quaternions, edges)
        return relax(begin, material, clamps, replace(solver, first_shift=0.0), up=up, **self.around(lengths))

    def around(self, lengths: Lengths, rows: np.ndarray | None = None) -> dict:
        """Arguments of :func:`doo_ti.relaxation.relax.relax`: what the rods touch, and what hangs at their marks."""
        touched = (self.surroundings if rows is None else self.surroundings.take(rows)).arguments
        if self.loads is None:
            return touched
        shares, _ = values_at(lengths.mark_place, self.mesh(lengths).place)  # of the vertices on either side of a mark
        mass = (self.loads if rows is None else self.loads[rows]) @ shares
        return touched | {"external": PointLoads(np.zeros((*mass.shape, 3)), mass)}

    def marks(self, solution: Solution, lengths: Lengths) -> np.ndarray:
        """(R, M, 3) places of the marks of relaxed rods, mm."""
        return self.mesh(lengths).at(lengths.mark_place)[0] @ solution.configuration.vertices

    def directors(self, solution: Solution, lengths: Lengths) -> np.ndarray:
        """(R, M − 1, 3) m1 of relaxed rods half-way between their marks."""
        place = lengths.mark_place
        return self.mesh(lengths).at_edges(0.5 * (place[1:] + place[:-1]))[0] @ solution.configuration.frames[..., 1]

    def distance(self, marks: np.ndarray, solution: Solution, lengths: Lengths, frame_weight: float) -> np.ndarray:
        """(D,) Eq. 1 in mm between ``marks`` (D, M, 3) of relaxed rods, where ``frame_weight`` is positive also m1 half-way
        between them, and the observations."""
        seen = self.observations
        apart = np.linalg.norm(np.where(seen.valid[..., None], marks - np.nan_to_num(seen.vertices), 0.0), axis=-1)
        total = apart.sum(axis=1) / (seen.valid.sum(axis=1) - 1)
        if frame_weight > 0:
            turned = np.linalg.norm(self.directors(solution, lengths) - seen.frames[..., 1], axis=-1)
            total = total + frame_weight * turned.sum(axis=1) / (seen.edges - 1)
        return total

    def _on_mesh(self, lengths: Lengths) -> Observations:
        """The observed curves, and frames if these were measured, on the mesh: the start of relaxations."""
        seen, mesh, mark_place = self.observations, self.mesh(lengths), lengths.mark_place
        marks, last = fill_missing(seen), len(mark_place) - 2
        low = np.clip(np.searchsorted(mark_place, mesh.place, side="right") - 1, 0, last)
        # Beyond the outer marks the mesh goes straight on.
        share = ((mesh.place - mark_place[low]) / lengths.spacing[low])[:, None]
        vertices = (1 - share) * marks[:, low] + share * marks[:, low + 1]
        nearest = np.clip(np.searchsorted(mark_place, mesh.middles, side="right") - 1, 0, last)
        return Observations(
            vertices=vertices, rest_length=np.full(self.edges, mesh.edge), start_frame=seen.start_frame,
            end_frame=seen.end_frame, frames=None if seen.frames is None else seen.frames[:, nearest],
            total_twist=np.zeros(seen.count) if self.twist_unknown else seen.total_twist, up=seen.up, name=seen.name,
            source=seen.source)
