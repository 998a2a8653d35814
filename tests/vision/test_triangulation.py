"""Labelled marks to points, outliers and ribbons."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize

from doo_ti import Camera, Rig
from doo_ti.rod.frames import orthonormality_error
from doo_ti.vision.marks import Marks, observe, read_labels, read_marks
from doo_ti.vision.triangulation import MarkStatus, Points, TriangulationOptions, triangulate
from tests.conftest import check_refused
from tests.io.rods import twisted_frames, wavy_vertices
from tests.vision.boards import around

NOISE = 0.3
SURE = TriangulationOptions(sigma_px=NOISE)


def seen(rng, count: int, rig: Rig | None = None, noise: float = NOISE) -> tuple[Rig, np.ndarray, np.ndarray]:
    """A rig, (P, 3) points in front of it, and (C, P, 2) labels with noise."""
    rig = rig or around()
    points = rng.uniform(-35, 35, (count, 3))
    exact = rig.project(points)
    return rig, points, exact + rng.normal(0, noise, exact.shape)


def off(found: Points, points: np.ndarray, which=slice(None)) -> np.ndarray:
    """Squared errors in units of the covariance: χ² of three degrees of freedom."""
    error = (found.position - points)[which]
    return np.einsum("pi,pij,pj->p", error, np.linalg.inv(found.covariance[which]), error)


def test_it_is_the_least_squares_point(rng):
    rig, _, pixels = seen(rng, 5)
    found = triangulate(rig, pixels, SURE)
    for point in range(5):
        def residual(x, labels=pixels[:, point]):
            return (rig.project(x) - labels).ravel()
        best = scipy.optimize.least_squares(residual, np.zeros(3), xtol=1e-14, ftol=1e-14, gtol=1e-14)
        np.testing.assert_allclose(found.position[point], best.x, atol=1e-6)
        np.testing.assert_allclose(found.covariance[point], NOISE**2 * np.linalg.inv(best.jac.T @ best.jac), rtol=1e-4)


def test_a_point_does_not_depend_on_the_others(rng):
    rig, _, pixels = seen(rng, 50)
    pixels[1, 7] += [25, -10]
    together, order = triangulate(rig, pixels, SURE), rng.permutation(50)
    shuffled = triangulate(rig, pixels[:, order], SURE)
    np.testing.assert_allclose(shuffled.position, together.position[order], atol=1e-9)
    np.testing.assert_array_equal(shuffled.status, together.status[order])
    np.testing.assert_allclose(triangulate(rig, pixels[:, 7:8], SURE).position[0], together.position[7], atol=1e-9)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("cameras", [3, 4])
def test_outliers_are_found_and_left_out(rng, cameras):
    rig, points, pixels = seen(rng, 1000, around(count=cameras))
    wrong, camera = rng.choice(1000, 100, replace=False), rng.integers(0, cameras, 100)
    angle = rng.uniform(0, 2 * np.pi, 100)
    pixels[camera, wrong] += rng.uniform(6, 40, 100)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    found = triangulate(rig, pixels, SURE)
    status = found.status[wrong]
    assert (np.delete(found.status, wrong) == MarkStatus.TRIANGULATED).all()
    named = status == MarkStatus.OUTLIER_LEFT_OUT
    assert np.mean(named) > (0.8 if cameras == 3 else 0.95)
    assert (status[~named] == MarkStatus.CONTRADICTORY).all()  # along the other cameras' epipolar lines: undecidable
    assert not found.used[camera[named], wrong[named]].any() and (found.used[:, wrong[named]].sum(axis=0) == cameras - 1).all()
    assert off(found, points, wrong[named]).max() < 25 and (found.residual[camera[named], wrong[named]] > 4).all()
    assert np.isnan(found.position[wrong[~named]]).all() and np.isnan(found.covariance[wrong[~named]]).all()


def test_few_views_and_parallel_rays(rng):
    rig, points, pixels = seen(rng, 4)
    pixels[1:, 0] = np.nan
    pixels[:, 1] = np.nan
    found = triangulate(rig, pixels, SURE)
    assert found.status.tolist() == [MarkStatus.FEW_VIEWS] * 2 + [MarkStatus.TRIANGULATED] * 2
    assert found.valid.tolist() == [False, False, True, True] and not found.used[:, :2].any()
    here = rig.cameras[0]
    beside = replace(here, name="beside", translation=here.translation + [0.5, 0, 0])
    copies = [replace(camera, name=name) for camera, name in ((here, "c"), (beside, "d"), (here, "e"))]
    for close in (Rig((here, beside)), Rig((here, beside, *copies))):
        assert (triangulate(close, close.project(points), SURE).status == MarkStatus.DEGENERATE).all()


def test_a_point_behind_the_cameras_is_none():
    matrix = [[500.0, 0, 320], [0, 500.0, 240], [0, 0, 1]]
    rig = Rig(tuple(Camera(name, 640, 480, matrix, np.zeros(5), np.eye(3), [x, 0, 0])
                    for name, x in (("left", 20.0), ("right", -20.0))))
    assert triangulate(rig, np.array([[[200.0, 240]], [[440.0, 240]]]), SURE).status.tolist() == [MarkStatus.DEGENERATE]


def test_wrong_arguments():
    for rig, cameras, word in ((Rig(around().cameras[:1]), 1, "two or more"), (around(), 2, "shape")):
        check_refused(word, triangulate, rig, np.zeros((cameras, 4, 2)))
    for wrong in ({"sigma_px": 0.0}, {"threshold": -1.0}, {"sigma_px": np.nan}):
        check_refused(": ", TriangulationOptions, **wrong)


WIDTH = 6.7


def ribbon(rng) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(D, V, 3) centre lines near the origin, (D, E, 3, 3) frames, and (D, V, 2, 3) marks on both edges."""
    vertices = wavy_vertices(rng, count=4, marks=12)
    vertices = vertices - vertices.mean(axis=1, keepdims=True)
    frames = twisted_frames(vertices, np.array([0.3, -1.5, 2.0, 0.0]), rng)
    director = np.concatenate([frames[:, :1, :, 1], frames[:, :-1, :, 1] + frames[:, 1:, :, 1], frames[:, -1:, :, 1]], axis=1)
    director /= np.linalg.norm(director, axis=-1, keepdims=True)
    return vertices, frames, np.stack([vertices - WIDTH / 2 * director, vertices + WIDTH / 2 * director], axis=2)


def marked(rig: Rig, edges: np.ndarray, noise: float, rng) -> Marks:
    exact = rig.project(edges)
    return Marks(tuple(f"pose {d}" for d in range(len(edges))), exact + rng.normal(0, noise, exact.shape), "marks.csv")


def observed(rig: Rig, marks: Marks, **labels):
    return observe(marks, triangulate(rig, marks.pixels.reshape(len(rig.cameras), -1, 2), SURE), **labels)


def test_ribbons_get_their_frames(rng):
    vertices, frames, edges = ribbon(rng)
    rig = around()
    found, filled = observed(rig, marked(rig, edges, 0.0, rng), up=(0, 1, 0), end_distance=np.arange(4.0))
    np.testing.assert_allclose(found.vertices, vertices, atol=1e-8)
    np.testing.assert_allclose(found.frames[..., 0], frames[..., 0], atol=1e-7)
    # m1 points from left to right. The widths at both ends of an edge turn about it; their mean is its own director.
    inner = np.sum(found.frames[:, 1:-1, :, 1] * frames[:, 1:-1, :, 1], axis=-1)
    assert inner.min() > np.cos(np.radians(4))
    assert orthonormality_error(found.frames).max() < 1e-12 and (np.linalg.det(found.frames) > 0).all()
    np.testing.assert_array_equal(found.start_frame, found.frames[:, 0])
    np.testing.assert_array_equal(found.end_frame, found.frames[:, -1])
    assert not filled.any() and found.up.tolist() == [0, 1, 0] and found.end_distance.tolist() == [0, 1, 2, 3]


def test_a_ribbon_s_uncertainty_matches_the_errors(rng):
    rig, scores = around(), []
    for _ in range(10):
        vertices, _, edges = ribbon(rng)
        found, _ = observed(rig, marked(rig, edges, NOISE, rng))
        scores.append(np.mean((found.vertices - vertices) ** 2, axis=-1) / found.sigma**2)
    assert np.mean(scores) == pytest.approx(1, rel=0.12)


def test_missing_edge_marks(rng):
    vertices, frames, edges = ribbon(rng)
    rig = around()
    marks = marked(rig, edges, 0.0, rng)
    marks.pixels[:, 1, 5, 0] = np.nan  # the left mark of an inner vertex, in all images
    marks.pixels[1:, 2, 0, 1] = np.nan  # the right mark of the first, in all but one
    found, filled = observed(rig, marks)
    assert not found.valid[1, 5] and not found.valid[2, 0] and found.valid.sum() == found.valid.size - 2
    assert np.argwhere(filled).tolist() == [[1, 4], [1, 5], [2, 0]]
    assert found.start_frame is None and np.shape(found.end_frame) == (4, 3, 3)
    assert orthonormality_error(found.frames).max() < 1e-12
    assert np.sum(found.frames[1, 4:6, :, 1] * frames[1, 4:6, :, 1], axis=-1).min() > np.cos(np.radians(25))


def test_an_observation_without_two_vertices_is_named(rng):
    _, _, edges = ribbon(rng)
    marks = marked(around(), edges, 0.0, rng)
    marks.pixels[:, 2, 1:] = np.nan
    check_refused("pose 2", observed, around(), marks)


HEADER = "observation,camera,mark,u_px,v_px\n"


def written(folder, rows, header: str = HEADER):
    path = folder / "marks.csv"
    path.write_text(header + "".join(f"{','.join(map(str, row))}\n" for row in rows), encoding="utf-8")
    return path


def test_marks_come_back_in_their_order(tmp_path, rng):
    rig, pixels = around(), rng.uniform(0, 400, (3, 2, 4, 1, 2))
    pixels[1, 1, 2] = np.nan
    rows = [(f"take {'ba'[d]}", rig.names[c], v, *pixels[c, d, v, 0].tolist())
            for d in range(2) for c in range(3) for v in range(4) if np.isfinite(pixels[c, d, v, 0, 0])]
    marks = read_marks(written(tmp_path, rows[:12] + rows[:11:-1]), rig)
    assert marks.names == ("take b", "take a") and not marks.is_ribbon
    np.testing.assert_array_equal(marks.pixels, pixels)


def good_rows() -> list[tuple]:
    return [("a", camera, mark, 100 + 20 * mark, 200.5) for camera in ("cam0", "cam1", "cam2") for mark in range(4)]


def changed(row: int, place: int, value) -> list[tuple]:
    rows = [list(entry) for entry in good_rows()]
    rows[row][place] = value
    return rows


@pytest.mark.parametrize("rows, message", [
    (changed(3, 1, "cam9"), "camera: 'cam9' in line 5 .* cam0, cam1, cam2"),
    (changed(2, 3, "left"), "u_px: 'left' in line 4"), (changed(5, 3, 1200), "u_px: '1200' in line 7 .* cam1, 640 x 480"),
    (changed(5, 4, -3), "v_px: '-3' in line 7"), ([*good_rows(), good_rows()[1]], "'1' in line 14 is there twice .* cam0"),
    (changed(0, 2, "x"), "mark: 'x' in line 2"), (changed(0, 2, -1), "mark: '-1' in line 2"),
    (changed(0, 2, "0L"), "mark: '1' in line 3"), ([row for row in good_rows() if row[2] != 2], "mark: 2 is missing"),
    ([(*row[:2], f"{row[2]}L", *row[3:]) for row in good_rows()], "mark: 0R is missing"),
    ([row for row in good_rows() if row[2] < 2], "2 marks"), (changed(4, 0, ""), "observation: '' in line 6"),
    ([], "holds no rows"), ([row[:4] for row in good_rows()], "v_px: ")])
def test_wrong_marks(tmp_path, rows, message):
    header = HEADER.replace(",v_px", "") if message == "v_px: " else HEADER
    check_refused(message, read_marks, written(tmp_path, rows, header), around())


def test_labels(tmp_path):
    path = tmp_path / "labels.csv"
    path.write_text("observation,end_distance_mm,total_twist_deg\nb,54,-90\na,30,450\nc,1,1\n")
    labels = read_labels(path, ("a", "b"))
    assert {name: value.tolist() for name, value in labels.items()} == {"end_distance": [30, 54], "total_twist": [450, -90]}
    for text, names, message in (("observation,end_distance_mm\na,1\na,2\n", ("a",), "'a' in line 2 is there twice"),
                                 ("observation,end_distance_mm\na,1\n", ("a", "b"), "no row for 'b'"),
                                 ("observation,distance\na,1\n", ("a",), "no label"),
                                 ("observation,end_distance_mm\na,\n", ("a",), "'' in line 2")):
        path.write_text(text)
        check_refused(message, read_labels, path, names)
