"""Scenes of rods that touch themselves: a knot pulled tight, and what is refused."""

import numpy as np
import pytest

from doo_ti.commands.cli import main
from doo_ti.contact.itself import smallest_self_gap
from tests.commands.calls import refused, written
from tests.contact.topology import determinant

SCENE = """
rate_hz = 20
duration_s = 0.25
quasi_static = true
[rod]
length_mm = 130.0
edges = 45
radius_mm = 0.8
at_rest = true
knot_loop_mm = 10.0
[materials.suture]
bend = 6e5
weight = 0.0
density = 1.0
[clamps]
start = "tangent"
end = "tangent"
[[obstacles]]
kind = "itself"
friction = 0.1
[[moments]]
time_s = 0.25
start_position_mm = [-2.0, 0, 0]
"""


@pytest.mark.slow
def test_a_knot_is_pulled_tight(tmp_path, capsys):
    (tmp_path / "knot.toml").write_text(SCENE)
    words = ["simulate", str(tmp_path / "knot.toml"), "--out", str(tmp_path / "k.npz"), "--picture", str(tmp_path / "k.png"),
             "--recording", str(tmp_path / "k.rrd")]
    assert main(words) == 0
    assert "1 converged at the end" in capsys.readouterr().out
    assert (tmp_path / "k.png").stat().st_size > 5_000 and (tmp_path / "k.rrd").stat().st_size > 5_000
    found = written(tmp_path / "k.npz")
    positions, force = found["positions_mm"][0], found["contact_force"][0]
    assert [determinant(x) for x in positions] == [3] * len(positions)
    assert np.abs(smallest_self_gap(positions, np.array([0.8]))).max() < 1e-3 * 0.8
    assert np.allclose(found["smallest_gap_mm"][0], smallest_self_gap(positions, np.array([0.8])))
    assert (np.diff(found["friction_work"][0]) > 0).all(), "its strands slide along each other in every step"
    assert np.abs(force.sum(axis=1)).max() < 1e-8 * np.abs(force).max()


@pytest.mark.parametrize(("old", "new", "words"), [
    ("radius_mm = 0.8", "", "rod.radius_mm: missing"), ("length_mm = 130.0", "length_mm = 60.0", "rod.length_mm: 60 mm"),
    ("friction = 0.1", "friction = -0.1", "friction"), ("friction = 0.1", "radius = 1", "radius"),
    ("start_position_mm = [-2.0, 0, 0]", 'start_turns = "two"', "start_turns")])
def test_wrong_scenes_are_one_line(old, new, words, tmp_path, capsys):
    (tmp_path / "knot.toml").write_text(SCENE.replace(old, new))
    refused(capsys, tmp_path, ["simulate", str(tmp_path / "knot.toml"), "--out", str(tmp_path / "k.npz")], words)
