"""Eq. 4: twist from shape, on rods whose twist is known because they were made with it; the intervals that it reports."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from doo_ti import Clamp, Material, Observations, Plane, Surroundings, consecutive_groups, distance, end_offsets, relax
from doo_ti.lab.synthesis import synthesise
from doo_ti.lab.workload import LAB, SUTURES
from doo_ti.perception.twist import TwistOptions, TwistVerdict, estimate_twist
from doo_ti.rod.frames import angle_about, total_twist, unit_vectors
from doo_ti.rod.start import held_spins, observation_clamps, start_configuration
from tests.conftest import check_refused
from tests.references.rods import at_rest, bows, chain, observed

MATERIAL = Material(6e5, 4e5)
EDGES = 33
TWIST = np.radians([-250.0, -100.0, 30.0, 140.0, 305.0])


@pytest.fixture(scope="module")
def made():
    return observed(at_rest(bows(0.5, 0.7, 0.9, 0.6, 0.8, edges=EDGES, twist=TWIST), MATERIAL))


def test_the_curve_is_eq_4(made):
    """Sample by sample against F called the way an observation's own hypotheses are: another start, another clamp code."""
    options = TwistOptions(step=np.pi / 2, span=np.pi, precision="f64")
    offset = np.linspace(-0.5, 0.7, made.count)
    estimate = estimate_twist(made, MATERIAL, np.zeros(made.count, dtype=int), offset, options)
    for place, phi in enumerate(options.angles):
        twisted = replace(made, total_twist=phi + offset)
        held = held_spins(twisted, replace(observation_clamps(made), end=Clamp.TANGENT), phi + offset)
        solution = relax(start_configuration(twisted, held), MATERIAL, held)
        assert estimate.objective[0, place] == pytest.approx(distance(solution.configuration, made).sum(), rel=1e-6, abs=1e-6)


def test_every_grasp_has_its_own_angle(made):
    """Footnote 4: two grasps, two turns of the rod in the gripper."""
    group = consecutive_groups(made.count, made.count, [3])
    offset = made.total_twist - np.where(group == 0, 0.4, -1.1)
    np.testing.assert_allclose(estimate_twist(made, MATERIAL, group, offset).phi, [0.4, -1.1], atol=np.radians(1.0))


@pytest.mark.parametrize("count, together, more, groups", [
    (7, 3, (), [0, 0, 0, 1, 1, 1, 2]), (7, 3, [1, 5], [0, 1, 1, 1, 2, 3, 3]), (3, 1, (), [0, 1, 2]),
    (5, 5, [3], [0, 0, 0, 1, 1])])
def test_groups(count, together, more, groups):
    assert consecutive_groups(count, together, more).tolist() == groups


def test_offsets_without_a_hint_follow_from_one_to_the_next(made):
    """Whole turns of end frames: each within half a turn of the one before it, the first of a group within half a turn."""
    turns = np.radians([0.0, 100.0, 200.0, 300.0, 20.0])
    known = replace(made.take([0] * 5), total_twist=None)
    first = end_offsets(known, np.zeros(5, dtype=int))[0]
    turned = known.end_frame @ Rotation.from_euler("x", turns[:, None]).as_matrix()
    offset = end_offsets(replace(known, end_frame=turned), np.array([0, 0, 0, 0, 1]))
    assert np.abs(first) <= np.pi
    np.testing.assert_allclose(np.diff(offset[:4]), np.radians(100.0), atol=1e-9)
    assert np.abs(offset[[0, 4]]).max() <= np.pi + 1e-9
    check_refused("end_frame", end_offsets, replace(known, end_frame=None), np.zeros(5, dtype=int))


def test_noisy_marks_alone_say_less(made, rng):
    """They tilt the ends that are held along them, which moves the estimate by far more than its curve is wide."""
    noisy = replace(made.take(np.repeat(np.arange(made.count), 8)), frames=None, total_twist=None)
    noisy = replace(noisy, vertices=noisy.vertices + rng.normal(0, 0.002, noisy.vertices.shape))
    truth, bare = np.repeat(TWIST, 8), replace(noisy, start_frame=None, end_frame=None)
    held, alone = (estimate_twist(one, MATERIAL) for one in (noisy, bare))
    assert np.mean((alone.low <= truth) & (truth <= alone.high)) > 0.9
    assert np.median(alone.high - alone.low) > 2 * np.median(held.high - held.low)
    same = estimate_twist(bare.take([11]), MATERIAL)
    assert (same.objective[0] == alone.objective[11]).all() and (same.low, same.high) == (alone.low[11], alone.high[11])


def test_materials_may_differ_and_no_observation_depends_on_others(made):
    each = Material(np.array([6e5, 1e6, 6e5, 1e6, 6e5]), 4e5)
    mixed, plain, stiff = (estimate_twist(made, material) for material in (each, MATERIAL, Material(1e6, 4e5)))
    for name in ("phi", "least", "objective", "minima", "verdict"):
        np.testing.assert_array_equal(getattr(mixed, name)[::2], getattr(plain, name)[::2])
        np.testing.assert_array_equal(getattr(mixed, name)[1::2], getattr(stiff, name)[1::2])
    np.testing.assert_array_equal(estimate_twist(made.take([3]), MATERIAL).objective[0], plain.objective[3])


def test_rods_that_cannot_be_are_undetermined(made):
    """Further apart than the rod is long: no curve, no angle, and no effect on other observations."""
    torn = made.vertices.copy()
    torn[1, 20:] += [60.0, 0, 0]
    estimate = estimate_twist(Observations(torn, rest_length=made.rest_length, start_frame=made.start_frame), MATERIAL)
    assert estimate.verdict[1] == TwistVerdict.UNDETERMINED and np.isnan(estimate.phi[1])
    assert (estimate.unsound[1] == 1).all() and np.isfinite(np.delete(estimate.phi, 1)).all()


def test_a_rod_that_does_not_feel_twist_is_ambiguous(made):
    """Nearly straight and much stiffer in bend than in twist: every angle fits."""
    line = np.linspace([0.0, 0, 0], [3.0 * EDGES, 0, 0.2], EDGES + 1)
    estimate = estimate_twist(Observations(line[None], rest_length=np.full(EDGES, 3.01)), Material(1e7, 1e4))
    assert estimate.verdict[0] in (TwistVerdict.AMBIGUOUS, TwistVerdict.AT_BORDER)
    assert estimate.high[0] - estimate.low[0] > np.pi


def test_wrong_arguments_are_named(made):
    for arguments, word in (({"group": np.array([0, 2, 2, 3, 4])}, "group"), ({"offset": np.zeros(3)}, "offset"),
                            ({"material": Material(np.ones(3), 1.0)}, "material")):
        check_refused(word, estimate_twist, made, **{"material": MATERIAL, **arguments})
    check_refused("start_frame", estimate_twist, replace(made, start_frame=None), Material.diagonal(1e6, 1e5, 1e5))
    check_refused("step", TwistOptions, step=0.0)
    deep = TwistOptions(surroundings=Surroundings([Plane((0, 0, 900), (0, 0, 1))], 2.0))
    check_refused("inside a Plane", estimate_twist, made, MATERIAL, options=deep)


def test_total_twist_is_the_angle_between_transported_directors(made):
    """Against angles in the plane across each edge."""
    rod = chain(np.diff(made.vertices[2], axis=0), [0, 1, 0], 3.0, spin=np.linspace(0, 7.0, EDGES))
    angles = []
    for before, after in pairwise(rod.frames[0]):
        axis = np.cross(before[:, 0], after[:, 0])
        turn = Rotation.from_rotvec(np.arcsin(np.linalg.norm(axis)) * unit_vectors(axis))
        angles.append(angle_about(after[:, 0], turn.apply(before[:, 1]), after[:, 1]))
    assert np.sum(angles) == pytest.approx(7.0)
    assert total_twist(rod.quaternions)[0] == pytest.approx(np.sum(angles), abs=1e-12)


SPECIMENS = range(300, 303)
WORLDS = {
    "ideal clips": {}, "tilted clips": {"clip_tilt_deg": 2.0, "clip_offset_mm": 0.3},
    "slightly tilted clips": {"clip_tilt_deg": 1.0, "clip_offset_mm": 0.2},
    "smooth rest curvature": {"rest_curvature_range_mm": 30.0}, "poor labels": {"label_noise_mm": 0.5}}


@pytest.mark.thorough
@pytest.mark.parametrize("world", WORLDS)
def test_the_intervals_contain_the_truth(world):
    """Of each suture some specimens, all of their observations, alone and three or six to a grasp. And a clear verdict is
    within 60° of the truth."""
    covered, wrong = {}, []
    for name in SUTURES:
        for seed in SPECIMENS:
            recipe = replace(LAB[name], seed=seed, **WORLDS[world])
            seen = synthesise(recipe)
            seen = seen.take(np.random.default_rng(seed).permutation(seen.count))
            for together in (1, 3, 6):
                group = consecutive_groups(seen.count, together)
                offset = end_offsets(seen, group) if together > 1 else np.zeros(seen.count)
                found = estimate_twist(seen, Material(recipe.bend, recipe.twist), group, offset)
                truth = (seen.total_twist - offset)[::together]
                covered.setdefault(together, []).append((found.low <= truth) & (truth <= found.high))
                wrong.append((np.abs(found.phi - truth) > np.radians(60))[found.verdict == TwistVerdict.CLEAR])
    assert min(np.concatenate(rods).mean() for rods in covered.values()) > 0.9 and np.concatenate(wrong).mean() < 0.02
