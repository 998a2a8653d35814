"""The virtual lab: what observations contain, clips whose real pose is another one; and the rods that are timed."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from doo_ti import Clamp, Clamps, InterruptedRunError, Material, relax
from doo_ti.io.scene import Synthesis
from doo_ti.lab import cases as timed
from doo_ti.lab import synthesis as lab
from doo_ti.lab import workload
from doo_ti.lab.cases import Case, Outcome, Specimens, measure
from doo_ti.lab.synthesis import ClipErrors, fine_vertices, synthesise
from doo_ti.relaxation import batch
from doo_ti.rod.frames import quaternion_from_matrix
from tests.io.rods import joint_twist
from tests.references.rods import chain, clamps_at

DISTANCES, ROTATIONS = (42.0, 66.0, 84.0), (0.0, 90.0, 180.0, 270.0)
ROUND = Synthesis(bend=6e5, twist=8e5, seed=4, end_distances_mm=DISTANCES, end_rotations_deg=ROTATIONS)
FLAT = replace(ROUND, bend=((6e6, 0.0), (0.0, 1.2e5)), twist=5e5, frames=True)

both = pytest.mark.parametrize("recipe", [ROUND, FLAT], ids=["round", "flat"])
observed = cache(synthesise)


def quiet(recipe: Synthesis) -> Synthesis:
    """The same rod, its marks read off without error."""
    return replace(recipe, label_noise_mm=0.0)


@pytest.mark.thorough
@both
def test_the_same_recipe_gives_the_same_observations(recipe):
    first, second = observed(recipe), synthesise(replace(recipe, clip_mm=(3.0, 3.0)))
    for name in ("vertices", "rest_length", *["frames"] * recipe.frames):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    assert np.abs(synthesise(replace(recipe, seed=5)).vertices - first.vertices)[:, 5:-5].max() > 0.1


@pytest.mark.sampled(1)
@pytest.mark.parametrize("recipe", [ROUND, FLAT, replace(ROUND, clip_mm=(2.0, 7.0))], ids=["round", "flat", "unequal clips"])
def test_clips_hold_straight_pieces_where_they_should(recipe):
    """Marks in a clip, its inner edge included, lie on its axis, free of noise; the frames are the clips'."""
    observations, rods = observed(recipe), lab.fine_vertices(recipe)
    near, far = (np.array(d) / np.linalg.norm(d) for d in (recipe.start_direction, recipe.end_direction))
    first, last = (round(clip) for clip in recipe.clips_mm)
    steps = np.diff(rods, axis=1)
    np.testing.assert_allclose(steps[:, :first], np.broadcast_to(near, (12, first, 3)), atol=1e-9)
    np.testing.assert_allclose(steps[:, -last:], np.broadcast_to(far, (12, last, 3)), atol=1e-9)
    assert (np.linalg.norm(steps[:, first] - near, axis=1) > 1e-4).all()
    assert (np.linalg.norm(steps[:, -last - 1] - far, axis=1) > 1e-4).all()
    noise = observations.vertices - rods[:, ::3]
    first, last = 1 + first // 3, 1 + last // 3
    assert (noise[:, :first] == 0).all() and (noise[:, first] != 0).all()
    assert (noise[:, -last:] == 0).all() and (noise[:, -last - 1] != 0).all()
    np.testing.assert_allclose(rods[:, 0], 0, atol=1e-12)
    np.testing.assert_allclose(rods[:, -1], np.outer(observations.end_distance, [1, 0, 0]), atol=1e-10)
    for frame, axis in ((observations.start_frame, near), (observations.end_frame, far)):
        np.testing.assert_allclose(frame[..., 0], np.tile(axis, (12, 1)), atol=1e-12)
    np.testing.assert_array_equal(observations.end_distance, np.tile(DISTANCES, 4))
    np.testing.assert_array_equal(observations.end_rotation, np.repeat(ROTATIONS, 3))


def test_the_end_clip_turns_by_the_end_rotation():
    """About its own axis, from where it is at 0°, the same for every distance."""
    frames = observed(ROUND).end_frame.reshape(4, 3, 3, 3)
    for turn, frame in zip(np.radians(ROTATIONS), frames, strict=True):
        np.testing.assert_allclose(frame, np.tile(frame[:1], (3, 1, 1)), atol=1e-12)
        expected = np.cos(turn) * frames[0, 0, :, 1] + np.sin(turn) * frames[0, 0, :, 2]
        np.testing.assert_allclose(frame[0, :, 1], expected, atol=1e-12)


@pytest.mark.sampled(1)
@both
def test_noise_is_of_the_asked_for_size(recipe):
    """The same seed gives the same shapes without noise; on request there is noise on held marks, that of others stays."""
    noisy, clean = observed(recipe), observed(quiet(recipe))
    inner = (noisy.vertices - clean.vertices)[:, 2:-2]
    assert abs(inner.mean()) < 4 * recipe.label_noise_mm / np.sqrt(inner.size)
    assert inner.std() == pytest.approx(recipe.label_noise_mm, rel=0.06)
    if recipe.frames:
        assert (noisy.frames[:, 0] == clean.frames[:, 0]).all() and (noisy.frames[:, -1] == clean.frames[:, -1]).all()
        assert (np.abs(noisy.frames - clean.frames)[:, 1:-1].max(axis=(2, 3)) > 0).all()
    everywhere = synthesise(replace(recipe, end_mark_noise=True)).vertices
    np.testing.assert_array_equal(everywhere[:, 2:-2], noisy.vertices[:, 2:-2])
    held = (everywhere - noisy.vertices)[:, [0, 1, -2, -1]]
    assert held.std() == pytest.approx(recipe.label_noise_mm, rel=0.25) and (held != 0).all()


@pytest.mark.parametrize("reach", [0.0, 4.0, 25.0])
def test_rest_curvature_has_the_asked_for_size_and_is_smooth_over_its_range(reach):
    """The same pointwise size on any mesh, correlated by exp(-s²/(2 range²)), the two directions independent."""
    for edge in (0.5, 1.0):
        recipe = replace(ROUND, length_mm=6000.0, marks=2001, fine_edge_mm=edge, end_distances_mm=(2000.0,),
                         rest_curvature_range_mm=reach)
        rest = lab.specimen_material(recipe, np.random.default_rng(recipe.seed)).rest_curvature[0] * 900
        apart = max(reach, edge)
        few = 1 / np.sqrt(6000 / apart)  # about as many independent values
        np.testing.assert_allclose(rest.std(axis=0), 1.0, atol=3 * few)
        assert (np.abs(rest.mean(axis=0)) < 8 * few).all() and abs(np.mean(rest[:, 0] * rest[:, 1])) < 4 * few
        for share in (0.5, 1.0, 2.0)[reach == 0 :]:
            lag, expected = round(share * apart / edge), np.exp(-(share**2) / 2) * (reach > 0)
            assert abs(np.mean(rest[lag:] * rest[:-lag]) - expected) < 4 * few


def test_twist_labels_name_the_turn():
    """To the nearest 30°, whole turns included: within half a turn of the truth, which is all they are used for."""
    observations = observed(quiet(FLAT))
    label = np.degrees(observations.total_twist)
    np.testing.assert_allclose(label / 30, np.round(label / 30), atol=1e-9)
    truth = np.degrees(joint_twist(quaternion_from_matrix(observations.frames)).sum(axis=1))
    assert np.abs(label - truth).max() < 180 < np.ptp(label)


def test_a_rod_that_cannot_reach_is_named():
    with pytest.raises(InterruptedRunError, match="98.9 mm"):
        synthesise(replace(ROUND, end_distances_mm=(98.9,)))


def test_a_plastic_rod_keeps_the_excess_as_rest_curvature(rng):
    """An even arc: released from its clamps it is bent by its curvature less the yield curvature."""
    turn, edge, limit = 0.1, 2.0, 0.02
    angle = turn * np.arange(12)
    arc = chain(np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1), [0, 0, 1], edge)
    straight = Material(6e5, 8e5, 0.0, np.zeros((1, 11, 2)))
    bent = lab.yielded(straight, arc, limit)
    free = relax(arc, bent, Clamps(Clamp.FRAME, Clamp.FREE, *(getattr(clamps_at(arc), name) for name in (
        "start_position", "end_position", "start_frame", "end_frame"))))
    t = free.configuration.frames[0, :, :, 0]
    left = np.arccos(np.clip(np.sum(t[1:] * t[:-1], axis=1), -1, 1))
    assert free.converged.all()
    np.testing.assert_allclose(2 * np.tan(left / 2), 2 * np.tan(turn / 2) - limit * edge, rtol=1e-6)
    np.testing.assert_array_equal(lab.yielded(straight, arc, 1.0).rest_curvature, 0)
    elastic, plastic = observed(quiet(ROUND)), synthesise(replace(quiet(ROUND), yield_curvature_per_mm=0.02))
    off = np.linalg.norm(elastic.vertices - plastic.vertices, axis=-1).mean(axis=1)
    assert off[elastic.end_distance == 42.0].min() > 0.1 and np.isfinite(off).all()


IDEAL = replace(ROUND, end_rotations_deg=(0.0, 90.0, 180.0), label_noise_mm=0.0)
RIBBON = replace(IDEAL, bend=FLAT.bend, twist=FLAT.twist, frames=True)
TILT, OFFSET = {"clip_tilt_deg": 2.0}, {"clip_offset_mm": 0.4}


def errors_of(recipe: Synthesis) -> ClipErrors:
    return ClipErrors.drawn(recipe.seed, 9, tilt=np.radians(recipe.clip_tilt_deg), offset=recipe.clip_offset_mm,
                            scatter=np.radians(recipe.clip_scatter_deg))


def seen_in(frame: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """(D, 3) components of vectors (D, 3) along t, m1, m2 of frames (D, 3, 3)."""
    return np.einsum("dij,di->dj", frame, vector)


def test_draws_have_the_asked_for_size():
    many = [ClipErrors.drawn(seed, 5, tilt=0.03, offset=0.2, scatter=0.01) for seed in range(400)]
    for name, size in (("tilt", 0.03), ("offset", 0.2), ("scatter", 0.01)):
        values = np.array([getattr(one, name) for one in many])
        assert values.std() == pytest.approx(size, rel=0.08) and abs(values.mean()) < 4 * size / np.sqrt(values.size)
    none, tilted = (ClipErrors.drawn(3, 5, tilt=tilt, offset=0.0, scatter=0.0) for tilt in (0.0, 0.03))
    assert many[3].any and many[3].vary and tilted.any and not (none.any or none.vary or tilted.vary)
    np.testing.assert_array_equal(tilted.tilt, many[3].tilt)  # one size does not change the draws of another


@pytest.mark.thorough
@pytest.mark.parametrize("wrong", [TILT, OFFSET, {"clip_scatter_deg": 1.5}, {**TILT, **OFFSET, "clip_scatter_deg": 0.5}])
@pytest.mark.parametrize("recipe", [IDEAL, RIBBON], ids=["round", "ribbon"])
def test_ideal_clips_are_reported_and_others_hold(recipe, wrong):
    """Frames and marks of the clips as without errors, the rod between them elsewhere; the same again from the same seed."""
    ideal, real = synthesise(recipe), synthesise(replace(recipe, **wrong))
    for name in ("start_frame", "end_frame"):
        np.testing.assert_allclose(getattr(real, name), getattr(ideal, name), atol=1e-12)
    for mark in (0, 1, -2, -1):
        np.testing.assert_allclose(real.vertices[:, mark], ideal.vertices[:, mark], atol=1e-9)
    assert (np.linalg.norm(real.vertices - ideal.vertices, axis=2)[:, 2:-2].max(axis=1) > 0.02).all()
    if recipe.frames:
        np.testing.assert_allclose(real.frames[:, [0, -1]], ideal.frames[:, [0, -1]], atol=1e-9)
    np.testing.assert_array_equal(synthesise(replace(recipe, **wrong)).vertices, real.vertices)


def test_a_tilt_turns_the_clip_about_its_outer_end_and_turns_with_it():
    """The piece inside the clip leaves the reported tangent by the drawn angles about m1 and m2, at every end rotation."""
    recipe = replace(IDEAL, **TILT)
    rods, reported, tilt = fine_vertices(recipe), synthesise(recipe), errors_of(recipe).tilt
    np.testing.assert_allclose(rods[:, 0], reported.vertices[:, 0], atol=1e-9)
    np.testing.assert_allclose(rods[:, -1], reported.vertices[:, -1], atol=1e-9)
    pieces = rods[:, 3] - rods[:, 0], rods[:, -1] - rods[:, -4]
    for end, frame, piece in zip((0, 1), (reported.start_frame, reported.end_frame), pieces, strict=True):
        size = np.linalg.norm(tilt[end])
        a, b = tilt[end] * np.sin(size) / size
        np.testing.assert_allclose(seen_in(frame, piece), np.tile(3 * np.array([np.cos(size), b, -a]), (9, 1)), atol=1e-8)


RODS = 48


@pytest.fixture(scope="module", autouse=True)
def short_rounds():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(timed, "ROUND_SECONDS", 0.0)
        yield


@pytest.fixture(scope="module")
def specimens():
    return Specimens(RODS)


@pytest.mark.thorough
def test_only_rods_that_converged_count(specimens):
    solution = specimens.many.relaxed(timed.Newton(max_iterations=6), "f64")
    done = solution.converged
    assert 0 < done.sum() < RODS
    outcome = timed.converged((solution, 0))
    assert (outcome.amount, outcome.converged) == (done.sum(), done.mean())
    assert outcome.residual == solution.residual[done].max()


@pytest.mark.thorough
def test_trips_are_counted_by_launch(monkeypatch, specimens):
    """Of all lanes, idle ones too; of a launch in f64 only where it ended a rod."""
    monkeypatch.setattr(batch, "pack_trips", {32: (10, 16), 64: (5, 8)}.__getitem__)
    for precision, count in (("f32", 160), ("mixed", 200), ("f64", 40)):
        assert timed.trips(specimens.many.relaxed(timed.COARSE, precision), precision) == count


def test_busy_lanes():
    case = Case("made up", "rods/s", lambda: Outcome(3.0, iterations=np.array([20, 40, 90]), trips=200))
    assert measure(case, workload.Reference(1), 1).busy == 150 / 200
