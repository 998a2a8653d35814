"""The development data: the virtual lab at the true Θ, real cables over decades of bend."""

import pytest

from doo_ti import Newton, distance, relax
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
