"""Hypotheses from traced paths: rods that explain the detected thread from its beginning to its end (docs/perception.md).

    paths     along the thread in each image, from the seed on            doo_ti.vision.paths
    matches   paths of all images that are of one curve, and the curve    doo_ti.perception.matching
    rods      that begin as these curves, some smoother than others, and are relaxed under E/B + ν E_back

E_back pulls places of the rod to points of the paths. Which point belongs to which place is found anew after each relaxation:
the one nearest to the place's image, in order along the path. At first all rods are made longer or shorter, until they end
where the paths end. One that is known to be about as long then gets its length, and its places are spread over all of its
paths; where the known length is another, the rod ends before the thread, or goes on beyond it, along its paths as before.

Axes: A image sets, R rods of all sets, C cameras, N edges of a rod, K places along an edge.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from doo_ti.perception.matching import Match, curve_of, likely_matches
from doo_ti.perception.posterior import PLACES
from doo_ti.relaxation.newton import Newton
from doo_ti.relaxation.relax import relax
from doo_ti.rod.frames import across, arc_lengths, bishop_frames, placed, quaternion_from_matrix, unit_vectors
from doo_ti.rod.shapes import end_clamps
from doo_ti.rod.types import Clamp, Configuration, Material, Solution
from doo_ti.vision.cameras import Rig
from doo_ti.vision.detection import Detection
from doo_ti.vision.image_energy import AssignedPoints
from doo_ti.vision.paths import Chains, ImagePath, paths_from

PATHS, MATCHES = 4, 3  # paths of each image, and matches of each set, that are tried
SMOOTHNESS = (30.0, 1e3, 3e4)
"""Smoothness of the curves with which rods begin. Between cameras that are close together a rough curve folds along the line of
sight, and a very smooth one is too flat; the energy decides between the rods."""
NU_BACK = 0.03  # ν of E_back, 1/(mm px³)
FREE_ROUNDS, FIXED_ROUNDS = 4, 2  # relaxations of rods whose length is free, and of those whose length is given
STEPS, NEAREST_PX = 3, 6.0  # steps along a path to the point nearest to a place's image, and the longest of them
AHEAD_MM = 1e-3  # distance over which the image of a direction is taken
SAME_LENGTH = 0.05
"""A rod and its paths end together if their lengths differ by less than this share. Between cameras that are close together the
length of a thread is no more certain than that."""


HIDDEN = ImagePath(np.zeros((2, 2)), np.zeros(2, dtype=bool), 0.0, 0.0)  # of a camera that a match leaves out


def whole_rods(rig: Rig, detections: Sequence[Sequence[Detection]], point: np.ndarray, direction: np.ndarray | None,
               shares: np.ndarray, material: Material, up: np.ndarray) -> tuple["Tracing", "TracedShapes | None"]:
    """Rods along paths from the seeds on, that end where these end; None where no set has any.

    point      (A, 3) mm
    direction  (A, 3) unit vectors, or None: unknown
    shares     (N,) of the rod's length that its edges have
    """
    of_set, begun, matches = [], [], []
    for row, images in enumerate(detections):
        way = None if direction is None else direction[row]
        for match, curve, arcs in _curves(rig, _paths(rig, images, point[row], way), point[row]):
            of_set.append(row)
            begun.append(_begun(curve, arcs, way, shares))
            matches.append(match)
    rows = np.array(of_set, dtype=np.int64)
    tracing = Tracing(rig, rows, matches, point[rows], None if direction is None else direction[rows], shares, material, up)
    if not begun:
        return tracing, None
    quaternions, arcs, length = (np.stack(values) for values in zip(*begun, strict=True))
    return tracing, tracing.freely_long(TracedShapes(quaternions, arcs, length))


def _curves(rig: Rig, paths: list[list[ImagePath]], point: np.ndarray):
    """(match, curve (K, 3) mm, its places (C, K) along the paths) of the best matches of all cameras, and of all but one: the
    thread may be hidden there."""
    every = tuple(range(len(rig.cameras)))
    for kept in (every, *(combinations(every, len(every) - 1) if len(every) > 2 else ())):
        some = rig.take(kept)
        for match in likely_matches(some, [paths[camera] for camera in kept], point, SMOOTHNESS[0], MATCHES):
            for smooth in SMOOTHNESS:
                curve, arcs, _ = curve_of(some, match, point, smooth)
                there = np.zeros((len(every), arcs.shape[1]))
                there[list(kept)] = arcs
                along = dict(zip(kept, match.paths, strict=True))
                yield replace(match, paths=tuple(along.get(camera, HIDDEN) for camera in every), arcs=there), curve, there


def _paths(rig: Rig, images: list[Detection], point: np.ndarray, direction: np.ndarray | None):
    """The paths of each camera from where it sees ``point``; none of one that does not."""
    found = []
    for camera, detection in zip(rig.cameras, images, strict=True):
        at = camera.project(point)
        if not np.isfinite(at).all():
            found.append([])
            continue
        ahead = None if direction is None else camera.project(point + AHEAD_MM * direction) - at
        found.append(paths_from(Chains.of(detection), at, ahead, PATHS))
    return found


def _begun(curve: np.ndarray, arcs: np.ndarray, direction: np.ndarray | None, shares: np.ndarray) -> tuple:
    """Where a rod begins: frames (N, 4), places along the paths (C, N, K), and length in mm, along a curve (K, 3) whose points
    are at ``arcs`` (C, K) of the paths."""
    along = arc_lengths(curve)
    ends = along[-1] * np.concatenate([[0.0], np.cumsum(shares)])
    tangents = unit_vectors(np.diff(placed(ends, along, curve), axis=0))
    if direction is not None:
        tangents[0] = direction
    frames = bishop_frames(tangents[None], across(tangents[:1]))
    places = ends[:-1, None] + np.diff(ends)[:, None] * PLACES
    there = np.stack([np.interp(places, along, one) for one in arcs])
    return quaternion_from_matrix(frames)[0], there, float(along[-1])


@dataclass(frozen=True)
class TracedShapes:
    """R rods: frames (R, N, 4), places along their paths (R, C, N, K) and lengths (R,) mm; after a relaxation its solution."""

    quaternions: np.ndarray
    arcs: np.ndarray
    length: np.ndarray
    solution: Solution | None = None

    def take(self, rows: np.ndarray) -> "TracedShapes":
        return TracedShapes(self.quaternions[rows], self.arcs[rows], self.length[rows])

    def cut(self, shares: np.ndarray, share: np.ndarray, length: np.ndarray) -> "TracedShapes":
        """The first ``share`` (R,) of each rod, as a rod of ``length`` (R,) mm, with the frames that were nearest; beyond its
        end it goes straight on."""
        ends = np.concatenate([[0.0], np.cumsum(shares)])
        middles = 0.5 * (ends[1:] + ends[:-1])
        nearest = np.clip(np.searchsorted(ends, middles * share[:, None]) - 1, 0, len(middles) - 1)
        places = (ends[:-1, None] + shares[:, None] * PLACES).ravel()
        flat = self.arcs.reshape(*self.arcs.shape[:2], -1)
        arcs = np.array([[np.interp(places * own, places, line) for line in rod] for rod, own in zip(flat, share, strict=True)])
        quaternions = np.take_along_axis(self.quaternions, nearest[..., None], axis=1)
        return TracedShapes(quaternions, arcs.reshape(self.arcs.shape), length)


@dataclass(frozen=True)
class Tracing:
    """Rods on their paths: R of all sets, whose places are assigned to points of the paths anew after each relaxation."""

    rig: Rig
    of_set: np.ndarray  # (R,) image set
    matches: Sequence[Match]  # R times the paths of a rod
    point: np.ndarray  # (R, 3) mm where it begins
    direction: np.ndarray | None  # (R, 3) in which it begins, or None: free
    shares: np.ndarray  # (N,) of its length that its edges have
    material: Material
    up: np.ndarray

    def take(self, rows: np.ndarray) -> "Tracing":
        """Some of the rods, which may occur several times."""
        direction = None if self.direction is None else self.direction[rows]
        return replace(self, of_set=self.of_set[rows], matches=[self.matches[row] for row in rows], point=self.point[rows],
                       direction=direction)

    def freely_long(self, rods: TracedShapes) -> TracedShapes:
        """Relaxed, made longer or shorter until they end where their paths end."""
        reach = np.ones(len(rods.length))
        for _ in range(FREE_ROUNDS):
            rods = self._minimised(replace(rods, length=rods.length / np.clip(reach, 0.7, 1.4)))
            arcs, reach = self._reassigned(rods, np.zeros(len(rods.length), dtype=bool))
            rods = replace(rods, arcs=arcs)
        return rods

    def relaxed(self, rods: TracedShapes, together: np.ndarray, rounds: int = FIXED_ROUNDS) -> TracedShapes:
        """Relaxed, as long as they are. Those that end ``together`` (R,) with their paths are spread over all of them."""
        for turn in range(rounds):
            if turn:
                rods = replace(rods, arcs=self._reassigned(rods, together)[0])
            rods = self._minimised(rods)
        return rods

    def _minimised(self, rods: TracedShapes) -> TracedShapes:
        start = Configuration(self.point, rods.quaternions, rods.length[:, None] * self.shares)
        clamps = end_clamps(start, Clamp.POSITION if self.direction is None else Clamp.TANGENT)
        solution = relax(start, self.material, clamps, Newton(), up=self.up, precision="mixed",
                         external=self._assigned(rods.arcs), external_index=np.arange(len(rods.length)))
        return replace(rods, quaternions=solution.configuration.quaternions, solution=solution)

    def _assigned(self, arcs: np.ndarray) -> AssignedPoints:
        """E_back of places at ``arcs`` (R, C, N, K) along the paths. A place explains the line half-way to its neighbours."""
        points, tangents = np.zeros((2, *arcs.shape, 2))
        weight = np.zeros(arcs.shape)
        for r, match in enumerate(self.matches):  # a handful of hypotheses of each set
            for c, path in enumerate(match.paths):
                here = arcs[r, c]
                points[r, c], tangents[r, c] = path.at(here), path.tangent_at(here)
                explained = np.maximum(np.gradient(here.ravel()), 0.0).reshape(here.shape)
                weight[r, c] = explained * path.is_seen(here)
        return AssignedPoints(self.rig, points, tangents, weight, NU_BACK * float(np.linalg.eigvalsh(self.material.bend).max()))

    def _reassigned(self, rods: TracedShapes, together: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Places along the paths nearest to the images of the rods' places, in order, and (R,) the share of their paths that
        rods cover, above one where they go on beyond.

        together  (R,) bool: rods as long as their paths: where a path goes on a little, places are spread over all of it
        """
        arcs, vertices = rods.arcs, rods.solution.configuration.vertices
        places = vertices[:, :-1, None] + PLACES[:, None] * np.diff(vertices, axis=1)[:, :, None]
        seen, ends = self.rig.project(places.reshape(len(arcs), -1, 3)), self.rig.project(vertices[:, -1])
        found, reach = np.empty_like(arcs), np.ones(arcs.shape[:2])
        for r, match in enumerate(self.matches):
            for c, path in enumerate(match.paths):
                at, image = arcs[r, c].ravel(), np.nan_to_num(seen[c, r])
                for _ in range(STEPS):
                    ahead = ((image - path.at(at)) * path.tangent_at(at)).sum(axis=1)
                    at = np.clip(at + np.clip(ahead, -NEAREST_PX, NEAREST_PX), 0.0, path.length)
                at = np.maximum.accumulate(at)
                over = float((np.nan_to_num(ends[c, r]) - path.points[-1]) @ path.tangents[-1])
                covered = at[-1] + 0.5 * (at[-1] - at[-2]) if at[-1] < path.length - 2 else path.length + over
                reach[r, c] = covered / max(path.length, 1.0) if path.seen.any() else np.nan
                if together[r] and 1 - 2 * SAME_LENGTH < reach[r, c] < 1:
                    at = at / reach[r, c]
                found[r, c] = np.clip(at, 0.0, path.length).reshape(found[r, c].shape)
        return found, np.nanmean(reach, axis=1)
