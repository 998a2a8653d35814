"""The paper's detector (§IV-A): Canny's edges, which vote for the centre line."""

import numpy as np

from doo_ti.vision.detection.appearance import Appearance
from doo_ti.vision.detection.ridge import REACH_PX, Curvature, gradient, pieces

CANNY_STRONG, CANNY_WEAK = 0.4, 0.15
"""Canny's thresholds over the slope of the thread's edges."""
VOTE_BLUR_PX = 1.0
"""Standard deviation of a vote."""
MEETING = 0.5
"""Least share of votes on the centre line, of those of two complete edges with an edge pixel per px of length."""
STEEPEST = 8000
"""Slope of the thread's edges in the whole numbers that Canny takes."""


def canny_line(image: np.ndarray, look: Appearance, least_contrast: float, shortest_px: float) -> tuple[np.ndarray, ...]:
    """(N, 2) pixels of the centre line in an image (H, W) float32, their (N, 2) directions and (N,) strengths.

    "A Canny edge detector with a blurred, offset Gaussian kernel" (§IV-A): every edge pixel votes for the place half a thread's
    width along the gradient towards the thread's middle; votes are blurred. The centre line lies where votes of both edges
    coincide. Votes have directions: those of opposite edges cancel, and only votes that cancel count.

    look            of the thread: the offset is half its width
    least_contrast  grey levels: fainter edges are ignored
    shortest_px     of a piece of line
    """
    import cv2

    slope = gradient(image)
    whole = np.clip(np.rint(slope * (STEEPEST / look.slope)), -32767, 32767).astype(np.int16)
    floor = 0.25 * least_contrast / look.slope
    weak, strong = (STEEPEST * max(share, floor) for share in (CANNY_WEAK, CANNY_STRONG))
    edge = cv2.Canny(np.ascontiguousarray(whole[..., 0]), np.ascontiguousarray(whole[..., 1]), weak, strong, L2gradient=True)
    row, column = np.nonzero(edge)
    outward = slope[row, column] / np.maximum(np.linalg.norm(slope[row, column], axis=1, keepdims=True), 1e-30)
    meeting = _meeting(row, column, outward if look.polarity == "dark" else -outward, look.width_px / 2, image.shape)
    curvature = Curvature(meeting, VOTE_BLUR_PX)
    ridges = curvature.ridges("light", 1e-3)
    ridges = ridges[(meeting[ridges.row, ridges.column] >= MEETING) & (np.abs(ridges.offset) <= REACH_PX)]
    ridges = ridges[pieces(ridges, 0.0, shortest_px) > 0]
    return np.stack([ridges.column, ridges.row], axis=1).astype(np.float64), ridges.tangent, look.slope * ridges.strength


def _meeting(row: np.ndarray, column: np.ndarray, outward: np.ndarray, offset: float, shape: tuple[int, int]) -> np.ndarray:
    """(H, W) float32: blurred votes of edge pixels that coincide with votes from the other edge, 1 for two complete edges."""
    import cv2

    x = np.rint(column - offset * outward[:, 0]).astype(np.int64)
    y = np.rint(row - offset * outward[:, 1]).astype(np.int64)
    inside = (x >= 0) & (x < shape[1]) & (y >= 0) & (y < shape[0])
    place, length = (y * shape[1] + x)[inside], shape[0] * shape[1]
    ballots = [np.bincount(place, weight, length).reshape(shape).astype(np.float32)
               for weight in (None, outward[inside, 0], outward[inside, 1])]
    votes, across, down = (cv2.GaussianBlur(ballot, (0, 0), VOTE_BLUR_PX, borderType=cv2.BORDER_CONSTANT) for ballot in ballots)
    return (votes - np.sqrt(across * across + down * down)) * np.float32(VOTE_BLUR_PX * np.sqrt(2 * np.pi) / 2)
