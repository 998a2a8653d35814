"""The development data: the virtual lab at the true Θ, real cables over decades of bend."""

import numpy as np
import pytest

from doo_ti import Clamp, Material, Newton, distance, load_observations, observation_clamps, relax, start_configuration
from tests.relaxation.rods import RIBBON_WIDTH, lab

BARS = {"nylon": 0.90, "vicryl": 0.85, "silk": 0.90}


@pytest.mark.parametrize("precision", ["f64", "f32", "mixed"])
@pytest.mark.parametrize("name", BARS)
def test_sutures_at_the_truth(laboratory, name, precision):
    rod = lab(laboratory, name)
    solution = relax(rod.start, rod.material, rod.clamps, up=rod.observations.up, precision=precision)
    mean = distance(solution.configuration, rod.observations).mean()
    assert (solution.converged & solution.stable).all()
    assert mean <= BARS[name]


def test_ribbon_at_the_truth(laboratory):
    """Started from the measured frames; what is off is their noise, not the solver's choice of minimum."""
    rod = lab(laboratory, "ribbon")
    errors = {}
    for name, solver in (("plain", Newton()), ("careful", Newton.careful())):
        solution = relax(rod.start, rod.material, rod.clamps, solver, up=rod.observations.up)
        assert (solution.converged & solution.stable).all()
        errors[name] = distance(solution.configuration, rod.observations, frame_weight=RIBBON_WIDTH).mean()
    assert errors["plain"] == pytest.approx(errors["careful"], rel=1e-3) and errors["plain"] < 2.0


def cable(folder, name: str):
    observations = load_observations(folder / "cables" / f"{name}.npz")
    clamps = observation_clamps(observations)
    assert clamps.start == clamps.end == Clamp.TANGENT
    bend = np.geomspace(1e5, 1e8, 13)
    rows = np.arange(observations.count).repeat(13), np.tile(np.arange(13), observations.count)
    solution = relax(start_configuration(observations, clamps), Material(bend, bend, 1.0), clamps, up=observations.up,
                     configuration_index=rows[0], material_index=rows[1])
    assert (solution.converged & solution.stable).all()
    error = distance(solution.configuration, observations, rows[0]).reshape(-1, 13).mean(axis=0)
    print(f"{name}: " + ", ".join(f"{b:.2g}: {e:.2f}" for b, e in zip(bend, error, strict=True)))
    return bend, error


@pytest.mark.parametrize(("name", "low", "high", "least", "limp"), [
    ("dlo1", 2e6, 5e6, 14.3, 15.5), ("dlo3", 3e7, 1e8, 16.1, 25)])
def test_cables(shared_data, name, low, high, least, limp):
    bend, error = cable(shared_data, name)
    assert low < bend[error.argmin()] < high and error.min() <= least and error[0] > limp
