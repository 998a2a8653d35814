"""E_vis = E + ν Σ_c E_proj^c of thousands of hypotheses, E of rods without twist (§IV-A).

    maps = distance_maps(detections)
    score(vertices, maps, set_index, rig, nu, Material(bend=6e5, twist=8e5))  # Score, one entry per hypothesis
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
import taichi as ti
from numpy.typing import ArrayLike

from doo_ti.physics.number import Number, device_functions
from doo_ti.physics.tuples import cross, dot, minus, put_lane, record, repeated, variable
from doo_ti.relaxation.tables import MOST_NUMBERS
from doo_ti.rod.types import Material, unit_up
from doo_ti.system import runtime
from doo_ti.system.arguments import short_repr, typed
from doo_ti.system.errors import InputError
from doo_ti.vision.cameras import Rig
from doo_ti.vision.distance_map import DistanceMaps
from doo_ti.vision.edge_integral import EdgeIntegral
from doo_ti.vision.image_energy import Reprojection


@dataclass(frozen=True)
class Score:
    """E_vis of N hypotheses, term by term.

    energy        (N,) E of the rod itself, mm²: bend and gravity, without twist; zero without a material
    camera_error  (N, C) E_proj of each camera, px²
    total         (N,) E_vis = E + ν Σ_c E_proj, mm²; NaN where a vertex is not finite
    unseen        (N, C) share of the rod that is behind a camera; where it is not 0, the camera's error has no meaning
    """

    __repr__ = short_repr

    energy: np.ndarray
    camera_error: np.ndarray
    total: np.ndarray
    unseen: np.ndarray


@typed
@runtime.exclusive
def score(
    vertices: np.ndarray, maps: DistanceMaps, set_index: ArrayLike, rig: Rig, nu: float, material: Material | None = None,
    *, material_index: ArrayLike | None = None, points: int = 8, cap: float = 40.0, up: ArrayLike = (0.0, 0.0, 1.0),
) -> Score:
    """E_vis of N hypotheses (§IV-A), in f32, with six correct digits.

    vertices        (N, V, 3) mm, float32 or float64; of relaxed rods ``configuration.vertices``
    set_index       (N,) the set of images, of A, that each hypothesis is compared with, or one for all
    material        isotropic, G rows: E is that of a rod with a free end, which has no twist; None: no E
    material_index  (N,) row of the material of each hypothesis; without it one row for all, or one each
    up              (3,) direction against gravity, of length one

    ``maps``, ``rig``, ``nu``, ``points`` and ``cap`` are those of :class:`Reprojection`. E is not divided by α, as it is in
    :func:`doo_ti.perception.perceive.perceive`: with its ν give ν α. The score of a hypothesis does not
    depend on the others. Raises InputError for shapes that do not match, rows out of range, and materials that are not
    isotropic.
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
    """(G, 2) α and μ. Raises InputError for a material whose energy does not follow from vertices alone."""
    if material is None:
        return np.zeros((1, 2))
    if not material.is_isotropic:
        raise InputError("score", "material", "not isotropic", "give one α and no rest curvature: E is computed from vertices")
    return np.ascontiguousarray(np.stack([material.bend[:, 0, 0, 0], material.weight], axis=-1))


@device_functions
class Scoring:
    """The terms of E_vis of a pack of hypotheses, ``first`` and those after it, for one kind of number."""

    def __init__(self, number: Number):
        self.lane, self.with_lane, self.constant = number.lane, number.with_lane, number.constant
        self.width, self.scalar = number.width, number.scalar
        self.edge = EdgeIntegral(number)

    def vertex(self, vertices: ti.template(), first, v):
        """Vertex v of the pack's hypotheses; the last hypothesis fills an incomplete pack."""
        found = record(x=repeated(self.constant(0.0), 3))
        for slot in ti.static(range(self.width)):
            rod = ti.min(first + slot, vertices.shape[0] - 1)
            put_lane(found, self.with_lane, slot, x=(vertices[rod, v, 0], vertices[rod, v, 1], vertices[rod, v, 2]))
        return found.x

    def rows(self, set_index: ti.template(), material_index: ti.template(), stiffness: ti.template(), first):
        """(set, α, μ) of the pack's hypotheses."""
        zero = self.constant(0.0)
        found = record(row=zero, alpha=zero, mu=zero)
        for slot in ti.static(range(self.width)):
            rod = ti.min(first + slot, set_index.shape[0] - 1)
            put_lane(found, self.with_lane, slot, row=set_index[rod], alpha=stiffness[material_index[rod], 0],
                     mu=stiffness[material_index[rod], 1])
        return found.row, found.alpha, found.mu

    def rod_energy(self, vertices: ti.template(), first, alpha, mu, up):
        """Σ α |κb|²/l̄ + μ Σ z l̄ (§III-C), κb = 2 e × e'/(|e| |e'| + e·e')."""
        energy, before = self.constant(0.0), self.constant(0.0)
        a = self.vertex(vertices, first, 0)
        edge = variable(repeated(self.constant(0.0), 3))  # the one before
        for v in range(1, vertices.shape[1]):
            b = self.vertex(vertices, first, v)
            d = minus(b, a)
            length = ti.sqrt(dot(d, d))
            energy = energy + mu * length * (dot(up, a) + dot(up, b))
            if v > 1:
                normal = cross(edge, d)
                bottom = before * length + dot(edge, d)
                energy = energy + 4.0 * alpha * dot(normal, normal) / (bottom * bottom * (before + length))
            a, edge = b, d
            before = length
        return energy

    def camera_error(self, vertices: ti.template(), first, view):
        """(E_proj in the camera of ``view``, share unseen)."""
        camera = self.edge.projection
        total, unseen = (self.constant(0.0), self.constant(0.0))
        a = variable(camera.entered(view.numbers, view.c, self.vertex(vertices, first, 0)))
        for v in range(1, vertices.shape[1]):
            b = camera.entered(view.numbers, view.c, self.vertex(vertices, first, v))
            error, hidden = self.edge.error(view, a, minus(b, a))
            total = total + error
            unseen = unseen + hidden
            a = b
        return total, unseen / ti.cast(vertices.shape[1] - 1, self.scalar)


@cache
def score_kernel(number: Number, block: int, bits: int):
    """The compiled-on-first-use kernel for one kind of number, ``block`` threads in a block, and vertices of ``bits`` bits."""
    scoring, width = Scoring(number), number.width

    @runtime.kernel
    def scored(
        vertices: ti.types.ndarray(dtype=ti.f32 if bits == 32 else ti.f64, ndim=3),  # [hypothesis, vertex, 3] mm
        set_index: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [hypothesis]
        material_index: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [hypothesis]
        stiffness: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [material, (α, μ)]
        up0: ti.f32,
        up1: ti.f32,
        up2: ti.f32,
        numbers: ti.types.ndarray(dtype=ti.f64, ndim=3),  # [set, camera, COLUMNS or more]
        values: ti.types.ndarray(dtype=ti.f32, ndim=1),  # distances, px
        result: ti.types.ndarray(dtype=ti.f32, ndim=2),  # [hypothesis, (energy, errors, shares unseen)] out
    ):
        ti.loop_config(block_dim=block)
        for pack in range((vertices.shape[0] + width - 1) // width):
            first = pack * width
            cameras = numbers.shape[1]
            row, alpha, mu = scoring.rows(set_index, material_index, stiffness, first)
            energy = scoring.rod_energy(vertices, first, alpha, mu, (up0, up1, up2))
            for slot in range(width):
                result[ti.min(first + slot, vertices.shape[0] - 1), 0] = scoring.lane(energy, slot)
            for c in range(cameras):
                error, unseen = scoring.camera_error(vertices, first, scoring.edge.view(numbers, values, row, c))
                for slot in range(width):
                    rod = ti.min(first + slot, vertices.shape[0] - 1)
                    result[rod, 1 + c] = scoring.lane(error, slot)
                    result[rod, 1 + cameras + c] = scoring.lane(unseen, slot)

    return scored
