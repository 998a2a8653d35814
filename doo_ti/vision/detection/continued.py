"""Where a thread goes on but looks different: along a glint, or where it is wider than most of it.

A shiny thread has light lines within it: what is left of a dark thread are its two edges. Closing the darkness of an image
fills what is narrower than the thread, and the thread is one line again. Such a line is taken for the thread where it begins at
an end of what was found of it, in its direction, and no other end is there: where strands cross, or lie side by side, there are
more. It ends at another end, or is free: a needle is wider than its thread. What lies between two lines and is as light as the
background is no glint, but the inside of a narrow loop.
"""

import cv2
import numpy as np
from scipy.spatial import cKDTree

from doo_ti.vision.detection.appearance import BAR, Appearance
from doo_ti.vision.detection.line import Detection, chain_length, chains_of, outward
from doo_ti.vision.detection.ridge import REACH_PX, Curvature, Ridges, edges_across, gradient

TIMES = (2.0, 4.0)  # widths of lines that are tried, over that of the thread
SIGMA_PER_WIDTH = 0.35
FAINTEST = 0.4  # least strength over that of a line as dark as the thread
TOUCHING, ENDS_PX = 1.0, 3.0  # from the end of the thread to that of a line that goes on: widths of that line, and px more …
AGREEING = 0.7  # … and the least cosine between their directions
BESIDE = 0.7  # share of such a line along which another one that goes on runs: these are two strands
SHORTEST, GLINT = 1.0, 3.0  # least widths of such a line, and of one whose edges were found: strands that touch are shorter
INSIDE = 0.2  # least darkness within one whose edges were found, over the thread's: of glints 0.3 and more, in loops 0.1


def continued(image: np.ndarray, look: Appearance, ridges: Ridges) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(M, 2) points, (M, 2) directions and (M,) strengths of the thread in an image (H, W) float32: the ``ridges`` found at its
    usual width, and what goes on from their ends."""
    found = ridges.point, ridges.tangent, ridges.strength
    own = chains_of(_as_detection(*found, look, image.shape))
    if not own:
        return found
    contrast = float(np.median(ridges.strength)) / BAR
    dark = _darkness(image, look, contrast)
    for turn, times in enumerate(2 * TIMES):  # a part that is wider may become narrower again
        if turn == len(TIMES) and len(found[0]) == len(ridges.row):
            break
        width = times * look.width_px
        line = _lines(dark, width, np.concatenate([found[0], *own]), look.width_px)
        added = _joined(line, own, width, dark)
        if added:
            beside = _edges_of(found[0], own, added, width)
            found = tuple(np.concatenate([array[~beside], *new]) for array, new in zip(found, zip(*added), strict=True))
            own = chains_of(_as_detection(*found, look, image.shape))
    return found


def _as_detection(points, direction, strength, look: Appearance, shape: tuple[int, ...]) -> Detection:
    return Detection(points, direction, strength, look.width_px, look.polarity, shape, "ridge")


def _darkness(image: np.ndarray, look: Appearance, contrast: float) -> np.ndarray:
    """(H, W) float32: how much each pixel differs from the background around it towards the thread, 255 for its contrast."""
    side = 2 * int(np.ceil(1.25 * max(TIMES) * look.width_px)) + 1
    kernel = cv2.getStructuringElement(cv2.MORPH_RECT, (side, side))
    kind = cv2.MORPH_BLACKHAT if look.polarity == "dark" else cv2.MORPH_TOPHAT
    return np.minimum(cv2.morphologyEx(image, kind, kernel) * np.float32(255 / contrast), np.float32(255))


def _lines(dark: np.ndarray, width: float, own: np.ndarray, usual: float) -> Detection:
    """Lines about as wide as ``width`` in the closed darkness, away from points ``own`` (N, 2) of a line ``usual`` px wide."""
    side = 2 * int(np.ceil(width / 2)) + 1
    closed = cv2.morphologyEx(dark, cv2.MORPH_CLOSE, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side)))
    ridges = Curvature(closed, SIGMA_PER_WIDTH * width).ridges("light", FAINTEST * BAR * 255)
    edges = edges_across(gradient(closed), ridges.point, ridges.normal, "light", 0.75 * width + 2)
    sound = (edges.width > width / 2) & (edges.width < 1.5 * width + 1) & (np.abs(ridges.offset + edges.shift) <= REACH_PX)
    sound &= edges.balance > 0
    ridges = ridges.moved(edges.shift)[sound]
    if len(ridges.row):
        ridges = ridges[cKDTree(own).query(ridges.point)[0] > 0.5 * usual + 1]
    return Detection(ridges.point, ridges.tangent, ridges.strength, width, "light", dark.shape, "ridge")


def _joined(line: Detection, own: list[np.ndarray], width: float, dark: np.ndarray) -> list[tuple[np.ndarray, ...]]:
    """Points, directions and strengths of the parts of a ``line`` that go on from ends of the chains ``own``, or of those."""
    waiting, parts = [chain for chain in chains_of(line) if chain_length(chain) >= SHORTEST * width], []
    tree, known = cKDTree(line.points) if line.count else None, list(own)
    while True:
        ready = next((k for k, chain in enumerate(waiting) if _goes_on(chain, known, width, dark)), None)
        if ready is None:
            return parts
        chain = waiting.pop(ready)
        at = tree.query(chain)[1]
        parts.append((chain, line.direction[at], line.strength[at]))
        known.append(chain)


def _goes_on(chain: np.ndarray, known: list[np.ndarray], width: float, dark: np.ndarray) -> bool:
    """Whether a chain begins where one of those ``known`` ends, and no other one ends beside that half of it."""
    line = cKDTree(chain)
    inside = [line.query(other)[0].max() <= width for other in known]
    edges, others = ([other for other, here in zip(known, inside, strict=True) if bool(here) is kind] for kind in (True, False))
    column, row = np.rint(chain).astype(int).T
    within = np.median(dark[row, column])
    if edges and (chain_length(chain) < GLINT * width or within < INSIDE * 255):
        return False
    strand = any((cKDTree(other).query(chain)[0] <= 0.6 * width).mean() > BESIDE for other in others)
    if strand or sum(chain_length(other) for other in others) < chain_length(chain):
        return False  # what has two edges all along is two threads
    ends = np.array([other[-1 if way else 0] for other in others for way in (0, 1)])
    ahead = np.array([outward(other, way) for other in others for way in (0, 1)])
    apart, at = line.query(ends)
    half = (2 * at >= len(chain)).astype(int)
    inward = -np.stack([outward(chain, way) for way in (0, 1)])[half]
    agreeing = (apart <= TOUCHING * width + ENDS_PX) & ((ahead * inward).sum(axis=1) >= AGREEING)
    return int(np.bincount(half[agreeing], minlength=2).max()) == 1


def _edges_of(points: np.ndarray, own: list[np.ndarray], parts: list[tuple[np.ndarray, ...]], width: float) -> np.ndarray:
    """(N,) bool: points of chains that lie beside the ``parts`` as their edges do, from end to end."""
    line = cKDTree(np.concatenate([part[0] for part in parts]))
    edges = [chain for chain in own if line.query(chain)[0].max() <= width]
    if not edges:
        return np.zeros(len(points), dtype=bool)
    return cKDTree(np.concatenate(edges)).query(points)[0] <= 1.0
