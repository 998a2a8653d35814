"""Rods that are curved at rest and roll freely in what holds them."""

import numpy as np
import pytest

from doo_ti import Clamp, Clamps, Observations, RefinementOptions, Theta, observation_clamps, refine, relax, start_configuration
from tools.studies.marks_study.specimens import clamps, drawn

LENGTH, BEND, CURVATURE, NOISE = 100.0, 4e5, 0.015, 0.1
TRUTH = Theta(BEND * np.eye(2), 0.8 * BEND, 1.0, [CURVATURE, 0.0])


def marks(rng, poses: int = 10, edges: int = 100, every: int = 5) -> np.ndarray:
    """(D, M, 3) mm: rods between ends that are held in place and direction, relaxed from cubic curves."""
    first, span, last = clamps(drawn("cable", 0), poses)
    held = Clamps(Clamp.TANGENT, Clamp.TANGENT, np.zeros((poses, 3)), LENGTH * span, first, last)
    s = np.linspace(0, 1, edges + 1)
    cubic = np.stack([s**3 - 2 * s**2 + s, 3 * s**2 - 2 * s**3, s**3 - s**2])
    curves = LENGTH * np.einsum("ks,kdx->dsx", cubic, np.stack([first[..., 0], span, last[..., 0]]))
    begun = start_configuration(Observations(curves, rest_length=np.full(edges, LENGTH / edges)), held, np.zeros(poses))
    rods = relax(begun, TRUTH.material, held)
    sound = rods.converged & rods.stable
    seen = rods.configuration.vertices[sound, ::every]
    return seen + NOISE * rng.normal(size=seen.shape)


@pytest.mark.thorough
def test_curved_rods_that_roll_freely_are_not_taken_for_soft_straight_ones(rng):
    """A radius of 67 mm: held at unknown rolls, or straight, such a rod seems to have two thirds of its stiffness."""
    seen = Observations(marks(rng), rest_length=np.full(20, LENGTH / 20))
    found = refine(seen, observation_clamps(seen), Theta(1.5 * BEND * np.eye(2), 1.2 * BEND), RefinementOptions())
    bend = found.estimate.parameter("bend")
    assert found.swivels and found.converged
    assert bend.low < BEND < bend.high < 2 * bend.low
    assert np.sqrt((found.theta.rest_curvature**2).sum(axis=1).mean()) == pytest.approx(CURVATURE, rel=0.25)
