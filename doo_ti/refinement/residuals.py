"""Residuals of all observations, and their linear model around the present values of a fit.

A mark's residual is x − x', a director's m1 − m1', of model and observation. Around the present values

    r_d = r_d(now) + J_d x + Z_d z_d + noise,    x ~ N(x̄, A⁻¹), z_d ~ N(0, S), noise ~ N(0, σ²),

with the P unknowns x that all observations share, and the Q effects z_d of one observation: errors of its clamps, and
amplitudes of smooth displacements that the rest of the model does not explain (the gap). x counts from the present values,
z_d from zero.

Marks from which a clamp's position or tangent was taken are left out: there the model agrees by construction. Residuals of
marks are in mm, or in units of σ where the observations state it; those of directors have no unit.

Axes: D observations, M marks, N residuals of one kind in each observation, P unknowns, Q effects, G smooth displacements.
"""

from dataclasses import dataclass, fields

import numpy as np

from doo_ti.refinement.held_rod import POSE
from doo_ti.refinement.mesh import GEOMETRY, Lengths, Mesh, values_at
from doo_ti.refinement.theta import Scales
from doo_ti.refinement.unknowns import ALONG, CLIPS, Unknowns, Values
from doo_ti.relaxation.pullback import pullback
from doo_ti.relaxation.sensitivity import STIFFNESS_MODES, sensitivity
from doo_ti.rod.types import Clamp, Solution

RODS_AT_ONCE = 128  # derivatives of as many rods are held in memory at a time
SOFT = 30.0  # times the median: rods whose derivatives are larger are about to snap
GAP_MODES = 4
OF_POSES = ("end_shift", "start_turn", "end_turn")
"""Of :func:`doo_ti.relaxation.sensitivity.sensitivity`, three columns each: what a pose moves, beside the whole rod, which its
start carries along. Obstacles stay where they are: among them the start's displacement has columns of its own."""


@dataclass(frozen=True)
class Residuals:
    """Residuals of one kind, all with the noise of ``scale``, a name of :mod:`doo_ti.refinement.theta`."""

    scale: str
    values: np.ndarray  # (D, N) with z_d = 0; zero where nothing was seen
    shared: np.ndarray  # (D, N, P) J
    effects: np.ndarray  # (D, N, Q) Z
    count: np.ndarray  # (D,) number of independent residuals


@dataclass(frozen=True)
class Moments:
    """Products of the residuals of one kind: all that the evidence needs of them. Sums are over the observations, each with its
    share."""

    scale: str
    squares: float  # Σ r²
    shared: np.ndarray  # (P, P) Σ JᵀJ
    shared_slope: np.ndarray  # (D, P) Jᵀr
    mixed: np.ndarray  # (D, Q, P) ZᵀJ
    effects: np.ndarray  # (D, Q, Q) ZᵀZ
    effects_slope: np.ndarray  # (D, Q) Zᵀr
    count: float  # number of independent residuals

    @classmethod
    def of(cls, residuals: Residuals, share: np.ndarray | float = 1.0) -> "Moments":
        """``share``: (D,) weight of each observation in the sums."""
        share = np.broadcast_to(share, len(residuals.values))
        root = np.sqrt(share)[:, None]
        shared = (root[..., None] * residuals.shared).reshape(residuals.values.size, -1)
        transposed, effects = np.swapaxes(residuals.shared, 1, 2), np.swapaxes(residuals.effects, 1, 2)
        values = residuals.values[..., None]
        return cls(
            residuals.scale, float(share @ (residuals.values**2).sum(axis=1)), shared.T @ shared, (transposed @ values)[..., 0],
            effects @ residuals.shared, effects @ residuals.effects,
            (effects @ values)[..., 0], float(share @ residuals.count))

    def averaged(self, other: "Moments", weight: float) -> "Moments":
        """The mean of both, ``other`` with ``weight``."""
        return Moments(self.scale, *((1 - weight) * getattr(self, field.name) + weight * getattr(other, field.name)
                                     for field in fields(self)[1:]))


@dataclass(frozen=True)
class Comparison:
    """The compared quantities."""

    unknowns: Unknowns  # of the fit
    weight: np.ndarray  # (D, M) of marks: zero for those that are left out
    directors: np.ndarray | None  # (D, M − 1) one where m1 of an edge is compared; None where frames are not
    # (D, M, 3) change of the marks' places by a finer mesh, mm: :func:`doo_ti.refinement.refine.mesh_correction`
    correction: np.ndarray

    @classmethod
    def of(cls, unknowns: Unknowns, with_frames: bool) -> "Comparison":
        seen, clamps = unknowns.rod.observations, unknowns.rod.clamps
        counts = seen.valid.copy()
        ends = ((clamps.start, 0, 1, seen.start_frame), (clamps.end, -1, -2, seen.end_frame))
        for kind, outer, inner, frame in ends if unknowns.rod.exact else ():
            counts[:, outer] &= np.asarray(kind) < Clamp.POSITION
            if frame is None:  # the tangent is that of the observed edge
                counts[:, inner] &= np.asarray(kind) < Clamp.TANGENT
        sigma = np.ones(counts.shape) if seen.sigma is None else np.broadcast_to(seen.sigma, counts.shape)
        weight = np.where(counts, 1 / np.where(counts, sigma, 1.0), 0.0)
        if not with_frames:
            return cls(unknowns, weight, None, np.zeros_like(seen.vertices))
        directors = np.ones((seen.count, seen.edges))
        for kind, outer in ((clamps.start, 0), (clamps.end, -1)):
            directors[np.broadcast_to(np.asarray(kind) == Clamp.FRAME, seen.count), outer] = 0.0
        return cls(unknowns, weight, directors, np.zeros_like(seen.vertices))

    @property
    def count(self) -> np.ndarray:
        """(D,) number of coordinates of marks that are compared."""
        return 3.0 * (self.weight > 0).sum(axis=1)

    def values(self, solution: Solution, values: Values) -> tuple[np.ndarray, ...]:
        """(D, 3 M) residuals of the marks and, if these are compared, (D, 3 (M − 1)) of the directors."""
        rod = self.unknowns.rod
        seen = rod.observations
        places = rod.marks(solution, self.unknowns.lengths(values)) + self.correction
        if len(ends := self.unknowns.outer_ends):
            places[:, ends] += np.einsum("deij,ej->dei", self.unknowns.outer_axes, values.outer[ends])
        marks = self.weight[..., None] * (places - np.nan_to_num(seen.vertices))
        found = (np.where(self.weight[..., None] > 0, marks, 0.0).reshape(len(marks), -1),)
        if self.directors is None:
            return found
        apart = rod.directors(solution, self.unknowns.lengths(values)) - seen.frames[..., 1]
        return (*found, (self.directors[..., None] * apart).reshape(len(apart), -1))

    def linear(self, solution: Solution, values: Values, used: np.ndarray, leave_out_soft: bool = True, shared: bool = True
               ) -> tuple[tuple[Residuals, ...], np.ndarray]:
        """The linear model around ``values``, all effects zero, of the rods ``used`` (D,) bool; and the rods in it (D,) bool:
        those with derivatives, without those about to snap if ``leave_out_soft``. Without ``shared`` it has the effects alone,
        P = 0, at a fraction of the time."""
        loaded = shared and self.unknowns.rod.loads is not None
        bodies = self._by_bodies(solution, values) if loaded else np.zeros((len(used), 1, 1, 1))
        parts = [self._derivatives(solution, values, slice(first, min(first + RODS_AT_ONCE, len(used))), shared, bodies)
                 for first in range(0, len(used), RODS_AT_ONCE)]
        kinds = [tuple(np.concatenate(pieces) for pieces in zip(*kind, strict=True))
                 for kind in zip(*(of_kinds for of_kinds, _ in parts), strict=True)]
        used = used & np.concatenate([usable for _, usable in parts])
        # A rod about to snap moves far for tiny changes of the unknowns: the linear model does not hold for it.
        if used.any() and leave_out_soft:
            size = np.sqrt((kinds[0][0] ** 2).mean(axis=(1, 2)))
            used &= size <= SOFT * np.median(size[used])
        weights, counts = [np.repeat(self.weight, 3, axis=1)], [self.count]
        if self.directors is not None:
            weights.append(np.repeat(self.directors, 3, axis=1))
            counts.append(2.0 * self.directors.sum(axis=1))  # a unit vector has two numbers
        found = []
        for name, now, (j, z), weight, count in zip(
                ("marks", "frames"), self.values(solution, values), kinds, weights, counts, strict=False):
            gap = self.gap_modes if name == "marks" else 0.0  # which leaves directors unchanged
            z = np.concatenate([z, np.broadcast_to(gap, (*z.shape[:2], 3 * GAP_MODES))], axis=-1)
            keep = np.where(used[:, None], weight, 0.0)[..., None]
            z = np.where(keep > 0, keep * z, 0.0)
            r = np.where(used[:, None], now, 0.0)
            if not self.unknowns.rod.exact:
                r = r - (z[..., :POSE] @ values.scatter[..., None])[..., 0]
            found.append(Residuals(name, r, np.where(keep > 0, keep * j, 0.0), z, np.where(used, count, 0.0)))
        return tuple(found), used

    def squares(self, residuals: tuple[np.ndarray, ...], scatter: np.ndarray, scales: Scales) -> np.ndarray:
        """(D,) of ``residuals`` as :meth:`values` returns them, the gap integrated out, and of the errors of the clamps, each
        over its size."""
        gap = self.gap_weight(scales)
        total = np.zeros(len(scatter))
        for name, kind in zip(("marks", "frames"), residuals, strict=False):
            rows = kind / scales[name]
            total += (rows**2).sum(axis=1)
            if name == "marks":
                total -= ((rows @ gap) ** 2).sum(axis=1)
        if not self.unknowns.rod.exact:
            sizes = np.array([scales[name] if name else np.inf for name in self.unknowns.rod.pose_scales])
            total += ((scatter / sizes) ** 2).sum(axis=1)
        return total

    def gap_weight(self, scales: Scales) -> np.ndarray:
        """(3 M, 3 G) C of rᵀ(σ² + δ²ΦΦᵀ)⁻¹r = (|r|² − |rᵀC|²)/σ², Φ the smooth displacements and δ the size ``gap``: one C for
        all observations, with the mean weight of the marks."""
        weight = self.weight[self.weight > 0].mean() if (self.weight > 0).any() else 1.0
        modes = self.gap_modes * weight * scales["gap"] / scales["marks"]
        left, sizes, _ = np.linalg.svd(modes, full_matrices=False)
        return left * np.sqrt(sizes**2 / (1 + sizes**2))

    @property
    def gap_modes(self) -> np.ndarray:
        """(3 M, 3 G) smooth displacements of the marks, zero at a held end; the k-th is scaled by 1/k²."""
        rod, k = self.unknowns.rod, np.arange(1, GAP_MODES + 1)
        start, end = (bool(np.max(kind) >= Clamp.POSITION) for kind in (rod.clamps.start, rod.clamps.end))
        place = Lengths(np.zeros(2), rod.observations.rest_length).mark_place
        share = (place - place[0]) / (place[-1] - place[0])
        waves = np.pi * np.outer(share, k if start and end else k - 0.5)
        modes = (np.sin(waves) if start else np.cos(waves)) / k**2
        return np.einsum("mg,ab->magb", modes, np.eye(3)).reshape(-1, 3 * GAP_MODES)

    def _by_bodies(self, solution: Solution, values: Values) -> np.ndarray:
        """(D, M, 3, GEOMETRY + M − 1) derivatives of the marks by lengths and spacings, because bodies stay at their marks
        as the mesh slides along the rod: weight passes from one vertex to the next, which pulls. The gradient of a pull's work
        by forces is how a rod moves under that pull."""
        lengths, (_, mesh), loads = self.unknowns.lengths(values), self.unknowns.modes(values), self.unknowns.rod.loads
        by_place = np.concatenate([mesh.slide(lengths.mark_place), lengths.mark_slope / mesh.edge], axis=1)
        weights, slopes = mesh.at(lengths.mark_place)[0], values_at(lengths.mark_place, mesh.place)[1] * mesh.edge
        found = np.zeros((*self.weight.shape, 3, by_place.shape[1]))
        for mark in np.flatnonzero(loads.any(axis=0)):
            pull = -loads[:, mark, None, None] * slopes[mark][:, None] * values.theta.up
            moved = np.nan_to_num(pullback(solution, pull, ("forces",))["forces"])
            found += (weights @ moved)[..., None] * by_place[mark]
        return found

    def _derivatives(self, solution: Solution, values: Values, rows: slice, shared: bool, bodies: np.ndarray):
        """(J, Z) of each kind, Z without the gap, and usable (R,) bool, of the R rods ``rows``; J without columns if not
        ``shared``. ``bodies``: see :meth:`_by_bodies`; directors do not follow these."""
        unknowns, among = self.unknowns, bool(self.unknowns.rod.surroundings)
        (elementary, chain), (modes, mesh) = unknowns.chain(values), unknowns.modes(values)
        of_poses = ("start_shift", *OF_POSES) if among else OF_POSES
        names, along = of_poses, {}
        if shared:
            names, along = (*elementary, "modes", "length", *of_poses), {"modes": modes}
        if shared and unknowns.uneven:
            names = (STIFFNESS_MODES, *(name for name in names if name not in ALONG))
            along["stiffness_modes"] = unknowns.stiffness_modes(values, mesh, elementary)
        found = sensitivity(solution, names, first=rows.start, last=rows.stop, rotations=self.directors is not None,
                            loads=False, **along)
        lengths, shape = unknowns.lengths(values), found.configuration
        moved, turned = (slopes[:, rows] for slopes in unknowns.rod.clamp_slopes(lengths, unknowns.pose(values)))
        by_clamps = np.concatenate([*(moved if among else [moved[1] - moved[0]]), *turned], axis=1)
        place, slope = lengths.mark_place, lengths.mark_slope
        # Arc lengths of X places, their derivatives by the logarithms of the marks' spacings, weights of the interpolation
        # there and their derivatives by u, the vectors on the mesh (R, ·, 3), their derivatives, the displacement of the start,
        # which carries the whole rod along, and what bodies add.
        quantities = [(place, slope, mesh.at(place), shape.vertices, found.vertices, 0.0 * moved[0] if among else moved[0],
                       bodies[rows])]
        if self.directors is not None:
            place, slope = (0.5 * (ends[1:] + ends[:-1]) for ends in (place, slope))
            quantities.append((place, slope, mesh.at_edges(place), shape.frames[..., 1], found.directors,
                               np.zeros_like(moved[0]), 0.0))
        kinds = []
        for place, slope, (weights, turns), present, changes, carried, more in quantities:
            flat = np.where(np.isnan(changes), 0.0, changes).reshape(*changes.shape[:2], -1)
            at = (weights @ flat).reshape(len(flat), len(weights), 3, -1)
            poses = at[..., -by_clamps.shape[1] :] @ by_clamps[:, None] + carried[:, None]
            effects = poses[..., :0] if unknowns.rod.exact else poses[..., GEOMETRY:] * unknowns.rod.loose
            by_place = np.concatenate([mesh.slide(place), slope / mesh.edge], axis=1)
            sliding = (turns @ present)[..., None] * by_place[:, None] + more
            by_unknowns = self._shared(at, poses, sliding, chain, values, mesh, rows) if shared else at[..., :0]
            kinds.append([part.reshape(len(at), 3 * at.shape[1], part.shape[-1]) for part in (by_unknowns, effects)])
        return kinds, found.usable

    def _shared(self, at: np.ndarray, poses: np.ndarray, sliding: np.ndarray, chain: np.ndarray, values: Values, mesh: Mesh,
                rows: slice) -> np.ndarray:
        """(R, X, 3, P) derivatives by the unknowns: the chain rule over those on the mesh.

        at       (R, X, 3, columns of :func:`sensitivity`)
        poses    (R, X, 3, GEOMETRY + Q) by the lengths, as they move the clamps, and by the poses
        sliding  (R, X, 3, GEOMETRY + M − 1) as the mesh slides along the rod by its lengths, and the places by the spacings
        chain    (columns of Θ, unknowns of Θ), from :meth:`Unknowns.chain`
        """
        unknowns = self.unknowns
        theta, knots, stiffness = chain.shape[0], len(unknowns.columns("curvature")), len(unknowns.columns("stiffness"))
        uneven = GEOMETRY * unknowns.uneven
        of_stiffness, of_uneven, of_theta, of_knots, of_joints, length, _ = np.split(
            at, np.cumsum([stiffness, uneven, theta, knots, GEOMETRY, 1]), axis=-1)
        by_lengths = poses[..., :GEOMETRY] + of_joints + length * (mesh.edge_slope / mesh.edge) + sliding[..., :GEOMETRY]
        if uneven:
            by_lengths += of_uneven
        ends = [end for end, name in enumerate(CLIPS) if name in unknowns.names]
        parts = [of_theta @ chain, by_lengths[..., ends], of_knots, of_stiffness]
        if unknowns.turns:
            parts.append(poses[..., GEOMETRY:] @ unknowns.rod.constant_slopes[rows, None])
        if len(unknowns.columns("spacing")):
            parts.append(by_lengths[..., 2:] * unknowns.lengths(values).spacing + sliding[..., GEOMETRY:])
        if len(unknowns.outer_ends):
            by_outer = np.zeros((*at.shape[:3], len(unknowns.outer_ends), 6))
            if at.shape[1] == len(self.weight[0]):  # directors stay
                for k, end in enumerate(unknowns.outer_ends):
                    by_outer[:, end, :, k] = unknowns.outer_axes[rows, k]
            parts.append(by_outer.reshape(*at.shape[:3], -1))
        return np.concatenate(parts, axis=-1)
