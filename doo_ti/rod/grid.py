"""Grids over Θ = (B, β, μ) for the exhaustive search of §III-E, and the range of each parameter near the minimum.

Axes: G grid cells. Bend and twist in mm³, weight relative (footnote 6).
"""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated

import numpy as np
from numpy.typing import ArrayLike

from doo_ti.rod.types import LARGEST, Material
from doo_ti.system.arguments import short_repr, typed
from doo_ti.system.errors import InputError

# Axis name: unit, in the order in which a grid's axes run.
UNITS = {"bend": "mm³", "bend_1": "mm³", "bend_2": "mm³", "twist": "mm³", "twist_ratio": "", "weight": ""}
SAME = ("bend", "bend_1"), ("bend", "bend_2"), ("twist", "twist_ratio")  # pairs of axes of which one stands for the other
MOST_VALUES = 1_000_000
_FORM = "give a number or LO:HI:N[:log|:lin], such as 5e4:1e7:25"


@typed
@dataclass(frozen=True)
class Axis:
    """One parameter's values: ``name`` from UNITS, ``values`` (n,) increasing, ``log`` if spaced by factors."""

    __repr__ = short_repr

    name: str
    values: Annotated[np.ndarray, "() | K"]
    log: bool = True

    if TYPE_CHECKING:  # what it takes; the field is the array that it makes of it
        def __init__(self, name: str, values: ArrayLike, log: bool = True) -> None: ...

    def __post_init__(self) -> None:
        values = np.atleast_1d(np.array(self.values, dtype=np.float64))
        values.setflags(write=False)
        object.__setattr__(self, "values", values)

    @property
    def unit(self) -> str:
        """``mm³``, or empty for a ratio."""
        return UNITS[self.name]

    @property
    def label(self) -> str:
        """Name and unit."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name

    def __len__(self) -> int:
        return len(self.values)


@typed
@dataclass(frozen=True)
class Grid:
    """The cells Θ of a search: every combination of the axes' values, in C order.

    axes     (bend | bend_1, bend_2), (twist | twist_ratio), weight, always in this order; twist_ratio and weight
             are put in with the single value 1 where they are left out. β = ratio · bend, or ratio · bend_1 where
             the rod is anisotropic.
    bend_12  the off-diagonal entry of B in mm³, one for all cells

    Raises InputError for unknown, contradicting or missing axes, values out of range, and B not positive definite.
    """

    axes: tuple[Axis, ...]
    bend_12: float = 0.0
    source: str = field(default="grid", compare=False)

    def __post_init__(self) -> None:
        axes = {axis.name: axis for axis in self.axes}
        _check_names(self.source, [axis.name for axis in self.axes])
        if "twist" not in axes and "twist_ratio" not in axes:
            axes["twist_ratio"] = Axis("twist_ratio", 1.0)
        axes.setdefault("weight", Axis("weight", 1.0))
        for axis in axes.values():
            _check_values(self.source, axis)
        object.__setattr__(self, "axes", tuple(axes[name] for name in UNITS if name in axes))
        # The smallest entries make the least definite B of the grid.
        first, second = self.axes[0].values[0], self.axes[0 if "bend" in axes else 1].values[0]
        if abs(self.bend_12) > LARGEST or self.bend_12**2 >= first * second:
            raise _indefinite(self.source, "bend", first, second, self.bend_12)

    @property
    def picture_axes(self) -> list[tuple]:
        """One (name, values, is_log, unit) per axis, as the pictures of :mod:`doo_ti.report` take them."""
        return [(axis.name, axis.values, axis.log, axis.unit) for axis in self.axes]

    @property
    def shape(self) -> tuple[int, ...]:
        """The number of values of each axis."""
        return tuple(len(axis) for axis in self.axes)

    @property
    def size(self) -> int:
        """G, the number of cells."""
        return int(np.prod(self.shape))

    @property
    def varying(self) -> tuple[Axis, ...]:
        """The axes with more than one value."""
        return tuple(axis for axis in self.axes if len(axis) > 1)

    @property
    def is_isotropic(self) -> bool:
        return self.bend_12 == 0 and self.axes[0].name == "bend"

    def cell_values(self, cells: np.ndarray | slice = slice(None)) -> dict[str, np.ndarray]:
        """(G,) values of bend_1, bend_2, twist and weight, or only those of the ``cells`` named by index or slice."""
        if isinstance(cells, slice):
            cells = np.arange(*cells.indices(self.size))
        given = {axis.name: axis.values[place] for axis, place in zip(self.axes, np.unravel_index(cells, self.shape))}
        bend_1 = given.get("bend", given.get("bend_1"))
        bend_2 = given.get("bend", given.get("bend_2"))
        twist = given["twist"] if "twist" in given else given["twist_ratio"] * bend_1
        return {"bend_1": bend_1, "bend_2": bend_2, "twist": twist, "weight": given["weight"]}

    def cells_of(self, values: dict[str, np.ndarray]) -> np.ndarray:
        """(n,) the cells that hold ``values`` (n,) of bend_1, bend_2, twist and weight; −1 where none does."""
        places = []
        for axis in self.axes:
            wanted, borders = values.get("bend_1" if axis.name == "bend" else axis.name), axis.values[1:]
            if axis.name == "twist_ratio":  # the quotient is rounded: the nearest ratio is meant
                with np.errstate(divide="ignore", invalid="ignore"):
                    wanted, borders = values["twist"] / values["bend_1"], 0.5 * (axis.values[1:] + axis.values[:-1])
            places.append(np.searchsorted(borders, wanted, side="right"))
        cells = np.ravel_multi_index(places, self.shape)
        same = [values[name] == own for name, own in self.cell_values(cells).items()]
        return np.where(np.all(same, axis=0), cells, -1)

    def materials(self, cells: np.ndarray | slice = slice(None)) -> Material:
        """The table of G materials, one per cell in C order, or only those of ``cells``: a chunk of a large grid."""
        values = self.cell_values(cells)
        if self.is_isotropic:
            return Material(values["bend_1"], values["twist"], values["weight"])
        bend = np.full((len(values["weight"]), 2, 2), self.bend_12)
        bend[:, 0, 0], bend[:, 1, 1] = values["bend_1"], values["bend_2"]
        return Material(bend, values["twist"], values["weight"])

    def with_axes(self, axes: tuple[Axis, ...], bend_12: float = 0.0) -> "Grid":
        """This grid with ``axes`` in place of its own of the same parameters, and ``bend_12`` where they give bend.

        ``bend`` replaces ``bend_1`` and ``bend_2``, ``twist`` replaces ``twist_ratio``, and vice versa.
        """
        names = {axis.name for axis in axes}
        replaced = names | {other for pair in SAME for one, other in (pair, pair[::-1]) if one in names}
        kept = tuple(axis for axis in self.axes if axis.name not in replaced)
        bends = names & {"bend", "bend_1", "bend_2"}
        return Grid((*kept, *axes), bend_12 if bends else self.bend_12, self.source)

    def as_dict(self) -> dict:
        """The grid as JSON holds it; :meth:`from_dict` reads it back exactly."""
        axes = [{"name": axis.name, "values": axis.values.tolist(), "log": axis.log} for axis in self.axes]
        return {"axes": axes, "bend_12": self.bend_12}

    @classmethod
    def from_dict(cls, content: dict, source: str = "grid") -> "Grid":
        """The grid that :meth:`as_dict` wrote. Raises InputError where ``content`` does not describe a grid."""
        try:
            axes = tuple(Axis(str(axis["name"]), axis["values"], bool(axis["log"])) for axis in content["axes"])
            bend_12 = float(content["bend_12"])
        except (KeyError, TypeError, ValueError, OverflowError):
            raise InputError(source, "grid", "does not describe a grid", "run the sweep again") from None
        return cls(axes, bend_12, source)


@typed
@dataclass(frozen=True)
class Interval:
    """One parameter in a landscape: its value in the best cell, and the range of cells with nearly the smallest error.

    The range ends half-way to the nearest cells outside it, as precisely as the grid allows. ``low_is_open`` and
    ``high_is_open``: it reaches the grid's edge, and values beyond may fit as well.
    """

    name: str
    best: float
    low: float
    high: float
    low_is_open: bool
    high_is_open: bool

    @property
    def at_border(self) -> bool:
        """The best value is the grid's first or last."""
        return self.best in (self.low, self.high)

    def __str__(self) -> str:
        low, high = f"{'<=' * self.low_is_open}{self.low:.3g}", f"{'>=' * self.high_is_open}{self.high:.3g}"
        return f"{self.name} = {self.best:.4g} {UNITS[self.name]}".rstrip() + f" in {low} .. {high}"


def valley(grid: Grid, mean_distance: np.ndarray, fraction: float = 0.05) -> tuple[Interval, ...]:
    """The interval of each varying axis over the cells whose error is within ``fraction`` of the smallest one.

    mean_distance (G,) mm in the cells' order; cells that are NaN do not count. Raises InputError where all are.
    """
    mean = np.asarray(mean_distance, dtype=np.float64)
    if np.isnan(mean).all():
        raise InputError(grid.source, "distance_mm", "no cell has an error", "look at the rods' status")
    best = int(np.nanargmin(mean))
    near = np.flatnonzero(np.nan_to_num(mean, nan=np.inf) <= mean[best] * (1 + fraction))
    intervals = []
    for number, axis in enumerate(grid.axes):
        if len(axis) == 1:
            continue
        places, there = (np.unravel_index(cells, grid.shape)[number] for cells in (near, best))
        between = np.sqrt(axis.values[1:] * axis.values[:-1]) if axis.log else 0.5 * (axis.values[1:] + axis.values[:-1])
        ends = np.concatenate([axis.values[:1], between, axis.values[-1:]])
        first, last = places.min(), places.max()
        intervals.append(Interval(axis.name, float(axis.values[there]), float(ends[first]), float(ends[last + 1]),
                                  bool(first == 0), bool(last == len(axis) - 1)))
    return tuple(intervals)


def parse_axis(option: str, text: str, source: str = "grid") -> Axis:
    """``LO:HI:N[:log|:lin]`` or one number to the axis that ``option`` names (``twist_ratio`` or ``--twist-ratio``).

    Raises InputError for anything that is no such text, and for grids of no cells.
    """
    name = option.removeprefix("--").replace("-", "_")
    parts = [part.strip() for part in str(text).split(":")]
    if len(parts) == 1:
        axis = Axis(name, _number(source, option, text, parts[0]))
    else:
        axis = _spaced(source, option, name, text, parts)
    _check_values(source, axis, option)
    return axis


def parse_bend(text: str, option: str = "bend", source: str = "grid") -> tuple[tuple[Axis, ...], float]:
    """``A``, ``A1,A2``, ``A1,A2,A12`` or a range ``LO:HI:N`` to the axes of B and its off-diagonal entry.

    Raises InputError for anything else and for a B that is not positive definite.
    """
    parts = [part.strip() for part in str(text).split(",")]
    if len(parts) == 1:
        return (parse_axis(option, text, source),), 0.0
    if len(parts) > 3:
        raise InputError(source, option, f"{text!r} has {len(parts)} entries", "give A, A1,A2 or A1,A2,A12")
    first, second, mixed = [_number(source, option, text, part) for part in [*parts, "0"][:3]]
    if not (first > 0 and second > 0 and mixed**2 < first * second):
        raise _indefinite(source, option, first, second, mixed)
    return (Axis("bend_1", first), Axis("bend_2", second)), mixed


def parse_axes(texts: dict[str, str], source: str = "grid", prefix: str = "") -> tuple[list[Axis], float]:
    """The axes that ``texts`` give by their names, and the off-diagonal entry of B; messages name ``prefix`` and the axis."""
    axes, bend_12 = [], 0.0
    for name, text in texts.items():
        option = name if not prefix else prefix + name.replace("_", "-")
        if name == "bend":
            found, bend_12 = parse_bend(text, option, source)
            axes += found
        else:
            axes.append(parse_axis(option, text, source))
    return axes, bend_12


def _indefinite(source: str, option: str, first: float, second: float, mixed: float) -> InputError:
    return InputError(source, option, f"[[{first:g}, {mixed:g}], [{mixed:g}, {second:g}]] is not positive definite",
                      "give A1 > 0, A2 > 0 and |A12| < sqrt(A1 A2)")


def _number(source: str, option: str, text: str, part: str) -> float:
    try:
        value = float(part)
    except ValueError:
        raise InputError(source, option, f"{part!r} in {text!r} is not a number", _FORM) from None
    if not abs(value) <= LARGEST:
        raise InputError(source, option, f"{part!r} in {text!r} is not finite, or beyond {LARGEST:g}", _FORM)
    return value


def _spaced(source: str, option: str, name: str, text: str, parts: list[str]) -> Axis:
    if len(parts) not in (3, 4) or parts[3:] not in ([], ["log"], ["lin"]):
        raise InputError(source, option, f"{text!r} is not a range", _FORM)
    low, high = (_number(source, option, text, part) for part in parts[:2])
    log = parts[3:] != ["lin"]
    try:
        count = int(parts[2])
    except ValueError:
        raise InputError(source, option, f"{parts[2]!r} in {text!r} is not a whole number of values", _FORM) from None
    if count < 1:
        raise InputError(source, option, f"{text!r} is a grid of zero cells", "give N >= 1 values")
    if count > MOST_VALUES:
        raise InputError(source, option, f"{text!r} has {count} values", f"give N <= {MOST_VALUES}")
    if low > high or (low == high) != (count == 1):
        raise InputError(source, option, f"{text!r} does not run upwards over {count} different values",
                         "give LO < HI with N >= 2, or a single number")
    if log and low <= 0:
        raise InputError(source, option, f"{text!r} starts at {low:g}, logarithmic spacing needs LO > 0", "give LO > 0")
    return Axis(name, np.geomspace(low, high, count) if log else np.linspace(low, high, count), log)


def _check_names(source: str, names: list[str]) -> None:
    unknown = [name for name in names if name not in UNITS]
    if unknown:
        raise InputError(source, unknown[0], "unknown axis", f"use {', '.join(UNITS)}")
    for one, other in SAME:
        if one in names and other in names:
            raise InputError(source, other, f"given beside {one}", f"give one of {one} and {other}")
    if len(set(names)) < len(names):
        raise InputError(source, max(names, key=names.count), "given twice", "give each axis once")
    if "bend" not in names:
        for name in ("bend_1", "bend_2"):
            if name not in names:
                raise InputError(source, name if "bend_1" in names or "bend_2" in names else "bend", "missing",
                                 "give bend, or both bend_1 and bend_2")


def _check_values(source: str, axis: Axis, option: str | None = None) -> None:
    values, name = axis.values, option or axis.name
    if values.ndim != 1 or not len(values):
        raise InputError(source, name, "a grid of zero cells", "give at least one value")
    if not np.isfinite(values).all() or (np.diff(values) <= 0).any():
        raise InputError(source, name, f"{values.tolist()} are not increasing finite numbers", _FORM)
    if axis.name in ("bend", "bend_1", "bend_2", "twist") and 0 < values[0] < 1 / LARGEST:
        raise InputError(source, name, f"{values[0]:g} is below {1 / LARGEST:g}", f"give {1 / LARGEST:g} or more")
    if values[0] < 0 or (values[0] == 0 and axis.name != "weight"):
        raise InputError(source, name, f"{values[0]:g} is not {'zero or ' * (axis.name == 'weight')}positive",
                         "give positive values")
