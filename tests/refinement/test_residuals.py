"""The derivatives of all residuals with respect to all unknowns, against rods relaxed again."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti import Clamp, Newton, Theta
from doo_ti.refinement.fit import Fit
from doo_ti.refinement.held_rod import POSE
from doo_ti.refinement.unknowns import TURNS
from tests.refinement.rods_between_clips import TRUTH, held, model, suture

SHARP = Newton(tolerance=1e-10)
RIBBON = Theta([[6e5, 1e5], [1e5, 3e5]], 3e5, 1.2, up=np.array([0.1, -0.05, 1.0]) / np.sqrt(1.0125))


def moved_residuals(comparison, fit, state, step, scatter):
    values = fit.unknowns.moved(state.values, step, scatter)
    return np.concatenate(comparison.values(fit.at(values, state.scales, state.solution).solution, values), axis=1)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("theta, parameters, kinds, fields", [
    (TRUTH, ("bend", "twist"), (None, None), {}),
    (TRUTH, ("bend", "twist", "weight", "up"), (Clamp.TANGENT, Clamp.FRAME), {"curvature": "uniform"}),
    (TRUTH, ("bend",), (Clamp.FRAME, Clamp.POSITION), {"clips": False}),
    (TRUTH, ("bend", "up"), (Clamp.FRAME, Clamp.FREE), {}),
    (RIBBON, ("bend_1", "bend_2", "bend_12", "twist"), (None, None), {"with_frames": True}),
    (TRUTH, ("bend", "twist"), (None, None), {"bare": ("start_frame", "end_frame")}),
    (TRUTH, ("bend", "twist"), (None, None), {"bare": ("start_frame",)}),
    (TRUTH, ("bend",), (Clamp.POSITION, None), {"bare": ("start_frame", "end_frame")}),
])
def test_residuals_follow_the_unknowns(rng, theta, parameters, kinds, fields):
    """J and Z of :class:`doo_ti.refinement.residuals.Comparison` by central differences, with clips of unequal lengths, a
    curvature, spacings that are off, and clamps that are already off, with and without reported frames."""
    seen = suture(2, frames=fields.get("with_frames", False)).take([0, 1, 4])
    seen = replace(seen, spacing_error=0.02, **dict.fromkeys(fields.pop("bare", ()), None))
    rod = held(seen, 34, kinds)
    comparison, scales = model(rod, parameters, **fields)
    unknowns = comparison.unknowns
    values = unknowns.begun(theta, np.array([2.1, 3.4]))
    values = replace(values, curvature=1e-3 * rng.normal(size=values.curvature.shape))
    if not rod.exact:
        values = replace(values, constant=1e-2 * rng.normal(size=TURNS), scatter=0.1 * rng.normal(size=(3, POSE)))
    values = replace(values, spacing=0.01 * rng.normal(size=seen.edges))
    fit = Fit(comparison, values, SHARP)
    pose, lengths = unknowns.pose(values), unknowns.lengths(values)
    state = fit.at(values, scales, rod.relaxed(unknowns.material(values), lengths, pose, SHARP, theta.up))
    assert (state.solution.converged & state.solution.stable).all()
    linear, used = comparison.linear(state.solution, values, np.ones(3, dtype=bool))
    assert used.all()
    shared = np.concatenate([kind.shared for kind in linear], axis=1)
    effects = np.concatenate([kind.effects for kind in linear], axis=1)
    for kind, alone in zip(linear, comparison.linear(state.solution, values, used, False, shared=False)[0], strict=True):
        assert alone.shared.shape[2] == 0
        np.testing.assert_allclose(alone.effects, kind.effects, atol=1e-9 * max(np.abs(kind.effects).max(initial=0.0), 1.0))
    none, still = np.zeros(len(unknowns.names)), np.zeros((3, POSE))
    columns = [(unknowns.names[k], none + np.eye(len(none))[k], still, shared[..., k]) for k in range(len(none))]
    if not rod.exact:
        columns += [(f"pose {q}", none, still + np.eye(POSE)[q], effects[..., q]) for q in range(POSE)]
    largest = np.abs(shared).max()
    for name, step, scatter, own in columns:
        size = 1e-4
        expected = (moved_residuals(comparison, fit, state, size * step, size * scatter)
                    - moved_residuals(comparison, fit, state, -size * step, -size * scatter)) / (2 * size)
        np.testing.assert_allclose(own, expected, atol=1e-5 * max(np.abs(expected).max(), 1e-3 * largest), err_msg=name)


def test_marks_that_an_exact_clamp_was_taken_from_do_not_count():
    def left_out(seen, kinds=(None, None), exact=True) -> list[int]:
        return np.flatnonzero(model(replace(held(seen, kinds=kinds), exact=exact))[0].weight[0] == 0).tolist()

    seen = suture(1)
    assert left_out(seen) == [0, 33] and left_out(seen, exact=False) == [] and left_out(seen, (None, Clamp.FREE)) == [0]
    assert left_out(replace(seen, start_frame=None)) == [0, 1, 33]
    missing = seen.valid.copy()
    missing[0, 9] = False
    assert left_out(replace(seen, valid=missing), exact=False) == [9]
    assert model(held(replace(seen, sigma=np.array(0.2))))[0].weight[0, 9] == pytest.approx(5.0)
