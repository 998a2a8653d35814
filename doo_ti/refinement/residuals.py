"""What of the observations is compared with the model, and how that changes with the unknowns.

A mark's residual is x − x', a director's m1 − m1'. Marks that a clamp's position or tangent was taken from say nothing and are
left out. Marks come in mm, or over their σ where the observations state it; directors are pure numbers. Axes: D observations, M
marks, P unknowns, Q effects.
"""

from dataclasses import dataclass

import numpy as np

from doo_ti.refinement.held_rod import POSE
from doo_ti.refinement.linear_model import GAP_MODES, Residuals, smooth_modes
from doo_ti.refinement.scales import Scales
from doo_ti.refinement.unknowns import Unknowns, Values
from doo_ti.relaxation.sensitivity import sensitivity
from doo_ti.types import Clamp, Solution

RODS_AT_ONCE = 128
"""Derivatives of as many rods are held in memory at a time."""
SOFT = 30.0
"""Times the median: rods whose derivatives are larger are about to snap."""


@dataclass(frozen=True)
class Comparison:
    """The numbers that are compared.

    unknowns    of the fit
    weight      (D, M) of marks: zero where one does not count
    directors   (D, M − 1) one where m1 of an edge counts; None where frames do not
    correction  (D, M, 3) what a finer mesh adds to where the marks are, mm: see :mod:`doo_ti.refinement.mesh_error`
    """

    unknowns: Unknowns
    weight: np.ndarray
    directors: np.ndarray | None
    correction: np.ndarray | float = 0.0

    @classmethod
    def of(cls, unknowns: Unknowns, with_frames: bool) -> "Comparison":
        seen, clamps = unknowns.rod.observations, unknowns.rod.clamps
        counts = seen.valid.copy()
        ends = ((clamps.start, 0, 1, seen.start_frame), (clamps.end, -1, -2, seen.end_frame))
        for kind, outer, inner, frame in ends:
            counts[:, outer] &= np.asarray(kind) < Clamp.POSITION
            if frame is None:  # the tangent is that of the observed edge
                counts[:, inner] &= np.asarray(kind) < Clamp.TANGENT
        sigma = np.ones(counts.shape) if seen.sigma is None else np.broadcast_to(seen.sigma, counts.shape)
        weight = np.where(counts, 1 / np.where(counts, sigma, 1.0), 0.0)
        if not with_frames:
            return cls(unknowns, weight, None)
        directors = np.ones((seen.count, seen.edges))
        for kind, outer in ((clamps.start, 0), (clamps.end, -1)):
            directors[np.broadcast_to(np.asarray(kind) == Clamp.FRAME, seen.count), outer] = 0.0
        return cls(unknowns, weight, directors)

    @property
    def count(self) -> np.ndarray:
        """(D,) marks' coordinates that are compared."""
        return 3.0 * (self.weight > 0).sum(axis=1)

    def values(self, solution: Solution, values: Values) -> tuple[np.ndarray, ...]:
        """(D, 3 M) residuals of the marks and, if these count, (D, 3 (M − 1)) of the directors."""
        rod = self.unknowns.rod
        seen = rod.observations
        marks = self.weight[..., None] * (rod.marks(solution, values.clip) + self.correction - np.nan_to_num(seen.vertices))
        found = (np.where(self.weight[..., None] > 0, marks, 0.0).reshape(len(marks), -1),)
        if self.directors is None:
            return found
        apart = rod.directors(solution, values.clip) - seen.frames[..., 1]
        return (*found, (self.directors[..., None] * apart).reshape(len(apart), -1))

    def linear(self, solution: Solution, values: Values, used: np.ndarray, spare_soft: bool = True
               ) -> tuple[tuple[Residuals, ...], np.ndarray]:
        """The residuals around ``values``, with all effects zero, of rods that are ``used`` (D,) bool; and which have
        derivatives, those that are about to snap not among them if they are to be spared."""
        unknowns = self.unknowns
        shared, effects = [], []
        usable = np.zeros(len(used), dtype=bool)
        for first in range(0, len(used), RODS_AT_ONCE):
            rows = slice(first, min(first + RODS_AT_ONCE, len(used)))
            marks, directors, usable[rows] = self._derivatives(solution, values, rows)
            kinds = [marks] if self.directors is None else [marks, directors]
            shared.append([kind[0] for kind in kinds])
            effects.append([kind[1] for kind in kinds])
        shared = [np.concatenate(parts) for parts in zip(*shared, strict=True)]
        effects = [np.concatenate(parts) for parts in zip(*effects, strict=True)]
        used = used & usable
        # A rod about to snap moves far for tiny changes of the unknowns: the linear model does not hold for it.
        size = np.sqrt((shared[0] ** 2).mean(axis=(1, 2)))
        if used.any() and spare_soft:
            used &= size <= SOFT * np.median(size[used])
        weights = [np.repeat(self.weight, 3, axis=1)]
        counts = [self.count]
        if self.directors is not None:
            weights.append(np.repeat(self.directors, 3, axis=1))
            counts.append(2.0 * self.directors.sum(axis=1))  # a unit vector has two numbers
        effects = self._with_gap(effects)
        found = []
        for name, now, j, z, weight, count in zip(
                ("marks", "frames"), self.values(solution, values), shared, effects, weights, counts, strict=False):
            keep = np.where(used[:, None], weight, 0.0)[..., None]
            z = np.where(keep > 0, keep * z, 0.0)
            r = np.where(used[:, None], now, 0.0)
            if unknowns.clamps:
                r = r - (z[..., :POSE] @ values.scatter[..., None])[..., 0]
            found.append(Residuals(name, r, np.where(keep > 0, keep * j, 0.0), z, np.where(used, count, 0.0)))
        return tuple(found), used

    def gap_weight(self, scales: Scales) -> np.ndarray:
        """(3 M, 3 G) C of rᵀ(σ² + δ²ΦΦᵀ)⁻¹r = (|r|² − |rᵀC|²)/σ², Φ the smooth displacements of δ = ``gap``: the same for all
        observations, as if every mark counted as the mean of them does."""
        weight = self.weight[self.weight > 0].mean() if (self.weight > 0).any() else 1.0
        modes = self.gap_modes * weight * scales["gap"] / scales["marks"]
        left, sizes, _ = np.linalg.svd(modes, full_matrices=False)
        return left * np.sqrt(sizes**2 / (1 + sizes**2))

    @property
    def gap_modes(self) -> np.ndarray:
        """(3 M, 3 G) smooth displacements of the marks, those of unit amplitude."""
        rod = self.unknowns.rod
        held = tuple(bool(np.max(kind) >= Clamp.POSITION) for kind in (rod.clamps.start, rod.clamps.end))
        return np.einsum("mg,ab->magb", smooth_modes(rod.mark_place, held, GAP_MODES), np.eye(3)).reshape(-1, 3 * GAP_MODES)

    def _with_gap(self, effects: list[np.ndarray]) -> list[np.ndarray]:
        """The effects with the smooth displacements of the marks besides; directors know none."""
        modes = self.gap_modes
        gaps = [np.broadcast_to(modes, (len(effects[0]), *modes.shape))]
        gaps += [np.zeros((*z.shape[:2], modes.shape[1])) for z in effects[1:]]
        return [np.concatenate([z, gap], axis=-1) for z, gap in zip(effects, gaps, strict=True)]

    def _derivatives(self, solution: Solution, values: Values, rows: slice):
        """((J, Z) of the marks, (J, Z) of the directors, usable) of a block of rods; Z of the poses alone."""
        unknowns = self.unknowns
        rod = unknowns.rod
        elementary, chain = unknowns.chain(values)
        modes, mesh = unknowns.modes(values)
        found = sensitivity(solution, (*elementary, "modes", "length", "end_shift", "start_turn", "end_turn"), modes,
                            rows.start, rows.stop)
        block = np.arange(rows.start, rows.stop)
        pose = unknowns.pose(values)
        moved, turned = (slopes[:, rows] for slopes in rod.clamp_slopes(values.clip, pose))
        place = rod.mark_place
        at_marks, by_mark = mesh.at(place)
        configuration = found.configuration
        sliding = np.einsum("mv,rvk,me->rmke", by_mark, configuration.vertices, mesh.slide(place))
        marks = self._combined(block, at_marks, found.vertices, moved, turned, chain, values, mesh, sliding, True)
        directors = None
        if self.directors is not None:
            middles = 0.5 * (place[1:] + place[:-1])
            at_middles, by_middle = mesh.at_edges(middles)
            sliding = np.einsum("mv,rvk,me->rmke", by_middle, configuration.frames[..., 1], mesh.slide(middles))
            directors = self._combined(block, at_middles, found.directors, moved, turned, chain, values, mesh, sliding, False)
        return marks, directors, found.usable

    def _combined(self, block, weights, changes, moved, turned, chain, values, mesh, sliding, moves):
        """(J, Z) of what ``weights`` (X, ·) take from ``changes`` (rods of the block, ·, 3, columns) of the mesh."""
        unknowns, count = self.unknowns, len(block)
        changes = np.nan_to_num(changes)
        at = (weights @ changes.reshape(count, changes.shape[1], -1)).reshape(count, len(weights), 3, -1)
        theta = chain.shape[0]
        knots = len(unknowns.columns("curvature"))
        of_knots, of_sliding = at[..., theta : theta + knots], at[..., theta + knots : theta + knots + 2]
        length, rest = at[..., theta + knots + 2], at[..., theta + knots + 3 :]
        shift, start_turn, end_turn = rest[..., :3], rest[..., 3:6], rest[..., 6:]
        # What the clamps do: columns of the two clips, then of the pose.
        of_clamps = np.einsum("rmab,rbq->rmaq", shift, moved[1] - moved[0])
        of_clamps += np.einsum("rmab,rbq->rmaq", start_turn, turned[0]) + np.einsum("rmab,rbq->rmaq", end_turn, turned[1])
        if moves:
            of_clamps += moved[0][:, None]
        of_clips = of_clamps[..., :2] + of_sliding + length[..., None] * (mesh.edge_slope / mesh.edge) + sliding
        pose = of_clamps[..., 2:]
        parts = [at[..., :theta] @ chain]
        names = unknowns.names
        ends = (end for end, name in enumerate(("clip_start", "clip_end")) if name in names)
        parts += [of_clips[..., [end]] * values.clip[end] for end in ends]
        parts.append(of_knots)
        if unknowns.clamps:
            parts.append(np.einsum("rmaq,rqc->rmac", pose, unknowns.constant_slopes()[block]))
        shared = np.concatenate(parts, axis=-1).reshape(count, -1, len(names))
        return shared, (pose * unknowns.loose if unknowns.clamps else pose[..., :0]).reshape(count, shared.shape[1], -1)

