"""Derivatives of motions by what rods are made of, against central differences of whole motions."""

import numpy as np
import pytest

from doo_ti.dynamics import simulate as simulation
from doo_ti.dynamics.grippers import Grippers
from doo_ti.dynamics.parameters import Direction, Dynamics
from doo_ti.dynamics.simulate import simulate
from doo_ti.frames import bishop_frames, matrix_from_quaternion, quaternion_about, quaternion_from_matrix
from doo_ti.relaxation.newton import Newton
from doo_ti.types import Clamp, Configuration, Material

EDGES, STEPS, RATE = 7, 30, 100.0
LENGTHS = np.linspace(38.0, 46.0, EDGES)
NAMES = ("bend", "twist", "rest", "weight", "bend_damping", "twist_damping", "drag", "quadratic_drag", "point_mass")
SIZES = (1.0, 1.0, 1.0, 1.0, 0.01, 0.01, 1.0, 1e-4, 1.0)
POINT = np.array([3e6, 2e6, 1.0, 1.1, 0.03, 0.02, 0.4, 3e-4, 4.0])
SMALL = np.array([3e2, 2e2, 1e-4, 1e-4, 1e-5, 1e-5, 1e-4, 1e-7, 1e-3])


@pytest.fixture(autouse=True)
def tight(monkeypatch):
    """Steps converged as far as f64 goes: differences between motions are small."""
    monkeypatch.setattr(simulation, "_newton", lambda: Newton(tolerance=1e-11, first_shift=0.0, max_escapes=0))


def rod(numbers):
    """(material, dynamics) of the numbers that NAMES name."""
    value = dict(zip(NAMES, numbers, strict=True))
    along = np.linspace(-1.0, 1.0, EDGES - 1)
    rest = value["rest"] * 1e-3 * np.stack([1.0 + along, 2.0 * along**2 - 0.5], axis=-1)
    mass = value["point_mass"] * np.linspace(1.0, 2.0, EDGES + 1)[None]
    return (Material(np.array([value["bend"]]), np.array([value["twist"]]), np.array([value["weight"]]), rest[None]),
            Dynamics(bend_damping=value["bend_damping"], twist_damping=value["twist_damping"], drag=value["drag"],
                     quadratic_drag=value["quadratic_drag"], point_mass=mass))


def bow(rods: int):
    """(start configurations, (S, V, 3) vertices): arches of different heights."""
    place = (np.arange(EDGES) + 0.5) / EDGES
    height = 0.7 + 0.2 * np.arange(rods)[:, None]
    slope = height * np.cos(np.pi * place)
    t = np.stack([np.cos(slope) * np.cos(0.3 * place), np.cos(slope) * np.sin(0.3 * place), np.sin(slope)], axis=-1)
    vertices = np.concatenate([np.zeros((rods, 1, 3)), np.cumsum(t * LENGTHS[:, None], axis=1)], axis=1)
    frames = quaternion_from_matrix(bishop_frames(t, np.broadcast_to([0.0, 1.0, 0.0], (rods, 3))))
    return Configuration(vertices[:, 0].copy(), frames, LENGTHS), vertices


def moving(configuration, vertices, start: Clamp, end: Clamp) -> Grippers:
    """Grippers that swing and turn."""
    time = np.arange(STEPS + 1)[:, None] / RATE
    swing = np.concatenate([30 * np.sin(9 * time), 20 * np.sin(7 * time), 25 * (1 - np.cos(8 * time))], axis=-1)
    turn = matrix_from_quaternion(quaternion_about(np.broadcast_to([0.6, 0.0, 0.8], (STEPS + 1, 3)), 0.5 * np.sin(6 * time[:, 0])))
    ends = matrix_from_quaternion(configuration.quaternions[:, [0, -1]])
    first, last = (np.einsum("tij,sjk->stik", turn, ends[:, k]) for k in (0, 1))
    return Grippers(start, end, vertices[:, None, 0] + swing, vertices[:, None, -1] - 0.5 * swing * [1, 1, -1], first, last)


def slopes_and_differences(start: Clamp, end: Clamp, rods: int = 2, **options):
    """(derivatives of the positions by each number, their central differences), both (P, R, F, V, 3)."""
    configuration, vertices = bow(rods)
    grippers = moving(configuration, vertices, start, end)
    velocity = np.zeros_like(vertices)
    ways = np.diag(SMALL)

    def motion(numbers, directions=()):
        found = simulate(configuration, *rod(numbers)[:1], grippers, rod(numbers)[1], RATE, velocity=velocity,
                         directions=directions, **options)
        assert found.converged.all()
        return found

    directions = [Direction(rod(POINT - way), rod(POINT + way), 2.0 * way.max()) for way in ways]
    slopes = np.moveaxis(motion(POINT, directions).slopes, 2, 0)
    differences = np.stack([(motion(POINT + 3 * way).positions - motion(POINT - 3 * way).positions) / (6.0 * way.max())
                            for way in ways])
    return slopes, differences


def worst(slopes, differences):
    """(P,) the largest error of a parameter's derivatives, over the largest of them."""
    return np.abs(slopes - differences).max(axis=(1, 2, 3, 4)) / np.abs(differences).max(axis=(1, 2, 3, 4))


@pytest.mark.parametrize("start, end, options", [
    (Clamp.FRAME, Clamp.TANGENT, {"smooth_start": False}),
    (Clamp.FRAME, Clamp.FRAME, {"smooth_start": False, "scheme": "euler"}),
    (Clamp.FRAME, Clamp.FRAME, {"smooth_start": True, "substeps": 2}),
    (Clamp.TANGENT, Clamp.POSITION, {"smooth_start": True}),
    (Clamp.FRAME, Clamp.FREE, {"smooth_start": False}),
    (Clamp.FREE, Clamp.FRAME, {"smooth_start": True}),
    (Clamp.FREE, Clamp.FREE, {"smooth_start": False}),
])
def test_derivatives_are_those_of_the_motion(start, end, options):
    slopes, differences = slopes_and_differences(start, end, **options)
    assert worst(slopes, differences).max() < 1e-5, worst(slopes, differences)
