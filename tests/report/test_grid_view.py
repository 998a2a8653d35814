"""The grid view: every observation at its own place, gravity down; subtracting the offset gives true coordinates."""

import numpy as np
import pytest

from doo_ti.report.canvas import Observed, grid_view
from tests.record import runs

LABELS = {"end_distance_mm": np.repeat([30.0, 50.0, 70.0], 2), "end_rotation_deg": np.tile([120.0, 0.0], 3)}


def boxes(vertices, sheet) -> tuple[np.ndarray, np.ndarray]:
    """(D, 3) lowest and highest right, depth and up coordinate of each placed observation."""
    local = (vertices + sheet.offset[:, None]) @ sheet.basis.T
    return np.nanmin(local, axis=1), np.nanmax(local, axis=1)


@pytest.mark.parametrize("labels", [LABELS, {}, {"end_distance_mm": np.arange(6.0)},
                                    {"end_distance_mm": np.zeros(6), "end_rotation_deg": np.tile([0.0, 1.0], 3)},
                                    {"end_distance_mm": np.arange(6.0), "end_rotation_deg": np.arange(6.0)}])
def test_no_observation_overlaps_another(labels, rng):
    vertices = runs.observations(rng)
    vertices[3, 4], vertices[2, 0] = np.nan, np.nan
    sheet = grid_view(Observed(vertices, labels))
    low, high = boxes(vertices, sheet)
    apart = ((low[:, None] > high[None]) | (low[None] > high[:, None]))[..., [0, 2]].any(axis=-1)
    assert (apart | np.eye(len(vertices), dtype=bool)).all()
    assert (sheet.offset[0] == 0).all()
    corner = sheet.basis @ sheet.centre
    assert (low[:, [0, 2]] > corner[[0, 2]] - sheet.extent / 2).all()
    assert (high[:, [0, 2]] < corner[[0, 2]] + sheet.extent / 2).all()


def test_labels_make_columns_and_rows(rng):
    vertices = runs.observations(rng)
    sheet = grid_view(Observed(vertices, LABELS))
    low, high = boxes(vertices, sheet)
    middle, floor = (0.5 * (low + high)[:, 0]).reshape(3, 2), low[:, 2].reshape(3, 2)
    np.testing.assert_allclose(middle[:, 0], middle[:, 1], atol=1e-9)
    assert (np.diff(middle[:, 0]) > 0).all()
    np.testing.assert_allclose(floor, floor[:1].repeat(3, axis=0), atol=1e-9)
    assert (floor[:, 0] < floor[:, 1]).all()  # 120° stands in the row below 0°
    assert [text for text, _ in sheet.headings] == ["30 mm", "50 mm", "70 mm", "0°", "120°"]
    assert sheet.meaning == "columns: end distance, rows: end rotation"


@pytest.mark.parametrize("up", [(0, 0, 1), (0, -2, 0), (1, 1, 1)])
def test_plane_is_upright_along_the_rods(up, rng):
    right, depth, above = grid_view(Observed(runs.observations(rng), {}, up)).basis
    np.testing.assert_allclose(above, np.array(up) / np.linalg.norm(up), atol=1e-12)
    basis = np.stack([right, depth, above])
    np.testing.assert_allclose(basis @ basis.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(basis) > 0
    if up == (0, 0, 1):
        assert right[0] > 0.99


def test_one_observation_stays_where_it_is(rng):
    vertices = runs.observations(rng)[2:3] + 100.0
    sheet = grid_view(Observed(vertices))
    assert (sheet.offset == 0).all()
    assert sheet.headings == []


def test_names_say_number_and_labels(rng):
    vertices = runs.observations(rng)
    assert Observed(vertices, LABELS).names[1] == "observation 1: 30 mm 0°"
    assert Observed(vertices[:2]).names == ["observation 0", "observation 1"]
