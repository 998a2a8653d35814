"""Θ and friction from recordings of rods that are moved about on a table."""

import json
from dataclasses import replace

import numpy as np
import pytest

from doo_ti import Clamp, Configuration, Grippers, Moving, Observations, Plane, RecordedMotion, Stepping, Surroundings, simulate
from doo_ti.commands.results import plain
from doo_ti.dynamics.identify import IdentifyOptions, identify, identify_from_guesses
from doo_ti.dynamics.theta import MotionTheta, Stills, Unknowns, load_theta, save_form, simulated
from doo_ti.rod.frames import bishop_frames, quaternion_from_matrix, rotation_matrix
from tests.commands.calls import made
from tests.conftest import SEED, check_refused
from tests.dynamics.test_identify import slopes_and_differences

RATE, COUNT, FRAMES, SETTLING = 100.0, 6, 150, 60
RADIUS, HEIGHT, EDGE, EDGES = 4.0, 12.0, 40.0, 12  # mm
TABLE = Plane((0, 0, 0), (0, 0, 1))
TRUE = MotionTheta(
    bend=2e6, twist_ratio=1.0, bend_damping=0.03, drag=0.3, quadratic_drag=1e-4, marker_share=0.0, rest=np.zeros((2, 0)),
    rest_length=np.full(EDGES, EDGE), reference=np.array([0.0, 0.0, 1.0]), friction=0.35)
OPTIONS = IdentifyOptions(modes=0, fitted=("bend_damping", "friction"), surroundings=Surroundings([TABLE], RADIUS))
AS_RECORDED = replace(OPTIONS, smoothing=1)
GUESS = replace(TRUE, bend=4e6, bend_damping=0.01, friction=0.6)


def swings(rng, size: float, axes: int) -> np.ndarray:
    """(COUNT, SETTLING + FRAMES, axes) ways that grow out of rest within half a second."""
    times = np.maximum(np.arange(SETTLING + FRAMES) - SETTLING, 0)[:, None] / RATE
    rates, phases, sizes = (rng.uniform(low, high, (COUNT, 1, axes)) for low, high in ((2, 6), (0, 6), (-size, size)))
    return times**2 / (0.3**2 + times**2) * sizes * np.sin(rates * times + phases)


def arcs(rng) -> tuple[Configuration, np.ndarray]:
    """Rods just above the table, and the frames (COUNT, EDGES, 3, 3) of their edges."""
    bent = rng.uniform(0.9, 1.5, (COUNT, 1)) * rng.choice([-1.0, 1.0], (COUNT, 1)) * np.linspace(-1.0, 1.0, EDGES)
    bent[:, [0, -1]] = bent[:, [1, -2]]
    tangents = np.stack([np.cos(bent), np.sin(bent), 0.0 * bent], axis=-1)
    up = np.broadcast_to(TRUE.reference, (COUNT, 3))
    frames = bishop_frames(tangents, up)
    return Configuration(HEIGHT * up, quaternion_from_matrix(frames), TRUE.rest_length), frames


def recorded(rng) -> RecordedMotion:
    """Arcs whose ends are held just above the table and carried about."""
    start, frames = arcs(rng)
    together, ways = np.pad(swings(rng, 100.0, 2), ((0, 0), (0, 0), (0, 1))), []
    for vertex in (0, -1):
        apart = np.pad(swings(rng, 15.0, 2), ((0, 0), (0, 0), (0, 1)))
        turn = rotation_matrix(swings(rng, 0.5, 1) * TRUE.reference)
        ways += [start.vertices[:, None, vertex] + together + apart, turn @ frames[:, None, vertex]]
    grippers = Grippers(Clamp.FRAME, Clamp.FRAME, ways[0], ways[2], ways[1], ways[3])
    (material, dynamics), rough = simulated([TRUE]), TABLE.rubbing(TRUE.friction)
    found = simulate(start, material, grippers, dynamics, Stepping(RATE), obstacles=[rough], radius=RADIUS)
    assert found.converged.all()
    motion = RecordedMotion.of(found.positions[:, SETTLING - 1 :], RATE)
    # As they move from where their first two frames show them, in edges and steps an eighth as long.
    positions, status = AS_RECORDED.rollouts(motion, TRUE, 3).predicted([TRUE])
    assert (status == 0).all()
    return replace(motion, positions=positions[:, 0])


@pytest.fixture(scope="module")
def motion() -> RecordedMotion:
    return recorded(np.random.default_rng(SEED))


@pytest.mark.slow
def test_intervals_hold_the_truth(rng):
    """Of ten sets of six recordings, with 0.3 mm at every marker."""
    inside, off = [], []
    for _ in range(10):
        motion = recorded(rng)
        motion = RecordedMotion.of(motion.positions + 0.3 * rng.normal(size=motion.positions.shape), RATE)
        rows = {row["name"]: row for row in identify_from_guesses(motion, OPTIONS).parameters()}
        truth = {name: getattr(TRUE, name) for name in ("bend", "friction")}
        inside.append([(rows[name]["low"] or 0.0) <= truth[name] <= rows[name]["high"] for name in truth])
        off.append([rows[name]["value"] / truth[name] - 1.0 for name in truth])
    largest = np.abs(off).max(axis=0)
    print(f"{np.mean(inside):.0%} of the intervals contain the truth; off by at most {largest[0]:.1%} in bend, "
          f"{largest[1]:.1%} in friction, {np.median(np.abs(off)):.1%} in the median")
    assert np.mean(inside) > 0.7 and (largest < 0.15).all()


@pytest.mark.slow
def test_still_frames_lie_on_the_table(motion):
    """Their derivatives are differences, with the contacts that bear a force."""
    seen = Observations(motion.positions[:3, 0], rest_length=TRUE.rest_length)
    stills = Stills.of(seen, TRUE.reference, TRUE.rest_length.sum(), OPTIONS.surroundings)
    solution = stills.rested(TRUE)
    assert (solution.contact.force[..., 2] > 0).any(axis=1).all() and stills.residuals(solution)[1].all()
    for slope, difference in zip(*slopes_and_differences(stills, TRUE, Unknowns(TRUE, 1, ())), strict=True):
        assert np.abs(slope - difference).max() < 0.02 * np.abs(difference).max() + 1e-3


@pytest.mark.parametrize("wrong, problem", [
    ({"iterations": 0}, "iterations: 0"), ({"horizons": ()}, "horizons"), ({"fitted": ("mass",)}, "'mass' is unknown"),
    ({"delta": -1.0}, "delta: -1"), ({"modes": -1}, "modes: -1"), ({"fitted": ("friction",)}, "friction without obstacles"),
    ({"surroundings": Surroundings([Moving(TABLE, np.zeros((4, 3)))], RADIUS)}, "obstacles that rest"),
    ({"smoothing": 4}, "odd number")])
def test_options_that_cannot_be(wrong, problem):
    check_refused(problem, IdentifyOptions, **wrong)


def test_what_cannot_be_identified_is_one_line(rng):
    motion = RecordedMotion.of(np.repeat(arcs(rng)[0].vertices[:, None], 20, axis=1), RATE)
    check_refused("no friction", identify, motion, replace(GUESS, friction=None), OPTIONS)
    high = replace(OPTIONS, surroundings=Surroundings([Plane((0, 0, 8.5), (0, 0, 1))], RADIUS))
    check_refused(r"hold the rod up to 0\.5\d* mm inside", identify, motion, GUESS, high)


def written(path, friction: float | None):
    path.write_text(json.dumps(plain(save_form(TRUE)) | {"friction": friction}))
    return path


@pytest.mark.thorough
def test_simulate_takes_the_table_and_the_friction_of_theta(motion, tmp_path):
    np.savez(tmp_path / "dragged.npz", positions_mm=motion.positions, rate_hz=RATE)
    (tmp_path / "table.toml").write_text('[[obstacles]]\nkind = "plane"\npoint = [0, 0, 0]\nnormal = [0, 0, 1]\n')
    errors = []
    for friction in (TRUE.friction, 0.25, 0.1):
        found = made(["simulate", tmp_path / "dragged.npz", "--theta", written(tmp_path / "theta.json", friction),
                      "--out", tmp_path / "f.npz", "--obstacles", tmp_path / "table.toml", "--radius", RADIUS])
        errors.append(found["error_mm"].mean())
        assert found["contact_force"].shape == found["positions_mm"].shape
    assert errors[0] < 0.1 < errors[1] < errors[2]


def test_theta_keeps_its_friction(tmp_path):
    for friction in (TRUE.friction, None):
        assert load_theta(written(tmp_path / "theta.json", friction)).friction == friction
    check_refused("friction", load_theta, written(tmp_path / "theta.json", -0.1))
