"""Paths along detected lines: in order, across gaps and corners, and both ways at crossings."""

import numpy as np
import pytest

from doo_ti.vision.detection import Detection
from doo_ti.vision.paths import Chains, paths_from

SHAPE = (480, 640)


def detected(points: np.ndarray, rng: np.random.Generator, hidden: tuple[float, float] = (1.0, 1.0)) -> Detection:
    """The curve (N, 2) px, in no order, without what lies between two shares of it."""
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    place = np.arange(0.0, arc[-1], 0.75)
    place = place[(place < hidden[0] * arc[-1]) | (place > hidden[1] * arc[-1])]
    found = np.stack([np.interp(place, arc, column) for column in points.T], axis=1)
    both = [[np.interp(place + side, arc, line) for line in points.T] for side in (0.5, -0.5)]
    ahead = np.stack(both[0], axis=1) - np.stack(both[1], axis=1)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    order = rng.permutation(len(place))
    sign = rng.choice([-1.0, 1.0], len(place))[:, None]
    noisy, strength = found + 0.05 * rng.normal(size=found.shape), np.full(len(place), 50.0)
    return Detection(noisy[order], (sign * ahead)[order], strength, 2.0, "dark", SHAPE, "ridge")


def chains(*arguments) -> Chains:
    return Chains.of(detected(*arguments))


def wave() -> np.ndarray:
    s = np.linspace(0, 1, 800)
    return np.stack([60 + 500 * s, 240 + 120 * np.sin(7 * s)], axis=1)


def loop() -> np.ndarray:
    """It crosses itself once."""
    a = np.linspace(-2.2, 2.2, 1200)
    return np.stack([320 + 90 * (a**3 - 2.5 * a) / 2, 120 + 60 * a**2], axis=1)


def corner() -> np.ndarray:
    """It comes towards the camera and goes back beside itself."""
    down, up = np.linspace(0, 1, 300), np.linspace(0, 1, 300)
    return np.concatenate([np.stack([300 - 12 * (1 - down), 100 + 220 * down], axis=1),
                           np.stack([301 + 25 * up, 320 - 200 * up], axis=1)])


def missed(path, curve: np.ndarray) -> float:
    """px: the largest distance of the path from the curve, share by share."""
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])
    share = np.linspace(0, 1, 200)
    there = np.stack([np.interp(share * arc[-1], arc, column) for column in curve.T], axis=1)
    return float(np.linalg.norm(path.at(share * path.length) - there, axis=1).max())


def test_the_line_on_a_laid_rope_is_one_path():
    """On each strand it runs at an angle, and jumps back across half of the rope to the next one."""
    place = np.arange(0.0, 500.0)
    aside = 5.0 * (place / 28 % 1 - 0.5)
    points, way = np.stack([60 + place, 240 + aside], axis=1), np.array([1.0, 5 / 28]) / np.hypot(1.0, 5 / 28)
    rope = Detection(points, np.tile(way, (500, 1)), np.full(500, 50.0), 8.0, "light", SHAPE, "ridge")
    path = paths_from(Chains.of(rope), points[0], None)[0]
    assert path.share > 0.95 and abs(path.points[-1, 0] - 559) < 5


@pytest.mark.parametrize("curve", [wave(), loop(), corner()], ids=["wave", "loop", "corner"])
def test_a_path_goes_from_end_to_end(rng, curve):
    path = paths_from(chains(curve, rng), curve[0], curve[5] - curve[0])[0]
    assert missed(path, curve) < 8.0 and path.share > 0.95


@pytest.mark.parametrize("hidden", [(0.4, 0.5), (0.45, 0.62)])
def test_a_path_crosses_a_gap_and_says_so(rng, hidden):
    path = paths_from(chains(wave(), rng, hidden), wave()[0], None)[0]
    share = np.mean(~path.seen)
    assert missed(path, wave()) < 30.0 and abs(share - (hidden[1] - hidden[0])) < 0.06


def test_it_begins_in_the_middle_in_the_direction_that_is_given(rng):
    curve = wave()
    ahead, back = (paths_from(chains(curve, rng), curve[300], sign * (curve[310] - curve[300]))[0] for sign in (1.0, -1.0))
    assert np.linalg.norm(ahead.points[-1] - curve[-1]) < 4 and np.linalg.norm(back.points[-1] - curve[0]) < 4


def test_a_loop_has_other_paths_as_well(rng):
    paths = paths_from(chains(loop(), rng), loop()[0], None)
    assert len(paths) > 1 and missed(paths[0], loop()) < 8.0 < missed(paths[1], loop())


def test_free_ends_are_those_of_the_thread(rng):
    ends = chains(wave(), rng).free_ends
    for end in wave()[[0, -1]]:
        assert np.linalg.norm(ends - end, axis=1).min() < 3.0


@pytest.mark.parametrize("apart", [0.25, 0.32, 0.45])
def test_a_point_found_twice_does_not_cut_off_the_end(apart):
    """Either side of the border between two pixels: here 4 px from the end, where the rest of the chain was noise."""
    x = np.r_[96.5 + apart / 2, np.arange(98.0, 200.0), 96.5 - apart / 2, 95.2, 94.1, 93.0]
    fifty = np.full(len(x), 50.0)
    points, along = np.stack([x, fifty], axis=1), np.tile([1.0, 0.0], (len(x), 1))
    ends = Chains.of(Detection(points, along, fifty, 2.0, "dark", SHAPE, "ridge")).free_ends
    assert sorted(ends[:, 0]) == [93.0, 199.0]


def test_without_a_thread_there_is_no_path():
    nothing = Detection(np.empty((0, 2)), np.empty((0, 2)), np.empty(0), np.nan, "", SHAPE, "ridge")
    assert paths_from(Chains.of(nothing), np.zeros(2), None) == [] and Chains.of(nothing).free_ends.shape == (0, 2)
