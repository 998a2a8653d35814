"""The size that an image file states, before it is unpacked: a few bytes may state one that fills the memory."""

import re
import struct

PNG, JPEG, BMP = b"\x89PNG", b"\xff\xd8", b"BM"
PNM = re.compile(rb"P[1-6]\s+(?:#[^\n]*\n\s*)*(\d{1,9})\s+(?:#[^\n]*\n\s*)*(\d{1,9})\s")
KNOWN = "PNG, JPEG, TIFF, BMP, PGM or PPM"
TIFF = {b"II*\0": "<", b"MM\0*": ">"}
"""Beginnings of files, and the order of bytes."""
_NO_FRAME = (0xC4, 0xC8, 0xCC)
_WIDTH, _HEIGHT = 256, 257
"""Tags of TIFF."""


def stated_size(content: bytes) -> tuple[int, ...]:
    """Width and height of an image file of a format that is :data:`KNOWN`, or its height and width; nothing for other and
    damaged files."""
    try:
        if content.startswith(PNG):
            return struct.unpack(">II", content[16:24])
        if content.startswith(JPEG):
            return _of_jpeg(content)
        if content.startswith(BMP):
            return tuple(map(abs, struct.unpack("<ii", content[18:26])))
        if stated := PNM.match(content[:1000]):
            return tuple(map(int, stated.groups()))
        if content[:4] in TIFF:
            return _of_tiff(content, TIFF[content[:4]])
    except struct.error:  # it ends before
        pass
    return ()


def _of_jpeg(content: bytes) -> tuple[int, ...]:
    place = 2
    while place < len(content):
        mark, length = struct.unpack(">HH", content[place : place + 4])
        if mark >> 8 != 0xFF:
            return ()
        if 0xFFC0 <= mark <= 0xFFCF and mark & 0xFF not in _NO_FRAME:
            return struct.unpack(">HH", content[place + 5 : place + 9])
        place += 2 + length
    return ()


def _of_tiff(content: bytes, order: str) -> tuple[int, ...]:
    first, = struct.unpack(f"{order}I", content[4:8])
    count, = struct.unpack(f"{order}H", content[first : first + 2])
    sizes = []
    for entry in range(first + 2, first + 2 + 12 * count, 12):
        tag, kind = struct.unpack(f"{order}HH", content[entry : entry + 4])
        if tag in (_WIDTH, _HEIGHT):
            form = struct.Struct(f"{order}{'H' if kind == 3 else 'I'}")
            sizes += form.unpack(content[entry + 8 : entry + 8 + form.size])
    return tuple(sizes)
