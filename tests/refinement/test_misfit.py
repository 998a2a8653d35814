"""Both objectives' gradients against finite differences of rods relaxed again; what counts in χ²."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti import Clamp, Material, Newton, Observations, distance, observation_clamps, relax, relax_again
from doo_ti.refinement.misfit import distance_gradient, misfit
from doo_ti.refinement.sensitivity import sensitivity
from tests.data.rods import wavy_vertices
from tests.references.rods import chain
from tests.relax.lab import RIBBON_WIDTH, SUTURES, lab

SHARP = Newton(tolerance=1e-12, first_shift=0.0)
STEPS = (2e-3, 6e-4, 2e-4, 6e-5)  # of a logarithm: rods near the end of their branch need small ones, where rounding shows


def differences(value):
    """(R,) d value/d step at zero: of five-point differences with each of STEPS, the one that is nearest to the one before."""
    found = np.stack([(8 * (value(h) - value(-h)) - (value(2 * h) - value(-2 * h))) / (12 * h) for h in STEPS])
    settled = np.argmin(np.abs(np.diff(found, axis=0)), axis=0)
    return found[settled + 1, np.arange(found.shape[1])]


@pytest.mark.parametrize("name", [*SUTURES, "ribbon"])
def test_gradients_are_those_of_rods_relaxed_again(shared_data, rng, name):
    """Fifty random (Θ, observation) of the four materials together, 13 of each."""
    rods = lab(shared_data, name).take(rng.choice(60, 13, replace=False))
    weight = RIBBON_WIDTH if name == "ribbon" else 0.0
    bend, twist = (rng.uniform(-1, 1, (13, 2)), rng.uniform(-1, 1, 13))
    columns = ("bend_1", "bend_2", "twist", "weight")

    def material(column=0, step=0.0):
        logs = np.concatenate([bend if name == "ribbon" else bend[:, [0, 0]], twist[:, None], np.zeros((13, 1))], axis=1)
        logs[:, column] += step
        factors = np.exp(logs)
        return Material.diagonal(rods.bend[0, 0] * factors[:, 0], rods.bend[1, 1] * factors[:, 1],
                                 rods.twist * factors[:, 2], factors[:, 3])

    solution = relax(rods.start, material(), rods.clamps, SHARP)
    found = sensitivity(solution, columns)
    assert found.usable.all()
    compared = misfit(rods.observations, rods.clamps, weight)
    own = {"distance": distance_gradient(found, rods.observations, weight),
           "squares": 2 * np.einsum("dn,dnp->dp", compared.residuals(solution.configuration), compared.derivatives(found))}
    at = material()
    values = np.stack([at.bend[:, 0, 0, 0], at.bend[:, 0, 1, 1], at.twist[:, 0], at.weight], axis=1)
    for column in range(len(columns)):
        moved = {step: relax_again(solution, material(column, step), SHARP).configuration
                 for h in STEPS for step in (-2 * h, -h, h, 2 * h)}
        for objective, value in (("distance", lambda at: distance(at, rods.observations, frame_weight=weight)),
                                 ("squares", lambda at: (compared.residuals(at) ** 2).sum(axis=1))):
            expected = differences(lambda step, value=value, moved=moved: value(moved[step]))
            error = np.abs(own[objective][:, column] * values[:, column] - expected)
            worst = (error / np.abs(own[objective] * values).max(axis=1)).max()
            print(f"{name}, {objective}, {columns[column]}: {worst:.1e}")
            assert worst < 1e-6


@pytest.fixture
def observed(rng) -> Observations:
    return Observations(wavy_vertices(rng))


def test_marks_that_clamps_hold_or_nobody_saw_do_not_count(observed):
    valid = np.ones((3, 9), dtype=bool)
    valid[1, 4] = False
    seen = replace(observed, valid=valid, sigma=np.array(0.5))
    for kind, held in ((Clamp.FREE, 0), (Clamp.POSITION, 1), (Clamp.TANGENT, 2)):
        found = misfit(seen, observation_clamps(seen, Clamp.TANGENT, kind))
        expected = valid.copy()
        expected[:, :2] = False
        expected[:, 9 - held :] = False
        np.testing.assert_array_equal(found.vertex_weight, np.where(expected, 2.0, 0.0))
        np.testing.assert_array_equal(found.numbers, 3 * expected.sum(axis=1))
    assert found.directors is None


def test_frames_count_where_their_spin_is_not_held(observed):
    tangents = np.diff(observed.vertices, axis=1)
    frames = np.stack([chain(t, [0.0, 0.3, 1.0], 3.0).frames[0] for t in tangents])
    observed = replace(observed, frames=frames, start_frame=frames[:, 0], sigma=np.full((3, 9), 0.2))
    found = misfit(observed, observation_clamps(observed, Clamp.FRAME, Clamp.TANGENT), 6.0)
    np.testing.assert_allclose(found.frame_weight[:, 1:], 30.0)
    np.testing.assert_array_equal(found.frame_weight[:, 0], 0.0)
    np.testing.assert_array_equal(found.numbers, 3 * 5 + 2 * 7)


def test_a_mark_that_is_met_exactly_has_no_gradient(rng):
    rods = chain(np.tile([1.0, 0.0, 0.0], (8, 1)) + 0.1 * rng.normal(size=(8, 3)), [0, 0, 1], 3.0)
    seen = Observations(rods.vertices)
    solution = relax(rods, Material(1e5, 1e5), observation_clamps(seen), SHARP)
    seen = replace(seen, vertices=solution.configuration.vertices)
    assert (distance_gradient(sensitivity(solution), seen) == 0).all()
