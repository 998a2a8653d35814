"""Plane elasticas by shooting, as references for rods that touch obstacles, and rods laid along a trace."""

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve

from doo_ti import Configuration
from doo_ti.rod.frames import across
from tests.references.rods import chain

ANGLE, CURVATURE, X, Z = range(4)


def arc(bend: float, angle: float, curvature: float, force, length: float):
    """The solution (θ, κ, x, z) over arc length from the origin of B θ″ = n_x sin θ − n_z cos θ, ``force`` n = (n_x, n_z) being
    what the part beyond exerts on the part before."""
    def slope(s, y):
        return [y[1], (force[0] * np.sin(y[0]) - force[1] * np.cos(y[0])) / bend, np.cos(y[0]), np.sin(y[0])]
    return solve_ivp(slope, (0.0, length), [angle, curvature, 0.0, 0.0], rtol=1e-11, atol=1e-12, dense_output=True).sol


def solved(miss, first) -> np.ndarray:
    """The zero of ``miss``, found from ``first``."""
    found, _, good, text = fsolve(miss, first, xtol=1e-12, full_output=True)
    assert good == 1 or np.abs(miss(found)).max() < 1e-9, text
    return found


def along(trace: np.ndarray, edges: int, length: float) -> Configuration:
    """A rod of equal edges, without twist, along a trace (N, 3) of about that length."""
    s = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(trace, axis=0), axis=1)))
    x = np.stack([np.interp(np.linspace(0.0, s[-1], edges + 1), s, trace[:, k]) for k in range(3)], -1)
    steps = np.diff(x, axis=0)
    return chain(steps, across(steps[:1])[0], length / edges, x[0])
