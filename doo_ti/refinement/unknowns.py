"""The unknowns of a fit, transformed so that none has bounds, and their prior.

    bend                    ln α of B = αI
    bend_1, bend_2          ln B₁₁, ln B₂₂; the correlation B₁₂/√(B₁₁B₂₂) stays
    bend_12                 artanh of that correlation, so that B stays positive definite
    twist, weight           ln β, ln μ
    up                      two tilts from the present up, rad
    clip_start, clip_end    mm from the outer mark inwards to where a clip ends; negative where it ends before that mark
    curvature               L ω̄ at the knots of :mod:`doo_ti.refinement.mesh`, two components each, or of the whole rod
    stiffness               ln B along the rod at these knots, less its mean, and as much of ln β
    clamps                  constant errors of the reported frames: a rotation of each in its own axes, and one in the world's
    spacing                 ln of the rod's length between neighbouring marks over that which the observations state
    outer                   mm by which an outer mark beside a reported frame is off the rod, along the frame's axes and the
                            world's: it often is the place of what holds the rod, and off by as much as that is

The prior of the first five is so wide that it matters only along directions that the observations do not determine; only twist
over bend is expected to be that of a common rod (:func:`doo_ti.refinement.theta.common_rod`) where nothing says how far the rod
is twisted.

Axes: D observations, P unknowns, the first T of them Θ's, K knots, E edges between marks, N edges of the mesh.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from doo_ti.refinement.held_rod import POSE, TURNS, HeldRod
from doo_ti.refinement.mesh import Field, Lengths, Mesh, knots_of, values_at
from doo_ti.refinement.theta import Scales, Theta, common_rod, slopes_of_entries
from doo_ti.rod.frames import rotation_matrix, tilt_axes, tilts_between
from doo_ti.rod.types import Material
from doo_ti.system.errors import InputError

PARAMETERS = ("bend", "bend_1", "bend_2", "bend_12", "twist", "weight", "up")
CLIPS = ("clip_start", "clip_end")
LOGARITHMIC = ("bend", "bend_1", "bend_2", "twist", "weight")
WIDE = 7.0  # standard deviation of the logarithm of a positive unknown: a factor of a thousand either way
TILT = 0.1  # rad, of gravity's direction, where that is learned
CLIP_MEAN, CLIP_SPREAD = 0.75, 0.75
"""Prior of where a clip ends: mean and standard deviation, in spacings of the outer marks, inwards from the outermost."""
RATIO_FACTOR = 0.4
"""Prior of twist over bend stiffness where nothing says how far the rod is twisted: standard deviation of its logarithm about
that of a common rod."""
OUTER_SPREAD = 0.1  # prior of by how much an outer mark beside a reported frame is off, in spacings of the outer marks
ALONG = ("bend", "twist")  # what varies along an uneven rod


@dataclass(frozen=True)
class Values:
    """Values of all unknowns, in their own units."""

    theta: Theta  # Θ without its rest curvature
    clip: np.ndarray  # (2,) mm
    curvature: np.ndarray  # (K, 2) 1/mm at the knots, (1, 2) of the whole rod, or (0, 2)
    stiffness: np.ndarray  # (K,) at the knots, or (0,)
    # (TURNS,) rad, constant errors of the reported frames: of start and end in their axes, and in the world's
    constant: np.ndarray
    scatter: np.ndarray  # (D, POSE) additional errors of the clamps in each observation
    spacing: np.ndarray  # (M − 1,) logarithms of the spacings of the marks over the stated ones
    outer: np.ndarray  # (2, 6) mm, constant errors of the outer marks


@dataclass(frozen=True)
class Unknowns:
    """Which unknowns a fit has.

    Raises InputError for parameters that are unknown, repeated or contradict each other.
    """

    rod: HeldRod  # the observed rod
    parameters: tuple[str, ...]  # of Θ, from PARAMETERS
    clips: bool = True  # whether the clips' lengths are unknown
    curvature: str = "field"  # "field", "uniform" or "none"
    twist_follows: bool = False  # whether a twist stiffness that is not learned stays in proportion to the bend stiffness
    uneven: bool = False  # whether the bend stiffness varies along the rod

    def __post_init__(self) -> None:
        names = self.parameters
        for name in names:
            if name not in PARAMETERS:
                raise InputError("refine", "parameters", f"{name!r} is unknown",
                                 f"use {', '.join(PARAMETERS).replace('_', '-')}")
        for other in ("bend_1", "bend_2", "bend_12"):
            if "bend" in names and other in names:
                raise InputError("refine", "parameters", f"both bend and {other}", "give one of them")
        if not names or len(set(names)) < len(names):
            raise InputError("refine", "parameters", f"{', '.join(names) or 'none'}", "give each parameter once")

    @property
    def round(self) -> bool:
        """Whether the rod is taken to bend alike about all axes."""
        return not {"bend_1", "bend_2", "bend_12"} & set(self.parameters)

    @cached_property
    def knots(self) -> np.ndarray:
        """(K,) mm: one knot for a uniform rest curvature, no knots for none."""
        if self.curvature == "field":
            return knots_of(self.rod.observations.rest_length)
        return np.full(int(self.curvature == "uniform"), 0.5 * self.rod.length)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """(P,)"""
        of_theta = [part for name in self.parameters for part in (("up[0]", "up[1]") if name == "up" else (name,))]
        ends = [name for name, held in zip(CLIPS, self.rod.clamped, strict=True) if held and self.clips]
        seen = self.rod.observations
        fields = {field.name: field.components * len(field.knots) for field in self.fields}
        numbered = {**fields, "clamps": TURNS * self.turns,
                    "spacing": seen.edges if seen.spacing_error > 0 else 0, "outer": 6 * len(self.outer_ends)}
        return (*of_theta, *ends, *(f"{part}[{k}]" for part, count in numbered.items() for k in range(count)))

    @cached_property
    def fields(self) -> tuple[Field, ...]:
        """The functions along the rod among the unknowns."""
        found = (Field("curvature", "range", self.knots, 2, self.rod.length),
                 Field("stiffness", "stiffness_range", self.stiffness_knots, 1, 1.0))
        return tuple(field for field in found if len(field.knots))

    @cached_property
    def stiffness_knots(self) -> np.ndarray:
        """(K,) mm, none where the bend stiffness is uniform."""
        return knots_of(self.rod.observations.rest_length) if self.uneven else np.zeros(0)

    @cached_property
    def outer_ends(self) -> np.ndarray:
        """Of the outer marks, 0 and −1, those beside which a frame was reported that may be off."""
        seen = self.rod.observations
        given = [frame is not None and not self.rod.exact for frame in (seen.start_frame, seen.end_frame)]
        return np.array([0, -1])[given]

    @cached_property
    def outer_axes(self) -> np.ndarray:
        """(D, ·, 3, 6) the axes of the reported frames there, and of the world."""
        seen = self.rod.observations
        frames = np.stack([(seen.start_frame, seen.end_frame)[end] for end in self.outer_ends], axis=1)
        return np.concatenate([frames, np.broadcast_to(np.eye(3), frames.shape)], axis=-1)

    @property
    def turns(self) -> bool:
        """Whether reported frames may have constant errors."""
        return "turn_scatter" in self.rod.pose_scales

    @property
    def theta_count(self) -> int:
        """T."""
        return len(self.parameters) + ("up" in self.parameters)

    @property
    def scale_names(self) -> set[str]:
        """The sizes of :mod:`doo_ti.refinement.theta` that occur in the prior of the unknowns."""
        found = {"turn", "turn_scatter"} if self.turns else set()
        for field in self.fields:
            found |= {field.name} | ({field.range} if len(field.knots) > 1 else set())
        return found

    @cached_property
    def _columns(self) -> dict[str, np.ndarray]:
        parts = np.array([name.partition("[")[0] for name in self.names])
        return {part: np.flatnonzero(parts == part) for part in set(parts.tolist())}

    def columns(self, part: str) -> np.ndarray:
        """Indices of the unknowns that are called ``part``, or ``part[·]``."""
        return self._columns.get(part, np.zeros(0, dtype=int))

    def begun(self, theta: Theta, clip: np.ndarray) -> Values:
        """Initial values: ``theta`` with its own rest curvature, and clamps without errors.

        Raises InputError where ``theta`` does not fit the unknowns.
        """
        first, second, mixed = theta.bend[0, 0], theta.bend[1, 1], theta.bend[0, 1]
        if "bend" in self.parameters and (first != second or mixed != 0):
            raise InputError("refine", "parameters", "bend of a rod that is not round", "give bend_1 and bend_2")
        if "weight" in self.parameters and not theta.weight > 0:
            raise InputError("refine", "weight", f"{theta.weight:g} has no logarithm", "give a positive weight")
        curvature = np.zeros((len(self.knots), 2))
        if theta.rest_curvature is not None:
            if not len(curvature):
                raise InputError("refine", "rest_curvature", "given, but the fit has none", "leave the curvature unknown")
            own = np.atleast_2d(theta.rest_curvature)
            joints = np.cumsum(self.rod.observations.rest_length)[:-1]
            curvature[:] = own if len(own) == 1 else np.stack([np.interp(self.knots, joints, c) for c in own.T], axis=1)
        count = self.rod.observations.count
        return Values(replace(theta, rest_curvature=None), np.array(clip, dtype=float), curvature,
                      np.zeros(len(self.stiffness_knots)), np.zeros(TURNS), np.zeros((count, POSE)),
                      np.zeros(self.rod.observations.edges), np.zeros((2, 6)))

    def lengths(self, values: Values) -> Lengths:
        """Where marks and clips are along the rod."""
        return Lengths(values.clip, self.rod.observations.rest_length * np.exp(values.spacing))

    def moved(self, values: Values, step: np.ndarray, scatter: np.ndarray) -> Values:
        """``values`` with the unknowns changed by ``step`` (P,) and the clamps' scatter by ``scatter`` (D, POSE)."""
        of = dict(zip(self.names, step, strict=True))
        theta, up, both = values.theta, values.theta.up, of.get("bend", 0.0)
        correlation = np.tanh(np.arctanh(theta.correlation) + of.get("bend_12", 0.0))
        logarithms = np.array([of.get(name, 0.0) + both for name in ("bend_1", "bend_2")])
        root = np.sqrt(np.diag(theta.bend)) * np.exp(0.5 * logarithms)
        if "up[0]" in of:
            up = rotation_matrix(np.array([of["up[0]"], of["up[1]"]]) @ tilt_axes(up)) @ up
        twist = of.get("twist", logarithms.mean() if self.twist_follows else 0.0)
        theta = Theta(np.diag(root**2) + correlation * root.prod() * (1 - np.eye(2)),
                      theta.twist * float(np.exp(twist)), theta.weight * float(np.exp(of.get("weight", 0.0))),
                      None, up / np.linalg.norm(up))
        clip = values.clip + [of.get("clip_start", 0.0), of.get("clip_end", 0.0)]
        curvature = values.curvature + step[self.columns("curvature")].reshape(-1, 2) / self.rod.length
        stiffness = values.stiffness + step[self.columns("stiffness")]
        constant = values.constant + (step[self.columns("clamps")] if self.turns else 0.0)
        spacing, own = values.spacing.copy(), self.columns("spacing")
        spacing[: len(own)] += step[own]
        outer = values.outer.copy()
        outer[self.outer_ends] += step[self.columns("outer")].reshape(-1, 6)
        return Values(theta, clip, curvature, stiffness, constant, values.scatter + scatter, spacing, outer)

    def theta_at(self, values: Values, joints: np.ndarray | None = None) -> Theta:
        """Θ with the rest curvature at ``joints`` (·,), mm; by default at the E − 1 joints between the marks' edges."""
        if not len(self.knots):
            return values.theta
        joints = np.cumsum(self.rod.observations.rest_length)[:-1] if joints is None else joints
        return replace(values.theta, rest_curvature=values_at(joints, self.knots)[0] @ values.curvature)

    def material(self, values: Values) -> Material:
        """The material on the mesh."""
        mesh = self.rod.mesh(self.lengths(values))
        material = self.theta_at(values, mesh.joints).material
        if not self.uneven:
            return material
        edges, joints = (np.exp(self.stiffness_at(values, places))[None] for places in (mesh.middles, mesh.joints))
        return replace(material, bend=material.bend * edges[..., None, None], twist=material.twist * joints)

    def model(self, values: Values) -> tuple[Material, Lengths, np.ndarray, np.ndarray]:
        """The material on the mesh, the lengths, the poses of the clamps, and up: what :meth:`HeldRod.relaxed` takes."""
        return self.material(values), self.lengths(values), self.pose(values), values.theta.up

    def stiffness_at(self, values: Values, places: np.ndarray) -> np.ndarray:
        """(X,) ln of the bend stiffness at arc lengths ``places`` (X,) over its geometric mean along the mesh, which is Θ's."""
        if not self.uneven:
            return np.zeros(len(places))
        along, mesh = (values_at(at, self.stiffness_knots)[0] @ values.stiffness
                       for at in (places, self.rod.mesh(self.lengths(values)).middles))
        return along - mesh.mean()

    def pose(self, values: Values) -> np.ndarray:
        """(D, POSE) the error of each clamp's pose in each observation."""
        return values.scatter + np.einsum("dij,j->di", self.rod.constant_slopes, values.constant)

    def modes(self, values: Values) -> tuple[np.ndarray, Mesh]:
        """(2 K + GEOMETRY, N − 1, 2) derivatives of the rest curvature on the mesh, by each unknown of the curvature and by the
        lengths, with which the joints slide along the rod; and the mesh."""
        mesh = self.rod.mesh(self.lengths(values))
        weights, slopes = values_at(mesh.joints, self.knots)
        by_knot = np.einsum("jk,ab->kajb", weights, np.eye(2)).reshape(-1, len(mesh.joints), 2) / self.rod.length
        by_clip = np.einsum("jk,kb,je->ejb", slopes, values.curvature, mesh.slope(mesh.joints))
        return np.concatenate([by_knot, by_clip]), mesh

    def stiffness_modes(self, values: Values, mesh: Mesh, elementary: tuple[str, ...]) -> np.ndarray:
        """(K + GEOMETRY + ·, N − 1, 3) derivatives of ln B of both edges at each joint, and of ln β there, of a rod whose
        stiffness varies along it: by each unknown of the stiffness, by the lengths, with which the mesh slides along the rod,
        and by ln α and ln β, those of them that are ``elementary`` (:meth:`chain`)."""
        def at(places: np.ndarray) -> np.ndarray:
            weights, slopes = values_at(places, self.stiffness_knots)
            return np.concatenate([weights, (slopes @ values.stiffness)[:, None] * mesh.slope(places)], axis=1)

        edges, joints = at(mesh.middles), at(mesh.joints)
        along = np.stack([edges[:-1], edges[1:], joints], axis=-1) - edges.mean(axis=0)[:, None]
        whole = np.array([[name == "bend"] * 2 + [name == "twist"] for name in ALONG if name in elementary], dtype=np.float64)
        return np.concatenate([np.moveaxis(along, 0, 1), np.repeat(whole.reshape(-1, 1, 3), len(joints), axis=1)])

    def chain(self, values: Values) -> tuple[tuple[str, ...], np.ndarray]:
        """The parameters of :func:`doo_ti.relaxation.sensitivity.sensitivity` that Θ's unknowns need, those of
        :data:`ALONG` first, and the derivatives (·, T) of their columns by the unknowns of Θ."""
        theta, entries = values.theta, ("bend_1", "bend_2", "bend_12")
        elementary = [name for name in self.parameters if name not in entries]
        elementary += entries if len(elementary) < len(self.parameters) else ()
        names = self.names[: self.theta_count]
        follows = {"bend": 1.0, "bend_1": 0.5, "bend_2": 0.5} if self.twist_follows and "twist" not in names else {}
        elementary += ["twist"] * bool(follows)
        elementary.sort(key=lambda name: (*ALONG, name).index(name))
        rows = []
        for name in elementary:
            if name in entries:
                slopes = dict(zip(entries, slopes_of_entries(theta.bend)[entries.index(name)], strict=True))
                rows.append([slopes.get(unknown, 0.0) for unknown in names])
            elif name == "up":
                rows += [[float(unknown == f"up[{k}]") for unknown in names] for k in range(2)]
            else:
                along = follows if name == "twist" and follows else {name: 1.0}
                relative = name in ALONG and self.uneven  # as one of the modes of the stiffness
                rows.append([(1.0 if relative else theta.entries[name]) * along.get(unknown, 0.0) for unknown in names])
        return tuple(elementary), np.array(rows)

    def offset(self, values: Values, origin: Values) -> np.ndarray:
        """(P,) the unknowns less the mean of their prior; that of Θ is ``origin``."""
        theta, start, parts = values.theta, origin.theta, []
        for name in self.names[: self.theta_count]:
            if name in LOGARITHMIC:
                parts.append(np.log(theta.entries[name] / start.entries[name]))
            elif name == "bend_12":
                parts.append(np.arctanh(theta.correlation) - np.arctanh(start.correlation))
            else:
                parts.append(tilts_between(start.up, theta.up)[int(name[3])])
        clips = [apart for name, apart in zip(CLIPS, values.clip - self.clip_prior, strict=True) if name in self.names]
        constant = values.constant if self.turns else np.zeros(0)
        return np.concatenate([parts, clips, self.rod.length * values.curvature.ravel(), values.stiffness, constant,
                               values.spacing[: len(self.columns("spacing"))], values.outer[self.outer_ends].ravel()])

    @property
    def clip_prior(self) -> np.ndarray:
        """(2,) prior mean of the clips' lengths, mm."""
        return CLIP_MEAN * self.rod.observations.rest_length[[0, -1]]

    def precision(self, scales: Scales) -> tuple[np.ndarray, float]:
        """(P, P) inverse covariance of the prior, and ln of its determinant."""
        spread = np.full(len(self.names), WIDE)
        outer = CLIP_SPREAD * self.rod.observations.rest_length[[0, -1]]
        for prefix, size in (("up", TILT), ("clip_start", outer[0]), ("clip_end", outer[1]), ("clamps", scales["turn"]),
                             ("spacing", self.rod.observations.spacing_error)):
            spread[self.columns(prefix)] = size
        spread[self.columns("outer")] = np.repeat(OUTER_SPREAD * self.rod.observations.rest_length[self.outer_ends], 6)
        matrix = np.diag(1 / spread**2)
        if len(ratio := self._ratio):
            matrix[: len(ratio), : len(ratio)] += np.outer(ratio, ratio) / RATIO_FACTOR**2
        logarithm = float(np.linalg.slogdet(matrix)[1])
        for field in self.fields:
            own = self.columns(field.name)
            prior, _ = field.covariance(scales)
            matrix[np.ix_(own, own)] = np.kron(np.linalg.inv(prior), np.eye(field.components))
            logarithm += 2 * float(np.log(spread[own]).sum()) - field.components * float(np.linalg.slogdet(prior)[1])
        return matrix, logarithm

    @property
    def _ratio(self) -> np.ndarray:
        """(T,) direction of the logarithm of twist over bend stiffness, if both are learned; else (0,)."""
        names = self.names[: self.theta_count]
        bends = [name for name in ("bend", "bend_1", "bend_2") if name in names]
        if not bends or "twist" not in names or not self.rod.twist_unknown:
            return np.zeros(0)
        return np.array([float(name == "twist") - (name in bends) / len(bends) for name in names])

    def expected(self, theta: Theta) -> Theta:
        """``theta`` as the mean of the prior: a common rod where that knows of the twist stiffness."""
        return common_rod(theta) if len(self._ratio) else theta
