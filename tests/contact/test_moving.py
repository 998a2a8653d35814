"""Obstacles that move: only how rod and obstacle move against each other counts, and a belt drags a rod by its friction."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti import Clamp, ClampPath, Dynamics, Grippers, Material, Moving, Stepping, predict_moving, relax, simulate
from doo_ti.commands.cli import main
from doo_ti.contact.obstacles import Capsule, Cylinder, Plane
from doo_ti.contact.touch import GAP_TOLERANCE, Touch
from doo_ti.dynamics.parameters import GRAVITY
from doo_ti.dynamics.scene import load_motion_scene
from doo_ti.rod.frames import rotation_matrix
from doo_ti.rod.shapes import end_clamps, hanging, straight_rod
from tests.commands.calls import refused
from tests.conftest import check_refused

RADIUS, INSTANTS = 2.0, 21
TIME = np.linspace(0.0, 1.0, INSTANTS)
QUASI_STATIC, DYNAMICS = Stepping(20.0, 3, "euler", quasi_static=True), Dynamics(density=1.0)
PEG = Cylinder((0, -50, -45), (0, 50, -45), 10.0, friction=0.3)
WAY = np.stack([12 * np.sin(2 * TIME) * TIME, 4 * TIME**2, 35 * TIME], axis=-1)
UNTURNED = np.broadcast_to(np.eye(3), (INSTANTS, 3, 3))


def a_rope(weight: float, clamp: Clamp = Clamp.POSITION):
    """A relaxed rod between two clamps above the peg, its material and its clamps."""
    rod, clamps = hanging(120.0, 24, (-40.0, 0.0, 20.0), (40.0, 0.0, 20.0), clamp=clamp)
    material = Material(2e4, 2e4, weight)
    return relax(rod, material, clamps).configuration, material, clamps


def moved(rope, material, grippers: Grippers, obstacle, stepping: Stepping = QUASI_STATIC):
    return simulate(rope, material, grippers, DYNAMICS, stepping, obstacles=[obstacle], radius=RADIUS)


def held(clamps, rotation: np.ndarray, shift: np.ndarray) -> Grippers:
    """Grippers at R x + s of where the clamps are, (T, 3, 3) and (T, 3)."""
    ends = (rotation @ place[0] + shift for place in (clamps.start_position, clamps.end_position))
    frames = (rotation @ frame[0] for frame in (clamps.start_frame, clamps.end_frame))
    return Grippers(clamps.start, clamps.end, *(path[None] for path in (*ends, *frames)))


@pytest.mark.thorough
def test_a_peg_that_moves_is_a_rope_that_moves_the_other_way():
    rope, material, clamps = a_rope(1.0)
    drawn = moved(rope, material, held(clamps, UNTURNED, -WAY), PEG)
    pushed = moved(rope, material, Grippers.resting(clamps, INSTANTS), Moving(PEG, WAY))
    assert drawn.converged.all() and pushed.converged.all() and np.ptp(drawn.touch) == Touch.SLIPS
    np.testing.assert_allclose(drawn.positions + WAY[1:, None], pushed.positions, atol=1e-9)
    np.testing.assert_allclose(pushed.contact_force, drawn.contact_force, atol=1e-6 * np.abs(drawn.contact_force).max())
    np.testing.assert_allclose(pushed.friction_work, drawn.friction_work, rtol=1e-6)


def test_a_peg_that_turns_is_a_rope_that_turns_the_other_way():
    """A rope without weight is the same seen from a frame that turns."""
    rope, material, clamps = a_rope(0.0, Clamp.FRAME)
    at_once = Stepping(20.0, 1, "euler", quasi_static=True)  # substeps are on cubics, which turned ones are not
    turn = np.stack([0.1 * TIME, 0.3 * TIME, -0.1 * TIME**2], axis=-1)
    rotation, way = rotation_matrix(turn), np.stack([0 * TIME, 3 * TIME, 28 * TIME], axis=-1)
    back = np.swapaxes(rotation, 1, 2)
    drawn = moved(rope, material, held(clamps, back, -(back @ way[..., None])[..., 0]), PEG, at_once)
    turning = Moving(PEG, way, rotation, pivot=(0, 0, 0))
    pushed = moved(rope, material, Grippers.resting(clamps, INSTANTS), turning, at_once)
    assert drawn.converged.all() and pushed.converged.all() and (drawn.touch > 0).any()
    seen = (rotation[1:, None] @ drawn.positions[0][..., None])[..., 0] + way[1:, None]
    np.testing.assert_allclose(seen, pushed.positions[0], atol=5 * GAP_TOLERANCE * RADIUS)
    np.testing.assert_allclose(pushed.friction_work, drawn.friction_work, rtol=1e-3)


@pytest.mark.parametrize("stepping", [
    pytest.param(QUASI_STATIC, id="quasi-static"), pytest.param(Stepping(20.0, 2), id="f64"),
    pytest.param(Stepping(20.0, 2, precision="f32"), id="f32", marks=pytest.mark.slow)])
def test_one_launch_is_as_many(stepping):
    """Every step in a launch of its own, as ``detailed`` makes them: the same bits, though a rope that slips has a larger κ."""
    rope, material, clamps = a_rope(1.0)
    grippers = held(clamps, UNTURNED, -0.5 * WAY)
    once, often = (moved(rope, material, grippers, PEG, replace(stepping, detailed=detailed)) for detailed in (False, True))
    assert once.converged.all() and once.friction_work[0, -1] > 0.0
    for name in ("positions", "iterations", "contact_force", "friction_work", "touch"):
        np.testing.assert_array_equal(getattr(once, name), getattr(often, name), err_msg=name)


def test_a_belt_drags_a_rod_along():
    """A free rod on a belt that starts at once is drawn along by μ g until it is as fast."""
    rod = straight_rod(60.0, 6, (0.0, 0.0, RADIUS), (1.0, 0.0, 0.0))
    rate, speed, friction = 100.0, 400.0, 0.2
    time, until = np.arange(31) / rate, speed / (friction * GRAVITY)
    free = Grippers.resting(end_clamps(rod, Clamp.FREE, Clamp.FREE), len(time))
    belt = Moving(Plane((0, 0, 0), (0, 0, 1), friction), np.outer(speed * time, [0.0, 1.0, 0.0]))
    found = moved(rod, Material(1e5, 1e5), free, belt, Stepping(rate, 4, "euler"))
    assert found.converged.all()
    exact = np.where(time < until, 0.5 * friction * GRAVITY * time**2, speed * (time - 0.5 * until))[1:]
    np.testing.assert_allclose(found.positions[0, :, :, 1].mean(axis=1), exact, atol=0.02 * exact[-1])
    assert (found.touch[0, 1:10] == Touch.SLIPS).all() and (found.touch[0, -1] == Touch.STICKS).all()


def test_obstacles_of_their_own():
    """Rods with a moving obstacle each move as alone."""
    rope, material, clamps = a_rope(1.0)
    way = TIME[:, None] * np.array([[0, 0, 35], [8, 0, 35], [-5, 0, 35]])[:, None]
    rows, grippers = [0, 0, 0], Grippers.resting(clamps, INSTANTS)
    together = moved(rope.take(rows), material, grippers.take(rows), Moving(PEG, way))
    alone = moved(rope, material, grippers, Moving(PEG, way[1]))
    np.testing.assert_array_equal(together.positions[1], alone.positions[0])
    assert together.converged.all() and np.abs(together.positions[0] - together.positions[1]).max() > 1.0


def test_wrong_motions_are_one_line():
    rope, material, clamps = a_rope(1.0)
    fast = Moving(PEG, np.outer(300.0 * TIME, [0.0, 0.0, 1.0]))
    given = rope, material, Grippers.resting(clamps, INSTANTS)
    check_refused(r"a Cylinder moves by 5 mm in a time step.*give 1\d `substeps`", moved, *given, fast,
                  Stepping(20.0, 3, "euler"))
    check_refused("moves at 5 instants, the grippers at 21", moved, *given, Moving(PEG, np.zeros((5, 3))))
    check_refused("obstacles: a Moving", relax, rope, material, clamps, obstacles=[fast], radius=RADIUS)
    for problem, arguments in (("shape", (PEG, np.zeros(3))), ("not finite", (PEG, np.full((4, 3), np.nan))),
                               ("instants", (PEG, np.zeros((4, 3)), np.broadcast_to(np.eye(3), (5, 3, 3)))),
                               ("off a rotation", (PEG, np.zeros((4, 3)), np.ones((4, 3, 3)))),
                               ("Moving: obstacle", ("a peg", np.zeros((4, 3))))):
        check_refused(problem, Moving, *arguments)


def test_predictions_have_obstacles_that_move():
    """Those of the states that are returned; the same as in a simulation."""
    rope, material, clamps = a_rope(1.0)
    path = ClampPath(np.array([0.0, 1.0]), np.repeat(clamps.start_position[None], 2, axis=0))
    found = predict_moving(rope, material, clamps, path, DYNAMICS, replace(QUASI_STATIC, rate=1.0), between=INSTANTS - 1,
                           obstacles=[Moving(PEG, WAY)], radius=RADIUS)
    pushed = moved(rope, material, Grippers.resting(clamps, INSTANTS), Moving(PEG, WAY))
    assert found.followed.all() and len(found.time) == INSTANTS
    np.testing.assert_allclose(found.vertices[1:, 0], pushed.positions[0], atol=1e-9)
    np.testing.assert_allclose(found.contact_force[1:, 0], pushed.contact_force[0], atol=1e-6)


PREDICTED = """
between = 10
rod = {length_mm = 120.0, edges = 24, radius_mm = 2.0}
materials = {rope = {bend = 2e4, twist = 2e4}}
moments = [{time_s = 0.0, end_position_mm = [100, 0, 0]}, {time_s = 1.0}]
[[obstacles]]
kind = "cylinder"
start = [50, 50, -60]
end = [50, 150, -60]
radius = 10.0
friction = 0.3
moments = [{time_s = 0.5, shift = [0, -100, 0]}, {time_s = 1.0, shift = [0, -100, 40]}]
"""


@pytest.mark.thorough
def test_scenes_of_predict_state_motions(tmp_path, capsys):
    """Steps are as many as the fastest obstacle needs, or an error says how many that is."""
    path, out = tmp_path / "scene.toml", tmp_path / "f.npz"
    path.write_text(PREDICTED, encoding="utf-8")
    assert main(["predict", str(path), "--out", str(out), "--picture", str(tmp_path / "f.png")]) == 0
    assert "11 converged" in (printed := capsys.readouterr().out) and "quasi-static steps" in printed
    with np.load(out) as found:
        gap, height = found["smallest_gap_mm"][:, 0], found["vertices_mm"][:, 0, :, 2]
    assert gap.min() > -RADIUS * GAP_TOLERANCE - 1e-9 and (height[-1] - height[0]).max() > 15.0
    path.write_text(PREDICTED.replace("time_s = 0.5", "time_s = 1e30"), encoding="utf-8")
    refused(capsys, tmp_path, ["predict", str(path), "--out", str(out)])


SCENE = """
rate_hz = 20
duration_s = 1.0
rod = {length_mm = 100.0, edges = 10, radius_mm = 1.0}
materials = {rope = {bend = 1e4}}
[[obstacles]]
kind = "capsule"
start = [50, 0, -20]
end = [50, 0, -40]
radius = 5.0
turn_axis = [0, 2, 0]
pivot = [50, 0, 0]
moments = [{time_s = 0.5, shift = [0, 10, 0], turns = 0.25}]
"""


def test_scenes_state_motions(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(SCENE, encoding="utf-8")
    moving, = load_motion_scene(path).surroundings().obstacles
    assert isinstance(moving.obstacle, Capsule) and moving.instants == 21
    last = moving.at(-1)
    np.testing.assert_allclose([last.start[0], last.end[0]], [(30, 10, 0), (10, 10, 0)], atol=1e-12)
    np.testing.assert_allclose(moving.at(0).start, [(50, 0, -20)])
    for old, new, message in (
            ("turns = 0.25", "turns = 20.0", "obstacles\\[0\\].moments: .* turns between two frames"),
            ("shift =", "shifted =", "obstacles\\[0\\].moments\\[0\\].shifted"),
            ('kind = "capsule"\nstart = [50, 0, -20]\nend = [50, 0, -40]\nradius = 5.0', 'kind = "itself"', "the rod itself")):
        path.write_text(SCENE.replace(old, new), encoding="utf-8")
        check_refused(message, load_motion_scene(path).surroundings)
