"""External energies at the vertices of a rod, besides bending, twist and gravity.

A kind of external energy is a table of numbers and a field of values on the host, and two Taichi functions on the device,
``load`` and ``evaluate``; the solver needs nothing else. Springs are the simplest kind, and need no field. Forces and masses at
the vertices, such as a needle, a payload or a pull of known direction, are another:

    force = np.zeros((1, V, 3))
    force[:, -1] = (0, 0.02, 0)                                         # N at the last vertex
    relax(start, material, clamps, external=PointLoads.from_physical(force, material))
"""

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, field
from typing import Annotated, ClassVar, NamedTuple, Protocol

import numpy as np
import taichi as ti
from numpy.typing import ArrayLike

from doo_ti.physics.number import Layout, Number, read
from doo_ti.physics.tuples import dot, minus, scaled
from doo_ti.rod.material import LARGEST, STANDARD_GRAVITY, Material
from doo_ti.system.arguments import owning, short_repr, typed
from doo_ti.system.errors import InputError


class ExternalFunctions(NamedTuple):
    """An external energy as Taichi functions.

    load      (own, numbers, row, edge, scale): those of ``numbers``' row into the view ``own`` of an edge's numbers in a lane
              (:mod:`doo_ti.physics.number`), energies times ``scale``
    evaluate  (own, numbers, field, start, end, coarse): an edge's energy E with its vertices at ``start`` and ``end``,
              and the moments of its gradient γ and curvature K over the places s in [0, 1] along the edge where it acts,
              (E, Σ γ, Σ s γ, Σ K, Σ s K, Σ s² K). That is: the derivatives by a shift of the whole edge and by the change
              of end − start, and the second derivatives by shift and shift, by shift and change (nine numbers, row by row),
              by change and change; symmetric ones as (11, 12, 13, 22, 23, 33).
              Where ``coarse`` is one the rod is far from rest, and K better positive semidefinite than exact.
              None where there is no energy.
    """

    load: Callable
    evaluate: Callable | None


class External(Protocol):
    """The interface of an external energy, and what a class that derives from it has unless it says otherwise: no energy.
    ``external_index`` gives each rod one of its ``count`` rows.

    layout       of the numbers it needs in scratch per edge
    at_vertices  whether each edge carries that of the vertex where it ends; that of vertex 0, if it may move, is then the one
                 of an edge −1 that ends there
    has_coarse   whether K far from rest differs from that near it
    vertices     of the rods it is for, None where it is for any number of them
    """

    layout: ClassVar[Layout] = Layout()
    at_vertices: ClassVar[bool] = False
    has_coarse: ClassVar[bool] = False

    @property
    def count(self) -> int:
        return 1

    @property
    def vertices(self) -> int | None:
        return None

    def numbers(self) -> np.ndarray:
        """(count, -, -) float64, one number at least."""
        return np.zeros((1, 1, 1))

    def field(self) -> np.ndarray:
        """(-,) float32, one number at least."""
        return np.zeros(1, dtype=np.float32)

    def energy_at_start(self, start: np.ndarray, index: np.ndarray) -> np.ndarray:
        """(R,) the part that no edge carries: at vertex 0 in ``start`` (R, 3), of the rows ``index`` (R,)."""
        return np.zeros(len(start))

    @staticmethod
    def functions(number: Number) -> ExternalFunctions:
        """For one kind of number."""
        @ti.func
        def load(own, numbers: ti.template(), row, edge, scale):
            pass

        return ExternalFunctions(load, None)


@owning
@dataclass(frozen=True)
class Springs(External):
    """½ k |x_i − p_i|² at every vertex: the simplest external energy.

    points     (A, V, 3) mm
    stiffness  (A, V) k ≥ 0, energy over mm²

    ``external_index`` gives each rod one of the A rows. Raises InputError for shapes that do not match, and for
    numbers that are negative or not finite.
    """

    __repr__ = short_repr

    points: Annotated[np.ndarray, "A V 3", float]
    stiffness: Annotated[np.ndarray, "A V", float]
    layout: ClassVar[Layout] = Layout(point=3, stiffness=1)
    at_vertices: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if not np.isfinite(self.points).all():
            raise InputError("Springs", "points", "not finite", "give finite points, and stiffness 0 where there is none")
        if not (np.isfinite(self.stiffness).all() and (self.stiffness >= 0).all()):
            raise InputError("Springs", "stiffness", "negative or not finite", "give zero or more")

    @property
    def count(self) -> int:
        """A."""
        return len(self.points)

    @property
    def vertices(self) -> int:
        """V."""
        return self.points.shape[1]

    def numbers(self) -> np.ndarray:
        """(A, V, 4): point and stiffness."""
        return np.concatenate([self.points, self.stiffness[..., None]], axis=-1, dtype=np.float64)

    def energy_at_start(self, start: np.ndarray, index: np.ndarray) -> np.ndarray:
        """(R,) energy at vertex 0 in ``start`` (R, 3), which no kernel moves."""
        return 0.5 * self.stiffness[index, 0] * np.sum((start - self.points[index, 0]) ** 2, axis=-1)

    @staticmethod
    def functions(number: Number) -> ExternalFunctions:
        """On the device: each edge carries the spring of the vertex where it ends."""
        @ti.func
        def load(own, numbers: ti.template(), row, edge, scale):
            own.point = read(numbers, row, edge + 1, 0)
            own.stiffness = numbers[row, edge + 1, 3] * scale

        @ti.func
        def evaluate(own, numbers: ti.template(), field: ti.template(), start, end, coarse):
            k, none = own.stiffness, 0.0 * own.stiffness
            apart = minus(end, own.point)
            gradient = scaled(apart, k)
            curvature = (k, none, none, k, none, k)
            mixed = (k, none, none, none, k, none, none, none, k)
            return 0.5 * k * dot(apart, apart), gradient, gradient, curvature, mixed, curvature

        return ExternalFunctions(load, evaluate)


class Nothing(External):
    """No energy: for rods that only contact loads."""


@owning
@dataclass(frozen=True)
class PointLoads(External):
    """−F_i · x_i at every vertex: dead forces, and masses that hang there. An external energy, alone or together with springs.

    force    (A, V, 3) on the vertices, in the package's unit, energy (mm²) per mm
    mass     (A, V) ≥ 0, or one number for all vertices: the weight that the body has, in the same unit, whatever the weight of
             the rod. In a motion it has the inertia of that weight under standard gravity
    springs  of A rows, or none

    ``up`` (3,), the unit direction against which masses hang, is that of the call they are given to, which sets it.
    ``external_index`` gives each rod one of the A rows. Raises InputError for shapes that do not match, and for numbers that
    are not finite or masses that are negative.
    """

    __repr__ = short_repr

    force: Annotated[np.ndarray, "A V 3", float]
    mass: Annotated[np.ndarray | float, "() | A V", float] = 0.0
    springs: Springs | None = None
    up: np.ndarray | None = field(default=None, init=False)
    layout: ClassVar[Layout] = Springs.layout + Layout(force=3)
    at_vertices: ClassVar[bool] = True

    def __post_init__(self) -> None:
        for name, value in (("force", self.force), ("mass", self.mass)):
            if not (np.abs(value) <= LARGEST).all():
                raise InputError("PointLoads", name, f"not finite, or beyond {LARGEST:g}", "give finite numbers")
        if not np.all(self.mass >= 0):
            raise InputError("PointLoads", "mass", f"{np.min(self.mass):g} is negative", "give zero or more")
        rows = self.force.shape[:2]
        if self.springs is not None and self.springs.stiffness.shape != rows:
            raise InputError("PointLoads", "springs", f"those of {self.springs.stiffness.shape} vertices", f"give {rows}")
        object.__setattr__(self, "mass", np.broadcast_to(np.asarray(self.mass, dtype=np.float64), rows))

    @classmethod
    @typed
    def from_physical(cls, force: Annotated[ArrayLike, "A V 3", float], material: Material,
                      mass: Annotated[ArrayLike, "() | A V", float] = 0.0) -> "PointLoads":
        """Those of ``force`` (A, V, 3) in N and ``mass`` in g, (A, V) or one number for all vertices, on rods of ``material``,
        of one row or A, whose weight per length is known.

        Raises InputError as the class does, and for a material without a weight per length.
        """
        if material.newton is None:
            raise InputError("PointLoads", "material", "without a weight per length", "give Material.from_physical(…)")
        if material.count not in (1, len(force)):
            raise InputError("PointLoads", "force", f"shape {force.shape} for {material.count} materials", "give (A, V, 3)")
        unit = material.newton[:, None]
        weight = np.broadcast_to(1e-3 * STANDARD_GRAVITY * np.asarray(mass, dtype=np.float64), force.shape[:2])
        return cls(force / unit[..., None], weight / unit)

    @property
    def count(self) -> int:
        """A."""
        return len(self.force)

    @property
    def vertices(self) -> int:
        """V."""
        return self.force.shape[1]

    @property
    def whole_force(self) -> np.ndarray:
        """(A, V, 3) with the weight of the masses."""
        return self.force if self.up is None else self.force - self.mass[..., None] * self.up

    def hanging(self, up: np.ndarray) -> "PointLoads":
        """The same, whose masses hang against ``up`` (3,)."""
        loads = copy(self)
        object.__setattr__(loads, "up", up)
        return loads

    def take(self, rows: np.ndarray) -> "PointLoads":
        """The rows of that number, in that order."""
        springs = None if self.springs is None else Springs(self.springs.points[rows], self.springs.stiffness[rows])
        return PointLoads(self.force[rows], self.mass[rows], springs)

    def numbers(self) -> np.ndarray:
        """(A, V, 7): point and stiffness of a spring, and the force."""
        springs = np.zeros((*self.mass.shape, 4)) if self.springs is None else self.springs.numbers()
        return np.concatenate([springs, self.whole_force], axis=-1, dtype=np.float64)

    def energy_at_start(self, start: np.ndarray, index: np.ndarray) -> np.ndarray:
        """(R,) energy at vertex 0 in ``start`` (R, 3), which no kernel moves."""
        own = -np.sum(self.whole_force[index, 0] * start, axis=-1)
        return own if self.springs is None else own + self.springs.energy_at_start(start, index)

    @staticmethod
    def functions(number: Number) -> ExternalFunctions:
        """On the device: those of springs, and the force of the vertex where an edge ends."""
        springs = Springs.functions(number)

        @ti.func
        def load(own, numbers: ti.template(), row, edge, scale):
            springs.load(own, numbers, row, edge, scale)
            own.force = scaled(read(numbers, row, edge + 1, 4), scale)

        @ti.func
        def evaluate(own, numbers: ti.template(), field: ti.template(), start, end, coarse):
            energy, gradient, along, curvature, mixed, stiffness = springs.evaluate(own, numbers, field, start, end, coarse)
            force = own.force
            return (energy - dot(force, end), minus(gradient, force), minus(along, force), curvature, mixed, stiffness)

        return ExternalFunctions(load, evaluate)


def check_rows(function: str, loads: PointLoads | Springs | None, rods: int, vertices: int) -> None:
    """Raise InputError, naming ``function``, for loads of others than so many rods, or one for all, of so many vertices."""
    if loads is not None and (loads.vertices != vertices or loads.count not in (1, rods)):
        name = "loads" if isinstance(loads, PointLoads) else "springs"
        raise InputError(function, name, f"{loads.count} rows of {loads.vertices} vertices",
                         f"give 1 or {rods} rows of {vertices} vertices")
