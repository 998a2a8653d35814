"""E_proj of edges, E_vis of hypotheses and E_back on the device, against the dense oracle, a formula and finite differences."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti import DistanceMaps, Material, Reprojection, Rig, score
from doo_ti.physics.number import Number
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


def edges_near(rng, rods, count=40, off=0.7):
    """(N, 7): set, start and end of edges some way off those of the rods."""
    rows, edges = rng.integers(0, len(rods), count), rng.integers(0, rods.shape[1] - 1, count)
    return np.column_stack([rows, rods[rows, edges] + off * rng.normal(size=(count, 3)),
                            rods[rows, edges + 1] + off * rng.normal(size=(count, 3))])


def evaluated(number, scene, edges, coarse=0.0, nu=NU, points=POINTS):
    """Energy (N,), gradient (N, 6) and Hessian (N, 6, 6) by start and end."""
    rig, _, maps = scene
    external = Reprojection(maps, rig, nu, points, CAP)
    rows = np.column_stack([edges[:, 0], np.full(len(edges), nu), edges[:, 1:], np.full(len(edges), coarse)])
    found = edge_kernel(number, Reprojection)(rows, external.numbers(), external.field())
    g, h, k, n, m = np.split(found[:, 1:], [3, 6, 12, 21], axis=1)
    k, n, m = k[:, SYMMETRIC], n.reshape(-1, 3, 3), m[:, SYMMETRIC]
    # From moments, over the start and the change along the edge, to start and end.
    mixed = n - m
    hessian = np.block([[k - n - n.transpose(0, 2, 1) + m, mixed], [mixed.transpose(0, 2, 1), m]])
    return found[:, 0], np.concatenate([g - h, h], axis=1), hessian


@pytest.mark.sampled(1)
@every_number
def test_energy_and_gradient_are_the_oracle_s(number, scene, rng):
    rig, rods, maps = scene
    edges = edges_near(rng, rods, 21)
    edges[:3, 1:] += 40.0  # off the windows
    energy, gradient, _ = evaluated(number, scene, edges)
    for (row, *ends), found, slope in zip(edges, energy, gradient):
        start, end = np.split(np.array(ends), 2)
        views = [(camera, map_of(maps, int(row), c), start, end, POINTS, CAP) for c, camera in enumerate(rig.cameras)]
        assert found == pytest.approx(NU * sum(edge_error(*one) for one in views), rel=1e-12 if number.bits == 64 else 1e-5)
        wanted = NU * sum(edge_gradient(*one) for one in views)
        np.testing.assert_allclose(slope, wanted, atol=(1e-11 if number.bits == 64 else 1e-3) * np.abs(wanted).max())


@pytest.mark.thorough
def test_hessian_is_that_of_finite_differences(scene, rng):
    """Off the lines halfway between pixels, where the spline's second derivative jumps."""
    rig, rods, maps = scene
    edges = edges_near(rng, rods, 12)
    _, _, hessian = evaluated(NUMBERS[0], scene, edges, points=2)
    smooth = 0
    for (row, *ends), found in zip(edges, hessian):
        start, end = np.split(np.array(ends), 2)
        views = [(camera, map_of(maps, int(row), c), start, end, 2, CAP) for c, camera in enumerate(rig.cameras)]
        wide, wanted = (NU * sum(edge_hessian(*one, step) for one in views) for step in (2e-6, 1e-6))
        if np.abs(wide - wanted).max() < 1e-6 * np.abs(wanted).max():
            smooth += 1
            np.testing.assert_allclose(found, wanted, atol=1e-6 * np.abs(wanted).max())
    assert smooth >= 8


@pytest.mark.sampled(1)
@every_number
def test_coarse_curvature_is_positive_semidefinite(number, scene, rng):
    """With the same energy and gradient; on the crease it has the true curvature across."""
    _, rods, _ = scene
    edges = edges_near(rng, rods, 60, off=2.0)
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
    edges = np.column_stack([np.zeros(3), begin, begin + np.array([1e-4, 2e-4, 0]) @ camera.rotation])
    found = evaluated(number, (Rig((camera,)), rods, DistanceMaps(maps.values, maps.window[:, :1])), edges)
    assert found[0] == pytest.approx(NU * UNSEEN, rel=1e-6) and not found[1].any() and not found[2].any()


def hypotheses(rng, rods, count):
    sets = rng.integers(0, len(rods), count)
    return rods[sets] + np.cumsum(0.2 * rng.normal(size=(count, *rods.shape[1:])), axis=1), sets


@pytest.mark.parametrize("kind", [pytest.param(np.float32, marks=pytest.mark.slow), np.float64])
def test_scores_are_the_oracle_s(kind, scene, rng):
    rig, rods, maps = scene
    vertices, sets = hypotheses(rng, rods, 19)
    up, material = np.array([0.6, 0.0, 0.8]), Material(rng.uniform(1e5, 6e5, 19), 1.0, rng.uniform(0, 2, 19))
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
    assert found.unseen[1, 2] == 1 and found.unseen[2].max() == 0 and found.camera_error[1, 2] == pytest.approx(12 * UNSEEN)


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
    rng, rig = np.random.default_rng(4), three_cameras()
    shape = (ROWS, 3, EDGES, PLACES)
    middle = np.array([camera.project(np.zeros((1, 3)))[0] for camera in rig.cameras])
    points = middle[None, :, None, None] + rng.normal(0, 6.0, (*shape, 2))
    angle, weight = rng.uniform(0, np.pi, shape), rng.uniform(0.5, 2.0, shape)
    weight[1, 0, 2] = 0.0
    return AssignedPoints(rig, points, np.stack([np.cos(angle), np.sin(angle)], axis=-1), weight, NU_BACK, 0.1, 3.0)


def formula(external: AssignedPoints, row: int, edge: int, start: np.ndarray, end: np.ndarray) -> float:
    total = 0.0
    for c, camera in enumerate(external.rig.cameras):
        for k in range(PLACES):
            share = (k + 0.5) / PLACES
            apart = camera.project((start + share * (end - start))[None])[0] - external.points[row, c, edge, k]
            t = external.tangent[row, c, edge, k]
            square, h = (apart @ [-t[1], t[0]]) ** 2 + external.along * (apart @ t) ** 2, external.soft
            total += external.weight[row, c, edge, k] * 2 * h * h * (np.sqrt(1 + square / h**2) - 1)
    return NU_BACK * total


def on_device(number: Number, external: AssignedPoints, rows: np.ndarray, coarse: float = 0.0) -> np.ndarray:
    rows = np.column_stack([rows, np.full(len(rows), coarse)])
    return edge_kernel(number, AssignedPoints)(rows, external.numbers(), external.field())


def edges(rng) -> np.ndarray:
    """(N, 9) row, edge, ν, start and end of edges near the origin."""
    count = 24
    start = rng.normal(0, 2.0, (count, 3))
    return np.column_stack([rng.integers(0, ROWS, count), rng.integers(0, EDGES, count), np.full(count, NU_BACK), start,
                            start + rng.normal(0, 2.0, (count, 3))])


@pytest.mark.sampled(1)
@every_number
def test_e_back_and_its_gradient_are_those_of_the_formula(number, assigned, rng):
    rows = edges(rng)
    found = on_device(number, assigned, rows)
    tolerance = 1e-9 if number.bits == 64 else 2e-3
    for one, row in zip(found, rows, strict=True):
        at, start, end = (int(row[0]), int(row[1])), row[3:6], row[6:9]
        scale = 1 + abs(formula(assigned, *at, start, end))
        assert abs(one[0] - formula(assigned, *at, start, end)) < max(tolerance, 1e-5) * scale
        if number.bits == 64:
            for axis in range(3):
                step = 1e-5 * np.eye(3)[axis]
                shifted = formula(assigned, *at, start + step, end + step) - formula(assigned, *at, start - step, end - step)
                stretched = formula(assigned, *at, start, end + step) - formula(assigned, *at, start, end - step)
                assert one[1 + axis] == pytest.approx(shifted / 2e-5, abs=1e-5 * scale)
                assert one[4 + axis] == pytest.approx(stretched / 2e-5, abs=1e-5 * scale)


@pytest.mark.thorough
def test_curvature_of_e_back_is_that_of_finite_differences(assigned, rng):
    number, rows, step = Number(1, 64), edges(rng), 1e-5
    now = on_device(number, assigned, rows)
    for axis in range(3):
        both, only = np.zeros((2, 10))
        both[[3 + axis, 6 + axis]], only[6 + axis] = step, step
        shifted, stretched = ((on_device(number, assigned, rows + move[:9]) - on_device(number, assigned, rows - move[:9]))
                              / (2 * step) for move in (both, only))
        scale = np.abs(now[:, 7:13]).max(axis=1, keepdims=True)
        assert (np.abs(now[:, 7:13][:, SYMMETRIC[axis]] - shifted[:, 1:4]) < 1e-5 * scale).all()
        assert (np.abs(now[:, 13:22].reshape(-1, 3, 3)[:, axis] - shifted[:, 4:7]) < 1e-5 * scale).all()
        assert (np.abs(now[:, 22:28][:, SYMMETRIC[axis]] - stretched[:, 4:7]) < 1e-5 * scale).all()


def test_coarse_curvature_of_e_back_is_positive_semidefinite(assigned, rng):
    found = on_device(Number(1, 64), assigned, edges(rng), coarse=1.0)
    k, ks, kss = found[:, 7:13], found[:, 13:22].reshape(-1, 3, 3), found[:, 22:28]
    values = np.linalg.eigvalsh(np.block([[k[:, SYMMETRIC], ks], [np.swapaxes(ks, 1, 2), kss[:, SYMMETRIC]]]))
    assert (values[:, 0] > -1e-9 * values[:, -1]).all()


def test_wrong_points_are_refused(assigned):
    for change, word in (({"weight": assigned.weight[:, :2]}, "points, weight"), ({"weight": -assigned.weight}, "negative"),
                         ({"tangent": assigned.points[..., :1]}, "tangent"), ({"nu": -1.0}, "nu"), ({"along": 2.0}, "along")):
        check_refused(word, replace, assigned, **change)
