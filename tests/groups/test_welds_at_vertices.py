"""Welds of end edges without length: rods are joined, and rings closed, without a joint and with second order."""

import numpy as np
import pytest
from scipy.integrate import solve_bvp

from doo_ti import Group, GroupSolution, InputError, Tie, end_clamps, hanging, relax, relax_group, rod_along, straight_rod
from doo_ti.groups.scene import load_group_scene
from doo_ti.rod.types import Clamp, Clamps, Configuration, Material

LENGTH = 300.0
RADIUS = LENGTH / (2 * np.pi)
EDGES = (10, 20, 40, 80)


def circle(edges: int) -> Configuration:
    """A ring that stands, from its top and back to it."""
    angle = np.linspace(0, 2 * np.pi, 40 * edges + 1)
    ring = rod_along(np.stack([np.sin(angle), 0 * angle, np.cos(angle) - 1], axis=-1) * RADIUS, edges, vertex_clamps=True)
    return Configuration(ring.start, ring.quaternions, ring.rest_length * (LENGTH / ring.rest_length.sum()))


def closed(edges: int, material: Material, clamp: Clamp) -> GroupSolution:
    """That ring, its ends welded to each other."""
    ring = circle(edges)
    solution = relax_group(Group([ring], material, [end_clamps(ring, clamp, Clamp.FREE)], [Tie((0, 0), (0, -1), weld=True)]))
    assert solution.converged.all() and solution.stable.all()
    return solution


def second_order(errors) -> bool:
    return bool((np.array(errors[1:]) < np.array(errors[:-1]) / 3.5).all())


def heavy_ring(stiffness: float) -> float:
    """Height over R of a ring hung from its top, of unit weight per length and ``stiffness`` EI over R³: x, z, direction,
    curvature and level force along one half."""
    s = np.linspace(0, np.pi, 201)
    y = np.stack([np.sin(s), np.cos(s) - 1, -s, -np.ones_like(s), 0 * s])
    for load in np.linspace(0, 1 / stiffness, 21):
        half = solve_bvp(
            lambda s, y, q=load: np.stack([np.cos(y[2]), np.sin(y[2]), y[3],
                                           np.sin(y[2]) * y[4] + np.cos(y[2]) * q * (np.pi - s), 0 * s]),
            lambda a, b: np.array([a[0], a[1], a[2], b[0], b[2] + np.pi]), s, y, tol=1e-9, max_nodes=100_000)
        s, y = half.x, half.y
    return -y[1, -1]


def test_a_ring_closes_without_a_joint():
    exact = 0.5 * (2 * np.pi) ** 2 / LENGTH
    errors = [abs(closed(edges, Material(1.0, 5.0, 0.0), Clamp.POSITION).energy[0] / exact - 1) for edges in EDGES]
    print(errors)
    assert second_order(errors) and errors[-1] < 1.1e-3


@pytest.mark.thorough
def test_a_heavy_ring_hangs_as_the_smooth_one():
    exact, material = RADIUS * heavy_ring(1.0), Material(2.0 * RADIUS**3, RADIUS**3)
    hung = [closed(edges, material, Clamp.TANGENT).rods[0].vertices[0, :, 2] for edges in EDGES]
    errors = [abs(np.ptp(heights) / exact - 1) for heights in hung]
    print(errors)
    assert second_order(errors[1:]) and errors[-1] < 2e-4


def apart(edges: int, clamp: Clamp) -> float:
    """mm between a rod, and the same rod cut in its middle and welded."""
    material = Material(1e6, 0.8e6)
    rope, held = hanging(LENGTH, edges, (0, 0, 0), (240, 0, 0), vertex_clamps=True)
    frame = np.eye(3)[None]
    whole = relax(rope, material, Clamps(clamp, clamp, held.start_position, held.end_position, frame, frame)).configuration
    cut, free = edges // 2 + 1, np.zeros_like(held.start_position)
    joint = np.array([[[1.0, 0.0, 0.0, 0.0]]])  # both edges without length have one direction
    halves = [Configuration(start, np.concatenate(frames, axis=1), np.concatenate(lengths)) for start, frames, lengths in (
        (whole.start, (whole.quaternions[:, :cut], joint), (rope.rest_length[:cut], [0.0])),
        (whole.vertices[:, cut], (joint, whole.quaternions[:, cut:]), ([0.0], rope.rest_length[cut:])))]
    both = relax_group(Group(halves, material, [
        Clamps(clamp, Clamp.FREE, held.start_position, free, frame, frame),
        Clamps(Clamp.FREE, clamp, free, held.end_position, frame, frame)], [Tie((0, -1), (1, 0), weld=True)]))
    assert both.converged.all() and both.stable.all()
    vertices = np.concatenate([both.rods[0].vertices[0, :cut], both.rods[1].vertices[0, 1:]])
    return float(np.abs(vertices - whole.vertices[0]).max())


@pytest.mark.parametrize("clamp", [Clamp.POSITION, Clamp.FRAME])
def test_two_halves_are_one_rod(clamp):
    """The joint in the middle is two of half the angle each."""
    errors = [apart(edges, clamp) for edges in (10, 20, 40, 80)]
    print(errors)
    assert second_order(errors) and errors[-1] < 1e-5 * LENGTH


SCENE = """
[materials.rope]
bend = 2e5
twist = 1e5
[rods.trunk]
edges = 10
length_mm = 100.0
vertex_clamps = true
start = "frame"
[rods.branch]
edges = 6
points_mm = [[50, 0, 0], [60, 20, 0], [50, 50, 0]]
vertex_clamps = true
[[ties]]
first = ["trunk", 5]
second = ["branch", 0]
weld = true
[[ties]]
first = ["trunk", -1]
second = ["branch", 6]
"""


def test_scenes_number_vertices_as_without(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(SCENE)
    group = load_group_scene(path).group
    assert [rod.edges for rod in group.rods] == [12, 8] and group.rods[0].rest_length[[0, -1]].tolist() == [0.0, 0.0]
    assert [(tie.first, tie.second) for tie in group.ties] == [((0, 6), (1, 0)), ((0, -1), (1, -1))]
    np.testing.assert_allclose(group.rods[0].vertices[0, 6], [50, 0, 0], atol=1e-9)
    path.write_text(SCENE.replace('["branch", 6]', '["branch", 7]'))
    with pytest.raises(InputError, match="'branch' has no vertex 7; give one from 0 to 6"):
        load_group_scene(path)


def test_the_directions_of_end_edges_are_those_of_the_curve():
    assert np.allclose(circle(20).frames[0, [0, -1], :, 0], [1, 0, 0], atol=1e-9)
    assert np.allclose(straight_rod(100.0, 5, direction=(0, 0, 2), vertex_clamps=True).frames[0, :, :, 0], [0, 0, 1])
