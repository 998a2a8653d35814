"""What scenes of rods that move state of a material's inertia and losses."""

from pathlib import Path

from doo_ti.dynamics.parameters import Dynamics
from doo_ti.io.scene_keys import MaterialKeys
from doo_ti.io.toml_file import NotNegative, Positive
from doo_ti.system.errors import InputError


class InertiaKeys(MaterialKeys, kw_only=True):
    """Keys of a material and of a rod's mass and losses."""

    density: Positive | None = None
    bend_damping_s: NotNegative = 0.0
    twist_damping_s: NotNegative = 0.0
    drag_per_s: NotNegative = 0.0
    quadratic_drag_per_mm: NotNegative = 0.0

    def dynamics(self, path: Path, key: str, weight: float) -> Dynamics:
        """Those of rods with that ``weight``. Raises InputError, naming the table ``key``, for rods without mass."""
        density = weight if self.density is None else self.density
        if not density > 0:
            raise InputError(path, f"{key}.density", "missing for a rod without weight",
                             "give its mass per length over that of a rod of weight 1")
        return Dynamics(density, self.bend_damping_s, self.twist_damping_s, self.drag_per_s, self.quadratic_drag_per_mm)
