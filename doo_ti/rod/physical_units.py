"""Physical units beside those of the package (footnote 6), and numbers that may be right but are hardly in the unit that was
asked for: metres for mm, degrees for radians.

In the continuum bend α is EI, twist β is GJ and the weight per length w is 2 μ (PAPER.md): shapes determine EI/w = α/(2 μ) in
mm³ and no more. The weight per length, or a linear density ρ with w = ρ g, gives the rest:

    EI = α w/(2 μ),   GJ = β w/(2 μ),   force = end_force · w/(2 μ).

The library warns of implausible numbers (``warnings``, at the caller's line), the commands print the same words.
"""

import sys
import warnings
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from doo_ti.system.errors import InputError

UNITS_IN_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0}
"""mm in one unit of length, by its name on the command line."""
STANDARD_GRAVITY = 9.80665
"""m/s²."""


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


LEAST_MM, MOST_MM = 10.0, 20_000.0
"""Lengths of rods that raise no doubt about the unit."""
LEAST_NEWTON, MOST_NEWTON = 1e-6, 1e3
"""N/m: the finest suture weighs 1e-5, a steel bar 40 mm thick 100."""
LEAST_RISE_MM, MOST_RISE_MM = 0.1, 1e5
"""(EI/w)^(1/3), the length over which its weight bends a rod: 10 mm of a hair, 6 m of that bar."""
NEAR = 0.02
"""Distance of neighbouring marks over the rod between them, below which they are hardly in mm."""
LEAST_IN_DEGREES = 10.0
"""Of an angle's number, from which on a whole one is more likely in degrees."""
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


def doubt_marks(source: str, field: str, marks: np.ndarray, edge: float) -> None:
    """Warn of ``marks`` (R, V, 3) in mm, NaN where not seen, of rods with edges of length ``edge``, that are all far nearer to
    each other than along the rod: in another unit."""
    apart = np.linalg.norm(np.diff(marks, axis=1), axis=-1) / edge
    if np.isfinite(apart).any() and np.nanmax(apart) < NEAR:
        _warn(source, field, f"marks are {np.nanmax(apart) * edge:.3g} mm apart at most on a rod with edges of {edge:.3g} mm",
              "give mm")


def doubt_angle(source: str, field: str, angle: ArrayLike | None) -> None:
    """Warn of an ``angle`` in rad that is more likely in degrees: a whole number, and not small."""
    if angle is None or not np.size(angle):
        return
    angles = np.asarray(angle, dtype=np.float64)
    most = angles.flat[np.argmax(np.abs(angles))]
    if LEAST_IN_DEGREES <= abs(most) < np.inf and (angles == np.round(angles)).all():
        _warn(source, field, f"{most:g} rad are {most / (2 * np.pi):.3g} turns", f"give radians; {most:g} degrees are "
              f"{np.radians(most):.4g}")


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
              "give EI in N m², which is 1e-6 N mm², and N/m")


def _warn(source: str, field: str, problem: str, remedy: str) -> None:
    """Warn at the line outside of this package that led here."""
    level, frame = 2, sys._getframe(1)
    while frame is not None and frame.f_code.co_filename.startswith(_OURS):
        level, frame = level + 1, frame.f_back
    warnings.warn(f"{source}: {field}: {problem}; {remedy}", UserWarning, stacklevel=level)
