"""Images from files, as grey levels."""

import os
import sys
from contextlib import contextmanager, nullcontext
from pathlib import Path
from threading import Lock

import numpy as np

from doo_ti.errors import InputError, system_reason
from doo_ti.vision.rig import Camera

ENDS = ((b"\x89PNG", b"IEND"), (b"\xff\xd8", b"\xff\xd9"))
"""What whole PNG and JPEG files begin and end with."""
_alone = Lock()


def read_image(path: str | os.PathLike, camera: Camera | None = None) -> np.ndarray:
    """(H, W) uint8 grey levels of any image file that OpenCV reads; colours are weighted, the orientation tag is obeyed.

    camera  whose image it is

    Raises InputError for a file that is missing or is no image, and for another size than the camera's.
    """
    import cv2

    path = Path(path)
    try:
        stored = np.fromfile(path, dtype=np.uint8)
    except (OSError, ValueError) as error:  # a name that holds a null byte
        raise InputError(path, "file", system_reason(error), "name a readable image") from None
    try:
        with nullcontext() if _is_whole(stored[:8].tobytes(), stored[-16:].tobytes()) else _silenced():
            image = cv2.imdecode(stored, cv2.IMREAD_GRAYSCALE) if stored.size else None
    except cv2.error:
        image = None
    if image is None:
        raise InputError(path, "file", "cannot be read as an image", "give a PNG, JPEG or TIFF file")
    if camera is not None and image.shape != (camera.height, camera.width):
        raise InputError(path, "size", f"{image.shape[1]} x {image.shape[0]} px, but {camera.name} of {camera.source} takes "
                         f"{camera.width} x {camera.height}", "give the rig's own images, neither scaled nor cropped")
    return image


def _is_whole(head: bytes, tail: bytes) -> bool:
    """Whether a file begins and ends as a PNG or a JPEG does."""
    return any(head.startswith(begin) and end in tail for begin, end in ENDS)


@contextmanager
def _silenced():
    """Without what image libraries write to the standard error about files that the caller reports on in one line; one
    thread at a time, since there is one standard error."""
    with _alone:
        sys.stderr.flush()
        kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, 2)
        try:
            yield
        finally:
            os.dup2(kept, 2)
            os.close(kept)
            os.close(nowhere)
