"""Gradients by one adjoint solve against the columns of sensitivity and against rods relaxed again."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti import Clamp, Material, Newton, PointLoads, Solution, pullback, relax
from doo_ti.relaxation.sensitivity import PARAMETERS, sensitivity
from tests.conftest import check_refused
from tests.contact.clutter import LEANING, OBSTACLES, RADIUS, SLOPE_AND_BALL, sagging
from tests.references.rods import clamps_at
from tests.relaxation.rods import PAIRS, definite, wandering, with_kinds
from tests.relaxation.test_sensitivity import PENDULUMS, SHARP, UP

ALONG = tuple(name for name in PARAMETERS if name != "modes")


def contracted(solution: Solution, cotangent, frames, parameters, modes=None) -> tuple[np.ndarray, np.ndarray]:
    """(R, P) cotangentᵀ · sensitivity, and the size that its terms have."""
    found = sensitivity(solution, parameters, modes)
    turned = np.cross(solution.configuration.frames[..., None], found.rotations[:, :, None], axis=3)
    terms = np.concatenate([part.reshape(len(cotangent), -1, turned.shape[-1]) for part in (
        cotangent[..., None] * found.vertices, frames[..., None] * turned)], axis=1)
    return terms.sum(axis=1), np.sqrt((terms**2).sum(axis=1))


def flat(pulled, parameters) -> np.ndarray:
    return np.concatenate([pulled[name].reshape(len(pulled.usable), -1) for name in parameters], axis=1)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("kind", ["edge by edge", "round"])
def test_it_is_the_adjoint_of_sensitivity(rng, kind):
    count = len(PAIRS)
    rods = wandering(rng, count, 12, rest_length=rng.uniform(2, 4, 12))
    material = Material(2e5, 1.5e5, 1.1) if kind == "round" else Material(
        definite(rng, count, 12), rng.uniform(1e5, 3e5, (count, 11)), 1.3, 0.01 * rng.normal(size=(count, 11, 2)))
    solution = relax(rods, material, with_kinds(clamps_at(rods), PAIRS), SHARP, up=UP)
    cotangent, frames, modes = rng.normal(size=(count, 13, 3)), rng.normal(size=(count, 12, 3, 3)), rng.normal(size=(2, 11, 2))
    for row in map(PAIRS.index, PENDULUMS):  # their angle about the vertical is not determined: nothing may depend on it
        places = solution.configuration.vertices[row]
        swing = np.cross(UP, places - places[-1 if PAIRS[row][0] == Clamp.FREE else 0])
        cotangent[row] -= swing * (swing * cotangent[row]).sum() / (swing**2).sum()
        frames[row] = 0.0
    pulled = pullback(solution, cotangent, PARAMETERS, modes, frames)
    expected, size = contracted(solution, cotangent, frames, PARAMETERS, modes)
    np.testing.assert_array_equal(pulled.usable, sensitivity(solution).usable)
    assert pulled.usable.sum() > 0.8 * count
    off = (np.abs(flat(pulled, PARAMETERS) - expected) / (size + 1e-300))[pulled.usable]
    # Held by both frames a rod hardly moves with B: that column is a small difference, and rounding is up to 1e-8 of it.
    bound = np.where(np.flatnonzero(pulled.usable) == PAIRS.index((Clamp.FRAME, Clamp.FRAME)), 1e-8, 1e-9)
    assert (off.max(axis=1) < bound).all()


@pytest.mark.thorough
def test_rods_relaxed_again_change_so(rng):
    rods = wandering(rng, 6, 12)
    kinds = [(Clamp.FRAME, Clamp.FRAME), (Clamp.TANGENT, Clamp.FRAME), (Clamp.FREE, Clamp.FRAME)] * 2
    clamps, (cotangent, along) = with_kinds(clamps_at(rods), kinds), rng.normal(size=(2, 6, 13, 3))
    material = Material([[2e5, 3e4], [3e4, 1e5]], 1.5e5, 1.0, 0.01 * rng.normal(size=(6, 11, 2)))
    force, mass = 30.0 * rng.normal(size=(6, 13, 3)), rng.uniform(0, 30, (6, 13))
    solution = relax(rods, material, clamps, SHARP, up=UP, external=PointLoads(force, mass))
    pulled = pullback(solution, cotangent, ("forces",))
    assert pulled.usable.all()

    def scalar(more: float):
        again = relax(solution.configuration, material, clamps, replace(SHARP, first_shift=0.0), up=UP,
                      external=PointLoads(force + more * along, mass))
        assert again.converged.all()
        return np.einsum("rvk,rvk->r", cotangent, again.configuration.vertices)

    near, far = ((scalar(step) - scalar(-step)) / (2 * step) for step in (0.1, 0.2))
    expected = (4 * near - far) / 3
    assert np.abs((pulled["forces"] * along).sum(axis=(1, 2)) - expected).max() < 1e-6 * np.abs(expected).max()


@pytest.mark.thorough
def test_contacts_stay_as_they_are():
    rng, close = np.random.default_rng(5), Newton(max_iterations=1000, gap_tolerance=1e-8)
    start, material, clamps = sagging(rng, 48)
    amid = relax(start, material, clamps, close, obstacles=OBSTACLES, radius=RADIUS, up=(0.1, 0.05, 1.0))
    ends = [relax(LEANING, Material(4e4, 3e4), with_kinds(clamps_at(LEANING), [kinds]), close, **SLOPE_AND_BALL)
            for kinds in ((Clamp.FRAME, Clamp.FREE), (Clamp.FREE, Clamp.FRAME))]
    for solution in (amid, *ends):
        cotangent, none = rng.normal(size=solution.configuration.vertices.shape), 0 * solution.configuration.frames
        pulled = pullback(solution, cotangent, ALONG)
        expected, size = contracted(solution, cotangent, none, ALONG)
        rows = pulled.usable & solution.contact.touching.any(axis=1)
        assert rows.any() and rows.sum() >= 0.7 * len(rows)
        # Contacts are stiff: rounding counts for more.
        typical = np.maximum(size, 1e-9 * size.max(axis=1, keepdims=True))
        assert (np.abs(flat(pulled, ALONG) - expected) / typical)[rows].max() < 1e-6


def at_rest(rods) -> Solution:
    return relax(rods, Material(1e5, 1e5), clamps_at(rods))


def test_no_cotangents_and_no_rods(rng):
    pulled = pullback(at_rest(wandering(rng, 2, 12)), None, ("twist", "forces"))
    assert pulled.usable.all() and (pulled["twist"] == 0).all() and (pulled["forces"] == 0).all()
    none = at_rest(wandering(rng, 2, 12).take([]))
    assert pullback(none, np.zeros((0, 13, 3)))["bend"].shape == (0,)


def test_wrong_input_is_reported(rng):
    solution, bad = at_rest(wandering(rng, 2, 12)), np.zeros((2, 13, 3))
    bad[1, 4] = np.nan
    for given, field in (({"cotangent": np.zeros((2, 12, 3))}, "cotangent"), ({"cotangent": bad}, "cotangent"),
                         ({"cotangent": None, "frames": np.zeros((2, 12, 3))}, "frames"),
                         ({"cotangent": None, "parameters": ("bent",)}, "parameters"),
                         ({"cotangent": None, "parameters": ("modes",)}, "modes")):
        check_refused(f"^pullback: {field}: ", pullback, solution, **given)
