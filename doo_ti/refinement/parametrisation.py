"""Θ as unknowns without bounds: logarithms of what is positive, so that no step leaves the materials there are.

    bend                      ln α of B = αI
    bend_1, bend_2            ln B₁₁, ln B₂₂; the correlation B₁₂/√(B₁₁B₂₂) stays
    bend_12                   artanh of that correlation, so that B stays positive definite
    twist, weight             ln β, ln μ
    rest_curvature            its two components, 1/mm
    rest_curvature_per_joint  2 (E−1) components, 1/mm, held together by a prior
    up                        two tilts from where up was, rad

The prior on the rest curvature of joints is a stationary process along the rod, each component for itself: of standard
deviation d at any one place, its correlation falling as exp(−distance/range).
"""

from dataclasses import dataclass, replace

import numpy as np

from doo_ti.errors import InputError
from doo_ti.frames import matrix_from_quaternion, quaternion_about
from doo_ti.refinement.sensitivity import tilt_axes
from doo_ti.types import Material

UNKNOWNS = ("bend", "bend_1", "bend_2", "bend_12", "twist", "weight", "rest_curvature", "rest_curvature_per_joint", "up")
LOGARITHMIC = ("bend", "bend_1", "bend_2", "twist", "weight")


@dataclass(frozen=True)
class Theta:
    """One material and the direction of gravity.

    bend (2, 2) mm³, twist mm³, weight μ, rest_curvature None, (2,) or (E−1, 2) in 1/mm, up (3,) unit vector
    """

    bend: np.ndarray
    twist: float
    weight: float = 1.0
    rest_curvature: np.ndarray | None = None
    up: np.ndarray = (0.0, 0.0, 1.0)

    def __post_init__(self):
        for name in ("bend", "rest_curvature", "up"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, np.array(getattr(self, name), dtype=np.float64))

    @classmethod
    def of(cls, material: Material, row: int = 0, up=(0.0, 0.0, 1.0)) -> "Theta":
        """Row ``row`` of a table of materials that are the same all along the rod, but for their rest curvature.

        Raises InputError for others.
        """
        if material.bend.shape[1] > 1 or material.twist.shape[1] > 1:
            raise InputError("refine", "material", "bend or twist vary along the rod", "give one value for the whole rod")
        rest = material.rest_curvature
        rest = None if rest is None else rest[row, 0] if rest.shape[1] == 1 else rest[row]
        return cls(material.bend[row, 0], float(material.twist[row, 0]), float(material.weight[row]), rest, np.asarray(up))

    @property
    def material(self) -> Material:
        """The table of this one material."""
        rest = self.rest_curvature
        return Material(self.bend, self.twist, self.weight, None if rest is None else rest[None])


@dataclass(frozen=True)
class Parametrisation:
    """The unknowns of one fit.

    parameters       from UNKNOWNS
    rest_length      (E,) mm
    curvature_spread d of the prior on rest_curvature_per_joint, 1/mm
    curvature_range  its range, mm

    Raises InputError for parameters that are unknown, repeated or contradict each other.
    """

    parameters: tuple[str, ...]
    rest_length: np.ndarray
    curvature_spread: float
    curvature_range: float

    def __post_init__(self):
        names = self.parameters
        for name in names:
            if name not in UNKNOWNS:
                raise InputError("refine", "parameters", f"{name!r} is unknown", f"use {', '.join(UNKNOWNS)}")
        pairs = [("bend", other) for other in ("bend_1", "bend_2", "bend_12")]
        for one, other in [*pairs, ("rest_curvature", "rest_curvature_per_joint")]:
            if one in names and other in names:
                raise InputError("refine", "parameters", f"{one} beside {other}", "give one of them")
        if not names or len(set(names)) < len(names):
            raise InputError("refine", "parameters", f"{', '.join(names) or 'none'}", "give each parameter once")

    @property
    def length(self) -> float:
        """mm."""
        return float(self.rest_length.sum())

    @property
    def names(self) -> tuple[str, ...]:
        """(P,) of the unknowns."""
        joints = len(self.rest_length) - 1
        counts = {"rest_curvature": 2, "rest_curvature_per_joint": 2 * joints, "up": 2}
        return tuple(name if name not in counts else f"{name}[{k}]"
                     for name in self.parameters for k in range(counts.get(name, 1)))

    @property
    def scale(self) -> np.ndarray:
        """(P,) a change of each unknown that changes much: a factor e, a curvature of one radian in all, a radian of tilt."""
        return np.array([1 / self.length if name.startswith("rest") else 1.0 for name in self.names])

    def begun(self, theta: Theta, turn: float = 0.0) -> Theta:
        """``theta`` in the form that the unknowns need; ``turn`` in rad is the whole rod's rest curvature if it has none.

        Raises InputError where ``theta`` does not fit the unknowns.
        """
        first, second, mixed = theta.bend[0, 0], theta.bend[1, 1], theta.bend[0, 1]
        if "bend" in self.parameters and (first != second or mixed != 0):
            raise InputError("refine", "parameters", "bend of a rod that is not round", "give bend_1 and bend_2")
        if "weight" in self.parameters and not theta.weight > 0:
            raise InputError("refine", "weight", f"{theta.weight:g} has no logarithm", "give a positive weight")
        rest = theta.rest_curvature
        joints = len(self.rest_length) - 1
        if {"rest_curvature", "rest_curvature_per_joint"} & set(self.parameters):
            rest = np.array([turn / self.length, 0.0]) if rest is None else rest
            if "rest_curvature_per_joint" in self.parameters:
                rest = np.array(np.broadcast_to(rest, (joints, 2)))
            elif rest.ndim > 1:
                raise InputError("refine", "rest_curvature", "varies from joint to joint", "give rest_curvature_per_joint")
        return replace(theta, rest_curvature=rest)

    def moved(self, theta: Theta, step: np.ndarray) -> Theta:
        """``theta`` with the unknowns changed by ``step`` (P,)."""
        of = {name: step[self._columns(name)] for name in self.parameters}
        none = np.zeros(2)
        root = np.sqrt(np.diag(theta.bend))
        correlation = np.tanh(np.arctanh(theta.bend[0, 1] / root.prod()) + of.get("bend_12", none)[0])
        both = of.get("bend", none)[0]
        root = root * np.exp(0.5 * np.array([of.get(name, none)[0] + both for name in ("bend_1", "bend_2")]))
        rest = theta.rest_curvature
        for name in ("rest_curvature", "rest_curvature_per_joint"):
            if name in of:
                rest = rest + of[name].reshape(rest.shape)
        up = theta.up
        if "up" in of:
            turn = of["up"] @ tilt_axes(up)
            angle = np.linalg.norm(turn)
            up = matrix_from_quaternion(quaternion_about(turn / max(angle, 1e-300), angle)) @ up
        return Theta(np.diag(root**2) + correlation * root.prod() * (1 - np.eye(2)),
                     theta.twist * float(np.exp(of.get("twist", none)[0])),
                     theta.weight * float(np.exp(of.get("weight", none)[0])), rest, up / np.linalg.norm(up))

    def tilt(self, origin: Theta, theta: Theta) -> np.ndarray:
        """(2,) the step of ``up`` that leads from one Θ to the other."""
        turn = np.cross(origin.up, theta.up)
        sine = np.linalg.norm(turn)
        return tilt_axes(origin.up) @ turn * (np.arctan2(sine, origin.up @ theta.up) / max(sine, 1e-300))

    def chain(self, theta: Theta) -> tuple[tuple[str, ...], np.ndarray]:
        """The parameters of :func:`doo_ti.refinement.sensitivity.sensitivity` to differentiate by, and the derivatives (Q, P)
        of their Q columns by the unknowns."""
        elementary = [name for name in self.parameters if name not in ("bend_1", "bend_2", "bend_12")]
        entries = ("bend_1", "bend_2", "bend_12")
        if len(elementary) < len(self.parameters):
            elementary += entries
        rows, matrix = 0, np.zeros((len(self.names) + len(entries), len(self.names)))
        for name in elementary:
            if name in entries:
                for unknown in set(entries) & set(self.parameters):
                    matrix[rows, self._columns(unknown)] = _bend_entry(name, unknown, theta.bend)
                rows += 1
                continue
            columns = self._columns(name)
            value = {"bend": theta.bend[0, 0], "twist": theta.twist, "weight": theta.weight}.get(name, 1.0)
            count = columns.stop - columns.start
            matrix[rows : rows + count, columns] = value * np.eye(count)
            rows += count
        return tuple(elementary), matrix[:rows]

    def prior(self, theta: Theta) -> tuple[float, np.ndarray, np.ndarray]:
        """−2 ln of the prior but for a constant, half its gradient (P,) and half its Hessian (P, P)."""
        count = len(self.names)
        half = np.zeros((count, count))
        if "rest_curvature_per_joint" not in self.parameters:
            return 0.0, np.zeros(count), half
        columns = self._columns("rest_curvature_per_joint")
        half[columns, columns] = np.kron(self._precision(), np.eye(2))
        curvature = theta.rest_curvature.ravel()
        slope = np.zeros(count)
        slope[columns] = half[columns, columns] @ curvature
        return float(curvature @ slope[columns]), slope, half

    def _columns(self, name: str) -> slice:
        """Where the unknowns of a parameter stand."""
        own = [k for k, unknown in enumerate(self.names) if unknown == name or unknown.startswith(f"{name}[")]
        return slice(own[0], own[-1] + 1)

    def _precision(self) -> np.ndarray:
        """(E−1, E−1) inverse covariance of the prior's process at the joints, which is Markov: tridiagonal."""
        apart = self.rest_length[1:-1]  # from joint to joint
        kept = np.exp(-apart / self.curvature_range)
        link = np.array([[kept**2, -kept], [-kept, np.ones_like(kept)]]) / (1 - kept**2)
        precision = np.zeros((len(apart) + 1,) * 2)
        precision[0, 0] = 1.0
        joints = np.arange(len(apart))
        for a in range(2):
            for b in range(2):
                precision[joints + a, joints + b] += link[a, b]
        return precision / self.curvature_spread**2


def _bend_entry(entry: str, unknown: str, bend: np.ndarray) -> float:
    """Derivative of an entry of B by one of its unknowns."""
    first, second, mixed = bend[0, 0], bend[1, 1], bend[0, 1]
    if unknown == "bend_12":
        root = np.sqrt(first * second)
        return root - mixed**2 / root if entry == "bend_12" else 0.0
    if entry == "bend_12":
        return 0.5 * mixed
    return {"bend_1": first, "bend_2": second}[entry] if entry == unknown else 0.0
