"""What an image file states before it is unpacked: its size, which may fill the memory, and how the camera was held."""

import re
import struct

PNG, JPEG, BMP = b"\x89PNG", b"\xff\xd8", b"BM"
PNM = re.compile(rb"P[1-6]\s+(?:#[^\n]*\n\s*)*(\d{1,9})\s+(?:#[^\n]*\n\s*)*(\d{1,9})\s")
KNOWN = "PNG, JPEG, TIFF, BMP, PGM or PPM"
TIFF = {b"II*\0": "<", b"MM\0*": ">"}
"""Beginnings of files, and the order of bytes."""
_NO_FRAME = (0xC4, 0xC8, 0xCC)
_WIDTH, _HEIGHT, _ORIENTATION = 256, 257, 274
"""Tags of TIFF, and of the Exif data of other files, which are in its form."""
_EXIF = b"Exif\0\0", b"eXIf"
"""What Exif data follow in JPEG and PNG."""
SEARCHED = 1 << 16
"""Bytes of a file's beginning in which the orientation of one that is no TIFF is stated."""
UPRIGHT = 1


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
    found = _tags(content, order)
    return tuple(found[tag] for tag in (_WIDTH, _HEIGHT) if tag in found)


def _tags(content: bytes, order: str) -> dict[int, int]:
    """The first numbers of the first directory of a TIFF file."""
    first, = struct.unpack(f"{order}I", content[4:8])
    count, = struct.unpack(f"{order}H", content[first : first + 2])
    found = {}
    for entry in range(first + 2, first + 2 + 12 * count, 12):
        tag, kind = struct.unpack(f"{order}HH", content[entry : entry + 4])
        form = struct.Struct(f"{order}{'H' if kind == 3 else 'I'}")
        found[tag], = form.unpack(content[entry + 8 : entry + 8 + form.size])
    return found


def may_be_transparent(content: bytes) -> bool:
    """Whether an image file states an alpha channel or transparent colours: of the formats that are read, PNG alone."""
    return content.startswith(PNG) and (content[25:26] in (b"\x04", b"\x06") or b"tRNS" in content[: content.find(b"IDAT")])


def stated_orientation(content: bytes) -> int:
    """The orientation tag of an image file: 1 to 8, as Exif numbers them; 1, upright, where there is none."""
    beginning = content[:SEARCHED]
    places = [place + len(mark) for mark in _EXIF if (place := beginning.find(mark)) >= 0]
    try:
        for place in [0, *places]:
            order = TIFF.get(content[place : place + 4])
            tag = _tags(content[place:], order).get(_ORIENTATION, UPRIGHT) if order else UPRIGHT
            if 1 < tag <= 8:
                return tag
    except struct.error:  # it ends before
        pass
    return UPRIGHT
