"""E_vis of rods against images, E + ν Σ_c E_proj^c: scored by the thousand, and minimised by F (§IV-A).

    maps = distance_maps(detections)
    score(vertices, maps, set_index, rig, nu, Material(bend=6e5, twist=8e5))  # Score, one entry per hypothesis
    relax(start, material, clamps, external=Reprojection(maps, rig, nu), external_index=set_index)  # F(Γ, E_vis, C)

E is in mm² (relative to weight, as everywhere), E_proj in px², so ν is in mm²/px² and goes with the cameras' resolution.
What counts is ν over the largest eigenvalue of B: for sutures seen at 6 px/mm 3e-5 1/(mm px²) leaves vertices 0.2 mm off
the truth, 3e-4 leaves 0.1 mm, 3e-3 leaves 0.05 mm.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import taichi as ti

from doo_ti import runtime
from doo_ti.errors import InputError
from doo_ti.physics.number import Number
from doo_ti.relaxation.columns import MOST_NUMBERS
from doo_ti.relaxation.external import ExternalFunctions
from doo_ti.types import Material, unit_up
from doo_ti.vision.distance_map import DistanceMaps
from doo_ti.vision.edge_integral import COLUMNS, POINTS, WINDOW, edge_integrals
from doo_ti.vision.projection import camera_table
from doo_ti.vision.rig import Rig
from doo_ti.vision.sampling import SMALLEST
from doo_ti.vision.score_kernel import score_kernel

NU = COLUMNS
"""The column of ν, after those of the edge integral."""


@dataclass(frozen=True)
class Reprojection:
    """ν Σ_c E_proj^c as an external energy of :func:`doo_ti.relaxation.relax.relax`, for rods of any number of edges.

    maps    of A sets of images; rods take turns with them as ``external_index`` says
    rig     the C cameras the maps are of
    nu      ν, mm²/px²
    points  n: at how many places along an edge the maps are read, for each camera
    cap     px: distances saturate there, so that a gap costs but does not veto
    reach   px: while steps are large, K is that of a parabola to the nearest detected line, or to this far from it

    In f32 pixels are known to 1e-4, and residuals do not fall below some ν/B of the largest eigenvalue of B, in 1/mm: ask for
    no smaller ``Newton(tolerance=...)``, or f64 does all over again what f32 could not finish.

    Raises InputError for maps of another number of cameras, for windows that are too small or lie outside the values, and
    for numbers out of range.
    """

    maps: DistanceMaps
    rig: Rig
    nu: float
    points: int = 4
    cap: float = 40.0
    reach: float = 2.0
    items: ClassVar[int] = 2
    start_items: ClassVar[int] = 0
    has_coarse: ClassVar[bool] = True
    vertices: ClassVar[None] = None

    def __post_init__(self):
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
    def functions(number, stride: int, first: int) -> ExternalFunctions:
        """On the device, with its items from ``first`` on: the set of images and ν."""
        put, constant = number.lanes().put, number.lanes().constant
        edge = edge_integrals(number)

        @ti.func
        def load(scratch: ti.template(), at, slot, numbers: ti.template(), row, edge, scale):
            put(scratch, at + first * stride, slot, row)
            put(scratch, at + (first + 1) * stride, slot, numbers[row, 0, NU] * scale)

        @ti.func
        def evaluate(scratch: ti.template(), at, numbers: ti.template(), values: ti.template(), start, end, coarse):
            nu = scratch[at + (first + 1) * stride]
            zero = constant(0.0)
            # A lane without a rod may hold anything, and must not look it up.
            asked = scratch[at + first * stride]
            known = (asked >= 0.0) & (asked < numbers.shape[0])
            row = ti.select(known, asked, zero)
            d = (end[0] - start[0], end[1] - start[1], end[2] - start[2])
            energy = zero
            g0, g1, g2, h0, h1, h2 = (zero, zero, zero, zero, zero, zero)
            k0, k1, k2, k3, k4, k5 = (zero, zero, zero, zero, zero, zero)
            l0, l1, l2, l3, l4, l5, l6, l7, l8 = (zero, zero, zero, zero, zero, zero, zero, zero, zero)
            m0, m1, m2, m3, m4, m5 = (zero, zero, zero, zero, zero, zero)
            for c in range(numbers.shape[1]):
                e, g_seen, h_seen, k_seen, l_seen, m_seen = edge.moments(
                    values, numbers, row, c, edge.window(numbers, row, c), edge.lens(numbers, c),
                    edge.entered(numbers, c, start), edge.turned(numbers, c, d), coarse)
                energy = energy + e
                g = edge.turned_back(numbers, c, g_seen)
                h = edge.turned_back(numbers, c, h_seen)
                k = edge.form_turned_back(numbers, c, k_seen)
                n = edge.matrix_turned_back(numbers, c, l_seen)
                m = edge.form_turned_back(numbers, c, m_seen)
                g0, g1, g2, h0, h1, h2 = (g0 + g[0], g1 + g[1], g2 + g[2], h0 + h[0], h1 + h[1], h2 + h[2])
                k0, k1, k2, k3, k4, k5 = (k0 + k[0], k1 + k[1], k2 + k[2], k3 + k[3], k4 + k[4], k5 + k[5])
                l0, l1, l2, l3, l4, l5 = (l0 + n[0], l1 + n[1], l2 + n[2], l3 + n[3], l4 + n[4], l5 + n[5])
                l6, l7, l8 = (l6 + n[6], l7 + n[7], l8 + n[8])
                m0, m1, m2, m3, m4, m5 = (m0 + m[0], m1 + m[1], m2 + m[2], m3 + m[3], m4 + m[4], m5 + m[5])
            return (
                nu * energy, (nu * g0, nu * g1, nu * g2), (nu * h0, nu * h1, nu * h2),
                (nu * k0, nu * k1, nu * k2, nu * k3, nu * k4, nu * k5),
                (nu * l0, nu * l1, nu * l2, nu * l3, nu * l4, nu * l5, nu * l6, nu * l7, nu * l8),
                (nu * m0, nu * m1, nu * m2, nu * m3, nu * m4, nu * m5),
            )

        return ExternalFunctions(load, evaluate)


@dataclass(frozen=True)
class Score:
    """E_vis of N hypotheses, term by term.

    energy        (N,) E of the rod itself, mm²: bend and gravity, without twist; zero without a material
    camera_error  (N, C) E_proj of each camera, px²
    total         (N,) E_vis = E + ν Σ_c E_proj, mm²; NaN where a vertex is not finite
    unseen        (N, C) share of the rod that a camera cannot see, for being behind it: its error says nothing then
    """

    energy: np.ndarray
    camera_error: np.ndarray
    total: np.ndarray
    unseen: np.ndarray


@runtime.exclusive
def score(
    vertices: np.ndarray, maps: DistanceMaps, set_index, rig: Rig, nu: float, material: Material | None = None,
    *, material_index=None, points: int = 8, cap: float = 40.0, up=(0.0, 0.0, 1.0),
) -> Score:
    """E_vis of N hypotheses (§IV-A), in f32: terms are good to six digits.

    vertices        (N, V, 3) mm, float32 or float64; of relaxed rods ``configuration.vertices``
    set_index       (N,) which of the A sets of images each hypothesis is compared with, or one for all
    material        isotropic, G rows: then E is that of the rod without twist, which a free end leaves it; None: no E
    material_index  (N,) its row for each hypothesis; without it one row for all, or one each
    up              (3,) direction against gravity, of length one

    ``maps``, ``rig``, ``nu``, ``points`` and ``cap`` are those of :class:`Reprojection`. The same hypothesis has the same
    score in any company. Raises InputError for shapes that do not match, rows out of range, and another material.
    """
    reprojection = Reprojection(maps, rig, nu, points, cap)
    vertices = np.asarray(vertices)
    if vertices.dtype not in (np.float32, np.float64):
        vertices = vertices.astype(np.float64)
    if vertices.ndim != 3 or vertices.shape[1] < 2 or vertices.shape[2] != 3 or vertices.size > MOST_NUMBERS:
        raise InputError("score", "vertices", f"shape {vertices.shape}", f"give (N, V, 3), at most {MOST_NUMBERS:,} numbers")
    count, cameras = len(vertices), len(rig.cameras)
    sets = _rows("set_index", set_index, count, reprojection.count)
    stiffness = _stiffness(material)
    every = np.arange(count) if len(stiffness) == count else 0
    rows = _rows("material_index", every if material_index is None else material_index, count, len(stiffness))
    if material_index is None and len(stiffness) not in (1, count):
        raise InputError("score", "material", f"{len(stiffness)} rows for {count} hypotheses", "give one, or one for each")
    result = np.empty((count, 1 + 2 * cameras), dtype=np.float32)
    up = unit_up(up, "score")
    on_cpu = runtime.start() == "cpu"
    kernel = score_kernel(Number(16 if on_cpu else 1, 32), 1 if on_cpu else 64, vertices.dtype.itemsize * 8)
    if count:
        kernel(np.ascontiguousarray(vertices), sets, rows, stiffness, *map(float, up), reprojection.numbers(),
               reprojection.field(), result)
    energy, errors, unseen = np.split(result.astype(np.float64), [1, 1 + cameras], axis=1)
    return Score(energy[:, 0], errors, energy[:, 0] + nu * errors.sum(axis=1), unseen)


def _rows(name: str, index, count: int, size: int) -> np.ndarray:
    """(N,) int32 row numbers below ``size``; one stands for all."""
    index = np.asarray(index)
    if index.dtype.kind not in "iu" or index.shape not in ((), (count,)):
        raise InputError("score", name, f"dtype {index.dtype}, shape {index.shape}", f"give one row, or ({count},) of them")
    if index.size and not 0 <= index.min() <= index.max() < size:
        raise InputError("score", name, "rows out of range", f"give whole numbers from 0 to {size - 1}")
    return np.ascontiguousarray(np.broadcast_to(index, count), dtype=np.int32)


def _stiffness(material: Material | None) -> np.ndarray:
    """(G, 2) α and μ. Raises InputError for a material whose energy vertices do not tell."""
    if material is None:
        return np.zeros((1, 2))
    if not material.is_isotropic:
        raise InputError("score", "material", "not isotropic", "give one α and no rest curvature: E is that of vertices")
    return np.ascontiguousarray(np.stack([material.bend[:, 0, 0, 0], material.weight], axis=-1))


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
        raise InputError("maps", "values", f"{np.size(maps.values)} distances", f"give the {ends.max()} that the windows name")
