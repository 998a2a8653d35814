"""A bowed rope on a table of which one end is pushed: what moves slips, what stays where it is sticks."""

import numpy as np

from doo_ti import Clamp, Configuration, Dynamics, Grippers, Material, Plane, Stepping, Touch, relax, simulate

LENGTH, EDGES, RADIUS, FRAMES, PUSH = 300.0, 40, 1.0, 4, 4.0  # mm


def pushed(coefficient: float):
    """The motion, and its places at every instant."""
    table = [Plane((0, 0, 0), (0, 0, 1), friction=coefficient)]
    rod = Configuration.straight(np.array([0.0, 0.0, RADIUS]), np.array([1.0, 0.0, 0.0]), LENGTH, EDGES)
    frame = np.repeat(rod.frames[:, :1], FRAMES + 1, axis=1)
    start = rod.start[:, None] + np.linspace(0.0, PUSH, FRAMES + 1)[:, None] * [1.0, 0.0, 0.0]
    end = np.repeat(rod.vertices[:, -1:] - [[[40.0, 0.0, 0.0]]], FRAMES + 1, axis=1)
    grippers = Grippers(Clamp.POSITION, Clamp.POSITION, start, end, frame, frame)
    material = Material(2e4, 2e4, 2.0)
    # Bowed along the table before it lies on it.
    rest = relax(rod, material, grippers.at(0), up=(0.0, 1.0, 0.0)).configuration
    rest = relax(rest, material, grippers.at(0), obstacles=table, radius=RADIUS)
    found = simulate(rest.configuration, material, grippers, Dynamics(), Stepping(1.0, quasi_static=True), obstacles=table,
                     radius=RADIUS)
    assert rest.converged.all() and found.converged.all()
    return found, np.concatenate([rest.configuration.vertices[:, None], found.positions], axis=1)


def test_what_moves_slips_and_what_stays_sticks():
    found, places = pushed(0.4)
    moved, touch = np.linalg.norm(np.diff(places, axis=1), axis=-1)[0], found.touch[0]
    print(f"stick {(touch == Touch.STICKS).sum(axis=1)}, slip {(touch == Touch.SLIPS).sum(axis=1)}; moved {moved[-1]}")
    assert (touch[-1] == Touch.STICKS).any() and (touch[-1] == Touch.SLIPS).any()
    assert (moved[touch == Touch.STICKS] < 1e-2).all()
    assert (touch[(moved > 0.1) & (touch != Touch.NONE)] == Touch.SLIPS).all()
    assert found.friction_work[0, -1] > 0


def test_with_hardly_any_friction_all_that_moves_slips():
    """The whole bow moves, but for its far end."""
    found, places = pushed(1e-5)
    moved, touch = np.linalg.norm(np.diff(places, axis=1), axis=-1)[0], found.touch[0]
    print(f"stick {(touch == Touch.STICKS).sum(axis=1)}, slip {(touch == Touch.SLIPS).sum(axis=1)}; moved {moved[-1]}")
    assert (moved[:, :-1] > 0.05).all() and (touch[:, :-1] != Touch.STICKS).all()
