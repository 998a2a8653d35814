"""Ribbons in space: bands of a given width, drawn and recorded."""

import numpy as np
import pytest

from doo_ti.report import Ribbons, ribbon_sides, ribbons_picture
from tests.record.recordings import read


def helices(count: int, marks: int = 20) -> tuple[np.ndarray, np.ndarray]:
    """(D, V, 3) and m1 (D, E, 3), across each edge and level."""
    along = np.linspace(0, 3, marks)
    radius = np.linspace(5, 12, count)[:, None]
    vertices = np.stack([20 * along + 0 * radius, radius * np.cos(along), radius * np.sin(along)], axis=-1)
    across = np.cross(np.diff(vertices, axis=1), [0.0, 0.0, 1.0])
    return vertices, across / np.linalg.norm(across, axis=-1, keepdims=True)


def kinds(count: int) -> list[Ribbons]:
    vertices, across = helices(count)
    return [Ribbons("observed", (120, 120, 120), ribbon_sides(vertices, across, 6.7), filled=False),
            Ribbons("1: red", (214, 57, 57), ribbon_sides(vertices + [0, 0, 9.0], across, 6.7)),
            Ribbons("3: blue", (48, 105, 205), ribbon_sides(vertices - [0, 0, 9.0], across, 6.7))]


def test_bands_have_the_given_width_and_lie_along_m1():
    vertices, across = helices(3)
    sides = ribbon_sides(vertices, across, 6.7)
    assert sides.shape == (3, 2, 20, 3)
    np.testing.assert_allclose(sides.mean(axis=1), vertices, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(sides[:, 1] - sides[:, 0], axis=-1), 6.7)
    np.testing.assert_allclose((sides[:, 1, 0] - sides[:, 0, 0]) / 6.7, across[:, 0], atol=1e-12)


@pytest.mark.thorough
def test_picture_shows_each_kind_in_its_colour(tmp_path):
    from PIL import Image

    ribbons_picture(tmp_path / "ribbons.png", kinds(2), 1, basis=np.eye(3), title="made up")
    picture = np.asarray(Image.open(tmp_path / "ribbons.png").convert("RGB")).astype(int)
    red = (picture[..., 0] > 1.8 * picture[..., 1]) & (picture[..., 0] > 90)
    blue = (picture[..., 2] > 1.8 * picture[..., 0]) & (picture[..., 2] > 90)
    half = picture.shape[1] // 2
    for color, inside, outside in ((red, slice(None, half), slice(half, None)), (blue, slice(half, None), slice(None, half))):
        assert color[:, inside].sum() > 5000 > 50 > color[:, outside].sum()


def test_recording_holds_a_band_per_kind_and_step(tmp_path):
    from doo_ti.record import record_ribbons

    shown = kinds(4)
    lost = shown[1].sides.copy()
    lost[2, :, 5] = np.nan
    shown[1] = Ribbons("1: red", (214, 57, 57), lost)
    record_ribbons(tmp_path / "r.rrd", run_id="r", name="made up", ribbons=shown, observation=np.array([3, 5, 6, 9]),
                   rank=np.array([2, 0, 1, 3]), texts=[f"text {k}" for k in range(4)], basis=np.eye(3))
    assert [entry.name for entry in tmp_path.iterdir()] == ["r.rrd"]
    static, moving = read(tmp_path / "r.rrd")
    assert set(moving) == {"/world/ribbons/0/borders", "/world/ribbons/1", "/world/ribbons/1/borders", "/world/ribbons/2",
                           "/world/ribbons/2/borders", "/summary"}
    band = moving["/world/ribbons/2"]
    assert set(band) == {"observation", "difference"}
    assert band["observation"]["observation"] == [3, 5, 6, 9] and band["difference"]["difference"] == [0, 1, 2, 3]
    assert band["difference"]["observation"] == [5, 6, 3, 9]
    points = np.array(band["observation"]["Mesh3D:vertex_positions"]).reshape(4, 2, 20, 3)
    np.testing.assert_allclose(points, shown[2].sides, atol=1e-4)
    triangles = np.array(static["/world/ribbons/2"]["Mesh3D:triangle_indices"][0])
    assert triangles.shape == (2 * 19, 3) and triangles.max() == 39
    corners = points.reshape(4, 40, 3)[:, triangles]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0]), axis=-1)
    length = np.linalg.norm(np.diff(shown[2].sides.mean(axis=1), axis=1), axis=-1).sum(axis=1)
    np.testing.assert_allclose(area.sum(axis=1), 6.7 * length, rtol=0.1)
    normals = np.array(band["observation"]["Mesh3D:vertex_normals"])
    np.testing.assert_allclose(np.linalg.norm(normals, axis=-1), 1, atol=1e-5)
    red = moving["/world/ribbons/1"]["observation"]["Mesh3D:vertex_positions"]
    assert np.isfinite(red).all() and (np.array(red)[2] == 0).all()
    assert [len(strip) for strip in moving["/world/ribbons/1/borders"]["observation"]["LineStrips3D:strips"][2]] == [0, 0]
    assert moving["/summary"]["observation"]["TextDocument:text"][1] == ["text 1"]
