"""Bodies of known mass on a rod of unknown mass give its stiffness in N m²: cantilevers by the elastica's equation."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from doo_ti.commands.cli import main
from tests.commands.calls import refused

EI, GRAMS_PER_METRE, LENGTH, HUNG, MARKS, NOISE, GRAVITY = 2e-3, 40.0, 0.4, 0.01, 17, 2e-4, 9.80665
AT = 10  # the mark at which the body hangs


def cantilever(tilt: float, mass: float) -> np.ndarray:
    """(MARKS, 2) in m: marks of a rod clamped at ``tilt`` above the horizontal, its other end free, a body of ``mass`` kg at
    mark AT. EI θ'' = cos θ times all that hangs beyond, integrated from the free end, whose angle is found by bisection."""
    weight, s = 1e-3 * GRAMS_PER_METRE * GRAVITY, np.linspace(0, LENGTH, MARKS)

    def from_end(angle: float) -> np.ndarray:
        state, found = np.array([angle, 0.0, 0.0, 0.0]), np.zeros((MARKS, 4))
        for load, rows in ((0.0, slice(MARKS - 1, AT - 1, -1)), (mass * GRAVITY, slice(AT, None, -1))):
            def slopes(at, now, load=load):
                return [now[1], np.cos(now[0]) * (weight * (LENGTH - at) + load) / EI, np.cos(now[0]), np.sin(now[0])]

            solved = solve_ivp(slopes, (s[rows][0], s[rows][-1]), state, t_eval=s[rows], rtol=1e-9, atol=1e-10)
            found[rows], state = solved.y.T, solved.y[:, -1]
        return found

    angles = np.linspace(tilt, tilt - np.pi, 60)
    beyond = next(k for k, angle in enumerate(angles) if from_end(angle)[0, 0] < tilt)
    end = brentq(lambda angle: from_end(angle)[0, 0] - tilt, angles[beyond], angles[beyond - 1], xtol=1e-10)
    curve = from_end(end)[:, 2:]
    return curve - curve[0]


@pytest.fixture(scope="module")
def marks(tmp_path_factory) -> Path:
    """Sixteen poses, every second with the body; ``marks.npz`` and ``mass.npz``."""
    rng, folder = np.random.default_rng(5), tmp_path_factory.mktemp("hung")
    vertices, mass = [], np.zeros((16, MARKS))
    for pose, tilt in enumerate(np.radians(np.linspace(-50, 70, 16))):
        mass[pose, AT] = 1e3 * HUNG * (pose % 2)
        along, azimuth = cantilever(tilt, HUNG * (pose % 2)), rng.uniform(-np.pi, np.pi)
        curve = along @ np.array([[np.cos(azimuth), np.sin(azimuth), 0.0], [0.0, 0.0, 1.0]])
        vertices.append(1e3 * (curve + NOISE * rng.normal(size=curve.shape)))
    np.savez(folder / "marks.npz", vertices_mm=vertices, rest_length_mm=np.full(MARKS - 1, 1e3 * LENGTH / (MARKS - 1)))
    np.savez(folder / "mass.npz", mass_g=mass)
    return folder


def refined(folder: Path, density: float, *words: str) -> dict:
    """By marks of rods of that linear density, g/m."""
    assert main(["refine", str(folder / "marks.npz"), "--EI", "1e-3", "--GJ", "1e-3", "--clamp-end", "free", "--no-models",
                 "--rest-curvature", "none", "--linear-density", str(density), "--out", str(folder / "out.json"), *words]) == 0
    return json.loads((folder / "out.json").read_text())[0]


@pytest.mark.thorough
def test_the_stiffness_and_the_mass_of_the_rod_are_learned_together(marks, capsys):
    found = refined(marks, 60.0, "--mass", str(marks / "mass.npz"), "--parameters", "bend,twist,weight")
    value, low, high = found["stiffness"]["EI_Nm2"]
    assert low < EI < high and high / low < 1.2 and value == pytest.approx(EI, rel=0.05)
    density, least, most = found["linear_density_g_per_m"]
    assert least < GRAMS_PER_METRE < most and density == pytest.approx(GRAMS_PER_METRE, rel=0.05)
    assert "linear density" in capsys.readouterr().out


@pytest.mark.thorough
def test_a_body_that_is_not_said_is_taken_for_softness(marks):
    stated = refined(marks, GRAMS_PER_METRE, "--mass", str(marks / "mass.npz"))
    low, high = stated["stiffness"]["EI_Nm2"][1:]
    assert low < EI < high and high / low < 1.1
    assert stated["linear_density_g_per_m"] == [GRAMS_PER_METRE] * 3
    silent = refined(marks, GRAMS_PER_METRE)
    assert silent["stiffness"]["EI_Nm2"][0] < 0.95 * EI or silent["misfits"]


@pytest.mark.parametrize(("words", "field"), [
    (["--mass", "10:10"], "--mass"), (["--mass", "99:10", "--linear-density", "40"], "--mass"),
    (["--mass", "3:-1", "--linear-density", "40"], "--mass"), (["--mass", "none.npz", "--linear-density", "40"], "none.npz")])
def test_what_is_wrong_is_said_in_a_line(tmp_path, words, field, capsys):
    angle = np.linspace(0, 1, MARKS)
    np.savez(tmp_path / "marks.npz", vertices_mm=[1e3 * LENGTH * np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=1)])
    refused(capsys, tmp_path, ["refine", str(tmp_path / "marks.npz"), "--bend", "1e6", "--twist", "1e6", *words], field)
