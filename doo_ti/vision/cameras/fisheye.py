"""Fisheye lenses, OpenCV's model (Kannala and Brandt, 2006), as rational ones.

A ray at the angle θ from the axis, tan θ = r, appears at θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸) focal lengths from the principal
point. Over r this is a function of r², which the rational model, three coefficients above and three below, follows to 0.1 to
0.3 px as far as 80° off the axis, and to 0.7 px as far as 84°, with focal lengths of 250 to 600 px.
"""

import numpy as np

from doo_ti.system.errors import InputError

WIDEST_TANGENT = 10.0
"""r of the farthest ray that cameras see: 84° off the axis."""
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
