"""Algorithm 1: from images to rods, edge by edge (§IV-A).

    Γ ← v⁰, e⁰                                                       Search.initial_hypotheses
    for i = 1 … E − 1:
        sample e^i, e^i·e^{i−1} > 0; keep the best that differ       Search.grown
        Γ ← F(Γ, E_vis, C)                                           Search.nearly_relaxed
        keep the H hypotheses of least E_vis that differ             Search.selected
    the Γ of least E_vis after F(Γ, E_vis, C)                        Search.relaxed

Beyond the paper, rods that are traced along the detected lines join the last hypotheses, these are relaxed on a finer mesh, and
evidence counts both ways in their E_vis (:mod:`doo_ti.perception.search`). All image sets are searched at once.

    found = perceive(maps, rig, point, direction, rest_length, Material(bend=6e5, twist=8e5))
    found.vertices    # (A, V, 3) mm

Axes: A image sets, C cameras, N hypotheses of all sets, E edges, V vertices, K runners-up.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from doo_ti.contact.surroundings import Surroundings
from doo_ti.perception.growth import rank_distinct
from doo_ti.perception.search import Finalists, Hypotheses, PerceptionOptions, Search, evidence, finalists, left_over
from doo_ti.perception.verdict import Perception
from doo_ti.rod.types import LARGEST, Material, Status, put_rods, unit_up
from doo_ti.system.arguments import typed
from doo_ti.system.errors import InputError
from doo_ti.vision.cameras import Rig
from doo_ti.vision.distance_map import DistanceMaps, Misread, misread


@typed
def perceive(
    maps: DistanceMaps, rig: Rig, point: ArrayLike, direction: ArrayLike, rest_length: ArrayLike, material: Material, *,
    up: ArrayLike = (0.0, 0.0, 1.0),
    options: PerceptionOptions = PerceptionOptions(), on_step: Callable[[int, Hypotheses, Hypotheses], None] | None = None,
    surroundings: Surroundings = Surroundings(), start_sigma: ArrayLike = 0.0,
) -> Perception:
    """Recover the rods in A sets of images (Alg. 1).

    maps         distances to the detected lines, from :func:`doo_ti.vision.distance_map.distance_maps`
    rig          the C calibrated cameras
    point        (A, 3) mm, the first vertex v⁰
    direction    (A, 3) direction of the first edge e⁰; any length
    rest_length  (E,) mm
    material     one Θ for all rods
    up           (3,) direction against gravity; any length
    on_step      called with the number of edges, the hypotheses kept and those pruned, after each step
    surroundings obstacles that all rods may touch but not enter, and their radius
    start_sigma  (A,) mm: standard deviation of each ``point``, root mean square over the coordinates. It counts in that of
                 the rod, whose start the last relaxation may then move; 0: point and direction are exact

    Raises InputError for shapes that do not match, fewer than two edges, more than one material, and seeds inside an obstacle.
    """
    point, direction = checked_seeds("perceive", point, direction, len(maps.window))
    rest_length, up = checked_rod("perceive", rest_length, material, up)
    search = Search(maps, rig, point, direction, rest_length, material, up, options, check_seeds(surroundings, point))
    kept = search.initial_hypotheses()
    for edges in range(2, len(search.rest_length) + 1):
        grown = search.nearly_relaxed(search.grown(kept))
        rows = search.selected(grown)
        kept = grown.take(rows)
        if on_step is not None:
            on_step(edges, kept, grown.take(np.setdiff1d(np.arange(len(grown.of_set)), rows)))
    return _result(search, kept, np.broadcast_to(np.asarray(start_sigma, dtype=np.float64), len(point)))


def checked_seeds(function: str, point: ArrayLike, direction: ArrayLike, sets: int) -> tuple[np.ndarray, np.ndarray]:
    """(A, 3) points, and unit directions. Raises InputError, naming ``function``."""
    point, direction = (np.atleast_2d(np.asarray(value, dtype=np.float64)) for value in (point, direction))
    for name, value in (("point", point), ("direction", direction)):
        if value.shape != (sets, 3) or not (np.abs(value) <= LARGEST).all():
            raise InputError(function, name, f"shape {value.shape}", f"give ({sets}, 3) finite numbers, a row for each set")
    length = np.linalg.norm(direction, axis=-1, keepdims=True)
    if not (length > 0).all():
        raise InputError(function, "direction", "no direction", "give a vector of some length")
    return point, direction / length


def checked_rod(function: str, rest_length: ArrayLike, material: Material, up: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """(E,) lengths in an array of their own, and the unit vector against gravity. Raises InputError, naming ``function``."""
    lengths = np.array(rest_length, dtype=np.float64)
    if lengths.ndim != 1 or len(lengths) < 2 or not ((lengths > 0) & (lengths <= LARGEST)).all():
        raise InputError(function, "rest_length", f"shape {lengths.shape}", "give two or more lengths (E,) in mm")
    if material.count != 1:
        raise InputError(function, "material", f"{material.count} rows", "give one material")
    return lengths, unit_up(up, function)


def check_seeds(surroundings: Surroundings, point: np.ndarray) -> Surroundings:
    """``surroundings``, if rods can begin at ``point`` (A, 3) there. Raises InputError."""
    if not surroundings:
        return surroundings
    if np.size(surroundings.radius) != 1 or any(obstacle.count > 1 for obstacle in surroundings.obstacles):
        raise InputError("perceive", "obstacles", "other ones, or another radius, for each rod", "give the same to all rods")
    if surroundings.itself is not None:
        raise InputError("perceive", "obstacles", "the rod itself", "leave it out: a growing rod is no obstacle to itself")
    for obstacle in surroundings.obstacles:
        gap = obstacle.distance(point[None])[0][0] - surroundings.radius
        worst = int(np.argmin(gap))
        if gap[worst] < 0:
            raise InputError("perceive", "point", f"a rod that begins there is {-gap[worst]:.3g} mm inside a "
                             f"{type(obstacle).__name__}", "correct the seed or the obstacle, or give a smaller `radius`")
    return surroundings


def _result(search: Search, kept: Hypotheses, start_sigma: np.ndarray) -> Perception:
    """The finalists of each set relaxed until they converge, ranked."""
    options = search.options
    candidates = rank_distinct(kept.energy_vis, search.vertices(kept), kept.of_set, options.finalists, options.similar_distance)
    final = finalists(search, kept.take(np.sort(candidates[candidates >= 0])))
    marks = final.configuration.vertices[:, :: options.pieces]
    # Where some rods are traced, others were relaxed under another energy: a certificate is no reason to prefer one.
    certified = final.certified | np.isin(final.of_set, final.of_set[~np.isnan(final.thread)])
    ranked = rank_distinct(final.energy_vis, marks, final.of_set, 1 + options.runners_up, options.similar_distance, certified)
    # If all rods of a set failed, one of them is returned with its status.
    best = np.where(ranked[:, 0] >= 0, ranked[:, 0], np.searchsorted(final.of_set, np.arange(len(ranked))))
    return perception_of(search, final, best, ranked[:, 1:], start_sigma)


def perception_of(search: Search, final: Finalists, best: np.ndarray, others: np.ndarray, start_sigma: np.ndarray
                  ) -> Perception:
    """The rods ``best`` (A,) among ``final``, one of each set, beside ``others`` (A, K), −1 where there are fewer."""
    options, found = search.options, others >= 0
    marks = final.configuration.vertices[:, :: options.pieces]
    runner_up_energy = np.where(found, final.energy_vis[others], np.inf)
    with np.errstate(invalid="ignore"):  # a rod that is not finite is data
        worse = runner_up_energy.min(axis=1, initial=np.inf) - final.energy_vis[best]
        final = _sharpened(search, final, best, start_sigma == 0)
        rods = final.configuration.take(best)
        edge_error, image_length = search.reprojected(rods.vertices)
        near = edge_error <= options.unsupported
        hidden = ~near & (near.sum(axis=1, keepdims=True) >= 2)
        seen_length = np.where(hidden, 0.0, image_length)
        sigma = search.sigma(rods, start_sigma)
    both = search.maps.detections is not None and options.evidence == "both"
    errors = Misread(*np.zeros((4, *image_length.shape[:2])))
    if both:
        errors = misread(search.rig, rods.vertices, search.maps.detections)
    return Perception(
        vertices=rods.vertices[:, :: options.pieces],
        configuration=rods,
        energy_vis=final.energy_vis[best],
        # The distance is smoothed near lines, whose mean effect is subtracted: on the line itself it can be -0.01.
        camera_error=np.maximum(np.einsum("ace,ace->ac", edge_error, seen_length) / seen_length.sum(axis=2), 0.0),
        hidden=1 - seen_length.sum(axis=2) / image_length.sum(axis=2),
        status=final.status[best],
        stable=final.certified[best],
        sigma=sigma,
        runner_up=np.where(found[..., None, None], marks[others], np.nan),
        runner_up_energy=runner_up_energy,
        gap=worse / (options.nu * image_length.sum(axis=(1, 2))),
        edge_error=edge_error,
        unsupported=(edge_error > options.unsupported).all(axis=1),
        coverage=final.coverage[best] / (1 - errors.outside),
        outside=errors.outside,
        skipped=errors.skipped,
        twice=errors.twice,
        wider=errors.wider,
        thread_length=final.thread[best],
        left_over=left_over(final, best, image_length.sum(axis=2), search.rest_length.sum()),
        length_range=np.full((len(best), 2), np.nan),
    )


def _sharpened(search: Search, final: Finalists, best: np.ndarray, exact: np.ndarray) -> Finalists:
    """``final`` with the rods ``best`` (A), one of each set, on the detected points themselves."""
    rods, sound = search.sharpened(final.configuration.take(best), exact)
    if not sound.any():
        return final
    energy, found = evidence(search.rig, search.maps, rods, final.of_set[best], search.material, search.up, search.options,
                             search.piece_points)
    changed = best[sound]
    energy_vis, status, certified, share = (values.copy() for values in (final.energy_vis, final.status, final.certified,
                                                                         final.coverage))
    energy_vis[changed], share[changed] = energy[sound], found.share[sound]
    status[changed], certified[changed] = Status.CONVERGED, True
    return replace(final, configuration=put_rods(final.configuration, best, rods), energy_vis=energy_vis, status=status,
                   certified=certified, coverage=share)
