"""Curves in space from paths along a thread in two or more images (docs/perception.md).

Both paths begin where the rod begins, and go along it: the place in one grows with that in the other. So the places that belong
together are a monotone sequence of pairs, found by dynamic programming over how far each pair misses a point in space, in px.
Where a path runs along its epipolar lines all pairs fit: there lengths along both paths grow alike.

Depth along the rays of the first camera is then fitted to the other cameras, smooth along the curve: there only the distance
across a path counts, since that along it says nothing where it runs along the epipolar line.

Axes: C cameras, I and J places along two paths, K along the curve.
"""

from dataclasses import dataclass, replace

import numpy as np
import taichi as ti
from scipy.linalg import solveh_banded

from doo_ti.rod.frames import curve_length, normal_to
from doo_ti.system import runtime
from doo_ti.vision.cameras import Rig
from doo_ti.vision.paths import ImagePath
from doo_ti.vision.triangulation import rays

STEP_PX, MOST_PLACES = 2.0, 1000  # between places that are compared, or more where a path would have more places
FEWEST = 3  # places of a match: with fewer there is no curve
FARTHEST_PX = 12.0  # distances saturate there
SLIP = 0.15  # px: cost of a step along one path alone, over that of a step along both
LEFT_OVER = 1.0  # cost of each step that is left of a path where the other ends
UNEXPLAINED = 4.0  # px: cost of a path that explains nothing of the detection
ALONG = 0.02  # weight of a distance along a path over that across it
ROUNDS, FREE_ROUNDS = 6, 2  # linearisations of the depth, and the first of them, which keep the places found by matching
WINDOW_PX = 12  # how far a place moves along a path in one of them
RANKED, COARSE = 12, 120  # matches of least cost whose curves are compared, and places of these
LONG_PX = 0.05  # cost of a curve e times as long: a long thread that looks short in all images is improbable
NEARER = np.log(4.0)  # of the depth along a curve, over that of its start: a thread would look four times as wide, or thin
HELD = 1e4  # information at a start whose depth is given, over the median along the curve
BOTH, FIRST_ALONE, SECOND_ALONE = 0, 1, 2


@dataclass(frozen=True)
class Match:
    """Places along one path in each camera that belong together."""

    paths: tuple[ImagePath, ...]  # C of them
    arcs: np.ndarray  # (C, K) px along each path
    cost: float  # px: mean distance by which pairs miss a point in space, with gaps and what is left over

    def cost_with(self, curve: np.ndarray) -> float:
        """px: the cost, and that of the length of its ``curve`` (K, 3) mm."""
        return self.cost + LONG_PX * np.log(max(curve_length(curve), 1e-9))


def best_matches(rig: Rig, paths: list[list[ImagePath]], most: int, places: int = MOST_PLACES) -> list[Match]:
    """Up to ``most`` matches of the paths in each camera (C lists), the best first, of FEWEST places or more; none where a
    camera has no path. Paths are compared at so many ``places`` at most."""
    if not all(paths):
        return []
    first, others = paths[0], paths[1:]
    pairs = [(a, c + 1, b) for a in range(len(first)) for c, here in enumerate(others) for b in range(len(here))]
    step = max(STEP_PX, max(len(path.points) for some in paths for path in some) / places)
    found = dict(zip(pairs, _paired(rig, [(first[a], c, paths[c][b]) for a, c, b in pairs], step), strict=True))
    matches = []
    for a, path in enumerate(first):
        # The paths of the other cameras are chosen one by one: of two cameras the second best as well.
        ranked = [sorted((found[a, c, b][1], b) for b in range(len(paths[c]))) for c in range(1, len(paths))]
        choices = [[one[0][1] for one in ranked]]
        if len(ranked) == 1:
            choices += [[one[1]] for one in ranked[0][1:]]
        for choice in choices:
            matches.append(_joined(path, [(paths[c + 1][b], *found[a, c + 1, b]) for c, b in enumerate(choice)], step))
    matches = [match for match in matches if match.arcs.shape[1] >= FEWEST]
    return sorted(matches, key=lambda match: match.cost)[:most]


def likely_matches(rig: Rig, paths: list[list[ImagePath]], start: np.ndarray, smooth: float, most: int,
                   places: int = MOST_PLACES) -> list[Match]:
    """Up to ``most`` matches of paths from ``start`` (3,), the most probable first: of loops that are passed the other way
    round in one image the cost is hardly more, but their curves, as smooth as of :func:`curve_of`, run to and fro in depth."""
    found = best_matches(rig, paths, RANKED, places)
    if len(found) < 2:
        return found
    cost = []
    for match in found:
        step = max(1, match.arcs.shape[1] // COARSE)
        coarse = replace(match, arcs=match.arcs[:, ::step])
        cost.append(match.cost_with(curve_of(rig, coarse, start, smooth / step**3)[0]))
    return [found[k] for k in np.argsort(cost, kind="stable")[:most]]


def _joined(first: ImagePath, others, step: float) -> Match:
    """One match of several cameras, as far as all of them go."""
    arcs = _arcs(first, step)
    end = min([len(arcs), *(int(pairs[-1, 0]) + 1 for _, pairs, _ in others)])
    there = [np.interp(arcs[:end], step * pairs[:, 0], step * pairs[:, 1]) for _, pairs, _ in others]
    paths = (first, *(path for path, _, _ in others))
    cost = float(np.mean([path.cost / len(path.points) + UNEXPLAINED * (1 - path.share) for path in paths]))
    return Match(paths, np.array([arcs[:end], *there]), cost + float(np.mean([0.0, *(cost for _, _, cost in others)])))


@runtime.exclusive
def _paired(rig: Rig, problems, step: float) -> list[tuple[np.ndarray, float]]:
    """For each (path in camera 0, camera, path there) the (K, 2) places that belong together, in steps, and the mean cost."""
    if not problems:
        return []
    apart = [np.minimum(epipolar_distance(rig, 0, c, *(path.at(_arcs(path, step)) for path in (one, other))), FARTHEST_PX)
             for one, c, other in problems]
    sizes = np.array([one.shape for one in apart], dtype=np.int32)
    first = np.cumsum([0, *sizes.prod(axis=1)]).astype(np.int64)
    flat = np.concatenate([one.ravel() for one in apart]).astype(np.float32)
    total, came = np.empty_like(flat), np.empty(len(flat), dtype=np.int8)
    runtime.start()
    _least_costs(flat, first, sizes, total, came)
    parts = [(slice(a, b), size) for a, b, size in zip(first[:-1], first[1:], sizes, strict=True)]
    return [_walked(total[part].reshape(size), came[part].reshape(size)) for part, size in parts]


def _arcs(path: ImagePath, step: float) -> np.ndarray:
    """px along a path where it is compared."""
    return np.arange(0.0, len(path.points) - 1e-9, step)


@runtime.kernel
def _least_costs(
    apart: ti.types.ndarray(dtype=ti.f32, ndim=1),  # [place of a problem, line by line]
    first: ti.types.ndarray(dtype=ti.i64, ndim=1),  # [problem + 1]
    sizes: ti.types.ndarray(dtype=ti.i32, ndim=2),  # [problem, I J]
    total: ti.types.ndarray(dtype=ti.f32, ndim=1),  # least cost of a sequence of pairs that ends there, out
    came: ti.types.ndarray(dtype=ti.i8, ndim=1),  # its last step, out
):
    """Dynamic programming over pairs of places: each follows that before it in one path or in both."""
    for p in range(sizes.shape[0]):
        width = sizes[p, 1]
        for i in range(sizes[p, 0]):
            for j in range(width):
                here = ti.cast(first[p], ti.i32) + i * width + j
                cost, step = ti.select(i + j == 0, apart[here], 1e30), BOTH
                if i > 0 and j > 0:
                    cost = total[here - width - 1] + apart[here]
                if i > 0 and total[here - width] + 0.5 * apart[here] + SLIP < cost:
                    cost, step = total[here - width] + 0.5 * apart[here] + SLIP, FIRST_ALONE
                if j > 0 and total[here - 1] + 0.5 * apart[here] + SLIP < cost:
                    cost, step = total[here - 1] + 0.5 * apart[here] + SLIP, SECOND_ALONE
                total[here] = cost
                came[here] = ti.cast(step, ti.i8)


def _walked(total: np.ndarray, came: np.ndarray) -> tuple[np.ndarray, float]:
    """The sequence of pairs that costs least, from its best end on the last line or column back to the beginning."""
    count, width = total.shape
    last_line = total[-1] + LEFT_OVER * np.arange(width - 1, -1, -1)
    last_column = total[:, -1] + LEFT_OVER * np.arange(count - 1, -1, -1)
    i, j = count - 1, int(last_line.argmin())
    if last_column.min() < last_line.min():
        i, j = int(last_column.argmin()), width - 1
    cost = min(last_line.min(), last_column.min()) / max(count, width)
    found = [(i, j)]
    while i or j:  # along one path
        step = came[i, j]
        i, j = i - (step != SECOND_ALONE), j - (step != FIRST_ALONE)
        found.append((i, j))
    return np.array(found[::-1], dtype=float), float(cost)


def epipolar_distance(rig: Rig, a: int, b: int, one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(I, J) px by which pixels ``one`` (I, 2) of camera a and ``other`` (J, 2) of camera b miss one point in space, to first
    order (Sampson)."""
    first, second = rig.cameras[a], rig.cameras[b]
    x, y = rays(first, one) @ first.rotation.T, rays(second, other) @ second.rotation.T
    x, y = x / x[:, 2:], y / y[:, 2:]
    turn = second.rotation @ first.rotation.T
    move = second.translation - turn @ first.translation
    essential = np.array([[0, -move[2], move[1]], [move[2], 0, -move[0]], [-move[1], move[0], 0]]) @ turn
    lines, back = x @ essential.T, y @ essential
    size = ((lines[:, :2] ** 2).sum(axis=1) / second.lens[:2].mean() ** 2)[:, None] + (
        (back[:, :2] ** 2).sum(axis=1) / first.lens[:2].mean() ** 2)
    return np.abs(lines @ y.T) / np.sqrt(np.maximum(size, 1e-30))


# --- depth ----------------------------------------------------------------------------------------------------------------

def curve_of(rig: Rig, match: Match, start: np.ndarray, smooth: float, known: float | None = None
             ) -> tuple[np.ndarray, np.ndarray, float]:
    """(K, 3) mm: the curve from ``start`` (3,) along the rays of the first camera, (C, K) px where it is along the paths, and
    the standard deviation of the logarithm of its first depth for 1 px of the places' distances.

    known   information of the logarithm of the depth of ``start``, for 1 px of the places' distances; None: it is right
    smooth  weight of the squared second differences of ln depth, over the median information that the images hold of it
    """
    camera, arcs = rig.cameras[0], match.arcs.copy()
    ray = rays(camera, match.paths[0].at(arcs[0])) @ camera.rotation.T
    world, centre = (ray / ray[:, 2:]) @ camera.rotation, camera.centre
    first = float(np.log(max(camera.depth(start), 1e-6)))
    depth = np.full(len(ray), first)
    seen = match.paths[0].is_seen(arcs[0])
    for turn in range(ROUNDS):
        information, slope = np.zeros((2, len(depth)))
        points = centre + np.exp(depth)[:, None] * world
        for c in range(1, len(match.paths)):
            path, view = match.paths[c], rig.cameras[c]
            image, by_point, _ = view.project_with_jacobian(points)
            motion = np.einsum("kxy,ky->kx", by_point @ view.rotation, points - centre)  # px for a unit of ln depth
            if turn >= FREE_ROUNDS:
                arcs[c] = path.followed(image, arcs[c], WINDOW_PX)
            tangent = path.tangent_at(arcs[c])
            off, weight = path.at(arcs[c]) - image, (seen & path.is_seen(arcs[c])).astype(float)
            for way, share in ((normal_to(tangent), 1.0), (tangent, ALONG)):
                rate, miss = (motion * way).sum(axis=1), (off * way).sum(axis=1)
                miss = np.clip(miss, -FARTHEST_PX, FARTHEST_PX) if turn else miss
                with np.errstate(invalid="ignore"):
                    sound = np.isfinite(rate) & np.isfinite(miss)
                information += np.where(sound, weight * share * rate**2, 0.0)
                slope += np.where(sound, weight * share * rate * miss, 0.0)
        scale = max(float(np.median(information)), 1e-9)
        held = HELD * scale if known is None else known
        information[0] += held
        slope[0] += held * (first - depth[0])
        depth = np.clip(depth + _smooth_step(information, slope, depth, smooth * scale), first - NEARER, first + NEARER)
    variance = _smooth_step(information, np.eye(1, len(depth))[0], np.zeros(len(depth)), smooth * scale)[0]
    return centre + np.exp(depth)[:, None] * world, arcs, float(np.sqrt(max(variance, 0.0)))


def _smooth_step(information: np.ndarray, slope: np.ndarray, value: np.ndarray, weight: float) -> np.ndarray:
    """The step d that minimises Σ h d² − 2 g d + weight Σ (second difference of value + d)²."""
    count = len(value)
    bands = np.zeros((3, count))
    bands[2] = information + 1e-9 * max(weight, 1e-9)
    right = slope.copy()
    if count > 2:
        bend = weight * np.diff(value, 2)
        for k, factor in enumerate((1.0, -2.0, 1.0)):
            bands[2, k : count - 2 + k] += weight * factor**2
            right[k : count - 2 + k] -= factor * bend
        bands[1, 1:-1] += -2.0 * weight
        bands[1, 2:] += -2.0 * weight
        bands[0, 2:] += weight
    return solveh_banded(bands, right)
