"""``doo-ti convert``: a finer mesh through marks, and the warning that names it."""

import numpy as np
import pytest

from doo_ti.commands.cli import main
from doo_ti.io.observation_files import load_observations

POLE = """
[[obstacles]]
kind = "capsule"
start = [0, -50, 20]
end = [0, 50, 20]
radius = 4
"""


@pytest.fixture
def marks(tmp_path):
    """A file of a catenary-like curve with 11 marks, one of them missing, and the curve at many places."""
    curve = np.stack([np.linspace(-100, 100, 2001), np.zeros(2001), 0.002 * np.linspace(-100, 100, 2001) ** 2], axis=-1)
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])
    rows = np.searchsorted(arc, np.linspace(0, arc[-1], 11)[:-1].tolist() + [arc[-1]]).clip(0, 2000)
    vertices = curve[rows].copy()
    vertices[4] = np.nan
    np.savez(tmp_path / "marks.npz", vertices_mm=vertices[None], rest_length_mm=np.diff(arc[rows]))
    return tmp_path / "marks.npz", curve


def test_a_finer_mesh_lies_on_the_curve_through_the_marks(marks, tmp_path, capsys):
    source, curve = marks
    assert main(["convert", str(source), str(tmp_path / "fine.npz"), "--edges", "60"]) == 0
    assert "61 vertices" in capsys.readouterr().out
    fine = load_observations(tmp_path / "fine.npz")
    assert fine.edges == 60 and fine.valid.all() and np.ptp(fine.rest_length) < 1e-9
    assert np.linalg.norm(fine.vertices[0][:, None] - curve, axis=-1).min(axis=1).max() < 1.0
    assert main(["convert", str(source), str(tmp_path / "no.npz"), "--edges", "1"]) == 2
    assert main(["convert", str(source), str(tmp_path / "no.npz"), "--edges", "9", "--motion"]) == 2


def test_marks_too_far_apart_for_a_thin_pole_are_warned_of(marks, tmp_path, capsys):
    source, _ = marks
    (tmp_path / "pole.toml").write_text(POLE)
    words = ["--bend", "1e5", "--obstacles", str(tmp_path / "pole.toml"), "--radius", "1", "--out", str(tmp_path / "out.npz")]
    assert main(["relax", str(source), *words]) == 0
    assert "convert IN OUT --edges" in capsys.readouterr().err
    main(["convert", str(source), str(tmp_path / "fine.npz"), "--edges", "42"])
    assert main(["relax", str(tmp_path / "fine.npz"), *words]) == 0
    assert "convert" not in capsys.readouterr().err
