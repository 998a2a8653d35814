"""The account of energies: against F's energy, and balanced to the order of the scheme under every clamp and every loss."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from doo_ti import Clamp, Dynamics, Grippers, Material, Springs, Stepping, Touch, relax, simulate
from doo_ti.dynamics.scene import load_motion_scene
from doo_ti.rod.frames import vertices_from_quaternions
from tests.dynamics.motions import resting
from tests.references.rods import clamps_at
from tests.relaxation.rods import wandering

SCENES = Path(__file__).parents[2] / "scenes" / "motion"
RATE, INSTANTS = 100.0, 21
CURVED = Material(np.diag([2e5, 3e5])[None], 1e5, 1.0, np.array([[0.003, -0.002]]))
LOSSES = Dynamics(drag=2.0, quadratic_drag=1e-3, bend_damping=0.01, twist_damping=0.02, point_mass=3.0)


def shaken(rods, start: Clamp, end: Clamp) -> Grippers:
    """Grippers that rest for two instants, and then move and turn smoothly."""
    still = resting(rods, start, end, INSTANTS)
    swing = 1.0 - np.cos(4.0 * np.pi * np.maximum(np.arange(INSTANTS) - 2, 0) / RATE)
    turn = Rotation.from_rotvec(np.outer(swing, [0.1, 0.05, -0.05])).as_matrix()
    way = np.outer(swing, [0.0, 5.0, 8.0])
    nearer = 0.05 * swing[:, None] * (still.start_position - still.end_position)
    return Grippers(still.start, still.end, still.start_position + 0.3 * way, still.end_position + 0.2 * way + nearer,
                    np.swapaxes(turn, 1, 2) @ still.start_frame, turn @ still.end_frame)


def at_rest(rng, material: Material, start: Clamp, end: Clamp, count: int = 3):
    rods = wandering(rng, count, 8, 12.0, wander=0.2, twist=0.1)
    return relax(rods, material, clamps_at(rods, start, end)).configuration


@pytest.mark.sampled(1)
@pytest.mark.parametrize("scheme, order", [("bdf2", 1.8), ("euler", 0.8)])
@pytest.mark.parametrize("start, end", [(Clamp.FRAME, Clamp.FRAME), (Clamp.FRAME, Clamp.FREE), (Clamp.FREE, Clamp.TANGENT),
                                        (Clamp.TANGENT, Clamp.POSITION), (Clamp.POSITION, Clamp.FRAME)])
def test_energy_losses_and_work_balance(rng, start, end, scheme, order):
    """Rods with every loss and rest curvature, whose grippers move: what is unaccounted for is of the scheme's order in h."""
    rods = at_rest(rng, CURVED, start, end)
    left = []
    for substeps in (6, 12):
        stepping = Stepping(RATE, substeps, scheme, detailed=True)
        found = simulate(rods, CURVED, shaken(rods, start, end), LOSSES, stepping)
        fine = found.detail.energies
        assert found.converged.all()
        left.append(np.abs(fine["unaccounted"]).max(axis=1) / np.abs(fine["work"]).max(axis=1))
    assert (np.log2(left[0] / left[1]) > order).all() and left[1].max() < (1e-3 if scheme == "bdf2" else 0.05)
    for name in ("drag", "bend_damping", "twist_damping"):
        assert (fine[name][:, -1] > 0).all() and (np.diff(fine[name], axis=1) >= 0).all()


def test_what_is_stored_is_the_energy_of_relaxed_rods(rng):
    """Elastic energy and weight at rest are F's energy; springs are counted apart."""
    rods = wandering(rng, 3, 8, 12.0, wander=0.3, twist=0.4)
    clamps = clamps_at(rods, Clamp.FRAME, Clamp.FRAME)
    solution = relax(rods, CURVED, clamps)
    rest = solution.configuration
    springs = Springs(rest.vertices[:1] + 1.0, np.full((1, 9), 0.2))
    found = simulate(rest, CURVED, Grippers.resting(clamps, 2), Dynamics(), Stepping(RATE, detailed=True), springs=springs)
    stored = {name: value[:, 0] for name, value in found.detail.energies.items()}
    height = rest.vertices[..., 2] @ np.array([6.0, *[12.0] * 7, 6.0]) * 2.0
    np.testing.assert_allclose(stored["bending"] + stored["twist"], solution.energy - height, rtol=1e-9)
    expected = 0.1 * ((rest.vertices - springs.points) ** 2).sum(axis=(1, 2))
    np.testing.assert_allclose(stored["springs"], expected, rtol=1e-9)
    assert (stored["kinetic"] == 0).all() and (stored["gravity"] == 0).all()


def test_a_detailed_motion_is_the_same_motion(rng):
    rods = at_rest(rng, CURVED, Clamp.FRAME, Clamp.POSITION)
    grippers = shaken(rods, Clamp.FRAME, Clamp.POSITION)
    grippers.end_position[2, 12:] += 1e3
    plain = simulate(rods, CURVED, grippers, LOSSES, Stepping(RATE, 3))
    found = simulate(rods, CURVED, grippers, LOSSES, Stepping(RATE, 3, detailed=True))
    for name in ("positions", "status", "iterations", "residual", "end_force"):
        np.testing.assert_array_equal(getattr(found, name), getattr(plain, name))
    np.testing.assert_array_equal(found.converged, [True, True, False])
    for value in (found.detail.quaternions[..., 0, 0], found.detail.velocities[..., 0, 0], *found.detail.energies.values()):
        np.testing.assert_array_equal(np.isfinite(value[:, 1:]), found.status == 0)
    frames = found.detail.quaternions[:2, 1:].reshape(-1, rods.edges, 4)
    vertices = vertices_from_quaternions(found.positions[:2, :, 0].reshape(-1, 3), frames, rods.rest_length[0])
    np.testing.assert_allclose(vertices, found.positions[:2].reshape(-1, rods.edges + 1, 3), atol=1e-9)


@pytest.mark.parametrize("scene, frames, share", [
    pytest.param("rope_over_peg", 40, 5e-3, marks=pytest.mark.thorough),
    pytest.param("overhand_knot", 8, 0.05, marks=pytest.mark.slow)])
def test_energies_balance_where_rods_slide_over_obstacles_and_themselves(scene, frames, share):
    """The work of friction, which the kernels sum up, is what stored energy and the grippers' work leave for contact."""
    told = load_motion_scene(SCENES / f"{scene}.toml")
    grippers = told.grippers.until(frames)
    touched, undamped = told.surroundings().arguments, replace(told.dynamics, bend_damping=0.0, twist_damping=0.0)
    rest = relax(told.start, told.material, grippers.at(0), **touched).configuration
    found = simulate(rest, told.material, grippers, undamped, replace(told.stepping, detailed=True), **touched)
    assert found.converged.all()
    energies = {name: value[0, -1] for name, value in found.detail.energies.items()}
    assert (found.touch[:, -1] == Touch.SLIPS).any()
    assert energies["work"] > 0 and energies["contact"] > 0.3 * energies["work"]
    assert abs(energies["unaccounted"]) < share * energies["work"]
    assert abs(energies["contact"] - found.friction_work[0, -1]) < 0.05 * energies["contact"]
