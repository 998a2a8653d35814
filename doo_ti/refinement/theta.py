"""Θ, the parameters of one rod (§III-E)."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated

import numpy as np
from numpy.typing import ArrayLike

from doo_ti.rod.types import Material
from doo_ti.system.arguments import short_repr, typed
from doo_ti.system.errors import InputError, require_whole

RATIO = 0.8  # twist over bend stiffness of a common rod


@typed
@dataclass(frozen=True)
class Theta:
    """One material and the direction of gravity.

    bend (2, 2) mm³, twist mm³, weight μ, rest_curvature None, (2,) or (E−1, 2) in 1/mm, up (3,) unit vector
    """

    __repr__ = short_repr

    bend: Annotated[np.ndarray, "2 2"]
    twist: float
    weight: float = 1.0
    rest_curvature: Annotated[np.ndarray | None, "2 | J 2"] = None
    up: Annotated[np.ndarray, "3"] = (0.0, 0.0, 1.0)

    if TYPE_CHECKING:  # what it takes; the fields are the arrays that it makes of them
        def __init__(self, bend: ArrayLike, twist: float, weight: float = 1.0, rest_curvature: ArrayLike | None = None,
                     up: ArrayLike = (0.0, 0.0, 1.0)) -> None: ...

    def __post_init__(self) -> None:
        for name in ("bend", "rest_curvature", "up"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, np.array(getattr(self, name), dtype=np.float64))

    @classmethod
    @typed
    def of(cls, material: Material, row: int = 0, up: ArrayLike = (0.0, 0.0, 1.0)) -> "Theta":
        """Row ``row`` of ``material``. Raises InputError where bend or twist vary along the rod."""
        if material.bend.shape[1] > 1 or material.twist.shape[1] > 1:
            raise InputError("refine", "material", "bend or twist vary along the rod", "give one value for the whole rod")
        require_whole("Theta.of", "row", row, 0, material.count - 1)
        rest = material.rest_curvature
        rest = None if rest is None else rest[row, 0] if rest.shape[1] == 1 else rest[row]
        return cls(material.bend[row, 0], float(material.twist[row, 0]), float(material.weight[row]), rest, np.asarray(up))

    @property
    def entries(self) -> dict[str, float]:
        """Parameter: value, in mm³, the weight μ without unit; ``bend`` is α of a round rod."""
        return {"bend": self.bend[0, 0], "bend_1": self.bend[0, 0], "bend_2": self.bend[1, 1], "bend_12": self.bend[0, 1],
                "twist": self.twist, "weight": self.weight}

    @property
    def material(self) -> Material:
        """The same as a table of one row."""
        rest = self.rest_curvature
        return Material(self.bend, self.twist, self.weight, None if rest is None else rest[None])

    @property
    def correlation(self) -> float:
        """B₁₂/√(B₁₁B₂₂)."""
        return float(self.bend[0, 1] / np.sqrt(self.bend[0, 0] * self.bend[1, 1]))


def common_rod(theta: Theta) -> Theta:
    """``theta`` with the twist stiffness of a common rod of its bend stiffness."""
    return replace(theta, twist=RATIO * float(np.sqrt(np.linalg.det(theta.bend))))
