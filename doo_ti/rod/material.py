"""Θ = (B, β, μ) of §III-C, the material of rods, as NumPy arrays (R rods, E edges); physical units beside those of the package
(footnote 6); and numbers that may be right but are hardly in the unit that was asked for: metres for mm, degrees for radians.

In the continuum bend α is EI, twist β is GJ and the weight per length w is 2 μ (PAPER.md): shapes determine EI/w = α/(2 μ) in
mm³ and no more. The weight per length, or a linear density ρ with w = ρ g, gives the rest:

    EI = α w/(2 μ),   GJ = β w/(2 μ),   force = end_force · w/(2 μ).

The library warns of implausible numbers (``warnings``, at the caller's line), the commands print the same words.
"""

import sys
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from doo_ti.system.arguments import counted, span_text, typed
from doo_ti.system.errors import InputError, real_array

Rows = ArrayLike | slice  # row numbers, flags or a slice

LARGEST = 1e30  # upper bound of all inputs: squares of larger numbers overflow in f32 or f64 arithmetic


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
        count = _rows("bend, twist, weight", *(value for value in values.values() if value is not None))
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
        _rows("bend_1, bend_2", first, second)
        first, second = np.broadcast_arrays(first, second)
        return cls(first[:, None, None] * np.diag([1.0, 0.0]) + second[:, None, None] * np.diag([0.0, 1.0]), twist, weight)

    @classmethod
    @typed
    def from_physical(cls, EI: ArrayLike, GJ: ArrayLike, weight_per_length: ArrayLike) -> "Material":  # noqa: N803
        """The round rods of stiffness EI and GJ in N m² that weigh ``weight_per_length`` in N/m, scalars or (R,); μ is 1.
        Forces and moments of these rods come out in N and N m (:func:`doo_ti.relaxation.sensitivity.end_loads`). A ribbon:
        ``Material(2e9 / w * np.diag([EI_1, EI_2]), 2e9 / w * GJ, weight_per_length=w)``.

        Raises InputError as the class does, and for a rod without weight, which has no stiffness relative to it.
        """
        weight = _positive("weight_per_length", weight_per_length, " N/m",
                           "give N/m; for a rod without weight give Material(bend, twist, weight=0)")
        bend, twist = (_positive(name, value, " N m²", "give N m²") for name, value in (("EI", EI), ("GJ", GJ)))
        _rows("EI, GJ, weight_per_length", bend, twist, weight)
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
        bend, twist = (span_text(value, "mm³") + (" along the rod" if np.ptp(value, axis=1).any() else "")
                       for value in (self.bend[..., [0, 1], [0, 1]], self.twist))
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


def _rows(name: str, *values: np.ndarray) -> int:
    """R of ``values`` with one row or R each. Raises InputError for other numbers of rows, and for none."""
    rows = {len(value) for value in values}
    if len(rows - {1}) > 1 or 0 in rows:
        raise InputError("material", name, f"{', '.join(map(str, sorted(rows)))} rows", "give one value or one per rod")
    return max(rows)


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


# --- physical units ------------------------------------------------------------------------------------------------------

UNITS_IN_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4}  # mm in one unit of length, by its name on the command line
STANDARD_GRAVITY = 9.80665  # m/s²


def mm_in(unit: str, source: str) -> float:
    """mm in one ``unit`` that a user names. Raises InputError, of ``source``, for one that is not known."""
    if unit not in UNITS_IN_MM:
        raise InputError(source, "unit", f"{unit!r}", f"give one of {', '.join(UNITS_IN_MM)}")
    return UNITS_IN_MM[unit]


def weight_per_length(linear_density: float) -> float:
    """w in N/m of a rod of ``linear_density`` g/m."""
    return 1e-3 * linear_density * STANDARD_GRAVITY


def relative_stiffness(value, weight):
    """EI/w or GJ/w in mm³ from bend or twist (mm³) and the weight μ they are relative to."""
    return np.asarray(value) / (2.0 * np.asarray(weight))


def stiffness(over_weight: float, linear_density: float) -> float:
    """EI or GJ in N m² from EI/w or GJ/w in mm³ and the linear density in g/m."""
    return over_weight * weight_per_length(linear_density) * 1e-9


def bend_or_twist(stiffness, weight_per_length):
    """α or β in mm³, relative to μ = 1, from EI or GJ in N m² and the weight per length in N/m."""
    return 2e9 * np.asarray(stiffness) / np.asarray(weight_per_length)


def force_in_newton(force, weight_per_length, weight=1.0):
    """N from a force in the units of the package, mm² of energy per mm, of a rod of weight μ and w in N/m."""
    return np.asarray(force) * (1e-3 * np.asarray(weight_per_length) / (2.0 * np.asarray(weight)))


LEAST_MM, MOST_MM = 10.0, 20_000.0  # lengths of rods that raise no doubt about the unit
LEAST_NEWTON, MOST_NEWTON = 1e-6, 1e3  # N/m: the finest suture weighs 1e-5, a steel bar 40 mm thick 100
LEAST_RISE_MM, MOST_RISE_MM = 0.1, 1e5
"""(EI/w)^(1/3), the length over which its weight bends a rod: 10 mm of a hair, 6 m of that bar."""
MOST_STIFF = 3e6
"""4 π EI over the square of the mass per length, E/ρ² of a solid round rod in SI: 3e3 of steel, 1.5e5 of carbon fibre, and of a
tube of it with walls of a tenth of its radius ten times as much."""
LEAST_SLENDER, MOST_SLENDER = 3.0, 1500.0  # length over the diameter of a solid rod as dense as water
NEAR = 0.15  # distance of marks that follow each other over the rod between them, below which they are hardly in mm
FOLLOWING = 0.25  # of a rod: marks farther apart along it may be near each other
LEAST_IN_DEGREES = 10.0  # of an angle's number, from which on a whole one is more likely in degrees
_OURS = str(Path(__file__).parents[1]), "<string>"
"""What names of source files begin with; the second one is of constructors that dataclass makes."""


def likely_unit(length: float) -> str | None:
    """"" for a rod's plausible length in mm, the unit that it is more likely in, or None where no unit helps."""
    units = ("mm", "m", "cm")
    likely = next((unit for unit in units if LEAST_MM <= length * UNITS_IN_MM[unit] <= MOST_MM), None)
    return "" if likely == "mm" else likely


def doubt_length(source: str, length: ArrayLike) -> None:
    """Warn of rods whose ``length`` in mm is implausible."""
    for value in np.unique(np.asarray(length, dtype=np.float64)):
        unit = likely_unit(value)
        if unit != "":
            remedy = "give mm" if unit is None else f"give mm; {value:g} {unit} are {value * UNITS_IN_MM[unit]:g}"
            return _warn(source, "length", f"a rod {value:.4g} mm long", remedy)


def doubt_marks(source: str, field: str, marks: np.ndarray, rest_length: np.ndarray) -> None:
    """Warn of ``marks`` (R, V, 3) in mm, NaN where not seen, of rods with those edges (E,), that are all far nearer to each
    other than along the rod: in another unit."""
    share, _ = shares_of_rod(marks, rest_length)
    if len(share) and share.max() < NEAR:
        _warn(source, field, f"marks are {share.max():.2g} times as far apart as along a rod of {rest_length.sum():.4g} mm",
              "give mm")


def shares_of_rod(marks: np.ndarray, rest_length: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n,) distances of ``marks`` (R, V, 3) that follow each other on the same rod, without those that are NaN, over the length
    of rod between them, of edges ``rest_length`` (E,); and (n,) between how many edges. Marks that are FOLLOWING of the rod
    apart or more do not count."""
    rod, vertex = np.nonzero(np.isfinite(marks).all(axis=-1))
    place = np.concatenate([[0.0], np.cumsum(rest_length)])
    along, edges = np.diff(place[vertex]), np.diff(vertex)
    counts = (np.diff(rod) == 0) & (along > 0) & ((edges == 1) | (along < FOLLOWING * place[-1]))
    apart = np.linalg.norm(np.diff(marks[rod, vertex], axis=0), axis=-1)
    return apart[counts] / along[counts], edges[counts]


def doubt_angle(source: str, field: str, angle: ArrayLike | None) -> None:
    """Warn of an ``angle`` in rad that is more likely in degrees: a whole number, and not small."""
    if angle is None or not np.size(angle):
        return
    angles = np.asarray(angle, dtype=np.float64)
    most = angles.flat[np.argmax(np.abs(angles))]
    if LEAST_IN_DEGREES <= abs(most) < np.inf and (angles == np.round(angles)).all():
        _warn(source, field, f"{most:g} rad are {most / (2 * np.pi):.3g} turns", f"give radians; {most:g} degrees are "
              f"{np.radians(most):.4g}")


def density_doubt(length: float, weight: ArrayLike | None) -> str | None:
    """Why rods ``length`` mm long may not weigh that ``weight`` in N/m, or None."""
    for density in () if weight is None else np.ravel(weight)[np.ravel(weight) > 0] * 1e3 / STANDARD_GRAVITY:
        thick = np.sqrt(4 * density / np.pi)  # 1 g/m of water is 1 mm²
        if not LEAST_SLENDER <= length / thick <= MOST_SLENDER:
            return (f"a rod {length:.4g} mm long of {density:.3g} g/m is {thick:.2g} mm thick if as dense as water; give g/m, "
                    "which is kg/m times 1000")
    return None


def stiffness_doubt(stiffness: ArrayLike | None, weight: ArrayLike | None) -> str | None:
    """Why rods of that ``weight`` in N/m may not be as stiff as EI, ``stiffness`` in N m², or None."""
    if stiffness is None or weight is None:
        return None
    density = np.asarray(weight) / STANDARD_GRAVITY  # kg/m
    ratio, stiff, grams = np.broadcast_arrays(4 * np.pi * np.asarray(stiffness) / density**2, stiffness, 1e3 * density)
    worst = np.argmax(ratio)
    if not ratio.flat[worst] > MOST_STIFF:
        return None
    return (f"EI of {stiff.flat[worst]:g} N m² at {grams.flat[worst]:.3g} g/m, stiffer than any material; give EI in N m², "
            "of which one is 1e6 N mm², and g/m")


def doubt_weight(source: str, stiffness: np.ndarray, weight: np.ndarray) -> None:
    """Warn of rods of that ``stiffness`` EI in N m² whose ``weight`` in N/m is implausible, or beside the other."""
    rise = np.cbrt(1e9 * stiffness / weight)
    light, heavy = weight.min(), weight.max()
    if light < LEAST_NEWTON or heavy > MOST_NEWTON:
        _warn(source, "weight_per_length", f"{light if light < LEAST_NEWTON else heavy:g} N/m",
              "give N/m: kg/m times 9.80665, or g/m times 0.00980665")
    elif rise.min() < LEAST_RISE_MM or rise.max() > MOST_RISE_MM:
        short = rise.min() < LEAST_RISE_MM
        _warn(source, "EI, weight_per_length", f"a rod that its weight bends over {rise.min() if short else rise.max():.3g} mm",
              "give EI in N m², of which one is 1e6 N mm², and N/m")


def _warn(source: str, field: str, problem: str, remedy: str) -> None:
    """Warn at the line outside of this package that led here."""
    level, frame = 2, sys._getframe(1)
    while frame is not None and frame.f_code.co_filename.startswith(_OURS):
        level, frame = level + 1, frame.f_back
    warnings.warn(f"{source}: {field}: {problem}; {remedy}", UserWarning, stacklevel=level)
