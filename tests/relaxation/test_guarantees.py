"""Guarantees for every rod: edge lengths, clamps, closure, energy, independence of bad rods; the virtual lab at the true Θ."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti import Clamp, Clamps, Configuration, Descent, Material, Newton, Status, distance, relax
from tests.oracle.chain_form import rod_of
from tests.oracle.equilibrium import State, energy_of
from tests.references.rods import certified, clamps_at, jiggled
from tests.relaxation.rods import PAIRS, RIBBON_WIDTH, assert_same, definite, lab, wandering, with_kinds

EDGES = 20
SOLVERS = {"newton": Newton(), "descent": Descent(tolerance=1e-2, max_iterations=300)}
BAD = 11  # the place of the bad rod


def rods_under_all_clamps(rng, count: int = len(PAIRS)):
    rods = wandering(rng, count, EDGES, rng.uniform(1, 6, EDGES))
    kinds = [PAIRS[k % len(PAIRS)] for k in range(count)]
    return jiggled(rods, rng, 0.05), with_kinds(clamps_at(rods), kinds), kinds


def test_layout_and_number_type_of_inputs_do_not_matter(rng):
    start, clamps, _ = rods_under_all_clamps(rng)
    material = Material(2e5, 1e5, 1.0)
    plain = relax(start, material, clamps)
    strided = Configuration(np.asfortranarray(start.start), start.quaternions[::-1][::-1], np.asfortranarray(start.rest_length))
    held = (clamps.start_position, clamps.end_position, clamps.start_frame, clamps.end_frame)
    turned = Clamps(list(clamps.start), list(clamps.end), *map(np.asfortranarray, held))
    assert_same(plain, slice(None), relax(strided, material, turned, up=[0, 0, 2]), slice(None))


@pytest.mark.parametrize("solver", SOLVERS)
def test_edge_lengths_and_clamps_are_exact(rng, solver):
    start, clamps, kinds = rods_under_all_clamps(rng)
    solution = relax(start, Material(definite(rng, len(PAIRS)), 2e5, 1.0), clamps, SOLVERS[solver])
    vertices, frames = solution.configuration.vertices, solution.configuration.frames
    lengths = np.linalg.norm(np.diff(vertices, axis=1), axis=2)
    assert np.abs(lengths - start.rest_length).max() < 1e-10
    for row, pair in enumerate(kinds):
        ends = ((0, pair[0], clamps.start_position, clamps.start_frame), (-1, pair[1], clamps.end_position, clamps.end_frame))
        for end, kind, position, frame in ends:
            if kind >= Clamp.POSITION:
                assert np.linalg.norm(vertices[row, end] - position[row]) < 1e-9
            if kind >= Clamp.TANGENT:
                assert np.abs(frames[row, end, :, 0] - frame[row, :, 0]).max() < 1e-14
            if kind == Clamp.FRAME:
                assert np.abs(frames[row, end] - frame[row]).max() < 1e-14
    closed = np.array([min(pair) >= Clamp.POSITION for pair in kinds])
    assert (solution.closure[~closed] == 0).all()
    apart = np.linalg.norm(vertices[:, -1] - clamps.end_position, axis=1) / start.rest_length.sum(axis=1)
    np.testing.assert_allclose(solution.closure[closed], apart[closed], atol=1e-14)


@pytest.mark.parametrize("precision", ["f64", "f32"])
def test_energy_is_that_of_the_returned_shape(rng, precision):
    """Bend, twist and gravity of what came back, by the oracle, the constant μ z_0 Σ l̄ included."""
    start, clamps, _ = rods_under_all_clamps(rng)
    material = Material(definite(rng, len(PAIRS), EDGES), 2e5, 20.0, 0.01 * rng.normal(size=(len(PAIRS), EDGES - 1, 2)))
    up = np.array([0.3, -0.2, 0.9])
    solution = relax(start, material, clamps, up=up, precision=precision)
    for row in range(len(PAIRS)):
        state = State(solution.configuration.start[row], solution.configuration.quaternions[row].astype(np.float64))
        energy, size = energy_of(rod_of(start, material, row, up=up), state)
        assert abs(solution.energy[row] - energy) / size < (1e-13 if precision == "f64" else 4e-6)


HELD = (Clamp.FRAME, Clamp.FRAME)
SPOILED = {
    "a frame is not a number": ("quaternions", np.nan, HELD, Status.NOT_FINITE),
    "a clamp is not a number": ("end_position", np.nan, HELD, Status.INFEASIBLE),
    "clamps too far apart": ("end_position", 1e3, HELD, Status.INFEASIBLE),
    "a frame of zeros": ("quaternions", 0.0, (Clamp.POSITION, Clamp.FREE), Status.NOT_FINITE),
    "a clamp at infinity": ("start_position", np.inf, HELD, Status.INFEASIBLE),
    "a place that is not a number": ("start_position", np.nan, (Clamp.FRAME, Clamp.FREE), Status.NOT_FINITE),
    "a far place at infinity": ("end_position", np.inf, (Clamp.FREE, Clamp.FRAME), Status.NOT_FINITE)}
"""A field of the start or of the clamps, what rod BAD has there, how all are held, and the status that says so."""


@pytest.mark.sampled(len(SPOILED))
@pytest.mark.parametrize("how", SPOILED)
@pytest.mark.parametrize("solver, precision", [("newton", "f64"), ("descent", "f64"), ("newton", "f32"), ("newton", "mixed")])
def test_one_bad_rod_does_not_spoil_its_neighbours(rng, how, solver, precision):
    """Warnings are errors here: a rod that cannot be relaxed says so by its status alone."""
    start, clamps, _ = rods_under_all_clamps(rng, 24)
    (field, value, kinds, status), material = SPOILED[how], Material(2e5, 1e5, 1.0)
    clamps = replace(clamps, start=kinds[0], end=kinds[1])
    healthy = relax(start, material, clamps, SOLVERS[solver], precision=precision)
    getattr(start if field == "quaternions" else clamps, field)[BAD] = value
    solution = relax(start, material, clamps, SOLVERS[solver], precision=precision)
    others = np.flatnonzero(np.arange(24) != BAD)
    assert_same(solution, others, healthy, others)
    assert solution.status[BAD] == status and not solution.stable[BAD] and not solution.converged[BAD]
    for array in (solution.energy, solution.residual, solution.end_force, solution.configuration.vertices[:, 1:]):
        assert np.isnan(array[BAD]).all()
    assert status != Status.INFEASIBLE or solution.iterations[BAD] == 0


def test_two_edges_that_both_are_clamped_are_infeasible(rng):
    rods = wandering(rng, 3, 2)
    assert (relax(rods, Material(2e5, 1e5, 1.0), clamps_at(rods)).status == Status.INFEASIBLE).all()


BARS = {"nylon": 0.90, "vicryl": 0.85, "silk": 0.90}


@pytest.mark.parametrize("precision", ["f64", "f32", "mixed"])
@pytest.mark.parametrize("name", BARS)
def test_sutures_at_the_truth(laboratory, name, precision):
    rod = lab(laboratory, name)
    solution = certified(relax(rod.start, rod.material, rod.clamps, up=rod.observations.up, precision=precision))
    assert distance(solution.configuration, rod.observations).mean() <= BARS[name]


def test_ribbon_at_the_truth(laboratory):
    """Started from the measured frames; what is off is their noise, not the solver's choice of minimum."""
    rod = lab(laboratory, "ribbon")
    plain, careful = (certified(relax(rod.start, rod.material, rod.clamps, solver, up=rod.observations.up))
                      for solver in (Newton(), Newton.careful()))
    error, same = (distance(solution.configuration, rod.observations, frame_weight=RIBBON_WIDTH).mean()
                   for solution in (plain, careful))
    assert error == pytest.approx(same, rel=1e-3) and error < 2.0
