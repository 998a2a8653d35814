"""Θ = (B, β, μ) of §III-C, the material of rods, as NumPy arrays. Axes: R rods, E edges."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from doo_ti.rod.physical_units import bend_or_twist, doubt_weight, force_in_newton
from doo_ti.system.arguments import typed
from doo_ti.system.errors import InputError, real_array
from doo_ti.system.short_repr import counted, span_text

Rows = ArrayLike | slice
"""Row numbers, flags or a slice."""

LARGEST = 1e30
"""Upper bound of all inputs: squares of larger numbers overflow in f32 or f64 arithmetic."""


@typed
@dataclass(frozen=True)
class Material:
    """Θ = (B, β, μ) of §III-C for R materials; scalars broadcast.

    bend            B in mm³: a scalar α (isotropic, B = αI) or (R,) of them; or symmetric positive definite matrices (2, 2),
                    (R, 2, 2) or, edge by edge, (R, E, 2, 2)
    twist           β in mm³: scalar, (R,), or per inner vertex (R, E−1)
    weight          μ: scalar or (R,); the weight per length of the rod is 2 μ
    rest_curvature  ω̄ in 1/mm, components (κb·m2, −κb·m1)/(l̄/2): None (straight at rest), (2,), (R, 2) or, per inner
                    vertex, (R, E−1, 2)
    weight_per_length  in N/m, scalar or (R,), where it is known: forces then come out in N and moments in N m

    After construction the arrays have the shapes (R, 1 or E, 2, 2), (R, 1 or E−1), (R,) and None or (R, 1 or E−1, 2), R being 1
    where everything broadcasts.

    Raises InputError for a B that is not symmetric positive definite, a β that is not positive, a negative μ, or shapes that
    do not match.
    """

    bend: np.ndarray
    twist: np.ndarray
    weight: np.ndarray = 1.0
    rest_curvature: np.ndarray | None = None
    weight_per_length: np.ndarray | None = None

    if TYPE_CHECKING:  # what it takes; the fields are the arrays that it makes of them
        def __init__(self, bend: ArrayLike, twist: ArrayLike, weight: ArrayLike = 1.0, rest_curvature: ArrayLike | None = None,
                     weight_per_length: ArrayLike | None = None) -> None: ...

    def __post_init__(self) -> None:
        bend = _finite("bend", self.bend)
        if bend.ndim <= 1:
            bend = _positive("bend", bend, " mm³", "give mm³")
            bend = bend.reshape(-1, 1, 1, 1) * np.eye(2)
        elif bend.ndim == 2:
            bend = bend[None, None]
        elif bend.ndim == 3:
            bend = bend[:, None]
        twist = _finite("twist", self.twist)
        twist = twist.reshape(-1, 1) if twist.ndim <= 1 else twist
        if twist.ndim != 2 or not twist.size:
            raise InputError("material", "twist", f"shape {twist.shape}", "give β, (R,) or (R, E-1)")
        weight = _per_rod("weight", self.weight)
        newton = None if self.weight_per_length is None else _per_rod("weight_per_length", self.weight_per_length)
        rest = self.rest_curvature
        if rest is not None:
            rest = _finite("rest_curvature", rest)
            rest = rest[None, None] if rest.ndim == 1 else rest[:, None] if rest.ndim == 2 else rest
            if rest.ndim != 3 or rest.shape[-1] != 2 or not rest.size:
                raise InputError("material", "rest_curvature", f"shape {rest.shape}", "give (2,), (R, 2) or (R, E-1, 2)")
        _check_bend(bend)
        if (twist <= 0).any():
            raise InputError("material", "twist", f"{twist.min():g} is not positive", "give a positive twist in mm³")
        if (weight < 0).any():
            raise InputError("material", "weight", f"{weight.min():g} is negative", "give zero or a positive weight")
        if newton is not None and not ((newton > 0).all() and (weight > 0).all()):
            raise InputError("material", "weight_per_length", "not positive, or given for a rod without weight",
                             "give N/m; for a rod without weight leave it out")
        values = {"bend": bend, "twist": twist, "weight": weight, "rest_curvature": rest, "weight_per_length": newton}
        lengths = [len(value) for value in values.values() if value is not None]
        count = max(lengths)
        if not all(lengths):
            raise InputError("material", "bend, twist, weight", "no rows", "give at least one material")
        if any(length not in (1, count) for length in lengths):
            raise InputError("material", "bend, twist, weight", "leading lengths differ", "give one value or one per rod")
        for name, value in values.items():
            if value is not None:
                value = np.array(np.broadcast_to(value, (count, *value.shape[1:])))
                value.setflags(write=False)
            object.__setattr__(self, name, value)

    @classmethod
    @typed
    def diagonal(cls, bend_1: ArrayLike, bend_2: ArrayLike, twist: ArrayLike, weight: ArrayLike = 1.0) -> "Material":
        """B = diag(bend_1, bend_2) along the material frame: bend_1 weighs bending about m2, bend_2 about m1."""
        first, second = (_positive(name, value, " mm³", "give mm³") for name, value in (("bend_1", bend_1), ("bend_2", bend_2)))
        if (len(first) != len(second) and 1 not in (len(first), len(second))):
            shapes = f"shapes {first.shape}, {second.shape}"
            raise InputError("material", "bend_1, bend_2", shapes, "give one value or one per rod")
        first, second = np.broadcast_arrays(first, second)
        return cls(first[:, None, None] * np.diag([1.0, 0.0]) + second[:, None, None] * np.diag([0.0, 1.0]), twist, weight)

    @classmethod
    @typed
    def from_physical(cls, EI: ArrayLike, GJ: ArrayLike, weight_per_length: ArrayLike) -> "Material":  # noqa: N803
        """The round rods of stiffness EI and GJ in N m² that weigh ``weight_per_length`` in N/m, scalars or (R,); μ is 1.
        Forces and moments of these rods come out in N and N m (:func:`doo_ti.relaxation.sensitivity.end_loads`).

        Raises InputError as the class does, and for a rod without weight, which has no stiffness relative to it.
        """
        weight = _positive("weight_per_length", weight_per_length, " N/m",
                           "give N/m; for a rod without weight give Material(bend, twist, weight=0)")
        bend, twist = (_positive(name, value, " N m²", "give N m²") for name, value in (("EI", EI), ("GJ", GJ)))
        rows = {len(value) for value in (bend, twist, weight)} - {1}
        if len(rows) > 1:
            raise InputError("material", "EI, GJ, weight_per_length", f"{sorted(rows)} rows", "give one value or one per rod")
        doubt_weight("Material.from_physical", bend, weight)
        return cls(bend_or_twist(bend, weight), bend_or_twist(twist, weight), weight_per_length=weight)

    @property
    def count(self) -> int:
        return len(self.weight)

    @property
    def newton(self) -> np.ndarray | None:
        """(R,) N that the rods' unit of force, mm² of energy per mm, is. None where their weight per length is not known."""
        return None if self.weight_per_length is None else force_in_newton(1.0, self.weight_per_length, self.weight)

    def with_unit(self, newton: np.ndarray) -> "Material":
        """The same material relative to other weights: its unit of force is ``newton`` (1 or R,) N. Needs a weight per
        length."""
        ratio = self.newton / newton
        return Material(self.bend * ratio[:, None, None, None], self.twist * ratio[:, None], self.weight * ratio,
                        self.rest_curvature, self.weight_per_length)

    def __repr__(self) -> str:
        bend, twist = (span_text(value, "mm³") for value in (self.bend[..., [0, 1], [0, 1]], self.twist))
        rest = "" if self.rest_curvature is None else f", rest curvature up to {np.abs(self.rest_curvature).max():.3g} 1/mm"
        newton = "" if self.weight_per_length is None else f", {span_text(self.weight_per_length, 'N/m')}"
        return (f"Material({counted(self.count, 'material')}: bend {bend}, twist {twist}, weight {span_text(self.weight)}"
                f"{rest}{newton})")

    def take(self, index: Rows) -> "Material":
        """The rows named by ``index``, in that order and as often."""
        rest, newton = (None if value is None else value[index] for value in (self.rest_curvature, self.weight_per_length))
        return Material(self.bend[index], self.twist[index], self.weight[index], rest, newton)

    @property
    def isotropic(self) -> np.ndarray:
        """(R,) bool: uniform B = αI and β along the rod, straight at rest: the case with the shorter formulas."""
        first = self.bend[:, :1, 0, 0]
        rows = ((self.bend[..., 0, 0] == first) & (self.bend[..., 1, 1] == first) & (self.bend[..., 0, 1] == 0)).all(axis=1)
        rows = rows & (self.twist == self.twist[:, :1]).all(axis=1)
        return rows if self.rest_curvature is None else rows & (self.rest_curvature == 0).all(axis=(1, 2))

    @property
    def is_isotropic(self) -> bool:
        """Whether all rows are isotropic."""
        return bool(self.isotropic.all())


def _finite(name: str, value) -> np.ndarray:
    array = real_array("material", name, value, "give real numbers").astype(np.float64)
    if not (np.abs(array) <= LARGEST).all():
        raise InputError("material", name, f"not finite, or beyond {LARGEST:g}", "give finite numbers")
    return array


def _per_rod(name: str, value) -> np.ndarray:
    array = _finite(name, value)
    if array.ndim > 1:
        raise InputError("material", name, f"shape {array.shape}", "give one value or (R,)")
    return np.atleast_1d(array)


def _positive(name: str, value, unit: str, remedy: str) -> np.ndarray:
    """``value`` as positive numbers, (1,) or (R,). Raises InputError."""
    array = _per_rod(name, value)
    if not array.size or not (array > 0).all():
        problem = f"{array.min():g}{unit} is not positive" if array.size else "no rows"
        raise InputError("material", name, problem, remedy)
    return array


def _check_bend(bend: np.ndarray) -> None:
    if not bend.size:
        raise InputError("material", "bend", "no rows", "give at least one material")
    if bend.ndim != 4 or bend.shape[-2:] != (2, 2):
        raise InputError("material", "bend", f"shape {bend.shape}", "give α, (R,), (2, 2), (R, 2, 2) or (R, E, 2, 2)")
    symmetric = np.abs(bend[..., 0, 1] - bend[..., 1, 0]) <= 1e-12 * np.abs(bend).max()
    definite = (bend[..., 0, 0] > 0) & (bend[..., 0, 0] * bend[..., 1, 1] > bend[..., 0, 1] * bend[..., 1, 0])
    if not (symmetric & definite).all():
        worst = f"{bend[~(symmetric & definite)][0].tolist()} is not symmetric positive definite"
        raise InputError("material", "bend", worst, "give A1 > 0, A2 > 0, |A12| < sqrt(A1*A2)")
