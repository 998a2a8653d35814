"""E_proj of edges, E_vis of hypotheses and E_back on the device, against the dense oracle, a formula and finite differences."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti import DistanceMaps, Material, Reprojection, Rig, score
from doo_ti.physics.number import Number
from doo_ti.rod.frames import normal_to, unit_vectors
from doo_ti.vision.edge_integral import UNSEEN
from doo_ti.vision.image_energy import AssignedPoints
from tests.conftest import check_refused
from tests.oracle.reprojection import edge_error, edge_gradient, edge_hessian, rod_energy
from tests.vision.device import NUMBERS, edge_kernel, every_number
from tests.vision.scenes import drawn_scene, map_of, three_cameras

POINTS, CAP, NU = 5, 30.0, 0.7
SYMMETRIC = [[0, 1, 2], [1, 3, 4], [2, 4, 5]]


@pytest.fixture(scope="module")
def scene():
    return drawn_scene(4, 4, 12)


def edges_near(rng, rods, count, off=0.7):
    """(N, 8): set, ν, start and end of edges some way off those of the rods."""
    rows, edges = rng.integers(0, len(rods), count), rng.integers(0, rods.shape[1] - 1, count)
    ends = np.hstack([rods[rows, edges], rods[rows, edges + 1]])
    return np.column_stack([rows, np.full(count, NU), ends + off * rng.normal(size=(count, 6))])


def on_device(number: Number, external, rows: np.ndarray, coarse: float = 0.0) -> list[np.ndarray]:
    """Energy (N,) and its moments g, h (N, 3) and k, n, m (N, 3, 3), over the start and the change along the edge."""
    found = edge_kernel(number, type(external))(np.insert(rows, rows.shape[1], coarse, axis=1), external.numbers(),
                                                external.field())
    _, g, h, k, n, m = np.split(found, [1, 4, 7, 13, 22], axis=1)
    return [found[:, 0], g, h, k[:, SYMMETRIC], n.reshape(-1, 3, 3), m[:, SYMMETRIC]]


def evaluated(number, scene, edges, coarse=0.0, points=POINTS):
    """Energy (N,), gradient (N, 6) and Hessian (N, 6, 6) by start and end."""
    energy, g, h, k, n, m = on_device(number, Reprojection(scene[2], scene[0], NU, points, CAP), edges, coarse)
    hessian = np.block([[k - n - n.transpose(0, 2, 1) + m, n - m], [(n - m).transpose(0, 2, 1), m]])
    return energy, np.hstack([g - h, h]), hessian


def views(scene, edge: np.ndarray, points: int = POINTS) -> list[tuple]:
    """What the oracle has to know of an edge, for each camera."""
    return [(camera, map_of(scene[2], int(edge[0]), c), edge[2:5], edge[5:], points, CAP)
            for c, camera in enumerate(scene[0].cameras)]


@pytest.mark.sampled(1)
@every_number
def test_energy_and_gradient_are_the_oracle_s(number, scene, rng):
    edges = edges_near(rng, scene[1], 21)
    edges[:3, 2:] += 40.0  # off the windows
    for edge, found, slope in zip(edges, *evaluated(number, scene, edges)[:2]):
        wanted = NU * sum(edge_error(*one) for one in views(scene, edge))
        assert found == pytest.approx(wanted, rel=1e-12 if number.bits == 64 else 1e-5)
        wanted = NU * sum(edge_gradient(*one) for one in views(scene, edge))
        np.testing.assert_allclose(slope, wanted, atol=(1e-11 if number.bits == 64 else 1e-3) * np.abs(wanted).max())


@pytest.mark.thorough
def test_hessian_is_that_of_finite_differences(scene, rng):
    """Off the lines halfway between pixels, where the spline's second derivative jumps."""
    edges, smooth = edges_near(rng, scene[1], 12), 0
    for edge, found in zip(edges, evaluated(NUMBERS[0], scene, edges, points=2)[2]):
        wide, wanted = (NU * sum(edge_hessian(*one, step) for one in views(scene, edge, 2)) for step in (2e-6, 1e-6))
        if np.abs(wide - wanted).max() < 1e-6 * np.abs(wanted).max():
            smooth += 1
            np.testing.assert_allclose(found, wanted, atol=1e-6 * np.abs(wanted).max())
    assert smooth >= 8


@pytest.mark.sampled(1)
@every_number
def test_coarse_curvature_is_positive_semidefinite(number, scene, rng):
    """With the same energy and gradient; on the crease it has the true curvature across."""
    edges = edges_near(rng, scene[1], 60, off=2.0)
    fine, coarse = evaluated(number, scene, edges), evaluated(number, scene, edges, coarse=1.0)
    np.testing.assert_array_equal(fine[0], coarse[0])
    np.testing.assert_array_equal(fine[1], coarse[1])
    eigenvalues = np.linalg.eigvalsh(coarse[2])
    assert (eigenvalues[:, 0] > -(1e-12 if number.bits == 64 else 1e-4) * eigenvalues[:, -1]).all()
    assert (np.linalg.eigvalsh(fine[2])[:, 0] < 0).mean() > 0.5


@pytest.mark.sampled(1)
@every_number
def test_an_edge_that_a_camera_does_not_see_costs_but_does_not_pull(number, scene):
    """Behind it, 87° off its axis, and at it."""
    rig, rods, maps = scene
    camera = rig.cameras[0]
    begin = camera.centre + np.array([(0, 0, -20), (100, 0, 5), (0, 0, 1e-3)]) @ camera.rotation
    edges = np.column_stack([np.zeros(3), np.full(3, NU), begin, begin + np.array([1e-4, 2e-4, 0]) @ camera.rotation])
    found = evaluated(number, (Rig((camera,)), rods, DistanceMaps(maps.values, maps.window[:, :1])), edges)
    assert found[0] == pytest.approx(NU * UNSEEN, rel=1e-6) and not found[1].any() and not found[2].any()


def hypotheses(rng, rods, count):
    sets = rng.integers(0, len(rods), count)
    return rods[sets] + np.cumsum(0.2 * rng.normal(size=(count, *rods.shape[1:])), axis=1), sets


@pytest.mark.parametrize("kind", [pytest.param(np.float32, marks=pytest.mark.slow), np.float64])
def test_scores_are_the_oracle_s(kind, scene, rng):
    rig, rods, maps = scene
    vertices, sets = hypotheses(rng, rods, 19)
    up = np.array([0.6, 0.0, 0.8])
    material = Material(rng.uniform(1e5, 6e5, 19), 1.0, rng.uniform(0, 2, 19))
    found = score(vertices.astype(kind), maps, sets, rig, NU, material, points=POINTS, cap=CAP, up=up)
    assert found.camera_error.shape == found.unseen.shape == (19, 3) and not found.unseen.any()
    for n, rod in enumerate(vertices):
        errors = [sum(edge_error(camera, map_of(maps, sets[n], c), *ends, POINTS, CAP) for ends in zip(rod[:-1], rod[1:]))
                  for c, camera in enumerate(rig.cameras)]
        np.testing.assert_allclose(found.camera_error[n], errors, rtol=2e-5)
        energy = rod_energy(rod, material.bend[n, 0, 0, 0], material.weight[n], up)
        assert found.energy[n] == pytest.approx(energy, rel=1e-5)
        assert found.total[n] == pytest.approx(energy + NU * sum(errors), rel=1e-5)


def test_rods_not_finite_or_not_seen_are_reported(scene, rng):
    rig, rods, maps = scene
    vertices, sets = hypotheses(rng, rods, 3)
    vertices[0, 5, 1] = np.nan
    vertices[1] += rig.cameras[2].centre - 40 * rig.cameras[2].rotation[2]
    found = score(vertices, maps, sets, rig, NU, Material(2e5, 1e5))
    assert np.isnan(found.total[0]) and np.isfinite(found.total[1:]).all()
    assert found.unseen[1, 2] == 1 and found.unseen[2].max() == 0
    assert found.camera_error[1, 2] == pytest.approx(12 * UNSEEN)


def test_the_true_rod_scores_best(scene, rng):
    """Against rods bent off it; its own error is nothing but how the spline rounds the crease here and there."""
    rig, rods, maps = scene
    vertices, sets = hypotheses(rng, rods, 400)
    true = score(rods, maps, np.arange(4), rig, 2.0)
    length = np.array([np.linalg.norm(np.diff(rig.project(rod), axis=1), axis=-1).sum(axis=1) for rod in rods])
    assert (np.abs(true.camera_error) < 0.02 * length).all() and not true.energy.any()
    np.testing.assert_allclose(true.total, 2.0 * true.camera_error.sum(axis=1))
    assert (score(vertices, maps, sets, rig, 2.0).total > true.total[sets]).all()
    assert score(np.zeros((0, 13, 3)), maps, 0, rig, 1.0).total.shape == (0,)


@pytest.mark.parametrize("change, word", [
    ({"vertices": np.zeros((2, 3))}, "vertices"), ({"set_index": [0, 9, 0, 0]}, "set_index"),
    ({"set_index": [0.5, 1, 0, 0]}, "set_index"), ({"material": Material.diagonal(2e5, 1e5, 1e5)}, "isotropic"),
    ({"material": Material([1e5, 2e5, 3e5], 1e5)}, "3 rows for 4"), ({"nu": -1.0}, "nu"), ({"points": 0}, "points"),
    ({"cap": 0.0}, "cap")])
def test_wrong_input_is_refused(scene, change, word):
    rig, rods, maps = scene
    check_refused(word, score, **{"vertices": rods, "maps": maps, "set_index": [0, 1, 2, 3], "rig": rig, "nu": 1.0, **change})


def test_maps_that_do_not_fit_are_refused(scene):
    rig, _, maps = scene
    thin = maps.window.copy()
    thin[1, 2, 3] = 2
    for values, window, cameras, word in ((maps.values, maps.window, rig.cameras[:2], "camera of the rig"),
                                          (maps.values[:-1], maps.window, rig.cameras, "distances"),
                                          (maps.values, thin, rig.cameras, "3 px or more")):
        check_refused(word, Reprojection, DistanceMaps(values, window), Rig(cameras), 1.0)


ROWS, EDGES, PLACES, NU_BACK = 6, 4, 3, 2.5


@pytest.fixture(scope="module")
def assigned() -> AssignedPoints:
    """Points about the middle of the images, a few px from where edges are seen."""
    rng, rig, shape = np.random.default_rng(4), three_cameras(), (ROWS, 3, EDGES, PLACES)
    points = rig.project(np.zeros(3))[:, None, None] + rng.normal(0, 6.0, (*shape, 2))
    weight = rng.uniform(0.5, 2.0, shape)
    weight[1, 0, 2] = 0.0
    return AssignedPoints(rig, points, unit_vectors(rng.normal(size=points.shape)), weight, NU_BACK, 0.1, 3.0)


def formula(external: AssignedPoints, row: int, edge: int, start: np.ndarray, end: np.ndarray) -> float:
    share, tangent = (np.arange(PLACES)[:, None] + 0.5) / PLACES, external.tangent[row, :, edge]
    apart = external.rig.project(start + share * (end - start)) - external.points[row, :, edge]
    across, along = (np.sum(apart * way, axis=-1) for way in (normal_to(tangent), tangent))
    root = np.sqrt(1 + (across**2 + external.along * along**2) / external.soft**2)
    return 2 * NU_BACK * external.soft**2 * np.sum(external.weight[row, :, edge] * (root - 1))


def edges(rng) -> np.ndarray:
    """(24, 9) row, edge, ν, start and end of edges near the origin."""
    start, along = rng.normal(0, 2.0, (2, 24, 3))
    return np.column_stack([rng.integers(0, ROWS, 24), rng.integers(0, EDGES, 24), np.full(24, NU_BACK), start, start + along])


@pytest.mark.sampled(1)
@every_number
def test_e_back_and_its_gradient_are_those_of_the_formula(number, assigned, rng):
    rows = edges(rng)
    for row, energy, *slopes in zip(rows, *on_device(number, assigned, rows)[:3]):
        def at(shift, stretch=0.0, row=row):
            return formula(assigned, int(row[0]), int(row[1]), row[3:6] + shift, row[6:] + shift + stretch)

        scale = 1 + abs(at(0.0))
        assert abs(energy - at(0.0)) < (1e-5 if number.bits == 64 else 2e-3) * scale
        for axis, step in enumerate(1e-5 * np.eye(3) if number.bits == 64 else ()):
            for slope, move in zip(slopes, ((step, 0.0), (0.0, step))):
                above, below = (at(*(sign * part for part in move)) for sign in (1, -1))
                assert slope[axis] == pytest.approx((above - below) / 2e-5, abs=1e-5 * scale)


@pytest.mark.thorough
def test_curvature_of_e_back_is_that_of_finite_differences(assigned, rng):
    rows = edges(rng)
    _, _, _, k, n, m = on_device(NUMBERS[0], assigned, rows)
    for axis in range(3):
        both, only = np.zeros((2, 9))
        both[[3 + axis, 6 + axis]] = only[6 + axis] = 1e-5
        slopes = [[on_device(NUMBERS[0], assigned, rows + sign * move)[1:3] for sign in (1, -1)] for move in (both, only)]
        (by_start, by_both), (_, by_stretch) = [(np.array(above) - below) / 2e-5 for above, below in slopes]
        for found, wanted in ((k, by_start), (n, by_both), (m, by_stretch)):
            assert (np.abs(found[:, axis] - wanted) < 1e-5 * np.abs(k).max(axis=(1, 2))[:, None]).all()


def test_coarse_curvature_of_e_back_is_positive_semidefinite(assigned, rng):
    _, _, _, k, n, m = on_device(NUMBERS[0], assigned, edges(rng), coarse=1.0)
    values = np.linalg.eigvalsh(np.block([[k, n], [n.transpose(0, 2, 1), m]]))
    assert (values[:, 0] > -1e-9 * values[:, -1]).all()


def test_wrong_points_are_refused(assigned):
    for change, word in (({"weight": assigned.weight[:, :2]}, "points, weight"), ({"weight": -assigned.weight}, "negative"),
                         ({"tangent": assigned.points[..., :1]}, "tangent"), ({"nu": -1.0}, "nu"), ({"along": 2.0}, "along")):
        check_refused(word, replace, assigned, **change)
