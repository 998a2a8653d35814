"""Θ from still frames and motion together: derivatives of the stills, narrower intervals, and stills that are refused."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti import InputError, Observations, RecordedMotion, Stills, identify
from doo_ti.dynamics.theta import Unknowns
from tests.dynamics.recordings import RATE
from tests.dynamics.test_identify import GUESS, OPTIONS, TRUE, rolled_out
from tests.references.rods import chain, stacked

LENGTH = TRUE.rest_length.sum()
EDGES = 12


def at_rest(rng, count: int, noise: float) -> Observations:
    """Rods of TRUE under gravity, in twelve edges, first edges near x; their marks with noise."""
    slopes = np.linspace(-1.0, 1.0, EDGES) * rng.uniform(0.8, 1.8, (count, 1))
    sides = rng.uniform(-0.4, 0.4, (count, 1)) * np.sin(np.linspace(0, np.pi, EDGES))
    rods = stacked([chain(np.stack([np.cos(a), np.sin(b), np.sin(a)], axis=-1), TRUE.reference, LENGTH / EDGES)
                    for a, b in zip(slopes, sides, strict=True)])
    seen = Observations(rods.vertices, rest_length=np.full(EDGES, LENGTH / EDGES))
    stills = Stills.of(seen, TRUE.reference, LENGTH)
    vertices = stills.rested(TRUE).configuration.vertices
    shaken = noise * rng.normal(size=vertices.shape)
    shaken[:, [0, 1, -2, -1]] = 0.0  # of what is held
    return Observations(vertices + shaken, rest_length=seen.rest_length, sigma=np.array(noise) if noise else None)


def test_derivatives_of_the_stills_are_differences(rng):
    stills = Stills.of(at_rest(rng, 3, 0.5), TRUE.reference, LENGTH)
    unknowns = Unknowns(TRUE, 2, ("bend_damping", "twist_ratio"))
    p = unknowns.vector(TRUE)
    slopes = stills.slopes(TRUE, stills.rested(TRUE), unknowns)
    assert slopes.shape == (3, len(p), EDGES + 1, 3) and (slopes[:, 1] == 0).all()
    for k in (0, 2, 3, 4, 5, 6):
        step = 1e-4 * np.eye(len(p))[k]
        ahead, behind = (stills.residuals(stills.rested(unknowns.theta(q)))[0] for q in (p + step, p - step))
        difference = (ahead - behind) / 2e-4
        assert np.abs(slopes[:, k] - difference).max() < 1e-4 * np.abs(difference).max(), unknowns.names[k]


def noisy(rng, count: int, noise: float) -> RecordedMotion:
    """Recordings of the rod TRUE with noise at all that is predicted."""
    motion = rolled_out(rng, count, 0.0)
    positions = motion.positions.copy()
    positions[:, 2:, 2:-2] += noise * rng.normal(size=positions[:, 2:, 2:-2].shape)
    return RecordedMotion.of(positions, RATE)


@pytest.mark.thorough
def test_still_frames_narrow_the_intervals(rng):
    """Four recordings of 1 mm noise alone, and with twelve still frames of 0.05 mm noise, three times; the truth is inside."""
    begin = replace(GUESS, quadratic_drag=TRUE.quadratic_drag)
    options = replace(OPTIONS, fitted=("bend_damping", "drag", "twist_ratio"))
    narrower, inside = [], []
    for _ in range(3):
        motion, seen = noisy(rng, 4, 1.0), at_rest(rng, 12, 0.05)
        alone = identify(motion, begin, options)
        together = identify(motion, begin, options, stills=[Stills.of(seen, TRUE.reference, LENGTH)])
        assert together.still_error.shape == (12,) and together.still_error.max() < 0.15
        narrower.append(np.sqrt(np.diag(together.covariance) / np.diag(alone.covariance)))
        truth = alone.unknowns.intervals(alone.unknowns.vector(TRUE), 0.0 * together.covariance, 1)
        inside += [row["low"] is None or row["low"] <= one["value"] <= row["high"]
                   for row, one in zip(together.parameters(), truth, strict=True)]
    narrower = np.median(narrower, axis=0)
    print("intervals with stills over those without", dict(zip(together.unknowns.names, narrower.round(2), strict=True)))
    print(f"{np.mean(inside):.0%} hold the truth")
    assert narrower[-4:].max() < 0.8 and np.median(narrower[-4:]) < 0.5 and np.mean(inside) > 0.8


def test_hidden_marks_and_rods_that_fail_do_not_count(rng):
    seen = at_rest(rng, 4, 0.1)
    hidden = replace(seen, valid=np.arange(EDGES + 1) != np.array([[4], [5], [6], [7]]))
    stills = Stills.of(hidden, TRUE.reference, LENGTH)
    apart, used = stills.residuals(stills.rested(TRUE))
    assert used.all() and (apart[~hidden.valid] == 0).all() and (apart[hidden.valid] != 0).any()
    assert stills.variance(apart, used) == pytest.approx(0.01)
    assert Stills.of(replace(hidden, sigma=None), TRUE.reference, LENGTH).variance(apart, used) < 0.02


def test_stills_of_another_rod_are_refused(rng):
    seen = at_rest(rng, 2, 0.1)
    with pytest.raises(InputError, match="rest_length_mm"):
        Stills.of(seen, TRUE.reference, 1.3 * LENGTH)
    with pytest.raises(InputError, match="start_frame"):
        Stills.of(seen, seen.vertices[0, 1] - seen.vertices[0, 0], LENGTH)
