"""What is known about the thread before an image is looked at, and which part of the image is looked at."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from doo_ti.system.arguments import short_repr, typed
from doo_ti.system.errors import InputError

METHODS = ("ridge", "canny")
POLARITIES = ("dark", "light")
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
    region          left, top, width and height in px of the part of the image where the thread is; None: all of it

    Raises InputError for another method or polarity, numbers that are not positive, and other colours and regions.
    """

    __repr__ = short_repr

    method: str = "ridge"
    polarity: str | None = None
    width_px: float | None = None
    least_contrast: float = 10.0
    shortest_px: float = 10.0
    colour: Sequence[float] | None = None
    region: Sequence[int] | None = None

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


def check_image(image: np.ndarray) -> None:
    """Raise InputError for anything but (H, W) or (H, W, 3) numbers of at least 16 × 16."""
    form = image.ndim in (2, 3) and image.shape[2:] in ((), (3,)) and image.dtype.kind in "uif"
    if not form or min(image.shape[:2]) < 16:
        raise InputError("detection", "image", f"shape {image.shape} of {image.dtype}",
                         "give (H, W) or (H, W, 3) levels, at least 16 x 16")


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
