"""A calibrated camera: x_cam = R x_world + t, then a lens with radial and tangential distortion, then K (§V-A).

A point y in the camera's axes has the normalised image (X, Y) = (y1, y2)/y3, which the lens bends to b(X, Y), Brown's model
(1971) with OpenCV's five coefficients, or eight with those of its rational model,

    b = (X, Y) R(r²) + (2 p1 X Y + p2 (r² + 2 X²), p1 (r² + 2 Y²) + 2 p2 X Y),    r² = X² + Y²,
    R(s) = (1 + k1 s + k2 s² + k3 s³) / (1 + k4 s + k5 s² + k6 s³).

The Jacobian of b is symmetric, and so are its second and third derivatives in all indices: all are derivatives of one
potential. A ``lens`` is fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6, and possibly more. The functions use arithmetic only,
so that they serve arrays as well as kernels (:mod:`doo_ti.vision.reprojection.sampling`); ``kept`` makes a kernel evaluate a
number once.

Millimetres in the world, pixels in images, pixel (0, 0) at the centre of the upper left one.

Fisheye lenses, OpenCV's model (Kannala and Brandt, 2006), as rational ones.

A ray at the angle θ from the axis, tan θ = r, appears at θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸) focal lengths from the principal
point. Over r this is a function of r², which the rational model, three coefficients above and three below, follows to 0.1 to
0.3 px as far as 80° off the axis, and to 0.7 px as far as 84°, with focal lengths of 250 to 600 px.
"""

from dataclasses import dataclass

import numpy as np

from doo_ti.rod.frames import FRAME_TOLERANCE, handedness, orthonormality_error
from doo_ti.system.arguments import typed
from doo_ti.system.errors import InputError, real_array

COEFFICIENTS = 5  # coefficients of distortion: k1, k2, p1, p2, k3
RATIONAL = 8  # coefficients with those of the rational model: k4, k5, k6 as well
FITTED, LENS = 4 + COEFFICIENTS, 4 + RATIONAL  # numbers of a lens: those that calibration fits, and all
MOST_SIDE = 20_000  # pixels along a side of an image
LEAST_FOCAL_PX, MOST_PX = 1.0, 1e6  # least focal length, and largest focal length and offset of the principal point
MOST_DISTORTION = 1e6
MOST_MM = 1e6  # from the world's origin to a camera
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
        if orthonormality_error(self.rotation) > FRAME_TOLERANCE or handedness(self.rotation) < 0:
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
        x, y, _ = self._normalised(points)
        return np.stack(bent(self.lens, x, y), axis=-1)

    def project_with_jacobian(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(..., 2) px as :meth:`project`, (..., 2, 3) px per mm that the points move along the **camera's** axes, and
        (..., 2, 9) px by the lens. By a move in the world the first derivative is times ``rotation``."""
        x, y, near = self._normalised(points)
        lens = self.lens
        pixel = np.stack(bent(lens, x, y), axis=-1)
        focal = lens[:2]
        by_ray = focal[:, None] * np.stack(bent_slope(lens, x, y), axis=-1)[..., [[0, 1], [1, 2]]]
        ray_by_point = np.zeros((*x.shape, 2, 3))
        ray_by_point[..., 0, 0] = ray_by_point[..., 1, 1] = near
        ray_by_point[..., 0, 2], ray_by_point[..., 1, 2] = -x * near, -y * near
        by_lens, square = np.zeros((*x.shape, 2, FITTED)), x * x + y * y
        below = 1 + square * (lens[9] + square * (lens[10] + square * lens[11]))
        for axis, along in enumerate((x, y)):
            by_lens[..., axis, axis] = (pixel[..., axis] - lens[2 + axis]) / focal[axis]
            by_lens[..., axis, 2 + axis] = 1
            for column, power in ((4, 1), (5, 2), (8, 3)):
                by_lens[..., axis, column] = focal[axis] * along * square**power / below
            by_lens[..., axis, 6 + axis] = focal[axis] * 2 * x * y
            by_lens[..., axis, 7 - axis] = focal[axis] * (square + 2 * along * along)
        return pixel, by_ray @ ray_by_point, by_lens

    def _normalised(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """X, Y and 1/depth of (..., 3) points in the world; NaN for those that are not in front."""
        seen = np.asarray(points, dtype=np.float64) @ self.rotation.T + self.translation
        depth = np.where(seen[..., 2] > 0, seen[..., 2], np.nan)
        return seen[..., 0] / depth, seen[..., 1] / depth, 1 / depth

    def depth(self, points: np.ndarray) -> np.ndarray:
        """(...) mm along the optical axis of (..., 3) points in the world."""
        return np.asarray(points, dtype=np.float64) @ self.rotation[2] + self.translation[2]

    def sees(self, points: np.ndarray) -> np.ndarray:
        """(...) bool: (..., 3) points in the world are in front, and in the image."""
        pixel = self.project(points)
        return ((pixel > -0.5) & (pixel < [self.width - 0.5, self.height - 0.5])).all(axis=-1)


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
