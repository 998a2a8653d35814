"""Θ and friction from recordings of rods that are moved about on a table."""

import json
from dataclasses import replace

import numpy as np
import pytest

from doo_ti import Clamp, Configuration, Grippers, Moving, Observations, Plane, RecordedMotion, Stepping, Surroundings, simulate
from doo_ti.commands.cli import main
from doo_ti.dynamics.identify import IdentifyOptions, identify, identify_from_guesses
from doo_ti.dynamics.rollouts import Nearby
from doo_ti.dynamics.theta import MotionTheta, Stills, Unknowns, load_theta, save_form, simulated
from doo_ti.rod.frames import bishop_frames, quaternion_from_matrix, rotation_matrix
from tests.commands.calls import refused
from tests.conftest import check_refused

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
    ramp = (times / 0.3) ** 2 / (1.0 + (times / 0.3) ** 2)
    rates, phases, sizes = (rng.uniform(low, high, (COUNT, 1, axes)) for low, high in ((2, 6), (0, 6), (-size, size)))
    return ramp * sizes * np.sin(rates * times + phases)


def arcs(rng) -> tuple[Configuration, np.ndarray]:
    """Rods just above the table, and the frames (COUNT, EDGES, 3, 3) of their edges."""
    bent = rng.uniform(0.9, 1.5, (COUNT, 1)) * rng.choice([-1.0, 1.0], (COUNT, 1)) * np.linspace(-1.0, 1.0, EDGES)
    bent[:, [0, -1]] = bent[:, [1, -2]]
    tangents = np.stack([np.cos(bent), np.sin(bent), 0.0 * bent], axis=-1)
    up = np.broadcast_to(TRUE.reference, (COUNT, 3))
    frames = bishop_frames(tangents, up)
    return Configuration(HEIGHT * up, quaternion_from_matrix(frames), TRUE.rest_length), frames


def recorded(rng, end: Clamp = Clamp.FRAME) -> RecordedMotion:
    """Arcs whose ends, or whose first end alone, are held just above the table and carried about."""
    start, frames = arcs(rng)
    together, ways = np.pad(swings(rng, 100.0, 2), ((0, 0), (0, 0), (0, 1))), []
    for vertex in (0, -1):
        apart = np.pad(swings(rng, 15.0, 2), ((0, 0), (0, 0), (0, 1)))
        turn = rotation_matrix(swings(rng, 0.5, 1) * TRUE.reference)
        ways += [start.vertices[:, None, vertex] + together + apart, turn @ frames[:, None, vertex]]
    material, dynamics = simulated([TRUE])
    grippers = Grippers(Clamp.FRAME, end, ways[0], ways[2], ways[1], ways[3])
    found = simulate(start, material, grippers, dynamics, Stepping(RATE), obstacles=[TABLE.rubbing(TRUE.friction)],
                     radius=RADIUS)
    assert found.converged.all()
    motion = RecordedMotion.of(found.positions[:, SETTLING - 1 :], RATE, free_end=end == Clamp.FREE)
    # As they move from where their first two frames show them.
    positions, status = AS_RECORDED.rollouts(motion, TRUE).predicted([TRUE])
    assert (status == 0).all() and np.abs(positions[:, 0] - motion.positions).max() < 0.2
    return replace(motion, positions=positions[:, 0])


@pytest.fixture(scope="module")
def motion() -> RecordedMotion:
    return recorded(np.random.default_rng(2011))


@pytest.mark.thorough
def test_friction_and_stiffness_are_found_in_noise(motion, rng):
    """0.3 mm at every marker, those of the grippers included, whose noise shakes the rod loose unless it is smoothed."""
    noisy = RecordedMotion.of(motion.positions + 0.3 * rng.normal(size=motion.positions.shape), RATE)
    found = identify_from_guesses(noisy, OPTIONS)
    rows = {row["name"]: row for row in found.parameters()}
    for name, off in (("bend", 0.05), ("bend_damping", 0.1), ("friction", 0.05)):
        row = rows[name]
        print(f"{name} {row['value']:.4g} [{row['low']:.4g}, {row['high']:.4g}], {getattr(TRUE, name):.4g} in truth")
        assert row["value"] == pytest.approx(getattr(TRUE, name), rel=off)
    shaken = identify_from_guesses(noisy, AS_RECORDED)
    assert abs(found.theta.friction - TRUE.friction) < abs(shaken.theta.friction - TRUE.friction)


@pytest.mark.thorough
def test_a_rope_may_be_dragged_at_one_end(rng):
    """With 0.3 mm of noise at all markers; the free end slides as well."""
    motion = recorded(rng, Clamp.FREE)
    noisy = replace(motion, positions=motion.positions + 0.3 * rng.normal(size=motion.positions.shape))
    for seen, smoothing, off in ((motion, 1, 1e-3), (noisy, None, 0.05)):
        found = identify(seen, GUESS, replace(OPTIONS, smoothing=smoothing)).theta
        assert found.bend == pytest.approx(TRUE.bend, rel=off) and found.friction == pytest.approx(TRUE.friction, rel=off)


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


@pytest.mark.thorough
def test_differences_of_rollouts_are_those_of_any_step(motion):
    """Ten times the step gives the same slopes, but where contacts begin."""
    fitted = Unknowns(TRUE, 0, OPTIONS.fitted)
    rollouts, p = OPTIONS.rollouts(motion.until(60), TRUE), fitted.vector(TRUE)
    slopes = []
    for step in (5e-3, 5e-2):
        nearby = [Nearby(fitted.theta(p - away), fitted.theta(p + away), 2 * step) for away in step * np.eye(len(p))]
        positions, found, status = rollouts.differentiated(TRUE, nearby)
        assert (status == 0).all() and positions.shape == found[:, 0].shape
        slopes.append(found)
    square = [np.sum(value**2, axis=(0, 2, 3, 4)) for value in (slopes[0] - slopes[1], slopes[0])]
    off = np.sqrt(square[0] / square[1])
    assert (off < 0.1).all()


@pytest.mark.slow
def test_still_frames_lie_on_the_table(motion):
    """Their derivatives are differences, with the contacts that bear a force."""
    seen = Observations(motion.positions[:3, 0], rest_length=TRUE.rest_length)
    stills = Stills.of(seen, TRUE.reference, TRUE.rest_length.sum(), OPTIONS.surroundings)
    unknowns = Unknowns(TRUE, 1, ())
    solution = stills.rested(TRUE)
    assert (solution.contact.force[..., 2] > 0).any(axis=1).all() and stills.residuals(solution)[1].all()
    slopes, p = stills.slopes(TRUE, solution, unknowns), unknowns.vector(TRUE)
    for k in range(len(p)):
        step = 1e-4 * np.eye(len(p))[k]
        ahead, behind = (stills.residuals(stills.rested(unknowns.theta(q)))[0] for q in (p + step, p - step))
        difference = (ahead - behind) / 2e-4
        assert np.abs(slopes[:, k] - difference).max() < 0.02 * np.abs(difference).max() + 1e-3, unknowns.names[k]


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


@pytest.mark.thorough
def test_commands_take_the_table_and_the_friction(motion, tmp_path, capsys):
    np.savez(tmp_path / "dragged.npz", positions_mm=motion.positions, rate_hz=RATE)
    (tmp_path / "table.toml").write_text('[[obstacles]]\nkind = "plane"\npoint = [0, 0, 0]\nnormal = [0, 0, 1]\n')
    among = ["--obstacles", str(tmp_path / "table.toml"), "--radius", str(RADIUS)]
    source, out = str(tmp_path / "dragged.npz"), tmp_path / "theta.json"
    fit = ["identify", source, "--modes", "0", "--fit", "bend_damping,friction", "--out", str(out)]
    assert main([*fit, "--smoothing", "1", "--picture", str(tmp_path / "fit.png"), *among]) == 0
    assert "friction        0.3" in capsys.readouterr().out and (tmp_path / "fit.png").exists()
    assert load_theta(out).friction == pytest.approx(TRUE.friction, rel=0.02)

    def error(theta) -> float:
        other, made = tmp_path / "other.json", tmp_path / "f.npz"
        other.write_text(json.dumps(theta))
        assert main(["simulate", source, "--theta", str(other), "--out", str(made), *among]) == 0
        return float(np.load(made)["error_mm"].mean())

    written = json.loads(out.read_text())
    assert error(written) < 0.1 < error(written | {"friction": 0.25}) < error(written | {"friction": 0.1})
    for more in (fit, [*fit, *among, "--smoothing", "4"], [*fit, *among[:2], "--radius", "20"]):
        capsys.readouterr()
        refused(capsys, tmp_path, more)


def test_theta_keeps_its_friction(tmp_path):
    for theta in (TRUE, replace(TRUE, friction=None)):
        form = {key: value.tolist() if isinstance(value, np.ndarray) else value for key, value in save_form(theta).items()}
        (tmp_path / "theta.json").write_text(json.dumps(form))
        assert load_theta(tmp_path / "theta.json").friction == theta.friction
    (tmp_path / "theta.json").write_text(json.dumps(form | {"friction": -0.1}))
    check_refused("friction", load_theta, tmp_path / "theta.json")
