"""ν Σ_c E_proj^c, which images add to a rod's energy E: F minimises E_vis = E + ν Σ_c E_proj^c (§IV-A).

    maps = distance_maps(detections)
    relax(start, material, clamps, external=Reprojection(maps, rig, nu), external_index=set_index)  # F(Γ, E_vis, C)

E is in mm² (relative to weight, as everywhere), E_proj in px², so ν is in mm²/px² and depends on the cameras' resolution.
Results depend on ν over the largest eigenvalue of B: for sutures seen at 6 px/mm, 3e-5 1/(mm px²) gives vertices 0.2 mm off
the truth, 3e-4 gives 0.1 mm, 3e-3 gives 0.05 mm.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import taichi as ti

from doo_ti.physics.number import Number
from doo_ti.physics.tuples import minus
from doo_ti.physics.view import Layout
from doo_ti.relaxation.external import ExternalFunctions
from doo_ti.relaxation.tables import MOST_NUMBERS
from doo_ti.system.arguments import typed
from doo_ti.system.errors import InputError
from doo_ti.vision.cameras.rig import Rig
from doo_ti.vision.reprojection.distance_map import DistanceMaps
from doo_ti.vision.reprojection.edge_integral import (
    COLUMNS,
    POINTS,
    WINDOW,
    EdgeIntegral,
    add_turned_back,
    no_moments,
    weighted,
)
from doo_ti.vision.reprojection.sampling import SMALLEST, camera_table

NU = COLUMNS
"""The column of ν, after those of the edge integral."""


@typed
@dataclass(frozen=True)
class Reprojection:
    """ν Σ_c E_proj^c as an external energy of :func:`doo_ti.relaxation.relax.relax`, for rods of any number of edges.

    maps    of A sets of images; ``external_index`` names the set of each rod
    rig     the C cameras the maps are of
    nu      ν, mm²/px²
    points  n: number of places along an edge where the maps are sampled, for each camera
    cap     px: distances saturate there, so that gaps in the detection cost a limited energy
    reach   px: while steps are large, K is that of a parabola to the nearest detected line, or to this far from it

    In f32 pixels are exact to 1e-4, which limits the residual. With a ``Newton(tolerance=...)`` below that limit all rods are
    relaxed again in f64.

    Raises InputError for maps of another number of cameras, for windows that are too small or lie outside the values, and
    for numbers out of range.
    """

    maps: DistanceMaps
    rig: Rig
    nu: float
    points: int = 4
    cap: float = 40.0
    reach: float = 2.0
    layout: ClassVar[Layout] = Layout(images=1, nu=1)
    start_layout: ClassVar[Layout] = Layout()
    has_coarse: ClassVar[bool] = True
    vertices: ClassVar[None] = None

    def __post_init__(self) -> None:
        _check_maps(self.maps, self.rig)
        for name in ("nu", "cap", "reach"):
            value = getattr(self, name)
            number = isinstance(value, int | float | np.number) and np.isfinite(value)
            if not (number and (value >= 1e-12 or (name == "nu" and value == 0))):
                raise InputError("Reprojection", name, f"{value!r}", "give a positive, finite number")
        if not (isinstance(self.points, int | np.integer) and 1 <= self.points <= 64):
            raise InputError("Reprojection", "points", f"{self.points!r}", "give a whole number from 1 to 64")

    @property
    def count(self) -> int:
        """A."""
        return len(self.maps.window)

    def numbers(self) -> np.ndarray:
        """(A, C, NU + 1): cameras, windows, how to integrate, and ν."""
        sets, cameras = self.maps.window.shape[:2]
        table = np.empty((sets, cameras, NU + 1))
        table[..., :WINDOW] = camera_table(self.rig)
        table[..., WINDOW:POINTS] = self.maps.window
        table[..., POINTS:] = self.points, self.cap**-2, self.reach, self.nu
        return table

    def field(self) -> np.ndarray:
        """(N,) float32: the distances of all maps."""
        return np.ascontiguousarray(self.maps.values, dtype=np.float32)

    def energy_at_start(self, start: np.ndarray, index: np.ndarray) -> np.ndarray:
        """(R,) none: all of it lies on edges."""
        return np.zeros(len(start))

    @staticmethod
    def functions(number: Number) -> ExternalFunctions:
        """On the device."""
        energy = ImageEnergy(number)
        return ExternalFunctions(energy.load, energy.evaluate)


@ti.data_oriented
class ImageEnergy:
    """ν Σ_c E_proj^c of an edge for one kind of number."""

    def __init__(self, number):
        self.constant, self.edge = number.lanes().constant, EdgeIntegral(number)

    @ti.func
    def load(self, own, numbers: ti.template(), row, edge, scale):
        own.images, own.nu = row, numbers[row, 0, NU] * scale

    @ti.func
    def evaluate(self, own, numbers: ti.template(), values: ti.template(), start, end, coarse):
        nu, zero = own.nu, self.constant(0.0)
        # A lane without a rod may hold any number, which must not be used as an index.
        given = own.images
        row = ti.select((given >= 0.0) & (given < numbers.shape[0]), given, zero)
        total, camera = no_moments(zero), self.edge.projection
        for c in range(numbers.shape[1]):
            seen = self.edge.moments(self.edge.view(numbers, values, row, c), camera.entered(numbers, c, start),
                                     camera.turned(numbers, c, minus(end, start)), coarse)
            add_turned_back(total, seen, camera, numbers, c)
        return weighted(total, nu)


def _check_maps(maps: DistanceMaps, rig: Rig) -> None:
    """Raise InputError unless every window can be sampled and lies within the values."""
    window, cameras = np.asarray(maps.window), len(rig.cameras)
    if np.ndim(maps.values) != 1 or np.asarray(maps.values).dtype.kind != "f":
        raise InputError("maps", "values", f"shape {np.shape(maps.values)}", "give all maps' distances as one vector")
    if window.ndim != 3 or window.shape[1:] != (cameras, 5):
        raise InputError("maps", "window", f"shape {window.shape}", f"give (A, {cameras}, 5), a map for each camera of the rig")
    if window.dtype.kind not in "iu":
        raise InputError("maps", "window", f"dtype {window.dtype}", "give whole numbers")
    if ((window[..., 3:] < SMALLEST) | (window[..., 3:] > MOST_NUMBERS // SMALLEST)).any():
        raise InputError("maps", "window", f"{window[..., 3:].min()} to {window[..., 3:].max()} px across",
                         f"give windows of {SMALLEST} px or more that lie within the values")
    ends = window[..., 0] + window[..., 3] * window[..., 4]
    if (window[..., 0] < 0).any() or (ends > np.size(maps.values)).any() or np.size(maps.values) > MOST_NUMBERS:
        raise InputError("maps", "values", f"{np.size(maps.values)} distances", f"give the {ends.max()} that the windows need")
