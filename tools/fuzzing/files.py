"""Changes of any file: of its bytes, of images' chunks, and its replacement by something else."""

import os
import random
import shutil
import struct
import zlib
from pathlib import Path

from tools.fuzzing.arrays import spoil_npz, spoil_parquet
from tools.fuzzing.texts import spoil_text

STRUCTURED = {".npz": spoil_npz, ".parquet": spoil_parquet} | dict.fromkeys(
    (".toml", ".csv", ".yaml", ".json", ".txt"), spoil_text
)


def spoil(path: Path, corpus: Path, chance: random.Random) -> tuple[str, str]:
    """Change one thing about a good file; returns the change's kind and what it is."""
    structured = spoil_image if path.suffix == ".png" else STRUCTURED.get(path.suffix)
    if structured is not None and chance.random() < 0.7:
        try:
            return structured(path, chance)
        except (OverflowError, ValueError, NotImplementedError) as error:  # a value that the format cannot hold
            return "structure", f"none: {error}"[:60]
    if chance.random() < 0.85:
        return "bytes", spoil_bytes(path, chance)
    return "place", _replace(path, corpus, chance)


def spoil_bytes(path: Path, chance: random.Random) -> str:
    content = bytearray(path.read_bytes())
    at, size = chance.randrange(len(content) + 1), len(content)
    length = min(chance.choice((1, 2, 4, 16, 256)), size)
    way = chance.choice(
        ("flip", "flip", "flips", "truncate", "truncate", "insert", "duplicate", "remove", "zeros", "ones", "tail", "empty")
    )
    if way in ("flip", "flips") and size:
        for _ in range(1 if way == "flip" else chance.randint(2, 40)):
            content[chance.randrange(size)] ^= 1 << chance.randrange(8)
    elif way == "truncate":
        del content[at:]
    elif way == "insert":
        content[at:at] = chance.randbytes(length)
    elif way == "duplicate":
        content[at:at] = content[at : at + length]
    elif way == "remove":
        del content[at : at + length]
    elif way in ("zeros", "ones"):
        content[at : at + length] = (b"\0" if way == "zeros" else b"\xff") * len(content[at : at + length])
    elif way == "tail":
        content += chance.randbytes(length)
    else:
        content.clear()
    path.write_bytes(content)
    return f"{way} at {at} of {size}"


def _replace(path: Path, corpus: Path, chance: random.Random) -> str:
    """Something else where the file was."""
    way = chance.choice(("nothing", "folder", "loop", "dangling", "device", "pipe", "another", "another", "another"))
    path.unlink()
    if way == "folder":
        path.mkdir()
    elif way == "loop":
        path.symlink_to(path.name)
    elif way == "dangling":
        path.symlink_to("missing")
    elif way == "device":
        path.symlink_to(chance.choice(("/dev/zero", "/dev/null", "/proc/self/mem", "/dev/full")))
    elif way == "pipe":
        os.mkfifo(path)
    elif way == "another":
        other = chance.choice(sorted(each for each in corpus.rglob("*") if each.is_file()))
        shutil.copyfile(other, path)
        return f"{other.relative_to(corpus)} in its place"
    return f"{way} in its place"


def spoil_image(path: Path, chance: random.Random) -> tuple[str, str]:
    """A PNG with a chunk changed, sums and all, or the image in another form."""
    if chance.random() < 0.4:
        return "values", _other_image(path, chance)
    content = path.read_bytes()
    chunks, at = [], 8
    while at < len(content):
        (length,) = struct.unpack_from(">I", content, at)
        chunks.append([content[at + 4 : at + 8], content[at + 8 : at + 8 + length]])
        at += 12 + length
    head = dict(
        zip(
            ("width", "height", "depth", "colour", "compression", "filter", "interlace"),
            struct.unpack(">IIBBBBB", chunks[0][1]),
            strict=True,
        )
    )
    extra = {
        "profile": (b"iCCP", b"x\0\0" + zlib.compress(b"profile" * 30)),
        "gamma": (b"gAMA", b"\0\0\0\0"),
        "text": (b"tEXt", b"a\0b" * 9),
        "rendering": (b"sRGB", b"\x09"),
        "unknown": (b"ABCD", b"x" * 8),
        "palette": (b"PLTE", b"x" * 7),
        "transparent": (b"tRNS", b"x" * 9),
        "animated": (b"acTL", b"\0\0\0\2\0\0\0\0"),
        "exif": (b"eXIf", b"MM\0*\0\0\0\x08\xff\xff"),
        "time": (b"tIME", b"\xff" * 7),
        "physical": (b"pHYs", b"\xff" * 9),
        "second head": (b"IHDR", chunks[0][1]),
    }
    way = chance.choice(("head", "head", "extra", "extra", "data", "sum", "order", "end"))
    described = way
    if way == "head":
        key = chance.choice(sorted(head))
        head[key] = chance.choice(
            (0, 1, 2, 3, 4, 6, 16, 255)
            if key not in ("width", "height")
            else (0, 1, 159, 161, 20_000, 20_001, 2**31 - 1, 2**32 - 1)
        )
        chunks[0][1] = struct.pack(">IIBBBBB", *head.values())
        described = f"{key} {head[key]}"
    elif way == "extra":
        described = chance.choice(sorted(extra))
        chunks.insert(chance.choice((1, 1, len(chunks) - 1)), list(extra[described]))
    elif way == "data":
        data = next(chunk for chunk in chunks if chunk[0] == b"IDAT")
        described, data[1] = chance.choice(
            (
                ("half the data", data[1][: len(data[1]) // 2]),
                ("other data", zlib.compress(b"\x09" * 19_000)),
                ("too much data", zlib.compress(b"\0" * 5_000_000)),
                ("no data", b""),
                ("no zlib", b"x" * 99),
            )
        )
    elif way == "order":
        chance.shuffle(chunks)
    elif way == "end":
        chunks.pop()
    wrong = chance.randrange(len(chunks)) if way == "sum" else None
    path.write_bytes(
        content[:8]
        + b"".join(
            struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data) ^ (index == wrong))
            for index, (name, data) in enumerate(chunks)
        )
    )
    return "structure", described


def _other_image(path: Path, chance: random.Random) -> str:
    import cv2
    import numpy as np

    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    images = {
        "black": image * 0,
        "white": image * 0 + 255,
        "noise": np.random.default_rng(chance.randrange(2**32)).integers(0, 256, image.shape, dtype=np.uint8),
        "turned": image.T,
        "smaller": image[::2, ::2],
        "one pixel": image[:1, :1],
        "upside down": image[::-1],
        "inverted": 255 - image,
        "of 16 bits": image.astype(np.uint16) * 257,
        "coloured": np.stack([image, image, 255 - image], axis=-1),
        "stripes": np.where(np.arange(image.shape[1]) % 2, 255, 0) * np.ones_like(image),
        "with one dot": np.where(np.arange(image.size).reshape(image.shape) == 5000, 0, 255).astype(np.uint8),
    }
    forms = (".png", ".png", ".png", ".jpg", ".bmp", ".tiff", ".webp", ".pgm", ".gif", ".hdr", ".jp2", ".ras")
    described, form = chance.choice(sorted(images)), chance.choice(forms)
    try:
        good, content = cv2.imencode(form, images[described])
    except cv2.error:
        good = False
    if not good:
        form, (_, content) = ".png", cv2.imencode(".png", images[described])
    content = content.tobytes()
    if form != ".png" and chance.random() < 0.5:
        content = content[: chance.randrange(len(content))]
        form += ", cut off"
    path.write_bytes(content)
    return f"{described} as {form}"
