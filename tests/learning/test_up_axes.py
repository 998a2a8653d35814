"""Observations read with another axis upwards than they were recorded with are found out, and no others."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti import Clamp, Clamps, Material, Observations, load_observations, observation_clamps, relax, start_configuration
from doo_ti.learning.up_axes import other_up
from doo_ti.rod.frames import bishop_frames

AXES = {name: sign * np.eye(3)["xyz".index(name[-1])] for name, sign in
        (("x", 1.0), ("y", 1.0), ("z", 1.0), ("-x", -1.0), ("-y", -1.0), ("-z", -1.0))}
SHARED = (
    *(f"lab_a/{name}.npz" for name in ("nylon", "ribbon", "silk", "vicryl")), *(f"specimens/s{k:02}.npz" for k in range(8)),
    "cables/dlo1.npz", "cables/dlo3.npz", *(f"marks/{name}/marks.npz" for name in (
        "02_cable", "05_cable", "08_cable", "12_suture", "14_suture", "16_suture", "19_suture")))


def hanging(rng, up: np.ndarray, stiffness: float, count: int = 10) -> Observations:
    """Marks of a metre of cable of B/(2 μ L³) = ``stiffness`` between grippers at different places and tilts, off by 0.5 mm."""
    edges, length = 20, 1000.0
    start, side = np.zeros((count, 3)), np.array([1.0, 0.0, 0.0])
    end = np.array([500.0, 0.0, 0.0]) + rng.uniform(-200, 200, (count, 3))
    tangents = side + 0.8 * rng.normal(size=(2, count, 3))
    frames = [bishop_frames(t[:, None] / np.linalg.norm(t, axis=-1)[:, None, None], np.cross(t, [0.3, 0.9, 0.2]))[:, 0]
              for t in tangents]
    clamps, sag = Clamps(Clamp.TANGENT, Clamp.TANGENT, start, end, *frames), np.linspace(0, 1, edges + 1)
    seen = Observations(start[:, None] + sag[:, None] * (end - start)[:, None] - 300 * np.sin(np.pi * sag)[:, None] * up,
                        rest_length=np.full(edges, length / edges), up=up)
    bend = 2 * stiffness * length**3
    vertices = relax(start_configuration(seen, clamps, np.zeros(count, int)), Material(bend, bend), clamps,
                     up=up).configuration.vertices
    vertices[:, 2:-2] += 0.5 * rng.normal(size=vertices[:, 2:-2].shape)
    return replace(seen, vertices=vertices)


def judged(observations: Observations, up: np.ndarray):
    return other_up(observations, observation_clamps(observations), up)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("right, given", [("y", "z"), ("-x", "y"), ("z", "-z")])
def test_a_wrong_axis_is_found_out_and_the_right_one_is_named(rng, right, given):
    seen = hanging(rng, AXES[right], 5e-3)
    found = judged(seen, AXES[given])
    assert np.array_equal(found.up, AXES[right]) and found.option == f"--up {right}"
    assert found.misfit_mm < 0.5 * found.given_misfit_mm and found.option in found.text and judged(seen, AXES[right]) is None


@pytest.mark.sampled(1)
@pytest.mark.parametrize("given", ["x", "y", "z", "-z"])
def test_rods_that_hardly_feel_their_weight_name_no_axis(rng, given):
    assert judged(hanging(rng, AXES["z"], 30.0), AXES[given]) is None


@pytest.mark.thorough
def test_one_observation_is_not_enough(rng):
    assert judged(hanging(rng, AXES["z"], 0.3).take([0]), AXES["z"]) is None


@pytest.mark.thorough
@pytest.mark.parametrize("name", SHARED)
def test_no_alarm_under_the_right_axis(shared_data, name):
    seen = load_observations(shared_data / name)
    assert judged(seen, seen.up) is None
