"""Paths along detected lines: in order, across gaps and corners, and both ways at crossings."""

import numpy as np
import pytest

from doo_ti.rod.frames import arc_lengths, curve_length, placed, unit_vectors
from doo_ti.rod.shapes import rod_along
from doo_ti.vision.detection import Detection
from doo_ti.vision.paths import Chains, line_trees, merged, paths_from, thread_beyond
from doo_ti.vision.tubes import smooth_curve
from tests.vision.scenes import bow, line_of, small_rig

SHAPE = (480, 640)


def chains(points: np.ndarray, rng: np.random.Generator, hidden: tuple[float, float] = (1.0, 1.0)) -> Chains:
    """Of the curve ``points`` (N, 2) px, detected in no order, without what lies between two shares of it."""
    arc = arc_lengths(points)
    place = np.arange(0.0, arc[-1], 0.75)
    place = rng.permutation(place[(place < hidden[0] * arc[-1]) | (place > hidden[1] * arc[-1])])
    ahead = unit_vectors(placed(place + 0.5, arc, points) - placed(place - 0.5, arc, points))
    noisy = placed(place, arc, points) + 0.05 * rng.normal(size=ahead.shape)
    return Chains.of(line_of(noisy, rng.choice([-1.0, 1.0], (len(place), 1)) * ahead, 2.0, SHAPE))


def _curves():
    s, a, way = np.linspace(0, 1, 800), np.linspace(-2.2, 2.2, 1200), np.linspace(0, 1, 300)[:, None]
    yield np.stack([60 + 500 * s, 240 + 120 * np.sin(7 * s)], axis=1)
    yield np.stack([320 + 90 * (a**3 - 2.5 * a) / 2, 120 + 60 * a**2], axis=1)
    yield np.concatenate([[288, 100] + way * [12, 220], [301, 320] + way * [25, -200]])


WAVE, LOOP, CORNER = _curves()
"""(N, 2) px. The loop crosses itself once; the corner comes towards the camera and goes back beside itself."""


def missed(path, curve: np.ndarray) -> float:
    """px: the largest distance of the path from the curve, share by share."""
    arc, share = arc_lengths(curve), np.linspace(0, 1, 200)
    return float(np.linalg.norm(path.at(share * path.length) - placed(share * arc[-1], arc, curve), axis=1).max())


def test_the_line_on_a_laid_rope_is_one_path():
    """On each strand it runs at an angle, and jumps back across half of the rope to the next one."""
    place = np.arange(0.0, 500.0)
    aside = 5.0 * (place / 28 % 1 - 0.5)
    points, way = np.stack([60 + place, 240 + aside], axis=1), unit_vectors(np.array([1.0, 5 / 28]))
    path = paths_from(Chains.of(line_of(points, way, 8.0)), points[0], None)[0]
    assert path.share > 0.95 and abs(path.points[-1, 0] - 559) < 5


@pytest.mark.parametrize("curve", [WAVE, LOOP, CORNER], ids=["wave", "loop", "corner"])
def test_a_path_goes_from_end_to_end(rng, curve):
    path = paths_from(chains(curve, rng), curve[0], curve[5] - curve[0])[0]
    assert missed(path, curve) < 8.0 and path.share > 0.95


@pytest.mark.parametrize("hidden", [(0.4, 0.5), (0.45, 0.62)])
def test_a_path_crosses_a_gap_and_says_so(rng, hidden):
    path = paths_from(chains(WAVE, rng, hidden), WAVE[0], None)[0]
    assert missed(path, WAVE) < 30.0 and abs(np.mean(~path.seen) - (hidden[1] - hidden[0])) < 0.06


def test_it_begins_in_the_middle_in_the_direction_that_is_given_and_leads_to_a_free_end(rng):
    for sign, end in ((1.0, WAVE[-1]), (-1.0, WAVE[0])):
        path = paths_from(chains(WAVE, rng), WAVE[300], sign * (WAVE[310] - WAVE[300]))[0]
        assert np.linalg.norm(path.points[-1] - end) < 4
        assert np.linalg.norm(chains(WAVE, rng).free_ends - end, axis=1).min() < 3.0


def test_a_loop_has_other_paths_as_well(rng):
    paths = paths_from(chains(LOOP, rng), LOOP[0], None)
    assert len(paths) > 1 and missed(paths[0], LOOP) < 8.0 < missed(paths[1], LOOP)


@pytest.mark.parametrize("apart", [0.25, 0.32, 0.45])
def test_a_point_found_twice_does_not_cut_off_the_end(apart):
    """Either side of the border between two pixels: here 4 px from the end, where the rest of the chain was noise."""
    x = np.r_[96.5 + apart / 2, np.arange(98.0, 200.0), 96.5 - apart / 2, 95.2, 94.1, 93.0]
    ends = Chains.of(line_of(np.stack([x, np.full(len(x), 50.0)], axis=1), np.array([1.0, 0.0]), 2.0)).free_ends
    assert sorted(ends[:, 0]) == [93.0, 199.0]


def test_without_a_thread_there_is_no_path():
    nothing = Chains.of(Detection.none(SHAPE, "ridge"))
    assert paths_from(nothing, np.zeros(2), None) == [] and nothing.free_ends.shape == (0, 2)


def test_thread_beyond_a_rod_is_found_joined_or_behind_gaps_in_two_cameras_and_other_lines_are_not():
    rig, curve = small_rig(), smooth_curve(0.7 * bow(), 30)  # 990 points
    rod, rest, behind, nothing = curve[:600], curve[600:], curve[700:], curve[:0]
    across = curve[599] + np.linspace(-15, 15, 400)[:, None] * np.array([0.3, 1.0, 0.0])

    def beyond(*more, backwards=False):
        images = [camera.project(np.concatenate([rod, part])) for camera, part in zip(rig.cameras, more, strict=True)]
        lines = [line_of(image, shape=(360, 480)) for image in images]
        return thread_beyond(rig, rod_along(rod[::-1] if backwards else rod, 20), [lines], np.array([backwards]))[0]

    assert beyond(rest, nothing) == pytest.approx([0, curve_length(rest)], rel=0.2) and beyond(behind, behind)[1] > 15
    assert beyond(rest, rest, backwards=True)[0] > 0.8 * curve_length(rest)
    assert max(beyond(*more).max() for more in ((nothing, nothing), (across, across), (curve[960:], nothing))) < 1.0


def test_where_a_line_merges_with_that_of_the_same_rod():
    """Strands 5 px apart of a thread 4 px wide, and a corner; not where strands cross, nor in a wide bend."""
    s = np.linspace(0, np.pi, 40)
    bend = [220, 102.5] + 2.5 * np.stack([np.sin(s), -np.cos(s)], axis=1)
    hairpin = np.concatenate([np.linspace([100, 100], [220, 100], 40), bend,
                              np.linspace([220, 105], [180, 105], 14), np.linspace([176, 108], [100, 180], 40)])
    corner = np.linspace([296, 285], [301, 320], 8)  # its strands are less than 7 px apart from there on
    for curve, expected in ((WAVE, []), (LOOP, []), (CORNER, corner), (hairpin, np.linspace([180, 105], [220, 100], 9))):
        arc = arc_lengths(curve)
        places = placed(np.linspace(0, arc[-1], 400).reshape(1, 1, 200, 2), arc, curve)
        lines = line_trees([[line_of(curve, unit_vectors(np.gradient(curve, axis=0)), 4.0, SHAPE)]])
        others, itself = merged(places, np.ones(places.shape[:-1], bool), lines, np.full((1, 1, 1), 4.0))
        far = np.linalg.norm(places[itself][:, None] - np.reshape(expected, (-1, 2)), axis=-1)
        assert not others.any() and itself.any() == bool(len(expected))
        assert not len(expected) or far.min(axis=0).max() < 6 and far.min(axis=1).max() < 12
