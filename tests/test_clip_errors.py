"""Clips whose real pose differs from the reported one: the error, its frame, and its effect on observations."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti.io.scene import Synthesis
from doo_ti.lab.synthesis import ClipErrors, fine_vertices, synthesise

ROUND = Synthesis(bend=6e5, twist=8e5, seed=4, end_distances_mm=(42.0, 66.0, 84.0), end_rotations_deg=(0.0, 90.0, 180.0),
                  label_noise_mm=0.0)
RIBBON = replace(ROUND, bend=((6e6, 0.0), (0.0, 1.2e5)), twist=5e5, frames=True)
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
    assert many[0].any and many[0].vary
    none = ClipErrors.drawn(3, 5, tilt=0.0, offset=0.0, scatter=0.0)
    assert not none.any and not none.vary


def test_one_size_does_not_change_the_draws_of_another():
    tilted = ClipErrors.drawn(3, 5, tilt=0.03, offset=0.0, scatter=0.0)
    both = ClipErrors.drawn(3, 5, tilt=0.03, offset=0.2, scatter=0.01)
    np.testing.assert_array_equal(tilted.tilt, both.tilt)


@pytest.mark.thorough
@pytest.mark.parametrize("wrong", [TILT, OFFSET, {"clip_scatter_deg": 1.5}, {**TILT, **OFFSET, "clip_scatter_deg": 0.5}])
@pytest.mark.parametrize("recipe", [ROUND, RIBBON], ids=["round", "ribbon"])
def test_ideal_clips_are_reported_and_others_hold(recipe, wrong):
    """Frames and marks of the clips as without errors, the rod between them elsewhere; the same again from the same seed."""
    ideal, real = synthesise(recipe), synthesise(replace(recipe, **wrong))
    for name in ("start_frame", "end_frame"):
        np.testing.assert_allclose(getattr(real, name), getattr(ideal, name), atol=1e-12)
    for mark in (0, 1, -2, -1):
        np.testing.assert_allclose(real.vertices[:, mark], ideal.vertices[:, mark], atol=1e-9)
    apart = np.linalg.norm(real.vertices - ideal.vertices, axis=2)[:, 2:-2]
    print(f"{wrong}: marks moved by {apart.mean():.2f} mm on average, {apart.max():.2f} at most")
    assert (apart.max(axis=1) > 0.02).all()
    if recipe.frames:
        np.testing.assert_allclose(real.frames[:, [0, -1]], ideal.frames[:, [0, -1]], atol=1e-9)
    np.testing.assert_array_equal(synthesise(replace(recipe, **wrong)).vertices, real.vertices)


def test_a_tilt_turns_the_clip_about_its_outer_end_and_turns_with_it():
    """The piece inside the clip leaves the reported tangent by the drawn angles about m1 and m2, at every end rotation."""
    recipe = replace(ROUND, **TILT)
    rods, reported, tilt = fine_vertices(recipe), synthesise(recipe), errors_of(recipe).tilt
    np.testing.assert_allclose(rods[:, 0], reported.vertices[:, 0], atol=1e-9)
    np.testing.assert_allclose(rods[:, -1], reported.vertices[:, -1], atol=1e-9)
    pieces = rods[:, 3] - rods[:, 0], rods[:, -1] - rods[:, -4]
    for end, frame, piece in zip((0, 1), (reported.start_frame, reported.end_frame), pieces, strict=True):
        size = np.linalg.norm(tilt[end])
        a, b = tilt[end] * np.sin(size) / size
        np.testing.assert_allclose(seen_in(frame, piece), np.tile(3 * np.array([np.cos(size), b, -a]), (9, 1)), atol=1e-8)


@pytest.mark.thorough
def test_an_offset_moves_the_clip_sideways_and_turns_with_it():
    recipe = replace(ROUND, **OFFSET)
    rods, reported, offset = fine_vertices(recipe), synthesise(recipe), errors_of(recipe).offset
    for end, frame, vertex, mark in ((0, reported.start_frame, 0, 0), (1, reported.end_frame, -1, -1)):
        moved = seen_in(frame, rods[:, vertex] - reported.vertices[:, mark])
        np.testing.assert_allclose(moved, np.tile([0.0, *offset[end]], (9, 1)), atol=1e-8)


@pytest.mark.thorough
def test_scatter_is_of_each_observation_by_itself():
    recipe = replace(ROUND, clip_scatter_deg=1.5)
    rods, reported, errors = fine_vertices(recipe), synthesise(recipe), errors_of(recipe)
    along = rods[:, 1] - rods[:, 0]
    found = np.degrees(np.arccos(np.einsum("di,di->d", along, reported.start_frame[..., 0])))
    np.testing.assert_allclose(found, np.degrees(np.linalg.norm(errors.scatter[:, 0], axis=1)), atol=1e-4)
    assert len(set(found.round(6))) == 9


@pytest.mark.thorough
def test_noise_and_rest_curvature_of_a_seed_do_not_depend_on_clip_errors():
    noisy = replace(ROUND, label_noise_mm=0.1)
    noise = synthesise(noisy).vertices - synthesise(ROUND).vertices
    tilted = synthesise(replace(noisy, **TILT)).vertices - synthesise(replace(ROUND, **TILT)).vertices
    np.testing.assert_allclose(noise, tilted, atol=1e-12)
