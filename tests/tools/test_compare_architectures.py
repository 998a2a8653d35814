"""The tool that compares architectures: what a case leaves, and a table that counts other minima apart."""

import numpy as np

from tools.studies import compare_architectures
from tools.studies.compare_architectures import SAME, Found, compared, one


def test_a_case_leaves_what_it_found_and_how_long_it_took(tmp_path, monkeypatch):
    def prepared(count: int):
        return lambda: Found(np.arange(3.0 * count).reshape(count, 3), np.ones(count, dtype=bool))

    monkeypatch.setitem(compare_architectures.CASES, "numbers", prepared)
    one("numbers", 4, 2, tmp_path / "found.npz")
    found = np.load(tmp_path / "found.npz")
    assert (found["values"] == np.arange(12.0).reshape(4, 3)).all()
    assert found["converged"].all() and (found["seconds"] > 0).all()


def test_other_minima_are_counted_apart():
    values, seconds = np.zeros((4, 3)), np.array([2.0, 0.5])
    cpu = {"values": values, "converged": np.array([True, True, True, False]), "seconds": seconds}
    moved = values + np.array([[1e-6], [10 * SAME], [0.0], [1.0]])
    cuda = {"values": moved, "converged": np.ones(4, dtype=bool), "seconds": seconds / 5}
    cells = compared(cpu, cuda).split(" | ")
    assert cells == ["4", "2.0", "0.4", "8", "40", "75.00", "100.00", "1", "5e-07", "1e-06"]
