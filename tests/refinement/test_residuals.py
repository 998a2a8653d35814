"""The mesh between the clips, the rest curvature on it, the places of marks; derivatives of all residuals by all unknowns."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from doo_ti import Clamp, Newton, Plane, Surroundings, Theta
from doo_ti.refinement.fit import Fit
from doo_ti.refinement.held_rod import POSE, TURNS
from doo_ti.refinement.mesh import Field, Lengths, knots_of, values_at
from doo_ti.refinement.refine import mesh_correction, relaxed_on
from doo_ti.refinement.unknowns import Unknowns
from doo_ti.rod.frames import right_jacobian, rotation_matrix
from tests.refinement.rods_between_clips import TRUTH, held, model, suture


@pytest.mark.thorough
@pytest.mark.parametrize("kinds, count", [((None, None), 39), ((Clamp.POSITION, None), 39.5), ((None, Clamp.FREE), 39.5)])
def test_edges_share_what_lies_between_the_clips(kinds, count):
    rod = held(suture(1), 40, kinds)
    clip, spacing = np.array([1.7, 3.1]), rod.observations.rest_length
    mesh, free = rod.mesh(Lengths(clip, spacing)), 99.0 - clip[rod.clamped].sum()
    assert mesh.edge == pytest.approx(free / count)
    if rod.clamped[0]:  # the middle of the first edge is where the clip lets go
        assert mesh.place[:2].mean() == pytest.approx(1.7)
    if rod.clamped[1]:
        assert mesh.place[-2:].mean() == pytest.approx(99.0 - 3.1)
    for end in range(2):
        step = 1e-6 * np.eye(2)[end]
        above, below = (rod.mesh(Lengths(clip + sign * step, spacing)) for sign in (1, -1))
        assert mesh.edge_slope[end] == pytest.approx((above.edge - below.edge) / 2e-6, abs=1e-8)
        np.testing.assert_allclose(mesh.slope(mesh.joints)[:, end], (above.joints - below.joints) / 2e-6, atol=1e-7)


def test_marks_are_interpolated_to_the_third_order():
    mesh = held(suture(1), 40).mesh(Lengths(np.array([2.0, 2.0]), np.full(33, 3.0)))
    weights, slopes = mesh.at(np.linspace(8.0, 90.0, 17))
    for power in range(4):
        np.testing.assert_allclose(weights @ mesh.place**power, np.linspace(8.0, 90.0, 17) ** power, rtol=1e-10)
    np.testing.assert_allclose(slopes @ mesh.place, mesh.edge, rtol=1e-10)
    np.testing.assert_allclose(mesh.at(np.array([0.0, 1.0]))[0] @ mesh.place, [0.0, 1.0], atol=1e-12)


def test_turns_and_their_jacobian(rng):
    turn, change = 0.4 * rng.normal(size=(5, 3)), 1e-6 * rng.normal(size=(5, 3))
    np.testing.assert_allclose(rotation_matrix(turn), Rotation.from_rotvec(turn).as_matrix(), atol=1e-14)
    moved = rotation_matrix(turn) @ rotation_matrix(np.einsum("dij,dj->di", right_jacobian(turn), change))
    np.testing.assert_allclose(rotation_matrix(turn + change), moved, atol=1e-11)


def test_the_field_is_linear_between_knots_and_its_covariance_slopes_as_it_says(rng):
    knots, values = np.sort(rng.uniform(0, 90, 8)), rng.normal(size=8)
    place = np.linspace(-5, 95, 23)
    weights, slopes = values_at(place, knots)
    np.testing.assert_allclose(weights @ values, np.interp(place, knots, values), atol=1e-12)
    above, below = (values_at(place + step, knots)[0] @ values for step in (1e-7, -1e-7))
    smooth = np.abs(place[:, None] - knots).min(axis=1) > 1e-5
    np.testing.assert_allclose((slopes @ values)[smooth], ((above - below) / 2e-7)[smooth], atol=1e-6)
    field = Field("curvature", "range", knots, 2, 1.0)
    matrix, slope = field.covariance({"curvature": 2e-3, "range": 12.0})
    wider, narrower = (field.covariance({"curvature": 2e-3, "range": 12.0 * np.exp(step)})[0] for step in (1e-5, -1e-5))
    np.testing.assert_allclose(slope, (wider - narrower) / 2e-5, atol=1e-12)
    assert np.linalg.eigvalsh(matrix).min() > 0 and matrix[0, 0] == pytest.approx(4e-6, rel=1e-5)
    assert len(knots_of(np.full(200, 1.0))) == 16 and len(knots_of(np.full(12, 3.0))) == 11


def test_the_corrected_mesh_is_close_to_a_very_fine_one():
    """Marks of 40 edges, corrected, against those of 640: the error decreases by an order of magnitude."""
    seen = suture(2, label_noise_mm=0.0)
    unknowns = Unknowns(held(seen, 40), ("bend", "twist"))
    values = unknowns.begun(TRUTH, np.array([2.25, 2.25]))
    values = replace(values, curvature=1e-3 * np.ones_like(values.curvature))
    rod, solver, none, lengths = unknowns.rod, Newton(), np.zeros((seen.count, POSE)), unknowns.lengths(values)
    coarse = rod.relaxed(unknowns.material(values), lengths, none, TRUTH.up, solver)
    finest = replace(unknowns, rod=replace(rod, edges=640))
    off = rod.marks(coarse, lengths) - finest.rod.marks(relaxed_on(finest, values, coarse, rod, solver), lengths)
    before, after = (np.abs(one).max() for one in (off, off + mesh_correction(unknowns, values, coarse, solver)))
    assert 0.01 < before < 0.5 and after < 0.15 * before


SHARP = Newton(tolerance=1e-10)
RIBBON = Theta([[6e5, 1e5], [1e5, 3e5]], 3e5, 1.2, up=np.array([0.1, -0.05, 1.0]) / np.sqrt(1.0125))


@pytest.mark.sampled(1)
@pytest.mark.parametrize("theta, parameters, kinds, fields", [
    (TRUTH, ("bend", "twist"), (None, None), {}),
    (TRUTH, ("bend", "twist", "weight", "up"), (Clamp.TANGENT, Clamp.FRAME), {"curvature": "uniform"}),
    (TRUTH, ("twist", "bend"), (None, None), {"uneven": True}),
    (TRUTH, ("bend", "weight"), (None, Clamp.FREE), {"uneven": True, "curvature": "none", "twist_follows": True}),
    (TRUTH, ("twist",), (None, None), {"uneven": True, "with_frames": True}),
    (TRUTH, ("bend",), (None, None), {"twist_follows": True}),
    (RIBBON, ("bend_1", "bend_2"), (None, None), {"twist_follows": True}),
    (TRUTH, ("bend",), (Clamp.FRAME, Clamp.POSITION), {"clips": False}), (TRUTH, ("bend", "up"), (Clamp.FRAME, Clamp.FREE), {}),
    (RIBBON, ("bend_1", "bend_2", "bend_12", "twist"), (None, None), {"with_frames": True}),
    (TRUTH, ("bend", "twist"), (None, None), {"bare": ("start_frame", "end_frame")}),
    (TRUTH, ("bend", "twist"), (None, None), {"bare": ("start_frame",)}),
    (TRUTH, ("bend",), (Clamp.POSITION, None), {"bare": ("start_frame", "end_frame")}),
    (TRUTH, ("bend", "twist"), (None, Clamp.FREE), {"table": 4.0, "uneven": True}),
    (TRUTH, ("bend", "weight"), (None, Clamp.FREE), {"bodies": [9, 20]}),
    (TRUTH, ("bend", "twist"), (None, Clamp.FREE), {"table": 4.0, "bodies": [20]}),
    (TRUTH, ("bend",), (None, None), {"table": -0.1}), (TRUTH, ("bend", "twist"), (None, Clamp.FREE), {"table": 4.0})])
def test_residuals_follow_the_unknowns(rng, theta, parameters, kinds, fields):
    """J and Z of :class:`doo_ti.refinement.residuals.Comparison` by central differences, with clips of unequal lengths, a
    curvature, a stiffness along the rod, spacings that are off, and clamps that are already off, with and without reported
    frames; of rods that a table holds up, of which nothing goes along when their start is lifted, or of which the
    start lies on the table and cannot be lower; with bodies at marks."""
    seen = suture(2, frames=fields.get("with_frames", False)).take([0, 1, 4])
    seen = replace(seen, spacing_error=0.02, **dict.fromkeys(fields.pop("bare", ()), None))
    rod, higher = held(seen, 34, kinds), fields.pop("table", None)
    if marks := fields.pop("bodies", ()):
        rod = replace(rod, loads=np.isin(np.arange(34), marks) * [[0.0], [5.0], [8.0]])
    if higher is not None:
        clips = Lengths(np.array([2.1, 3.4]), seen.rest_length)
        hanging = rod.relaxed(theta.material, clips, np.zeros((3, POSE)), theta.up, SHARP).configuration.vertices
        point = (hanging[..., 2].min(axis=1) + higher)[:, None] * (0, 0, 1)
        rod = replace(rod, surroundings=Surroundings([Plane(point, (0, 0, 1))], 0.5))
    comparison, scales = model(rod, parameters, **fields)
    unknowns = comparison.unknowns
    values = unknowns.begun(theta, np.array([2.1, 3.4]))
    values = replace(values, curvature=1e-3 * rng.normal(size=values.curvature.shape),
                     stiffness=0.1 * rng.normal(size=values.stiffness.shape))
    if not rod.exact:
        values = replace(values, constant=1e-2 * rng.normal(size=TURNS), scatter=0.1 * rng.normal(size=(3, POSE)))
    values = replace(values, spacing=0.01 * rng.normal(size=seen.edges))
    fit = Fit(comparison, values, SHARP)
    pose, lengths = unknowns.pose(values), unknowns.lengths(values)
    state = fit.at(values, scales, rod.relaxed(unknowns.material(values), lengths, pose, theta.up, SHARP))
    assert (state.solution.converged & state.solution.stable).all()
    linear, used = comparison.linear(state.solution, values, np.ones(3, dtype=bool))
    assert used.all()
    shared = np.concatenate([kind.shared for kind in linear], axis=1)
    effects = np.concatenate([kind.effects for kind in linear], axis=1)
    for kind, alone in zip(linear, comparison.linear(state.solution, values, used, False, shared=False)[0], strict=True):
        assert alone.shared.shape[2] == 0
        np.testing.assert_allclose(alone.effects, kind.effects, atol=1e-9 * max(np.abs(kind.effects).max(initial=0.0), 1.0))

    def residuals(step, scatter):
        now = fit.unknowns.moved(state.values, step, np.tile(scatter, (3, 1)))
        return np.concatenate(comparison.values(fit.at(now, state.scales, state.solution).solution, now), axis=1)

    shared_only = len(unknowns.names)
    derivatives = np.concatenate([shared, effects], axis=2)[..., : shared_only + (0 if rod.exact else POSE)]
    for k, step in enumerate(1e-4 * np.eye(shared_only + POSE)[: derivatives.shape[2]]):
        above, below = (residuals(*np.split(sign * step, [shared_only])) for sign in (1, -1))
        expected = (above - below) / 2e-4
        np.testing.assert_allclose(derivatives[..., k], expected, err_msg=f"column {k} of {unknowns.names} and the pose",
                                   atol=1e-5 * max(np.abs(expected).max(), 1e-3 * np.abs(shared).max()))


def test_marks_that_an_exact_clamp_was_taken_from_do_not_count():
    def left_out(seen, kinds=(None, None), exact=True) -> list[int]:
        return np.flatnonzero(model(replace(held(seen, kinds=kinds), exact=exact))[0].weight[0] == 0).tolist()

    seen = suture(1)
    assert left_out(seen) == [0, 33] and left_out(seen, exact=False) == [] and left_out(seen, (None, Clamp.FREE)) == [0]
    assert left_out(replace(seen, start_frame=None)) == [0, 1, 33]
    assert left_out(replace(seen, valid=seen.valid & (np.arange(34) != 9)), exact=False) == [9]
    assert model(held(replace(seen, sigma=np.array(0.2))))[0].weight[0, 9] == pytest.approx(5.0)
