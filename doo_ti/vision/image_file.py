"""Images from files, as grey levels."""

import os
import struct
import sys
from contextlib import contextmanager, nullcontext
from pathlib import Path
from threading import Lock

import numpy as np

from doo_ti.errors import InputError
from doo_ti.file_content import read_content
from doo_ti.vision.rig import MOST_SIDE, Camera

ENDS = ((b"\x89PNG", b"IEND"), (b"\xff\xd8", b"\xff\xd9"))
"""What whole PNG and JPEG files begin and end with."""
_alone = Lock()


def read_image(path: str | os.PathLike, camera: Camera | None = None) -> np.ndarray:
    """(H, W) uint8 grey levels of any image file that OpenCV reads; colours are weighted, the orientation tag is obeyed.

    camera  whose image it is

    Raises InputError for a file that is missing or is no image, and for another size than the camera's.
    """
    import cv2

    if hasattr(cv2, "setLogLevel"):
        cv2.setLogLevel(0)  # its lines on the standard error would stand beside the caller's own
    path = Path(path)
    stored = np.frombuffer(read_content(path, remedy="name a readable image"), dtype=np.uint8)
    _check_side(path, *_png_size(stored[:24].tobytes()))  # before it is unpacked
    try:
        with nullcontext() if _is_whole(stored[:8].tobytes(), stored[-16:].tobytes()) else _silenced():
            image = cv2.imdecode(stored, cv2.IMREAD_GRAYSCALE) if stored.size else None
    except cv2.error:
        image = None
    if image is None:
        raise InputError(path, "file", "cannot be read as an image", "give a PNG, JPEG or TIFF file")
    _check_side(path, *image.shape)
    if camera is not None and image.shape != (camera.height, camera.width):
        raise InputError(path, "size", f"{image.shape[1]} x {image.shape[0]} px, but {camera.name} of {camera.source} takes "
                         f"{camera.width} x {camera.height}", "give the rig's own images, neither scaled nor cropped")
    return image


def _png_size(head: bytes) -> tuple[int, ...]:
    """Width and height of a PNG, from its first bytes; nothing for other files."""
    return struct.unpack(">II", head[16:24]) if head.startswith(ENDS[0][0]) and len(head) == 24 else ()


def _check_side(path: Path, *sides: int) -> None:
    if max(sides, default=0) > MOST_SIDE:
        raise InputError(path, "size", f"{' x '.join(map(str, sides))} px", f"give images of at most {MOST_SIDE:,} px a side")


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
