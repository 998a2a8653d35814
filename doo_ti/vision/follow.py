"""The thread under a pixel: its points in order, from end to end.

1. **Start.** Around the pixel, the line of largest contrast in Lab is sought over places, directions and widths.
2. **Colours.** Across the thread, where a colour is far from that of the background on either side, lit or in any shadow, over
   the scatter along the thread, there is thread. That gives its middle, width and colours; a striped thread has several. A
   thread whose own colour is that of a shadow is told from the lit background only.
3. **Walk.** In the likeness to these colours, rather than to the background's, the thread is a light line of known width. Of
   circular arcs that go on from the last point, the one along which the line is strongest is followed for half a width;
   strength is the second derivative across, 1 for a clean line. Where it is missing, for instance where something crosses, the
   arc goes on to where the line is there again within six widths. Else the thread ends. Colours are looked at again every
   three widths, and before it ends: stripes wind round a cable, light and background change.
4. **Middle.** The points are moved midway between the thread's edges.

Other threads that cross are not followed: an arc that is straighter through the crossing has more of the line.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.ndimage import binary_closing

from doo_ti.rod.frames import arc_lengths, normal_to, placed, unit_vectors
from doo_ti.system.arguments import typed
from doo_ti.system.errors import InputError
from doo_ti.vision.detection import WIDEST_GLINT, Detection, DetectionOptions, image_part, moved
from doo_ti.vision.ridge import ROWS, TOLERANCE, WORKING_WIDTH, Curvature, as_colour, lab

REACH_PX = 4.0  # from the pixel to the thread's middle, or half a width, whichever is more
FINEST, OCTAVES = 2.0, 6  # widths tried, px: two to an octave, up to 180
DIRECTIONS, SEGMENT = 24, 1.5  # of lines at the start, and half their length in widths
FINENESS = 1.75  # power of σ in the strength of the start's line: 2 treats all widths alike, but threads have shadows
AHEAD, SHARPEST, ARCS = 6.0, 0.35, 21  # length of arcs in widths, their largest curvature times the width, and their number
PRESENT = 0.35  # least strength of the line over its median along the path so far
FULL = 0.41 * 255  # second derivative times σ², σ = 0.35 widths, on the middle of a clean line
AGAIN = 2.0  # widths along which the line must be there behind a gap
STRAIGHT = 0.15  # strength that an arc of the largest curvature must have more than a straight one
SHORTEST = 4.0  # widths of a thread
WITHIN = 0.5  # share of the largest ratio of difference and scatter up to which a place is within the thread
SURELY_WITHIN = 2.5  # ratio from which on a place is within the thread in any case: its stripes may differ
LEVEL, LEAST_TOLERANCE = 3.0, 5.0  # Lab: scatter without noise, and of colours of the thread
LIT = np.float32([16, 0, 0])  # less light multiplies (L + 16, a, b), the cube roots of intensities, by a number
DEEPEST, DEEPER = 0.7, 1.25  # of a shadow, with a third of the light; a and b may be more of the background's than L
TINGE = 6.0  # Lab by which colours of shadows may differ from that
STRETCH = 3.0  # widths of thread after which its colours are looked at again
SAME = 0.5  # share by which the width at the start and farther along may differ
REACH = 2.5  # widths to either side that are looked at
SMOOTHING_PX = 0.7


@dataclass(frozen=True)
class Line:
    """A place on a thread: (2,) px, the angle of its direction and its width."""

    point: np.ndarray
    angle: float
    width: float


@dataclass(frozen=True)
class Look:
    """How a thread differs from what is beside it."""

    colours: np.ndarray  # (n, 3) Lab, across it
    ground: np.ndarray  # (2, 3) Lab, beside it
    deepest: float  # DEEPEST, or 1 where what differs from the background as shadows do is the thread
    contrast: float  # Lab
    polarity: str  # "dark" or "light"
    sound: bool  # both its edges are where they are for its width, and it is no shadow


@typed
def follow(image: np.ndarray, pixel: tuple[float, float], options: DetectionOptions = DetectionOptions()) -> Detection:
    """The thread of which ``pixel`` (u, v) shows a part, in an image (H, W) grey or (H, W, 3) in OpenCV's order; others that it
    crosses are left out. Points are in order, a pixel apart, from one end to the other or to the border of the image or of
    ``options.region``, which alone of the options counts: colour and width are those at the pixel. ``strength`` is 0 where a
    gap was bridged. Without a thread there the detection has no points.

    Raises InputError for another image, and for a pixel outside.
    """
    image = np.asarray(image)
    part, corner = image_part(image, options)
    place = np.asarray(pixel, dtype=np.float64) - corner
    if not ((place >= -0.5) & (place < np.array(part.shape[1::-1]) - 0.5)).all():
        raise InputError("detection", "pixel", f"{tuple(pixel)} is outside",
                         f"give one of the {part.shape[1]} x {part.shape[0]} px of the image or region")
    levels = [as_colour(part)]
    lines = sorted(_lines(levels, place), key=lambda entry: -entry[0])
    found = next((one for sound, deepest in ((True, DEEPEST), (True, 1.0), (False, 1.0)) for _, line in lines
                  if (one := _followed(levels, line, sound, deepest)) is not None), None)
    if found is None:
        return Detection.none(image.shape[:2], "follow")
    along = unit_vectors(np.gradient(found[0], axis=0))
    return moved(Detection(found[0], along, *found[1:], image.shape[:2], "follow"), corner)


# --- the line at the pixel -------------------------------------------------------------------------------------------------

def _lines(levels: list[np.ndarray], place: np.ndarray) -> list[tuple[float, Line]]:
    """(contrast, line) of the best line of each width near ``place``; appends halved images to ``levels``."""
    found = []
    for level in range(OCTAVES):
        if level:
            if min(levels[-1].shape[:2]) < 32:
                break
            levels.append(cv2.pyrDown(levels[-1]))
        scale = 2.0**level
        for width in (2 * FINEST, 2 * FINEST * np.sqrt(2)) if level else FINEST * np.sqrt(2) ** np.arange(4):
            contrast, line = _line(levels[level], place / scale, float(width), REACH_PX / scale)
            found.append((contrast, Line(line.point * scale, line.angle, line.width * scale)))
    return found


def _line(image: np.ndarray, place: np.ndarray, width: float, reach: float) -> tuple[float, Line]:
    """The contrast in Lab and the line of this width that is most distinct within ``reach`` or half a width of ``place``."""
    reach, sigma = max(reach, width / 2), width / 2
    pixels, corner = window(image, place, int(np.ceil(reach + (SEGMENT + 2) * width)) + 2)
    colours = lab(pixels)
    parts = [Curvature(np.ascontiguousarray(colours[..., channel]), sigma) for channel in range(3)]
    grid = np.arange(-np.ceil(reach), np.ceil(reach) + 1)
    offset = np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2)
    offset = offset[np.linalg.norm(offset, axis=1) <= reach]
    angle = np.arange(DIRECTIONS) * np.pi / DIRECTIONS
    along = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    step = np.arange(-np.floor(SEGMENT * width), SEGMENT * width + 0.01)
    at = (place - corner + offset[:, None]) + (along[:, None] * step[:, None])[:, None]
    at = at.reshape(-1, len(step), 2).astype(np.float32)
    across = normal_to(along)
    weight = np.stack([across[:, 0] ** 2, 2 * across[:, 0] * across[:, 1], across[:, 1] ** 2], axis=-1)
    square = 0.0
    for part in parts:
        bends = cv2.remap(cv2.merge([part.xx, part.xy, part.yy]), at[..., 0], at[..., 1], cv2.INTER_LINEAR,
                          borderMode=cv2.BORDER_REPLICATE).mean(axis=1).reshape(DIRECTIONS, -1, 3)
        square = square + np.einsum("apk,ak->ap", bends, weight) ** 2
    contrast = np.sqrt(square) * sigma**FINENESS * (1 - 0.5 * (np.linalg.norm(offset, axis=1) / (reach + 1)) ** 2)
    best, at_place = np.unravel_index(np.argmax(contrast), contrast.shape)
    return float(contrast[best, at_place]), Line(place + offset[at_place], float(angle[best]), width)


# --- the thread along it ---------------------------------------------------------------------------------------------------

def _followed(levels: list[np.ndarray], line: Line, sound: bool, deepest: float
              ) -> tuple[np.ndarray, np.ndarray, float, str] | None:
    """(N, 2) points, (N,) strengths, width and polarity of the thread that has this line; None where there is none, or none
    that is ``sound`` where it must be."""
    level = int(np.clip(np.ceil(np.log2(line.width / WORKING_WIDTH)), 0, len(levels) - 1))
    image, scale, line = levels[level], 2.0**level, Line(line.point / 2.0**level, line.angle, line.width / 2.0**level)
    step = np.arange(-np.ceil(SEGMENT * line.width), np.ceil(SEGMENT * line.width) + 1)
    path = line.point + step[:, None] * [np.cos(line.angle), np.sin(line.angle)]
    line, look = looked(image, path, len(step) // 2, line, deepest)
    found = None if sound and not look.sound else _both_ways(image, line, look, 8 * line.width)
    found = found and (_both_ways(image, replace(line, width=found[2]), look, np.inf) or _both_ways(image, line, look, np.inf))
    if found is None:
        return None
    path, strength, width = found
    points, width = _centred(image, path, strength > 0, width, deepest)
    points, place = scale * points, scale * arc_lengths(points)
    at = np.arange(0, place[-1], 1.0)  # a pixel apart
    strength = strength[np.clip(np.searchsorted(place, at), 0, len(place) - 1)]
    return placed(at, place, points), strength, width * scale, look.polarity


def _both_ways(image: np.ndarray, line: Line, look: Look, length: float) -> tuple[np.ndarray, np.ndarray, float] | None:
    """(N, 2) points and (N,) strengths of the thread as far as ``length`` px either way, and its width; None where it is no
    longer than four widths."""
    fields = [_Field(image, look, line.width) for _ in range(2)]
    (back, behind), (ahead, before) = (_walked(field, replace(line, angle=line.angle + turn), length)
                                       for field, turn in zip(fields, (np.pi, 0.0), strict=True))
    path, strength = np.concatenate([back[::-1], line.point[None], ahead]), np.concatenate([behind[::-1], [FULL], before])
    width = float(np.median([line.width, *fields[0].widths, *fields[1].widths]))
    return None if len(path) < SHORTEST * line.width else (path, strength, width)


# --- from point to point -----------------------------------------------------------------------------------------------------

class _Field:
    """Second and first derivatives of an image's likeness to the thread, in a window that moves along with those who ask."""

    def __init__(self, image: np.ndarray, look: Look, width: float):
        self.image, self.look, self.width, self.sigma = image, look, width, max(0.8, 0.35 * width)
        self.reach = int((AHEAD + STRETCH) * width) + int(np.ceil(4 * self.sigma))
        self.widths, self.centre = [], np.full(2, np.inf)  # of the thread where it was looked at again; of the window
        side = 2 * int(WIDEST_GLINT * width / 2) + 1
        self.fill = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))

    def cover(self, point: np.ndarray, behind: np.ndarray, anew: bool) -> None:
        """Move the window to a ``point`` (2,) if that is far from its middle, or if ``anew``. The thread's colours there are
        those at the start and those along the path ``behind`` (N, 2)."""
        if not anew and np.linalg.norm(point - self.centre) <= STRETCH * self.width:
            return
        looks = [self.look]
        if len(behind) >= AGAIN * self.width:
            line, look = looked(self.image, behind, len(behind) // 2, Line(point, 0.0, self.width), self.look.deepest)
            if look.sound and abs(line.width - self.width) <= SAME * self.width:
                looks.append(look)
                self.widths.append(line.width)
        pixels, self.corner = window(self.image, point, self.reach)
        like = _likeness(lab(pixels.astype(np.float32)), looks)
        part, self.centre = Curvature(cv2.morphologyEx(like, cv2.MORPH_CLOSE, self.fill), self.sigma), point
        self.maps = cv2.merge([part.xx, part.xy, part.yy]), cv2.merge([part.x, part.y])

    def sampled(self, points: np.ndarray, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(a, n) strength across a line at (a, n, 2) points with unit tangents ``along``, and px to the crest of the line."""
        at = (points - self.corner).astype(np.float32)
        bends, slopes = (cv2.remap(part, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
                         for part in self.maps)
        x, y = -along[..., 1], along[..., 0]
        bend = -(bends[..., 0] * x * x + 2 * bends[..., 1] * x * y + bends[..., 2] * y * y)
        slope = slopes[..., 0] * x + slopes[..., 1] * y
        return bend * self.sigma**2 / FULL, slope / np.maximum(bend, 0.1 * FULL / self.sigma**2)


def _walked(field: _Field, line: Line, longest: float) -> tuple[np.ndarray, np.ndarray]:
    """(N, 2) points a pixel apart beyond a line's point, and (N,) grey levels: their strengths, 0 in gaps."""
    width, (height, breadth) = line.width, field.image.shape[:2]
    step = np.arange(1.0, np.ceil(AHEAD * width) + 1)
    bend = np.where(np.arange(ARCS) == ARCS // 2, 1e-9, np.linspace(-SHARPEST, SHARPEST, ARCS))[:, None] / width
    arcs, turn = np.stack([np.sin(bend * step), 1 - np.cos(bend * step)], axis=-1) / bend[..., None], bend * step
    cost = STRAIGHT * np.abs(bend[:, 0]) * width / SHARPEST
    point, angle, points, strengths = line.point, line.angle, [], [np.ones(1)]
    stride, again, count, fresh = max(1, int(width / 2)), int(np.ceil(AGAIN * width)), 0, False
    while count < min(longest, height * breadth / width):
        at, heading = point + arcs @ [[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]], angle + turn
        behind = np.concatenate([line.point[None], *points[-int(3 * SHORTEST) :]])
        field.cover(point, behind[-int((AGAIN if fresh else SHORTEST) * width) - 1 :], fresh)
        strength = field.sampled(at, np.stack([np.cos(heading), np.sin(heading)], axis=-1))[0]
        best = np.argmax(np.clip(strength, -0.3, 1.2).mean(axis=1) - cost)
        strength, at, heading = strength[best], at[best], heading[best]
        there = strength >= PRESENT * np.median(np.concatenate(strengths[-50:]))
        taken, ended = stride, False
        if there[: max(stride, int(width))].mean() < 0.5:
            share = np.convolve(there, np.ones(again), "valid")
            later = np.flatnonzero((share >= 0.85 * again) & there[: len(share)])
            taken, ended = (later[0] + 1, False) if len(later) else (int(np.argmin(there)), True)
            if ended and not fresh:
                fresh = True
                continue
        fresh = False
        inside = ((at[:taken] > -0.5) & (at[:taken] < [breadth - 0.5, height - 0.5])).all(axis=1)
        kept = taken if inside.all() else int(np.argmin(inside))
        points.append(at[:kept])
        strengths.append(np.where(there, np.clip(strength, 0, 1), 0)[:kept])
        count += kept
        if ended or kept < taken or count > 4 * width and np.linalg.norm(at[taken - 1] - line.point) < width / 2:
            break
        point, angle = at[taken - 1], heading[taken - 1]
        shift = float(np.clip(field.sampled(point[None, None], np.array([[[np.cos(angle), np.sin(angle)]]]))[1][0, 0],
                              -width / 4, width / 4))
        point, angle = point + shift * np.array([-np.sin(angle), np.cos(angle)]), angle + 0.5 * shift / max(taken, width)
    found, strength = np.concatenate([np.empty((0, 2)), *points]), np.concatenate(strengths)[1:]
    last = np.flatnonzero(strength > 0).max(initial=-1) + 1
    return found[:last], FULL * strength[:last]


# --- across the thread -------------------------------------------------------------------------------------------------------

def looked(image: np.ndarray, path: np.ndarray, middle: int, line: Line, deepest: float) -> tuple[Line, Look]:
    """The line at point number ``middle`` of a ``path`` (N, 2), moved to the thread's middle and with its width, and the
    thread's look along the path. Place and width are unchanged where the thread has no two edges."""
    seen, along, offset = _across(image, path, line.width)
    usual = np.median(seen, axis=0)
    scatter = np.median(np.linalg.norm(seen - usual, axis=-1), axis=0)
    difference = np.min([np.median(_unlike(seen, seen[:, [end]], deepest), axis=0) for end in (0, -1)], axis=0)
    ratio = difference / (scatter + LEVEL)
    top = int(np.argmax(np.where(np.abs(offset) <= max(line.width / 2, 0.5), ratio, -1.0)))
    first, last = _edges(ratio, difference, top, 2 * int(WIDEST_GLINT * line.width) + 1)
    width = offset[last] - offset[first] + 0.5
    sound = difference[top] > TINGE and 0 < first and last < len(offset) - 1 and line.width / 2 <= width <= 2 * line.width
    shift, inner = (offset[first] + offset[last]) / 2, np.linspace(offset[first] + 0.2 * width, offset[last] - 0.2 * width, 5)
    if not sound:
        shift, inner, width = 0.0, offset[[top]], line.width
    colours, ahead = usual[np.argmin(np.abs(offset[:, None] - inner), axis=0)], along[middle]
    polarity = "light" if np.median(colours[:, 0]) > (usual[0, 0] + usual[-1, 0]) / 2 else "dark"
    line = Line(path[middle] + shift * normal_to(ahead), float(np.arctan2(ahead[1], ahead[0])), max(float(width), 2.0))
    return line, Look(colours, usual[[0, -1]], deepest, float(difference[top]), polarity, sound)


def window(image: np.ndarray, place: np.ndarray, reach: int) -> tuple[np.ndarray, np.ndarray]:
    """The pixels within ``reach`` of a place, blurred, and the corner (2,) at which they begin."""
    x, y = (int(value) for value in np.clip(np.rint(place), 0, np.array(image.shape[1::-1]) - 1))
    left, top = max(x - reach, 0), max(y - reach, 0)
    return cv2.GaussianBlur(image[top : y + reach + 1, left : x + reach + 1], (0, 0), SMOOTHING_PX), np.array([left, top])


def _across(image: np.ndarray, path: np.ndarray, width: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(N, n, 3) colours in Lab across a path (N, 2), its (N, 2) directions, and the (n,) offsets in px."""
    step, smoothing = np.gradient(path, axis=0)[:, None], (1, 2 * int(max(1, width)) + 1)
    along = unit_vectors(cv2.blur(step, smoothing, borderType=cv2.BORDER_REPLICATE)[:, 0])
    offset = np.arange(-REACH * width, REACH * width + 0.01, 0.5)
    place, reach = path.mean(axis=0), int(np.abs(path - path.mean(axis=0)).max() + REACH * width) + 4
    pixels, corner = window(image, place, reach)
    at = ((path - corner)[:, None] + offset[:, None] * normal_to(along)[:, None]).astype(np.float32)
    seen = [lab(cv2.remap(pixels, rows[..., 0], rows[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))
            for rows in np.split(at, np.arange(ROWS, len(at), ROWS))]
    return np.concatenate(seen), along, offset


def _edges(ratio: np.ndarray, difference: np.ndarray, top: int, glint: int) -> tuple[int, int]:
    """The first and the last place within the thread around ``top``; of a glint in it there are fewer than ``glint``."""
    within = ratio > min(WITHIN * ratio[top], SURELY_WITHIN)
    outside = np.flatnonzero(~(within | binary_closing(within, np.ones(glint))))
    first, last = outside[outside < top].max(initial=-1) + 1, outside[outside > top].min(initial=len(ratio)) - 1
    # The edges, blurred, are where half of the outermost stripe's difference is reached.
    third = max(1, (last - first) // 3)
    outer, inner = difference[first : first + third], difference[last - third + 1 : last + 1]
    return first + int(np.argmax(outer >= outer.max() / 2)), last - int(np.argmax(inner[::-1] >= inner.max() / 2))


def _unlike(seen: np.ndarray, ground: np.ndarray, deepest: float) -> np.ndarray:
    """(...) distances in Lab of colours ``seen`` (..., 3) from those of the ``ground`` (..., 3), lit or in a shadow."""
    (lightness, a, b), (high, own_a, own_b) = (np.moveaxis(colours, -1, 0) for colours in (seen + LIT, ground + LIT))
    factor = (a * own_a + b * own_b) / np.maximum(own_a**2 + own_b**2, 1e-9)
    factor, high = np.clip(factor, deepest, DEEPER if deepest < 1 else 1.0), np.clip(lightness, deepest * high, high)
    return np.sqrt((lightness - high) ** 2 + (a - factor * own_a) ** 2 + (b - factor * own_b) ** 2)


def _likeness(seen: np.ndarray, looks: list[Look]) -> np.ndarray:
    """(H, W) likeness, 0 to 255, of colours ``seen`` (H, W, 3) in Lab to the thread as it looked; half of it where the
    background of the last look is as near, and less where that is nearer."""
    colours, flat = np.float32(np.concatenate([look.colours for look in looks])), np.ascontiguousarray(seen.reshape(-1, 3).T)
    tolerance = np.float32(np.clip(looks[0].contrast / 2, LEAST_TOLERANCE, TOLERANCE))
    own = ((colours**2).sum(axis=1)[:, None] - 2 * colours @ flat).min(axis=0) + (flat * flat).sum(axis=0)
    own = np.maximum(own, 0).reshape(seen.shape[:2]) / tolerance**2
    ground = np.minimum(*(_unlike(seen, np.float32(ground), looks[-1].deepest) for ground in looks[-1].ground)) / tolerance
    return 255 * np.exp(-own) / (1 + np.exp(np.clip(own - ground**2, -50, 50)))


def _centred(image: np.ndarray, path: np.ndarray, there: np.ndarray, width: float, deepest: float
             ) -> tuple[np.ndarray, float]:
    """The (N, 2) points of a path moved midway between the edges of the thread, about ``width`` px wide, and its width. Where
    it is not ``there`` (N,), or has no two edges, the shift is interpolated."""
    seen, along, offset = _across(image, path, width)
    unlike = np.minimum(*(_unlike(seen, seen[:, [end]], deepest) for end in (0, -1)))
    unlike = cv2.blur(unlike, (1, int(width) // 2 * 2 + 1), borderType=cv2.BORDER_REPLICATE)
    edges, rows = [], np.arange(len(path))
    for side in (-1, 1):  # from a quarter of the width outwards
        outward = np.flatnonzero((side * offset >= width / 4) & (side * offset <= 0.75 * width + 1))[::side]
        level = unlike[:, outward]
        half = level[:, np.abs(offset[outward]) <= width / 2].max(axis=1) / 2
        at = np.minimum(len(outward) - 1 - np.argmax(level[:, ::-1] >= half[:, None], axis=1), len(outward) - 2)
        inner, outer = level[rows, at], level[rows, at + 1]
        edge = offset[outward[at]] + side * 0.5 * (inner - half) / np.maximum(inner - outer, 1e-9)
        edges.append(np.where((outer < half) & (half > TINGE / 2), edge, np.nan))
    shift, found = np.mean(edges, axis=0), edges[1] - edges[0]
    sure = np.convolve(~there, np.ones(2 * int(width) + 1), "same")[: len(path)] == 0  # a gap's cause pulls the line aside
    sure &= (found > 0.6 * width) & (found < 1.5 * width)
    if sure.any():  # what smooths the image makes thin lines wider
        path = path + np.interp(rows, rows[sure], shift[sure])[:, None] * normal_to(along)
        width = float(np.sqrt(max(np.median(found[sure]) ** 2 - 8 * np.log(2) * SMOOTHING_PX**2, 1.0)))
    return path, width
