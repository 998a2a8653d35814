"""The development data: the virtual lab at the true Θ, real cables over decades of bend."""

import numpy as np
import pytest

from doo_ti.io.observation_files import load_observations
from doo_ti.relaxation.relax import Newton, relax
from doo_ti.rod.metric import distance
from doo_ti.rod.start import observation_clamps, start_configuration
from doo_ti.rod.types import Clamp, Material
from tests.relaxation.lab import RIBBON_WIDTH, lab

BARS = {"nylon": 0.90, "vicryl": 0.85, "silk": 0.90}


@pytest.mark.parametrize("precision", ["f64", "f32", "mixed"])
@pytest.mark.parametrize("name", BARS)
def test_sutures_at_the_truth(laboratory, name, precision):
    rod = lab(laboratory, name)
    solution = relax(rod.start, rod.material(), rod.clamps, up=rod.observations.up, precision=precision)
    mean = distance(solution.configuration, rod.observations).mean()
    print(f"{name}, {precision}: {mean:.4f} mm (bar {BARS[name]}), {solution.iterations.mean():.1f} iterations")
    assert (solution.converged & solution.stable).all()
    assert mean <= BARS[name]


def test_ribbon_at_the_truth(laboratory):
    """Started from the measured frames; what is off is their noise, not the solver's choice of minimum."""
    rod = lab(laboratory, "ribbon")
    errors = {}
    for name, solver in (("plain", Newton()), ("careful", Newton.careful())):
        solution = relax(rod.start, rod.material(), rod.clamps, solver, up=rod.observations.up)
        assert (solution.converged & solution.stable).all()
        errors[name] = distance(solution.configuration, rod.observations, frame_weight=RIBBON_WIDTH).mean()
    print(f"ribbon, w_m {RIBBON_WIDTH} mm: {errors}")
    assert errors["plain"] == pytest.approx(errors["careful"], rel=1e-3) and errors["plain"] < 2.0


@pytest.mark.parametrize("name", BARS)
def test_the_lab_without_its_noise_is_nearer(laboratory, name):
    """The fit's mesh and clamps are not those of the lab: what is left is that, less than the labels' noise."""
    rod = lab(laboratory, name)
    with np.load(laboratory / "lab_a" / f"{name}_truth.npz") as truth:
        vertices = truth["vertices_mm"]
    solution = relax(rod.start, rod.material(), rod.clamps)
    noisy = distance(solution.configuration, rod.observations).mean()
    clean = np.linalg.norm(solution.configuration.vertices - vertices, axis=2).sum(axis=1).mean() / 33
    print(f"{name}: {noisy:.3f} mm from the labels, {clean:.3f} mm from the truth")
    assert clean < noisy


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


def test_cable_dlo1(shared_data):
    bend, error = cable(shared_data, "dlo1")
    assert 2e6 < bend[error.argmin()] < 5e6 and error.min() <= 14.3
    assert error[0] > 15.5


def test_cable_dlo3(shared_data):
    bend, error = cable(shared_data, "dlo3")
    assert 3e7 < bend[error.argmin()] < 1e8 and error.min() <= 16.1
    assert error[0] > 25
