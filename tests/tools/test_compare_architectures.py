"""The tool that compares architectures: its cases run, and its table counts other minima apart."""

import numpy as np

from tools.compare_architectures import SAME, compared, one


def test_a_case_runs_and_says_how_long(tmp_path):
    one("score, f32", 64, 1, tmp_path / "score.npz")
    found = np.load(tmp_path / "score.npz")
    assert found["values"].shape == (64, 1) and found["converged"].all() and (found["seconds"] > 0).all()


def test_other_minima_are_counted_apart():
    values, seconds = np.zeros((4, 3)), np.array([2.0, 0.5])
    cpu = {"values": values, "converged": np.array([True, True, True, False]), "seconds": seconds}
    moved = values + np.array([[1e-6], [10 * SAME], [0.0], [1.0]])
    cuda = {"values": moved, "converged": np.ones(4, dtype=bool), "seconds": seconds / 5}
    cells = compared(cpu, cuda).split(" | ")
    assert cells == ["4", "2.0", "0.4", "8", "40", "75.00", "100.00", "1", "5e-07", "1e-06"]
