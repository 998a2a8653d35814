"""Rods that are difficult for a solver, always the same ones: every status is right; of a thousand nearly all converge. The
results of rods that end with each status, and which arithmetic ended them."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from doo_ti import Clamp, Clamps, Configuration, Descent, Material, Newton, Status, relax, straight_rod
from doo_ti.lab.workload import BEND_RANGE, TWIST_RATIO_RANGE, log_uniform
from doo_ti.relaxation.newton import TOLERANCES
from doo_ti.rod.frames import unit_vectors
from tests.conftest import SEED
from tests.references.rods import chain, clamps_at, jiggled, stacked
from tests.relaxation.rods import wandering

Rods = tuple[Configuration, Material, Clamps]
LENGTH, EDGES = 99.0, 33  # mm
EVEN, SHARES = np.full(EDGES, LENGTH / EDGES), np.linspace(0.0, 1.0, EDGES)


def along(rng, tangents: np.ndarray) -> Configuration:
    """Rods along tangents (R, E, 3), twisted evenly by up to half a turn."""
    return stacked([chain(one, across(rng, one[0]), EVEN, spin=rng.uniform(-np.pi, np.pi) * SHARES) for one in tangents])


def across(rng, tangents: np.ndarray) -> np.ndarray:
    return unit_vectors(np.cross(tangents, rng.normal(size=tangents.shape)))


def isotropic(rng, count: int, weight: float = 1.0) -> Material:
    alpha = log_uniform(rng, BEND_RANGE, count)
    return Material(alpha, alpha * log_uniform(rng, TWIST_RATIO_RANGE, count), weight)


def held(rng, count: int, material: Material | None = None, rest_length=EVEN, start=Clamp.FRAME, end=Clamp.FRAME) -> Rods:
    """Rods that wander alike whatever their number of edges; their starts have errors, as frames of measured marks have."""
    edges = rest_length.shape[-1]
    finer = np.sqrt(EDGES / edges)
    rods = replace(wandering(rng, count, edges, 1.0, 0.15 * finer, 0.1 * finer), rest_length=rest_length)
    return jiggled(rods, rng, 0.05), isotropic(rng, count) if material is None else material, clamps_at(rods, start, end)


def nearly_taut(rng, count: int) -> Rods:
    """Straight, 0.05 mm of slack in 99 mm, in any direction of space, the far clamp turned."""
    ahead = unit_vectors(rng.normal(size=(count, 3)))
    rods = along(rng, np.repeat(ahead[:, None], EDGES, axis=1))
    return rods, isotropic(rng, count), replace(clamps_at(rods), end_position=98.95 * ahead)


def collinear(rng, count: int, weight: float) -> Rods:
    """An even bow to any side of the line of both clamps, about which it rotates without weight at constant energy."""
    angle = rng.uniform(0.3, 1.8, (count, 1, 1)) * np.sin(2 * np.pi * SHARES)[:, None]
    ahead = unit_vectors(rng.normal(size=(count, 1, 3)))
    rods = along(rng, np.cos(angle) * ahead + np.sin(angle) * across(rng, ahead))
    return rods, isotropic(rng, count, weight), clamps_at(rods)


def sharp_joints(rng, count: int) -> Rods:
    tangents = [unit_vectors(rng.normal(size=(count, 3)))]
    for _ in range(EDGES - 1):
        tangents.append(np.cos(1.5) * tangents[-1] + np.sin(1.5) * across(rng, tangents[-1]))
    rods = along(rng, np.stack(tangents, axis=1))
    return rods, isotropic(rng, count), clamps_at(rods)


def anisotropic(rng, count: int) -> Rods:
    soft, first = log_uniform(rng, (5e4, 1e6), count), rng.random(count) < 0.5
    twist = soft * log_uniform(rng, (0.1, 60.0), count)
    return held(rng, count, Material.diagonal(np.where(first, 100, 1) * soft, np.where(first, 1, 100) * soft, twist))


def uneven(rng, count: int) -> Rods:
    lengths = rng.permuted(np.tile(np.geomspace(1.0, 50.0, EDGES), (count, 1)), axis=1)
    return held(rng, count, rest_length=LENGTH * lengths / lengths.sum(axis=1, keepdims=True))


def curved_at_rest(rng, count: int) -> Rods:
    """Coils of 8 mm radius and more at rest, and from joint to joint a little different; half of the sections round."""
    alpha, ratio = log_uniform(rng, BEND_RANGE, count), log_uniform(rng, TWIST_RATIO_RANGE, count)
    second = np.where(rng.random(count) < 0.5, 1.0, log_uniform(rng, (0.2, 5.0), count))
    bend = alpha[:, None, None] * np.eye(2)
    bend[:, 1, 1] *= second
    axis = unit_vectors(rng.normal(size=(count, 1, 3)))[..., :2]
    rest = 0.125 * rng.uniform(0.0, 1.0, (count, 1, 1)) * axis + 0.01 * rng.normal(size=(count, EDGES - 1, 2))
    return held(rng, count, Material(bend, alpha * ratio, 1.0, rest))


ROWS = {
    "ends 98.95 of 99 mm apart": nearly_taut, "collinear clamps": partial(collinear, weight=1.0),
    "collinear clamps, no weight": partial(collinear, weight=0.0), "joints of 1.5 rad": sharp_joints,
    "99 edges": partial(held, rest_length=np.full(99, 1.0)), "512 edges": partial(held, rest_length=np.full(512, LENGTH / 512)),
    "anisotropy 100:1": anisotropic, "rest lengths 1:50": uneven, "rest curvature": curved_at_rest,
    "free end": partial(held, end=Clamp.FREE), "positions only": partial(held, start=Clamp.POSITION, end=Clamp.POSITION)}
every_row = pytest.mark.parametrize("row", ROWS)


@pytest.mark.sampled(len(ROWS))
@every_row
@pytest.mark.parametrize("precision", ["mixed", "f64", "f32"])
def test_every_status_is_right(row, precision):
    rods, material, clamps = ROWS[row](np.random.default_rng(SEED), 8)
    solution = relax(rods, material, clamps, precision=precision)
    assert np.isin(solution.status, list(Status)).all() and np.isin(solution.precision, (32, 64)).all()
    assert (solution.status != Status.INFEASIBLE).all()
    sound, done = solution.status != Status.NOT_FINITE, solution.converged
    for values in (solution.energy, solution.residual, solution.closure, solution.configuration.vertices):
        assert np.isfinite(values[sound]).all()
    assert (solution.iterations[sound] > 0).all() and not solution.stable[~done].any()
    assert precision == "f32" or done.sum() >= 5
    coarse = solution.precision[done] == 32
    assert (solution.residual[done] <= np.where(coarse, TOLERANCES[32], TOLERANCES[64])).all()
    vertices, frames = solution.configuration.vertices[done], solution.configuration.frames[done]
    # mm: the edges to rounding, the far end within what closure is asked for; in f32 the edges' rounding adds up along the rod.
    off = np.abs(np.linalg.norm(np.diff(vertices, axis=1), axis=2) - solution.configuration.take(done).rest_length)
    assert (off.max(axis=1) <= np.where(coarse, 1e-5, 1e-10)).all()
    np.testing.assert_array_equal(vertices[:, 0], clamps.start_position[done])
    if clamps.end != Clamp.FREE:
        miss = np.linalg.norm(vertices[:, -1] - clamps.end_position[done], axis=1)
        assert (miss <= np.where(coarse, 1e-4, 1e-10)).all(), miss
    for kind, edge, held in ((clamps.start, 0, clamps.start_frame), (clamps.end, -1, clamps.end_frame)):
        if kind == Clamp.FRAME:
            np.testing.assert_allclose(frames[:, edge], held[done], atol=1e-6 if coarse.any() else 1e-14)


@pytest.mark.slow
@every_row
def test_mixed_converges_on_99_percent_of_a_thousand(row):
    solution = relax(*ROWS[row](np.random.default_rng(SEED), 1000), precision="mixed")
    assert solution.converged[solution.status != Status.INFEASIBLE].mean() >= 0.99


MATERIAL = Material(2e5, 1e5, 1.0)


def bows(rng, count: int = 9):
    rods = wandering(rng, count, 12)
    return jiggled(rods, rng, 0.1), clamps_at(rods)


@pytest.mark.parametrize("precision", ["f64", "f32", "mixed"])
def test_iteration_limit_and_stalled(rng, precision):
    start, clamps = bows(rng)
    solution = relax(start, MATERIAL, clamps, Newton(max_iterations=3), precision=precision)
    assert (solution.status == Status.ITERATION_LIMIT).all() and not solution.stable.any()
    # What f32 could not finish f64 takes over.
    assert (solution.iterations == (3 if precision == "f64" else 6)).all() and (solution.precision == 64).all()
    vertices = solution.configuration.vertices
    assert np.isfinite(solution.energy).all() and np.isfinite(vertices).all()
    np.testing.assert_allclose(np.linalg.norm(np.diff(vertices, axis=1), axis=2), 3.0, atol=1e-5)
    # A tolerance below rounding: the rod stops by itself, long before the limit, as good as it can be.
    solution = relax(start, MATERIAL, clamps, Newton(tolerance=1e-17))
    assert (solution.status == Status.STALLED).all() and not solution.stable.any()
    assert (solution.iterations < 100).all() and (solution.residual < 1e-10).all()


@pytest.mark.parametrize("solver", [Newton(), Descent(max_iterations=20)], ids=["newton", "descent"])
@pytest.mark.parametrize("precision", ["f64", "f32", "mixed"])
def test_infeasible_by_a_hair(rng, precision, solver):
    """The clamped edges taken off, the span exceeds the free rest lengths, by any amount above rounding."""
    (start, clamps), frame = bows(rng, 3), np.tile(np.eye(3), (3, 1, 1))
    for excess in (1e-6, 0.1, 100.0):
        ahead = clamps.start_position + [36.0 + excess, 0.0, 0.0]
        beyond = Clamps(Clamp.FRAME, Clamp.FRAME, clamps.start_position, ahead, frame, frame)
        solution = relax(start, MATERIAL, beyond, solver, precision=precision)
        assert (solution.status == Status.INFEASIBLE).all(), excess
        assert np.isnan(solution.energy).all() and not solution.stable.any() and (solution.iterations == 0).all()


@pytest.mark.parametrize("far, status", [(5.0, Status.INFEASIBLE), (29.0, Status.INFEASIBLE), (31.0, Status.CONVERGED)])
def test_an_edge_that_is_longer_than_the_others_and_the_line_together(far, status):
    """Clamps can be too near to each other, too."""
    rod = replace(straight_rod(90.0, 4), rest_length=np.array([10.0, 60.0, 10.0, 10.0]))
    clamps = replace(clamps_at(rod, Clamp.POSITION, Clamp.POSITION), end_position=np.array([[far, 0.0, 0.0]]))
    assert relax(rod, MATERIAL, clamps).status[0] == status


def test_f64_takes_over_what_f32_cannot_finish(rng):
    start, clamps = bows(rng)
    demanding = relax(start, MATERIAL, clamps, Newton(tolerance=1e-9), precision="f32")
    assert (demanding.precision == 64).all() and demanding.converged.all() and demanding.residual.max() <= 1e-9
    np.testing.assert_allclose(demanding.energy, relax(start, MATERIAL, clamps).energy, rtol=1e-10)
