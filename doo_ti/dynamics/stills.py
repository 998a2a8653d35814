"""Still frames of the rod that moves: shapes at rest, from which Θ is learned together with motion (Eq. 2, §III-E).

Axes: D observations, V marks, E edges, P parameters.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import legendre

from doo_ti.contact.surroundings import Surroundings
from doo_ti.dynamics.theta import MotionTheta, Unknowns, rest_places
from doo_ti.relaxation.relax import relax
from doo_ti.relaxation.sensitivity import sensitivity
from doo_ti.rod.observations import Observations
from doo_ti.rod.start import check_experiment, observation_clamps, start_configuration
from doo_ti.rod.types import Clamps, Configuration, Material, Solution
from doo_ti.system.arguments import typed
from doo_ti.system.errors import InputError

MOST_STRETCH = 0.1  # by which the length of a rod in stills may differ from that in motion
LEAST_ACROSS = 0.2  # of the roll reference, a unit vector: its part across the first edge of a still without a frame


@typed
@dataclass(frozen=True)
class Stills:
    """D shapes at rest, with the clamps that hold them.

    observations  marks
    clamps        where frames are given, these; else at the start a frame whose m1 points towards the roll reference, as in
                  recordings, and at the end a tangent
    start         where relaxations begin
    surroundings  what the rods touch, without friction, with one row for all or one for each
    """

    observations: Observations
    clamps: Clamps
    start: Configuration
    surroundings: Surroundings = Surroundings()

    @classmethod
    @typed
    def of(cls, observations: Observations, reference: np.ndarray, length: float,
           surroundings: Surroundings = Surroundings()) -> "Stills":
        """The stills of a rod of that ``length``, mm. Raises InputError for rods of another length, first edges along the
        reference, and whatever cannot be relaxed."""
        own = float(observations.rest_length.sum())
        if abs(own - length) > MOST_STRETCH * length:
            raise InputError(observations.source, "rest_length_mm", f"{own:.4g} mm in all, {length:.4g} mm in motion",
                             "give still frames of the same rod, marked from the same end")
        if observations.start_frame is None:
            observations = replace(observations, start_frame=_rolled(observations, reference))
        clamps = observation_clamps(observations)
        check_experiment(observations, clamps, 1.0, 0.0)
        return cls(observations, clamps, start_configuration(observations, clamps), surroundings)

    @property
    def count(self) -> int:
        """D, the number of stills."""
        return self.observations.count

    def rested(self, theta: MotionTheta) -> Solution:
        """F of the D rods under Θ; markers count as weight that is spread evenly."""
        rest = theta.rest_curvature_at(self.observations.rest_length)
        material = Material(theta.bend, theta.bend * theta.twist_ratio, 1.0, rest[None])
        return relax(self.start, material, self.clamps, up=theta.up, precision="f64", **self.surroundings.arguments)

    def residuals(self, solution: Solution) -> tuple[np.ndarray, np.ndarray]:
        """((D, V, 3) mm, zero at marks that were not seen, (D,) whether the rod is at a stable minimum)."""
        valid = self.observations.valid[..., None]
        apart = np.where(valid, solution.configuration.vertices - np.where(valid, self.observations.vertices, 0.0), 0.0)
        return apart, solution.converged & solution.stable

    def slopes(self, theta: MotionTheta, solution: Solution, unknowns: Unknowns) -> np.ndarray:
        """(D, P, V, 3) derivatives of the residuals by the entries of p; those of losses are zero."""
        modes, edges = unknowns.modes, len(self.observations.rest_length)
        along = legendre.legvander(rest_places(self.observations.rest_length), max(modes - 1, 0))
        shapes = np.zeros((2 * modes, edges - 1, 2))
        for k in range(modes):
            shapes[k, :, 0] = shapes[modes + k, :, 1] = along[:, k]
        curved = {"modes": shapes} if modes else {}
        found = sensitivity(solution, ("bend", "twist", *curved), **curved, rotations=False, loads=False).vertices
        result = np.zeros((self.count, len(unknowns.names), edges + 1, 3))
        result[:, 0] = theta.bend * (found[..., 0] + theta.twist_ratio * found[..., 1])
        if "twist_ratio" in unknowns.fitted:
            entry = 1 + unknowns.fitted.index("twist_ratio")
            result[:, entry] = unknowns.SIZES["twist_ratio"] * theta.bend * found[..., 1]
        if modes:
            result[:, -2 * modes :] = unknowns.CURVATURE * np.moveaxis(found[..., 2:], -1, 1)
        return np.where(self.observations.valid[:, None, :, None], result, 0.0)

    def variance(self, apart: np.ndarray, used: np.ndarray) -> float:
        """mm², of the noise of a coordinate: as the observations state it, else as the residuals ``apart`` have it."""
        if self.observations.sigma is not None:
            return float(np.mean(np.square(self.observations.sigma)))
        seen = apart[used][self.observations.valid[used]]
        return max(float(np.mean(seen**2)), 1e-12) if len(seen) else np.inf


def _rolled(observations: Observations, reference: np.ndarray) -> np.ndarray:
    """(D, 3, 3) frames of the first edges with m1 towards ``reference``."""
    t = observations.vertices[:, 1] - observations.vertices[:, 0]
    t = t / np.linalg.norm(t, axis=-1, keepdims=True)
    m1 = reference / np.linalg.norm(reference)
    m1 = m1 - np.sum(m1 * t, axis=-1, keepdims=True) * t
    size = np.linalg.norm(m1, axis=-1, keepdims=True)
    if not (observations.valid[:, :2].all() and (size >= LEAST_ACROSS).all()):
        raise InputError(observations.source, "start_frame", "missing, and the first edge was not seen, or points along the "
                         "roll reference", "give start_frame")
    m1 = m1 / size
    return np.stack([t, m1, np.cross(t, m1)], axis=-1)
