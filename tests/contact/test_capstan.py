"""A limp rope that is pulled over a cylinder with friction: the tensions at its ends are e^(μ φ) apart."""

import numpy as np
import pytest

from doo_ti.contact.obstacles import Cylinder
from doo_ti.dynamics.grippers import Grippers
from doo_ti.dynamics.parameters import Dynamics, Stepping
from doo_ti.dynamics.simulate import simulate
from doo_ti.frames import bishop_frames, across, quaternion_from_matrix
from doo_ti.types import Clamp, Configuration, Material

ROPE, DRUM, STRAIGHT = 0.2, 20.0, 30.0
DRAWN, STEPS = 2.0, 20


def wound(angle: float, edges: int, pitch: float) -> np.ndarray:
    """(V, 3) a rope that comes straight, follows a helix on the drum through that angle and leaves straight."""
    r = DRUM + ROPE
    wrapped = np.hypot(r * angle, pitch * angle)
    total = 2 * STRAIGHT + wrapped
    s = np.linspace(-STRAIGHT, wrapped + STRAIGHT, 40 * edges + 1)
    turn = np.clip(s / wrapped, 0.0, 1.0) * angle
    beyond = s - np.clip(s, 0.0, wrapped)
    along = np.stack([-np.sin(turn) * r, np.cos(turn) * r, np.full_like(turn, pitch)], -1)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    x = np.stack([r * np.cos(turn), r * np.sin(turn), pitch * turn], -1) + beyond[:, None] * along
    # Chords of equal length, a trace outside the drum.
    x[:, :2] *= 1.0 + 1.5 * (total / edges) ** 2 / (8 * r**2)
    arc = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(x, axis=0), axis=1)))
    return np.stack([np.interp(np.linspace(0, arc[-1], edges + 1), arc, x[:, k]) for k in range(3)], -1)


def tensions(angle: float, friction: float, edges: int) -> tuple[float, float]:
    """(of the end that is drawn, of the end that follows), at the end of the motion."""
    x = wound(angle, edges, 0.4)
    step = np.diff(x, axis=0)
    tangents = step / np.linalg.norm(step, axis=1, keepdims=True)
    rod = Configuration(x[:1], quaternion_from_matrix(bishop_frames(tangents[None], across(tangents[None, 0]))),
                        np.linalg.norm(step, axis=1))
    share = np.linspace(0.0, 1.0, STEPS + 1)[:, None]
    # The start gives way a little less than the end draws, so that the rope stays taut.
    start = x[0] + 0.995 * DRAWN * share * tangents[0]
    end = x[-1] + DRAWN * share * tangents[-1]
    frame = np.broadcast_to(np.eye(3), (1, STEPS + 1, 3, 3)).copy()
    grippers = Grippers(Clamp.POSITION, Clamp.POSITION, start[None], end[None], frame, frame)
    material = Material(50.0, 50.0, weight=1e-6)
    moved = simulate(rod, material, grippers, Dynamics(), Stepping(rate=10.0, quasi_static=True),
                     obstacles=[Cylinder((0, 0, -80), (0, 0, 80), DRUM, friction=friction)], radius=ROPE)
    assert moved.converged.all(), moved.status[0]
    drawn = moved.end_force[0, -1]
    held = -(drawn + moved.contact_force[0, -1].sum(axis=0))
    return np.linalg.norm(drawn), np.linalg.norm(held)


if __name__ == "__main__":
    for degrees in (90, 180, 360):
        for friction in (0.1, 0.3, 0.5):
            a, b = tensions(np.deg2rad(degrees), friction, max(40, degrees // 3))
            print(degrees, friction, a, b, "ratio over e^(mu phi)", a / b / np.exp(friction * np.deg2rad(degrees)), flush=True)
