"""What images add to a rod's energy E: E_proj, and E_back (§IV-A).

F minimises E_vis = E + ν Σ_c E_proj^c, how far the rod is from the detection:

    maps = distance_maps(detections)
    relax(start, material, clamps, external=Reprojection(maps, rig, nu), external_index=set_index)  # F(Γ, E_vis, C)

E is in mm² (relative to weight, as everywhere), E_proj in px², so ν is in mm²/px² and depends on the cameras' resolution.
Results depend on ν over the largest eigenvalue of B: for sutures seen at 6 px/mm, 3e-5 1/(mm px²) gives vertices 0.2 mm off
the truth, 3e-4 gives 0.1 mm, 3e-3 gives 0.05 mm.

An edge that points at the camera has no image and costs nothing, so a rod may leave part of the thread unexplained. In E_back
each detected point belongs to one place of the rod, in order, and

    E_back = Σ_c Σ_k w_k ρ(r_k),   r² = (n·δ)² + a (t·δ)²,   δ = p(x_k) − q_k,   ρ(r) = 2 h² (√(1 + r²/h²) − 1)

with q_k the detected point of place k in camera c, t and n the directions along and across the line there, w_k the px of line
that the place explains, a < 1 the share that counts of a distance along the line, and h the distance in px from which ρ grows
linearly: ρ is r² near the line. It depends on the rod: each has a table of its own.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import taichi as ti

from doo_ti.physics.algebra import full
from doo_ti.physics.number import Layout, Number, device_functions
from doo_ti.physics.tuples import minus, plus, put_lane, record, repeated, scaled
from doo_ti.relaxation.external import External, ExternalFunctions
from doo_ti.relaxation.tables import MOST_NUMBERS
from doo_ti.rod.frames import normal_to
from doo_ti.system.arguments import typed
from doo_ti.system.errors import InputError
from doo_ti.vision.cameras import Rig
from doo_ti.vision.distance_map import DistanceMaps
from doo_ti.vision.edge_integral import (
    COLUMNS,
    POINTS,
    WINDOW,
    EdgeIntegral,
    add_turned_back,
    added,
    by_point,
    congruent,
    contracted,
    no_moments,
    square_of,
    twice_by_point,
    weighted,
)
from doo_ti.vision.sampling import CAMERA_COLUMNS, SMALLEST, Projection, bent, bent_curvature, bent_slope, camera_table

NU = COLUMNS  # of E_proj's numbers the column of ν, after those of the edge integral
ASSIGNED_NU, EDGES, PLACES, SOFT, ASSIGNED_COLUMNS = range(CAMERA_COLUMNS, CAMERA_COLUMNS + 5)
"""Of E_back's numbers, after the columns of a row and camera: ν, edges, places of an edge, 1/h²."""


@typed
@dataclass(frozen=True)
class Reprojection(External):
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
    has_coarse: ClassVar[bool] = True

    def __post_init__(self) -> None:
        window, values, cameras = np.asarray(self.maps.window), self.maps.values, len(self.rig.cameras)
        if np.ndim(values) != 1 or np.asarray(values).dtype.kind != "f":
            raise InputError("maps", "values", f"shape {np.shape(values)}", "give all maps' distances as one vector")
        if window.ndim != 3 or window.shape[1:] != (cameras, 5):
            raise InputError("maps", "window", f"shape {window.shape}",
                             f"give (A, {cameras}, 5), a map for each camera of the rig")
        if window.dtype.kind not in "iu":
            raise InputError("maps", "window", f"dtype {window.dtype}", "give whole numbers")
        if ((window[..., 3:] < SMALLEST) | (window[..., 3:] > MOST_NUMBERS // SMALLEST)).any():
            raise InputError("maps", "window", f"{window[..., 3:].min()} to {window[..., 3:].max()} px across",
                             f"give windows of {SMALLEST} px or more that lie within the values")
        ends = window[..., 0] + window[..., 3] * window[..., 4]
        if (window[..., 0] < 0).any() or (ends > np.size(values)).any() or np.size(values) > MOST_NUMBERS:
            raise InputError("maps", "values", f"{np.size(values)} distances", f"give the {ends.max()} that the windows need")
        for name in ("nu", "cap", "reach"):
            value = getattr(self, name)
            number = isinstance(value, int | float | np.number) and np.isfinite(value)
            if not (number and (value >= 1e-12 or (name == "nu" and value == 0))):
                raise InputError("Reprojection", name, f"{value!r}", "give a positive, finite number")
        if not (isinstance(self.points, int | np.integer) and 1 <= self.points <= 64):
            raise InputError("Reprojection", "points", f"{self.points!r}", "give a whole number from 1 to 64")

    @property
    def count(self) -> int:
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

    @staticmethod
    def functions(number: Number) -> ExternalFunctions:
        energy = ImageEnergy(number)
        return ExternalFunctions(energy.load, energy.evaluate)


@device_functions
class ImageEnergy:
    """ν Σ_c E_proj^c of an edge for one kind of number."""

    def __init__(self, number):
        self.constant, self.edge = number.constant, EdgeIntegral(number)

    def load(self, own, numbers: ti.template(), row, edge, scale):
        own.images, own.nu = row, numbers[row, 0, NU] * scale

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


# --- E_back ----------------------------------------------------------------------------------------------------------------

POINT = 6  # numbers of a place in the field: q, √(w n nᵀ + w a t tᵀ) as a symmetric matrix (11, 12, 22), and w


@typed
@dataclass(frozen=True)
class AssignedPoints(External):
    """ν E_back as an external energy of :func:`doo_ti.relaxation.relax.relax`; ``external_index`` names the row of each rod.

    Raises InputError for shapes that do not match, and for numbers that are negative or not finite.
    """

    rig: Rig  # C cameras
    points: np.ndarray  # (R, C, E, K, 2) px, q of K places along each of E edges, at the middles of K equal parts
    tangent: np.ndarray  # (R, C, E, K, 2) unit vectors t
    weight: np.ndarray  # (R, C, E, K) w ≥ 0, px; zero where nothing was detected
    nu: float  # ν, energy (mm²) per px³
    along: float = 0.05  # a
    soft: float = 3.0  # h, px
    layout: ClassVar[Layout] = Layout(row=1, edge=1, nu=1)
    has_coarse: ClassVar[bool] = True

    def __post_init__(self) -> None:
        shape = np.shape(self.weight)
        if len(shape) != 4 or shape[1] != len(self.rig.cameras) or np.shape(self.points) != (*shape, 2):
            raise InputError("AssignedPoints", "points, weight", f"shapes {np.shape(self.points)} and {shape}",
                             f"give (R, {len(self.rig.cameras)}, E, K, 2) and (R, {len(self.rig.cameras)}, E, K)")
        if np.shape(self.tangent) != (*shape, 2):
            raise InputError("AssignedPoints", "tangent", f"shape {np.shape(self.tangent)}", f"give {(*shape, 2)}")
        if not (np.isfinite(self.points).all() and np.isfinite(self.tangent).all() and (np.asarray(self.weight) >= 0).all()):
            raise InputError("AssignedPoints", "points, tangent, weight", "not finite, or negative", "give weight 0 where none")
        for name, most in (("nu", np.inf), ("along", 1.0), ("soft", np.inf)):
            if not 0 < getattr(self, name) <= most:
                raise InputError("AssignedPoints", name, f"{getattr(self, name)!r}", "give a positive number")

    @property
    def count(self) -> int:
        return len(self.weight)

    @property
    def vertices(self) -> int:
        return self.weight.shape[2] + 1

    def numbers(self) -> np.ndarray:
        """(R, C, ASSIGNED_COLUMNS): cameras, ν, and how the field is laid out."""
        rows, cameras, edges, places = self.weight.shape
        table = np.empty((rows, cameras, ASSIGNED_COLUMNS))
        table[..., :CAMERA_COLUMNS] = camera_table(self.rig)
        table[..., CAMERA_COLUMNS:] = self.nu, edges, places, self.soft**-2
        return table

    def field(self) -> np.ndarray:
        """(R · E · C · K · POINT,) float32."""
        t = np.asarray(self.tangent, dtype=np.float64)
        n = normal_to(t)
        form = n[..., :, None] * n[..., None, :] + self.along * t[..., :, None] * t[..., None, :]
        table = np.concatenate([self.points, form[..., [0, 0, 1], [0, 1, 1]], self.weight[..., None]], axis=-1)
        return np.ascontiguousarray(table.swapaxes(1, 2), dtype=np.float32).reshape(-1)

    @staticmethod
    def functions(number: Number) -> ExternalFunctions:
        energy = AssignedEnergy(number)
        return ExternalFunctions(energy.load, energy.evaluate)


@device_functions
class AssignedEnergy:
    """ν E_back of an edge for one kind of number."""

    def __init__(self, number):
        self.constant, self.lane, self.with_lane = number.constant, number.lane, number.with_lane
        self.scalar, self.width = number.scalar, number.width
        self.projection = Projection(number)

    def load(self, own, numbers: ti.template(), row, edge, scale):
        own.row, own.edge, own.nu = row, edge, numbers[row, 0, ASSIGNED_NU] * scale

    def point(self, values: ti.template(), numbers: ti.template(), row, edge, c, k):
        """(q, form, w) of each rod's place k of its edge in camera c."""
        seen = record(point=repeated(0.0 * row, POINT))
        for slot in ti.static(range(self.width)):
            edges, places = ti.cast(numbers[0, 0, EDGES], ti.i32), ti.cast(numbers[0, 0, PLACES], ti.i32)
            line = ti.cast(self.lane(row, slot), ti.i32) * edges + ti.cast(self.lane(edge, slot), ti.i32)
            here = ((line * numbers.shape[1] + c) * places + k) * POINT
            put_lane(seen, self.with_lane, slot, point=(values[here], values[here + 1], values[here + 2], values[here + 3],
                                                        values[here + 4], values[here + 5]))
        return seen.point

    def place(self, lens, q, y, inverse_soft, coarse):
        """(E, ∂y, ∂yy) of w ρ at the place y in the camera's axes, whose point and weights are q."""
        x0, x1, inverse, seen = self.projection.normalised(lens, y)
        x, pixel = (x0, x1), bent(lens, x0, x1)
        j, t = bent_slope(lens, x0, x1), bent_curvature(lens, x0, x1)
        d0, d1 = pixel[0] - q[0], pixel[1] - q[1]
        pull = (q[2] * d0 + q[3] * d1, q[3] * d0 + q[4] * d1)
        root = ti.sqrt(1.0 + inverse_soft * (d0 * pull[0] + d1 * pull[1]))
        w = ti.select(seen, q[5], 0.0 * q[5])
        energy = 2.0 * w * (root - 1.0) / inverse_soft
        steep = 2.0 * w / root
        fade = 0.0 - steep * inverse_soft / (root * root)
        focal = (lens[0], lens[1])
        s = (focal[0] * steep * pull[0], focal[1] * steep * pull[1])
        h = plus(scaled((q[2], q[3], q[4]), steep), square_of(pull, fade))
        c = (focal[0] * focal[0] * h[0], focal[0] * focal[1] * h[1], focal[1] * focal[1] * h[2])
        slope = contracted(j, s)
        fine = 1.0 - coarse
        form = plus(congruent(c, j), scaled(contracted(t, s), fine))
        none = 0.0 * x0
        curvature = twice_by_point(form, (none, none), (fine * slope[0], fine * slope[1], none), x, inverse)
        return energy, by_point(slope, none, x, inverse), curvature

    def evaluate(self, own, numbers: ti.template(), values: ti.template(), start, end, coarse):
        nu, zero, camera = own.nu, self.constant(0.0), self.projection
        given, along = own.row, own.edge
        # A lane without a rod may hold any number, which must not be used as an index.
        there = (given >= 0.0) & (given < numbers.shape[0]) & (along >= 0.0) & (along < numbers[0, 0, EDGES])
        row, edge = ti.select(there, given, zero), ti.select(there, along, zero)
        inverse_soft = ti.cast(numbers[0, 0, SOFT], self.scalar)
        places = ti.cast(numbers[0, 0, PLACES], ti.i32)
        step = ti.cast(1.0 / numbers[0, 0, PLACES], self.scalar)
        total = no_moments(zero)
        for c in range(numbers.shape[1]):
            lens = camera.lens(numbers, c)
            a, d = camera.entered(numbers, c, start), camera.turned(numbers, c, minus(end, start))
            s = 0.5 * step
            seen = no_moments(zero)
            for k in range(places):
                q = self.point(values, numbers, row, edge, c, k)
                energy, slope, curvature = self.place(lens, q, plus(a, scaled(d, s)), inverse_soft, coarse)
                seen.energy = seen.energy + energy
                seen.gradient = added(seen.gradient, slope)
                seen.gradient_s = added(seen.gradient_s, scaled(slope, s))
                seen.curvature = added(seen.curvature, curvature)
                seen.curvature_s = added(seen.curvature_s, scaled(full(curvature), s))
                seen.curvature_ss = added(seen.curvature_ss, scaled(curvature, s * s))
                s += step
            add_turned_back(total, seen, camera, numbers, c)
        return weighted(total, nu)
