"""Identification of a Θ under which synthetic recordings were made."""

import numpy as np

from doo_ti.dynamics.identify import IdentifyOptions, identify, predicted
from doo_ti.dynamics.recorded import RecordedMotion
from doo_ti.dynamics.theta import MotionTheta
from tests.dynamics.recordings import RATE, recorded

TRUE = MotionTheta(
    bend=3e6, twist_ratio=1.0, bend_damping=0.04, drag=0.6, quadratic_drag=2e-4, marker_share=0.0,
    rest=1e-3 * np.array([[1.5, -1.0], [0.8, 0.6]]), rest_length=np.full(8, 50.0), reference=np.array([0.0, 1.0, 0.0]))
OPTIONS = IdentifyOptions(modes=2, horizons=(30, 10**6))
GUESS = MotionTheta(5e6, 1.0, 0.02, 0.2, 1e-5, 0.0, np.zeros((2, 0)), TRUE.rest_length, TRUE.reference)


def test_what_was_simulated_is_predicted(rng):
    """Without noise the rollout is the motion itself, but for the first velocity, a difference of two frames."""
    motion = RecordedMotion.of(recorded(rng, TRUE, 4, 80, 0.0), RATE)
    assert motion.glitches() == []
    positions, status = predicted(motion, [TRUE], OPTIONS)
    apart = np.abs(positions[:, 0] - motion.positions).max(axis=(1, 2, 3))
    print("off by", apart, "mm")
    assert (status == 0).all() and apart.max() < 1.0


def test_a_known_theta_is_found(rng):
    motion = RecordedMotion.of(recorded(rng, TRUE, 4, 80, 0.2), RATE)
    found = identify(motion, GUESS, OPTIONS)
    assert not found.failed.any()
    true, rows = found.unknowns.vector(TRUE), found.parameters()
    inside = 0
    for k, row in enumerate(rows):
        actual = found.unknowns.vector(TRUE)[k] * (found.unknowns.SIZES.get(row["name"], found.unknowns.CURVATURE))
        actual = TRUE.bend if row["name"] == "bend" else actual
        low = -np.inf if row["low"] is None else row["low"]
        inside += low <= actual <= row["high"]
        print(f"{row['name']:22s} {actual:10.4g} found {row['value']:10.4g} from {low:10.4g} to {row['high']:10.4g}")
    print("error", found.error, "mm;", inside, "of", len(rows), "intervals contain the truth;", found.iterations, "iterations")
    np.testing.assert_allclose(found.theta.bend, TRUE.bend, rtol=0.05)
    assert np.abs(found.vector - true).max() < 0.2
    assert found.error.max() < 0.3
    assert inside >= len(rows) / 2
