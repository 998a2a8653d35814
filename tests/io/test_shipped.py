"""Scenes that come with the package, by name, from any folder."""

from pathlib import Path

import pytest

from doo_ti.cli import main
from doo_ti.io.toml_file import scene_file

SCENES = Path(__file__).resolve().parents[2] / "scenes"


@pytest.mark.parametrize(("name", "file"), [
    ("vicryl", "vicryl.toml"), ("vicryl.toml", "vicryl.toml"), ("scenes/vicryl.toml", "vicryl.toml"),
    ("whip", "motion/whip.toml"), ("groups/reef_knot", "groups/reef_knot.toml"),
    ("scenes/motion/whip.toml", "motion/whip.toml"), ("rig.yaml", "rig.yaml")])
def test_a_scene_is_found_in_any_folder(name, file, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert Path(scene_file(name)).read_bytes() == (SCENES / file).read_bytes()


def test_a_file_of_that_name_comes_first(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "vicryl").touch()
    assert scene_file("vicryl") == "vicryl"


@pytest.mark.parametrize("name", ["", "no_such", "../scenes/vicryl.toml", "/vicryl.toml", "scenes", ".", "motion"])
def test_other_names_stay_as_they_are(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert scene_file(name) == name


def test_a_command_takes_one_by_name(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    main(["synth", "vicryl", "--out", "vicryl.npz"])
    assert (tmp_path / "vicryl.npz").is_file()
