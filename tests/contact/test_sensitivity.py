"""dΓ*/dΘ of rods that touch obstacles against rods relaxed again, and against the same rods seen from their other end."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti import Clamp, Configuration, Itself, Material, Newton, PointLoads, end_loads, pullback, relax, sensitivity
from doo_ti.rod.shapes import end_clamps, overhand_knot
from tests.contact.clutter import LEANING, OBSTACLES, RADIUS, SLOPE_AND_BALL, sagging
from tests.references.rods import clamps_at
from tests.relaxation.rods import LOADS, relaxed_again, with_kinds

SHARP = Newton(tolerance=1e-11, max_iterations=2000, gap_tolerance=1e-10)  # so that differences of rods relaxed twice are exact
UP = np.array([0.1, 0.05, 1.0]) / np.linalg.norm([0.1, 0.05, 1.0])


@pytest.mark.thorough
def test_rods_relaxed_again_move_so():
    """Amid obstacles of all kinds, by central differences: places, and forces and moments at both ends."""
    start, material, clamps = sagging(np.random.default_rng(5), 48)
    among = dict(obstacles=OBSTACLES, radius=RADIUS, up=UP)
    rest = relax(start, material, clamps, SHARP, **among)
    found = sensitivity(rest, ("bend", "twist", "weight", "rest_curvature", "up", "start_turn", "end_shift", "length"))
    touching = rest.contact.touching
    considered = found.usable & touching.any(axis=1) & (rest.residual < 1e-9)
    assert considered.sum() >= 25
    steps = {"bend": 20.0, "twist": 20.0, "weight": 1e-4, "rest_curvature": 1e-6, "end_shift": 1e-4, "length": 1e-6}
    for column, title in enumerate(found.columns):
        step = steps.get(title.partition("[")[0], 1e-5)
        more, less = (relaxed_again(rest, material, clamps, SHARP, title, sign * step, **among) for sign in (1, -1))
        same = (more.contact.touching == touching).all(axis=1) & (less.contact.touching == touching).all(axis=1)
        rows = considered & more.converged & less.converged & same
        assert rows.sum() >= 0.9 * considered.sum(), title
        ahead, behind = end_loads(more), end_loads(less)
        pairs = [(found.vertices, more.configuration.vertices - less.configuration.vertices)]
        pairs += [(getattr(found.loads, load), getattr(ahead, load) - getattr(behind, load)) for load in LOADS]
        for derivative, difference in pairs:
            own = derivative[rows][..., column].reshape(rows.sum(), -1)
            off = np.abs(own - difference[rows].reshape(own.shape) / (2 * step)).max(axis=1) / np.abs(own).max(axis=1)
            # Some rods jump, or end where rounding limits them.
            assert np.median(off) < 1e-5 and np.quantile(off, 0.85) < 1e-3, title


@pytest.mark.thorough
def test_rods_seen_from_the_other_end_move_alike():
    """A rod held at one end on a slope and a ball: whether the free end is its first one or its last changes nothing."""
    close = Newton(max_iterations=1000, gap_tolerance=1e-8)
    one, among = LEANING, SLOPE_AND_BALL
    material, common = Material(4e4, 3e4, 1.0), ("bend", "weight", "up", "gravity", "length")
    own = relax(one, material, with_kinds(clamps_at(one), [(Clamp.FRAME, Clamp.FREE)]), close, **among)
    w, x, y, z = np.moveaxis(own.configuration.quaternions[:, ::-1], -1, 0)
    turned = Configuration(own.configuration.vertices[:, -1], np.stack([-y, -z, w, x], axis=-1), one.rest_length)
    clamps = with_kinds(clamps_at(turned), [(Clamp.FREE, Clamp.FRAME)])
    for solver in (close, replace(close, first_shift=0.0)):
        other = relax(turned, material, clamps, solver, **among)
        assert own.stable.all() and other.stable.all() and own.contact.touching.sum() >= 8
        np.testing.assert_allclose(other.configuration.vertices[0, ::-1], own.configuration.vertices[0], atol=1e-8)
        here = sensitivity(own, (*common, "start_shift", "start_turn"))
        there = sensitivity(other, (*common, "end_shift", "end_turn"))
        for a, b in ((here.vertices, there.vertices[:, ::-1]), (here.loads.start_force, there.loads.end_force),
                     (here.loads.start_moment, there.loads.end_moment)):
            size = np.abs(a).reshape(-1, a.shape[-1]).max(axis=0)
            assert (np.abs(a - b).reshape(-1, a.shape[-1]).max(axis=0) < 1e-5 * np.maximum(size, 1e-9)).all()


def test_loads_balance_weight_and_contact():
    start, material, clamps = sagging(np.random.default_rng(5), 64)
    rest = relax(start, material, clamps, obstacles=OBSTACLES, radius=RADIUS, up=UP)
    loads, rows = end_loads(rest), rest.converged
    weight = 2.0 * start.rest_length.sum() * UP
    together = loads.start_force + loads.end_force + rest.contact.force.sum(axis=1)
    assert np.abs(together - weight)[rows].max() < 1e-9 * np.abs(weight).max()
    # Moments about the start: of the clamps, of the contacts, and of the weight of every vertex's half edges.
    x = rest.configuration.vertices - rest.configuration.vertices[:, :1]
    share = np.ones(x.shape[1])
    share[[0, -1]] = 0.5
    hanging = -2.0 * start.rest_length.mean() * share[:, None] * UP
    moment = (loads.start_moment + loads.end_moment + np.cross(x[:, -1], loads.end_force)
              + np.cross(x, rest.contact.force + hanging).sum(axis=1))
    assert np.abs(moment)[rows].max() < 1e-6 * np.abs(loads.start_moment)[rows].max()


@pytest.mark.thorough
def test_point_loads_stiffen_rods_in_contact():
    """Forces and masses, on a slope and a ball, the free end last or first: by central differences of fourth order."""
    one, among, rng = LEANING, SLOPE_AND_BALL, np.random.default_rng(5)
    close = Newton(tolerance=1e-10, max_iterations=1000, gap_tolerance=1e-8)
    loads, cotangent = PointLoads(rng.normal(size=(1, 25, 3)), 1.0), rng.normal(size=(1, 25, 3))
    for kinds in ((Clamp.FRAME, Clamp.FREE), (Clamp.FREE, Clamp.FRAME), (Clamp.FRAME, Clamp.POSITION)):
        clamps = with_kinds(clamps_at(one), [kinds])
        if kinds[1] == Clamp.POSITION:
            clamps = replace(clamps, end_position=clamps.end_position - [4.0, 0.0, 0.0])

        def again(step, begin, solver=replace(close, first_shift=0.0), clamps=clamps):
            return relax(begin, Material(4e4 + step, 3e4, 1.0), clamps, solver, external=loads, **among)

        rest = again(0.0, one, close)
        assert rest.stable.all() and rest.contact.touching.any()
        near, far = ((again(step, rest).configuration.vertices - again(-step, rest).configuration.vertices) / (2 * step)
                     for step in (200.0, 400.0))
        found = sensitivity(rest, ("bend",)).vertices[..., 0]
        assert np.abs(found - (4 * near - far) / 3).max() < 1e-4 * np.abs(found).max()
        pulled = pullback(rest, cotangent, ("bend",))["bend"]
        np.testing.assert_allclose(pulled, (cotangent * found).sum(axis=(1, 2)), rtol=1e-6)


def test_rods_that_touch_themselves_have_none():
    knot = overhand_knot(200.0, 100, radius=1.0, loop=12.0)
    clamps = end_clamps(knot, Clamp.TANGENT, Clamp.TANGENT)
    rest = relax(knot, Material(1e5, 1e5, 0.0), clamps, obstacles=[Itself()], radius=1.0)
    found = sensitivity(rest)
    assert rest.converged.all() and np.isfinite(end_loads(rest).start_force).all()
    assert not found.usable.any() and np.isnan(found.vertices).all()
