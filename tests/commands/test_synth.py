"""doo-ti synth: images of the virtual lab's rods, with sets.csv, rig and truth; observations beside them or alone."""

from pathlib import Path

import numpy as np
import pytest

from doo_ti import Camera, Rig, load_observations
from doo_ti.commands.cli import main
from doo_ti.io.scene import load_scene
from doo_ti.lab.synthesis import synthesise
from doo_ti.perception.virtual_lab import lab_rods
from doo_ti.vision.images import load_sets
from doo_ti.vision.render import Photographs, RenderOptions
from doo_ti.vision.rig_files import load_rig, save_rig
from tests.commands.calls import refused, succeeded

SCENE = ('name = "silk"\n[synthesis]\nseed = 4\nbend = 1.5e5\ntwist = 5e4\nend_distances_mm = [42, 66]\n'
         'end_rotations_deg = [0, -30]\n[grid]\nbend = 1e5\n')
NAMES = ("silk_42mm_000deg", "silk_66mm_000deg", "silk_42mm_-30deg", "silk_66mm_-30deg")


def small_rig() -> Rig:
    """The shipped rig with a sixth of its pixels each way."""
    cameras = load_rig(Path(__file__).resolve().parents[2] / "scenes" / "rig.yaml").cameras
    shrink = np.diag([1 / 6, 1 / 6, 1.0])
    return Rig(tuple(Camera(c.name, 213, 160, shrink @ c.matrix, c.distortion, c.rotation, c.translation) for c in cameras))


def prepared(folder, *words: str, scene: str = SCENE) -> list[str]:
    (folder / "silk.toml").write_text(scene)
    save_rig(folder / "cameras.yaml", small_rig())
    return ["synth", str(folder / "silk.toml"), "--images", str(folder / "new" / "images"), "--rig",
            str(folder / "cameras.yaml"), *words]


def grey(path: Path) -> np.ndarray:
    cv2 = pytest.importorskip("cv2")
    return cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)


@pytest.mark.thorough
def test_images_with_all_that_is_known_of_them(tmp_path, capsys):
    out = tmp_path / "silk.npz"
    printed = succeeded(capsys, prepared(tmp_path, "--seed", "7", "--out", str(out)))
    folder = tmp_path / "new" / "images"
    assert "4 sets of 3 images" in printed and str(folder) in printed and "4 observations" in printed

    recipe = load_scene(tmp_path / "silk.toml").observations
    rig = load_rig(folder / "rig.yaml")
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
    observations = load_observations(out)
    np.testing.assert_array_equal(observations.vertices, synthesise(recipe).vertices)
    noise = observations.vertices - truth["vertices_mm"]
    assert not noise[:, :2].any() and 0.08 < noise[:, 2:-2].std() < 0.16


def test_images_as_asked_for(tmp_path):
    words = ["--diameter", "0.9", "--render", "jpeg_quality=none", "--render", "noise=0", "--render", "clutter=1",
             "--render", "thread=230", "--render", "background=60", "--render", "light=0,0,1"]
    assert main(prepared(tmp_path, *words)) == 0
    folder = tmp_path / "new" / "images"
    look = RenderOptions(jpeg_quality=None, noise=0.0, clutter=1, thread=230.0, background=60.0, light=(0.0, 0.0, 1.0))
    rods = lab_rods(load_scene(tmp_path / "silk.toml").observations)
    wanted = photographed(Photographs(NAMES, rods.curve, rods.point, rods.direction, 0.9, load_rig(folder / "rig.yaml"), look))
    np.testing.assert_array_equal(grey(folder / f"{NAMES[3]}_front.png"), wanted[3][1])
    assert not list(folder.glob("*.jpg")) and len(list(folder.glob("*.png"))) == 12


def photographed(photographs: Photographs) -> list:
    return [photographs.images(index) for index in range(len(photographs.names))]


def test_a_set_is_the_same_in_any_company():
    rods = lab_rods(load_scene(Path(__file__).resolve().parents[2] / "scenes" / "silk.toml").observations).take([3, 40])
    rig = small_rig()
    both = Photographs(rods.names, rods.curve, rods.point, rods.direction, 0.5, rig, seed=3)
    alone = rods.take([0])
    one = Photographs(alone.names, alone.curve, alone.point, alone.direction, 0.5, rig, seed=3)
    np.testing.assert_array_equal(photographed(both)[0], photographed(one)[0])


BAD = {
    "no rig": (["--rig"], "--rig", "missing"),
    "no such rig": (["--rig", "absent.yaml"], "absent.yaml", "no such file"),
    "unknown look": (["--render", "glare=3"], "--render", "'glare=3'"),
    "look without a value": (["--render", "noise"], "--render", "NAME=VALUE"),
    "look of another type": (["--render", "clutter=1.5"], "--render", "whole number"),
    "look out of range": (["--render", "noise=-1"], "noise", "not negative"),
    "diameter": (["--diameter", "0"], "--diameter", "positive")}


@pytest.mark.parametrize("case", BAD)
def test_wrong_options(capsys, tmp_path, case):
    words, *named = BAD[case]
    argv = prepared(tmp_path)
    argv = argv[:-2] + words[1:] if words == ["--rig"] else argv + words
    refused(capsys, tmp_path, argv, *named)


@pytest.mark.parametrize("words", [["--rig", "absent.yaml"], ["--seed", "3"], ["--render", "noise=2"]])
def test_options_of_images_need_images(capsys, tmp_path, words):
    refused(capsys, tmp_path, [*prepared(tmp_path)[:2], "--out", "o.npz", *words], words[0], "--images")


def test_wrong_places_scenes_and_rigs(capsys, tmp_path):
    argv = prepared(tmp_path)
    refused(capsys, tmp_path, ["synth", argv[1]], "--out", "missing")
    refused(capsys, tmp_path, [*argv[:3], argv[1], *argv[4:]], "--images", "is a file")
    (tmp_path / "full").mkdir()
    save_rig(tmp_path / "full" / "rig.yaml", small_rig())
    refused(capsys, tmp_path, [*argv[:3], "full", "--rig", "full/rig.yaml"], "--images", "is the input itself")
    save_rig(tmp_path / "cameras.yaml", Rig(tuple(
        Camera(c.name, 100, 60, c.matrix, c.distortion, c.rotation, c.translation) for c in small_rig().cameras)))
    refused(capsys, tmp_path, argv, "cameras.left", "does not see all of silk_42mm_000deg")
    ribbon = SCENE.replace("1.5e5", "[[6e6, 0], [0, 1e5]]")
    refused(capsys, tmp_path, prepared(tmp_path, scene=ribbon), "synthesis.bend", "not round")
    refused(capsys, tmp_path, prepared(tmp_path, scene=SCENE.replace('"silk"', '"a/b"')), "name", "cannot name a folder")
    file = '[observations]\nfile = "x.npz"\n[grid]\nbend = 1e5\n'
    refused(capsys, tmp_path, prepared(tmp_path, scene=file), "observations", "[synthesis]")
