"""What a rod in motion has besides its material: mass, damping, drag (docs/dynamics.md)."""

from dataclasses import dataclass, fields

import numpy as np

from doo_ti.errors import InputError, real_array
from doo_ti.types import Material

GRAVITY = 9806.65
"""mm/s²: a rod of weight μ = 1 has the mass per length 2/GRAVITY in the package's units, for which its weight is 2."""


@dataclass(frozen=True)
class Dynamics:
    """Mass and losses of G rods, scalars or (G,); rows go with those of :class:`doo_ti.types.Material`.

    density          mass per length over that of a rod of weight 1; None: the material's weight μ, as of a rod under gravity
    bend_damping     τ, s: bending at the rate ω̇ is resisted by the moment τ B ω̇
    twist_damping    s: the same of twist
    drag             1/s: force against the velocity v, −c v for each unit of the rod's mass
    quadratic_drag   1/mm: −c₂ |v| v for each unit of the rod's mass
    point_mass       mm of rod that weigh as much, at every vertex: a scalar, (G,), or (G, V)

    Raises InputError for numbers that are negative or not finite, and shapes that do not match.
    """

    density: np.ndarray | None = None
    bend_damping: np.ndarray = 0.0
    twist_damping: np.ndarray = 0.0
    drag: np.ndarray = 0.0
    quadratic_drag: np.ndarray = 0.0
    point_mass: np.ndarray = 0.0

    def __post_init__(self):
        for entry in fields(self):
            value = getattr(self, entry.name)
            if value is None:
                continue
            array = real_array("Dynamics", entry.name, value, "give real numbers").astype(np.float64)
            if not (np.isfinite(array).all() and (array >= 0).all()):
                raise InputError("Dynamics", entry.name, "negative or not finite", "give zero or more")
            most = 2 if entry.name == "point_mass" else 1
            if array.ndim > most:
                raise InputError("Dynamics", entry.name, f"shape {array.shape}",
                                 "give a number, (G,) or (G, V)" if most == 2 else "give a number or (G,)")
            object.__setattr__(self, entry.name, array)
        if len({len(array) for array in self._arrays() if array.ndim and len(array) > 1}) > 1:
            raise InputError("Dynamics", "drag, damping, point_mass", "leading lengths differ", "give one value or one per rod")

    def _arrays(self) -> list[np.ndarray]:
        return [array for entry in fields(self) if (array := getattr(self, entry.name)) is not None]

    @property
    def count(self) -> int:
        """G, or 1."""
        return max((len(array) for array in self._arrays() if array.ndim), default=1)

    @property
    def is_damped(self) -> bool:
        """Whether bending or twisting is damped in any rod."""
        return bool((self.bend_damping > 0).any() or (self.twist_damping > 0).any())

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


@dataclass(frozen=True)
class Direction:
    """A parameter by which a motion is differentiated: the material and the dynamics of the G rods at two near values of it.

    distance  between the two values. What the rods are made of is differentiated by this difference, their motion exactly.
    """

    before: tuple[Material, Dynamics]
    after: tuple[Material, Dynamics]
    distance: float
