"""Derivatives of rods at rest against dense linear algebra (differences: test_end_loads); which rods have none, here and in a
pullback."""

import numpy as np
import pytest

from doo_ti import Clamp, Material, Newton, Springs, end_loads, pullback, relax, sensitivity
from doo_ti.relaxation.sensitivity import PARAMETERS
from doo_ti.rod.frames import tilt_axes
from tests.conftest import check_refused
from tests.oracle.chain_form import rod_of
from tests.oracle.equilibrium import clamped_start, free_variables
from tests.oracle.sensitivity import dense_sensitivity
from tests.references.rods import chain, clamps_at
from tests.relaxation.rods import PAIRS, definite, one_of_three_at_rest, wandering, with_kinds

SHARP = Newton(tolerance=1e-10)
EVERY = ("bend", "bend_1", "bend_2", "bend_12", "twist", "weight", "rest_curvature", "rest_curvature_per_joint", "gravity")
PENDULUMS = [(Clamp.FREE, Clamp.POSITION), (Clamp.POSITION, Clamp.FREE)]
UP = np.array([0.2, -0.1, 1.0])


@pytest.mark.thorough
@pytest.mark.parametrize("kind", ["round", "ribbon", "edge by edge"])
def test_it_is_the_dense_bordered_system_s(rng, kind):
    count = len(PAIRS)
    rods = wandering(rng, count, 12, rest_length=rng.uniform(2, 4, 12))
    if kind == "round":
        material = Material(rng.uniform(1e5, 3e5, count), rng.uniform(1e5, 3e5, count), rng.uniform(0.5, 2.0, count))
    else:
        bend = definite(rng, count) if kind == "ribbon" else definite(rng, count, 12)
        material = Material(bend, rng.uniform(1e5, 3e5, (count, 11)), 1.3, 0.01 * rng.normal(size=(count, 11, 2)))
    clamps = with_kinds(clamps_at(rods), PAIRS)
    solution = relax(rods, material, clamps, SHARP, up=UP)
    found = sensitivity(solution, EVERY)
    np.testing.assert_array_equal(found.usable, solution.converged & solution.stable)
    assert found.usable.sum() > 0.8 * count
    errors = []
    for row in np.flatnonzero(found.usable):
        rod = rod_of(solution.configuration, material, row, up=UP)
        state, ends = clamped_start(solution.configuration, clamps, row)
        free = free_variables(rod, ends)
        if kind == "round" and max(ends.start, ends.end) < Clamp.FRAME:
            free = free[free != 3]  # the first spin is held
        closed = ends.end != Clamp.FREE
        vertices, rotations = dense_sensitivity(rod, solution.configuration.quaternions[row], free, closed, EVERY)
        if (pair := PAIRS[row]) in PENDULUMS:  # its angle about the vertical is not determined
            swing = np.einsum("ekd,k->ed", solution.configuration.frames[row], UP / np.linalg.norm(UP))
            share = np.einsum("ed,edp->p", swing, found.rotations[row] - rotations) / (swing**2).sum()
            assert relative_errors(found.rotations[row] - swing[..., None] * share, rotations).max() < 1e-6, pair
        else:
            errors += [relative_errors(found.vertices[row], vertices), relative_errors(found.rotations[row], rotations)]
            assert max(errors[-1].max(), errors[-2].max()) < 1e-8, pair
    assert np.median(errors) < 1e-10


def relative_errors(own, dense) -> np.ndarray:
    """(P,) of the columns of EVERY, each against its own largest entry where that matters at all."""
    size = np.abs(dense).max(axis=(0, 1))
    typical = np.concatenate([[2e5] * 4, [1.5e5, 1.0], [0.01] * 24, [1.0] * 3])
    return np.abs(own - dense).max(axis=(0, 1)) / np.maximum(size, 1e-3 * (size * typical).max() / typical)


def test_a_taut_rod_only_spins():
    rods = chain(np.tile([1.0, 0.0, 0.0], (8, 1)), [0, 0, 1], 3.0, spin=0.1 * np.arange(8))
    ribbon = relax(rods, Material.diagonal(2e5, 1e5, 1e5), clamps_at(rods), SHARP)
    assert ribbon.stable.all()
    found = sensitivity(ribbon, ("length", "end_shift", "bend_1", "twist", "weight", "rest_curvature"))
    assert found.usable.all() and (found.vertices[..., 4:] == 0).all() and np.isnan(found.vertices[..., :4]).all()
    assert (found.rotations[:, :, 1:, 4:] == 0).all() and np.isfinite(found.rotations[..., 4:]).all()
    pulled = pullback(ribbon, np.ones((1, 9, 3)), ("twist", "length", "end_shift"))
    assert np.isnan(pulled["length"]).all() and np.isnan(pulled["end_shift"]).all() and pulled["twist"][0] == 0


def test_rods_without_an_equilibrium_have_none(rng):
    solution = one_of_three_at_rest(rng)
    found = sensitivity(solution)
    pulled = pullback(solution, solution.configuration.vertices, ("bend", "forces", "rest_curvature"))
    assert found.usable.tolist() == pulled.usable.tolist() == [True, False, False] and np.isnan(found.rotations[1:]).all()
    for value in (found.vertices, *pulled.gradient.values()):
        assert np.isnan(value[1:]).all() and np.isfinite(value[0]).all()


def test_a_rod_is_the_same_in_any_company(rng):
    rods, cotangent = wandering(rng, 30, 12), rng.normal(size=(30, 13, 3))
    material = Material(np.geomspace(1e5, 3e5, 30), 1e5)
    solution, alone = (relax(own, material.take(rows), clamps_at(own)) for own, rows in (
        (rods, range(30)), (rods.take([7]), [7])))
    np.testing.assert_array_equal(sensitivity(solution).vertices[7], sensitivity(alone).vertices[0])
    pulled, own = pullback(solution, cotangent, ("bend", "forces")), pullback(alone, cotangent[[7]], ("bend", "forces"))
    for name in ("bend", "forces"):
        np.testing.assert_array_equal(pulled[name][7], own[name][0])


@pytest.mark.slow
def test_the_layout_of_a_gpu_gives_the_same_bits(rng, monkeypatch):
    """Threads interleaved in scratch, here run on the processor."""
    rods, cotangent = wandering(rng, 5, 12), rng.normal(size=(5, 13, 3))
    solution = relax(rods, Material(np.geomspace(1e5, 3e5, 5), 1e5), clamps_at(rods))
    every = [name for name in PARAMETERS if name != "modes"]
    own, pulled = sensitivity(solution, EVERY), pullback(solution, cotangent, every)
    monkeypatch.setattr("doo_ti.relaxation.sensitivity_kernel.runtime.start", lambda: "cuda")
    there, again = sensitivity(solution, EVERY), pullback(solution, cotangent, every)
    for here, other in ((own.vertices, there.vertices), (own.rotations, there.rotations), *(
            (pulled[name], again[name]) for name in every)):
        np.testing.assert_array_equal(here, other)


def test_tilt_axes_are_across_up():
    for up in ([0.0, 0.0, 1.0], UP / np.linalg.norm(UP), [0.0, 0.0, -1.0]):
        axes = tilt_axes(np.array(up))
        np.testing.assert_allclose(axes @ axes.T, np.eye(2), atol=1e-14)
        np.testing.assert_allclose(axes @ up, 0, atol=1e-14)
    np.testing.assert_array_equal(tilt_axes(np.array([0.0, 0.0, 1.0])), np.eye(3)[:2])


def test_wrong_input_is_reported(rng):
    rods = wandering(rng, 2, 12)
    solution = relax(rods, Material(1e5, 1e5), clamps_at(rods))
    for parameters, message in ((("bent",), "'bent' is unknown"), (("bend", "bend"), "once"), ((), "give a list"),
                                ("bend", "give a list")):
        check_refused(message, sensitivity, solution, parameters)
    clamps, springs = clamps_at(rods, Clamp.FRAME, Clamp.FREE), Springs(rods.vertices, np.full((2, 13), 50.0))
    check_refused("external energy", sensitivity, relax(rods, Material(1e5, 1e5), clamps, external=springs))


def test_modes_add_up_what_joints_do(rng):
    rods = wandering(rng, 3, 12)
    solution = relax(rods, Material(2e5, 1e5), clamps_at(rods), SHARP)
    modes = rng.normal(size=(2, 11, 2))
    found = sensitivity(solution, ("modes", "rest_curvature_per_joint"), modes)
    joints = found.vertices[..., 2:].reshape(3, 13, 3, 11, 2)
    np.testing.assert_allclose(found.vertices[..., :2], np.einsum("rvkjc,mjc->rvkm", joints, modes), atol=1e-9)
    for given in (None, modes[:, 1:]):
        check_refused("modes", sensitivity, solution, ("modes",), given)


def test_stiffness_modes_are_differences_of_relaxed_rods(rng):
    """Along rods that are curved at rest, of B and of β."""
    rods, step = wandering(rng, 2, 12), 1e-4
    edges, joints = rng.normal(size=(2, 12)), rng.normal(size=(2, 11))
    bend, rest, clamps = 2e5 * np.exp(0.2 * rng.normal(size=12)), rng.normal(scale=1e-3, size=(1, 11, 2)), clamps_at(rods)

    def relaxed(of_bend: np.ndarray, of_twist: np.ndarray):
        material = Material((bend * np.exp(of_bend))[None, :, None, None] * np.eye(2), 1e5 * np.exp(of_twist)[None], 1.0, rest)
        return relax(rods, material, clamps, SHARP)

    solution, modes = relaxed(np.zeros(12), np.zeros(11)), np.stack([edges[:, :-1], edges[:, 1:], joints], axis=-1)
    found = sensitivity(solution, ("stiffness_modes",), stiffness_modes=modes)
    for k in range(2):
        more, less = (relaxed(sign * step * edges[k], sign * step * joints[k]) for sign in (1, -1))
        for own, its in ((found.vertices[..., k], [one.configuration.vertices for one in (more, less)]),
                         (found.loads.end_moment[..., k], [end_loads(one).end_moment for one in (more, less)])):
            slope = (its[0] - its[1]) / (2 * step)
            np.testing.assert_allclose(own, slope, atol=1e-5 * np.abs(slope).max())
    for given in (None, modes[:, 1:]):
        check_refused("stiffness_modes", sensitivity, solution, ("stiffness_modes",), stiffness_modes=given)


def test_parts_are_those_of_the_whole(rng):
    """Blocks of rods; and what is not wanted has no columns."""
    rods = wandering(rng, 6, 12)
    kinds = [(Clamp.FRAME, Clamp.FRAME), (Clamp.FREE, Clamp.FRAME), (Clamp.FRAME, Clamp.FREE)] * 2
    solution = relax(rods, Material(2e5, 1e5), with_kinds(clamps_at(rods), kinds), SHARP)
    names = ("bend", "length", "end_shift", "end_turn")
    whole, part = sensitivity(solution, names), sensitivity(solution, names, first=2, last=5, rotations=False, loads=False)
    np.testing.assert_array_equal(part.vertices, whole.vertices[2:5])
    np.testing.assert_array_equal(part.usable, whole.usable[2:5])
    assert part.configuration.count == 3 and part.rotations.shape[3] == part.loads.end_force.shape[2] == 0
