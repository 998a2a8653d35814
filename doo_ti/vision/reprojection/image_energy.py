"""ν Σ_c E_proj^c, which images add to a rod's energy E: F minimises E_vis = E + ν Σ_c E_proj^c (§IV-A).

    maps = distance_maps(detections)
    relax(start, material, clamps, external=Reprojection(maps, rig, nu), external_index=set_index)  # F(Γ, E_vis, C)

E is in mm² (relative to weight, as everywhere), E_proj in px², so ν is in mm²/px² and depends on the cameras' resolution.
Results depend on ν over the largest eigenvalue of B: for sutures seen at 6 px/mm, 3e-5 1/(mm px²) gives vertices 0.2 mm off
the truth, 3e-4 gives 0.1 mm, 3e-3 gives 0.05 mm.

How much of the detected line a rod explains, in each image: evidence from the image to the rod (§IV-A).

    E_cover = Σ_q min(|q − image of the rod|, cap) · 1 px        over the detected points q, one per pixel of line

It is the counterpart of E_proj, which sums distances from the rod's image to the detection: a rod that leaves thread
unexplained costs as much there as a rod of that image length without detection costs in E_proj.

Axes: A image sets, C cameras, R rods, V vertices.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import taichi as ti

from doo_ti.physics.number import Layout, Number
from doo_ti.physics.tuples import minus
from doo_ti.relaxation.external import External, ExternalFunctions
from doo_ti.relaxation.tables import MOST_NUMBERS
from doo_ti.system import runtime
from doo_ti.system.arguments import typed
from doo_ti.system.errors import InputError
from doo_ti.vision.cameras.rig import Rig
from doo_ti.vision.detection.line import Detection, thinned
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
from doo_ti.vision.reprojection.triangulation import rays

NU = COLUMNS  # the column of ν, after those of the edge integral


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


NEAR_PX = 3.0  # A detected point this near to the rod's image is explained


@dataclass(frozen=True)
class Coverage:
    """Of R rods.

    share  (R, C) of the detected points within NEAR_PX of the rod's image
    error  (R, C) E_cover, px²
    line   (R, C) px of detected line
    """

    share: np.ndarray
    error: np.ndarray
    line: np.ndarray


@runtime.exclusive
def coverage(rig: Rig, vertices: np.ndarray, of_set: np.ndarray, detections: list[list[Detection]], cap: float) -> Coverage:
    """Of rods with ``vertices`` (R, V, 3) mm, each of the set ``of_set`` (R,) of ``detections`` (A lists of C). Distances
    saturate at ``cap`` px. What a camera does not see explains nothing."""
    flat = [thinned(found)[0] for images in detections for found in images]
    first = np.cumsum([0, *(len(points) for points in flat)]).astype(np.int32)
    image = np.ascontiguousarray(np.nan_to_num(np.moveaxis(rig.project(vertices), 0, 1), nan=1e9), dtype=np.float32)
    result = np.zeros((*image.shape[:2], 2), dtype=np.float32)
    runtime.start()
    _explained(np.concatenate([*flat, np.zeros((1, 2))]).astype(np.float32), first, of_set.astype(np.int32), image, cap, result)
    lengths = np.diff(first).reshape(len(detections), -1)[of_set]
    return Coverage(result[..., 0] / np.maximum(lengths, 1), result[..., 1].astype(np.float64), lengths.astype(np.float64))


def outside_others(rig: Rig, vertices: np.ndarray, detections: list[list[Detection]]) -> np.ndarray:
    """(A, C) share of the line detected in each camera that one rod of each set, ``vertices`` (A, V, 3) mm, leaves unexplained
    because no other camera's image shows it: at the depth of the nearest vertex it is outside all of these."""
    found = np.zeros((len(vertices), len(rig.cameras)))
    for row, rod in enumerate(vertices):
        if not np.isfinite(rod).all():
            continue
        for c, camera in enumerate(rig.cameras):
            points = thinned(detections[row][c])[0]
            apart = np.linalg.norm(points[:, None] - np.nan_to_num(camera.project(rod), nan=1e9), axis=-1)
            ray = rays(camera, points)
            there = camera.centre + ray * (camera.depth(rod)[apart.argmin(axis=1)] / (ray @ camera.rotation[2]))[:, None]
            alone = apart.min(axis=1) > NEAR_PX
            for other in rig.cameras[:c] + rig.cameras[c + 1 :]:
                middle = 0.5 * np.array([other.width - 1, other.height - 1])
                alone &= ~((np.abs(other.project(there) - middle) <= middle + 0.5).all(axis=1))
            found[row, c] = alone.mean() if len(rig.cameras) > 1 else 0.0
    return found


@runtime.kernel
def _explained(
    points: ti.types.ndarray(dtype=ti.f32, ndim=2),  # [point, x y], image by image
    first: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [image + 1]
    of_set: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [rod]
    image: ti.types.ndarray(dtype=ti.f32, ndim=4),  # [rod, camera, vertex, x y]
    cap: ti.f32,
    result: ti.types.ndarray(dtype=ti.f32, ndim=3),  # [rod, camera, (points explained, E_cover)] out
):
    cameras = image.shape[1]
    for pair in range(image.shape[0] * cameras):
        rod, c = pair // cameras, pair % cameras
        near, error = 0.0, 0.0
        for k in range(first[of_set[rod] * cameras + c], first[of_set[rod] * cameras + c + 1]):
            x, y, least = points[k, 0], points[k, 1], cap * cap
            for v in range(image.shape[2] - 1):
                ax, ay = image[rod, c, v, 0], image[rod, c, v, 1]
                dx, dy = image[rod, c, v + 1, 0] - ax, image[rod, c, v + 1, 1] - ay
                along = ti.min(ti.max(((x - ax) * dx + (y - ay) * dy) / ti.max(dx * dx + dy * dy, 1e-12), 0.0), 1.0)
                ox, oy = x - ax - along * dx, y - ay - along * dy
                least = ti.min(least, ox * ox + oy * oy)
            distance = ti.sqrt(least)
            near += ti.select(distance <= NEAR_PX, 1.0, 0.0)
            error += distance
        result[rod, c, 0], result[rod, c, 1] = near, error
