"""Algorithm 1: from images to rods, edge by edge (§IV-A).

A thin, uniform thread that crosses itself fits many curves; energy decides. Every step grows each hypothesis by several edges
chosen from the images alone, relaxes all of them under E_vis, of all image sets together, and keeps those that score best and
differ.

    E_vis = E / B + ν Σ_c E_proj                                                                        (§IV-A)

with E_proj in px² (a projected edge's mean distance to the nearest detected pixel, times its length), and the rod's energy E
over the largest eigenvalue of B, in 1/mm: so ν is in 1/(mm px²) and keeps its meaning whatever the rod's stiffness is.

Axes: A image sets, C cameras, N hypotheses of all sets, M sampled directions, E edges, V vertices, K runners-up.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from doo_ti.errors import InputError
from doo_ti.frames import (
    across,
    bishop_frames,
    matrix_from_quaternion,
    quaternion_from_matrix,
    quaternion_product,
    smallest_rotation,
    tangent_from_quaternion,
)
from doo_ti.growth import sampled_directions, select_hypotheses, suppress_similar
from doo_ti.newton import Newton
from doo_ti.relaxation import relax
from doo_ti.types import Clamp, Clamps, Configuration, Material, Status
from doo_ti.vision.distance_map import DistanceMaps
from doo_ti.vision.reprojection import Reprojection, score
from doo_ti.vision.rig import Rig


@dataclass(frozen=True)
class PerceptionOptions:
    """How Algorithm 1 searches.

    nu                   ν, 1/(mm px²): what a pixel's distance along a pixel weighs against energy over stiffness
    hypotheses           H: kept per image set and step
    samples              M: directions tried for a new edge, evenly over the half sphere before the last one
    separation           rad: of sampled directions this near to each other only the best is grown
    children             edges grown from one hypothesis at most
    similar_distance     mm: hypotheses whose last vertices are this near …
    similar_angle        rad: … and whose last edges differ by less are one; the better one stays
    points               places along an edge where a map is read while growing
    final_points         the same for the last relaxation and the scores it gives
    cap                  px: distances to the detection saturate there
    growing_iterations   Newton's, at most, in each step of growth: the next step goes on from there
    finalists            hypotheses of each set that are relaxed to the end
    runners_up           K: rods other than the best that are told
    unsupported          px: an edge further than this from the detection, on average, in every camera is not seen
    """

    nu: float = 0.005
    hypotheses: int = 40
    samples: int = 160
    separation: float = np.radians(20.0).item()
    children: int = 5
    similar_distance: float = 1.0
    similar_angle: float = np.radians(15.0).item()
    points: int = 3
    final_points: int = 8
    cap: float = 40.0
    growing_iterations: int = 6
    finalists: int = 8
    runners_up: int = 4
    unsupported: float = 3.0

    def __post_init__(self):
        for name in ("nu", "separation", "similar_distance", "similar_angle", "cap", "unsupported"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise InputError("PerceptionOptions", name, f"{getattr(self, name)}", "give a positive number")
        for name in ("hypotheses", "samples", "children", "points", "final_points", "growing_iterations", "finalists"):
            if getattr(self, name) < 1:
                raise InputError("PerceptionOptions", name, f"{getattr(self, name)}", "give 1 or more")


@dataclass(frozen=True)
class Hypotheses:
    """Rods that grow: i edges each, and what they score.

    of_set       (N,) image set, in increasing order
    quaternions  (N, i, 4) frames
    energy_vis   (N,) E_vis, 1/mm
    """

    of_set: np.ndarray
    quaternions: np.ndarray
    energy_vis: np.ndarray

    def take(self, rows: np.ndarray) -> "Hypotheses":
        """The hypotheses named by ``rows``, in that order."""
        return Hypotheses(self.of_set[rows], self.quaternions[rows], self.energy_vis[rows])


@dataclass(frozen=True)
class Perception:
    """What the images of A sets say.

    configuration        the best rod of each set
    energy_vis           (A,) its E_vis, 1/mm
    camera_error         (A, C) px: its distance to the detection, mean along it, in each camera
    status               (A,) Status of its last relaxation
    runner_up            (A, K, V, 3) mm: the next best rods that differ from all better ones; NaN where there are fewer
    runner_up_energy     (A, K) their E_vis, infinite where there are none
    edge_error           (A, C, E) px: distance to the detection along each edge of the best rod
    unsupported          (A, E) edges that no camera sees on the detection
    """

    configuration: Configuration
    energy_vis: np.ndarray
    camera_error: np.ndarray
    status: np.ndarray
    runner_up: np.ndarray
    runner_up_energy: np.ndarray
    edge_error: np.ndarray
    unsupported: np.ndarray

    @property
    def gap(self) -> np.ndarray:
        """(A,) by how much the best of the others is worse, over the best: 0 is a draw, 1 is twice the score."""
        return (self.runner_up_energy.min(axis=1, initial=np.inf) - self.energy_vis) / np.abs(self.energy_vis)


@dataclass(frozen=True)
class Search:
    """What does not change while hypotheses grow."""

    maps: DistanceMaps
    rig: Rig
    point: np.ndarray
    direction: np.ndarray
    rest_length: np.ndarray
    material: Material
    up: np.ndarray
    options: PerceptionOptions
    scale: float = field(init=False)

    def __post_init__(self):
        object.__setattr__(self, "scale", float(np.linalg.eigvalsh(self.material.bend).max()))

    def seen(self, points: int) -> Reprojection:
        """ν Σ E_proj in the units of the rod's energy."""
        return Reprojection(self.maps, self.rig, self.options.nu * self.scale, points, self.options.cap)


def perceive(
    maps: DistanceMaps, rig: Rig, point, direction, rest_length, material: Material, *, up=(0.0, 0.0, 1.0),
    options: PerceptionOptions = PerceptionOptions(), on_step: Callable[[int, Hypotheses], None] | None = None,
) -> Perception:
    """Recover the rods in A sets of images (Alg. 1).

    maps         what was detected, as distances
    point        (A, 3) mm, v⁰
    direction    (A, 3) of e⁰; any length
    rest_length  (E,) mm
    material     one Θ for all
    on_step      called with the number of edges and the hypotheses kept, after each step

    Raises InputError for shapes that do not match, fewer than two edges, and more than one material.
    """
    search = _checked(maps, rig, point, direction, rest_length, material, up, options)
    kept = _seedlings(search)
    for edges in range(2, len(search.rest_length) + 1):
        grown = _relaxed(search, _grown(search, kept), options.points, Newton(
            max_iterations=options.growing_iterations, tolerance=1e-3), "f32")
        kept = _selected(search, grown, options.hypotheses)
        if on_step is not None:
            on_step(edges, kept)
    return _result(search, kept)


def _checked(maps, rig, point, direction, rest_length, material, up, options) -> Search:
    sets = len(maps.window)
    point, direction = (np.atleast_2d(np.asarray(value, dtype=np.float64)) for value in (point, direction))
    for name, value in (("point", point), ("direction", direction)):
        if value.shape != (sets, 3) or not np.isfinite(value).all():
            raise InputError("perceive", name, f"shape {value.shape}", f"give ({sets}, 3) finite numbers, a row for each set")
    length = np.linalg.norm(direction, axis=-1, keepdims=True)
    if not (length > 0).all():
        raise InputError("perceive", "direction", "no direction", "give a vector along the first edge")
    rest_length = np.asarray(rest_length, dtype=np.float64)
    if rest_length.ndim != 1 or len(rest_length) < 2 or not (np.isfinite(rest_length) & (rest_length > 0)).all():
        raise InputError("perceive", "rest_length", f"shape {rest_length.shape}", "give two or more lengths (E,) in mm")
    if material.count != 1:
        raise InputError("perceive", "material", f"{material.count} rows", "give one material")
    return Search(maps, rig, point, direction / length, rest_length, material, np.asarray(up, dtype=np.float64), options)


def _seedlings(search: Search) -> Hypotheses:
    """One hypothesis of one edge for each set: v⁰ and e⁰ as given, its spin any."""
    frames = bishop_frames(search.direction[:, None], across(search.direction))
    count = len(frames)
    return Hypotheses(np.arange(count), quaternion_from_matrix(frames), np.zeros(count))


def _grown(search: Search, kept: Hypotheses) -> Hypotheses:
    """Each hypothesis with each of the edges that the images propose, by their error alone."""
    options = search.options
    edges = kept.quaternions.shape[1]
    length = search.rest_length[edges]
    tip = _vertices(search, kept)[:, -1]
    last = kept.quaternions[:, -1]
    local = sampled_directions(options.samples)
    # R(q) d for each sampled d: rotate the coordinate axes, not each direction.
    axes = matrix_from_quaternion(last)
    around = local @ np.swapaxes(axes, -1, -2)
    ends = tip[:, None] + length * around
    segments = np.stack([np.broadcast_to(tip[:, None], ends.shape), ends], axis=2).reshape(-1, 2, 3)
    found = score(segments, search.maps, np.repeat(kept.of_set, len(local)), search.rig, 1.0, points=options.points,
                  cap=options.cap)
    error = found.camera_error.sum(axis=1).reshape(len(tip), -1)
    chosen = suppress_similar(error, local, options.separation, options.children)
    parent, place = np.nonzero(chosen >= 0)
    toward = around[parent, chosen[parent, place]]
    turn = smallest_rotation(tangent_from_quaternion(last[parent]), toward)
    new = quaternion_product(turn, last[parent])
    quaternions = np.concatenate([kept.quaternions[parent], new[:, None]], axis=1)
    return Hypotheses(kept.of_set[parent], quaternions, kept.energy_vis[parent])


def _relaxed(search: Search, grown: Hypotheses, points: int, solver: Newton, precision: str) -> Hypotheses:
    """F(Γ, E_vis, C) of all hypotheses at once."""
    return _solved(search, grown, points, solver, precision)[0]


def _solved(search: Search, grown: Hypotheses, points: int, solver: Newton, precision: str):
    """(relaxed hypotheses, Solution)."""
    count, edges = grown.quaternions.shape[:2]
    point = search.point[grown.of_set]
    frame = np.broadcast_to(np.eye(3), (count, 3, 3)).copy()
    first = bishop_frames(search.direction[:, None], across(search.direction))[:, 0]
    clamps = Clamps(Clamp.TANGENT, Clamp.FREE, point, point, first[grown.of_set], frame)
    start = Configuration(point, grown.quaternions, search.rest_length[:edges])
    solution = relax(start, search.material, clamps, solver, up=search.up, precision=precision,
                     external=search.seen(points), external_index=grown.of_set)
    energy = np.where(solution.status == Status.NOT_FINITE, np.inf, solution.energy / search.scale)
    return Hypotheses(grown.of_set, solution.configuration.quaternions, energy), solution


def _selected(search: Search, grown: Hypotheses, most: int) -> Hypotheses:
    """The best that differ, at most ``most`` of each set."""
    options = search.options
    direction = tangent_from_quaternion(grown.quaternions[:, -1])
    return grown.take(select_hypotheses(
        grown.energy_vis, _vertices(search, grown)[:, -1], direction, grown.of_set, most, options.similar_distance,
        options.similar_angle))


def _vertices(search: Search, hypotheses: Hypotheses) -> np.ndarray:
    """(N, i + 1, 3) mm."""
    edges = hypotheses.quaternions.shape[1]
    return Configuration(search.point[hypotheses.of_set], hypotheses.quaternions, search.rest_length[:edges]).vertices


def _result(search: Search, kept: Hypotheses) -> Perception:
    """The finalists of each set relaxed to the end, and what the best of them are."""
    options = search.options
    last = kept.take(_best_of_each(kept, options.finalists))
    final, solution = _solved(search, last, options.final_points, Newton(), "mixed")
    rows = _ranked(search, final)
    best = np.maximum(rows[:, 0], 0)
    vertices = _vertices(search, final)
    others = rows[:, 1 : 1 + options.runners_up]
    runner_up = np.where((others >= 0)[..., None, None], vertices[others], np.nan)
    rod = solution.configuration.take(best)
    edge_error = _edge_error(search, rod.vertices)
    lengths = search.rest_length / search.rest_length.sum()
    return Perception(
        configuration=rod,
        energy_vis=final.energy_vis[best],
        camera_error=edge_error @ lengths,
        status=solution.status[best],
        runner_up=runner_up,
        runner_up_energy=np.where(others >= 0, final.energy_vis[others], np.inf),
        edge_error=edge_error,
        unsupported=(edge_error > options.unsupported).all(axis=1),
    )


def _best_of_each(kept: Hypotheses, most: int) -> np.ndarray:
    """Rows of the first ``most`` of each set: they come set by set and the best first."""
    _, first, count = np.unique(kept.of_set, return_index=True, return_counts=True)
    rank = np.arange(len(kept.of_set)) - np.repeat(first, count)
    return np.flatnonzero(rank < most)


def _ranked(search: Search, final: Hypotheses) -> np.ndarray:
    """(A, F) rows of each set's rods, the best first, without those that are as good as a better one; then −1."""
    sets, first, count = np.unique(final.of_set, return_index=True, return_counts=True)
    ranked = np.full((len(sets), count.max()), -1)
    vertices = _vertices(search, final)
    order = np.lexsort((final.energy_vis, final.of_set))
    taken = np.zeros(len(sets), dtype=np.int64)
    # Round by round the next best of every set, unless a better one runs along it.
    for rank in range(count.max()):
        here = np.flatnonzero(rank < count)
        rows = order[first[here] + rank]
        better = ranked[here]
        apart = np.linalg.norm(vertices[rows][:, None] - vertices[better], axis=-1).mean(axis=-1)
        new = ~((apart < search.options.similar_distance) & (better >= 0)).any(axis=1) & np.isfinite(final.energy_vis[rows])
        ranked[here[new], taken[here[new]]] = rows[new]
        taken[here[new]] += 1
    return ranked


def _edge_error(search: Search, vertices: np.ndarray) -> np.ndarray:
    """(A, C, E) px: mean distance to the detection along the image of each edge."""
    sets, marks = vertices.shape[:2]
    edges = np.stack([vertices[:, :-1], vertices[:, 1:]], axis=2).reshape(-1, 2, 3)
    found = score(edges, search.maps, np.repeat(np.arange(sets), marks - 1), search.rig, 1.0,
                  points=search.options.final_points, cap=search.options.cap)
    pixels = np.linalg.norm(np.diff(search.rig.project(edges), axis=2)[:, :, 0], axis=-1)
    return np.swapaxes((found.camera_error.T / np.maximum(pixels, 1e-9)).reshape(len(pixels), sets, marks - 1), 0, 1)
