"""Files of cameras: our own, OpenCV's stereo calibration, and COLMAP's text, read and written (§V-A).

COLMAP's pixel (0.5, 0.5) is the centre of the upper left one, ours (0, 0).

A fisheye lens of OpenCV's model (Kannala and Brandt, 2006) becomes a rational one. A ray at the angle θ from the axis,
tan θ = r, appears at θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸) focal lengths from the principal point. Over r this is a function of
r², which the rational model, three coefficients above and three below, follows to 0.1 to 0.3 px as far as 80° off the axis, and
to 0.7 px as far as 84°, with focal lengths of 250 to 600 px.
"""

import os
from contextlib import suppress
from pathlib import Path

import numpy as np

from doo_ti.io.foreign import matrix_of, read_opencv_yaml
from doo_ti.rod.frames import matrix_from_quaternion, rotation_matrix
from doo_ti.system.arguments import typed
from doo_ti.system.errors import InputError
from doo_ti.system.files import read_content, write_text
from doo_ti.vision.cameras import KEYS, Camera, Rig, RigReading

MOST_FILE_BYTES = 1 << 20  # of a rig: some thousand cameras
MOST_IMAGES_BYTES = 1 << 26  # of COLMAP's images.txt, which lists all points seen
MATRIX = ("K{}", "M{}", "cameraMatrix{}", "camera_matrix_{}", "camera_matrix{}", "CM{}", "intrinsics{}")
LENS = ("D{}", "distCoeffs{}", "dist_coeffs_{}", "dist_coeffs{}", "distortion{}", "dist{}", "distCoeff{}",
        "distortion_coefficients{}")
SIZE = (("image_width", "image_height"), ("width", "height"), ("imageWidth", "imageHeight"))
"""How programs name the entries of a stereo file."""
COLMAP = {
    "SIMPLE_PINHOLE": (1, 0), "PINHOLE": (2, 0), "SIMPLE_RADIAL": (1, 1), "RADIAL": (1, 2), "OPENCV": (2, 4),
    "FULL_OPENCV": (2, 8), "OPENCV_FISHEYE": (2, 4), "SIMPLE_RADIAL_FISHEYE": (1, 1), "RADIAL_FISHEYE": (1, 2),
}
"""Numbers of focal lengths and of coefficients; cx and cy are between them."""


@typed
def load_rig(path: str | os.PathLike[str], reading: RigReading = RigReading()) -> Rig:
    """The rig of a file: OpenCV FileStorage YAML with a list ``cameras`` of maps name, width, height, K, dist, R, t, or with
    K1, D1, K2, D2, R, T of a stereo calibration, or the camera_matrix of one camera, also as ROS writes it; or COLMAP's
    cameras.txt and images.txt, by either or their folder.

    Raises InputError for a file that cannot be read, for missing entries, and for values that :class:`Camera` refuses.
    """
    path = Path(path)
    if path.is_dir() or path.suffix == ".txt":
        cameras = colmap_cameras(path if path.is_dir() else path.parent)
    else:
        content = read_yaml(path)
        stereo = stereo_cameras(path, content, reading) if isinstance(content, dict) and "cameras" not in content else None
        cameras = own_cameras(path, content, reading) if stereo is None else stereo
    return Rig(tuple(reading.applied(camera) for camera in cameras), str(path), reading)


def save_rig(path: str | os.PathLike[str], rig: Rig) -> None:
    """Write ``rig`` as OpenCV FileStorage YAML; :func:`load_rig` reads it back."""
    import cv2

    storage = cv2.FileStorage(".yaml", cv2.FileStorage_WRITE | cv2.FileStorage_MEMORY | cv2.FileStorage_FORMAT_YAML)
    storage.startWriteStruct("cameras", cv2.FileNode_SEQ)
    for camera in rig.cameras:
        storage.startWriteStruct("", cv2.FileNode_MAP)
        entries = {"name": camera.name, "width": camera.width, "height": camera.height, "K": np.array(camera.matrix),
                   "dist": camera.distortion.reshape(1, -1).copy(), "R": np.array(camera.rotation),
                   "t": camera.translation.reshape(3, 1).copy()} | ({"orientation": "apply"} if camera.turned else {})
        for key, value in entries.items():
            storage.write(key, value)
        storage.endWriteStruct()
    storage.endWriteStruct()
    write_text(Path(path), storage.releaseAndGetString())


def read_yaml(path: Path):
    """The content of an OpenCV FileStorage YAML file. Raises InputError."""
    stored = read_content(path, MOST_FILE_BYTES, "name a readable rig")
    try:
        return read_opencv_yaml(stored.decode())
    except ValueError as error:  # no text, or no YAML
        raise InputError(path, "file", f"not a rig ({str(error)[:80]})",
                         "give OpenCV FileStorage YAML, or COLMAP's cameras.txt") from None


# --- OpenCV's stereo files -------------------------------------------------------------------------------------------------

def stereo_cameras(path: Path, content: dict, reading: RigReading) -> list[Camera] | None:
    """Two cameras, or the one of a file without a second, the world being the first one's axes; None where the file has no
    matrix of a camera.

    Poses may be in ``extrinsics.yml`` beside ``intrinsics.yml``, as OpenCV's program writes them.
    """
    numbers = (1, 2) if _named(content, MATRIX, 1) is not None else ("",)
    if _named(content, MATRIX, numbers[0]) is None:
        return None
    beside = path.with_name(path.name.replace("intrinsics", "extrinsics"))
    if "R" not in content and beside != path and beside.is_file():
        more = read_yaml(beside)
        content = {**(more if isinstance(more, dict) else {}), **content}
    width, height = _stated_size(path, content, reading)
    cameras = []
    for number in numbers:
        matrix, lens = _named(content, MATRIX, number), _named(content, LENS, number)
        pose = (np.eye(3), np.zeros(3)) if number != 2 else (content.get("R"), content.get("T", content.get("t")))
        for key, value, shapes in ((f"K{number}", matrix, ((3, 3),)), ("R", pose[0], ((3, 3), (3, 1), (1, 3))),
                                   ("T", pose[1], ((3,), (3, 1), (1, 3)))):
            if not isinstance(value, np.ndarray) or value.shape not in shapes:
                raise InputError(path, key, "missing or no matrix", "give K1, D1, K2, D2, R and T of OpenCV's stereoCalibrate")
        lens = np.zeros(5) if lens is None else lens
        if not isinstance(lens, np.ndarray):
            raise InputError(path, f"D{number}", "no matrix", "give the coefficients of distortion")
        turn = rotation_matrix(pose[0].ravel()) if pose[0].size == 3 else pose[0]
        if reading.lens == "fisheye" or content.get("distortion_model") == "equidistant":
            lens = rational_of_fisheye(path, f"D{number}", matrix, lens, width, height)
        cameras.append(Camera(f"cam{len(cameras)}", width, height, matrix, lens.ravel(), turn, pose[1].ravel(), str(path)))
    return cameras


def _named(content: dict, names: tuple[str, ...], number: int | str):
    """The entry of a camera, a matrix where it is one; ROS writes rows, cols and data without saying so."""
    found = next((content[name.format(number)] for name in names if name.format(number) in content), None)
    if isinstance(found, dict):
        with suppress(ValueError):  # else it is no matrix
            return matrix_of({"dt": "d", **found})
    return found


def _stated_size(path: Path, content: dict, reading: RigReading) -> tuple[int, int]:
    found = reading.size or next(((content[wide], content[high]) for wide, high in SIZE if wide in content and high in content),
                                 None)
    for key in ("image_size", "imageSize", "size"):
        if found is None and key in content:
            found = np.ravel(content[key]).tolist()
    if found is None or len(found) != 2 or not all(isinstance(side, int | float) and side % 1 == 0 for side in found):
        raise InputError(path, "image_width, image_height", "missing", "give --image-size WIDTH,HEIGHT")
    return int(found[0]), int(found[1])


# --- COLMAP ------------------------------------------------------------------------------------------------------------------

def colmap_cameras(folder: Path) -> list[Camera]:
    """A camera for each of the images in the model of ``folder``, named as the image is without its suffix. Raises InputError
    for lenses of other kinds and damaged files."""
    lenses = {}
    path = folder / "cameras.txt"
    for number, words in _lines(path, MOST_FILE_BYTES):
        if not words:
            continue
        if len(words) < 5:
            raise InputError(path, f"line {number}", f"{len(words)} words", "give CAMERA_ID MODEL WIDTH HEIGHT PARAMS")
        lenses[words[0]] = _lens(path, number, words)
    path, cameras, points_follow = folder / "images.txt", [], False
    for number, words in _lines(path, MOST_IMAGES_BYTES, 9):
        if points_follow or not words:  # the line of an image's points may be empty
            points_follow = False
            continue
        points_follow = True
        if len(words) < 10:
            raise InputError(path, f"line {number}", f"{len(words)} words", "give IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME")
        if words[8] not in lenses:
            raise InputError(path, f"line {number}", f"CAMERA_ID {words[8]!r} is not in cameras.txt", "export both together")
        pose = _numbers(path, number, words[1:8])
        length = np.linalg.norm(pose[:4])
        if not 0.5 < length < 2:
            raise InputError(path, f"line {number}", f"a quaternion of length {length:g}", "give QW QX QY QZ of length 1")
        width, height, matrix, lens = lenses[words[8]]
        turn = matrix_from_quaternion(pose[:4] / length)
        cameras.append(Camera(str(Path(words[9]).with_suffix("")), width, height, matrix, lens, turn, pose[4:], str(path)))
    if not cameras:
        raise InputError(path, "images", "none", "export a model with images")
    return cameras


def _lines(path: Path, most: int, splits: int = -1):
    """Numbers and words of the lines that are no comments, the last word with what follows ``splits`` others."""
    stored = read_content(path, most, "give a folder with cameras.txt and images.txt")
    try:
        text = stored.decode()
    except UnicodeDecodeError:
        raise InputError(path, "file", "is no text", "export COLMAP's model as text") from None
    for number, line in enumerate(text.splitlines(), 1):
        if not line.lstrip().startswith("#"):
            yield number, line.split(None, splits)


def _numbers(path: Path, number: int, words: list[str]) -> np.ndarray:
    try:
        values = np.array([float(word) for word in words])
    except ValueError:
        values = np.array([np.nan])
    if not np.isfinite(values).all():
        raise InputError(path, f"line {number}", f"{' '.join(words)[:60]!r}", "give finite numbers")
    return values


def _lens(path: Path, number: int, words: list[str]) -> tuple[int, int, np.ndarray, np.ndarray]:
    """Width, height, K and coefficients of a line of cameras.txt."""
    if words[1] not in COLMAP:
        raise InputError(path, f"line {number}", f"model {words[1][:40]!r}", f"use one of {', '.join(COLMAP)}")
    focals, count = COLMAP[words[1]]
    values = _numbers(path, number, words[2:])
    if len(values) != 4 + focals + count or (values[:2] != np.floor(values[:2])).any():
        raise InputError(path, f"line {number}", f"{len(values) - 2} parameters", f"{words[1]} has {2 + focals + count}")
    width, height = int(values[0]), int(values[1])
    focal, (x, y), lens = np.resize(values[2 : 2 + focals], 2), values[2 + focals : 4 + focals], values[4 + focals :]
    matrix = np.array([[focal[0], 0, x - 0.5], [0, focal[1], y - 0.5], [0, 0, 1]])
    if words[1].endswith("FISHEYE"):
        if not (focal > 0).all():
            raise InputError(path, f"line {number}", f"focal lengths {focal.tolist()}", "give numbers above 0")
        return width, height, matrix, rational_of_fisheye(path, f"line {number}", matrix, lens, width, height)
    return width, height, matrix, lens if count in (0, 4, 8) else np.append(lens, np.zeros(5 - count))


# --- our own files -----------------------------------------------------------------------------------------------------------

def own_cameras(path: Path, content, reading: RigReading) -> list[Camera]:
    """The cameras of a sequence ``cameras`` of maps name, width, height, K, dist, R, t."""
    found = content.get("cameras") if isinstance(content, dict) else None
    if not isinstance(found, list) or not found:
        raise InputError(path, "cameras", "missing or empty", "give a sequence of name, width, height, K, dist, R, t")
    return [_camera(path, entries, index, reading) for index, entries in enumerate(found)]


def _camera(path: Path, entries, index: int, reading: RigReading) -> Camera:
    if not isinstance(entries, dict):
        raise InputError(path, f"cameras[{index}]", "is no map", "give name, width, height, K, dist, R, t")
    name = entries.get("name") if isinstance(entries.get("name"), str) else f"cam{index}"
    for key in ("width", "height"):
        if type(entries.get(key)) is not int:
            raise InputError(path, f"cameras.{name}.{key}", "missing or no whole number", "give the images' size in pixels")
    for key in KEYS.values():
        if not isinstance(entries.get(key), np.ndarray):
            raise InputError(path, f"cameras.{name}.{key}", "missing or no matrix",
                             "give K (3, 3), dist (1, 5), R (3, 3), t (3, 1)")
    values = {"width": entries["width"], "height": entries["height"], **{field: entries[key] for field, key in KEYS.items()}}
    if reading.lens == "fisheye":
        plain = Camera(name=name, **{**values, "distortion": np.zeros(5)}, source=str(path))
        values["distortion"] = rational_of_fisheye(path, f"cameras.{name}.dist", plain.matrix, values["distortion"],
                                                   plain.width, plain.height)
    return Camera(name=name, **values, source=str(path), turned=entries.get("orientation") == "apply")


# --- fisheye lenses ------------------------------------------------------------------------------------------------------

WIDEST_TANGENT = 10.0  # r of the farthest ray that cameras see: 84° off the axis
MOST_ERROR_PX = 1.0
SAMPLES, ROUNDS = 400, 10


def rational_of_fisheye(source: str, field: str, matrix: np.ndarray, coefficients: np.ndarray, width: int,
                        height: int) -> np.ndarray:
    """(8,) k1, k2, p1, p2, k3, k4, k5, k6 of the rational model for a fisheye lens with up to four ``coefficients``.

    Raises InputError, naming ``source`` and ``field``, for another number of them, and where the rational model is farther off
    than a pixel within the image and 84° of the axis.
    """
    given = np.asarray(coefficients, dtype=np.float64).ravel()
    if given.size > 4 or not np.isfinite(given).all():
        raise InputError(source, field, f"{given.size} coefficients of a fisheye lens", "give k1, k2, k3, k4")
    focal, centre = matrix[[0, 1], [0, 1]], matrix[:2, 2]
    farthest = np.linalg.norm(np.maximum(np.abs(centre), np.abs([width - 1, height - 1] - centre)) / focal)
    tangent = np.linspace(0, 1, SAMPLES + 1)[1:] ** 2 * WIDEST_TANGENT
    image = _at(np.arctan(tangent), given)
    falling = np.flatnonzero(np.diff(image, prepend=0) <= 0)
    outside = np.flatnonzero(image > farthest)
    end = min(np.concatenate([falling, outside + 1, [SAMPLES]]))
    angle = np.linspace(0, 1, SAMPLES + 1)[1:] * np.arctan(tangent[max(end, 2) - 1])
    tangent = np.tan(angle)
    wanted, reach = _at(angle, given) / tangent, tangent[-1] ** 2
    powers = (tangent[:, None] ** 2 / reach) ** np.arange(1, 4)
    below = 1.0
    for _ in range(ROUNDS):  # of the linear problem A − w B = 0, over the B of the round before and by the pixels of an error
        weight = tangent / below
        system = np.concatenate([powers, -wanted[:, None] * powers], axis=1) * np.reshape(weight, (-1, 1))
        found = np.linalg.lstsq(system, weight * (wanted - 1), rcond=None)[0]
        below = 1 + powers @ found[3:]
    error = np.abs((1 + powers @ found[:3]) / below - wanted) * tangent * focal.max()
    if not (below > 0).all() or not error.max() <= MOST_ERROR_PX:
        raise InputError(source, field, f"a fisheye lens that the rational model misses by {error.max():.2g} px",
                         "undistort the images, and give the rig of those")
    above, below = found[:3] / reach ** np.arange(1, 4), found[3:] / reach ** np.arange(1, 4)
    return np.array([above[0], above[1], 0.0, 0.0, above[2], *below])


def _at(angle: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    square = angle * angle
    return angle * (1 + sum(value * square ** (power + 1) for power, value in enumerate(coefficients)))
