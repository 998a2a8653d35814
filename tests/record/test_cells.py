"""The recording of a figure, read back: a step per cell with that cell's rods, its mark in the picture and its text."""

import numpy as np
import pytest

from doo_ti import Observed
from doo_ti.record.sweep import CellsOfRun, Rods, record_cells
from doo_ti.record.viewer import FAILED
from doo_ti.report.canvas import distance_colors
from tests.conftest import SEED
from tests.record import runs
from tests.record.runs import read

CELLS, PANELS = 7, 2
LABELS = {"end_distance_mm": np.repeat([30.0, 50.0, 70.0], 2), "end_rotation_deg": np.tile([0.0, 120.0], 3)}
PAIRED = np.array([1, 0, 3, 2, 5, 4, 1])


def figure(rng, names=("silk", "a ribbon, dynamic")) -> dict:
    """What `record_cells` takes: of two runs, the second one with pairs, two of them ending on one observation."""
    observed, several, pieces = runs.observations(rng), [], []
    for number, name in enumerate(names):
        which = np.arange(runs.OBSERVATIONS) if number == 0 else PAIRED
        distance = rng.uniform(0.3, 30, (CELLS, len(which)))
        several.append(CellsOfRun(
            name=name, observed=Observed(observed, LABELS), observation=which, distance=distance,
            picture=rng.integers(0, 255, (90, 120, 3), dtype=np.uint8), boxes=rng.uniform(5, 50, (CELLS, PANELS, 4))))
        sound = rng.random(distance.shape) > 0.2
        rods = observed[which] + rng.normal(0, 3, (CELLS, len(which), runs.VERTICES, 3))
        pieces += [Rods(number, 0, rods[:4], distance[:4], sound[:4]), Rods(number, 4, rods[4:], distance[4:], sound[4:])]
    return {"run_id": "figure-1", "name": "made up", "runs": several, "cells": np.array([0, 3, 4, 8, 11, 15, 19]),
            "rank": rng.permutation(CELLS), "texts": [f"**Cell {k}**" for k in range(CELLS)], "rods": pieces}


def joined(given: dict, run: int, name: str) -> np.ndarray:
    return np.concatenate([getattr(piece, name) for piece in given["rods"] if piece.run == run])


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    path, given = tmp_path_factory.mktemp("cells") / "cells.rrd", figure(np.random.default_rng(SEED))
    record_cells(path, **given)
    assert [entry.name for entry in path.parent.iterdir()] == ["cells.rrd"]
    return given, *read(path)


def test_each_cell_is_a_step_with_its_rods_its_box_and_its_text(recorded):
    given, static, moving = recorded
    assert set(moving) == {"/world/silk/rods", "/landscape/silk/cell", "/world/a_ribbon__dynamic/rods",
                           "/landscape/a_ribbon__dynamic/cell", "/summary"}
    for run, place in enumerate(("silk", "a_ribbon__dynamic")):
        rods, still = moving[f"/world/{place}/rods"], static[f"/world/{place}/rods"]
        assert rods["cell"]["cell"] == given["cells"].tolist()
        assert rods["falling_error"]["cell"] == given["cells"][np.argsort(given["rank"])].tolist()
        offset = np.array(still["offset_mm"][0])
        assert len(still["LineStrips3D:labels"][0]) == len(given["runs"][run].observation)
        strips = np.array(rods["cell"]["LineStrips3D:strips"])
        np.testing.assert_allclose(strips - offset[:, None], joined(given, run, "vertices"), atol=1e-4)
        np.testing.assert_allclose(rods["cell"]["distance_mm"], joined(given, run, "distance"), rtol=1e-6)
        np.testing.assert_allclose(offset, np.array(static[f"/world/{place}/observations"]["offset_mm"][0])[
            given["runs"][run].observation])
        boxes = moving[f"/landscape/{place}/cell"]["cell"]
        centers, half = (np.array(boxes[f"Boxes2D:{name}"]) for name in ("centers", "half_sizes"))
        assert centers.shape == (CELLS, PANELS, 2)
        corner, size = given["runs"][run].boxes[..., :2], given["runs"][run].boxes[..., 2:]
        np.testing.assert_allclose(centers, corner + size / 2, rtol=1e-5)
        np.testing.assert_allclose(half, 0.625 * size, rtol=1e-5)
    assert moving["/summary"]["cell"]["TextDocument:text"] == [[text] for text in given["texts"]]
    assert static["/world/a_ribbon__dynamic/rods"]["LineStrips3D:labels"][0][-1] == "observation 1: 30 mm 120°"


def test_rods_are_coloured_on_one_scale_and_uncertified_ones_red(recorded):
    given, _, moving = recorded
    colors = np.array(moving["/world/silk/rods"]["cell"]["LineStrips3D:colors"])
    np.testing.assert_array_equal(colors >> 8 == int.from_bytes(bytes(FAILED)), ~joined(given, 0, "sound"))
    expected = distance_colors(joined(given, 0, "distance"), given["runs"][0].distance).astype(np.int64)
    packed = (expected[..., 0] << 16) + (expected[..., 1] << 8) + expected[..., 2]
    np.testing.assert_array_equal((colors >> 8)[joined(given, 0, "sound")], packed[joined(given, 0, "sound")])


def test_a_rod_that_is_nan_is_not_drawn(tmp_path, rng):
    given = figure(rng, names=("silk",))
    given["rods"][0].vertices[2, 4, 3] = np.nan
    given["rods"][0].distance[2, 4] = np.nan
    record_cells(tmp_path / "cells.rrd", **given)
    _, moving = read(tmp_path / "cells.rrd")
    counts = [[len(strip) for strip in row] for row in moving["/world/silk/rods"]["cell"]["LineStrips3D:strips"]]
    expected = np.full((CELLS, runs.OBSERVATIONS), runs.VERTICES)
    expected[2, 4] = 0
    np.testing.assert_array_equal(counts, expected)
