"""A rod through a video: every frame from the one before, and by Algorithm 1 where that fails (§III-D, §IV-A).

The rod of the last frame is moved in a few ways, with its start and by its own motion; from each of these initial shapes it is
relaxed under E_vis of the next images, and the one with the least E_vis until it converges. Where that is not on the detected
line, or is on it much worse than before, or its verdict is not at least *likely*, Algorithm 1 searches for the rod again.

    tracker = Tracker(rig, rest_length, Material(bend=6e5, twist=8e5))
    frames = [tracker.see(detected, point, direction) for detected, point, direction in video]

Axes: C cameras, E edges, V vertices, K initial shapes.
"""

from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike

from doo_ti.contact.surroundings import Surroundings
from doo_ti.motion.path import Motion
from doo_ti.motion.predict import predict_step
from doo_ti.perception.perceive import (
    Perception,
    PerceptionVerdict,
    checked_rod,
    checked_seeds,
    perceive,
    perception_of,
)
from doo_ti.perception.posterior import COVERED
from doo_ti.perception.search import Hypotheses, PerceptionOptions, Search, explained
from doo_ti.rod.frames import (
    bishop_frames,
    quaternion_from_matrix,
    quaternion_product,
    smallest_rotation,
    tangent_from_quaternion,
    unit_vectors,
)
from doo_ti.rod.shapes import end_clamps
from doo_ti.rod.types import Clamp, Configuration, Material, Status
from doo_ti.system.arguments import typed
from doo_ti.system.errors import InputError
from doo_ti.vision.cameras import Rig
from doo_ti.vision.detection import Detection
from doo_ti.vision.distance_map import distance_maps

FEWEST_CAMERAS = 2  # that must see a rod which is tracked: one does not see depth
ITERATIONS = 30  # largest number of Newton's iterations, in f32, from each initial shape
BETTER = 1e-6  # share of E_vis by which the rod of Algorithm 1 must be better than the tracked one, else it is the same rod


class How(IntEnum):
    """How a frame's rod was found.

    TRACKED  from the frame before
    SEEDED   by Algorithm 1, from the seed
    LOST     not at all
    """

    TRACKED = 0
    SEEDED = 1
    LOST = 2


@typed
@dataclass(frozen=True)
class TrackingOptions:
    """When a rod counts as lost.

    lost_px   px: largest distance to the detection, mean along what any camera shows of the rod, of one that is not lost.
              It must be met in two cameras; in the others the rod may be hidden. At least half of the rod must be shown
    worse_px  px: Algorithm 1 is run again if the mean distance over the cameras has grown by more than this since its last
              run, and the better rod counts

    Raises InputError for numbers that are not positive.
    """

    lost_px: float = 1.5
    worse_px: float = 0.1

    def __post_init__(self) -> None:
        for name in ("lost_px", "worse_px"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise InputError("TrackingOptions", name, f"{getattr(self, name)}", "give a positive number")


@dataclass(frozen=True)
class TrackedFrame:
    """The rod in one frame; NaN where it is lost.

    vertices      (V, 3) mm
    sigma         (V,) mm, as :class:`doo_ti.perception.perceive.Perception` has it
    energy_vis    E_vis, 1/mm, over the cameras that see a thread
    camera_error  (C,) px: distance to the detection, mean along the rod; NaN in a camera that sees no thread
    status        Status of the last relaxation; NOT_FINITE where there was none
    stable        certified to be a minimum of E_vis
    how           How
    verdict       PerceptionVerdict of the rod in this frame; of a tracked one without rivals
    doubts        why it is not clear, names of :attr:`.Perception.doubts`; of a lost one why what was found is not the rod
    """

    vertices: np.ndarray
    sigma: np.ndarray
    energy_vis: float
    camera_error: np.ndarray
    status: Status
    stable: bool
    how: How
    verdict: PerceptionVerdict = PerceptionVerdict.AMBIGUOUS
    doubts: tuple[str, ...] = ()


@typed
def seen_vertices(frame: TrackedFrame, rig: Rig, detected: list[Detection], within_px: float = TrackingOptions.lost_px
                  ) -> np.ndarray:
    """(V, 3) mm: the vertices of a tracked rod that images show, NaN at the others, as a servo takes them.

    detected   of each camera of the rig, those of the frame
    within_px  px: a camera shows a vertex that is so near to the thread that it detected. Two cameras must: of places that one
               sees or none the rod's stiffness is all that is known, which a servo has yet to learn

    Raises InputError for another number of detections, and a frame that is not of one rod.
    """
    if frame.vertices.ndim != 2 or frame.vertices.shape[1] != 3:
        raise InputError("seen_vertices", "frame", f"vertices {frame.vertices.shape}", "give a frame of a Tracker, (V, 3) mm")
    if len(detected) != len(rig.cameras):
        raise InputError("seen_vertices", "detected", f"{len(detected)}", f"give one for each camera, {len(rig.cameras)}")
    pixels = rig.project(frame.vertices)
    apart = [np.linalg.norm(own[:, None] - found.points, axis=-1).min(axis=1, initial=np.inf)
             for own, found in zip(pixels, detected, strict=True)]
    shown = np.sum(np.array(apart) <= within_px, axis=0) >= FEWEST_CAMERAS
    return np.where(shown[:, None], frame.vertices, np.nan)


@typed
class Tracker:
    """Tracks a rod frame by frame.

    rig, rest_length, material, up, search   as in :func:`doo_ti.perception.perceive.perceive`, ``search`` its options
    options                                  when the rod counts as lost
    surroundings                             obstacles that the rod may touch but not enter, and its radius
    length_range                             (2,) mm between which the length is, where it was found in images

    Raises InputError for a rig of one camera, and as that function does.
    """

    def __init__(self, rig: Rig, rest_length: ArrayLike, material: Material, *, up: ArrayLike = (0.0, 0.0, 1.0),
                 search: PerceptionOptions = PerceptionOptions(), options: TrackingOptions = TrackingOptions(),
                 surroundings: Surroundings = Surroundings(), length_range: ArrayLike | None = None) -> None:
        if len(rig.cameras) < FEWEST_CAMERAS:
            raise InputError("Tracker", "rig", "one camera, which shows no depth", "give two or more, or `perceive` the images")
        self._rig, self._material, self._search, self._options = rig, material, search, options
        self._rest_length, self._up = checked_rod("Tracker", rest_length, material, up)
        self._surroundings, self._length_range = surroundings, length_range
        self._last: Perception | None = None  # of one rod, in the cameras that saw a thread
        self._threads: list[float] = []  # mm, how long the thread was in the runs of Algorithm 1
        self._usual = np.inf  # px, mean over the cameras: the least since the last run of Algorithm 1

    @typed
    def see(self, detected: list[Detection], point: ArrayLike, direction: ArrayLike, far: Motion | None = None,
            start_covariance: ArrayLike = 0.0) -> TrackedFrame:
        """The rod in the next frame.

        detected   of each camera; a detection without points means that the camera sees no thread
        point      (3,) mm, v⁰ in this frame
        direction  (3,) of e⁰; any length
        far        motion of the far clamp since the frame before: the rod predicted from it is one more initial shape. Tangents
                   only; the start moves with the seed
        start_covariance  (3, 3) mm² of ``point``, as :func:`doo_ti.perception.perceive.perceive` takes it

        Raises InputError as :func:`doo_ti.perception.perceive.perceive` does.
        """
        search = self._search_in("Tracker.see", detected, point, direction)
        if search is None:
            return self._lost()
        covariance, how = np.broadcast_to(start_covariance, (1, 3, 3)), How.TRACKED
        rod = None if self._last is None else self._relaxed(search, self._starts(search, far), covariance)
        if rod is None or not self._goes_on(rod):
            self._usual = np.inf
            seeded = perceive(search.maps, search.rig, search.point, search.direction, self._rest_length, self._material,
                              up=self._up, options=self._search, surroundings=self._surroundings, start_covariance=covariance)
            self._threads += seeded.thread_length[np.isfinite(seeded.thread_length)].tolist()
            if rod is None or _is_better(seeded, rod):
                rod, how = seeded, How.SEEDED
        if not self._sound(rod):
            return self._lost(rod)
        self._last, self._usual = rod, min(self._usual, rod.camera_error[0].mean())
        return self._frame(rod, how, search)

    @typed
    def revised(self, frame: TrackedFrame, after: TrackedFrame, detected: list[Detection], point: ArrayLike,
                direction: ArrayLike, start_covariance: ArrayLike = 0.0) -> TrackedFrame:
        """``frame``, or the rod of the frame ``after`` it, relaxed in its images, where that is better. Other arguments as of
        :meth:`see`, which does not depend on this. Raises InputError as that does."""
        search = self._search_in("Tracker.revised", detected, point, direction)
        if search is None or after.how == How.LOST:
            return frame
        tangents = unit_vectors(np.diff(after.vertices, axis=0))
        edges = quaternion_from_matrix(bishop_frames(tangents, search.first[0, :, 1]))
        covariance = np.broadcast_to(start_covariance, (1, 3, 3))
        rod = self._relaxed(search, np.stack([edges, _aimed(edges, search.direction)]), covariance)
        better = self._sound(rod) and not rod.energy_vis[0] >= (1 - BETTER) * frame.energy_vis
        return self._frame(rod, How.TRACKED, search) if better else frame

    def _search_in(self, function: str, detected: list[Detection], point: ArrayLike, direction: ArrayLike) -> Search | None:
        """The search in the images of one frame, None where too few show anything. Raises InputError, naming ``function``."""
        names = self._rig.names
        if len(detected) != len(names):
            raise InputError(function, "detected", f"{len(detected)}", f"give one for each camera, {len(names)}")
        point, direction = checked_seeds(function, point, direction, 1)
        seeing = [name for name, found in zip(names, detected, strict=True) if found.count]
        if len(seeing) < FEWEST_CAMERAS:
            return None
        return Search(distance_maps([[found for found in detected if found.count]]), self._rig.only(seeing), point, direction,
                      self._rest_length, self._material, self._up, self._search, self._surroundings.for_seeds(point))

    def _relaxed(self, search: Search, starts: np.ndarray, start_covariance: np.ndarray) -> Perception:
        """The rod relaxed in a frame, from the best of its initial shapes ``starts`` (K, E, 4), the point where it begins as
        uncertain as ``start_covariance`` (1, 3, 3) mm². Its configuration is the one that was relaxed, not sharpened."""
        longer = replace(search, options=replace(search.options, growing_iterations=ITERATIONS))
        rested = longer.nearly_relaxed(Hypotheses(np.zeros(len(starts), dtype=np.int64), starts, np.zeros(len(starts))))
        alone, _ = explained(search, *search.relaxed(rested.take(np.array([np.argmin(rested.energy_vis)]))))
        found = perception_of(search, alone, np.zeros(1, dtype=np.int64), np.full((1, 0), -1), start_covariance)
        return replace(found, configuration=alone.configuration)

    def _starts(self, search: Search, far: Motion | None) -> np.ndarray:
        """(K, E, 4): the last rod unchanged, rotated with the seed, and carried by the far clamp. Each first edge is then
        held at the seed."""
        last = self._whole(self._last)
        edges = last.quaternions[0]
        starts = [edges, _aimed(edges, search.direction)]
        if far is not None:
            starts.append(self._carried(last, search, far))
        return np.stack([start for start in starts if np.isfinite(start).all()])

    def _carried(self, last: Configuration, search: Search, far: Motion) -> np.ndarray:
        """(E, 4) the last rod after its start has moved to the seed and its far end with the clamp."""
        here = end_clamps(last, Clamp.TANGENT, Clamp.TANGENT)
        goal = replace(replace(far, clamps=here).at(1.0), start_position=search.point, start_frame=search.first)
        solution, _ = predict_step(last, self._material, here, goal, up=self._up, watch=False, **self._surroundings.arguments)
        return solution.configuration.quaternions[0]

    def _whole(self, rod: Perception) -> Configuration:
        """The rod with uncut edges, in the directions of their middle pieces."""
        fine, pieces = rod.configuration, self._search.pieces
        return Configuration(fine.start, fine.quaternions[:, pieces // 2 :: pieces], self._rest_length)

    def _sound(self, rod: Perception) -> bool:
        """Whether the rod has converged on the detected line, as far as any camera shows it: in two cameras, or in one of three
        where it explains all that they detect: something hides a piece from the others, or the rod is too long."""
        if rod.status[0] != Status.CONVERGED or rod.verdict[0] == PerceptionVerdict.NOT_FOUND:
            return False
        whole = len(rod.coverage[0]) > FEWEST_CAMERAS and (rod.coverage[0] >= COVERED).all()
        needed = 1 if whole else FEWEST_CAMERAS
        return np.sort(rod.shown_error[0])[needed - 1] <= self._options.lost_px

    def _goes_on(self, rod: Perception) -> bool:
        """Whether the tracked rod needs no second opinion."""
        worse = rod.camera_error[0].mean() - self._usual > self._options.worse_px
        return self._sound(rod) and not worse and rod.verdict[0] <= PerceptionVerdict.LIKELY

    def _frame(self, found: Perception, how: How, search: Search) -> TrackedFrame:
        """The result of a frame. A thread that was not traced there is as long as in others."""
        if np.isnan(found.thread_length[0]) and self._threads:
            found = replace(found, thread_length=np.full(1, np.median(self._threads)))
        if self._length_range is not None:
            found = replace(found, length_range=np.reshape(self._length_range, (1, 2)))
        error = np.full(len(self._rig.cameras), np.nan)
        error[[self._rig.names.index(name) for name in search.rig.names]] = found.camera_error[0]
        return TrackedFrame(found.vertices[0], found.sigma[0], found.energy_vis[0], error, Status(found.status[0]),
                            bool(found.stable[0]), how, PerceptionVerdict(found.verdict[0]), _doubts(found))

    def _lost(self, found: Perception | None = None) -> TrackedFrame:
        """The rod is lost: the next frame begins with Algorithm 1. ``found``: what it found here, which is not the rod."""
        self._last = None
        vertices, doubts = np.full((len(self._rest_length) + 1, 3), np.nan), () if found is None else _doubts(found)
        return TrackedFrame(vertices, vertices[:, 0], np.nan, np.full(len(self._rig.cameras), np.nan), Status.NOT_FINITE,
                            False, How.LOST, PerceptionVerdict.NOT_FOUND, doubts)


def _doubts(found: Perception) -> tuple[str, ...]:
    """Why the first rod is not clear."""
    return tuple(name for name, own in found.doubts.items() if own[0])


def _is_better(seeded: Perception, tracked: Perception) -> bool:
    """Whether Algorithm 1 has found a better rod than the one before, moved."""
    converged, before = (one.status[0] == Status.CONVERGED for one in (seeded, tracked))
    return converged if converged != before else seeded.energy_vis[0] < (1 - BETTER) * tracked.energy_vis[0]


def _aimed(quaternions: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """(E, 4) a rod turned as a whole until its first edge points along ``direction`` (1, 3)."""
    return quaternion_product(smallest_rotation(tangent_from_quaternion(quaternions[0]), direction[0]), quaternions)
