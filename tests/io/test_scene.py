"""Scenes: the meaning of a TOML file, and errors in it."""

from pathlib import Path

import numpy as np
import pytest

from doo_ti import Clamp, InputError
from doo_ti.io.scene import Synthesis, load_scene

SCENES = Path(__file__).resolve().parents[2] / "scenes"
GOOD = {
    "top": 'name = "silk"\nframe_weight_mm = 6.7\nclamp_end = "tangent"\nprecision = "f64"\n',
    "data": "[synthesis]\nbend = 1.5e5\ntwist = 50000\n",
    "grid": '[grid]\nbend = "5e4:1e7:5"\ntwist_ratio = 0.5\n',
}


def write(folder: Path, **parts: str) -> Path:
    path = folder / "scene.toml"
    path.write_text("".join((GOOD | parts).values()), encoding="utf-8")
    return path


@pytest.mark.parametrize("name", ["vicryl", "nylon", "silk", "ribbon"])
def test_shipped_scenes(name):
    scene = load_scene(SCENES / f"{name}.toml")
    assert scene.name == name and scene.grid.size == 625 and isinstance(scene.observations, Synthesis)
    assert (scene.clamp_start, scene.clamp_end) == (Clamp.FRAME, Clamp.FRAME)
    assert len(scene.observations.end_distances_mm) * len(scene.observations.end_rotations_deg) == 60
    material = scene.observations.material()
    assert material.is_isotropic == (name != "ribbon") and scene.frame_weight == (6.7 if name == "ribbon" else 0)
    for axis, truth in zip(scene.grid.axes, (material.bend[0, 0, 0, 0], material.bend[0, 0, 1, 1]), strict=False):
        if axis.name.startswith("bend"):
            assert axis.values[0] < truth < axis.values[-1]


def test_seeds_of_shipped_scenes_differ():
    seeds = [load_scene(path).observations.seed for path in sorted(SCENES.glob("*.toml"))]
    assert len(set(seeds)) == len(seeds)


def test_a_scene_with_a_synthesis(tmp_path):
    scene = load_scene(write(tmp_path))
    assert (scene.name, scene.frame_weight, scene.precision, scene.objective) == ("silk", 6.7, "f64", "static")
    assert (scene.clamp_start, scene.clamp_end) == (None, Clamp.TANGENT)
    assert scene.grid.shape == (5, 1, 1) and scene.observations.name == "silk" and len(scene.sha256) == 64
    assert scene.observations.twist == 50000.0 and scene.observations.marks == 34


def test_a_scene_with_a_file(tmp_path):
    scene = load_scene(write(tmp_path, top="", data='[observations]\nfile = "data/silk.npz"\n'))
    assert scene.observations == tmp_path / "data" / "silk.npz" and scene.name == "scene" and scene.precision == "mixed"


def test_a_dynamic_scene(tmp_path):
    scene = load_scene(write(tmp_path, top='objective = "dynamic"\npairs = "data/pairs.csv"\nroll_hypotheses = 12\n'))
    assert (scene.objective, scene.pairs, scene.roll_hypotheses) == ("dynamic", tmp_path / "data" / "pairs.csv", 12)
    scene = load_scene(write(tmp_path, top='objective = "dynamic"\n'))
    assert (scene.pairs, scene.roll_hypotheses) == (None, 0)
    assert load_scene(write(tmp_path, top="spins = 7\n")).roll_hypotheses == 7  # as scenes used to call it


def test_an_anisotropic_scene(tmp_path):
    ribbon = "[synthesis]\nbend = [[6e6, 1e5], [1e5, 1.2e5]]\ntwist = 5e5\nframes = true\n"
    scene = load_scene(write(tmp_path, data=ribbon, grid='[grid]\nbend = "3e6,2e6,-1e6"\n'))
    np.testing.assert_array_equal(scene.observations.material().bend[0, 0], [[6e6, 1e5], [1e5, 1.2e5]])
    assert scene.grid.bend_12 == -1e6 and scene.observations.frames


def synthesis(line: str) -> dict:
    return {"data": GOOD["data"] + line + "\n"}


WRONG = {
    "no TOML": ({"top": "name = silk\n"}, "file"),
    "unknown key": ({"top": "colour = 3\n"}, "colour"),
    "unknown synthesis key": (synthesis("stretch = 3"), "synthesis.stretch"),
    "unknown grid key": ({"grid": "[grid]\nbend = 3\nstretch = 3\n"}, "grid.stretch"),
    "unknown observations key": ({"data": '[observations]\nfile = "x.npz"\nformat = 1\n'}, "observations.format"),
    "no data": ({"data": ""}, "observations"),
    "twice data": ({"data": GOOD["data"] + '[observations]\nfile = "x.npz"\n'}, "observations"),
    "no file": ({"data": "[observations]\n"}, "observations.file"),
    "file no text": ({"data": "[observations]\nfile = 3\n"}, "observations.file"),
    "no grid": ({"grid": ""}, "grid"),
    "grid no table": ({"top": "grid = 3\n", "grid": ""}, "grid"),
    "grid of zero cells": ({"grid": '[grid]\nbend = "1e5:1e6:0"\n'}, "bend"),
    "grid without bend": ({"grid": "[grid]\ntwist = 3\n"}, "bend"),
    "axis no number": ({"grid": "[grid]\nbend = [1, 2]\n"}, "grid.bend"),
    "axis of text": ({"grid": '[grid]\nbend = "stiff"\n'}, "bend"),
    "name no text": ({"top": "name = 3\n"}, "name"),
    "clamp": ({"top": 'clamp_start = "glued"\n'}, "clamp_start"),
    "objective": ({"top": 'objective = "both"\n'}, "objective"),
    "pairs of a static scene": ({"top": 'pairs = "pairs.csv"\n'}, "pairs"),
    "pairs no text": ({"top": 'objective = "dynamic"\npairs = [[0, 1]]\n'}, "pairs"),
    "rolls negative": ({"top": "roll_hypotheses = -1\n"}, "roll_hypotheses"),
    "spins negative": ({"top": "spins = -1\n"}, "spins"),
    "spins no whole number": ({"top": "spins = 2.5\n"}, "spins"),
    "spins true": ({"top": "spins = true\n"}, "spins"),
    "precision": ({"top": "precision = 64\n"}, "precision"),
    "frame weight": ({"top": "frame_weight_mm = -1\n"}, "frame_weight_mm"),
    "frame weight text": ({"top": 'frame_weight_mm = "6.7"\n'}, "frame_weight_mm"),
    "frame weight not a number": ({"top": "frame_weight_mm = nan\n"}, "frame_weight_mm"),
    "no twist": ({"data": "[synthesis]\nbend = 1e5\n"}, "synthesis.twist"),
    "bend not definite": ({"data": "[synthesis]\nbend = [[1, 2], [2, 1]]\ntwist = 1\n"}, "synthesis.bend"),
    "bend asymmetric": ({"data": "[synthesis]\nbend = [[1, 0.5], [0, 1]]\ntwist = 1\n"}, "synthesis.bend"),
    "bend a vector": ({"data": "[synthesis]\nbend = [1, 2]\ntwist = 1\n"}, "synthesis.bend"),
    "bend ragged": ({"data": "[synthesis]\nbend = [[1], [2, 3]]\ntwist = 1\n"}, "synthesis.bend"),
    "twist negative": ({"data": "[synthesis]\nbend = 1\ntwist = -1\n"}, "synthesis.twist"),
    "seed": (synthesis("seed = 1.5"), "synthesis.seed"),
    "seed negative": (synthesis("seed = -1"), "synthesis.seed"),
    "marks": (synthesis("marks = 2"), "synthesis.marks"),
    "marks true": (synthesis("marks = true"), "synthesis.marks"),
    "marks off the mesh": (synthesis("marks = 30"), "synthesis.marks"),
    "clip off the mesh": (synthesis("clip_mm = 2.5"), "synthesis.clip_mm"),
    "clip too long": (synthesis("clip_mm = 50"), "synthesis.clip_mm"),
    "second clip off the mesh": (synthesis("clip_mm = [3, 2.5]"), "synthesis.clip_mm"),
    "a clip that is not a number": (synthesis("clip_mm = nan"), "synthesis.clip_mm"),
    "an endless clip": (synthesis("clip_mm = [3, inf]"), "synthesis.clip_mm"),
    "bend not a number": ({"data": "[synthesis]\nbend = nan\ntwist = 1\n"}, "synthesis.bend"),
    "three clips": (synthesis("clip_mm = [3, 3, 3]"), "synthesis.clip_mm"),
    "one clip too long": (synthesis("clip_mm = [3, 50]"), "synthesis.clip_mm"),
    "no clip": (synthesis("clip_mm = [0, 3]"), "synthesis.clip_mm"),
    "curvature range": (synthesis("rest_curvature_range_mm = -1"), "synthesis.rest_curvature_range_mm"),
    "curvature range longer than the rod": (synthesis("rest_curvature_range_mm = 100"), "synthesis.rest_curvature_range_mm"),
    "clip tilt": (synthesis("clip_tilt_deg = -1"), "synthesis.clip_tilt_deg"),
    "clip tilt upside down": (synthesis("clip_tilt_deg = 180"), "synthesis.clip_tilt_deg"),
    "clip offset": (synthesis("clip_offset_mm = nan"), "synthesis.clip_offset_mm"),
    "clip scatter": (synthesis('clip_scatter_deg = "1"'), "synthesis.clip_scatter_deg"),
    "noise of end marks": (synthesis("end_mark_noise = 1"), "synthesis.end_mark_noise"),
    "distances": (synthesis("end_distances_mm = [30, 120]"), "synthesis.end_distances_mm"),
    "no distances": (synthesis("end_distances_mm = []"), "synthesis.end_distances_mm"),
    "distances one number": (synthesis("end_distances_mm = 30"), "synthesis.end_distances_mm"),
    "rotations text": (synthesis('end_rotations_deg = ["0"]'), "synthesis.end_rotations_deg"),
    "rotations twice": (synthesis("end_rotations_deg = [0, 0]"), "synthesis.end_rotations_deg"),
    "direction": (synthesis("start_direction = [0, 0, 0]"), "synthesis.start_direction"),
    "direction flat": (synthesis("end_direction = [1, 0]"), "synthesis.end_direction"),
    "frames": (synthesis("frames = 1"), "synthesis.frames"),
    "noise": (synthesis("label_noise_mm = inf"), "synthesis.label_noise_mm"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_scenes_are_named(tmp_path, case):
    parts, field = WRONG[case]
    path = write(tmp_path, **parts)
    with pytest.raises(InputError) as caught:
        load_scene(path)
    assert (caught.value.source, caught.value.field) == (str(path), field)
    assert caught.value.remedy and "\n" not in str(caught.value)


def test_an_unknown_key_lists_the_valid_ones(tmp_path):
    with pytest.raises(InputError, match="label_noise_mm"):
        load_scene(write(tmp_path, **synthesis("noise = 1")))
