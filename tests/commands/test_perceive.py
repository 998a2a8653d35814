"""doo-ti perceive: from images of rods to a file that doo-ti twist reads, with a picture and a recording beside it."""

import json
import shutil
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from scipy.spatial import cKDTree

from doo_ti import Rig, load_observations
from doo_ti.commands.cli import main
from doo_ti.commands.image_options import LengthBounds, detections
from doo_ti.system.errors import InputError
from doo_ti.vision.detection import Detection
from doo_ti.vision.render import render_set
from doo_ti.vision.rig_files import load_rig, save_rig
from doo_ti.vision.tubes import smooth_curve
from tests.commands.calls import ended, refused, succeeded, written
from tests.record.runs import read
from tests.vision.scenes import curves, three_cameras

EDGES = 14
MATERIAL = ["--bend", "2e5", "--twist", "2e5", "--weight", "1", "--rest-length", f"3:{EDGES}"]
ALONE = ("--no-picture", "--no-recording")


@pytest.fixture(scope="module")
def photographed(tmp_path_factory):
    """(folder of images, SETS.csv, the rig and the truth; the rods' vertices)."""
    folder, rods = tmp_path_factory.mktemp("images"), curves(np.random.default_rng(8), 2, EDGES)
    rig = three_cameras()
    save_rig(folder / "rig.yaml", rig)
    lines = ["name,cam0,cam1,cam2,seed_x,seed_y,seed_z,dir_x,dir_y,dir_z"]
    for name, rod in zip(("first", "second"), rods):
        for path, image in zip(images_of(folder, name), render_set(rig, smooth_curve(rod, 8), 1.0, seed=4)):
            assert cv2.imwrite(path, image)
        lines.append(",".join([name, *images_of(folder, name), *(f"{x:.6f}" for x in (*rod[0], *(rod[1] - rod[0])))]))
    (folder / "sets.csv").write_text("\n".join(lines) + "\n")
    np.savez(folder / "truth.npz", vertices_mm=rods[::-1], names=np.array(["second", "first"]))
    return folder, rods


def of_sets(folder, *more: str) -> list[str]:
    return ["perceive", "--rig", f"{folder}/rig.yaml", "--sets", f"{folder}/sets.csv", *MATERIAL, *more]


def images_of(folder, name: str = "first") -> list[str]:
    return [f"{folder}/{name}_cam{index}.png" for index in range(3)]


def of_images(folder, rod, *more: str) -> list[str]:
    seed = [",".join(f"{value:.6f}" for value in values) for values in (rod[0], rod[1] - rod[0])]
    return ["perceive", *images_of(folder), "--rig", f"{folder}/rig.yaml", "--seed-point", seed[0], "--seed-direction", seed[1],
            *MATERIAL, *more]


@pytest.fixture(scope="module")
def perceived(photographed, tmp_path_factory):
    """The command on both sets: (folder of what it wrote, its arrays, what it printed)."""
    (folder, _), out, printed = photographed, tmp_path_factory.mktemp("perceived") / "new", StringIO()
    with redirect_stdout(printed):
        assert main(of_sets(folder, "--out", f"{out}/f.npz", "--truth", f"{folder}/truth.npz", "--recorded", "1")) == 0
    return out, written(out / "f.npz"), printed.getvalue()


def test_rods_are_found_and_written(photographed, perceived):
    _, rods = photographed
    out, found, printed = perceived
    assert sorted(path.name for path in out.iterdir()) == ["f.npz", "f.png", "f.rrd"]
    assert "2 sets of 3 images" in printed and "14 edges" in printed and "2 converged" in printed
    line = next(line for line in printed.splitlines() if line.strip().startswith("second"))
    assert all(part in line for part in ("E_vis", "px off", "σ", "error 0.0"))
    assert found["name"].tolist() == ["first", "second"] and found["status"].tolist() == [0, 0]
    assert np.linalg.norm(found["vertices_mm"] - rods, axis=-1).mean() < 0.1
    vertices, edges = EDGES + 1, EDGES
    assert {name: value.shape for name, value in found.items()} == {
        "name": (2,), "vertices_mm": (2, vertices, 3), "rest_length_mm": (edges,), "up": (3,), "valid": (2, vertices),
        "sigma_mm": (2, vertices), "energy_vis": (2,), "status": (2,), "stable": (2,), "camera_error_px": (2, 3),
        "coverage": (2, 3), "thread_length_mm": (2,), "left_over_mm": (2,), "length_range_mm": (2, 2), "outside": (2, 3),
        "skipped": (2, 3), "twice": (2, 3), "wider": (2, 3), "hidden": (2, 3), "verdict": (2,), "gap_px": (2,),
        "beyond_mm": (2, 2), "unsupported": (2, edges), "runner_up_mm": (2, 4, vertices, 3), "runner_up_energy_vis": (2, 4)}
    assert (out / "f.png").read_bytes()[:4] == b"\x89PNG"
    static, moving = read(out / "f.rrd")
    assert "/images/set0_first/cam1/truth" in static and not any("second" in entity for entity in (*static, *moving))
    assert moving["/world/set0_first/rods"]["edges"]["edges"] == list(range(2, EDGES + 2))
    assert any(strips for strips in moving["/world/set0_first/pruned"]["edges"]["LineStrips3D:strips"])


@pytest.mark.thorough
def test_rods_begun_by_clicks_end_where_the_thread_ends(photographed, tmp_path, capfd):
    """Sets with a pixel each, in one camera or another; their inner marks are observations for refine."""
    folder, rods = photographed
    lines = ["name,cam0,cam1,cam2,cam0_u,cam0_v,cam1_u,cam1_v"]
    for name, rod, camera in (("first", rods[0], 0), ("second", rods[1], 1)):
        u, v = load_rig(folder / "rig.yaml").cameras[camera].project(rod[:1])[0] + (2, -2)
        lines.append(f"{name},{','.join(images_of(folder, name))},{',,' * camera}{u:.0f},{v:.0f}{',,' * (1 - camera)}")
    Path("sets.csv").write_text("\n".join(lines) + "\n")
    words = ["perceive", "--rig", f"{folder}/rig.yaml", "--sets", "sets.csv", *MATERIAL[:6], "--out", "rods.npz", *ALONE]
    succeeded(capfd, words)
    succeeded(capfd, "convert rods.npz marks.npz --marks 2:-2 --complete")
    found = load_observations("marks.npz")
    assert found.count == 2 and found.edges == 29 and abs(found.rest_length.sum() / 29 * 33 / (3 * EDGES) - 1) < 0.05
    for marks, rod in zip(found.vertices, rods, strict=True):
        assert cKDTree(smooth_curve(rod, 200)).query(marks)[0].max() < 0.2
    Path("sets.csv").write_text("\n".join([lines[0], lines[2].replace(lines[2].split(",")[6], "9")]) + "\n")
    refused(capfd, tmp_path, words, "sets.csv: --seed-pixel: 9,")


@pytest.mark.thorough
def test_sets_without_a_rod_do_not_end_the_others(photographed, perceived, capsys):
    """One with a click beside the thread, one with a blank image: their rows say so, and the others are as without them."""
    folder, rods = photographed
    u, v = load_rig(folder / "rig.yaml").cameras[0].project(rods[1][:1])[0]
    cv2.imwrite("blank.png", np.full((480, 640), 255, dtype=np.uint8))
    rows = [["beside", *images_of(folder), "9", "9"], ["second", *images_of(folder, "second"), f"{u:.0f}", f"{v:.0f}"],
            ["blank", *images_of(folder, "second")[:2], "blank.png", f"{u:.0f}", f"{v:.0f}"]]
    found, text = {}, {}
    for name, kept in (("all", rows), ("one", rows[1:2])):
        Path("sets.csv").write_text("\n".join(["name,cam0,cam1,cam2,cam0_u,cam0_v", *map(",".join, kept)]) + "\n")
        words = ["perceive", "--rig", f"{folder}/rig.yaml", "--sets", "sets.csv", *MATERIAL[:6], "--no-recording"]
        text[name], found[name] = succeeded(capsys, [*words, "--out", "f.npz"]), written("f.npz")
    assert all(part in text["all"] for part in ("beside  no rod: ", "nothing was detected", "blank.png: image: no thread"))
    every, one = found["all"], found["one"]
    assert every["name"].tolist() == ["beside", "second", "blank"] and every["status"].tolist() == [4, 0, 4]
    assert every["verdict"].tolist() == [3, one["verdict"][0], 3] and not every["valid"][[0, 2]].any()
    np.testing.assert_array_equal(every["vertices_mm"][1], one["vertices_mm"][0])


def test_a_click_beside_the_thread_is_an_error_of_its_set():
    def of_set(row, paths, cameras):
        if row == 1:
            raise InputError(paths[0], "pixel", "no thread at 2,2", "give another one")
        return sight, {}

    sight = SimpleNamespace(clicks=[{0: (2, 2)}] * 3, of_set=of_set, agreed=lambda found, *_: found,
                            detected=lambda path, _: Detection.none((9, 9), path))
    failed, paths = {}, [["a"], ["b"], ["c"]]
    assert [found[0].method for found in detections(sight, paths, [None], failed)] == ["a", "b", "c"] and list(failed) == [1]
    with pytest.raises(InputError, match="no thread at 2,2"):
        list(detections(sight, paths, [None]))


@pytest.mark.parametrize("lengths, bounds, like", [
    ([590.0, 840, 594, 1205, 584, np.nan], (0, np.inf), [0, 2, 4]),  # half of the lines go on along the clips
    ([300.0, 301, 299, 305, 297, 302], (0, np.inf), range(6)), ([300.0, 410, 415, 412, 303, np.nan], (250, 350), [0, 4]),
    ([300.0, 340], (0, np.inf), range(2)), ([410.0, np.nan], (0, 350), [0])])
def test_the_length_is_that_of_the_lines_that_agree_and_at_a_bound_not_certain(lengths, bounds, like):
    assert np.flatnonzero(LengthBounds(*bounds).agreeing(np.array(lengths))).tolist() == list(like)
    assert LengthBounds(285, 315).range(270, np.array([264, 277])).tolist() == [285, 292]
    assert LengthBounds().range(270, np.array([264, 277])).tolist() == [264, 277]


def test_stiffness_need_not_be_known(photographed, perceived, capsys):
    folder, rods = photographed
    np.savez("truth.npz", vertices_mm=rods[:1] / 1000)
    argv = of_images(folder, rods[0], "--out", "one.csv", *ALONE, "--truth", "truth.npz", "--unit", "m")
    for name in ("--bend", "--twist", "--weight"):
        del argv[argv.index(name) : argv.index(name) + 2]
    out, err = ended(capsys, argv)
    assert "none given: bend 1e+06 mm³" in out and "1 set of 3 images" in out and "runner_up_mm" in err and "note" in err
    found = load_observations("one.csv").vertices[0]
    assert np.abs(found - perceived[1]["vertices_mm"][0]).max() < 0.01
    assert f"error {np.linalg.norm(found - rods[0], axis=-1).mean():.3f} mm" in out


def test_a_seed_and_a_wrong_length(photographed, capsys):
    folder, rods = photographed
    argv = of_images(folder, rods[0], "--out", "f.npz", *ALONE, "--rest-length", f"3:{EDGES - 6}")
    assert "not clear" in succeeded(capsys, argv)


@pytest.mark.thorough
def test_a_click_and_no_length(photographed, tmp_path, capsys):
    """The rod begins at the end of the thread near the click, and ends at its other end: of its blunt ends, as detected."""
    folder, rods = photographed
    rig, length = load_rig(folder / "rig.yaml"), 3.0 * EDGES
    click = rig.cameras[1].project(rods[0][:1])[0] + [4.0, 3.0]
    begin = ["perceive", *images_of(folder), "--rig", f"{folder}/rig.yaml", "--edge", "3", *ALONE]
    argv = [*begin, "--seed-pixel", f"cam1:{click[0]:.1f},{click[1]:.1f}"]
    printed = json.loads(succeeded(capsys, [*argv, "--out", "f.npz", "--json"]))["sets"][0]
    found = written("f.npz")
    assert np.linalg.norm(found["vertices_mm"][0][0] - rods[0][0]) < 1.2
    assert found["rest_length_mm"].sum() == pytest.approx(length, rel=0.05)
    assert np.allclose(found["rest_length_mm"], 3.0, rtol=0.05)
    assert printed["name"] == "first_cam0" and min(printed["coverage"]) > 0.97 and printed["left_over_mm"] < 1.0
    # A rod of a third less: what is left over is said.
    said = succeeded(capsys, [*argv, "--length", "28", "--out", "g.npz"])
    assert written("g.npz")["left_over_mm"][0] == pytest.approx(length - 28, abs=3.0)
    assert "of thread left over" in said and "28 to 28 mm at a bound" in said
    u, v = rig.cameras[1].project(rods[0][[EDGES // 2]])[0]
    out, err = ended(capsys, [*begin, "--seed-pixel", f"cam1:{u:.0f},{v:.0f}", "--out", "h.npz"])
    assert "begins within the thread" in err and "may go on beyond the rod's start by" in out and "; ambiguous (" in out
    for change, words in ((["--seed-pixel", "cam9:1,2"], ("cam9", "cam0, cam1, cam2")), (["--length", "9:5"], ("--length",)),
                          (["--seed-pixel", "cam1:1,2"], ("given twice for cam1",)),
                          (["--rest-length", "3:14"], ("--edge", "--rest-length")),
                          (["--seed-point", "0,0,0"], ("--seed-point",)),
                          (["--seed-pixel", "cam0:3,3"], ("--seed-pixel", "px away"))):
        refused(capsys, tmp_path, [*argv, *change, "--out", "new/f.npz"], *words)


@pytest.mark.parametrize("change, words", [
    (["--bend", "1e5:1e6:5"], ("--bend", "grid")), (["--bend", "1e5,2e5"], ("--bend", "round")),
    (["--rest-length", "3:x"], ("--rest-length",)), (["--rest-length", "9e18:14"], ("--rest-length", "9e+18 mm")),
    (["--rest-length", "missing.txt"], ("--rest-length", "missing.txt")), (["--hypotheses", "0"], ("--hypotheses",)),
    (["--hypotheses", "9223372036854775808"], ("--hypotheses", "above")), (["--width", "1,2"], ("--width",)),
    (["--seed-point", "1,2,3"], ("--seed-point", "--sets")), (["--colour", "1,2"], ("colour",)),
    (["--colour", "clicked"], ("--colour", "--seed-pixel")),
    (["--region", "cam7:0,0,50,50"], ("--region", "cam7")), (["--region", "cam0:0,0,5,50"], ("region",)),
    (["--masks", "a.png"], ("--masks",)), (["--image-size", "3"], ("--image-size",))])
def test_wrong_options_are_reported(photographed, tmp_path, capsys, change, words):
    refused(capsys, tmp_path, of_sets(photographed[0], "--out", "new/f.npz", *change), *words)


def test_wrong_images_are_reported(photographed, tmp_path, capsys):
    folder, rods = photographed
    cv2.imwrite("blank.png", np.full((480, 640), 150, dtype=np.uint8))
    argv = of_images(folder, rods[0], "--out", "new/f.npz")
    for image, words in (("blank.png", ("blank.png", "no thread was found")), ("missing.png", ("missing.png", "no such file"))):
        refused(capsys, tmp_path, [*argv[:2], image, *argv[3:]], *words)
    cv2.imwrite("dark.png", np.zeros((480, 640), dtype=np.uint8))
    refused(capsys, tmp_path, [*argv, "--masks", *3 * ["dark.png"]], "dark.png: mask: no thread", "mark the thread in it")
    refused(capsys, tmp_path, [*argv[:2], "blank.png", *argv[3:], "--width", "3"], "--colour R,G,B or --polarity or --masks")
    refused(capsys, tmp_path, [*argv[:2], *argv[3:]], "2 images", "3 cameras", "cam0, cam1, cam2")
    refused(capsys, tmp_path, [word for word in argv if not word.endswith("png")], "IMAGE", "missing")


def test_no_input_is_overwritten(photographed, capsys):
    """The picture lies beside the file: an image may be there already."""
    folder, rods = photographed
    refused(capsys, folder, of_images(folder, rods[0], "--out", f"{folder}/first_cam0.npz"), "first_cam0.png")
    truth = f"{folder}/truth.npz"
    refused(capsys, folder, of_sets(folder, "--out", truth, "--truth", truth), "truth.npz")


def test_wrong_rigs_seeds_and_truths_are_reported(photographed, tmp_path, capsys):
    folder, rods = photographed
    rig, out = load_rig(folder / "rig.yaml"), ["--out", "new/f.npz"]
    behind = ",".join(map(str, 2 * rig.cameras[0].centre))
    refused(capsys, tmp_path, of_images(folder, rods[0], *out, "--seed-point", behind), "behind cam0")
    save_rig("one.yaml", Rig(rig.cameras[:1]))
    argv = f"perceive {folder}/first_cam0.png --rig one.yaml --seed-pixel cam0:100,100".split()
    refused(capsys, tmp_path, [*argv, *MATERIAL, *out], "one camera", "--seed-point")
    for keys, said in (({"vertices_mm": rods, "name": np.array(["first", "third"])}, "second"),
                       ({"vertices_mm": rods, "name": np.array(["first", "second", "third"])}, "shape (3,)"),
                       ({"vertices_mm": rods[:1]}, "1 rods for 2 sets")):
        np.savez("truth.npz", **keys)
        refused(capsys, tmp_path, of_sets(folder, *out, "--truth", "truth.npz"), said)


def test_one_mask_is_not_taken_for_two_cameras(photographed, tmp_path, capsys):
    names, cells = (line.split(",") for line in (photographed[0] / "sets.csv").read_text().splitlines()[:2])
    for place, image in zip(("cam0", "cam1", "cam2", "masks"), (*cells[1:4], cells[1])):
        Path(place).mkdir()
        shutil.copyfile(image, f"{place}/first.png")
    own = [cells[0], *(f"{camera}/first.png" for camera in names[1:4]), *cells[4:]]
    Path("sets.csv").write_text(f"{','.join(names)}\n{','.join(own)}\n")
    argv = of_sets(photographed[0], "--out", "new/f.npz", "--masks", "masks", "--sets", "sets.csv")
    refused(capsys, tmp_path, argv, "masks", "several cameras")
