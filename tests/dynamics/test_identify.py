"""Identification of a Θ under which synthetic recordings were made."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti import IdentifyOptions, MotionTheta, Observations, RecordedMotion, Stills, identify, identify_from_guesses
from doo_ti.commands.identify import _better_reversed
from doo_ti.dynamics.theta import Unknowns
from tests.conftest import check_refused
from tests.dynamics.recordings import RATE, recorded
from tests.references.rods import chain, stacked

TRUE = MotionTheta(
    bend=3e6, twist_ratio=1.0, bend_damping=0.04, drag=0.6, quadratic_drag=2e-4, marker_share=0.0,
    rest=1e-3 * np.array([[1.5, -1.0], [0.8, 0.6]]), rest_length=np.full(8, 50.0), reference=np.array([0.0, 1.0, 0.0]))
OPTIONS = IdentifyOptions(modes=2, horizons=(30, 10**6))
GUESS = replace(TRUE, bend=5e6, twist_ratio=0.7, bend_damping=0.02, drag=0.2, quadratic_drag=1e-5, rest=np.zeros((2, 0)))


def rolled_out(rng, count: int, free_end: bool = False) -> RecordedMotion:
    """``count`` recordings of 80 frames as TRUE moves on a mesh and with steps a fourth as long, from their first frames."""
    settled = RecordedMotion.of(recorded(rng, TRUE, count, 80, 0.0), RATE, free_end=free_end)
    halved = 7 if free_end else 6  # edges that grippers do not hold
    fine, marks = settled, np.arange(9)
    for _ in range(2):
        fine, _, own = fine.refined(fine.edge_lengths())
        marks = own[marks]
    true = replace(TRUE, rest_length=np.repeat([50.0, 12.5, 50.0], [1, 4 * halved, 7 - halved]))
    positions, status = replace(OPTIONS, substeps=4).rollouts(fine, true, 0).predicted([true])
    assert (status == 0).all() and (not free_end or np.abs(positions[:, 0] - fine.positions)[:, -1, -1].max() > 20.0)
    return RecordedMotion.of(positions[:, 0][:, :, marks], RATE, free_end=free_end)


@pytest.mark.parametrize("free_end", [False, pytest.param(True, marks=pytest.mark.thorough)])
def test_theta_is_found_from_recordings_without_noise(rng, free_end):
    """Of eight edges, whose own error would make the rod stiffer; with a free end, the last two markers count as well."""
    motion = rolled_out(rng, 4, free_end)
    assert motion.glitches() == [] and motion.predicted == slice(2, None if free_end else -2)
    found = identify(motion, GUESS, OPTIONS)
    turned = replace(motion, positions=motion.positions[:, :, ::-1])
    assert not free_end or _better_reversed(turned, OPTIONS, TRUE.up) and not _better_reversed(motion, OPTIONS, TRUE.up)
    bend = found.parameters()[0]
    assert not found.failed.any() and found.error.mean() < 0.3 and bend["low"] <= TRUE.bend <= bend["high"]
    assert abs(bend["value"] / TRUE.bend - 1) < (0.01 if free_end else 0.03) and found.rate_gain < 0.1
    if free_end:
        fast = identify(replace(motion, rate=1.06 * RATE), GUESS, OPTIONS)
        assert fast.rate == pytest.approx(RATE, rel=0.02) and fast.rate_gain > 0.5


LENGTH, EDGES = TRUE.rest_length.sum(), 12


def at_rest(rng, count: int, noise: float) -> Observations:
    """Rods of TRUE under gravity, in twelve edges, first edges near x; their marks with noise."""
    slopes = np.linspace(-1.0, 1.0, EDGES) * rng.uniform(0.8, 1.8, (count, 1))
    sides = rng.uniform(-0.4, 0.4, (count, 1)) * np.sin(np.linspace(0, np.pi, EDGES))
    rods = stacked([chain(np.stack([np.cos(a), np.sin(b), np.sin(a)], axis=-1), TRUE.reference, LENGTH / EDGES)
                    for a, b in zip(slopes, sides, strict=True)])
    seen = Observations(rods.vertices, rest_length=np.full(EDGES, LENGTH / EDGES))
    vertices = Stills.of(seen, TRUE.reference, LENGTH).rested(TRUE).configuration.vertices
    shaken = noise * rng.normal(size=vertices.shape)
    shaken[:, [0, 1, -2, -1]] = 0.0  # of what is held
    return Observations(vertices + shaken, rest_length=seen.rest_length, sigma=np.array(noise) if noise else None)


def slopes_and_differences(stills: Stills, theta: MotionTheta, unknowns: Unknowns) -> tuple[np.ndarray, np.ndarray]:
    """(P, …) derivatives of what is left of stills by each unknown, and their central differences."""
    p, slopes = unknowns.vector(theta), stills.slopes(theta, stills.rested(theta), unknowns)
    beside = [[stills.residuals(stills.rested(unknowns.theta(p + sign * step)))[0] for sign in (1, -1)]
              for step in 1e-4 * np.eye(len(p))]
    return np.moveaxis(slopes, 1, 0), np.array([ahead - behind for ahead, behind in beside]) / 2e-4


def test_derivatives_of_the_stills_are_differences(rng):
    stills = Stills.of(at_rest(rng, 3, 0.5), TRUE.reference, LENGTH)
    slopes, differences = slopes_and_differences(stills, TRUE, Unknowns(TRUE, 2, ("bend_damping", "twist_ratio")))
    assert slopes.shape == (7, 3, EDGES + 1, 3) and (slopes[1] == 0).all()
    for slope, difference in zip(slopes, differences, strict=True):
        assert np.abs(slope - difference).max() <= 1e-4 * np.abs(difference).max()


@pytest.mark.thorough
def test_still_frames_narrow_the_intervals(rng):
    """Four recordings of 1 mm noise alone, and with twelve still frames of 0.05 mm noise, three times; the truth is inside."""
    begin = replace(GUESS, quadratic_drag=TRUE.quadratic_drag)
    options = replace(OPTIONS, fitted=("bend_damping", "drag", "twist_ratio"))
    narrower, inside = [], []
    for _ in range(3):
        positions = rolled_out(rng, 4).positions
        positions[:, 2:, 2:-2] += rng.normal(size=positions[:, 2:, 2:-2].shape)  # mm, at all that is predicted
        motion, seen = RecordedMotion.of(positions, RATE), at_rest(rng, 12, 0.05)
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
    check_refused("rest_length_mm", Stills.of, seen, TRUE.reference, 1.3 * LENGTH)
    check_refused("start_frame", Stills.of, seen, seen.vertices[0, 1] - seen.vertices[0, 0], LENGTH)


@pytest.mark.thorough
@pytest.mark.parametrize("clip", [None, 20.0])
def test_a_beam_vibrates_as_theory_says(clip):
    """The first mode of a clamped beam by Euler and Bernoulli, EI/w = 1e10 mm³, that bends from half-way between its gripper's
    markers or, exactly held, from the inner one. Taken for the other one, its stiffness is off by a twentieth and more."""
    bending, spacing, markers, rate = 1e10, 20.0, 21, 4000.0
    begins = spacing * (0.5 if clip is None else 1.0)
    place, root = spacing * np.arange(markers) - begins, 1.8751040687
    length = place[-1]
    x = root * np.maximum(place, 0.0) / length
    share = (np.cosh(root) + np.cos(root)) / (np.sinh(root) + np.sin(root))
    mode = np.where(place > 0, 0.5 * (np.cosh(x) - np.cos(x) - share * (np.sinh(x) - np.sin(x))), 0.0)
    turn = np.cos(root**2 * np.sqrt(bending * 9806.65 / length**4) * np.arange(400) / rate)
    shapes = 10.0 * turn[:, None] * mode
    positions = np.stack([np.broadcast_to(place, shapes.shape), shapes, np.zeros_like(shapes)], axis=-1)
    motion = RecordedMotion.of(positions, rate, free_end=True)

    def found(own):
        return identify_from_guesses(motion, IdentifyOptions(modes=0, fitted=("bend_damping",), clip=own), 1e10).theta.bend / 2

    assert abs(found(clip) / bending - 1) < (0.03 if clip is None else 0.005)
    assert abs(found(spacing if clip is None else None) / bending - 1) > 0.05
    check_refused("clip: 21 mm; a gripper's inner marker is at 20 mm", motion.rest_length, 21.0)
