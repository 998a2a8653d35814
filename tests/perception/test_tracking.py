"""Known rods tracked through videos: followed, lost, and found again."""

from copy import deepcopy
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import doo_ti as d
from doo_ti.motion.path import Motion, motion_between
from doo_ti.perception.perceive import PerceptionVerdict
from doo_ti.perception.search import PerceptionOptions, Search
from doo_ti.perception.tracking import How, TrackedFrame, Tracker, seen_vertices
from doo_ti.rod.frames import across, matrix_from_quaternion, quaternion_about, unit_vectors
from doo_ti.vision.render import render_set
from doo_ti.vision.tubes import smooth_curve
from tests.conftest import check_refused
from tests.references.rods import certified
from tests.vision.scenes import curves, three_cameras

EDGES, LENGTH, FRAMES = 20, 3.0, 16
MATERIAL = d.Material(2e5, 2e5)
REST_LENGTH = np.full(EDGES, LENGTH)


@cache
def _first() -> d.Configuration:
    """Near the first frame's rod."""
    return d.rod_along(curves(np.random.default_rng(8), 1, EDGES, turn=0.09)[0], EDGES)


@cache
def far_motion() -> Motion:
    """From the first frame to the last: the far end is led 40 mm and turned by 68°."""
    held = d.end_clamps(_first(), d.Clamp.TANGENT, d.Clamp.TANGENT)
    along = unit_vectors(held.end_position - held.start_position)
    return Motion(held, end_shift=-30 * along + 26 * across(along), end_turn=np.array([[0.4, -0.6, 0.95]]))


@cache
def rods() -> np.ndarray:
    """(T, V, 3) mm: at rest without any image, each from the one before."""
    rod, shapes = _first(), []
    for frame in range(FRAMES):
        rod = certified(d.relax(rod, MATERIAL, far_motion().at(frame / (FRAMES - 1)), d.Newton.careful())).configuration
        shapes.append(rod.vertices[0])
    return np.array(shapes)


def photographed(rod: np.ndarray, frame: int) -> list[np.ndarray]:
    """C images."""
    return render_set(three_cameras(), smooth_curve(rod, 8), 1.0, seed=(4, frame))


@cache
def images(frame: int) -> list[np.ndarray]:
    return photographed(rods()[frame], frame)


NOTHING = d.Detection.none((480, 640), "ridge")


@cache
def seen(frame: int) -> list[d.Detection]:
    return [d.detect(one) for one in images(frame)]


def video(*rows: int) -> list[list[d.Detection]]:
    """What is detected in those frames, by default in all."""
    return [seen(frame) for frame in rows or range(FRAMES)]


@cache
def _begun() -> tuple[Tracker, TrackedFrame]:
    tracker, rod = Tracker(three_cameras(), REST_LENGTH, MATERIAL), rods()[0]
    return tracker, tracker.see(seen(0), rod[0], rod[1] - rod[0])


def begun() -> tuple[Tracker, TrackedFrame]:
    """A tracker of one's own that has seen the first frame, which takes as long as a dozen others, and what it found there."""
    return deepcopy(_begun())


def tracked(video, truth, material=MATERIAL, far=None, search=None, again=False):
    """Every frame, and the mean distance of its vertices to the truth; ``again``: the first one is searched, too."""
    tracker, found = Tracker(three_cameras(), REST_LENGTH, material, search=search or PerceptionOptions()), []
    if video[0] is seen(0) and material is MATERIAL and search is None and not again:
        tracker, *found = begun()
    for row in range(len(found), len(video)):
        far_clamp = None if far is None or row == 0 else far[row - 1]
        found.append(tracker.see(video[row], truth[row][0], truth[row][1] - truth[row][0], far_clamp))
    return found, np.linalg.norm([frame.vertices for frame in found] - truth, axis=-1).mean(axis=1)


def test_a_lost_frame_is_followed_back_from_the_next():
    """And one with another rod; the right one stays."""
    tracker, *found = begun()
    found.append(tracker.see(seen(1), rods()[1, 0], rods()[1, 1] - rods()[1, 0]))
    seed = rods()[0, 0], rods()[0, 1] - rods()[0, 0]
    assert found[0].verdict == PerceptionVerdict.CLEAR and found[1].verdict <= PerceptionVerdict.LIKELY
    lost = Tracker(three_cameras(), REST_LENGTH, MATERIAL).see([NOTHING] * 3, *seed)
    other = replace(found[0], vertices=found[0].vertices[:, [1, 0, 2]], energy_vis=1e3 * found[0].energy_vis)
    for frame in (lost, other):
        again = tracker.revised(frame, found[1], seen(0), *seed)
        assert again.how == How.TRACKED and np.linalg.norm(again.vertices - rods()[0], axis=-1).max() < 0.3
    assert tracker.revised(found[0], lost, seen(0), *seed) is found[0]


@pytest.mark.parametrize("frames", [4, pytest.param(FRAMES, marks=pytest.mark.thorough)])
def test_a_rod_is_followed(frames):
    """Its far end moves 2.6 mm from frame to frame, its edges turn by up to 9°."""
    found, error = tracked(video(*range(frames)), rods()[:frames])
    assert [frame.how for frame in found] == [How.SEEDED] + [How.TRACKED] * (frames - 1)
    assert error.max() < 0.15 and error.mean() < 0.05
    assert all(frame.status == d.Status.CONVERGED and frame.stable for frame in found)
    assert max(frame.camera_error.max() for frame in found) < 0.6
    again, _ = tracked(video(0, 1), rods()[:2], again=True)
    for one, other in zip(found, again, strict=False):
        np.testing.assert_array_equal(one.vertices, other.vertices)


@pytest.mark.thorough
def test_a_tracked_rod_is_the_one_that_algorithm_1_finds():
    """The last frame of fifteen that each began with the one before, against a search that knows none of them."""
    options = PerceptionOptions(evidence="rod")
    found, _ = tracked(video(), rods(), search=options)
    rod, rig = rods()[-1], three_cameras()
    alone = d.perceive(d.distance_maps(video(FRAMES - 1)), rig, rod[0], rod[1] - rod[0], REST_LENGTH, MATERIAL, options=options)
    np.testing.assert_allclose(found[-1].vertices, alone.vertices[0], atol=1e-4)
    assert found[-1].energy_vis == pytest.approx(alone.energy_vis[0], rel=1e-6)
    np.testing.assert_allclose(found[-1].camera_error, alone.camera_error[0], rtol=1e-4)
    np.testing.assert_allclose(found[-1].sigma, alone.sigma[0], rtol=1e-3)


def test_the_uncertainty_of_a_start_counts_in_that_of_its_rod():
    exact, uncertain = (d.Tracker(three_cameras(), REST_LENGTH, MATERIAL) for _ in range(2))
    for detected, rod in zip(video(0, 1), rods(), strict=False):  # the first by Algorithm 1, the second from it
        one, other = (tracker.see(detected, rod[0], rod[1] - rod[0], start_covariance=sigma**2 * np.eye(3))
                      for tracker, sigma in ((exact, 0.0), (uncertain, 0.7)))
        assert (other.sigma > np.hypot(one.sigma, 0.9 * 0.7 / np.sqrt(3)))[[0, -1]].all(), "the rod may slide along itself"
        np.testing.assert_allclose(other.sigma[2:-1], one.sigma[2:-1], rtol=0.3, err_msg="its shape is as certain")
        assert np.linalg.norm(other.vertices - rod, axis=-1).max() < 3 * other.sigma.max()


@pytest.mark.parametrize("blind", [2, pytest.param(3, marks=pytest.mark.thorough)])
def test_a_rod_behind_a_bar_is_followed(blind):
    """From the second frame on none of so many cameras shows a fifth of it: the rest leaves little to choose there."""
    rig = three_cameras()
    hidden = [[found if number >= blind else found.take(np.linalg.norm(
        found.points[:, None] - camera.project(rod[8:13]), axis=-1).min(axis=1) > 12.0)
               for number, (camera, found) in enumerate(zip(rig.cameras, frame, strict=True))]
              for frame, rod in zip(video(1, 2, 3), rods()[1:4], strict=True)]
    found, error = tracked(video(0) + hidden, rods()[:4])
    assert How.LOST not in [frame.how for frame in found] and found[3].how == How.TRACKED
    assert error.max() < 0.3 and min(frame.camera_error.max() for frame in found[1:]) > d.TrackingOptions().lost_px


def test_a_rod_longer_than_the_thread_is_doubted():
    """By three edges of twenty; in a frame that was tracked as well, where no thread was traced."""
    tracker = Tracker(three_cameras(), np.full(EDGES + 3, LENGTH), MATERIAL)
    for detected, rod in zip(video(0, 1), rods(), strict=False):
        found = tracker.see(detected, rod[0], rod[1] - rod[0])
        assert found.verdict == PerceptionVerdict.AMBIGUOUS and "another length" in found.doubts


@pytest.mark.thorough
def test_two_cameras_will_do():
    """One camera sees nothing for four frames."""
    hidden = [[frame[0], NOTHING, frame[2]] if 4 <= row < 8 else frame for row, frame in enumerate(video())]
    found, error = tracked(hidden, rods())
    assert all(frame.how == How.TRACKED for frame in found[1:]) and error.max() < 0.15
    blind = np.isnan([frame.camera_error for frame in found])
    assert blind[4:8, 1].all() and blind.sum() == 4


@pytest.mark.thorough
def test_a_cut_is_noticed_and_another_rod_is_not_tracked():
    """From one frame to the next another rod is seen: Algorithm 1 finds it, and the next frames track it."""
    other = curves(np.random.default_rng(16), 1, len(REST_LENGTH), turn=0.25).repeat(2, axis=0)
    cut = video(0, 1) + [[d.detect(one) for one in photographed(rod, frame)] for frame, rod in enumerate(other)]
    found, error = tracked(cut, np.concatenate([rods()[:2], other]))
    assert [frame.how for frame in found] == [How.SEEDED, How.TRACKED, How.SEEDED, How.TRACKED]
    assert error.max() < 0.15
    tracker, rod = Tracker(three_cameras(), REST_LENGTH, MATERIAL), rods()[0]  # with the seed of another, far from it
    assert tracker.see(seen(0), rod[0] + [0.0, 0.0, 60.0], [0.0, 0.0, 1.0]).how == How.LOST
    assert tracker.see(seen(0), rod[0], rod[1] - rod[0]).how == How.SEEDED


@pytest.mark.thorough
def test_a_moving_gripper_takes_the_rod_along():
    """The rod turns as a whole by 12° from frame to frame, and moves 2 mm, as its seed shows."""
    shape = rods()[5] - rods()[5].mean(axis=0)
    turns = matrix_from_quaternion(quaternion_about(np.array([0.6, 0.0, 0.8]), np.radians(12.0) * np.arange(8)))
    truth = shape @ np.swapaxes(turns, 1, 2) + np.array([2.0, 0, 0]) * np.arange(8)[:, None, None]
    video = [[d.detect(one) for one in photographed(rod, frame)] for frame, rod in enumerate(truth)]
    found, error = tracked(video, truth, d.Material(2e5, 2e5, 0.0))
    assert all(frame.how == How.TRACKED for frame in found[1:]) and error.max() < 0.15


@pytest.mark.thorough
def test_a_known_far_clamp_predicts_and_one_out_of_reach_does_no_harm(monkeypatch):
    """Every fifth frame, the far end 13 mm further: the prediction is a much better start than the last rod."""
    rows = np.arange(0, FRAMES, 5)
    places = [far_motion().at(row / (FRAMES - 1)) for row in rows]
    far = [motion_between(before, after) for before, after in zip(places, places[1:], strict=False)]
    starts, nearly_relaxed = [], Search.nearly_relaxed

    def watched(search, hypotheses):
        if len(hypotheses.quaternions[0]) == len(REST_LENGTH) and search.options.growing_iterations > 6:
            starts.append(search.vertices(hypotheses))
        return nearly_relaxed(search, hypotheses)

    monkeypatch.setattr(Search, "nearly_relaxed", watched)
    found, error = tracked(video(*rows), rods()[rows], far=far)
    assert all(frame.how == How.TRACKED for frame in found[1:]) and error.max() < 0.15
    for row, vertices in zip(rows[1:], starts, strict=True):
        off = np.linalg.norm(vertices - rods()[row], axis=-1).mean(axis=1)
        assert off[-1] < 0.5 * off[0] and off[-1] < 0.5
    monkeypatch.undo()
    place = far_motion().at(0.0)  # with an error of 500 mm the other starts remain
    far = [motion_between(place, replace(place, end_position=place.end_position + 500.0))] * 2
    found, error = tracked(video(0, 1, 2), rods()[:3], far=far)
    assert all(frame.how == How.TRACKED for frame in found[1:]) and error.max() < 0.15


def test_vertices_that_two_cameras_show_are_seen():
    rig, rod, first = three_cameras(), rods()[0], seen(0)
    frame = TrackedFrame(rod, np.zeros(len(rod)), 0.0, np.zeros(3), d.Status.CONVERGED, True, How.TRACKED)
    without = [found.take(np.linalg.norm(found.points - camera.project(rod[10]), axis=1) > 3.0)
               for camera, found in zip(rig.cameras, first, strict=True)]
    np.testing.assert_array_equal(seen_vertices(frame, rig, first), rod)
    np.testing.assert_array_equal(seen_vertices(frame, rig, [*first[:2], without[2]]), rod)
    shown = seen_vertices(frame, rig, [first[0], *without[1:]])
    assert np.isnan(shown[10]).all() and (shown[[8, 12]] == rod[[8, 12]]).all()
    assert np.isnan(seen_vertices(frame, rig, [first[0], NOTHING, NOTHING])).all()
    assert np.isnan(seen_vertices(replace(frame, vertices=np.full_like(rod, np.nan)), rig, first)).all()
    check_refused("detected", seen_vertices, frame, rig, first[:2])
