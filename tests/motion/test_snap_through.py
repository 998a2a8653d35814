"""An arch with one clamp tilted until it snaps through, and back: at the angles of beam theory, with hysteresis.

A strip with its ends brought together by d < 1 of its length and one end tilted by α is, shallow, a beam under compression:
w'''' + τ² w'' = 0 with w(0) = w(1) = w'(1) = 0, w'(0) = μ and ∫ w'² = 2, where μ = α/√d. Its branch ends where μ(τ) is largest,
at μ = 1.7818 (Gomez, Moulton, Vella, Nature Physics 13, 2017).
"""

import numpy as np
import pytest

from doo_ti import Clamp, ClampPath, Clamps, Configuration, Material, predict
from doo_ti.rod.frames import quaternion_from_matrix

LENGTH, EDGES, SHORTENING = 100.0, 64, 0.01
EDGE = LENGTH / EDGES
# Stiff against everything but bending about m1, which is across the plane: the arch stays in it.
STRIP = Material.diagonal(1e8, 1e6, 1e8, 0.0)


def fold() -> float:
    """The largest μ on the branch that begins with the arch, from the beam's closed form."""
    return max(tilt(tau) for tau in np.linspace(6.3, 9.0, 400))


def tilt(tau: float) -> float:
    """μ of the beam under τ: its shape for w'(0) = 1, scaled to ∫ w'² = 2."""
    c, s = np.cos(tau), np.sin(tau)
    rows = [[1, 0, 0, 1], [c, s, 1, 1], [0, tau, 1, 0], [-tau * s, tau * c, 1, 0]]
    a, b, slope, _ = np.linalg.solve(rows, [0, 0, 1, 0])
    x = np.linspace(0, 1, 2001)
    w = -a * tau * np.sin(tau * x) + b * tau * np.cos(tau * x) + slope
    return np.sqrt(2 / np.trapezoid(w * w, x))


def frame(angle: float) -> np.ndarray:
    """Tangent in the x-z plane, m1 along y."""
    tangent, across = np.array([np.cos(angle), 0, np.sin(angle)]), np.array([0.0, 1, 0])
    return np.stack([tangent, across, np.cross(tangent, across)], axis=1)


@pytest.fixture(scope="module")
def arch():
    """A hanging arch and its clamps; an edge is clamped at its middle, so that the strip is one edge shorter."""
    slope = -2 * np.sqrt(SHORTENING) * np.sin(2 * np.pi * np.arange(EDGES) / (EDGES - 1))
    frames = np.stack([frame(angle) for angle in slope])
    end = EDGE + (LENGTH - EDGE) * (1 - SHORTENING)
    rod = Configuration(np.zeros((1, 3)), quaternion_from_matrix(frames)[None], np.full(EDGES, EDGE))
    return rod, Clamps(Clamp.FRAME, Clamp.FRAME, np.zeros((1, 3)), np.array([[end, 0, 0]]), frame(0.0)[None], frame(0.0)[None])


def tilted(angles: np.ndarray) -> ClampPath:
    """The near clamp tilted about the middle of its edge."""
    frames = np.stack([frame(angle) for angle in angles])
    positions = [EDGE / 2, 0, 0] - EDGE / 2 * frames[..., 0]
    return ClampPath(np.arange(len(angles), dtype=float), start_position=positions[:, None], start_frame=frames[:, None])


def test_the_closed_form_has_the_known_fold():
    assert fold() == pytest.approx(1.7818, abs=1e-4)


@pytest.mark.thorough
def test_it_snaps_where_theory_says_and_comes_back_elsewhere(arch):
    rod, clamps = arch
    expected = np.degrees(fold() * np.sqrt(SHORTENING))
    up = np.arange(0.0, 12.01, 0.2)
    angles = np.concatenate([up, up[-2::-1], -up[1:]])
    prediction = predict(rod, STRIP, clamps, tilted(np.radians(angles)))
    assert prediction.followed.all()
    jumps = np.flatnonzero(prediction.jumps[:, 0])
    assert len(jumps) == 2
    there, back = (0.5 * (angles[jump] + angles[jump - 1]) for jump in jumps)
    print(f"snaps at {there:.1f}° and back at {back:.1f}°; theory {expected:.2f}°")
    assert there == pytest.approx(expected, rel=0.02) and back == pytest.approx(-expected, rel=0.02)
    middle = prediction.vertices[:, 0, EDGES // 2, 2]
    level = np.flatnonzero(angles == 0)
    # Hysteresis: the clamp is level again, and the arch is on the other side.
    assert middle[level[0]] < -3 and middle[level[1]] > 3


@pytest.mark.thorough
def test_a_coarse_path_jumps_once_too(arch):
    """Two moments, sub-steps of 5°: the jump is detected with any sub-steps."""
    rod, clamps = arch
    prediction = predict(rod, STRIP, clamps, tilted(np.radians([0.0, 12.0])))
    assert prediction.followed.all() and prediction.jumps[:, 0].tolist() == [0, 1]
    short = predict(rod, STRIP, clamps, tilted(np.radians([0.0, 9.5])))
    assert short.jumps.sum() == 0
