"""F(Γ, E_vis, C): rods at minima of their energy and reprojection error, against the oracle's E_vis."""

import numpy as np
import pytest

from doo_ti import Clamp, Clamps, Configuration, InputError, Material, Newton, Reprojection, relax, score
from doo_ti.relaxation.newton import TOLERANCES
from doo_ti.rod.frames import (
    bishop_frames,
    quaternion_from_matrix,
    quaternion_product,
    smallest_rotation,
    tangent_from_quaternion,
)
from tests.oracle.reprojection import edge_error, rod_energy
from tests.relaxation.rods import assert_same
from tests.vision.drawn_maps import curves, drawn_maps, map_of, three_cameras

EDGES, NU, POINTS = 14, 30.0, 4
ALPHA = 2e5
SEARCH = Newton(tolerance=1e-2)


@pytest.fixture(scope="module")
def scene():
    """(rig, five rods, their maps)."""
    rods = curves(np.random.default_rng(8), 5, EDGES)
    return three_cameras(), rods, drawn_maps(three_cameras(), rods)


def starts(rng, rods, count: int, turn: float, edges: int = EDGES):
    """(set of each rod, configurations whose edges are turned off the true ones by ``turn`` rad or so, but the first)."""
    sets = np.arange(count) % len(rods)
    tangents = np.diff(rods[sets], axis=1)[:, :edges] / 3.0
    off = turn * rng.normal(size=tangents.shape)
    off[:, 0] = 0.0
    turned = tangents + off
    turned /= np.linalg.norm(turned, axis=-1, keepdims=True)
    frames = bishop_frames(turned, np.cross(turned[:, 0], [0.3, 0.5, 0.8]))
    return sets, Configuration(rods[sets, 0], quaternion_from_matrix(frames), np.full(edges, 3.0))


def held(rods: Configuration, kind=Clamp.TANGENT) -> Clamps:
    """The start held, the far end free."""
    first = rods.frames[:, 0]
    return Clamps(kind, Clamp.FREE, rods.start, np.zeros_like(rods.start), first, first)


def energy_vis(scene, row: int, vertices: np.ndarray, nu: float = NU) -> float:
    """By the oracle, of a rod without twist."""
    rig, _, maps = scene
    errors = sum(edge_error(camera, map_of(maps, row, c), a, b, POINTS, 40.0)
                 for c, camera in enumerate(rig.cameras) for a, b in zip(vertices[:-1], vertices[1:]))
    return rod_energy(vertices, ALPHA, 1.0, np.array([0.0, 0.0, 1.0])) + nu * errors


@pytest.mark.thorough
@pytest.mark.parametrize("kind", [Clamp.POSITION, Clamp.TANGENT, Clamp.FRAME])
def test_at_rest_no_turn_of_an_edge_lowers_the_oracle_s_energy(kind, scene, rng):
    rig, rods, maps = scene
    sets, start = starts(rng, rods, 5, 0.05)
    found = relax(start, Material(ALPHA, ALPHA), held(start, kind), external=Reprojection(maps, rig, NU), external_index=sets)
    assert found.converged.all() and found.stable.all()
    for row, (vertices, energy) in enumerate(zip(found.configuration.vertices, found.energy)):
        assert energy == pytest.approx(energy_vis(scene, row, vertices), rel=1e-9)
        first = 0 if kind == Clamp.POSITION else 1
        for edge in rng.integers(first, EDGES, 12):
            axis = rng.normal(size=3)
            slope = []
            for angle in (2e-4, -2e-4):
                turned = vertices.copy()
                step = np.diff(vertices, axis=0)
                step[edge] = step[edge] + angle * np.cross(axis, step[edge])
                step[edge] *= 3.0 / np.linalg.norm(step[edge])
                turned[1:] = vertices[0] + np.cumsum(step, axis=0)
                slope.append(energy_vis(scene, row, turned) - energy)
            assert min(slope) > 0 and abs(slope[0] - slope[1]) < 0.1 * max(slope)


def test_the_images_recover_the_rod(scene, rng):
    """A strong ν: the shape that was drawn, to a fraction of a pixel (0.3 mm), from starts several pixels off."""
    rig, rods, maps = scene
    sets, start = starts(rng, rods, 50, 0.1)
    found = relax(start, Material(ALPHA, ALPHA), held(start), external=Reprojection(maps, rig, 300.0), external_index=sets)
    off = np.linalg.norm(found.configuration.vertices - rods[sets], axis=-1).max(axis=1)
    assert found.converged.mean() >= 0.98 and np.median(off) < 0.1
    again = score(found.configuration.vertices, maps, sets, rig, 300.0, Material(ALPHA, ALPHA), points=POINTS)
    np.testing.assert_allclose(again.total, found.energy, rtol=1e-4)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("nu", [1000.0, 10.0, 100.0])
def test_grown_rods_converge(nu, scene, rng):
    """As Alg. 1 grows them: a new edge, 0.15 rad off, on a rod that is at rest."""
    rig, rods, maps = scene
    external, material = Reprojection(maps, rig, nu), Material(ALPHA, ALPHA)
    sets, start = starts(rng, rods, 120, 0.02, EDGES - 1)
    parent = relax(start, material, held(start), external=external, external_index=sets).configuration
    last = tangent_from_quaternion(parent.quaternions[:, -1])
    new = last + 0.15 * rng.normal(size=last.shape)
    new /= np.linalg.norm(new, axis=-1, keepdims=True)
    edge = quaternion_product(smallest_rotation(last, new), parent.quaternions[:, -1])
    grown = Configuration(parent.start, np.concatenate([parent.quaternions, edge[:, None]], axis=1), np.full(EDGES, 3.0))
    fine = relax(grown, material, held(grown), external=external, external_index=sets)
    assert fine.converged.mean() >= 0.99 and fine.stable[fine.converged].all()
    assert (fine.residual[fine.converged] <= TOLERANCES[64]).all()


def test_single_precision_ends_where_double_does(scene, rng):
    rig, rods, maps = scene
    sets, start = starts(rng, rods, 60, 0.03)
    images = {"external": Reprojection(maps, rig, 100.0), "external_index": sets}
    fine = relax(start, Material(ALPHA, ALPHA), held(start), **images)
    quick = relax(start, Material(ALPHA, ALPHA), held(start), SEARCH, precision="f32", **images)
    assert quick.converged.all() and (quick.precision == 32).mean() > 0.9
    apart = np.linalg.norm(fine.configuration.vertices - quick.configuration.vertices, axis=-1).max(axis=1)
    # A few find another minimum.
    assert (apart < 5e-3).mean() > 0.9


def test_a_rod_does_not_depend_on_the_others(scene, rng):
    """Three rods leave lanes empty, whose values are never used."""
    rig, rods, maps = scene
    sets, start = starts(rng, rods, 40, 0.05)
    external, material = Reprojection(maps, rig, NU), Material(ALPHA, ALPHA)
    together = relax(start, material, held(start), external=external, external_index=sets)
    for rows in ([39], [3, 17, 8]):
        some = start.take(rows)
        alone = relax(some, material, held(some), external=external, external_index=sets[rows])
        assert_same(together, rows, alone, slice(None))


@pytest.mark.thorough
def test_no_weight_on_the_images_leaves_the_rod_to_itself(scene, rng):
    rig, rods, maps = scene
    _, start = starts(rng, rods, 6, 0.05)
    one = relax(start, Material(ALPHA, ALPHA), held(start), external=Reprojection(maps, rig, 0.0), external_index=[0] * 6)
    other = relax(start, Material(ALPHA, ALPHA), held(start))
    np.testing.assert_allclose(one.energy, other.energy, rtol=1e-9)


def test_wrong_input_is_refused(scene, rng):
    rig, rods, maps = scene
    sets, start = starts(rng, rods, 5, 0.05)
    with pytest.raises(InputError, match="external_index"):
        relax(start, Material(ALPHA, ALPHA), held(start), external=Reprojection(maps, rig, NU), external_index=sets + 1)
