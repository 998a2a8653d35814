"""Images from files, as grey levels."""

import os
import struct
import sys
from contextlib import contextmanager
from pathlib import Path
from threading import Lock

import numpy as np

from doo_ti.errors import InputError
from doo_ti.file_content import read_content
from doo_ti.vision.rig import MOST_SIDE, Camera

PNG = b"\x89PNG"
_changing, _silent = Lock(), []
"""What the standard error was, while images are decoded, and once for each that is."""


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
        with _silenced():
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
    return struct.unpack(">II", head[16:24]) if head.startswith(PNG) and len(head) == 24 else ()


def _check_side(path: Path, *sides: int) -> None:
    if max(sides, default=0) > MOST_SIDE:
        raise InputError(path, "size", f"{' x '.join(map(str, sides))} px", f"give images of at most {MOST_SIDE:,} px a side")


@contextmanager
def _silenced():
    """Without what image libraries write to the standard error about a damaged file: the caller reports on it in one line. As
    there is one standard error, the first thread to decode an image silences it, and the last one has it heard again."""
    with _changing:
        if not _silent:
            sys.stderr.flush()
            kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, 2)
            os.close(nowhere)
        else:
            kept = _silent[0]
        _silent.append(kept)
    try:
        yield
    finally:
        with _changing:
            _silent.pop()
            if not _silent:
                os.dup2(kept, 2)
                os.close(kept)
