"""The recording of a predicted motion: rods, the grippers that hold them, the marks they started from, jumps."""

import numpy as np
import pytest

from doo_ti.record import FAILED, record_motion
from doo_ti.report import MovingRods, distinct_colors
from tests.record.recordings import read


def moving_rods(rng, moments: int = 4, count: int = 9) -> MovingRods:
    vertices = rng.normal(size=(moments, count, 6, 3))
    jumps, sound = np.zeros((moments, count), int), np.ones((moments, count), bool)
    jumps[2, 1], sound[3, 4] = 1, False
    grippers = np.full((moments, count, 4, 2, 3), np.nan)
    grippers[:, :, :2] = rng.normal(size=(moments, count, 2, 2, 3))  # the far end is free
    marks = vertices[0].copy()
    marks[0, 2] = np.nan
    return MovingRods(np.arange(moments, dtype=float), vertices, [f"rod {k}" for k in range(count)], jumps, sound,
                      grippers=grippers, marks=marks)


def test_grippers_and_marks_are_shown(tmp_path, rng):
    rods = moving_rods(rng)
    curves = {"Energy [mm²]": rng.normal(size=(4, 9)), "Force [mm]": rng.normal(size=(4, 9))}
    record_motion(tmp_path / "r.rrd", run_id="r", name="made up", rods=rods, curves=curves, text="words")
    static, moving = read(tmp_path / "r.rrd")
    assert {"/world", "/world/rods", "/world/grippers", "/world/observations/marks", "/summary"} <= set(static)
    assert set(moving) == {"/world/rods", "/world/grippers", "/curves/Energy__mm²_", "/curves/Force__mm_", "/log"}
    drawn = moving["/world/grippers"]["time"]["LineStrips3D:strips"]
    assert len(drawn) == 4 and [len(line) for line in drawn[0]] == [2, 2, 0, 0] * 9
    np.testing.assert_allclose(drawn[3][0], rods.grippers[3, 0, 0], rtol=1e-5)
    assert len(static["/world/observations/marks"]["Points3D:positions"][0]) == 9 * 6 - 1
    colors = np.array(moving["/world/rods"]["time"]["LineStrips3D:colors"]) >> 8
    assert len(set(colors[0].tolist())) == 9 and colors[3, 4] == int.from_bytes(bytes(FAILED))
    assert len(set(static["/curves/Force__mm_"]["SeriesLines:colors"][0])) == 9
    assert moving["/log"]["time"]["TextLog:text"] == [["rod 1 jumps to another branch"]]


@pytest.mark.parametrize("count", [1, 6, 7, 60])
def test_colours_do_not_repeat(count):
    colors = distinct_colors(count).astype(int)
    assert len(np.unique(colors, axis=0)) == count
    assert (np.abs(colors - np.array(FAILED)).max(axis=1) > 60).all() and (colors.max(axis=1) > 100).all()
