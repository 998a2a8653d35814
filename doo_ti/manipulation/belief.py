"""What is known of rods while they are moved: Θ, how the clips hold them, and how they are curved at rest.

Each moment adds its marks to a linear regression with a Gaussian prior, of which older moments fade (a Kalman filter with
fading memory). With unknowns u = σ v, v ~ N(0, 1) before anything is seen, derivatives J of the marks by v, and residuals r of
the marks from the model at the present estimate v₀:

    Λ ← f Λ + JᵀJ/R      η ← f η + Jᵀ(r + J v₀)/R      v = (I + Λ)⁻¹ η      cov v = (I + Λ)⁻¹

R is the variance of a coordinate. To the noise it adds what this moment's linearisation is off by, an error common to all its
marks, which counts as often as these are; and what remains of the marks after the fit, an error of the model that is common to
those of some moments.

Unknowns in their order: ln of the factors on B and on β/B; twelve numbers of the clips (:func:`.model.held`); the additional
compliance of the joints at the clamps, over their own; and coefficients of the rest curvature over the rod's length, two
components for each of CURVES cosines. Those whose σ is zero are known.

Rods whose clamps act half an edge further in, as those of a mesh do, differ from a real one by a few percent of their bending
stiffness. Models therefore bend from the clamped vertices on (:func:`doo_ti.rod.shapes.with_end_edges`), and how much is
learned: a compliance of −1 of the joints there is a clamp that holds the whole edge, one of 0 a clamp that acts at the vertex.

Axes: B rods, P unknowns that are learned, V vertices, E edges, C columns of derivatives that a rod has: by bend and twist
stiffness, by the twelve numbers of its grippers, and by the modes.
"""

from dataclasses import dataclass

import numpy as np

from doo_ti.manipulation.damped_steps import normal_equations
from doo_ti.manipulation.targets import ServoOptions
from doo_ti.rod.shapes import material_curvature
from doo_ti.rod.types import Configuration, Material

BEND, RATIO, CLIP, JOINTS, CURVATURE = 0, 1, 2, 14, 15
CURVES = 3
LINEAR, TOUCHING = 0.1, 0.3
"""Share of a residual that its linearisation is off by, of all marks alike, and of that of rods that touch something: contacts
move along them. With 0.5 learning is slow, with 0.01 the first moments are trusted."""
MOST_DEVIATIONS = 4.0  # standard deviations of the prior, beyond which no unknown goes
CENTRE, STIFFEST, SOFTEST = -0.5, -0.95, 0.5
"""Of the additional compliance of the joints at the clamps, where it is unknown: its mean before anything is seen, and bounds;
at one, the outer edges would have no stiffness."""
PERSISTENT = 3.0
"""Moments to which an error of the model is common. With 1 a tenth of the intervals are too narrow, with 10 all are wide."""
QUANTILE = 1.96  # standard deviations of a 95 % interval
MISFIT = 1.5
"""Where the misfit is more than so many times the noise, intervals are wider by the factor above that (Birge's ratio): marks
may be late, or the rod may touch something that the model does not know."""


@dataclass(frozen=True)
class LearnedMaterial:
    """Θ of B rods as far as it has been learned; intervals contain 95 %.

    material        B rows
    bend, twist, ratio  (B,) mm³, mm³ and β/B; :attr:`EI` and :attr:`GJ` in N m² where the weight per length is known
    bend_interval, twist_interval, ratio_interval  (B, 2)
    misfit          (B,) mm, root mean square of what the model leaves of a coordinate of the marks; NaN before any is seen
    """

    material: Material
    bend: np.ndarray
    twist: np.ndarray
    ratio: np.ndarray
    bend_interval: np.ndarray
    twist_interval: np.ndarray
    ratio_interval: np.ndarray
    misfit: np.ndarray

    @property
    def EI(self) -> np.ndarray | None:  # noqa: N802
        """(B,) N m², or None where the material states no weight per length."""
        return self._in_physical_units(self.bend)

    @property
    def EI_interval(self) -> np.ndarray | None:  # noqa: N802
        """(B, 2) N m²."""
        return self._in_physical_units(self.bend_interval)

    @property
    def GJ(self) -> np.ndarray | None:  # noqa: N802
        """(B,) N m²."""
        return self._in_physical_units(self.twist)

    @property
    def GJ_interval(self) -> np.ndarray | None:  # noqa: N802
        """(B, 2) N m²."""
        return self._in_physical_units(self.twist_interval)

    def _in_physical_units(self, values: np.ndarray) -> np.ndarray | None:
        newton = self.material.newton
        return None if newton is None else (values.T * newton * 1e-6).T


class Belief:
    """The unknowns of B rods.

    material     nominal, B rows, round and uniform
    rest_length  (E,) mm
    centre       mean of the compliance of the joints at the clamps before anything is seen

    Attributes: ``unknowns`` (B, ·), all of them; ``material``, Θ with these; ``expected`` (B,) mm, the root mean square that a
    coordinate was expected to be off by at the last moment.
    """

    def __init__(self, material: Material, rest_length: np.ndarray, options: ServoOptions, centre: float = CENTRE):
        length, self._centre = rest_length.sum(), centre if options.compliance else 0.0
        turn = np.radians(options.clip_deg)
        spread = np.concatenate([[options.bend, options.ratio], np.tile(np.repeat([options.clip_mm, turn], 3), 2),
                                 [options.compliance], np.repeat(options.curvature, 2 * CURVES)])
        place = np.cumsum(rest_length)[:-1] / length
        waves = np.cos(np.pi * np.arange(CURVES)[:, None] * place) / length
        ends = np.eye(len(place))[[0, -1]]
        self.modes = np.einsum("kj,ab->kajb", np.concatenate([ends, waves]), np.eye(2)).reshape(-1, len(place), 2)
        self.learned = np.flatnonzero(spread)
        self._spread, self._nominal, self._options = spread, material, options
        bound = np.full(len(spread), MOST_DEVIATIONS)
        self._least, self._most = -bound[self.learned], bound[self.learned]
        joints = self.learned == JOINTS
        if joints.any():
            self._least[joints], self._most[joints] = (np.array([STIFFEST, SOFTEST]) - centre) / options.compliance
        rods, unknowns = material.count, len(self.learned)
        self.unknowns = np.zeros((rods, len(spread)))
        self._information = np.zeros((rods, unknowns, unknowns))
        self._vector = np.zeros((rods, unknowns))
        self._covariance = np.tile(np.eye(unknowns), (rods, 1, 1))
        self._variance = np.full(rods, options.noise_mm**2)
        self._square = self._variance.copy()  # mm², of what marks are off the model
        self.expected, self._taught = np.full(rods, np.inf), np.zeros(rods, dtype=bool)
        self.material = self._material()

    @property
    def clip(self) -> np.ndarray:
        """(B, 12) of :func:`.model.held`."""
        return self.unknowns[:, CLIP:JOINTS]

    @property
    def uneven(self) -> bool:
        """Whether what differs along the rod is unknown, whose derivatives need ``modes``: changes of the rest curvature at the
        first and at the last joint, then along the cosines, two components each."""
        return bool(self._spread[JOINTS:].any())

    @property
    def compliance(self) -> np.ndarray:
        """(B,) additional, of the joints at the clamps, over their own."""
        return self.unknowns[:, JOINTS] + self._centre

    def _material(self) -> Material:
        """B rows."""
        nominal, bend = self._nominal, self.unknowns[:, BEND]
        rest, matrix = nominal.rest_curvature, nominal.bend * np.exp(bend)[:, None, None, None]
        if self.uneven:
            # Not a matrix product, whose rounding depends on how many rods there are.
            own = np.sum(self.unknowns[:, CURVATURE:, None, None] * self.modes[-2 * CURVES :], axis=1)
            rest = own if rest is None else rest + own
            along = np.ones((len(own), own.shape[1] + 1))  # a joint's stiffness is the mean of its edges'
            along[:, 0] = along[:, -1] = 2.0 / (1.0 + self.compliance) - 1.0
            matrix = matrix * along[..., None, None]
        return Material(matrix, self._twist[:, None], nominal.weight, rest, nominal.weight_per_length)

    def held(self, edge: float) -> np.ndarray:
        """(B,) mm at each end that grippers may hold, of an outer ``edge`` of the rod that was given, to two standard
        deviations: at most the whole."""
        joints = np.flatnonzero(self.learned == JOINTS)
        if not len(joints):
            return np.full(len(self.unknowns), edge)
        spread = self._spread[JOINTS] * np.sqrt(self._covariance[:, joints[0], joints[0]])
        return edge * np.clip(2.0 * spread - self.compliance, 0.0, 1.0)

    @property
    def clip_margin(self) -> np.ndarray:
        """(B,) mm by which both clips together may be off their estimate along any line: two standard deviations."""
        own = (self.learned >= CLIP) & (self.learned < JOINTS) & ((self.learned - CLIP) % 6 < 3)
        variance = np.zeros((len(self.unknowns), 2, 3))
        if own.any():
            variance += (self._spread[self.learned[own]] ** 2 * np.diagonal(self._covariance, axis1=1, axis2=2)[:, own]
                         ).reshape(variance.shape)
        return 2.0 * np.sqrt(variance.max(axis=2).sum(axis=1))

    @property
    def _twist(self) -> np.ndarray:
        """(B,) β."""
        return self._nominal.twist[:, 0] * np.exp(self.unknowns[:, BEND] + self.unknowns[:, RATIO])

    def transform(self, grippers: np.ndarray, elastic: np.ndarray) -> np.ndarray:
        """(B, C, P): what derivatives by v are of the columns of a rod.

        grippers  (4, B, 3, 3) frames of the grippers, for shift and turn of the start and of the end
        elastic   (B, 4) curvature from rest at the first and at the last joint, 1/mm
        """
        soft = 1.0 + self.compliance
        rods = len(soft)
        whole = np.zeros((rods, CLIP + 12 + (len(self.modes) if self.uneven else 0), len(self._spread)))
        whole[:, 0, BEND] = self._nominal.bend[:, 0, 0, 0] * np.exp(self.unknowns[:, BEND])
        whole[:, 1, BEND] = whole[:, 1, RATIO] = self._twist
        for k, frame in enumerate(grippers):
            part = slice(CLIP + 3 * k, CLIP + 3 * k + 3)
            whole[:, part, part] = frame
        if self.uneven:
            # A joint softer by a share bends as if its rest curvature had grown by that share of its elastic one.
            joints = slice(CLIP + 12, CLIP + 16)
            whole[:, joints, JOINTS] = elastic / soft[:, None]
            whole[:, joints, BEND] = elastic * self.compliance[:, None]  # it gains less with B
            whole[:, CLIP + 16 :, CURVATURE:] = np.eye(2 * CURVES)
        if len(self.learned) < len(self._spread):
            whole = whole[..., self.learned]
        whole *= self._spread[self.learned]
        return whole

    def learn(self, residual: np.ndarray, visible: np.ndarray, columns: np.ndarray, transform: np.ndarray,
              touching: np.ndarray) -> np.ndarray:
        """Take in a moment: residuals (B, V, 3) and columns (B, V, 3, C) of the marks, of which some are ``visible`` (B, V), of
        rods that may be ``touching`` (B,) something. Returns (B, C) the change of what the columns are derivatives by."""
        keep, noise = 1.0 - 1.0 / self._options.memory, self._options.noise_mm**2
        count = 3 * visible.sum(axis=1)
        number, self._taught = np.maximum(count, 1), self._taught | (count > 0)
        apart, across = np.where(visible[..., None], residual, 0.0), np.swapaxes(transform, 1, 2)
        normal, right = normal_equations(columns, visible.astype(np.float64), apart)
        # JᵀJ (B, P, P), Jᵀr (B, P) and |r|² (B,), J = columns · transform
        normal, right, square = (across @ (normal @ transform), (across @ right[..., None])[..., 0],
                                 np.einsum("bvk,bvk->b", apart, apart))
        missing = np.maximum(self._variance - noise, 0.0) * PERSISTENT * number / 3
        variance = noise + missing + np.where(touching, TOUCHING, LINEAR) ** 2 * square / 3
        before = self.unknowns[:, self.learned] / self._spread[self.learned]
        self.expected = np.sqrt(self._variance + np.einsum("bpq,bpq->b", normal, self._covariance) / number)
        self._information *= keep
        self._information += normal / variance[:, None, None]
        self._vector = keep * self._vector + (right + (normal @ before[..., None])[..., 0]) / variance[:, None]
        self._covariance = np.linalg.inv(np.eye(len(self.learned)) + self._information)
        after = np.clip((self._covariance @ self._vector[..., None])[..., 0], self._least, self._most)
        step = after - before
        left = square - 2 * np.sum(step * right, axis=1) + np.sum(step * (normal @ step[..., None])[..., 0], axis=1)
        # The noise counts all unknowns as free in every moment, which intervals need where the model is not quite the rod; what
        # marks are off counts those that the moment determines.
        determined = np.einsum("bpq,bpq->b", normal, self._covariance) / variance
        for mean, own in ((self._variance, len(self.learned)), (self._square, determined)):
            freedom = np.maximum(number - own, number / 3)
            mean += np.where(count > 0, (1.0 - keep) * (left / freedom - mean), 0.0)
        self.unknowns = self.unknowns.copy()
        self.unknowns[:, self.learned] = after * self._spread[self.learned]
        self.material = self._material()
        return (transform @ step[..., None])[..., 0]

    def forget(self, rods: np.ndarray) -> None:
        """Half of what those ``rods`` (n,) have taught, whose model was another branch of equilibria than the rod."""
        self._information[rods] *= 0.5
        self._vector[rods] *= 0.5

    def result(self) -> LearnedMaterial:
        """Θ with its intervals."""
        covariance = np.zeros((len(self.unknowns), 2, 2))
        both = np.flatnonzero(self.learned < CLIP)
        kinds = self.learned[both]
        own = self._covariance[:, both[:, None], both] * np.outer(self._spread[kinds], self._spread[kinds])
        covariance[:, kinds[:, None], kinds] = own
        nominal = self._nominal.bend[:, 0, 0, 0], self._nominal.twist[:, 0]
        bend, ratio = self.unknowns[:, :CLIP].T
        value = nominal[0] * np.exp(bend), nominal[1] * np.exp(bend + ratio), nominal[1] / nominal[0] * np.exp(ratio)
        misfit = np.sqrt(self._square)
        excess = np.maximum(misfit / (MISFIT * self._options.noise_mm), 1.0)
        spread = excess * np.sqrt([covariance[:, 0, 0], covariance.sum(axis=(1, 2)), covariance[:, 1, 1]])
        prior = [self._spread[BEND], np.hypot(*self._spread[:CLIP]), self._spread[RATIO]]
        spread = np.minimum(spread, MOST_DEVIATIONS / QUANTILE * np.array(prior)[:, None])
        intervals = [one[:, None] * np.exp(QUANTILE * deviation[:, None] * [-1.0, 1.0])
                     for one, deviation in zip(value, spread, strict=True)]
        return LearnedMaterial(self.material, *value, *intervals, np.where(self._taught, misfit, np.nan))


def elastic_curvature(rods: Configuration, material: Material) -> np.ndarray:
    """(B, 4) curvature from rest at the first and at the last joint, in the material frames of the joints, 1/mm; zero in rods
    that are not finite."""
    bent = [material_curvature(Configuration(rods.start, rods.quaternions[:, pair], rods.rest_length[..., pair]))[:, 0]
            for pair in (slice(0, 2), slice(-2, None))]
    rest = 0.0 if material.rest_curvature is None else material.rest_curvature[:, [0, -1]].reshape(-1, 4)
    return np.nan_to_num(np.concatenate(bent, axis=-1) - rest)
