"""F(Γ, E_vis, C): rods at minima of their energy and reprojection error, against the oracle's E_vis."""

import numpy as np
import pytest

from doo_ti import Clamp, Configuration, Material, Newton, Reprojection, end_clamps, relax, score
from doo_ti.relaxation.newton import TOLERANCES
from doo_ti.rod import frames
from tests.conftest import check_refused
from tests.oracle.reprojection import edge_error, rod_energy
from tests.vision.scenes import drawn_scene, map_of

EDGES, NU, POINTS = 14, 30.0, 4
ALPHA = 2e5
MATERIAL = Material(ALPHA, ALPHA)


@pytest.fixture(scope="module")
def scene():
    return drawn_scene(8, 5, EDGES)


def starts(rng, rods, count: int, turn: float, edges: int = EDGES):
    """(set of each rod, configurations whose edges are turned off the true ones by ``turn`` rad or so, but the first)."""
    sets = np.arange(count) % len(rods)
    tangents = np.diff(rods[sets], axis=1)[:, :edges] / 3.0
    off = turn * rng.normal(size=tangents.shape)
    off[:, 0] = 0.0
    turned = frames.unit_vectors(tangents + off)
    first = frames.bishop_frames(turned, np.cross(turned[:, 0], [0.3, 0.5, 0.8]))
    return sets, Configuration(rods[sets, 0], frames.quaternion_from_matrix(first), np.full(edges, 3.0))


def relaxed(scene, sets: np.ndarray, start: Configuration, nu: float = NU, kind=Clamp.TANGENT, solver=Newton(), **options):
    images = Reprojection(scene[2], scene[0], nu)
    return relax(start, MATERIAL, end_clamps(start, kind), solver, external=images, external_index=sets, **options)


def energy_vis(scene, row: int, vertices: np.ndarray) -> float:
    """By the oracle, of a rod without twist."""
    errors = sum(edge_error(camera, map_of(scene[2], row, c), a, b, POINTS, 40.0)
                 for c, camera in enumerate(scene[0].cameras) for a, b in zip(vertices[:-1], vertices[1:]))
    return rod_energy(vertices, ALPHA, 1.0, np.array([0.0, 0.0, 1.0])) + NU * errors


@pytest.mark.thorough
@pytest.mark.parametrize("kind", [Clamp.POSITION, Clamp.TANGENT, Clamp.FRAME])
def test_at_rest_no_turn_of_an_edge_lowers_the_oracle_s_energy(kind, scene, rng):
    found = relaxed(scene, *starts(rng, scene[1], 5, 0.05), kind=kind)
    assert found.converged.all() and found.stable.all()
    for row, (vertices, energy) in enumerate(zip(found.configuration.vertices, found.energy)):
        assert energy == pytest.approx(energy_vis(scene, row, vertices), rel=1e-9)
        for edge in rng.integers(0 if kind == Clamp.POSITION else 1, EDGES, 12):
            axis, slope = rng.normal(size=3), []
            for angle in (2e-4, -2e-4):
                step = np.diff(vertices, axis=0)
                step[edge] = 3.0 * frames.unit_vectors(step[edge] + angle * np.cross(axis, step[edge]))
                turned = vertices[0] + np.concatenate([np.zeros((1, 3)), np.cumsum(step, axis=0)])
                slope.append(energy_vis(scene, row, turned) - energy)
            assert min(slope) > 0 and abs(slope[0] - slope[1]) < 0.1 * max(slope)


def test_the_images_recover_the_rod(scene, rng):
    """A strong ν: the shape that was drawn, to a fraction of a pixel (0.3 mm), from starts several pixels off."""
    rig, rods, maps = scene
    sets, start = starts(rng, rods, 50, 0.1)
    found = relaxed(scene, sets, start, 300.0)
    off = np.linalg.norm(found.configuration.vertices - rods[sets], axis=-1).max(axis=1)
    assert found.converged.mean() >= 0.98 and np.median(off) < 0.1
    again = score(found.configuration.vertices, maps, sets, rig, 300.0, MATERIAL, points=POINTS)
    np.testing.assert_allclose(again.total, found.energy, rtol=1e-4)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("nu", [1000.0, 10.0, 100.0])
def test_grown_rods_converge(nu, scene, rng):
    """As Alg. 1 grows them: a new edge, 0.15 rad off, on a rod that is at rest."""
    sets, start = starts(rng, scene[1], 120, 0.02, EDGES - 1)
    parent = relaxed(scene, sets, start, nu).configuration
    last = frames.tangent_from_quaternion(parent.quaternions[:, -1])
    turn = frames.smallest_rotation(last, frames.unit_vectors(last + 0.15 * rng.normal(size=last.shape)))
    edge = frames.quaternion_product(turn, parent.quaternions[:, -1])
    grown = Configuration(parent.start, np.concatenate([parent.quaternions, edge[:, None]], axis=1), np.full(EDGES, 3.0))
    fine = relaxed(scene, sets, grown, nu)
    assert fine.converged.mean() >= 0.99 and fine.stable[fine.converged].all()
    assert (fine.residual[fine.converged] <= TOLERANCES[64]).all()


@pytest.mark.thorough
def test_single_precision_ends_where_double_does(scene, rng):
    given = scene, *starts(rng, scene[1], 60, 0.03), 100.0
    fine, quick = relaxed(*given), relaxed(*given, solver=Newton(tolerance=1e-2), precision="f32")
    assert quick.converged.all() and (quick.precision == 32).mean() > 0.9
    apart = np.linalg.norm(fine.configuration.vertices - quick.configuration.vertices, axis=-1).max(axis=1)
    assert (apart < 5e-3).mean() > 0.9  # a few find another minimum


def test_wrong_input_is_refused(scene, rng):
    sets, start = starts(rng, scene[1], 5, 0.05)
    check_refused("external_index", relaxed, scene, sets + 1, start)
