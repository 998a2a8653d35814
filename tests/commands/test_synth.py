"""doo-ti synth: images of the virtual lab's rods, with sets.csv, rig and truth; observations beside them or alone."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from doo_ti import Rig, load_observations
from doo_ti.io.scene import load_scene
from doo_ti.lab.synthesis import synthesise
from doo_ti.perception.virtual_lab import lab_rods
from doo_ti.vision.images import load_sets
from doo_ti.vision.render import Photographs, RenderOptions
from doo_ti.vision.rig_files import load_rig, save_rig
from tests.commands.calls import refused, succeeded
from tests.processes import ROOT

SCENE = ('name = "silk"\n[synthesis]\nseed = 4\nbend = 1.5e5\ntwist = 5e4\nend_distances_mm = [42, 66]\n'
         'end_rotations_deg = [0, -30]\n[grid]\nbend = 1e5\n')
NAMES = ("silk_42mm_000deg", "silk_66mm_000deg", "silk_42mm_-30deg", "silk_66mm_-30deg")


def small_rig() -> Rig:
    shrink = np.diag([1 / 6, 1 / 6, 1.0])
    return Rig(tuple(replace(camera, width=213, height=160, matrix=shrink @ camera.matrix)
                     for camera in load_rig(ROOT / "scenes" / "rig.yaml").cameras))


SYNTH = "synth silk.toml --images new/images --rig cameras.yaml"


@pytest.fixture(autouse=True)
def prepared(written_whole) -> None:
    Path("silk.toml").write_text(SCENE)
    save_rig("cameras.yaml", small_rig())


def grey(path: Path) -> np.ndarray:
    return cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)


@pytest.mark.thorough
def test_images_with_all_that_is_known_of_them(capsys):
    printed, folder = succeeded(capsys, f"{SYNTH} --seed 7 --out silk.npz"), Path("new/images")
    assert "4 sets of 3 images" in printed and str(folder) in printed and "4 observations" in printed
    recipe, rig = load_scene("silk.toml").observations, load_rig(folder / "rig.yaml")
    sets, rods = load_sets(folder / "sets.csv", rig), lab_rods(recipe)
    assert sets.names == NAMES and rig.names == small_rig().names
    np.testing.assert_allclose(sets.point, rods.vertices[:, 0], atol=1e-12)
    np.testing.assert_allclose(sets.direction, rods.direction, atol=1e-12)
    wanted = photographed(Photographs(NAMES, rods.curve, rods.point, rods.direction, 0.5, rig, seed=7))
    for paths, images in zip(sets.paths, wanted, strict=True):
        for path, image in zip(paths, images, strict=True):
            np.testing.assert_array_equal(grey(path), image)
    truth = np.load(folder / "truth.npz")
    assert truth["names"].tolist() == list(NAMES) and truth["thread_diameter_mm"] == 0.5
    np.testing.assert_array_equal(truth["vertices_mm"], rods.vertices)
    np.testing.assert_array_equal(truth["rest_length_mm"], np.full(33, 3.0))
    np.testing.assert_array_equal(truth["curve_mm"], rods.curve)
    observations = load_observations("silk.npz")
    np.testing.assert_array_equal(observations.vertices, synthesise(recipe).vertices)
    noise = observations.vertices - truth["vertices_mm"]
    assert not noise[:, :2].any() and 0.08 < noise[:, 2:-2].std() < 0.16


def test_images_as_asked_for(capsys):
    asked = ("jpeg_quality=none", "noise=0", "clutter=1", "thread=230", "background=60", "light=0,0,1")
    succeeded(capsys, f"{SYNTH} --diameter 0.9 --render {' --render '.join(asked)}")
    folder, rods = Path("new/images"), lab_rods(load_scene("silk.toml").observations)
    look = RenderOptions(jpeg_quality=None, noise=0.0, clutter=1, thread=230.0, background=60.0, light=(0.0, 0.0, 1.0))
    wanted = photographed(Photographs(NAMES, rods.curve, rods.point, rods.direction, 0.9, load_rig(folder / "rig.yaml"), look))
    np.testing.assert_array_equal(grey(folder / f"{NAMES[3]}_front.png"), wanted[3][1])
    assert not list(folder.glob("*.jpg")) and len(list(folder.glob("*.png"))) == 12


def photographed(photographs: Photographs) -> list:
    return [photographs.images(index) for index in range(len(photographs.names))]


def test_a_set_is_the_same_in_any_company():
    rods = lab_rods(load_scene(ROOT / "scenes" / "silk.toml").observations).take([3, 40])
    both, one = (photographed(Photographs(some.names, some.curve, some.point, some.direction, 0.5, small_rig(), seed=3))
                 for some in (rods, rods.take([0])))
    np.testing.assert_array_equal(both[0], one[0])


@pytest.mark.parametrize("words, named", [
    ("--rig absent.yaml", ("absent.yaml", "no such file")), ("--render glare=3", ("--render", "'glare=3'")),
    ("--render noise", ("--render", "NAME=VALUE")), ("--render clutter=1.5", ("--render", "whole number")),
    ("--render noise=-1", ("noise", "not negative")), ("--diameter 0", ("--diameter", "positive"))])
def test_wrong_options(capsys, tmp_path, words, named):
    refused(capsys, tmp_path, f"{SYNTH} {words}", *named)


def test_wrong_places_scenes_and_rigs(capsys, tmp_path):
    for words in ("--rig absent.yaml", "--seed 3", "--render noise=2"):
        refused(capsys, tmp_path, f"synth silk.toml --out o.npz {words}", words.split()[0], "--images")
    refused(capsys, tmp_path, SYNTH.replace("--rig cameras.yaml", ""), "--rig", "missing")
    refused(capsys, tmp_path, "synth silk.toml", "--out", "missing")
    refused(capsys, tmp_path, SYNTH.replace("new/images", "silk.toml"), "--images", "is a file")
    Path("full").mkdir()
    save_rig("full/rig.yaml", small_rig())
    refused(capsys, tmp_path, "synth silk.toml --images full --rig full/rig.yaml", "--images", "is the input itself")
    save_rig("cameras.yaml", Rig(tuple(replace(camera, width=100, height=60) for camera in small_rig().cameras)))
    refused(capsys, tmp_path, SYNTH, "cameras.left", "does not see all of silk_42mm_000deg")
    save_rig("cameras.yaml", small_rig())
    for scene, named in ((SCENE.replace("1.5e5", "[[6e6, 0], [0, 1e5]]"), ("synthesis.bend", "not round")),
                         (SCENE.replace('"silk"', '"a/b"'), ("name", "cannot name a folder")),
                         ('observations.file = "x.npz"\ngrid.bend = 1e5\n', ("observations", "[synthesis]"))):
        Path("silk.toml").write_text(scene)
        refused(capsys, tmp_path, SYNTH, *named)
