"""Θ of a rod in motion: material, rest shape, mass of its markers, damping and drag, as a vector to fit and as a file. And
still frames of the rod: shapes at rest, from which Θ is learned together with motion (Eq. 2, §III-E).

Axes: D observations, V marks, E edges, P parameters.
"""

import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from msgspec import Meta, Struct
from numpy.polynomial import legendre
from scipy.special import stdtrit

from doo_ti.contact.surroundings import Surroundings
from doo_ti.dynamics.parameters import Dynamics
from doo_ti.io.toml_file import Finite, NotNegative, Positive, Vector, checked
from doo_ti.relaxation.relax import relax
from doo_ti.relaxation.sensitivity import sensitivity
from doo_ti.rod.frames import bishop_frames, unit_vectors
from doo_ti.rod.observations import Observations
from doo_ti.rod.start import check_experiment, observation_clamps, start_configuration
from doo_ti.rod.types import Clamps, Configuration, Material, Solution, unit_up
from doo_ti.system.arguments import owning, short_repr, typed
from doo_ti.system.errors import InputError
from doo_ti.system.files import MOST_TEXT_BYTES, read_content

FILE_KEYS = {"bend": "bend_mm3", "twist_ratio": "twist_ratio", "bend_damping": "bend_damping_s", "drag": "drag_per_s",
             "quadratic_drag": "quadratic_drag_per_mm", "marker_share": "marker_share"}
"""Numbers of Θ and their names in a file."""


class _File(Struct):
    """What a file must hold of Θ; what else it holds is not read."""

    bend_mm3: Positive
    twist_ratio: Positive
    bend_damping_s: NotNegative
    drag_per_s: NotNegative
    quadratic_drag_per_mm: NotNegative
    marker_share: Annotated[float, Meta(ge=0, lt=1)]
    rest_curvature_modes_per_mm: tuple[list[Finite], list[Finite]]
    rest_length_mm: Annotated[list[Positive], Meta(min_length=4)]
    roll_reference: Vector
    up: Vector
    friction: NotNegative | None = None


@owning
@dataclass(frozen=True)
class MotionTheta:
    """Θ of a rod in motion; stiffness is relative to the weight per length of rod and markers together.

    bend            α, mm³ (weight 1)
    twist_ratio     β/α
    bend_damping    τ, s; twist_damping is the same
    drag            1/s
    quadratic_drag  1/mm
    marker_share    of the mass that is in the markers, one at every vertex, in [0, 1)
    rest            (2, K) Legendre coefficients of the rest curvature about m2 and −m1 along the rod, 1/mm
    rest_length     (E,) mm
    reference       (3,) towards which m1 of the first edge points where a recording begins
    up              (3,) unit vector against gravity
    friction        coefficient against all obstacles that do not belong to the rod; None: as these state
    """

    __repr__ = short_repr

    bend: float
    twist_ratio: float
    bend_damping: float
    drag: float
    quadratic_drag: float
    marker_share: float
    rest: Annotated[np.ndarray, "2 K"]
    rest_length: Annotated[np.ndarray, "E"]
    reference: Annotated[np.ndarray, "3"]
    up: Annotated[np.ndarray, "3"] = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    friction: float | None = None

    @property
    def rest_curvature(self) -> np.ndarray:
        """(E − 1, 2) ω̄ at the inner vertices, 1/mm."""
        return self.rest_curvature_at(self.rest_length)

    def rest_curvature_at(self, rest_length: np.ndarray) -> np.ndarray:
        """(E − 1, 2) the same of the rod with edges of ``rest_length`` (E,)."""
        along = rest_places(rest_length)
        return np.stack([legendre.legval(along, coefficients) if len(coefficients) else 0.0 * along
                         for coefficients in self.rest], axis=-1)


def rest_places(rest_length: np.ndarray) -> np.ndarray:
    """(E − 1,) where the inner vertices are along a rod, from −1 to 1."""
    return 2.0 * np.cumsum(rest_length)[:-1] / np.sum(rest_length) - 1.0


def save_form(theta: MotionTheta) -> dict:
    """What a file holds of Θ."""
    return {key: getattr(theta, name) for name, key in FILE_KEYS.items()} | {
        "twist_mm3": theta.bend * theta.twist_ratio, "weight": 1.0, "rest_curvature_modes_per_mm": theta.rest,
        "rest_curvature_per_mm": theta.rest_curvature, "rest_length_mm": theta.rest_length,
        "roll_reference": theta.reference, "up": theta.up, "friction": theta.friction}


@typed
def load_theta(path: str | Path) -> MotionTheta:
    """Θ of a JSON file that ``doo-ti identify`` has written. Raises InputError for files that cannot be read, missing keys and
    values that no rod has."""
    try:
        content = json.loads(read_content(Path(path), MOST_TEXT_BYTES, "name a file that doo-ti identify has written"))
        if not isinstance(content, dict):
            raise ValueError("no object")
    except (ValueError, RecursionError) as error:
        raise InputError(path, "file", f"not JSON ({str(error).splitlines()[0]})",
                         "name a file that doo-ti identify has written; copy EI and GJ of refine to --EI and --GJ") from None
    stated = checked(path, "", content, _File)
    modes, reference = stated.rest_curvature_modes_per_mm, np.array(stated.roll_reference)
    if len(modes[0]) != len(modes[1]):
        raise InputError(path, "rest_curvature_modes_per_mm", f"{len(modes[0])} and {len(modes[1])} numbers",
                         "give as many for both directions")
    if not np.linalg.norm(reference) > 0:
        raise InputError(path, "roll_reference", "no direction", "give three numbers, not all zero")
    return MotionTheta(**{name: getattr(stated, key) for name, key in FILE_KEYS.items()}, rest=np.array(modes),
                       rest_length=np.array(stated.rest_length_mm), reference=reference,
                       up=unit_up(stated.up, str(path)), friction=stated.friction)


def simulated(thetas: list[MotionTheta]) -> tuple[Material, Dynamics]:
    """The rows of several Θ for :func:`doo_ti.dynamics.simulate.simulate`."""
    def column(name):
        return np.array([getattr(theta, name) for theta in thetas])
    bend, own = column("bend"), 1.0 - column("marker_share")
    rest = np.stack([theta.rest_curvature for theta in thetas])
    length = thetas[0].rest_length.sum()
    marker = column("marker_share") / own * length / (len(thetas[0].rest_length) + 1)
    material = Material(bend, bend * column("twist_ratio"), own, rest)
    dynamics = Dynamics(bend_damping=column("bend_damping"), twist_damping=column("bend_damping"), drag=column("drag") / own,
                        quadratic_drag=column("quadratic_drag") / own, point_mass=marker)
    return material, dynamics


class Unknowns:
    """Θ as a vector p: log α, and the others in units in which a tenth is a small change.

    lower, upper  (P,) bounds of p
    """

    UNITS = {"bend_damping": "s", "drag": "1/s", "quadratic_drag": "1/mm", "marker_share": "", "twist_ratio": "",
             "friction": ""}
    SIZES = {"bend_damping": 0.03, "drag": 0.3, "quadratic_drag": 1e-4, "marker_share": 0.3, "twist_ratio": 1.0,
             "friction": 0.3}
    """The change of a parameter for a change of one in its entry of p."""
    CURVATURE = 1e-3  # the same for the coefficients of the rest curvature, 1/mm

    def __init__(self, begin: MotionTheta, modes: int, fitted: tuple[str, ...]):
        self.begin, self.modes, self.fitted = begin, modes, tuple(fitted)
        unbounded = 2 * modes
        self.lower = np.array([-np.inf, *[0.02 if name == "twist_ratio" else 0.0 for name in fitted], *[-np.inf] * unbounded])
        self.upper = np.array([np.inf, *[3.0 if name == "marker_share" else np.inf for name in fitted], *[np.inf] * unbounded])

    @property
    def names(self) -> list[str]:
        """The names of the entries of p."""
        rest = (f"rest_curvature_{1 + k // self.modes}_{k % self.modes}" for k in range(2 * self.modes))
        return ["bend", *self.fitted, *rest]

    def vector(self, theta: MotionTheta) -> np.ndarray:
        """(P,) p of Θ."""
        rest = np.zeros((2, self.modes))
        common = min(self.modes, theta.rest.shape[1])
        rest[:, :common] = theta.rest[:, :common]
        return np.array([np.log(theta.bend), *(getattr(theta, name) / self.SIZES[name] for name in self.fitted),
                         *(rest / self.CURVATURE).ravel()])

    def theta(self, p: np.ndarray) -> MotionTheta:
        """Θ of p."""
        values = {name: float(self.SIZES[name] * entry) for name, entry in zip(self.fitted, p[1:], strict=False)}
        rest = p[1 + len(self.fitted) :].reshape(2, self.modes) * self.CURVATURE
        return replace(self.begin, bend=float(np.exp(p[0])), rest=rest, **values)

    def intervals(self, p: np.ndarray, covariance: np.ndarray, freedom: int) -> list[dict]:
        """Name, value, 95 % interval (``low`` None where it ends at a bound) and unit of every parameter; ``freedom``: one less
        than the recordings that ``covariance`` is from."""
        deviation = stdtrit(max(freedom, 1), 0.975) * np.sqrt(np.diag(covariance))
        rows = []
        for k, name in enumerate(self.names):
            size = self.SIZES.get(name, self.CURVATURE)
            value, low, high = p[k], p[k] - deviation[k], p[k] + deviation[k]
            bounded = low <= self.lower[k]
            if name == "bend":
                value, low, high = np.exp([value, low, high])
                size = 1.0
            rows.append({"name": name, "value": value * size, "low": None if bounded else low * size, "high": high * size,
                         "unit": "mm³" if name == "bend" else self.UNITS.get(name, "1/mm")})
        return rows


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

    def linearised(self, theta: MotionTheta, unknowns: Unknowns, variance: float) -> "LinearStills":
        """The stills near Θ, weighted against recordings of that ``variance``, mm²."""
        solution = self.rested(theta)
        apart, used = self.residuals(solution)
        weight = variance / self.variance(apart, used)
        root = np.sqrt(weight)
        error = np.where(used, np.linalg.norm(apart, axis=-1).sum(axis=1) / self.observations.valid.sum(axis=1), np.nan)
        return LinearStills(self, weight, root * apart, root * self.slopes(theta, solution, unknowns), used, error)

    def variance(self, apart: np.ndarray, used: np.ndarray) -> float:
        """mm², of the noise of a coordinate: as the observations state it, else as the residuals ``apart`` have it."""
        if self.observations.sigma is not None:
            return float(np.mean(np.square(self.observations.sigma)))
        seen = apart[used][self.observations.valid[used]]
        return max(float(np.mean(seen**2)), 1e-12) if len(seen) else np.inf


@dataclass(frozen=True)
class LinearStills:
    """Stills near some p: residuals (D, V, 3) and slopes (D, P, V, 3) times the root of their ``weight``, of the rods that are
    ``used`` (D,); error (D,) mm."""

    stills: Stills
    weight: float
    residual: np.ndarray
    slopes: np.ndarray
    used: np.ndarray
    error: np.ndarray


def _rolled(observations: Observations, reference: np.ndarray) -> np.ndarray:
    """(D, 3, 3) frames of the first edges with m1 towards ``reference``."""
    first = unit_vectors(observations.vertices[:, 1] - observations.vertices[:, 0])
    across = np.linalg.norm(np.cross(unit_vectors(reference), first), axis=-1)
    if not (observations.valid[:, :2].all() and (across >= LEAST_ACROSS).all()):
        raise InputError(observations.source, "start_frame", "missing, and the first edge was not seen, or points along the "
                         "roll reference", "give start_frame")
    return bishop_frames(first[:, None], np.broadcast_to(reference, first.shape))[:, 0]
