"""Where a rod begins, found in the images: from a clicked pixel, or from two (docs/perception.md).

A click names the end of the detected line that is nearest, or a place on it; in a camera without one the rod begins at an end,
or a place, near the epipolar line of the click. Of several choices the one is taken whose rays meet and whose paths from there
on belong together best. The rod begins on the curve along these paths, where the ends, or clicks, are, each as far as it is
certain. Of three cameras or more some may not see where it begins.

Threads of unknown length end where they end in the images. Between cameras that are close together a rod that is too long folds
along the line of sight, and explains the images as well as a shorter one. So its length is chosen by E_vis with evidence from
both sides, too: the best rods are relaxed again with lengths a little shorter and longer. Those whose E_vis is nearly the
least are the range of the length, widened on both sides by the width of the line's ends. The length at which the rod ends where
its paths end is taken if it is in the range, else that with the least E_vis.

Axes: A image sets, R rods, L lengths.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import PchipInterpolator

from doo_ti.perception.matching import MOST_PLACES, curve_of, epipolar_distance, likely_matches
from doo_ti.perception.search import PerceptionOptions, evidence
from doo_ti.perception.traced import PATHS, whole_rods
from doo_ti.rod.frames import normal_to
from doo_ti.rod.types import Material
from doo_ti.system.errors import InputError
from doo_ti.vision.cameras import Rig
from doo_ti.vision.detection import CLICK_PX, Detection, thinned
from doo_ti.vision.distance_map import distance_maps
from doo_ti.vision.paths import Chains, paths_from
from doo_ti.vision.triangulation import rays

HELP = "help the detection: --colour clicked, --polarity, --width or --masks"
END_PX = 15.0  # an end this near to a click is meant
EPIPOLAR_PX = 8.0  # an end this near to the epipolar line of a click may be its image
MOST_ENDS, MOST_CHOICES, FEW_PLACES = 12, 24, 150  # the last of the curves by which rigs are compared
LINE_PX, INSIDE_PX = 0.8, 3.0  # standard deviations of a place: across the line, and along it where no end is meant
SMOOTH, TANGENT = 100.0, 5  # of the curve; its places between which it has a direction
MISSED_PX = 0.2  # cost of rays that miss each other by as much as their places are uncertain along the line, times that
INSIDE_COST, HIDDEN_COST = 0.5, 0.5  # px, of a place that is no end of a line, and of a camera that sees no start
ALIKE_COST = 0.06  # px: standard deviation, over √½, of the cost of a choice that belongs together
MUCH_BETTER, A_LITTLE_PX = 0.75, 0.1  # share of the cost under a rig, and px, below which it is under one that fits much better
FAR = 30.0  # distances between cameras: how far away a thread is thought to begin whose rays do not meet in front of them


@dataclass(frozen=True)
class Seed:
    """Where a rod begins."""

    point: np.ndarray  # (3,) mm
    covariance: np.ndarray  # (3, 3) mm²
    inside: bool  # no end of the thread is near the click


@dataclass(frozen=True)
class _Place:
    """A place on a line where the rod may begin."""

    pixel: np.ndarray  # (2,) px
    tangent: np.ndarray  # (2,) unit vector along the line
    along: float  # px: its standard deviation along the line; infinite where only another camera says where it is


def seed_from_pixels(rig: Rig, detections: Sequence[Detection], clicks: Mapping[int, Sequence[float]], source: str,
                     before: np.ndarray | None = None, remedy: str = HELP) -> Seed:
    """Where the rod begins.

    detections  of the C cameras
    clicks      camera: (u, v) px; one or more
    before      (3,) mm, where the rod began a moment before, if known: other places cost their distance from it, px
    remedy      for clicks near which nothing was detected

    Raises InputError, naming ``source``, for a single camera, and where no thread is near a click, or no other line fits.
    """
    tried = [(cost, _settled(*rest)) for cost, *rest in _beginnings(rig, detections, clicks, source, remedy)]
    if before is not None:
        away = rig.project(np.stack([seed.point for _, seed in tried])) - rig.project(before[None])
        far = np.nan_to_num(np.linalg.norm(away, axis=-1).mean(axis=0), nan=1e6)  # NaN: behind a camera
        tried = [(cost + more, seed) for (cost, seed), more in zip(tried, far, strict=True)]
    least, best = min(tried, key=lambda one: one[0])
    apart = max(((seed.point - best.point) * np.exp(-(((cost - least) / ALIKE_COST) ** 2)) for cost, seed in tried),
                key=np.linalg.norm)
    return replace(best, covariance=best.covariance + np.outer(apart, apart))


def fit_better(rig: Rig, others: Mapping[str, Rig], detections: Sequence[Detection], clicks: Mapping[int, Sequence[float]]
               ) -> list[str]:
    """The names of those ``others`` under which the lines of two cameras fit together much better from a click on than under
    ``rig``, and about as well as under the best of them."""
    first = min(clicks)
    pair = first, next(camera for camera in range(len(detections)) if camera != first)
    images, click = [detections[camera] for camera in pair], {0: clicks[first]}
    if _clicked(images[0], Chains.of(images[0]), np.asarray(clicks[first], dtype=float), "", "").along == INSIDE_PX:
        return []  # a click within a line is not the rod's end: costs from there do not tell rigs apart

    def least(one: Rig) -> float:
        try:
            return min(cost for cost, *_ in _beginnings(one.take(pair), images, click, "", "", FEW_PLACES))
        except InputError:
            return np.inf

    costs, own = {name: least(other) for name, other in others.items()}, least(rig)
    best = min(costs.values(), default=np.inf)
    if not best < min(MUCH_BETTER * own, own - A_LITTLE_PX):
        return []
    return [name for name, cost in costs.items() if cost <= best + A_LITTLE_PX]


def _beginnings(rig: Rig, detections: Sequence[Detection], clicks: Mapping[int, Sequence[float]], source: str,
                remedy: str, places: int = MOST_PLACES) -> list[tuple]:
    """(cost in px, arguments of :func:`_settled`) of all choices of where the rod of :func:`seed_from_pixels`, which raises
    these errors, begins; curves are compared through so many ``places`` at most."""
    if len(rig.cameras) == 1:
        raise InputError(source, "--seed-pixel", "one camera does not see how far away the rod begins", "give --seed-point")
    lines = [Chains.of(detection) for detection in detections]
    given = {camera: _clicked(detections[camera], lines[camera], np.asarray(click, dtype=float), source, remedy)
             for camera, click in clicks.items()}
    known = min(given, key=lambda camera: (given[camera].along, camera))
    order = [known, *(camera for camera in range(len(lines)) if camera != known)]
    ends: list[list] = [[given[camera]] if camera in given else _across(rig, known, camera, given[known], detections[camera],
                                                                       lines[camera]) for camera in order]
    if sum(map(bool, ends)) < 2:
        raise InputError(source, "--seed-pixel", f"nothing in the image of {rig.names[order[1]]} belongs to the pixel",
                         "give a pixel in that camera, too")
    ordered, found = rig.take(order), []
    for miss, choice in _choices(ordered, ends, {order.index(camera) for camera in given}):
        if (begun := _beginning(ordered, [lines[camera] for camera in order], choice, places)) is not None:
            found.append((begun[0] + miss, *begun[1:]))
    if not found:
        raise InputError(source, "--seed-pixel", "no thread can be followed from there",
                         "give another pixel, --seed-point, or images in the order of the cameras")
    return found


def _clicked(detection: Detection, line: Chains, click: np.ndarray, source: str, remedy: str) -> _Place:
    """The end near the click, else the place of the line nearest to it."""
    points, direction = thinned(detection)
    apart = np.linalg.norm(points - click, axis=1)
    nearest = int(apart.argmin())
    if apart[nearest] > CLICK_PX:
        raise InputError(source, "--seed-pixel", f"{click[0]:g},{click[1]:g}: nothing was detected there, the nearest thread "
                         f"is {apart[nearest]:.0f} px away", f"if it is on the thread, {remedy}")
    ends = _ends(detection, line)
    off = [np.linalg.norm(end.pixel - click) for end in ends]
    if min(off, default=np.inf) <= END_PX:
        return ends[int(np.argmin(off))]
    return _Place(points[nearest], direction[nearest], INSIDE_PX)


def _ends(detection: Detection, line: Chains) -> list[_Place]:
    """The free ends of a line."""
    ends, (points, direction) = line.free_ends, thinned(detection)
    return [_Place(end, direction[np.linalg.norm(points - end, axis=1).argmin()], detection.end_sigma) for end in ends]


def _across(rig: Rig, known: int, camera: int, place: _Place, detection: Detection, line: Chains) -> list[_Place]:
    """Those in ``camera`` that may belong to the ``place`` in the camera ``known``: ends near its epipolar line, and places of
    the line on it."""
    if not detection.count:
        return []
    kept, (points, direction) = _ends(detection, line), thinned(detection)
    if kept:
        apart = epipolar_distance(rig, known, camera, place.pixel[None], np.array([end.pixel for end in kept]))[0]
        kept = [kept[k] for k in np.argsort(apart, kind="stable") if apart[k] <= EPIPOLAR_PX]
    apart = epipolar_distance(rig, known, camera, place.pixel[None], points)[0]
    for k in np.argsort(apart, kind="stable")[: np.count_nonzero(apart <= apart.min() + 1.0)]:
        if len(kept) < MOST_ENDS and all(np.linalg.norm(points[k] - other.pixel) > END_PX for other in kept):
            kept.append(_Place(points[k], direction[k], np.inf))
    return kept[:MOST_ENDS]


def _choices(rig: Rig, places: Sequence[list[_Place]], clicked: set[int]) -> list[tuple[float, list]]:
    """(cost in px, a place in each camera, or None in one that does not see where the rod begins): those of least cost of rays
    that miss each other. Cameras that are ``clicked`` see it."""
    found = [(0.0, [places[0][0]])]
    for camera, there in enumerate(places[1:], start=1):
        hidden = [None] if len(places) > 2 and camera not in clicked else []
        longer = [[*choice, place] for _, choice in found for place in [*there, *hidden]]
        found = sorted(((_missed(rig, choice), choice) for choice in longer), key=lambda one: one[0])[:MOST_CHOICES]
    return [(cost, choice) for cost, choice in found if sum(place is not None for place in choice) > 1]


def _missed(rig: Rig, choice: Sequence) -> float:
    """px: what it costs that rays miss each other, that a place is no end of a line, and that a camera sees no start."""
    seen = [place for place in choice if place is not None]
    inside = sum(np.isinf(place.along) for place in seen) if seen[0].along < INSIDE_PX else 0  # an end is one in all cameras
    cost = HIDDEN_COST * (len(choice) - len(seen)) + INSIDE_COST * inside
    if len(seen) < 2:
        return cost
    return cost + MISSED_PX * _depth(*_seeing(rig, choice))[2]


def _seeing(rig: Rig, choice: Sequence) -> tuple[Rig, list[_Place]]:
    """The cameras that see where the rod begins, and where."""
    kept = [camera for camera, place in enumerate(choice) if place is not None]
    return rig.take(kept), [choice[camera] for camera in kept]


def _beginning(rig: Rig, lines: Sequence[Chains], choice: Sequence, places: int) -> tuple | None:
    """(cost in px, arguments of :func:`_settled`) of the rod that begins at the places ``choice`` of the cameras; None where
    none does. Its curve is compared through so many ``places`` at most."""
    paths = [paths_from(line, place.pixel, None, PATHS) for line, place in zip(lines, choice, strict=True) if place is not None]
    rig, seen = _seeing(rig, choice)
    start, information, _ = _depth(rig, seen)
    matches = likely_matches(rig, paths, start, SMOOTH, 1, places)
    if not matches:
        return None
    curve, _, spread = curve_of(rig, matches[0], start, SMOOTH, LINE_PX**2 * information)
    return matches[0].cost_with(curve), rig, seen, curve, LINE_PX * spread


def _settled(rig: Rig, seen: Sequence[_Place], curve: np.ndarray, spread: float) -> Seed:
    """Where the rod begins by the places ``seen`` and by the beginning of a ``curve`` (K, 3), whose depth in the first camera
    is uncertain by the share ``spread``: along it, only the places say where."""
    sight, tangent = curve[0] - rig.cameras[0].centre, curve[min(TANGENT, len(curve) - 1)] - curve[0]
    tangent = tangent / max(np.linalg.norm(tangent), 1e-12)
    aside = sight - (sight @ tangent) * tangent  # across the curve, mm that all of its depth is
    held = np.outer(aside, aside) / max(spread * (aside @ aside), 1e-12) ** 2
    point = curve[0]
    for _ in range(ROUNDS):
        information, slope = held + 1e-12 * np.eye(3), held @ (curve[0] - point)
        for place, view in zip(seen, rig.cameras, strict=True):
            image, by_point, _ = view.project_with_jacobian(point[None])
            for way, sigma in ((normal_to(place.tangent), LINE_PX), (place.tangent, place.along)):
                row = way @ by_point[0] @ view.rotation
                information = information + np.outer(row, row) / sigma**2
                slope = slope + row * (way @ (place.pixel - image[0])) / sigma**2
        information = information + 1e-12 * np.trace(information) * np.eye(3)  # of places beside each other rounding is left
        point = point + np.linalg.solve(information, slope)
    return Seed(point, np.linalg.inv(information), seen[0].along == INSIDE_PX)


def _depth(rig: Rig, seen: Sequence[_Place]) -> tuple[np.ndarray, float, float]:
    """(3,) mm on the ray of the first place where it is nearest to the other ones, information of the logarithm of its depth
    from where these are along their lines, and how far they miss it, root mean square, over what is expected."""
    point, centre = _between_rays(rig, [place.pixel for place in seen]), rig.cameras[0].centre
    for _ in range(ROUNDS):
        information, slope, known, misses = 0.0, 0.0, 0.0, []
        for place, view in zip(seen[1:], rig.cameras[1:], strict=True):
            image, by_point, _ = view.project_with_jacobian(point[None])
            motion, off = by_point[0] @ view.rotation @ (point - centre), place.pixel - image[0]
            along = 1 / (place.along**2 + seen[0].along**2)
            ways = (normal_to(place.tangent), LINE_PX**-2), (place.tangent, along)
            information += sum(weight * (way @ motion) ** 2 for way, weight in ways)
            slope += sum(weight * (way @ motion) * (way @ off) for way, weight in ways)
            known += along * (place.tangent @ motion) ** 2
            misses.append(off @ off * along if along > 0 else 0.0)
        step = slope / information if information > 0 else 0.0
        point = centre + (point - centre) * np.exp(np.clip(np.nan_to_num(step), -0.5, 0.5))
    return point, float(np.nan_to_num(known)), float(np.nan_to_num(np.sqrt(np.mean(misses)), nan=np.inf))


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


EDGES, COARSE = 120, 3  # of the rods; every third is looked at for how much they turn
BEST = 3  # rods of a set that are tried with other lengths
TIMES = np.array([0.88, 0.94, 0.97, 0.985, 0.995, 1.0, 1.005, 1.015, 1.03, 1.06])
"""Those lengths, over those with which rods end where their paths end: E_vis rises steeply on both sides."""
FINE = 361  # lengths between the first and the last of them that are compared
POINTS = 2  # places along an edge where a map is sampled
ROUNDS = 3
BLUR_PX, FORESHORTENED = 1.0, 0.2
"""By how much lines end beyond a thread, and the least length of an image, over that in the camera where it is longest, that
says where a rod ends."""
AMBIGUOUS_PX = 0.02  # E_vis over ν and the length of all detected lines, in px, by which a length is no worse than the best


@dataclass(frozen=True)
class WholeThreads:
    """Of A sets; NaN where no thread can be followed from the seed."""

    length: np.ndarray  # (A,) mm
    range: np.ndarray  # (A, 2) mm: the shortest and the longest length that explains the images as well
    direction: np.ndarray  # (A, 3) unit vectors of the beginnings
    turn: np.ndarray  # (A,) rad by which their directions turn along them


def whole_threads(rig: Rig, detections: Sequence[Sequence[Detection]], point: np.ndarray, direction: np.ndarray | None,
                  material: Material, up: np.ndarray, options: PerceptionOptions = PerceptionOptions()) -> WholeThreads:
    """The thread from each seed ``point`` (A, 3) mm in its ``direction`` (A, 3), or in the one in which it goes on.

    options  whose ν and cap E_vis has
    """
    (length, turn), ways = np.full((2, len(point)), np.nan), np.full((len(point), 3), np.nan)
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
        tangents = rod.frames[0, ::COARSE, :, 0]
        turn[row] = np.arccos(np.clip((tangents[1:] * tangents[:-1]).sum(axis=1), -1.0, 1.0)).sum()
    return WholeThreads(length, bounds, ways if direction is None else direction, turn)


def _of_ends(rig: Rig, images: Sequence[Detection], vertices: np.ndarray) -> float:
    """mm by which the rod ``vertices`` (V, 3) may be longer or shorter: a line ends within half the thread's width, and the
    blur of the image, of its axis. The rod ends where lines do on average, but for images that hardly show its reach."""
    half, total = 0.5 * np.array([detection.width_px for detection in images]) + BLUR_PX, 0.0
    for outer, inner in ((0, 1), (-1, -2)):
        step = np.linalg.norm(vertices[outer] - vertices[inner])
        seen = np.linalg.norm(rig.project(vertices[outer]) - rig.project(vertices[inner]), axis=-1) / step  # px per mm
        total += float(np.nanmean(half / np.maximum(seen, max(FORESHORTENED * np.nanmax(seen), 1e-9))))
    return total


def _profiled(length: np.ndarray, energy: np.ndarray, slack: float) -> tuple[float, tuple[float, float]]:
    """The length of the thread, and the least and the largest one whose energy (R, L) exceeds the least by ``slack`` at most,
    of rods with TIMES their ``length`` (R, L)."""
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
