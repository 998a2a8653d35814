"""The development data: the virtual lab at the true Θ."""

import pytest

from doo_ti import Newton, distance, relax
from tests.references.rods import certified
from tests.relaxation.rods import RIBBON_WIDTH, lab

BARS = {"nylon": 0.90, "vicryl": 0.85, "silk": 0.90}


@pytest.mark.parametrize("precision", ["f64", "f32", "mixed"])
@pytest.mark.parametrize("name", BARS)
def test_sutures_at_the_truth(laboratory, name, precision):
    rod = lab(laboratory, name)
    solution = certified(relax(rod.start, rod.material, rod.clamps, up=rod.observations.up, precision=precision))
    assert distance(solution.configuration, rod.observations).mean() <= BARS[name]


def test_ribbon_at_the_truth(laboratory):
    """Started from the measured frames; what is off is their noise, not the solver's choice of minimum."""
    rod = lab(laboratory, "ribbon")
    plain, careful = (certified(relax(rod.start, rod.material, rod.clamps, solver, up=rod.observations.up))
                      for solver in (Newton(), Newton.careful()))
    error, same = (distance(solution.configuration, rod.observations, frame_weight=RIBBON_WIDTH).mean()
                   for solution in (plain, careful))
    assert error == pytest.approx(same, rel=1e-3) and error < 2.0
