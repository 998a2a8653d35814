"""Rods of the virtual lab for tests of refinement: small, quick, and not of the fit's own mesh."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti import Observations, Theta, observation_clamps
from doo_ti.io.scene import Synthesis
from doo_ti.lab.synthesis import synthesise
from doo_ti.refinement.held_rod import HeldRod
from doo_ti.refinement.residuals import Comparison
from doo_ti.refinement.theta import Scales, typical_scales
from doo_ti.refinement.unknowns import Unknowns

BEND, TWIST, NOISE = 4e5, 3e5, 0.1
TRUTH = Theta(BEND * np.eye(2), TWIST)


def suture(rotations: int = 4, **fields) -> Observations:
    """Observations of a rod with Θ = TRUTH at three end distances; ``fields`` of :class:`doo_ti.io.scene.Synthesis`."""
    recipe = dict(bend=BEND, twist=TWIST, label_noise_mm=NOISE, seed=7, fine_edge_mm=0.5, clip_mm=2.5,
                  rest_curvature_rms_per_mm=1 / 900, rest_curvature_range_mm=12.0, end_distances_mm=(42.0, 60.0, 78.0),
                  end_rotations_deg=tuple(60.0 * k for k in range(rotations)))
    return synthesise(Synthesis(**(recipe | fields)))


def bare(observations: Observations) -> Observations:
    """As if nobody had measured frames or twists."""
    return replace(observations, start_frame=None, end_frame=None, total_twist=None)


def held(observations: Observations, edges: int = 40, kinds=(None, None)) -> HeldRod:
    return HeldRod(observations, observation_clamps(observations, *kinds), edges)


def model(rod: HeldRod, parameters=("bend", "twist"), with_frames: bool = False, **fields) -> tuple[Comparison, Scales]:
    """A model of ``rod`` and sizes that are not typical in anything."""
    unknowns = Unknowns(rod, parameters, **fields)
    names = unknowns.scale_names | {"marks", "gap"} | ({"frames"} if with_frames else set())
    scales = typical_scales(rod.length, 3.0, names, {})
    return Comparison.of(unknowns, with_frames), replace(scales, value=scales.value * np.linspace(0.7, 1.4, len(scales.value)))


def assert_gradient(posterior, scales: Scales) -> None:
    """The gradient of ``posterior(scales)`` by the logarithms of the sizes is that of its value, by differences."""
    for k, slope in enumerate(posterior(scales).gradient):
        step = 1e-5 * np.eye(len(scales.free))[k]
        above, below = (posterior(scales.at(scales.free + sign * step)).value for sign in (1, -1))
        assert slope == pytest.approx((above - below) / 2e-5, rel=1e-5, abs=1e-3)
