"""Paths along the thread in one image: its detected points in order, from where the rod begins (docs/perception.md).

Points that follow each other along their directions are chains. A chain ends where the thread ends, is hidden, or crosses
itself; its end is joined to ends of other chains that go on in its direction. A path is a sequence of joined chains, each used
once: at a crossing there are several. And the detected line at the places of a rod's image.

Axes: N detected points, M of a path, A image sets, C cameras, E edges of a rod, K places along an edge.
"""

import heapq
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree

from doo_ti.rod.frames import arc_lengths, curve_length, placed, unit_vectors
from doo_ti.rod.types import Configuration
from doo_ti.vision.cameras import Rig
from doo_ti.vision.detection import NEAR_PX, NEXT_PX, SHORTEST_PX, Detection, chains_of, outward, single, thinned
from doo_ti.vision.distance_map import ALIKE, MOST_IMAGE_PX, beside_itself, left_out, nearest_place

WIDEST_GAP = 0.3  # of the image's height: the longest gap that a path crosses
FORWARD = 0.64  # least cosine between the direction of an end and the way to the next
TURNING = 2.0  # cost in lengths of a gap for each rad that the thread would turn in it
CORNER_PX = 8.0  # ends this near are joined whatever their directions: a thread turning back at the camera has a corner
CLOSE_PX = 2.0  # a shorter gap has no direction
BESIDE_PX = 6.0  # an end this near to the inside of another chain divides it, so that a path may change over
AGAINST = 0.5
"""Share of the detected line that a path against the given direction must have more: an image of a direction that points at the
camera says little."""
CROSSING_PX, NEIGHBOURS = 1.5, 12  # chains cross where points are this near that are so many apart along one chain
ALIKE_PX = 4.0  # mean distance below which two paths are the same
SHARP = 0.5  # cosine of the turn from a width before a place to a width after it: lines cut sharper bends short
TURN = 2.0  # lines of two parts of a rod merge that are farther apart along it than this times their distance; half a turn: π/2
MOST_JOINTS, MOST_TRIED = 4, 400  # ends that an end is joined to, and parts of paths that are looked at


@dataclass(frozen=True)
class ImagePath:
    """A path along the detected thread in one image."""

    points: np.ndarray  # (M, 2) px, a pixel apart
    seen: np.ndarray  # (M,) bool: on the detection; false across a gap
    cost: float  # px of gaps, turns in them counted as lengths
    share: float  # of the detected line that is on the path

    @cached_property
    def tangents(self) -> np.ndarray:
        """(M, 2) unit vectors."""
        padded = np.pad(self.points, ((2, 2), (0, 0)), mode="reflect", reflect_type="odd")
        smoothed = np.stack([np.convolve(column, np.full(5, 1 / 5), mode="valid") for column in padded.T], axis=1)
        return unit_vectors(np.gradient(smoothed, axis=0))

    @property
    def length(self) -> float:
        """px."""
        return len(self.points) - 1.0

    def at(self, arc: np.ndarray) -> np.ndarray:
        """(..., 2) px of the points at arc lengths ``arc`` (...) px from the first, within the path."""
        place = np.arange(len(self.points), dtype=float)
        return placed(arc, place, self.points)

    def tangent_at(self, arc: np.ndarray) -> np.ndarray:
        """(..., 2) unit vectors."""
        return self.tangents[self._nearest(arc)]

    def is_seen(self, arc: np.ndarray) -> np.ndarray:
        """(...) bool."""
        return self.seen[self._nearest(arc)]

    def followed(self, pixels: np.ndarray, arc: np.ndarray, window: int) -> np.ndarray:
        """(K,) places along the path nearest to ``pixels`` (K, 2), within ``window`` px of ``arc`` (K,), in order."""
        near = np.clip(arc[:, None] + np.arange(-window, window + 1), 0.0, self.length)
        apart = np.linalg.norm(self.at(near) - pixels[:, None], axis=-1)
        return np.maximum.accumulate(near[np.arange(len(arc)), np.nan_to_num(apart, nan=np.inf).argmin(axis=1)])

    def _nearest(self, arc: np.ndarray) -> np.ndarray:
        return np.clip(np.round(arc), 0, len(self.points) - 1).astype(np.int64)


@dataclass(frozen=True)
class Chains:
    """The detected line of an image in chains, from which paths begin anywhere."""

    points: list[np.ndarray]  # (M, 2) px of each chain
    # for each end (chain, way) the ends that may follow, (cost, chain, way in which it is then followed), the best first
    joints: dict[tuple[int, int], list[tuple[float, int, int]]]

    @classmethod
    def of(cls, detection: Detection) -> "Chains":
        whole = chains_of(*single(detection))
        if not whole:
            return cls([], {})
        chains, wide = _divided(whole), max(CLOSE_PX, float(np.nan_to_num(detection.width_px)))
        return cls(chains, _joints(chains, WIDEST_GAP * detection.shape[0], wide))

    @property
    def free_ends(self) -> np.ndarray:
        """(K, 2) px: ends that are joined to no other, the thread's ends among them."""
        free = [self.points[c][-1 if way else 0] for (c, way), others in self.joints.items() if not others]
        return np.array(free).reshape(-1, 2)


def paths_from(line: Chains, start: np.ndarray, direction: np.ndarray | None, most: int = 4) -> list[ImagePath]:
    """Up to ``most`` paths from the place ``start`` (2,) px on, in the ``direction`` (2,), or in either where that is None;
    those that explain most of the thread first."""
    chains, joints = line.points, line.joints
    if not chains:
        return []
    every, chain, place = _numbered(chains)
    nearest = int(np.argmin(np.linalg.norm(every - start, axis=1)))
    first, at = int(chain[nearest]), int(place[nearest])
    found, whole = [], sum(map(curve_length, chains))
    for way in (0, 1):
        rest = chains[first][at:] if way else chains[first][: at + 1][::-1]
        turn = 0.0
        if direction is not None and len(rest) > 1:
            cosine = -outward(rest, 0) @ direction / max(np.linalg.norm(outward(rest, 0)) * np.linalg.norm(direction), 1e-12)
            turn = float(np.arccos(np.clip(cosine, -1.0, 1.0)))
        found += _searched(chains, joints, first, rest, way, AGAINST * (turn / np.pi) ** 2 * whole)
    found.sort(key=lambda one: -one[0])
    kept: list[ImagePath] = []
    for _, pieces, cost in found:
        path = _resampled(pieces, cost, whole)
        if len(kept) == most:
            break
        if len(path.points) > SHORTEST_PX and not any(_alike(path, other) for other in kept):
            kept.append(path)
    return kept


# --- chains ---------------------------------------------------------------------------------------------------------------

def _numbered(chains: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(N, 2) px: the points of all chains; and (N,) twice: in which chain each is, and at which place of it."""
    sizes = [len(points) for points in chains]
    return np.concatenate(chains), np.repeat(np.arange(len(chains)), sizes), np.concatenate([*map(np.arange, sizes)])


def _divided(chains: list[np.ndarray]) -> list[np.ndarray]:
    """The chains, divided where an end of another one meets their inside."""
    cuts = [set() for _ in chains]
    trees = [cKDTree(chain) for chain in chains]
    for c, chain in enumerate(chains):
        for way in (0, 1):
            end, out = chain[-1 if way else 0], outward(chain, way)
            for other, tree in enumerate(trees):
                if other == c:
                    continue
                near = [k for k in tree.query_ball_point(end, BESIDE_PX) if (chains[other][k] - end) @ out > 0]
                if near:
                    k = min(near, key=lambda k: np.linalg.norm(chains[other][k] - end))
                    if min(curve_length(chains[other][: k + 1]), curve_length(chains[other][k:])) > SHORTEST_PX:
                        cuts[other].add(k)
    _cross_cuts(chains, cuts)
    return [part for chain, at in zip(chains, cuts, strict=True) for part in np.split(chain, sorted(at)) if len(part)]


def _cross_cuts(chains: list[np.ndarray], cuts: list[set]) -> None:
    """Add where chains cross each other, or themselves, to ``cuts``."""
    every, chain, place = _numbered(chains)
    pairs = cKDTree(every).query_pairs(CROSSING_PX, output_type="ndarray")
    apart = (chain[pairs[:, 0]] != chain[pairs[:, 1]]) | (np.abs(place[pairs[:, 0]] - place[pairs[:, 1]]) > NEIGHBOURS)
    for pair in pairs[apart]:
        for c, k in zip(chain[pair], place[pair], strict=True):
            inside = NEIGHBOURS // 2 < k < len(chains[c]) - NEIGHBOURS // 2
            if inside and all(abs(k - other) > NEIGHBOURS for other in cuts[c]):
                cuts[c].add(int(k))


def _joints(chains: list[np.ndarray], gap: float, wide: float) -> dict[tuple[int, int], list[tuple[float, int, int]]]:
    """As :class:`Chains` has them, across gaps of up to ``gap`` px. Within the thread, ``wide`` px, the way across says
    nothing: the line on a laid rope jumps from strand to strand."""
    ends = [(c, way) for c in range(len(chains)) for way in (0, 1)]
    places = np.array([chains[c][-1 if way else 0] for c, way in ends])
    out = np.array([outward(chains[c], way) for c, way in ends])
    found = {}
    for k, (c, way) in enumerate(ends):
        step = places - places[k]
        length = np.linalg.norm(step, axis=1)
        ahead = np.where(length[:, None] > wide, step / np.maximum(length, 1e-9)[:, None], out[k])
        leaving, entering = ahead @ out[k], -(ahead * out).sum(axis=1)
        turn = np.arccos(np.clip(leaving, -1, 1)) + np.arccos(np.clip(entering, -1, 1))
        cost = length + (length + 0.5 * CORNER_PX) * TURNING * turn
        fits = (length <= gap) & (leaving >= FORWARD) & (entering >= FORWARD) | (length <= CORNER_PX)
        fits &= np.array(ends)[:, 0] != c
        order = sorted(np.flatnonzero(fits), key=lambda j: cost[j])[:MOST_JOINTS]
        found[c, way] = [(float(cost[j]), ends[j][0], 1 - ends[j][1]) for j in order]
    return found


def _searched(chains, joints, first: int, begin: np.ndarray, way: int, cost: float) -> list:
    """(score, pieces, cost) of the paths that begin with the part ``begin`` of chain ``first``."""
    waiting, found = [(cost - curve_length(begin), 0, (first,), way, [begin], cost)], []
    tried = 0
    while waiting and tried < MOST_TRIED:
        score, _, used, way, pieces, cost = heapq.heappop(waiting)
        tried += 1
        on = [one for one in joints[used[-1], way] if one[1] not in used]
        found.append((-score, pieces, cost))
        for extra, chain, follow in on:
            piece = chains[chain] if follow else chains[chain][::-1]
            gain = curve_length(piece) - extra
            heapq.heappush(waiting, (score - gain, tried * 10 + len(waiting), (*used, chain), follow, [*pieces, piece],
                                     cost + extra))
    return found


def _alike(one: ImagePath, other: ImagePath) -> bool:
    """Whether two paths are at the same places, share by share of their lengths."""
    share = np.linspace(0.0, 1.0, 64)
    apart = one.at(share * one.length) - other.at(share * other.length)
    return bool(np.linalg.norm(apart, axis=1).mean() < ALIKE_PX)


def _resampled(pieces: list[np.ndarray], cost: float, whole: float) -> ImagePath:
    points = np.concatenate(pieces)
    last = np.cumsum([len(piece) for piece in pieces])[:-1]
    arc = arc_lengths(points)
    place = np.arange(0.0, arc[-1])
    seen = np.ones(len(place), dtype=bool)
    for k in last:
        if arc[k] - arc[k - 1] > NEXT_PX:
            seen &= ~((place > arc[k - 1]) & (place < arc[k]))
    return ImagePath(placed(place, arc, points), seen, cost, min(1.0, sum(map(curve_length, pieces)) / whole))


# --- the line at the places of a rod's image ----------------------------------------------------------------------------------

NEIGHBOURS = 8  # points nearest to a place that are looked at: the nearest may be of a strand that crosses there


Lines = list[list[tuple[np.ndarray, np.ndarray, cKDTree | None]]]  # of :func:`line_trees`


def line_trees(detections: Sequence[Sequence[Detection]]) -> Lines:
    """Of each detection its points (N, 2), about one for each pixel of line, their directions, and a tree to search them; None
    without any."""
    lines = [[thinned(detection) for detection in images] for images in detections]
    return [[(points, direction, cKDTree(points) if len(points) else None) for points, direction in views] for views in lines]


def thread_beyond(rig: Rig, rods: Configuration, detections: Sequence[Sequence[Detection]], from_start: np.ndarray
                  ) -> np.ndarray:
    """(A, 2) mm of thread that may go on beyond rods' starts, of those ``from_start`` (A,) bool, and beyond their ends: in the
    camera that shows most, at the scale of the rod's image. Behind a wide gap two cameras must show it: one may show anything.
    There it is the gain of both together that counts, as the piece behind the gap may be short in one of them."""
    beyond, images = np.zeros((len(detections), 2, len(rig.cameras), 3)), rig.project(rods.vertices)
    for c, row in np.ndindex(images.shape[:2]):
        line, wide = Chains.of(detections[row][c]), max(NEAR_PX, detections[row][c].width_px)
        for end, way in enumerate((-1, 1)):
            if end or from_start[row]:
                beyond[row, end, c] = _lines_beyond(line, wide, images[c, row, ::way]) / max(curve_length(images[c, row]), 1e-9)
    two = np.argsort(np.where(beyond[..., 2] > 0, beyond[..., 1], -np.inf), axis=-1)[..., -2:]
    gain, behind = (np.take_along_axis(beyond[..., kind], two, axis=-1) for kind in (1, 2))
    behind = np.where(gain.sum(axis=-1) > 0, behind.min(axis=-1), 0.0)
    return np.maximum(beyond[..., 0].max(axis=-1), behind) * rods.rest_length.sum(axis=-1).reshape(-1, 1)


def _lines_beyond(line: Chains, wide: float, image: np.ndarray) -> np.ndarray:
    """(3,) px: of line that goes on beyond the end of a rod's ``image`` (V, 2), which is ``wide`` px or less, on the path that
    explains most for its cost; and, where turning in gaps costs nothing, by how much that behind gaps is longer than these, on
    the path of which that is most, and the line on it. Corners do not count: what a thread ends on goes on to the side."""
    arc = arc_lengths(image)
    if not line.points or not arc[-1] <= MOST_IMAGE_PX:
        return np.zeros(3)
    rod = cKDTree(placed(np.arange(0.0, arc[-1] + 0.5, 0.5), arc, image))
    every, chain, place = _numbered(line.points)
    padded = [np.pad(points, ((1, 1), (0, 0)), mode="edge") for points in line.points]
    along = unit_vectors(np.concatenate([points[2:] - points[:-2] for points in padded])) @ outward(image, 1)
    on = (rod.query(every)[0] <= NEAR_PX) & (np.abs(along) >= ALIKE)
    if not on.any():
        return np.zeros(3)
    last = int(np.where(on, np.linalg.norm(every - image[-1], axis=1), np.inf).argmin())
    way, own = int(along[last] > 0), line.points[chain[last]]
    rest = own[place[last] :] if way else own[place[last] :: -1]
    plain, behind = (-np.inf, 0.0), (0.0, 0.0)  # gain, and line
    for _, (own, *others), cost in _searched(line.points, line.joints, int(chain[last]), own if way else own[::-1], way, 0.0):
        joints = [*pairwise([own, *others])]
        if all(-outward(after, 0) @ outward(before, 1) >= FORWARD for before, after in joints):
            gaps = sum(np.linalg.norm(after[0] - before[-1]) for before, after in joints)
            length = sum(map(curve_length, others))
            new = sum(curve_length(piece) * (rod.query(piece)[0] > wide).mean() for piece in (rest, *others))
            plain = max(plain, (length - cost, new))
            if others and new > 0:
                behind = max(behind, (length - gaps, new)) if behind[1] else (length - gaps, new)
    return np.array([plain[1], *behind])


def lines_at(places: np.ndarray, ways: np.ndarray, lines: Lines) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The detected lines at ``places`` (A, C, …, 2) px of images that run along ``ways`` there: their points and unit tangents
    (A, C, …, 2), zero where there is none, and (A, C, …) bool: whether a point of like direction is near."""
    points, tangents = np.zeros((2, *places.shape))
    found = np.zeros(places.shape[:-1], dtype=bool)
    for row, c in np.ndindex(places.shape[:2]):
        seen, direction, tree = lines[row][c]
        if tree is None:
            continue
        way = ways[row, c][..., None, :]
        apart, nearest = tree.query(places[row, c], NEIGHBOURS)
        nearest = np.minimum(nearest, len(seen) - 1)
        cosine = (direction[nearest] * way).sum(axis=-1)
        alike = (apart <= NEAR_PX) & (np.abs(cosine) >= ALIKE * np.linalg.norm(way, axis=-1))
        share = (alike / np.maximum(alike.sum(axis=-1, keepdims=True), 1))[..., None]
        along = (share * np.sign(cosine)[..., None] * direction[nearest]).sum(axis=-2)
        # Points of a bend lie inside of it, and where their tangents lead outside: the mean of both is on it.
        ahead = ((places[row, c][..., None, :] - seen[nearest]) * direction[nearest]).sum(axis=-1, keepdims=True)
        points[row, c] = (share * (seen[nearest] + 0.5 * ahead * direction[nearest])).sum(axis=-2)
        tangents[row, c] = unit_vectors(along)
        found[row, c] = alike.any(axis=-1) & along.any(axis=-1)
    return points, tangents, found


def contradicted(places: np.ndarray, found: np.ndarray, lines: Lines) -> np.ndarray:
    """(A, E, K) bool: ``places`` (A, C, E, K, 2) px at which some camera has not ``found`` (A, C, E, K) the rod's line, but one
    that leaves the rod there. The end of a rod that is longer than the thread in the images folds along the line of sight of
    some cameras, and leaves the line in others: which of them show it is not known."""
    against = np.zeros((len(places), *places.shape[2:4]), dtype=bool)
    for row, c in np.ndindex(places.shape[:2]):
        (points, _, tree), lost = lines[row][c], ~found[row, c].ravel()
        if tree is None or not lost.any():
            continue
        nearest, far = nearest_place(points, places[row, c].reshape(-1, 2))
        stretch = np.cumsum(np.diff(lost, prepend=lost[0]))  # places one after the other that are lost, or are not
        leaving = stretch[np.rint(nearest[left_out(points, far)]).astype(int)]
        against[row] |= (lost & np.isin(stretch, leaving)).reshape(against.shape[1:])
    return against


def merged(places: np.ndarray, inside: np.ndarray, lines: Lines, width: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(A, C, E, K) bool twice: ``places`` (A, C, E, K, 2) px within the ``width`` (A, C, 1) px of the line of other strands,
    and those where the rod itself runs as close to another part of it, or bends too sharply: there one line lies between both.
    Other strands are those beside places ``inside`` the rod's line; elsewhere it leaves its own line."""
    others, itself = np.zeros((2, *inside.shape), dtype=bool)
    for row, c in np.ndindex(inside.shape[:2]):
        points, image, reach = lines[row][c][0], places[row, c].reshape(-1, 2), NEAR_PX + width[row, c, 0]
        nearest, far = nearest_place(points, image)
        other = points[far & inside[row, c].ravel()[np.rint(nearest).astype(int)]]
        if len(other):
            others[row, c] = cKDTree(other).query(places[row, c])[0] <= reach
        twice, arc = beside_itself(image, reach, TURN * reach), arc_lengths(image)
        before, after = (way * (placed(arc + way * width[row, c, 0], arc, image) - image) for way in (-1, 1))
        bent = (before * after).sum(axis=1) < SHARP * np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1)
        itself[row, c].flat = bent | twice[np.minimum(arc, len(twice) - 1).astype(int)]
    return others, itself
