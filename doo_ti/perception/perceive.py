"""Algorithm 1: from images to rods, edge by edge (§IV-A), with the steps of :mod:`doo_ti.perception.search`.

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
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike

from doo_ti.contact.surroundings import Surroundings
from doo_ti.perception.growth import rank_distinct
from doo_ti.perception.posterior import COVERED, sharpened
from doo_ti.perception.search import Finalists, Hypotheses, PerceptionOptions, Search, evidence, finalists, left_over
from doo_ti.perception.traced import SAME_LENGTH
from doo_ti.rod.types import LARGEST, Configuration, Material, Status, put_rods, unit_up
from doo_ti.system.arguments import short_repr, typed
from doo_ti.system.errors import InputError
from doo_ti.vision.cameras import Rig
from doo_ti.vision.distance_map import ERRORS, DistanceMaps, misread

CLEAR_PX, AMBIGUOUS_PX = 0.1, 0.02
"""Bounds of the gap: the first is larger than the mean error of detected lines; the second is smaller than the difference of
the rod's energy, which depends on an inexact Θ, between rods that fit the images equally."""
FITTING_PX = 1.0  # bound of the distance to the detection; with more in any camera, something else was detected
LEAST_COVERED = 0.5, 0.25  # bounds of the share of the detected line that a likely rod explains, and one that is shorter
MOST_SKIPPED, MOST_WIDER = 3.0, 1.5  # bounds of pieces left out, and, of likely rods, along something wider; in widths
UNCERTAIN, CERTAIN_MM = 0.1, 1.0
"""Bounds of the vertices' sigma: of a likely rod, over its length, as of the share that no camera shows; and of a clear one."""
CERTAIN_LENGTH = 0.03
"""Bound, for a clear rod, of the share that no camera shows, and of the uncertainty of a length that was found, that of its
ends included. A rod that is too long by that may be off the thread along the line of sight by some hundredths of its length."""
LEAST_SHOWN = 0.5  # bound of the share of a rod's edges that some camera shows, of a rod that was found
LOST_PX = 3.0  # bound of the largest distance where no two cameras fit: a rod farther off is not the thread in the images


class PerceptionVerdict(IntEnum):
    """How certain the best rod is, by its gap to the best runner-up and its distance to the detection.

    CLEAR      no :attr:`Perception.doubts`: images alone separate it from others, by 0.1 px, and it is a certified minimum
               within 1 px of the line in each camera, which explains 95 % of it and is certain to 1 mm
    LIKELY     a gap of at least 0.02 px, to which the rod's energy may help; or a wider gap, but the rod is off the line
    AMBIGUOUS  either of two may be the rod; or there is one camera, without depth; or it has not converged, is shorter than its
               paths, or in all cameras but one explains less than half of the line, leaves a piece out or passes it twice; or a
               tenth is in no camera or beyond the thread's end, or of a found length goes on, or a vertex is as uncertain
    NOT_FOUND  mean distance above 1 px in all cameras but one and above 3 px in one, also without the edges that no camera
               shows, or more than half of all are such edges: other cameras, a wrong rig, seed or length
    """

    CLEAR = 0
    LIKELY = 1
    AMBIGUOUS = 2
    NOT_FOUND = 3


@dataclass(frozen=True)
class Perception:
    """The rods in A sets of images.

    vertices          (A, V, 3) mm: the best rod of each set at its marks, a certified minimum if there is one
    configuration     the same rod with every edge in pieces, as it was relaxed
    energy_vis        (A,) its E_vis, 1/mm
    camera_error      (A, C) px: its distance to the detection, mean along what is not hidden of it, in each camera
    hidden            (A, C) share of its image that is far from the detection there, while two other cameras see it
    status            (A,) Status of its last relaxation
    stable            (A,) bool: certified to be a minimum of E_vis
    sigma             (A, V) mm: uncertainty of its vertices (:mod:`doo_ti.perception.posterior`)
    runner_up         (A, K, V, 3) mm: the next best rods that differ from all better ones; NaN where there are fewer
    runner_up_energy  (A, K) their E_vis, infinite where there are fewer
    gap               (A,) px: E_vis of the best runner-up less that of the best rod, as a mean distance along all images;
                      infinite without one, negative where a rod that is no certified minimum scores better than this one
    edge_error        (A, C, E) px: mean distance to the detection along each edge of the best rod
    unsupported       (A, E) bool: edges that are far from the detection in all cameras
    coverage          (A, C) share of the line detected in each camera that the rod explains, of what lies in two images; NaN
                      where detections are unknown
    outside           (A, C) share of the line detected in each camera that lies outside all other images: no rod is there
    skipped           (A, C) longest piece of the line detected in each camera that the rod leaves out between its ends, over
                      the width of the thread there
    twice             (A, C) how much of its image passes along another part of it, over that width: it has turned back, or the
                      camera sees strands behind each other
    wider             (A, C) longest piece of line along the rod that is wider than the thread, in its widths: a needle, a clip
    thread_length     (A,) mm from the seed to where the thread ends in the images; NaN where the best rod was not traced and
                      thread is left over. With rods of another length, the best is part of it, or goes on beyond it
    left_over         (A,) mm of thread that the rod leaves over: beyond its end or, if not traced, at most in any camera
    length_range      (A, 2) mm: the shortest and the longest thread that explains the images as well; NaN of a stated one
    beyond            (A, 2) mm of thread that may go on beyond its start and its end, of a length that was found; else NaN
    """

    __repr__ = short_repr

    vertices: np.ndarray
    configuration: Configuration
    energy_vis: np.ndarray
    camera_error: np.ndarray
    hidden: np.ndarray
    status: np.ndarray
    stable: np.ndarray
    sigma: np.ndarray
    runner_up: np.ndarray
    runner_up_energy: np.ndarray
    gap: np.ndarray
    edge_error: np.ndarray
    unsupported: np.ndarray
    coverage: np.ndarray
    outside: np.ndarray
    skipped: np.ndarray
    twice: np.ndarray
    wider: np.ndarray
    thread_length: np.ndarray
    left_over: np.ndarray
    length_range: np.ndarray
    beyond: np.ndarray

    @property
    def sound(self) -> np.ndarray:
        """(A,) bool: the best rod converged to a certified minimum."""
        return (self.status == Status.CONVERGED) & self.stable

    @property
    def doubts(self) -> dict[str, np.ndarray]:
        """(A,) bool by each reason why a rod is not clear."""
        length = self.configuration.rest_length.sum(axis=-1)
        return {
            "no certified minimum": ~self.sound, "a rival": ~(self.gap >= CLEAR_PX),
            "off the line": ~(self.camera_error <= FITTING_PX).all(axis=1),
            "a piece left out": (self.skipped > MOST_SKIPPED).any(axis=1), "a line twice": self._often(self.twice),
            "along something wider": (self.wider > MOST_SKIPPED).any(axis=1),
            "rod unseen": self.unsupported.mean(axis=1) > CERTAIN_LENGTH,
            "thread unexplained": (self.coverage < COVERED).any(axis=1) | (self.left_over > CERTAIN_LENGTH * length),
            "places uncertain": (self.sigma > CERTAIN_MM).any(axis=1), "one camera": np.full(len(self.gap), self._two == 0),
            "another length": np.abs(self.thread_length / length - 1) > SAME_LENGTH,
            "length uncertain": np.ptp(self.length_range, axis=1) > 2 * CERTAIN_LENGTH * length,
            "thread beyond an end": self.beyond.max(axis=1) > CERTAIN_LENGTH * length}

    @property
    def _two(self) -> int:
        """The place of the second best of all cameras, or of the only one."""
        return min(2, self.camera_error.shape[1]) - 1

    def _often(self, widths: np.ndarray, most: float = MOST_SKIPPED) -> np.ndarray:
        """(A,) bool: in all cameras but one ``widths`` (A, C) are more than ``most``."""
        return np.sort(np.nan_to_num(widths), axis=1)[:, self._two] > most

    def _far_off(self, error: np.ndarray) -> np.ndarray:
        """(A,) bool: whether the mean distances ``error`` (A, C) px say that a rod is not on the line. Two cameras that fit are
        enough, as others may be occluded; one that does not see the rod does not fit. A rod that explains all of the line may
        go on beyond it."""
        error = np.sort(np.where(np.isfinite(error), error, np.inf), axis=1)
        far = (error[:, self._two] > FITTING_PX) & (error[:, -1] > LOST_PX)
        return far & ~(self.coverage >= COVERED).all(axis=1)

    @property
    def shown_error(self) -> np.ndarray:
        """(A, C) px: the distance to the detection, mean along the edges that are not ``unsupported``; infinite where these
        are less than half of all."""
        shown = ~self.unsupported[:, None]
        error = np.where(shown, self.edge_error, 0.0).sum(axis=2) / np.maximum(shown.sum(axis=2), 1)
        return np.where(shown.mean(axis=2) < LEAST_SHOWN, np.inf, error)

    @property
    def verdict(self) -> np.ndarray:
        """(A,) PerceptionVerdict."""
        clear, length = ~np.any([*self.doubts.values()], axis=0), self.configuration.rest_length.sum(axis=-1)
        far_off = self._far_off(self.camera_error)
        lost = far_off & self._far_off(self.shown_error)  # else cameras do not show all of it
        explained = np.sort(np.nan_to_num(self.coverage, nan=1.0), axis=1)[:, -1 - self._two]
        likely = (self.status == Status.CONVERGED) & (self.gap >= AMBIGUOUS_PX) & ~far_off & (self._two > 0)
        whole, part = LEAST_COVERED  # of a longer thread a rod explains a part
        likely &= explained >= np.maximum(whole * length / np.fmax(length, self.thread_length), part)
        likely &= ~(self.thread_length > self.length_range[:, 1])  # the length and the paths contradict each other
        likely &= ~(self.thread_length < (1 - UNCERTAIN) * length)  # it ends where no thread is
        likely &= ~self._often(self.skipped) & ~self._often(self.twice)
        likely &= ~self._often(self.wider, MOST_WIDER) & ~(self.beyond.max(axis=1) > UNCERTAIN * length)
        likely &= ~(self.unsupported.mean(axis=1) > UNCERTAIN) & ~(self.sigma.max(axis=1) > UNCERTAIN * length)
        kinds = PerceptionVerdict.NOT_FOUND, PerceptionVerdict.CLEAR, PerceptionVerdict.LIKELY
        return np.select([lost, clear, likely], kinds, PerceptionVerdict.AMBIGUOUS).astype(np.int8)

    @classmethod
    def joined(cls, parts: list["Perception"]) -> "Perception":
        """Several of the same rig and rod, one after the other."""
        whole = Configuration.concatenate([part.configuration for part in parts])
        values = {name: np.concatenate([getattr(part, name) for part in parts]) for name in cls.__dataclass_fields__
                  if name != "configuration"}
        return cls(configuration=whole, **values)

    def among(self, rows: np.ndarray, count: int) -> "Perception":
        """The same as ``rows`` of ``count`` sets. In the others there is no rod: NaN, with the status INFEASIBLE."""
        def spread(values: np.ndarray, missing) -> np.ndarray:
            every = np.full((count, *values.shape[1:]), missing, dtype=values.dtype)
            every[rows] = values
            return every

        missing = {"status": Status.INFEASIBLE, "stable": False, "unsupported": False}
        values = {name: spread(getattr(self, name), missing.get(name, np.nan)) for name in self.__dataclass_fields__
                  if name != "configuration"}
        own = self.configuration
        lengths = own.rest_length if own.rest_length.ndim == 1 else spread(own.rest_length, np.nan)
        return Perception(configuration=Configuration(spread(own.start, np.nan), spread(own.quaternions, np.nan), lengths),
                          **values)


@typed
def perceive(
    maps: DistanceMaps, rig: Rig, point: ArrayLike, direction: ArrayLike, rest_length: ArrayLike, material: Material, *,
    up: ArrayLike = (0.0, 0.0, 1.0),
    options: PerceptionOptions = PerceptionOptions(), on_step: Callable[[int, Hypotheses, Hypotheses], None] | None = None,
    surroundings: Surroundings = Surroundings(), start_covariance: ArrayLike = 0.0,
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
    start_covariance  (A, 3, 3) mm² of each ``point``. It counts in that of the rod, which may slide along itself, and whose
                 start the last relaxation may then move; 0: point and direction are exact

    Raises InputError for shapes that do not match, fewer than two edges, more than one material, and seeds inside an obstacle.
    """
    point, direction = checked_seeds("perceive", point, direction, len(maps.window))
    rest_length, up = checked_rod("perceive", rest_length, material, up)
    search = Search(maps, rig, point, direction, rest_length, material, up, options, surroundings.for_seeds(point))
    kept = search.initial_hypotheses()
    for edges in range(2, len(search.rest_length) + 1):
        grown = search.nearly_relaxed(search.grown(kept))
        rows = search.selected(grown)
        kept = grown.take(rows)
        if on_step is not None:
            on_step(edges, kept, grown.take(np.setdiff1d(np.arange(len(grown.of_set)), rows)))
    return _result(search, kept, np.broadcast_to(np.asarray(start_covariance, dtype=np.float64), (len(point), 3, 3)))


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


def _result(search: Search, kept: Hypotheses, start_covariance: np.ndarray) -> Perception:
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
    found = perception_of(search, final, best, ranked[:, 1:], start_covariance)
    shown, length = search.shown_length(found.configuration), search.rest_length.sum()
    ends = search.both_ways & ((shown < (1 - CERTAIN_LENGTH) * length) | (found.left_over <= CERTAIN_LENGTH * length))
    return replace(found, thread_length=np.where(np.isnan(found.thread_length) & ends, shown, found.thread_length))


def perception_of(search: Search, final: Finalists, best: np.ndarray, others: np.ndarray, start_covariance: np.ndarray
                  ) -> Perception:
    """The rods ``best`` (A,) among ``final``, one of each set, beside ``others`` (A, K), −1 where there are fewer."""
    options, found = search.options, others >= 0
    marks = final.configuration.vertices[:, :: options.pieces]
    runner_up_energy = np.where(found, final.energy_vis[others], np.inf)
    with np.errstate(invalid="ignore"):  # a rod that is not finite is data
        worse = runner_up_energy.min(axis=1, initial=np.inf) - final.energy_vis[best]
        final = _sharpened(search, final, best, ~start_covariance.any(axis=(1, 2)))
        rods = final.configuration.take(best)
        edge_error, image_length = search.reprojected(rods.vertices)
        near = edge_error <= options.unsupported
        hidden = ~near & (near.sum(axis=1, keepdims=True) >= 2)
        seen_length = np.where(hidden, 0.0, image_length)
        camera_error = np.einsum("ace,ace->ac", edge_error, seen_length) / seen_length.sum(axis=2)
        sigma = search.sigma(rods, start_covariance)
    errors = misread(search.rig, rods.vertices, search.maps.detections) if search.both_ways else {
        **dict.fromkeys(ERRORS, np.zeros(image_length.shape[:2])), "left": np.full(image_length.shape[:2], np.nan)}
    return Perception(
        vertices=rods.vertices[:, :: options.pieces],
        configuration=rods,
        energy_vis=final.energy_vis[best],
        # The distance is smoothed near lines, whose mean effect is subtracted: on the line itself it can be -0.01.
        camera_error=np.maximum(camera_error, 0.0),
        hidden=1 - seen_length.sum(axis=2) / image_length.sum(axis=2),
        status=final.status[best],
        stable=final.certified[best],
        sigma=sigma,
        runner_up=np.where(found[..., None, None], marks[others], np.nan),
        runner_up_energy=runner_up_energy,
        gap=worse / (options.nu * image_length.sum(axis=(1, 2))),
        edge_error=edge_error,
        unsupported=(edge_error > options.unsupported).all(axis=1),
        coverage=final.coverage[best] / (1 - errors["outside"]),
        left_over=left_over(final.thread[best], errors.pop("left"), image_length.sum(axis=2), search.rest_length.sum()),
        **errors,
        thread_length=final.thread[best],
        **dict.fromkeys(("length_range", "beyond"), np.full((len(best), 2), np.nan)),
    )


def _sharpened(search: Search, final: Finalists, best: np.ndarray, exact: np.ndarray) -> Finalists:
    """``final`` with the rods ``best`` (A), one of each set, on the detected points themselves, where evidence counts both
    ways. Where ``exact`` (A,) the first edge is held."""
    if not search.both_ways:
        return final
    rods, sound = sharpened(final.configuration.take(best), search.rig, search.maps.detections, search.material, search.up,
                            search.surroundings, exact, len(search.rest_length) + 1)
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
