"""What scenes state of a rod's material: relative to its weight, or in physical units as the options of commands do
(:mod:`doo_ti.rod.physical_units`).

    bend = 6e5                         # mm³, or a matrix [[A1, A12], [A12, A2]]
    twist = 8e5                        # mm³ (the same as a bend that is a number)
    weight = 1.0                       # (1)

    EI = 1e-5                          # N m², or a matrix, instead of bend and weight
    GJ = 8e-6                          # N m² (the same as an EI that is a number)
    linear_density = 3.0               # g/m, needed with EI; beside bend and weight it only gives forces in N
"""

from dataclasses import dataclass

import numpy as np

from doo_ti.io.toml_file import NotNegative, NumberOrMatrix, Positive, Table
from doo_ti.rod.physical_units import bend_or_twist, force_in_newton, weight_per_length
from doo_ti.system.errors import InputError


class MaterialKeys(Table, kw_only=True):
    """The keys; what is None is not stated."""

    bend: NumberOrMatrix | None = None
    twist: Positive | None = None
    weight: NotNegative | None = None
    EI: NumberOrMatrix | None = None
    GJ: Positive | None = None
    linear_density: Positive | None = None


@dataclass(frozen=True)
class StatedMaterial:
    """bend (2, 2) and twist in mm³ and weight, as :class:`.Material` has them; newton: N in its unit of force, or None."""

    bend: np.ndarray
    twist: float
    weight: float
    newton: float | None


def stated_material(source, key: str, keys: MaterialKeys, unit_density: float | None = None) -> StatedMaterial:
    """The material that the table ``key`` of the file ``source`` states.

    unit_density  g/m of a rod of weight 1, to which stiffness in N m² becomes relative; by default the material's own

    Raises InputError for keys that are missing, and for the same quantity stated in both ways.
    """
    physical = keys.EI is not None
    for name, other in (("bend", "EI"), ("weight", "EI"), ("twist", "EI"), ("GJ", "bend")):
        if getattr(keys, name) is not None and getattr(keys, other) is not None:
            raise InputError(source, f"{key}.{name}", f"given beside {other}", "give bend, twist and weight, or EI and GJ with "
                             "linear_density")
    if not physical and keys.bend is None:
        raise InputError(source, f"{key}.{'EI' if keys.GJ is not None else 'bend'}", "missing",
                         "give bend, or EI with linear_density")
    if physical and keys.linear_density is None:
        raise InputError(source, f"{key}.linear_density", "missing beside EI", "give the mass per length in g/m")
    bend, twist, names = (keys.EI, keys.GJ, ("EI", "GJ")) if physical else (keys.bend, keys.twist, ("bend", "twist"))
    if twist is None and not isinstance(bend, float):
        raise InputError(source, f"{key}.{names[1]}", f"missing beside a matrix {names[0]}", "give the stiffness against twist")
    matrix, twist = np.array(bend) if isinstance(bend, tuple) else bend * np.eye(2), bend if twist is None else twist
    weight = 1.0 if keys.weight is None else keys.weight
    if physical:
        unit = weight_per_length(keys.linear_density if unit_density is None else unit_density)
        matrix, twist = bend_or_twist(matrix, unit), float(bend_or_twist(twist, unit))
        weight = 1.0 if unit_density is None else keys.linear_density / unit_density
    newton = None
    if keys.linear_density is not None and weight > 0:
        newton = float(force_in_newton(1.0, weight_per_length(keys.linear_density), weight))
    return StatedMaterial(matrix, twist, weight, newton)


def newtons(found: list[StatedMaterial]) -> np.ndarray | None:
    """(G,) N in the unit of force of each material, or None where one does not state it."""
    return None if any(one.newton is None for one in found) else np.array([one.newton for one in found])
