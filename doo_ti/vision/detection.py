"""What a detection takes, what is known of the thread before an image is looked at, and gives: the centre line, points with
directions and widths, and chains of those that follow each other along their directions."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import accumulate
from typing import Annotated

import cv2
import numpy as np
from scipy.spatial import cKDTree

from doo_ti.rod.frames import arc_lengths, curve_length, normal_to, unit_vectors
from doo_ti.system.arguments import short_repr, typed
from doo_ti.system.errors import InputError
from doo_ti.vision.ridge import POINTS_PER_PX, STEP_PX, gradient, peak

METHODS = ("ridge", "canny")
POLARITIES = ("dark", "light")
WIDEST_GLINT = 0.5  # widths of a thread that something unlike it within, as a glint, takes at most: such is filled
NEAR_PX = 3.0  # a point this near to another line, or to the image of a rod, is on it
CLICK_PX = 30.0  # a clicked pixel is this near to the thread
MOST_WIDTH_PX = 1000.0  # largest width of a thread: samples are taken across it


@typed
@dataclass(frozen=True)
class DetectionOptions:
    """Options of the detection.

    method          "ridge": to a fraction of a pixel; "canny": the paper's edges and offset Gaussian, to a pixel
    polarity        "dark" or "light" against the background; None: the more distinct of the two
    width_px        of the thread between its edges; None: measured
    least_contrast  grey levels between thread and background; lines that differ less are ignored
    shortest_px     shorter visible pieces are regarded as specks
    colour          red, green and blue of the thread, 0 to 255: it is then a light line in the likeness to this colour
    shaded          whether shading is left out of the colour, so far as the colour is saturated: all of a thread lit from one
                    side is found, but also other things of its hue
    region          left, top, width and height in px of the part of the image where the thread is; None: all of it

    Raises InputError for another method or polarity, numbers that are not positive, and other colours and regions.
    """

    method: str = "ridge"
    polarity: str | None = None
    width_px: float | None = None
    least_contrast: float = 10.0
    shortest_px: float = 10.0
    colour: Sequence[float] | None = None
    region: Sequence[int] | None = None
    shaded: bool = False

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise InputError("detection", "method", f"{self.method!r} is unknown", f"give {' or '.join(METHODS)}")
        if self.polarity not in (None, *POLARITIES):
            raise InputError("detection", "polarity", f"{self.polarity!r} is unknown", f"give {' or '.join(POLARITIES)}")
        for name in ("width_px", "least_contrast", "shortest_px"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value > 0):
                raise InputError("detection", name, f"{value}", "give a number above 0")
        if self.width_px is not None and self.width_px > MOST_WIDTH_PX:
            raise InputError("detection", "width_px", f"{self.width_px:g}", f"give {MOST_WIDTH_PX:g} px at most")
        for name, count, wanted in (("colour", 3, "three numbers from 0 to 255: red, green and blue"),
                                    ("region", 4, "left, top, width and height in px, at least 16 x 16")):
            value = getattr(self, name)
            if value is None:
                continue
            numbers = tuple(value)
            sound = len(numbers) == count and np.isfinite(numbers).all() and min(numbers) >= 0
            if not sound or (max(numbers) > 255 if name == "colour" else min(numbers[2:]) < 16):
                raise InputError("detection", name, f"{numbers}", f"give {wanted}")
            object.__setattr__(self, name, numbers)


def image_part(image: np.ndarray, options: DetectionOptions) -> tuple[np.ndarray, tuple[int, int]]:
    """:func:`cropped` of an image. Raises InputError for anything but (H, W) or (H, W, 3) numbers of at least 16 × 16, too."""
    form = image.ndim in (2, 3) and image.shape[2:] in ((), (3,)) and image.dtype.kind in "uif"
    if not form or min(image.shape[:2]) < 16:
        raise InputError("detection", "image", f"shape {image.shape} of {image.dtype}",
                         "give (H, W) or (H, W, 3) levels, at least 16 x 16")
    return cropped(image, options)


def cropped(image: np.ndarray, options: DetectionOptions) -> tuple[np.ndarray, tuple[int, int]]:
    """The region of an image, and its corner's x and y. Raises InputError where the image has fewer than 16 × 16 px of it."""
    if options.region is None:
        return image, (0, 0)
    left, top, width, height = (int(value) for value in options.region)
    part = image[top : top + height, left : left + width]
    if min(part.shape[:2]) < 16:
        raise InputError("detection", "region", f"{options.region} has less than 16 x 16 px of the image",
                         f"give a part of its {image.shape[1]} x {image.shape[0]} px")
    return part, (left, top)


# --- the centre line -----------------------------------------------------------------------------------------------------

BLUNT_PX, BLUNT = 1.5, 0.3  # px, and share of the thread's width: see end_sigma


@typed
@dataclass(frozen=True)
class Detection:
    """The centre line found in one image; N = 0 where no thread was found.

    points     (N, 2) px, x and y, at most a pixel apart along the line, in no order
    direction  (N, 2) unit tangents, of either sign
    strength   (N,) grey levels: how distinct the line is
    width_px   median distance between the thread's edges, NaN without a thread
    polarity   "dark" or "light", "" without a thread
    shape      (height, width) of the image
    method     of :class:`DetectionOptions`, or "colour", "mask", "follow"
    width      (N,) px: the line's width at each point, of masks and where the thread goes on along something wider; else None
    """

    __repr__ = short_repr

    points: Annotated[np.ndarray, "N 2"]
    direction: Annotated[np.ndarray, "N 2"]
    strength: Annotated[np.ndarray, "N"]
    width_px: float
    polarity: str
    shape: tuple[int, int]
    method: str
    width: Annotated[np.ndarray, "N"] | None = None

    @property
    def end_sigma(self) -> float:
        """px: standard deviation along the line of where it ends. Ends may be cut or round."""
        return max(BLUNT_PX, BLUNT * self.width_px)

    @property
    def widths(self) -> np.ndarray:
        """(N,) px: the thread's width at each point; where only one is known, that."""
        return np.full(len(self.points), float(self.width_px)) if self.width is None else self.width

    @classmethod
    def none(cls, shape: tuple[int, int], method: str) -> "Detection":
        """No thread in an image of that ``shape``."""
        return cls(np.empty((0, 2)), np.empty((0, 2)), np.empty(0), np.nan, "", shape, method)

    def take(self, rows: np.ndarray) -> "Detection":
        """Some of the points: their numbers, or (N,) bool."""
        return replace(self, points=self.points[rows], direction=self.direction[rows], strength=self.strength[rows],
                       width=None if self.width is None else self.width[rows])

    def with_parts(self, parts: Sequence["Detection"]) -> "Detection":
        """The same with the points of other ``parts`` of the line, each as wide as it is there."""
        points, direction, strength, width = (np.concatenate([getattr(one, name) for one in (self, *parts)])
                                              for name in ("points", "direction", "strength", "widths"))
        return replace(self, points=points, direction=direction, strength=strength, width=width)

    def copy(self) -> "Detection":
        """The same in arrays of its own."""
        return self.take(np.arange(self.count))

    @property
    def count(self) -> int:
        return len(self.points)


def thinned(detection: Detection) -> tuple[np.ndarray, np.ndarray]:
    """The strongest point of each pixel (N', 2), and its direction: about one for each pixel of line."""
    order = np.argsort(-detection.strength, kind="stable")
    cells = np.round(detection.points[order]).astype(np.int64)
    _, first = np.unique(cells[:, 1] * (detection.shape[1] + 1) + cells[:, 0], return_index=True)
    kept = order[np.sort(first)]
    return detection.points[kept], detection.direction[kept]


SAME_PX = 0.5  # nearer points, either side of the border between two pixels, are one


def single(detection: Detection) -> tuple[np.ndarray, np.ndarray]:
    """:func:`thinned` without points that lie right beside a stronger one: chains would end there."""
    points, direction = thinned(detection)
    twins = cKDTree(points).query_pairs(SAME_PX, output_type="ndarray") if len(points) else np.empty((0, 2), np.int64)
    kept = np.ones(len(points), dtype=bool)
    for strong, weak in twins[np.lexsort(twins.T)]:  # the strongest come first
        kept[weak] &= not kept[strong]
    return points[kept], direction[kept]


def moved(detection: Detection, corner: tuple[int, int]) -> Detection:
    """What was detected in a region that begins at ``corner``, in px of the whole image."""
    return replace(detection, points=detection.points + corner) if any(corner) else detection


def in_whole_pixels(found: Detection, scale: float) -> Detection:
    """What was detected in an image that has one pixel for ``scale``, in px of the image itself and again at most a pixel
    apart."""
    if scale == 1:
        return found
    between = np.arange(scale) - (scale - 1) / 2
    points = (scale * found.points[:, None] + between[:, None] * found.direction[:, None]).reshape(-1, 2)
    dense = found.take(np.repeat(np.arange(found.count), len(between)))
    return replace(dense, points=points, width_px=scale * found.width_px,
                   width=None if found.width is None else scale * dense.width)


NEXT_PX = 2.6  # largest distance between points that follow each other
SLOPE, BEND = 0.6, 0.77  # of these: largest share of the step across the direction of either, least cosine between both
SHORTEST_PX = 4.0  # chains that are shorter are noise
END_PX = 8.0  # length of the end of a chain whose direction counts
TOUCHING, ENDS_PX = 1.0, 3.0  # from the end of the thread to that of a line that goes on: widths of that line, and px more …
AGREEING = 0.7  # … and the least cosine between their directions
BESIDE = 0.7  # share of such a line along which another one that goes on runs: these are two strands
GLINT = 3.0  # least widths of such a line whose edges were found: strands that touch are shorter
INSIDE = 0.2  # least darkness within one whose edges were found, over the thread's: of glints 0.3 and more, in loops 0.1


def chains_of(points: np.ndarray, direction: np.ndarray) -> list[np.ndarray]:
    """(M, 2) px each, M of the ``points`` (N, 2) in order. There is about one for each pixel of line, with its ``direction``
    (N, 2)."""
    if len(points) < 2:
        return []
    pairs = cKDTree(points).query_pairs(NEXT_PX, output_type="ndarray")
    pairs = np.concatenate([pairs, pairs[:, ::-1]])
    one, other = pairs.T
    step = points[other] - points[one]
    length, normal = np.linalg.norm(step, axis=1), normal_to(direction)
    forward = (step * direction[one]).sum(axis=1)
    turned = np.abs((direction[one] * direction[other]).sum(axis=1))
    aside = np.maximum(*(np.abs((step * normal[end]).sum(axis=1)) for end in (one, other)))
    fits = (aside <= SLOPE * length) & (turned >= BEND) & (length > 0.3)
    one, other, forward, length, aside = (values[fits] for values in (one, other, forward, length, aside))
    way = (forward > 0).astype(int)
    best = np.full((len(points), 2), -1)
    order = np.lexsort((other, length + 2 * aside, way, one))
    keys = 2 * one[order] + way[order]
    leading = order[np.flatnonzero(np.diff(keys, prepend=-1))]
    best[one[leading], way[leading]] = other[leading]
    mutual = np.array([[k if k >= 0 and i in best[k] else -1 for k in row] for i, row in enumerate(best)])
    chains, left = [], np.ones(len(points), dtype=bool)
    ends = np.flatnonzero((mutual >= 0).sum(axis=1) == 1)
    for begin in [*ends, *np.flatnonzero((mutual >= 0).all(axis=1))]:  # ends first, then closed chains
        if not left[begin]:
            continue
        rows, here = [], int(begin)
        while here >= 0 and left[here]:
            rows.append(here)
            left[here] = False
            here = next((int(k) for k in mutual[here] if k >= 0 and left[k]), -1)
        if len(rows) > 2 and curve_length(points[rows]) >= SHORTEST_PX:
            chains.append(points[rows])
    return chains


def outward(chain: np.ndarray, way: int) -> np.ndarray:
    """(2,) unit direction in which a chain ends."""
    points = (chain[::-1] if way else chain)[: int(4 * END_PX)]  # which are a third of a pixel apart or more
    out = points[0] - points[min(np.searchsorted(arc_lengths(points), END_PX), len(points) - 1)]
    return out / max(np.linalg.norm(out), 1e-12)


def goes_on(chain: np.ndarray, known: list[np.ndarray], width: float, dark: np.ndarray) -> bool:
    """Whether a chain begins where one of those ``known`` ends, and no other one ends beside that half of it.

    width  px of the line that the chain is
    dark   (H, W) how much pixels differ from the background towards the thread, 255 for its contrast
    """
    line, length = cKDTree(chain), curve_length(chain)
    apart, at = line.query(np.array([end for other in known for end in (other[0], other[-1])]))
    touching = np.flatnonzero(apart <= TOUCHING * width + ENDS_PX)
    half = (2 * at[touching] >= len(chain)).astype(int)
    inward = -np.stack([outward(chain, way) for way in (0, 1)])[half]
    ahead = np.array([outward(known[end // 2], end % 2) for end in touching]).reshape(-1, 2)
    agreeing = (ahead * inward).sum(axis=1) >= AGREEING
    if not agreeing.any():  # as of most chains
        return False
    beside = line.query(np.concatenate(known), distance_upper_bound=width)[0]
    first = np.cumsum([0, *map(len, known[:-1])])
    inside, near = np.logical_and.reduceat(beside <= width, first), np.logical_or.reduceat(beside <= 0.6 * width, first)
    column, row = np.rint(chain).astype(int).T
    if inside.any() and (length < GLINT * width or np.median(dark[row, column]) < INSIDE * 255):
        return False
    strands = (known[k] for k in np.flatnonzero(near & ~inside))
    if any((cKDTree(other).query(chain)[0] <= 0.6 * width).mean() > BESIDE for other in strands):
        return False
    lengths = accumulate(curve_length(known[k]) for k in np.flatnonzero(~inside))
    if all(others < length for others in lengths):
        return False  # what has two edges all along is two threads
    return int(np.bincount(half[agreeing & ~inside[touching // 2]], minlength=2).max()) == 1


# --- tips ------------------------------------------------------------------------------------------------------------------

THIN_PX = 3.0  # width of a thread that is hardly wider than the blur of its edges: that it ends early does not show
TIP = 0.3  # least slope of the image along the thread at its tip, over that at its edges
ACROSS = np.linspace(-0.2, 0.2, 5)  # widths aside of the line, where the image is looked at for that
BEYOND = 0.75  # widths beyond the end of a line up to which the tip may be


def to_tips(found: Detection, image: np.ndarray, slope: float, before: float = 0.0) -> Detection:
    """What was ``found`` in an image (H, W) float32, with lines that end where the thread does. Near its tip edges turn, and
    the roof of a mask parts towards corners: so lines go on from half a width before it, as bent as they are, to where the
    image changes most along them. Where there are other lines, they stay as they are.

    slope   of the thread's edges, in grey levels per px
    before  px by which lines are to end before tips
    """
    def along(places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.vander(places, 3) @ bent, -unit_vectors(np.vander(2 * places, 2) @ bent[:2])

    chains, slopes = chains_of(*single(found)), gradient(image) * (-1 if found.polarity == "light" else 1)
    if not chains:
        return found
    lengths = np.array([curve_length(chain) for chain in chains])
    low, high = (np.array([corner(chain, axis=0) for chain in chains]) for corner in (np.min, np.max))
    tree, widths, kept, rows, tips = cKDTree(found.points), found.widths, np.ones(found.count, dtype=bool), [], []
    for k, way in np.ndindex(len(chains), 2):
        chain = chains[k][::-1] if way else chains[k]
        arc, wide = arc_lengths(chain), float(np.median(widths[tree.query(chain[: int(4 * END_PX)])[1]]))
        if wide < THIN_PX or arc[-1] < max(2 * wide, 3 * END_PX):
            continue
        place, cut = np.arange(0.5 * wide, -BEYOND * wide - 2, -STEP_PX), 0.5 * wide
        for _ in range(2):  # how the line is bent is known up to half a width before the tip
            begin, end = np.searchsorted(arc, [cut, cut + max(1.5 * wide, 3 * END_PX)])
            bent = np.polyfit(arc[begin:end], chain[begin:end], 2)
            at, ahead = along(place)
            x, y = np.moveaxis((at + wide * ACROSS[:, None, None] * normal_to(ahead)).astype(np.float32), -1, 0)
            change = cv2.remap(slopes, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_CONSTANT)
            where, most = peak((change * ahead).sum(axis=-1).mean(axis=0)[None])
            last = place[0] - STEP_PX * where[0]
            cut = max(last + 0.5 * wide, 0.0)
        place = last + before + np.arange(0.0, 0.5 * wide, 1 / POINTS_PER_PX)
        at, ahead = along(place)
        inside = (at[0] > 0).all() and (at[0] < np.array(image.shape[::-1]) - 1).all()
        if not inside or most[0] < TIP * slope:
            continue
        about = (low <= at.max(axis=0) + wide).all(axis=1) & (high >= at.min(axis=0) - wide).all(axis=1) & (lengths > wide)
        others = [chains[j] for j in np.flatnonzero(about) if j != k]
        if (cKDTree(at).query(np.concatenate([*others, chain[end:]]))[0] < wide).any():
            continue
        away = found.points - at[-1]
        behind, aside = away @ ahead[-1], np.abs(away @ normal_to(ahead[-1]))
        kept &= (behind < 0) | (behind > 1.5 * wide + 2) | (aside > 0.5 * wide + 1)
        rows.append(np.full(len(at), tree.query(chain[begin])[1]))
        tips.append(np.stack([at, ahead]))
    if not tips:
        return found
    points, direction = np.concatenate(tips, axis=1)
    longer = found.take(np.concatenate([np.flatnonzero(kept), *rows]))
    return replace(longer, points=np.concatenate([found.points[kept], points]),
                   direction=np.concatenate([found.direction[kept], direction]))
