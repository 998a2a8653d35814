"""What a rod in motion has besides its material, how it starts, and the time steps it makes (docs/dynamics.md)."""

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Annotated

import numpy as np
from numpy.typing import ArrayLike

from doo_ti.contact.touch import require_gap_tolerance
from doo_ti.rod.material import STANDARD_GRAVITY
from doo_ti.rod.types import Configuration, Material
from doo_ti.system.arguments import short_repr, typed
from doo_ti.system.errors import InputError, real_array, require_whole

GRAVITY = 1e3 * STANDARD_GRAVITY
"""mm/s²: a rod of weight μ = 1 has the mass per length 2/GRAVITY in the package's units, for which its weight is 2."""


RATES = {"euler": 1.0, "bdf2": 1.5}  # schemes, with a of their time derivative D u = (a/h) (u − y)
LEAST_RATE, MOST_RATE = 1e-9, 1e7  # instants per second
LEAST_WAY = 1 / 8  # of the way to the next instant: the shortest quasi-static step, where longer ones fail


def vertex_lengths(rest_length: np.ndarray) -> np.ndarray:
    """(..., V) the length of rod that each vertex stands for, half of both edges beside it, from (..., E) lengths, mm."""
    none = np.zeros_like(rest_length[..., :1])
    return 0.5 * (np.concatenate([none, rest_length], axis=-1) + np.concatenate([rest_length, none], axis=-1))


@typed
@dataclass(frozen=True)
class Stepping:
    """The instants of a motion and the time steps between them.

    rate       instants of the grippers per second
    substeps   time steps from one instant to the next; grippers move smoothly between them
    scheme     "bdf2", of second order, or "euler", backward Euler, of first order and strongly damping
    precision  "f64"; "f32", in which a rod that rounding stops is reported as stalled; or "mixed": f32, and f64 for the rods
               that it stops or that need finer steps
    tolerance  mm: a rod whose estimated error is larger at some frame, or that fails, is simulated again with twice as many
               steps, which also gives the estimate (:mod:`doo_ti.dynamics.trajectory`); None: no error is estimated
    most_substeps  with a tolerance
    detailed   frames, velocities and energies are returned as well; every step is a launch of its own then
    quasi_static   without inertia, drag and damping: every step is an equilibrium, in which friction remembers where the rod
                   was
    gap_tolerance  of a rod's radius: how far the gap at a contact may be off, as in :class:`.Newton`. The limit of friction is
                   as exact as the force of its contact. None: 4e-5, and 2e-4 for rods that may touch themselves

    Raises InputError for numbers out of range and unknown words.
    """

    rate: float
    substeps: int = 1
    scheme: str = "bdf2"
    precision: str = "f64"
    tolerance: float | None = None
    most_substeps: int = 64
    detailed: bool = False
    quasi_static: bool = False
    gap_tolerance: float | None = None

    def __post_init__(self) -> None:
        if self.gap_tolerance is not None:
            require_gap_tolerance("Stepping", self.gap_tolerance)
        if not LEAST_RATE <= self.rate <= MOST_RATE:
            raise InputError("Stepping", "rate", f"{self.rate}", f"give instants per second, {LEAST_RATE:g} to {MOST_RATE:g}")
        require_whole("Stepping", "substeps", self.substeps, 1)
        require_whole("Stepping", "most_substeps", self.most_substeps, 1)
        if self.tolerance is not None:
            if not self.tolerance > 0:
                raise InputError("Stepping", "tolerance", f"{self.tolerance}", "give mm above zero, or None")
            if self.most_substeps < 2 * self.substeps:
                raise InputError("Stepping", "most_substeps", f"{self.most_substeps} with {self.substeps} substeps at first",
                                 "give at least twice as many: errors are estimated by doubling")
        for name, known in (("scheme", tuple(RATES)), ("precision", ("f32", "f64", "mixed"))):
            if getattr(self, name) not in known:
                raise InputError("Stepping", name, f"{getattr(self, name)!r}", f"give one of {', '.join(known)}")

    @property
    def step(self) -> float:
        """h, the time step, s."""
        return 1.0 / (self.rate * self.substeps)

    @property
    def least_way(self) -> float:
        """The share of a step's way that is made at once, at least."""
        return LEAST_WAY if self.quasi_static else 1.0


@typed
@dataclass(frozen=True)
class MovingStart:
    """S rods as a motion begins.

    configuration  where they are at the first instant
    velocity       (S, V, 3) mm/s; None: at rest
    velocity_age   s before the first instant for which ``velocity`` holds: ``smooth`` carries it on by the acceleration
    smooth         the history before the first instant is that of the acceleration there; False: of constant velocity

    Raises InputError for a velocity of another shape, or that is not finite.
    """

    __repr__ = short_repr

    configuration: Configuration
    velocity: np.ndarray | None = None
    velocity_age: float = 0.0
    smooth: bool = True

    def __post_init__(self) -> None:
        shape = (self.configuration.count, self.configuration.edges + 1, 3)
        velocity = np.zeros(shape) if self.velocity is None else self.velocity
        velocity = real_array("MovingStart", "velocity", velocity, "give real numbers").astype(np.float64)
        if velocity.shape != shape:
            raise InputError("MovingStart", "velocity", f"shape {velocity.shape}", f"give {shape}")
        if not np.isfinite(velocity).all():
            raise InputError("MovingStart", "velocity", "not finite", "give finite numbers of mm/s")
        object.__setattr__(self, "velocity", velocity)


@typed
@dataclass(frozen=True)
class Dynamics:
    """Mass and losses of G rods, scalars or (G,); rows go with those of :class:`doo_ti.rod.types.Material`.

    density          mass per length over that of a rod of weight 1; None: the material's weight μ, as of a rod under gravity
    bend_damping     τ, s: bending at the rate ω̇ is resisted by the moment τ B ω̇
    twist_damping    s: the same of twist
    drag             1/s: force against the velocity v, −c v for each unit of the rod's mass
    quadratic_drag   1/mm: −c₂ |v| v for each unit of the rod's mass
    point_mass       mm of rod that weigh as much, at every vertex: a scalar, (G,), or (G, V). Of markers that are part of the
                     rod; what it carries is for :class:`.PointLoads`

    Raises InputError for numbers that are negative or not finite, and shapes that do not match.
    """

    __repr__ = short_repr

    density: Annotated[np.ndarray | None, "() | 1G", float] = None
    bend_damping: Annotated[np.ndarray, "() | 1G", float] = 0.0
    twist_damping: Annotated[np.ndarray, "() | 1G", float] = 0.0
    drag: Annotated[np.ndarray, "() | 1G", float] = 0.0
    quadratic_drag: Annotated[np.ndarray, "() | 1G", float] = 0.0
    point_mass: Annotated[np.ndarray, "() | 1G | 1G V", float] = 0.0

    if TYPE_CHECKING:  # what it takes; the fields are the arrays that it makes of them
        def __init__(self, density: ArrayLike | None = None, bend_damping: ArrayLike = 0.0, twist_damping: ArrayLike = 0.0,
                     drag: ArrayLike = 0.0, quadratic_drag: ArrayLike = 0.0, point_mass: ArrayLike = 0.0) -> None: ...

    def __post_init__(self) -> None:
        for entry in fields(self):
            value = getattr(self, entry.name)
            if value is None:
                continue
            array = real_array("Dynamics", entry.name, value, "give real numbers").astype(np.float64)
            if not (np.isfinite(array).all() and (array >= 0).all()):
                raise InputError("Dynamics", entry.name, "negative or not finite", "give zero or more")
            object.__setattr__(self, entry.name, array)

    @property
    def count(self) -> int:
        """Number of rows: G, or one for all."""
        arrays = (getattr(self, entry.name) for entry in fields(self))
        return max((len(array) for array in arrays if array is not None and array.ndim), default=1)

    def column(self, name: str, count: int) -> np.ndarray:
        """(count,) the field of that name."""
        return np.broadcast_to(getattr(self, name), (count,))

    def point_masses(self, count: int, vertices: int) -> np.ndarray:
        """(count, V) mm. Raises InputError where the number of vertices is another."""
        mass = self.point_mass if self.point_mass.ndim == 2 else self.point_mass.reshape(-1, 1)
        if mass.shape[1] not in (1, vertices):
            raise InputError("Dynamics", "point_mass", f"{mass.shape[1]} vertices, the rods have {vertices}",
                             f"give (G, {vertices})")
        return np.broadcast_to(mass, (count, vertices))


@typed
@dataclass(frozen=True)
class Direction:
    """A parameter by which a motion is differentiated: the material and the dynamics of the G rods at two near values of it.

    distance  between the two values. What the rods are made of is differentiated by this difference, their motion exactly.
    """

    before: tuple[Material, Dynamics]
    after: tuple[Material, Dynamics]
    distance: float
