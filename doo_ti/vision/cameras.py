"""Calibrated cameras, rigs of them, and how a file of cameras is meant (§V-A).

A camera is x_cam = R x_world + t, then a lens with radial and tangential distortion, then K. A point y in the camera's axes has
the normalised image (X, Y) = (y1, y2)/y3, which the lens bends to b(X, Y), Brown's model (1971) with OpenCV's five
coefficients, or eight with those of its rational model,

    b = (X, Y) R(r²) + (2 p1 X Y + p2 (r² + 2 X²), p1 (r² + 2 Y²) + 2 p2 X Y),    r² = X² + Y²,
    R(s) = (1 + k1 s + k2 s² + k3 s³) / (1 + k4 s + k5 s² + k6 s³).

The Jacobian of b is symmetric, and so are its second and third derivatives in all indices: all are derivatives of one
potential. A ``lens`` is fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6, and possibly more. The functions use arithmetic only,
so that they serve arrays as well as kernels (:mod:`doo_ti.vision.sampling`); ``kept`` makes a kernel evaluate a number once.

Millimetres in the world, pixels in images, pixel (0, 0) at the centre of the upper left one. Axes: C cameras of a rig.
"""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from doo_ti.rod.frames import is_rotation
from doo_ti.rod.material import UNITS_IN_MM
from doo_ti.system.arguments import typed
from doo_ti.system.errors import InputError, real_array

COEFFICIENTS = 5  # coefficients of distortion: k1, k2, p1, p2, k3
RATIONAL = 8  # coefficients with those of the rational model: k4, k5, k6 as well
FITTED, LENS = 4 + COEFFICIENTS, 4 + RATIONAL  # numbers of a lens: those that calibration fits, and all
MOST_SIDE = 20_000  # pixels along a side of an image
LEAST_FOCAL_PX, MOST_PX = 1.0, 1e6  # least focal length, and largest focal length and offset of the principal point
MOST_DISTORTION, MOST_MM = 1e6, 1e6  # largest coefficient, and place of a camera
KEYS = {"matrix": "K", "distortion": "dist", "rotation": "R", "translation": "t"}  # how files name a camera's arrays


def _unchanged(value):
    return value


def _radial(lens, square, order: int, kept) -> tuple:
    """R and its derivatives up to this order at ``square``."""
    k1, k2, _, _, k3, k4, k5, k6 = lens[4:LENS]
    below = kept(1.0 / (1.0 + square * (k4 + square * (k5 + square * k6))))
    found = [kept((1.0 + square * (k1 + square * (k2 + square * k3))) * below)]
    if order:
        slope = kept(k4 + square * (2.0 * k5 + square * (3.0 * k6)))
        found.append(kept((k1 + square * (2.0 * k2 + square * (3.0 * k3)) - found[0] * slope) * below))
    if order > 1:
        bend = kept(2.0 * k5 + 6.0 * k6 * square)
        found.append(kept((2.0 * k2 + 6.0 * k3 * square - 2.0 * found[1] * slope - found[0] * bend) * below))
    if order > 2:
        found.append(kept((6.0 * k3 - 3.0 * found[2] * slope - 3.0 * found[1] * bend - 6.0 * found[0] * k6) * below))
    return tuple(found)


def bent(lens, x, y, kept=_unchanged):
    """The pixel (u, v) of (X, Y): b, times the focal lengths, from the principal point."""
    fx, fy, cx, cy, _, _, p1, p2 = lens[:8]
    square = kept(x * x + y * y)
    radial, = _radial(lens, square, 0, kept)
    u = x * radial + 2.0 * p1 * x * y + p2 * (square + 2.0 * x * x)
    v = y * radial + p1 * (square + 2.0 * y * y) + 2.0 * p2 * x * y
    return (fx * u + cx, fy * v + cy)


def bent_slope(lens, x, y, kept=_unchanged):
    """First derivatives of b: (11, 12, 22)."""
    p1, p2 = lens[6:8]
    radial, slope = _radial(lens, kept(x * x + y * y), 1, kept)
    growth = kept(2.0 * slope)
    return (
        radial + growth * x * x + 2.0 * p1 * y + 6.0 * p2 * x,
        growth * x * y + 2.0 * p1 * x + 2.0 * p2 * y,
        radial + growth * y * y + 6.0 * p1 * y + 2.0 * p2 * x,
    )


def bent_curvature(lens, x, y, kept=_unchanged):
    """Second derivatives of b: (111, 112, 122, 222), the same in all orders."""
    p1, p2 = lens[6:8]
    _, slope, bend = _radial(lens, kept(x * x + y * y), 2, kept)
    growth, more = kept(2.0 * slope), kept(4.0 * bend)
    return (
        3.0 * growth * x + more * x * x * x + 6.0 * p2,
        growth * y + more * x * x * y + 2.0 * p1,
        growth * x + more * x * y * y + 2.0 * p2,
        3.0 * growth * y + more * y * y * y + 6.0 * p1,
    )


def bent_third(lens, x, y, kept=_unchanged):
    """Third derivatives of b: (1111, 1112, 1122, 1222, 2222), the same in all orders."""
    square = kept(x * x + y * y)
    _, first, second, third = _radial(lens, square, 3, kept)
    third = kept(8.0 * third)
    a, b, c = kept(x * x), kept(x * y), kept(y * y)
    return (
        6.0 * first + 24.0 * second * a + third * a * a,
        b * (12.0 * second + third * a),
        2.0 * first + 4.0 * second * square + third * b * b,
        b * (12.0 * second + third * c),
        6.0 * first + 24.0 * second * c + third * c * c,
    )


@typed
@dataclass(frozen=True)
class Camera:
    """One calibrated camera.

    matrix       (3, 3) K, px: focal lengths and principal point, without skew
    distortion   (5,) k1, k2, p1, p2, k3, or (8,) with k4, k5, k6
    rotation     (3, 3) R from world to camera, x right, y down, z forward
    translation  (3,) t, mm
    turned       its images are turned as their files' orientation tags say; else they are taken as the sensor has them

    Raises InputError for sizes that are not positive, shapes that do not match, an R that is no rotation, and numbers beyond
    the bounds stated above.
    """

    name: str
    width: int
    height: int
    matrix: np.ndarray
    distortion: np.ndarray
    rotation: np.ndarray
    translation: np.ndarray
    source: str = "rig"
    turned: bool = False

    def __post_init__(self) -> None:
        for name, shape in (("matrix", (3, 3)), ("distortion", None), ("rotation", (3, 3)), ("translation", (3,))):
            value = np.array(real_array(self.source, f"cameras.{self.name}.{KEYS[name]}", getattr(self, name), "give numbers"),
                             dtype=np.float64)
            value = value if name in ("matrix", "rotation") else value.reshape(-1)
            if name == "distortion" and value.size in (0, 4):
                value = np.concatenate([value, np.zeros(COEFFICIENTS - value.size)])
            if name == "distortion" and value.size > RATIONAL and not value[RATIONAL:].any():
                value = value[:RATIONAL]
            shapes = [shape] if shape else [(COEFFICIENTS,), (RATIONAL,)]
            if value.shape not in shapes or not np.isfinite(value).all():
                wanted = f"give {shape or '(1, 5) or (1, 8)'} numbers"
                raise self._error(KEYS[name], f"shape {value.shape}, or not finite", wanted)
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        if not (1 <= self.width <= MOST_SIDE and 1 <= self.height <= MOST_SIDE):
            raise self._error("width, height", f"{self.width} x {self.height}",
                              f"give the size of the images in pixels, at most {MOST_SIDE:,} a side")
        (fx, skew, _), (lower, fy, _), last = self.matrix
        if not (fx > 0 and fy > 0) or skew != 0 or lower != 0 or (last != [0, 0, 1]).any():
            raise self._error("K", f"{self.matrix.tolist()}", "give [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] with fx, fy > 0")
        for name, value, most in (("K", self.matrix[:2], MOST_PX), ("dist", self.distortion, MOST_DISTORTION),
                                  ("t", self.translation, MOST_MM)):
            if (np.abs(value) > most).any():
                raise self._error(name, f"{value[np.abs(value) > most][0]:g}", f"give numbers up to {most:,.0f}")
        if min(fx, fy) < LEAST_FOCAL_PX:
            raise self._error("K", f"a focal length of {min(fx, fy):g} px", f"give {LEAST_FOCAL_PX:g} px or more")
        if not is_rotation(self.rotation):
            raise self._error("R", f"{np.round(self.rotation, 4).tolist()} is no rotation", "give a right-handed rotation")

    def _error(self, field: str, problem: str, remedy: str) -> InputError:
        return InputError(self.source, f"cameras.{self.name}.{field}", problem, remedy)

    @property
    def lens(self) -> np.ndarray:
        """(12,) fx, fy, cx, cy and the distortion."""
        more = np.zeros(RATIONAL - self.distortion.size)
        return np.concatenate([self.matrix[[0, 1, 0, 1], [0, 1, 2, 2]], self.distortion, more])

    @property
    def centre(self) -> np.ndarray:
        """(3,) mm: where the camera is in the world."""
        return -self.rotation.T @ self.translation

    @typed
    def project(self, points: np.ndarray) -> np.ndarray:
        """(..., 2) px of (..., 3) points in the world, distorted as the lens does; NaN for points that are not in front."""
        seen = self._in_front(points)
        return np.stack(bent(self.lens, seen[..., 0] / seen[..., 2], seen[..., 1] / seen[..., 2]), axis=-1)

    def project_with_jacobian(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(..., 2) px as :meth:`project`, (..., 2, 3) px per mm that the points move along the **camera's** axes, and
        (..., 2, 9) px by the lens. By a move in the world the first derivative is times ``rotation``."""
        import cv2

        seen, none, shape = self._in_front(points), np.zeros(3), np.shape(points)[:-1]
        pixel, slopes = np.zeros((0, 2)), np.zeros((0, 6 + FITTED))
        if seen.size:  # slopes by a pose first, of which the last three are those by the points
            pixel, slopes = cv2.projectPoints(seen.reshape(-1, 3), none, none, np.array(self.matrix), np.array(self.distortion))
        by_point, by_lens = np.split(slopes.reshape(*shape, 2, slopes.shape[1])[..., 3 : 6 + FITTED], [3], axis=-1)
        return pixel.reshape(*shape, 2), by_point, by_lens

    def _in_front(self, points: np.ndarray) -> np.ndarray:
        """(..., 3) points in the camera's axes; NaN for those that are not in front."""
        seen = np.asarray(points, dtype=np.float64) @ self.rotation.T + self.translation
        return np.where(seen[..., 2:] > 0, seen, np.nan)

    def depth(self, points: np.ndarray) -> np.ndarray:
        """(...) mm along the optical axis of (..., 3) points in the world."""
        return np.asarray(points, dtype=np.float64) @ self.rotation[2] + self.translation[2]

    def sees(self, points: np.ndarray) -> np.ndarray:
        """(...) bool: (..., 3) points in the world are in front, and in the image."""
        pixel = self.project(points)
        return ((pixel > -0.5) & (pixel < [self.width - 0.5, self.height - 0.5])).all(axis=-1)


# --- how a file is meant ---------------------------------------------------------------------------------------------------

_TO_OPENGL = np.diag([1.0, -1.0, -1.0])  # OpenGL's cameras have y up and z backwards
POSES = {
    "opencv": lambda turn, shift: (turn, shift),
    "opengl": lambda turn, shift: (_TO_OPENGL @ turn, _TO_OPENGL @ shift),
    "opencv-to-world": lambda turn, shift: (turn.T, -turn.T @ shift),
    "opengl-to-world": lambda turn, shift: (_TO_OPENGL @ turn.T, -_TO_OPENGL @ turn.T @ shift),
    "opencv-centre": lambda turn, shift: (turn, -turn @ shift),
}
"""What R and t of a file mean, and from them x_cam = R x_world + t with z forward: world to camera, camera to world, or R world
to camera and t the camera's centre."""
LENSES = ("opencv", "fisheye")


@typed
@dataclass(frozen=True)
class RigReading:
    """How a file of cameras is meant: what it leaves open. None: as usual, and doubted where cameras then do not see what they
    should: with a wrong reading it is behind them or beside their images.

    unit    of lengths, one of ``doo_ti.rod.material.UNITS_IN_MM``, or how many mm it has; None: mm
    poses   one of POSES; None: "opencv", x_cam = R x_world + t with z forward
    lens    "opencv", or "fisheye": of a stereo file, whose coefficients are k1, k2, k3, k4 of OpenCV's fisheye model
    turned  images are turned as their files' orientation tags say; None: as the rig says, else as the sensor has them
    size    width and height of the images, where the file does not state them

    Raises InputError for other words.
    """

    unit: str | float | None = None
    poses: str | None = None
    lens: str = "opencv"
    turned: bool | None = None
    size: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        for name, known in (("unit", UNITS_IN_MM), ("poses", POSES), ("lens", LENSES)):
            value = getattr(self, name)
            if isinstance(value, str) and value not in known:
                raise InputError("rig", name, f"{value!r} is unknown", f"give {', '.join(known)}")
        if isinstance(self.unit, float) and not 0 < self.unit < np.inf:
            raise InputError("rig", "unit", f"{self.unit}", "give how many mm it has")

    def applied(self, camera: Camera) -> Camera:
        """The camera of a file in our axes and mm."""
        turn, shift = POSES[self.poses or "opencv"](camera.rotation, camera.translation)
        changed = replace(camera, rotation=turn, translation=UNITS_IN_MM.get(self.unit or "mm", self.unit) * shift)
        return changed if self.turned is None else replace(changed, turned=self.turned)


# --- rigs --------------------------------------------------------------------------------------------------------------------

NEAREST_MM = 1.0  # distance of cameras below which lengths are hardly in mm
OTHER_COLUMNS = ("name", "frame", "time_s", "view", "seed_x", "seed_y", "seed_z", "dir_x", "dir_y", "dir_z")
"""Of tables that have a column of images for each camera, named as it is."""


@typed
@dataclass(frozen=True)
class Rig:
    """C cameras that look at one scene, and how their file was read. Raises InputError for names that occur twice, and for no
    camera at all."""

    cameras: tuple[Camera, ...]
    source: str = "rig"
    reading: RigReading = RigReading(unit="mm", poses="opencv")

    def __post_init__(self) -> None:
        if not self.cameras:
            raise InputError(self.source, "cameras", "no camera", "describe at least two")
        check_camera_names(self.source, [camera.name for camera in self.cameras])

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(camera.name for camera in self.cameras)

    def project(self, points: np.ndarray) -> np.ndarray:
        """(C, ..., 2) px of (..., 3) points in the world."""
        return np.stack([camera.project(points) for camera in self.cameras])

    def take(self, numbers: Iterable[int]) -> "Rig":
        """Some of the cameras, in that order."""
        return replace(self, cameras=tuple(self.cameras[number] for number in numbers))

    def only(self, names: Sequence[str]) -> "Rig":
        """The cameras of these names, in that order. Raises InputError for one that is not there."""
        for name in names:
            if name not in self.names:
                raise InputError(self.source, "cameras", f"no camera {name!r}", f"the rig has {', '.join(self.names)}")
        return self.take(map(self.names.index, names))

    def read_otherwise(self) -> Iterator[tuple["Rig", str, str]]:
        """The rigs of other readings of the same file that can be, what they assume, and the option for it: where neither unit
        nor poses were given."""
        if self.reading.unit or self.reading.poses:
            return
        kinds = [kind for kind in POSES if kind != "opencv"]
        readings = [(RigReading(unit="m"), "its lengths are in m", "--rig-unit m")]
        for unit, also, more in ((None, "", ""), ("m", ", in m", " --rig-unit m")):
            readings += [(RigReading(unit, kind), f"its poses are {kind}{also}", f"--rig-poses {kind}{more}") for kind in kinds]
        for reading, assumed, option in readings:
            with suppress(InputError):  # in m a rig of some metres would be one of kilometres
                yield Rig(tuple(reading.applied(camera) for camera in self.cameras), self.source, reading), assumed, option

    def check_sight(self, points: np.ndarray, what: str) -> None:
        """Raise InputError where cameras do not see ``points`` (N, 3), ``what`` for the caller, but would if their file were in
        another unit or had poses of another kind; the message names the option for it."""
        blind = [camera for camera in self.cameras if not camera.sees(points).all()]
        if 2 * len(blind) < len(self.cameras) or not blind:
            return  # a point may be beside a camera's image
        near = np.ptp([camera.centre for camera in self.cameras], axis=0).max() < NEAREST_MM
        for rig, assumed, option in self.read_otherwise():
            if (near or rig.reading.unit is None) and all(camera.sees(points).all() for camera in rig.cameras):
                where = "behind" if (blind[0].depth(points) <= 0).any() else "outside the image of"
                raise InputError(self.source, "cameras", f"{what} is {where} {blind[0].name}, but in every image if {assumed}",
                                 f"give {option}, or correct the seed")


def check_camera_names(source: str, names: list[str]) -> None:
    """Raise InputError for names of cameras that occur twice, are empty, hold a line break, or name another column of tables of
    images."""
    for name in names:
        if names.count(name) > 1:
            raise InputError(source, "cameras", f"the name {name!r} occurs twice", "name them apart")
        if "\n" in name:
            raise InputError(source, "cameras", f"{name!r} holds a line break", "name it in one line, such as cam0")
        if not name or name in OTHER_COLUMNS:
            raise InputError(source, "cameras", f"{name!r} cannot be a camera's name, tables of images have another column of "
                             "that name" if name else "a camera without a name", "name it otherwise, such as cam0")
