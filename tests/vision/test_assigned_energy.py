"""E_back on the device: energy, gradient and curvature of an edge against a formula and finite differences of it."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti.physics.number import Number
from doo_ti.system.errors import InputError
from doo_ti.vision.image_energy import AssignedPoints
from tests.vision.device import edge_kernel, every_number
from tests.vision.drawn_maps import three_cameras

ROWS, EDGES, PLACES, NU = 6, 4, 3, 2.5


@pytest.fixture(scope="module")
def assigned() -> AssignedPoints:
    """Points about the middle of the images, a few px from where edges are seen."""
    rng, rig = np.random.default_rng(4), three_cameras()
    shape = (ROWS, 3, EDGES, PLACES)
    middle = np.array([camera.project(np.zeros((1, 3)))[0] for camera in rig.cameras])
    points = middle[None, :, None, None] + rng.normal(0, 6.0, (*shape, 2))
    angle = rng.uniform(0, np.pi, shape)
    weight = rng.uniform(0.5, 2.0, shape)
    weight[1, 0, 2] = 0.0
    return AssignedPoints(rig, points, np.stack([np.cos(angle), np.sin(angle)], axis=-1), weight, NU, 0.1, 3.0)


def formula(external: AssignedPoints, row: int, edge: int, start: np.ndarray, end: np.ndarray) -> float:
    total = 0.0
    for c, camera in enumerate(external.rig.cameras):
        for k in range(PLACES):
            share = (k + 0.5) / PLACES
            apart = camera.project((start + share * (end - start))[None])[0] - external.points[row, c, edge, k]
            t = external.tangent[row, c, edge, k]
            square = (apart @ [-t[1], t[0]]) ** 2 + external.along * (apart @ t) ** 2
            h = external.soft
            total += external.weight[row, c, edge, k] * 2 * h * h * (np.sqrt(1 + square / h**2) - 1)
    return NU * total


def on_device(number: Number, external: AssignedPoints, rows: np.ndarray, coarse: float = 0.0) -> np.ndarray:
    rows = np.column_stack([rows, np.full(len(rows), coarse)])
    return edge_kernel(number, AssignedPoints)(rows, external.numbers(), external.field())


def edges(rng) -> np.ndarray:
    """(N, 9) row, edge, ν, start and end of edges near the origin."""
    count = 24
    start = rng.normal(0, 2.0, (count, 3))
    return np.column_stack([rng.integers(0, ROWS, count), rng.integers(0, EDGES, count), np.full(count, NU), start,
                            start + rng.normal(0, 2.0, (count, 3))])


@pytest.mark.sampled(1)
@every_number
def test_energy_and_gradient_are_those_of_the_formula(number, assigned, rng):
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
def test_curvature_is_that_of_finite_differences(assigned, rng):
    number, rows, step = Number(1, 64), edges(rng), 1e-5
    now = on_device(number, assigned, rows)
    symmetric = [[0, 1, 2], [1, 3, 4], [2, 4, 5]]
    for axis in range(3):
        both, only = np.zeros((2, 10))
        both[[3 + axis, 6 + axis]], only[6 + axis] = step, step
        shifted, stretched = ((on_device(number, assigned, rows + move[:9]) - on_device(number, assigned, rows - move[:9]))
                              / (2 * step) for move in (both, only))
        scale = np.abs(now[:, 7:13]).max(axis=1, keepdims=True)
        assert (np.abs(now[:, 7:13][:, symmetric[axis]] - shifted[:, 1:4]) < 1e-5 * scale).all()
        assert (np.abs(now[:, 13:22].reshape(-1, 3, 3)[:, axis] - shifted[:, 4:7]) < 1e-5 * scale).all()
        assert (np.abs(now[:, 22:28][:, symmetric[axis]] - stretched[:, 4:7]) < 1e-5 * scale).all()


def test_coarse_curvature_is_positive_semidefinite(assigned, rng):
    found = on_device(Number(1, 64), assigned, edges(rng), coarse=1.0)
    k, ks, kss = found[:, 7:13], found[:, 13:22].reshape(-1, 3, 3), found[:, 22:28]
    full = [[0, 1, 2], [1, 3, 4], [2, 4, 5]]
    whole = np.block([[k[:, full], ks], [np.swapaxes(ks, 1, 2), kss[:, full]]])
    values = np.linalg.eigvalsh(whole)
    assert (values[:, 0] > -1e-9 * values[:, -1]).all()


def test_wrong_input_is_refused(assigned):
    for change, word in (({"weight": assigned.weight[:, :2]}, "points, weight"), ({"weight": -assigned.weight}, "negative"),
                         ({"tangent": assigned.points[..., :1]}, "tangent"), ({"nu": -1.0}, "nu"), ({"along": 2.0}, "along")):
        with pytest.raises(InputError, match=word):
            replace(assigned, **change)
