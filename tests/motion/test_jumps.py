"""Jumps are counted where rods leave their branch, and only there.

A strip with its ends brought together by d < 1 of its length and one end tilted by α is, shallow, a beam under compression:
w'''' + τ² w'' = 0 with w(0) = w(1) = w'(1) = 0, w'(0) = μ and ∫ w'² = 2, where μ = α/√d. Its branch ends where μ(τ) is largest,
at μ = 1.7818 (Gomez, Moulton, Vella, Nature Physics 13, 2017).
"""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti import Clamp, ClampPath, Configuration, Material, Motion, Newton, Plane, Surroundings, predict, relax
from doo_ti.learning.experiment import journey, relaxed
from doo_ti.motion.journey import Journey
from doo_ti.rod.frames import quaternion_from_matrix
from doo_ti.rod.shapes import straight_rod
from tests.learning.lab import lab_rods
from tests.references.rods import certified, clamps_at
from tests.relaxation.rods import vertex_distance

STRIP = Material.diagonal(1e5, 2e6, 1e5)
UP = np.array([0.02, 0.02, 1.0])
SHIFTS = np.array([[0, 0, -55.0], [0, 0, 55], [0, 50, 0], [-40, 0, 0], [10, 40, -20], [10, 0, -20], [-20, 20, 20]])
SNAPS = {(0.0, 4), (0.3, 0), (0.3, 1)}


def frame(angle) -> np.ndarray:
    """(..., 3, 3) columns t in the x-z plane, m1 along y, m2."""
    tangent = np.stack([np.cos(angle), np.zeros_like(angle), np.sin(angle)], axis=-1)
    across = np.broadcast_to([0.0, 1.0, 0.0], tangent.shape)
    return np.stack([tangent, across, np.cross(tangent, across)], axis=-1)


def shifted_strips(degrees: float = 10.0, **more) -> tuple[list, Configuration, Journey]:
    """A strip bowed upwards between clamps that rise by three angles, each far clamp to be shifted in seven ways: cases, the
    strips at rest, and their journey."""
    cases = [(rise, way) for rise in (0.0, 0.3, 0.6) for way in range(len(SHIFTS))]
    frames = frame(np.outer([rise for rise, _ in cases], np.linspace(1, -1, 33)))
    start = Configuration(np.zeros((len(cases), 3)), quaternion_from_matrix(frames), np.full(33, 3.0))
    clamps = replace(clamps_at(start), end_position=np.tile([65.0, 0.0, 0.0], (len(cases), 1)))
    at_rest = relax(start, STRIP, clamps, Newton.careful(), up=UP)
    assert (at_rest.converged & at_rest.stable).all()
    motion = Motion(clamps, end_shift=SHIFTS[[way for _, way in cases]])
    return cases, at_rest.configuration, Journey(motion, STRIP, np.radians(degrees), start.rest_length, UP, **more)


@pytest.mark.thorough
def test_jumps_are_where_energy_is_lost():
    """Where the far clamp is only shifted, its force does all the work. In 400 sub-steps the energy changes by that work, to
    0.01, except where the strip snaps through: there it loses hundreds at once. The journey has 16 sub-steps."""
    cases, at_rest, way = shifted_strips()
    motion, (end, jumps) = way.motion, way.end(at_rest)
    fine, before, lost = 400, relax(at_rest, STRIP, way.motion.clamps, Newton.careful(), up=UP), []
    for k in range(1, fine + 1):
        after = relax(before.configuration, STRIP, motion.at(k / fine), Newton.careful(), up=UP)
        work = np.sum(0.5 * (before.end_force + after.end_force) * motion.end_shift / fine, axis=-1)
        lost.append(work - (after.energy - before.energy))
        before = after
    lost = np.array(lost)
    snaps = (lost > 100).sum(axis=0)
    assert (np.sort(np.abs(lost), axis=0)[-2] < 0.2).all()
    assert {case for case, count in zip(cases, snaps, strict=True) if count} == SNAPS
    np.testing.assert_array_equal(jumps, snaps)
    assert vertex_distance(end.configuration, after.configuration).max() < 1e-4


@pytest.mark.sampled(1)
@pytest.mark.parametrize("name", ["nylon", "vicryl", "silk", "ribbon"])
def test_lab_rods_that_do_not_come_back_have_jumped(laboratory, name):
    """Under its true material a rod that keeps to its branch comes back to where it set out. The stiff sutures all do, and no
    jump is counted; many ribbons jump; nothing that does not come back is missed."""
    experiment, material = lab_rods(laboratory, name)
    begin = relaxed(experiment, material).configuration.take(experiment.rods[0])
    way = journey(experiment, material)
    there, first = way.end(begin)
    reverse = Motion(way.motion.at(1.0), **{part: -change for part, change in way.motion.parts.items()})
    back, second = Journey(reverse, material, way.sub_step, way.rest_length).end(there.configuration)
    assert certified(there) and certified(back)
    jumping = (first > 0).mean()
    assert jumping == 0 if name in ("nylon", "vicryl") else jumping < 0.1 if name == "silk" else 0.2 < jumping < 0.5
    # All that comes back elsewhere has jumped.
    assert (vertex_distance(begin, back.configuration)[first + second == 0] < 1e-4).all()


def test_a_way_is_the_same_in_any_company_and_there_may_be_none():
    """How many sub-steps a rod takes is its own matter: short ways are not cut finer beside long ones."""
    cases, at_rest, together = shifted_strips()
    together.motion.end_shift[:] *= np.linspace(0.1, 1.0, len(cases))[:, None]
    assert len(np.unique(together.sub_steps)) > 2
    end, jumps = together.end(at_rest)
    *_, shown = together.follow(at_rest)
    np.testing.assert_array_equal(shown.energy, end.energy)
    for rod in (0, 7, len(cases) - 1):
        row = np.array([rod])
        own, counted = replace(together, motion=together.motion.take(row)).end(at_rest.take(row))
        np.testing.assert_array_equal(own.configuration.quaternions, end.configuration.quaternions[row])
        np.testing.assert_array_equal(counted, jumps[row])
    end, jumps = replace(together, motion=together.motion.take([])).end(at_rest.take([]))
    assert len(end.status) == len(jumps) == 0


@pytest.mark.sampled(1)
@pytest.mark.parametrize("precision", ["f64", "f32", "mixed"])
@pytest.mark.parametrize("degrees", [10, 60])
def test_results_of_a_rod_are_those_of_its_end(precision, degrees):
    """Also for rods whose last sub-step was repeated in parts: relaxed again, they keep their shape and numbers."""
    _, at_rest, way = shifted_strips(degrees, precision=precision)
    *_, shown = way.follow(at_rest)
    for solution in (way.end(at_rest)[0], shown):
        again = relax(solution.configuration, STRIP, way.motion.at(1.0), Newton.careful(), up=UP)
        loose = 1e-3 if precision == "f32" else 1e-6
        np.testing.assert_allclose(solution.energy, again.energy, rtol=loose)
        np.testing.assert_allclose(solution.end_force, again.end_force, rtol=loose, atol=loose * np.abs(again.end_force).max())
        np.testing.assert_array_equal(solution.stable, again.stable)


def test_a_rod_of_two_edges_goes_its_way():
    """It has no edge between its clamps to compare, and still counts as one that is watched."""
    frames = np.array([[[1.0, 0, 0, 0], [np.cos(0.3), 0, 0, np.sin(0.3)]]])
    start = Configuration(np.zeros((1, 3)), frames, np.full(2, 10.0))
    clamps = clamps_at(start, Clamp.POSITION, Clamp.POSITION)
    at_rest = relax(start, STRIP, clamps).configuration
    shift = np.array([[-3.0, 1.0, 0.5]])
    with np.errstate(all="raise"):
        end, jumps = Journey(Motion(clamps, end_shift=shift), STRIP, np.radians(5), start.rest_length).end(at_rest)
    assert end.converged.all() and jumps.tolist() == [0]
    np.testing.assert_allclose(end.configuration.vertices[:, -1], clamps.end_position + shift, atol=1e-9)


LENGTH, EDGES, SHORTENING = 100.0, 64, 0.01
EDGE = LENGTH / EDGES
# Stiff against everything but bending about m1, which is across the plane: the arch stays in it.
ARCH = Material.diagonal(1e8, 1e6, 1e8, 0.0)


def fold() -> float:
    """The largest μ on the branch that begins with the arch, from the beam's closed form."""
    return max(tilt(tau) for tau in np.linspace(6.3, 9.0, 400))


def tilt(tau: float) -> float:
    """μ of the beam under τ: its shape for w'(0) = 1, scaled to ∫ w'² = 2."""
    c, s = np.cos(tau), np.sin(tau)
    rows = [[1, 0, 0, 1], [c, s, 1, 1], [0, tau, 1, 0], [-tau * s, tau * c, 1, 0]]
    a, b, slope, _ = np.linalg.solve(rows, [0, 0, 1, 0])
    x = np.linspace(0, 1, 2001)
    w = -a * tau * np.sin(tau * x) + b * tau * np.cos(tau * x) + slope
    return np.sqrt(2 / np.trapezoid(w * w, x))


def test_the_closed_form_has_the_known_fold():
    assert fold() == pytest.approx(1.7818, abs=1e-4)


@pytest.mark.thorough
def test_it_snaps_where_theory_says_and_comes_back_elsewhere():
    """The near clamp of a hanging arch is tilted about the middle of its edge. Edges are clamped at their middles, so that the
    strip is one edge shorter."""
    slope = -2 * np.sqrt(SHORTENING) * np.sin(2 * np.pi * np.arange(EDGES) / (EDGES - 1))
    rod = Configuration(np.zeros((1, 3)), quaternion_from_matrix(frame(slope))[None], np.full(EDGES, EDGE))
    level, end = frame(np.zeros(1)), np.array([[EDGE + (LENGTH - EDGE) * (1 - SHORTENING), 0, 0]])
    clamps = replace(clamps_at(rod), end_position=end, start_frame=level, end_frame=level)
    expected = np.degrees(fold() * np.sqrt(SHORTENING))
    up = np.arange(0.0, 12.01, 0.2)
    angles = np.concatenate([up, up[-2::-1], -up[1:]])
    frames = frame(np.radians(angles))[:, None]
    places = [EDGE / 2, 0, 0] - EDGE / 2 * frames[..., 0]
    tilted = ClampPath(np.arange(float(len(angles))), start_position=places, start_frame=frames)
    prediction = predict(rod, ARCH, clamps, tilted)
    assert prediction.followed.all()
    jumps = np.flatnonzero(prediction.jumps[:, 0])
    assert 0.5 * (angles[jumps] + angles[jumps - 1]) == pytest.approx([expected, -expected], rel=0.02)
    middle = prediction.vertices[:, 0, EDGES // 2, 2]
    level = np.flatnonzero(angles == 0)
    # Hysteresis: the clamp is level again, and the arch is on the other side.
    assert middle[level[0]] < -3 and middle[level[1]] > 3


@pytest.mark.thorough
def test_sub_steps_repeated_in_parts_begin_where_a_free_end_was(monkeypatch):
    """The place that its clamp states is not used, and may be anything."""
    rod = straight_rod(200.0, 20, (0.0, 0.0, 30.0))
    held = replace(clamps_at(rod, Clamp.FREE), start_position=np.full((1, 3), np.nan))
    around = Surroundings([Plane((0, 0, 0), (0, 0, 1))], 2.0)
    rest = relax(rod, STRIP, held, **around.arguments)
    motion = Motion(held, end_turn=np.array([[0.0, 0.9, 0.0]]))
    plain, repeated = [], []
    for found, least in ((plain, 0.5), (repeated, 0.01)):
        monkeypatch.setattr("doo_ti.motion.journey.OUT_OF_PROPORTION", least)
        way = Journey(motion, STRIP, np.radians(20), rod.rest_length, precision="f64", surroundings=around)
        found.extend(way.follow(rest.configuration))
    assert all(state.converged.all() for state in plain + repeated)
    for one, other in zip(plain, repeated, strict=True):
        assert vertex_distance(one.configuration, other.configuration).max() < 1e-4
