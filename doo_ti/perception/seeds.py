"""Where a rod begins, found in the images: from a clicked pixel, or from two (docs/perception.md).

A click names the end of the detected line that is nearest, or a place on it. In a camera without a click the rod begins at an
end, or else at a place, of the detected line near the epipolar line of the click. Of several the one is taken whose paths from
there on belong together best. The curve along these paths says where the rod begins in depth.

Threads of unknown length, from a seed to where they end in the images (docs/perception.md).

Between cameras that are close together a rod that is too long folds along the line of sight, and explains the images as well
as a shorter one: to end where the paths end does not determine its length. So it is chosen as everything else is, by E_vis
with evidence from both sides. The best rods are relaxed again with lengths a little shorter and longer. Lengths whose E_vis
exceeds the least one by less than what makes a runner-up ambiguous explain the images as well: they are the range of the
thread's length. Within that, it is the one with which the best rod ends where its paths end. The range is wider by what the
ends of lines tell of those of threads, which may be cut or round.

Axes: A image sets, R rods, L lengths.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import PchipInterpolator

from doo_ti.perception.matching import best_matches, curve_of, epipolar_distance
from doo_ti.perception.search import PerceptionOptions, evidence
from doo_ti.perception.traced import PATHS, whole_rods
from doo_ti.rod.types import Material
from doo_ti.system.errors import InputError
from doo_ti.vision.cameras import Rig
from doo_ti.vision.detection import Detection, thinned
from doo_ti.vision.distance_map import distance_maps
from doo_ti.vision.paths import Chains, paths_from
from doo_ti.vision.triangulation import rays

CLICK_PX, END_PX = 30.0, 15.0  # A click is this near to the thread; an end this near to a click is meant
EPIPOLAR_PX = 8.0  # an end this near to the epipolar line of a click may be its image
MOST_PLACES = 12
SMOOTH = 1e3
LONG_PX = 0.05  # cost of a curve e times as long: a long thread that looks short in all images is improbable
FAR = 30.0  # distances between cameras: how far away a thread is thought to begin whose rays do not meet in front of them


def seed_from_pixels(rig: Rig, detections: Sequence[Detection], clicks: Mapping[int, Sequence[float]], source: str
                     ) -> np.ndarray:
    """(3,) mm where the rod begins.

    detections  of the C cameras
    clicks      camera: (u, v) px; one or more

    Raises InputError, naming ``source``, for a single camera, and where no thread is near a click, or nothing in another image
    belongs to it.
    """
    if len(rig.cameras) == 1:
        raise InputError(source, "--seed-pixel", "one camera does not see how far away the rod begins", "give --seed-point")
    lines = [Chains.of(detection) for detection in detections]
    given = {camera: _clicked(detections[camera], lines[camera], np.asarray(click, dtype=float), source)
             for camera, click in clicks.items()}
    known = min(given)
    places = [given[camera] if camera in given else _across(rig, known, camera, given[known][0], *one)
              for camera, one in enumerate(zip(detections, lines, strict=True))]
    if not all(len(there) for there in places):
        camera = next(camera for camera, there in enumerate(places) if not len(there))
        raise InputError(source, "--seed-pixel", f"nothing in the image of {rig.names[camera]} belongs to the pixel",
                         "give a pixel in that camera, too")
    best = None
    for choice in _choices(places):
        found = _seed(rig, lines, choice)
        if found is not None and (best is None or found[0] < best[0]):
            best = found
    if best is None:
        raise InputError(source, "--seed-pixel", "no thread can be followed from there", "give another pixel, or --seed-point")
    return best[1]


def _clicked(detection: Detection, line: Chains, click: np.ndarray, source: str) -> np.ndarray:
    """(1, 2) px: the end near the click, else the place of the line nearest to it."""
    points = thinned(detection)[0]
    nearest = points[np.linalg.norm(points - click, axis=1).argmin()]
    if np.linalg.norm(nearest - click) > CLICK_PX:
        raise InputError(source, "--seed-pixel", f"{click[0]:g},{click[1]:g}: the nearest thread is "
                         f"{np.linalg.norm(nearest - click):.0f} px away", "click on the thread")
    ends = line.free_ends
    if len(ends):
        apart = np.linalg.norm(ends - click, axis=1)
        if apart.min() <= END_PX:
            return ends[[int(apart.argmin())]]
    return nearest[None]


def _across(rig: Rig, known: int, camera: int, pixel: np.ndarray, detection: Detection, line: Chains) -> np.ndarray:
    """(K, 2) px in ``camera`` that may belong to ``pixel`` of the camera ``known``: ends near its epipolar line, else places of
    the line on it."""
    ends, points = line.free_ends, thinned(detection)[0]
    if len(ends):
        apart = epipolar_distance(rig, known, camera, pixel[None], ends)[0]
        near = np.flatnonzero(apart <= EPIPOLAR_PX)
        if len(near):
            return ends[near[np.argsort(apart[near], kind="stable")]][:MOST_PLACES]
    apart = epipolar_distance(rig, known, camera, pixel[None], points)[0]
    kept: list[np.ndarray] = []
    for place in points[np.argsort(apart, kind="stable")][apart.min() + 1.0 >= np.sort(apart)]:
        if len(kept) < MOST_PLACES and all(np.linalg.norm(place - other) > END_PX for other in kept):
            kept.append(place)
    return np.array(kept).reshape(-1, 2)


def _choices(places: list[np.ndarray]):
    """One place of each camera: the first of most cameras, each of those of every camera in turn."""
    first = [there[0] for there in places]
    yield first
    for camera, there in enumerate(places):
        for other in there[1:]:
            yield [*first[:camera], other, *first[camera + 1 :]]


def _seed(rig: Rig, lines: Sequence[Chains], pixels: Sequence[np.ndarray]) -> tuple[float, np.ndarray] | None:
    """(cost in px, point) of the rod that begins at ``pixels`` of the cameras; None where none does."""
    paths = [paths_from(line, pixel, None, PATHS) for line, pixel in zip(lines, pixels, strict=True)]
    matches = best_matches(rig, paths, 1)
    if not matches:
        return None
    curve, _ = curve_of(rig, matches[0], _between_rays(rig, pixels), SMOOTH, held=0.0)
    length = float(np.linalg.norm(np.diff(curve, axis=0), axis=1).sum())
    return matches[0].cost + LONG_PX * np.log(max(length, 1e-9)), curve[0]


def _between_rays(rig: Rig, pixels: Sequence[np.ndarray]) -> np.ndarray:
    """(3,) mm: the point in front of the first camera that is nearest to the rays of ``pixels``, one of each camera."""
    ways = np.array([rays(camera, pixel[None])[0] for camera, pixel in zip(rig.cameras, pixels, strict=True)])
    across = np.eye(3) - ways[:, :, None] * ways[:, None, :]
    first, centres = rig.cameras[0].centre, np.array([camera.centre for camera in rig.cameras])
    # Along the first ray, where its distances from the others are least.
    rate = (across[1:] @ ways[0]).reshape(-1)
    miss = np.einsum("cij,cj->ci", across[1:], centres[1:] - first).reshape(-1)
    far = float(rate @ miss / max(rate @ rate, 1e-15))
    base = np.linalg.norm(centres - first, axis=1).max()
    return first + ways[0] * (far if far > 0 else max(FAR * base, 1.0))


EDGES = 120
BEST = 3  # rods of a set that are tried with other lengths
TIMES = np.array([0.88, 0.94, 0.97, 0.985, 0.995, 1.0, 1.005, 1.015, 1.03, 1.06])
"""Those lengths, over those with which rods end where their paths end: E_vis rises steeply on both sides."""
FINE = 361  # lengths between the first and the last of them that are compared
POINTS = 2  # places along an edge where a map is sampled
ROUNDS = 3
AMBIGUOUS_PX = 0.02  # E_vis over ν and the length of all detected lines, in px, by which a length is no worse than the best


@dataclass(frozen=True)
class WholeThreads:
    """Of A sets; NaN where no thread can be followed from the seed."""

    length: np.ndarray  # (A,) mm
    range: np.ndarray  # (A, 2) mm: the shortest and the longest length that explains the images as well
    direction: np.ndarray  # (A, 3) unit vectors of the beginnings


def whole_threads(rig: Rig, detections: Sequence[Sequence[Detection]], point: np.ndarray, direction: np.ndarray | None,
                  material: Material, up: np.ndarray, options: PerceptionOptions = PerceptionOptions()) -> WholeThreads:
    """The thread from each seed ``point`` (A, 3) mm in its ``direction`` (A, 3), or in the one in which it goes on.

    options  whose ν and cap E_vis has
    """
    length, ways = np.full(len(point), np.nan), np.full((len(point), 3), np.nan)
    bounds = np.full((len(point), 2), np.nan)
    for row, images in enumerate(detections):  # maps of all sets at once may not fit into memory
        way = None if direction is None else direction[row : row + 1]
        tracing, rods = whole_rods(rig, [images], point[row : row + 1], way, np.full(EDGES, 1 / EDGES), material, up)
        if rods is None:
            continue
        maps, looked = distance_maps([list(images)]), (material, up, options, POINTS)
        energy, _ = evidence(rig, maps, rods.solution.configuration, tracing.of_set, *looked)
        rows = np.repeat(np.argsort(energy, kind="stable")[:BEST], len(TIMES))
        tracing, tried = tracing.take(rows), rods.take(rows)
        tried = replace(tried, length=tried.length * np.tile(TIMES, len(rows) // len(TIMES)))
        tried = tracing.relaxed(tried, np.ones(len(rows), dtype=bool), ROUNDS)
        energy, found = evidence(rig, maps, tried.solution.configuration, tracing.of_set, *looked)
        energy, lengths = energy.reshape(-1, len(TIMES)), tried.length.reshape(-1, len(TIMES))
        slack = AMBIGUOUS_PX * options.nu * found.line[0].sum()
        length[row], alike = _profiled(lengths, energy, slack)
        nearest = int(np.argmin(np.where(energy <= energy.min() + slack, np.abs(lengths - length[row]), np.inf)))
        rod = tried.solution.configuration.take([nearest])
        bounds[row] = alike + _of_ends(rig, images, rod.vertices[0]) * np.array([-1.0, 1.0])
        ways[row] = rod.frames[0, 0, :, 0]
    return WholeThreads(length, bounds, ways if direction is None else direction)


def _of_ends(rig: Rig, images: Sequence[Detection], vertices: np.ndarray) -> float:
    """mm by which the rod ``vertices`` (V, 3) may be longer or shorter, because in each image the line ends within half the
    thread's width of where its axis does."""
    half, total = 0.5 * np.array([detection.width_px for detection in images]), 0.0
    for outer, inner in ((0, 1), (-1, -2)):
        step = np.linalg.norm(vertices[outer] - vertices[inner])
        seen = np.linalg.norm(rig.project(vertices[outer]) - rig.project(vertices[inner]), axis=-1) / step  # px per mm
        total += float(np.nansum(half * seen) / max(np.nansum(seen**2), 1e-12))
    return total


def _profiled(length: np.ndarray, energy: np.ndarray, slack: float) -> tuple[float, tuple[float, float]]:
    """The length of the thread, and the least and the largest one whose energy exceeds the least by ``slack`` at most.

    length, energy  (R, L) of rods with TIMES their length
    """
    fine, values = [], []
    for tried, found in zip(length, energy, strict=True):
        if np.isfinite(found).all():
            fine.append(np.linspace(tried[0], tried[-1], FINE))
            values.append(PchipInterpolator(tried, found)(fine[-1]))  # monotone between the lengths: no minimum of its own
    if not fine:
        best = np.unravel_index(np.argmin(energy), energy.shape)
        return float(length[best]), (float(length.min()), float(length.max()))
    every, least = np.concatenate([*fine, length.ravel()]), np.concatenate([*values, energy.ravel()])
    alike = every[least <= least.min() + slack]
    at_end = int(np.argmax(TIMES == 1.0))
    best = int(np.argmin(energy[:, at_end]))
    sound = energy[best, at_end] <= least.min() + slack
    return float(length[best, at_end] if sound else every[np.argmin(least)]), (float(alike.min()), float(alike.max()))
