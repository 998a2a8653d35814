"""Eq. 4 for a rope that lies on a table."""

import numpy as np
import pytest

from doo_ti import Material, TwistOptions, TwistVerdict, end_offsets, estimate_twist, save_observations
from doo_ti.commands.cli import main
from tests.commands.calls import refused
from tools.studies.table_study import TABLE, specimen


@pytest.fixture(scope="module")
def rope():
    """Observations, their material, one group, and τ from the known end frames: then φ is zero."""
    observations, truth = specimen(2014)
    group = np.zeros(observations.count, dtype=int)
    return observations, Material(truth["bend"], truth["twist"]), group, end_offsets(observations, group)


@pytest.mark.thorough
def test_with_the_table_the_twist_is_found_and_without_it_not(rope):
    found = estimate_twist(*rope, TwistOptions(surroundings=TABLE))
    without = estimate_twist(*rope)
    assert abs(found.phi[0]) < np.radians(10.0) and found.unsound.sum() == 0
    assert without.verdict == [TwistVerdict.AT_BORDER] and without.least[0] > 10 * found.least[0]


@pytest.mark.thorough
def test_the_command_takes_the_table(rope, tmp_path, capsys):
    observations, material, _, _ = rope
    save_observations(tmp_path / "rope.npz", observations)
    (tmp_path / "table.toml").write_text('[[obstacles]]\nkind = "plane"\npoint = [0, 0, 0]\nnormal = [0, 0, 1]\n')
    words = ["twist", str(tmp_path / "rope.npz"), "--observations", "8", "--bend", f"{material.bend.flat[0]}", "--twist",
             f"{material.twist.flat[0]}", "--obstacles", str(tmp_path / "table.toml"), "--out", str(tmp_path / "twist.npz")]
    assert main([*words, "--radius", "2"]) == 0
    with np.load(tmp_path / "twist.npz") as found:
        assert abs(found["phi_deg"][0]) < 10.0
    capsys.readouterr()
    refused(capsys, tmp_path, words, "--radius: missing beside --obstacles")
