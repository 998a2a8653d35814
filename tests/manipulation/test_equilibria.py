"""Shapes that are interpolated, what keeps clear between two of them, and how taut grippers hold a rod."""

import numpy as np

import doo_ti as d
from doo_ti.contact.surroundings import Surroundings
from doo_ti.manipulation.equilibria import Clearance, Shapes
from doo_ti.manipulation.model import drawn_in, moved, slack, slack_gradient
from doo_ti.rod.frames import rotation_matrix

LENGTHS = np.full(20, 5.0)


def two() -> tuple[Shapes, Shapes]:
    one, other = (Shapes.at_random(4, np.zeros(3), np.full(3, 50.0), LENGTHS, anchor, np.random.default_rng(3))
                  for anchor in (10, 10))
    return one, other.take(np.array([1, 2, 3, 0]))


def test_shapes_are_those_of_their_rods():
    shapes = two()[0]
    again = Shapes.of(shapes.rods, 10)
    assert np.allclose(again.place, shapes.place) and np.allclose(again.joints, shapes.joints, atol=1e-12)
    assert np.allclose(shapes.apart(again, 60.0), 0.0, atol=1e-5)
    other = Shapes.of(shapes.rods, 0)
    assert np.allclose(other.rods.vertices, shapes.rods.vertices)


def test_a_way_leads_from_one_shape_to_the_other_at_a_constant_pace():
    one, other = two()
    whole = one.apart(other, 60.0)
    assert np.allclose(one.towards(other, np.ones(4)).rods.vertices, other.rods.vertices)
    half = one.towards(other, np.full(4, 0.5))
    assert np.allclose(one.apart(half, 60.0), whole / 2) and np.allclose(half.apart(other, 60.0), whole / 2)


def test_a_thin_obstacle_between_two_shapes_is_found():
    rods = Shapes(np.zeros((2, 3)), np.tile([1.0, 0, 0, 0], (2, 1)), np.zeros((2, 19, 3)), LENGTHS, 10).rods.vertices
    needle = Surroundings([d.Capsule((3.0, 11.3, -50), (3.0, 11.3, 50), 0.2)], 0.3)
    clearance = Clearance(needle, 100.0, 20)
    for shift, clear in ((9.0, True), (40.0, False)):
        after = rods + [0, shift, 0]
        assert (clearance.between(rods, after, clearance.of(rods), clearance.of(after)) == clear).all()


def test_slack_and_its_gradient():
    random = np.random.default_rng(3)
    frames = rotation_matrix(random.normal(size=(2, 5, 3)))
    clamps = d.Clamps(d.Clamp.FRAME, d.Clamp.FRAME, random.normal(size=(5, 3)), 100 + random.normal(size=(5, 3)), *frames)
    stiff, change = np.full(5, 7.0), 1e-5 * random.normal(size=(5, 12))
    there, back = (slack(moved(clamps, sign * change), 300.0, stiff) for sign in (1, -1))
    assert np.allclose((there - back) / 2, np.sum(slack_gradient(clamps, stiff) * change, axis=1), atol=1e-11)
    for free in (np.ones(12, dtype=bool), np.arange(12) >= 6):
        looser = slack(drawn_in(clamps, np.full(5, 2.0), stiff, free), 300.0, stiff)
        assert np.allclose(looser, slack(clamps, 300.0, stiff) + 2.0)
