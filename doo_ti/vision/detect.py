"""The thread's centre line in an image (§IV-A), by whatever there is of it: a mask, a colour, or grey levels.

The paper's binary image marks the pixels of the thread. Here the line is found to a fraction of a pixel, as points with
directions; all later steps are as exact as these. First the thread's :mod:`doo_ti.vision.ridge` is measured. The
paper's way is there too: Canny's edges, which vote for the centre line.

In a mask the distance to the border is a roof, whose crest is the centre line. Smoothed by σ, a crest between slopes of ±1 that
end at distance a from it has the second derivative across

    −2 (1 − exp(−a² / 2σ²)) / (σ √(2π)),

whatever the thread's width 2a; branches to corners and bumps of the border have √½ of it or less.

A thread may go on but look different: along a glint, or where it is wider than most of it. A shiny thread has light lines
within it: what is left of a dark thread are its two edges. Closing the darkness of an image fills what is narrower than the
thread, and the thread is one line again. Such a line is taken for the thread where it begins at an end of what was found of it,
in its direction, and no other end is there: where strands cross, or lie side by side, there are more. It ends at another end,
or is free: a needle is wider than its thread. What lies between two lines and is as light as the background is no glint, but
the inside of a narrow loop.
"""

from dataclasses import replace

import cv2
import numpy as np
from scipy.spatial import cKDTree

from doo_ti.rod.frames import curve_length, normal_to
from doo_ti.system.arguments import typed
from doo_ti.system.errors import InputError
from doo_ti.vision import ridge
from doo_ti.vision.detection import (
    WIDEST_GLINT,
    Detection,
    DetectionOptions,
    chains_of,
    cropped,
    goes_on,
    image_part,
    in_whole_pixels,
    moved,
    thinned,
    to_tips,
)

CANNY_STRONG, CANNY_WEAK = 0.4, 0.15  # Canny's thresholds over the slope of the thread's edges
VOTE_BLUR_PX = 1.0  # standard deviation of a vote
MEETING = 0.5  # least share of votes on the centre line, of those of two complete edges with an edge pixel per px of length
STEEPEST = 8000  # slope of the thread's edges in the whole numbers that Canny takes


def _canny_line(image: np.ndarray, look: ridge.Appearance, least_contrast: float, shortest_px: float) -> Detection:
    """The pixels of the centre line in an image (H, W) float32.

    "A Canny edge detector with a blurred, offset Gaussian kernel" (§IV-A): every edge pixel votes for the place half a thread's
    width along the gradient towards the thread's middle; votes are blurred. The centre line lies where votes of both edges
    coincide. Votes have directions: those of opposite edges cancel, and only votes that cancel count.

    look            of the thread: the offset is half its width
    least_contrast  grey levels: fainter edges are ignored
    shortest_px     of a piece of line
    """
    slope = ridge.gradient(image)
    whole = np.clip(np.rint(slope * (STEEPEST / look.slope)), -32767, 32767).astype(np.int16)
    floor = 0.25 * least_contrast / look.slope
    weak, strong = (STEEPEST * max(share, floor) for share in (CANNY_WEAK, CANNY_STRONG))
    edge = cv2.Canny(np.ascontiguousarray(whole[..., 0]), np.ascontiguousarray(whole[..., 1]), weak, strong, L2gradient=True)
    row, column = np.nonzero(edge)
    away = slope[row, column] / np.maximum(np.linalg.norm(slope[row, column], axis=1, keepdims=True), 1e-30)
    away = away if look.polarity == "dark" else -away
    x = np.rint(column - look.width_px / 2 * away[:, 0]).astype(np.int64)
    y = np.rint(row - look.width_px / 2 * away[:, 1]).astype(np.int64)
    inside = (x >= 0) & (x < image.shape[1]) & (y >= 0) & (y < image.shape[0])
    ballots = [np.bincount((y * image.shape[1] + x)[inside], weight, image.size).reshape(image.shape).astype(np.float32)
               for weight in (None, away[inside, 0], away[inside, 1])]
    votes, across, down = (cv2.GaussianBlur(ballot, (0, 0), VOTE_BLUR_PX, borderType=cv2.BORDER_CONSTANT) for ballot in ballots)
    # Votes that coincide with votes from the other edge, 1 for two complete edges.
    meeting = (votes - np.sqrt(across * across + down * down)) * np.float32(VOTE_BLUR_PX * np.sqrt(2 * np.pi) / 2)
    ridges = ridge.Curvature(meeting, VOTE_BLUR_PX).ridges("light", 1e-3)
    ridges = ridges[(meeting[ridges.row, ridges.column] >= MEETING) & (np.abs(ridges.offset) <= ridge.REACH_PX)]
    ridges = ridges[ridge.pieces(ridges, 0.0, shortest_px) > 0]
    pixels = np.stack([ridges.column, ridges.row], axis=1).astype(np.float64)
    return Detection(pixels, ridges.tangent, look.slope * ridges.strength, look.width_px, look.polarity, image.shape, "canny")


SIGMA_PER_WIDTH, SMALLEST_SIGMA = 0.35, 0.8  # px of smoothing: a bar gets a single ridge, and neighbouring strands stay apart
HALF = 0.5  # of the strength near by
WEAK, STRONG = 0.2, 0.5  # shares of the typical strength: all of a piece of thread exceeds the first, some of it the second
WIDTH_RATIO, FAINTEST = 1.5, 0.4
"""Largest ratio of widths, which differ with depth, and least ratio of mean strengths, of a piece and the most distinct one."""


MORE, SAME = 1.1, 0.95
"""Least ratios of what is found without glints over what is found with them, from which on that is taken: in any case, and
where it is in fewer pieces. A line that is bent between glint and rim is as long, but in more pieces."""


@typed
def detect(image: np.ndarray, options: DetectionOptions = DetectionOptions()) -> Detection:
    """The thread's centre line in an image with levels from 0 to 255, (H, W) grey or (H, W, 3) in OpenCV's order.

    Raises InputError for an image of another shape or smaller than 16 × 16, and for a region outside.
    """
    image = np.asarray(image)
    part, corner = image_part(image, options)
    if options.colour is not None:
        table = ridge.likeness_table([ridge.lab(np.array(options.colour[::-1]))], shaded=options.shaded)
        line, polarity = ridge.likeness(ridge.as_colour(part), table), "light"
    else:
        grey = part if part.ndim == 2 else cv2.cvtColor(ridge.as_colour(part), cv2.COLOR_BGR2GRAY)
        line, polarity = grey.astype(np.float32), options.polarity
    look = ridge.appearance(line, polarity, options.width_px, options.least_contrast)
    found = None if look is None else _line(line, look, options)
    if found is None or not found.count:
        return Detection.none(image.shape[:2], options.method)
    if options.colour is not None:
        points, width = ridge.between_edges(ridge.as_colour(part), found.points, found.direction, found.width_px)
        found = replace(found, points=points, width_px=width, method="colour")
    return replace(moved(found, corner), shape=image.shape[:2])


def _line(image: np.ndarray, look: ridge.Appearance, options: DetectionOptions) -> Detection:
    """The centre line of the thread in an image (H, W) float32."""
    left, top, right, bottom = look.box
    image = image[top:bottom, left:right]
    small, scale = _halved(image, look.width_px)
    in_small = replace(look, width_px=look.width_px / scale, slope=look.slope * scale)
    least = options.least_contrast, options.shortest_px / scale
    if options.method == "canny":
        return moved(in_whole_pixels(_canny_line(small, in_small, *least), scale), (left, top))
    found, count = _ridge_line(small, in_small, *least)
    if (look.shiny or count != 1) and WIDEST_GLINT * look.width_px >= 2:  # glints may have parted it
        plain = ridge.dull(image, look.polarity, WIDEST_GLINT * look.width_px)
        whole, parts = _ridge_line(_halved(plain, look.width_px)[0], in_small, *least)
        more = whole.count > (SAME if parts < count else MORE) * found.count
        if look.shiny or more and (not found.count or np.median(
                cKDTree(whole.points).query(found.points)[0]) <= in_small.width_px / 2):
            found, image = whole, plain
    found = in_whole_pixels(_continued(small, found), scale)
    if scale > 1:
        # Where the line has both edges in the image itself, its middle is between these.
        usual = found.widths <= 1.5 * look.width_px + 1
        normal = normal_to(found.direction)
        edges, about = ridge.edges_about(image, found.points, normal, look.polarity, look.width_px)
        sound = usual & about & (edges.balance > ridge.LEAST_BALANCE)
        found = replace(found, points=found.points + np.where(sound, edges.shift, 0.0)[:, None] * normal)
    return moved(to_tips(found, image, look.slope), (left, top))


def _halved(image: np.ndarray, width: float) -> tuple[np.ndarray, float]:
    """The image, halved until a line of that width is at most WORKING_WIDTH px wide, and px of the image to one of it."""
    halvings = max(0, int(np.ceil(np.log2(width / ridge.WORKING_WIDTH))))
    for _ in range(halvings):
        image = cv2.pyrDown(image)
    return image, 2.0**halvings


def _ridge_line(image: np.ndarray, look: ridge.Appearance, least_contrast: float, shortest_px: float) -> tuple[Detection, int]:
    """As :func:`_canny_line`: ridges at the thread's width, each moved to the middle between the two edges; and the number of
    pieces that they are in."""
    curvature = ridge.Curvature(image, max(SMALLEST_SIGMA, SIGMA_PER_WIDTH * look.width_px))
    certain = max(ridge.SURE * curvature.noise(), ridge.BAR * least_contrast)
    ridges = curvature.ridges(look.polarity, certain / 2)
    typical = (ridges.strength**3).sum() / max((ridges.strength**2).sum(), 1e-30)
    ridges = ridges[ridges.strength >= WEAK * typical]
    edges, about = ridge.edges_about(image, ridges.point, ridges.normal, look.polarity, look.width_px)
    sound = about & ridge.of_a_thread(edges, ridges.strength) & (np.abs(ridges.offset + edges.shift) <= ridge.REACH_PX)
    ridges, width = ridges.moved(edges.shift)[sound], edges.width[sound]
    within = _within_ends(ridges, image.shape, curvature.sigma)
    ridges, width = ridges[within], width[within]
    piece = ridge.pieces(ridges, max(certain, STRONG * typical), max(shortest_px, look.width_px))
    kept = np.flatnonzero(piece)
    kept = kept[_alike(piece[kept], width[kept], ridges.strength[kept])]
    ridges = ridges[kept]
    return (Detection(ridges.point, ridges.tangent, ridges.strength, look.width_px, look.polarity, image.shape, "ridge",
                      width[kept]), len(np.unique(piece[kept])))


def _within_ends(ridges: ridge.Ridges, shape: tuple[int, int], sigma: float) -> np.ndarray:
    """(N,) bool: points that are not beyond an end of their line, where it has HALF of its strength after smoothing by σ px.
    Weak points between others, as where the background is brighter, are of a line that goes on."""
    at, strength, weak = (ridges.row + 1, ridges.column + 1), *np.zeros((2, shape[0] + 2, shape[1] + 2), dtype=np.float32)
    strength[at] = ridges.strength
    along = ridges.point + sigma * np.array([-2, -1, 1, 2])[:, None, None] * ridges.tangent + 1
    column, row = np.clip(np.rint(along), 0, np.array(strength.shape[::-1]) - 1).astype(int).transpose(2, 0, 1)
    weak[at] = ridges.strength < HALF * cv2.dilate(strength, np.ones((3, 3), dtype=np.uint8))[row, column].max(axis=0)
    part, line = (cv2.connectedComponents(kind.astype(np.uint8))[1] for kind in (weak, (strength > 0) & (weak == 0)))
    around = [line[at[0] + down, at[1] + right] for down in (-1, 0, 1) for right in (-1, 0, 1)]
    touching = np.stack([np.tile(part[at], 9), np.concatenate(around)])
    lines = np.bincount(np.unique(touching[:, touching.all(axis=0)], axis=1)[0], minlength=part.max() + 1)
    return (part[at] == 0) | (lines[part[at]] != 1)


def _alike(piece: np.ndarray, width: np.ndarray, strength: np.ndarray) -> np.ndarray:
    """(N,) bool: points of pieces about as wide as the most distinct one, and not much fainter."""
    if not len(piece):
        return np.zeros(0, dtype=bool)
    _, piece, count = np.unique(piece, return_inverse=True, return_counts=True)
    median = width[np.lexsort((width, piece))][np.cumsum(count) - count + count // 2]
    mean = np.bincount(piece, strength) / count
    first = np.argmax(count * mean**2)
    ratio = median / median[first]
    return ((ratio < WIDTH_RATIO) & (ratio > 1 / WIDTH_RATIO) & (mean > FAINTEST * mean[first]))[piece]


# --- where the thread goes on ------------------------------------------------------------------------------------------------

TIMES = (2.0, 4.0)  # widths of lines that are tried, over that of the thread
LEAST_STRENGTH = 0.4  # least strength over that of a line as dark as the thread
PART = 1.0  # least widths of a line that goes on: strands that touch are shorter


def _continued(image: np.ndarray, usual: Detection) -> Detection:
    """The thread in an image (H, W) float32: what was found at its ``usual`` width, and what goes on from the ends of that."""
    found, own = usual, chains_of(*thinned(usual))
    if not own:
        return found
    dark = _darkness(image, usual)
    for turn, times in enumerate(2 * TIMES):  # a part that is wider may become narrower again
        if turn == len(TIMES) and found is usual:
            break
        width = times * usual.width_px
        line = _wide_lines(dark, width, np.concatenate([found.points, *own]), usual.width_px)
        added = _joined(line, own, width, dark)
        if added:
            found = found.take(~_edges_of(found.points, own, added, width)).with_parts(added)
            own = chains_of(*thinned(found))
    return found


def _darkness(image: np.ndarray, thread: Detection) -> np.ndarray:
    """(H, W) float32: how much each pixel differs from the background around it towards the thread, 255 for its contrast."""
    side = 2 * int(np.ceil(1.25 * max(TIMES) * thread.width_px)) + 1
    kernel = cv2.getStructuringElement(cv2.MORPH_RECT, (side, side))
    kind = cv2.MORPH_BLACKHAT if thread.polarity == "dark" else cv2.MORPH_TOPHAT
    contrast = float(np.median(thread.strength)) / ridge.BAR
    return np.minimum(cv2.morphologyEx(image, kind, kernel) * np.float32(255 / contrast), np.float32(255))


def _wide_lines(dark: np.ndarray, width: float, own: np.ndarray, usual: float) -> Detection:
    """Lines about as wide as ``width`` in the closed darkness, away from points ``own`` (N, 2) of a line ``usual`` px wide."""
    small, scale = _halved(dark, width)
    wide = width / scale
    side = 2 * int(np.ceil(wide / 2)) + 1
    closed = cv2.morphologyEx(small, cv2.MORPH_CLOSE, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side)))
    ridges = ridge.Curvature(closed, SIGMA_PER_WIDTH * wide).ridges("light", LEAST_STRENGTH * ridge.BAR * 255)
    edges, about = ridge.edges_about(closed, ridges.point, ridges.normal, "light", wide)
    sound = about & (np.abs(ridges.offset + edges.shift) <= ridge.REACH_PX) & (edges.balance > 0)
    ridges = ridges.moved(edges.shift)[sound]
    found = in_whole_pixels(Detection(ridges.point, ridges.tangent, ridges.strength, wide, "light", dark.shape, "ridge",
                                      edges.width[sound]), scale)
    return found.take(cKDTree(own).query(found.points)[0] > 0.5 * usual + 1)


def _joined(line: Detection, own: list[np.ndarray], width: float, dark: np.ndarray) -> list[Detection]:
    """The parts of a ``line`` that go on from ends of the chains ``own``, or of these parts."""
    waiting, parts = [chain for chain in chains_of(*thinned(line)) if curve_length(chain) >= PART * width], []
    tree, known = cKDTree(line.points) if line.count else None, list(own)
    while True:
        ready = next((k for k, chain in enumerate(waiting) if goes_on(chain, known, width, dark)), None)
        if ready is None:
            return parts
        chain = waiting.pop(ready)
        part = line.take(tree.query(chain)[1])
        parts.append(replace(part, width=np.full(part.count, np.median(part.width))))
        known.append(chain)


def _edges_of(points: np.ndarray, own: list[np.ndarray], parts: list[Detection], width: float) -> np.ndarray:
    """(N,) bool: points of chains that lie beside the ``parts`` as their edges do, from end to end."""
    line = cKDTree(np.concatenate([part.points for part in parts]))
    edges = [chain for chain in own if line.query(chain)[0].max() <= width]
    if not edges:
        return np.zeros(len(points), dtype=bool)
    return cKDTree(np.concatenate(edges)).query(points)[0] <= 1.0


# --- masks --------------------------------------------------------------------------------------------------------

SIGMA = 1.0
CREST = 0.8  # least second derivative over that of a full roof
LABELS = 16
LARGEST_HOLE = 20  # px of a hole or speck that is regarded as noise


@typed
def detect_mask(mask: np.ndarray, options: DetectionOptions = DetectionOptions()) -> Detection:
    """The centre line of a mask (H, W) of any numbers. With at most LABELS different ones the thread is where they are not 0;
    with more, in a smoothed mask, where they exceed half of the largest. Of ``options`` its ``shortest_px`` and ``region``
    are used.

    Raises InputError for anything else, and for masks smaller than 16 × 16.
    """
    mask = np.asarray(mask)
    if mask.ndim != 2 or min(mask.shape) < 16 or mask.dtype.kind not in "buif":
        raise InputError("detection", "mask", f"shape {mask.shape} of {mask.dtype}", "give (H, W) numbers, at least 16 x 16")
    part, corner = cropped(mask, options)
    least = 0 if len(np.unique(mask)) <= LABELS else mask.max() / 2
    inside, roof, scale = _roof(_cleaned(part > least))
    ridges = ridge.Curvature(roof, SIGMA).ridges("light", 0.1)
    half = roof[ridges.row, ridges.column].astype(np.float64)
    full = 2 * SIGMA / np.sqrt(2 * np.pi) * (1 - np.exp(-0.5 * (half / SIGMA) ** 2))
    kept = (ridges.strength >= CREST * full) & (np.abs(ridges.offset) <= ridge.REACH_PX) & (half > 0)
    ridges, half = ridges[kept], half[kept]
    kept = ridge.pieces(ridges, 0.0, options.shortest_px / scale) > 0
    ridges, half = ridges[kept], half[kept]
    # Distances are from pixel to pixel: half a pixel lies beyond the border.
    width = 2 * (half + np.abs(ridges.offset)) - 1
    if not len(width):
        return replace(Detection.none(mask.shape, "mask"), width=width)
    found = Detection(ridges.point, ridges.tangent, np.full(len(width), 255.0), float(np.median(width)), "light", mask.shape,
                      "mask", width)
    found = to_tips(found, inside, 255 / np.sqrt(2 * np.pi), 0.5 - 0.5 / scale)
    return moved(in_whole_pixels(found, scale), corner)


def _cleaned(inside: np.ndarray) -> np.ndarray:
    """(H, W) uint8: 1 within, without small holes and specks."""
    for within in (0, 1):
        of_kind = (inside == within).astype(np.uint8)
        label, sizes = cv2.connectedComponentsWithStats(of_kind, connectivity=4 + 4 * within)[1:3]
        small = sizes[:, cv2.CC_STAT_AREA] <= LARGEST_HOLE
        small[0] = False
        inside = inside ^ small[label]
    return inside.astype(np.uint8)


def _roof(inside: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """(h, w) float32 twice: the mask, 255 within, and px from the nearest pixel outside; both halved where the thread is wide;
    and px of the mask to one of it."""
    level, scale = 255 * inside.astype(np.float32), 1.0
    while True:
        # The thread goes on beyond the image's border; distances to nothing would have no end.
        roof = cv2.distanceTransform(np.pad(inside, 2, mode="edge"), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[2:-2, 2:-2]
        # Squares of distances are whole numbers; their rounding differs with the number of OpenCV's threads.
        roof = np.sqrt(np.rint(np.square(roof, dtype=np.float64))).astype(np.float32)
        roof = np.minimum(roof, max(inside.shape))
        if not inside.any() or 4 * np.median(roof[inside > 0]) <= ridge.WORKING_WIDTH or min(inside.shape) < 32:
            return level, np.ascontiguousarray(roof), scale
        inside, level, scale = (cv2.pyrDown(255 * inside) > 127).astype(np.uint8), cv2.pyrDown(level), 2 * scale
