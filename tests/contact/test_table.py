"""A heavy rod that hangs from a horizontal clamp onto a table, against the heavy elastica."""

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve

from doo_ti import Material, Plane, end_clamps, relax, straight_rod

BEND, LENGTH, RADIUS, HEIGHT = 4e4, 200.0, 1.0, 25.0
WEIGHT = 2.0  # per mm, of a material of weight 1


def elastica() -> tuple[float, float, object]:
    """(free length, reaction at lift-off, shape of (arc length from lift-off) -> (x, z)) of the heavy elastica.

    B θ'' = (R − w s) cos θ between lift-off, where θ and the moment B θ' are zero, and the clamp, where θ is zero again.
    """
    def shape(length, reaction):
        def slope(s, y):
            return [y[1], (reaction - WEIGHT * s) / BEND * np.cos(y[0]), np.cos(y[0]), np.sin(y[0])]
        return solve_ivp(slope, (0.0, length), [0.0] * 4, rtol=1e-11, atol=1e-11, dense_output=True)

    def miss(unknowns):
        end = shape(*unknowns).y[:, -1]
        return [end[0] * 100.0, end[3] - (HEIGHT - RADIUS)]

    first = (72.0 * BEND * (HEIGHT - RADIUS) / WEIGHT) ** 0.25
    length, reaction = fsolve(miss, [first, WEIGHT * first / 3.0], xtol=1e-12)
    return length, reaction, shape(length, reaction).sol


def on_table(edges: int):
    """The rod of so many edges, and its contact forces."""
    start = straight_rod(LENGTH, edges, (0.0, 0.0, HEIGHT))
    table = Plane((0, 0, 0), (0, 0, 1))
    solution = relax(start, Material(BEND, BEND), end_clamps(start), obstacles=[table], radius=RADIUS)
    assert solution.converged.all() and solution.stable.all()
    return solution.configuration.vertices[0], solution.tables.contact.forces[0]


def errors(edges: int) -> tuple[float, float]:
    """(relative error of the free length, largest error of the height over the clamp's) with so many edges."""
    x, forces = on_table(edges)
    held = LENGTH / edges / 2  # the clamp of a discrete rod is the middle of the edge that it holds
    free, reaction, shape = elastica()
    # The length that lies, and the reaction at its start, from the sum of the forces and their moment about the free end.
    arc = np.linspace(0.0, LENGTH, edges + 1)
    whole, moment = forces[:, 2].sum(), (forces[:, 2] * (LENGTH - arc)).sum()
    lying = (whole - np.sqrt(whole**2 - 2.0 * WEIGHT * moment)) / WEIGHT
    found = LENGTH - held - lying
    s = (free + held) - arc
    exact = np.where(s > 0, shape(np.clip(s, 0, free))[3], 0.0) + RADIUS
    inside = arc > held
    return found / free - 1.0, np.abs(x[:, 2] - exact)[inside].max() / HEIGHT


def test_lift_off_and_shape_of_a_heavy_rod_on_a_table():
    coarse, fine = errors(40), errors(80)
    assert abs(fine[0]) < 2e-3 and fine[1] < 2e-3
    assert coarse[1] / fine[1] > 3.5, "second order in the length of an edge"
