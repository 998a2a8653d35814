"""Labelled marks to points, outliers and ribbons."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from doo_ti import Camera, Rig
from doo_ti.rod.frames import orthonormality_error, unit_vectors
from doo_ti.vision.marks import Marks, observe, read_labels, read_marks
from doo_ti.vision.triangulation import MarkStatus, TriangulationOptions, triangulate
from tests.conftest import check_refused
from tests.io.rods import twisted_frames, wavy_vertices
from tests.vision.boards import around

NOISE = 0.3
SURE = TriangulationOptions(sigma_px=NOISE)


def seen(rng, count: int, cameras: int = 3) -> tuple[Rig, np.ndarray, np.ndarray]:
    """A rig, (P, 3) points in front of it, and (C, P, 2) labels with noise."""
    rig, points = around(count=cameras), rng.uniform(-35, 35, (count, 3))
    return rig, points, rig.project(points) + rng.normal(0, NOISE, (cameras, count, 2))


def test_it_is_the_least_squares_point(rng):
    rig, _, pixels = seen(rng, 5)
    found = triangulate(rig, pixels, SURE)
    for point in range(5):
        def residual(x, labels=pixels[:, point]):
            return (rig.project(x) - labels).ravel()

        best = least_squares(residual, np.zeros(3), xtol=1e-14, ftol=1e-14, gtol=1e-14)
        np.testing.assert_allclose(found.position[point], best.x, atol=1e-6)
        np.testing.assert_allclose(found.covariance[point], NOISE**2 * np.linalg.inv(best.jac.T @ best.jac), rtol=1e-4)


def test_a_point_does_not_depend_on_the_others(rng):
    rig, _, pixels = seen(rng, 50)
    pixels[1, 7] += [25, -10]
    together = triangulate(rig, pixels, SURE)
    for order in (rng.permutation(50), [7]):
        found = triangulate(rig, pixels[:, order], SURE)
        np.testing.assert_allclose(found.position, together.position[order], atol=1e-9)
        np.testing.assert_array_equal(found.status, together.status[order])


@pytest.mark.sampled(1)
@pytest.mark.parametrize("cameras", [3, 4])
def test_outliers_are_found_and_left_out(rng, cameras):
    rig, points, pixels = seen(rng, 1000, cameras)
    wrong, camera = rng.choice(1000, 100, replace=False), rng.integers(0, cameras, 100)
    pixels[camera, wrong] += rng.uniform(6, 40, 100)[:, None] * unit_vectors(rng.normal(size=(100, 2)))
    found = triangulate(rig, pixels, SURE)
    status = found.status[wrong]
    assert (np.delete(found.status, wrong) == MarkStatus.TRIANGULATED).all()
    named = status == MarkStatus.OUTLIER_LEFT_OUT
    assert np.mean(named) > (0.8 if cameras == 3 else 0.95)
    assert (status[~named] == MarkStatus.CONTRADICTORY).all()  # along the other cameras' epipolar lines: undecidable
    assert not found.used[camera[named], wrong[named]].any()
    assert (found.used[:, wrong[named]].sum(axis=0) == cameras - 1).all()
    error = (found.position - points)[wrong[named]]  # squared, over the covariance: χ² of three degrees of freedom
    assert np.einsum("pi,pij,pj->p", error, np.linalg.inv(found.covariance[wrong[named]]), error).max() < 25
    assert (found.residual[camera[named], wrong[named]] > 4).all()
    assert np.isnan(found.position[wrong[~named]]).all() and np.isnan(found.covariance[wrong[~named]]).all()


@pytest.mark.parametrize("cameras", [2, 3, 4])
@pytest.mark.parametrize("stated", [0.1, 1.0])
def test_noise_is_learned_whatever_is_stated(rng, cameras, stated):
    """Squared errors over the sigmas average 1, with a fifteenth of the labels anywhere."""
    rig, points, pixels = seen(rng, 300, cameras)
    wrong = rng.random((cameras, 300)) < 1 / 15
    pixels[wrong] += rng.uniform(20, 60, (wrong.sum(), 1)) * unit_vectors(rng.normal(size=(wrong.sum(), 2)))
    found = triangulate(rig, pixels, TriangulationOptions(stated))
    good = found.valid & ~(found.used & wrong).any(axis=0)
    assert good.mean() > 0.8 and found.sigma_px == found.label_sigma == pytest.approx(NOISE, rel=0.12)
    error = (found.position - points)[good]
    square = np.einsum("pi,pij,pj->p", error, np.linalg.inv(found.covariance[good]), error) / 3
    assert square.mean() == pytest.approx(1, abs=0.2)
    few = triangulate(rig, pixels[:, :9], TriangulationOptions(stated))
    assert np.isnan(few.label_sigma) and few.sigma_px == stated


def test_few_views_and_rays_that_are_parallel_or_diverge(rng):
    rig, points, pixels = seen(rng, 4)
    pixels[1:, 0] = pixels[:, 1] = np.nan
    found = triangulate(rig, pixels, SURE)
    assert found.status.tolist() == [MarkStatus.FEW_VIEWS] * 2 + [MarkStatus.TRIANGULATED] * 2
    assert found.valid.tolist() == [False, False, True, True] and not found.used[:, :2].any()
    here = rig.cameras[0]
    beside = replace(here, name="beside", translation=here.translation + [0.5, 0, 0])
    copies = [replace(camera, name=name) for camera, name in ((here, "c"), (beside, "d"), (here, "e"))]
    for close in (Rig((here, beside)), Rig((here, beside, *copies))):
        assert (triangulate(close, close.project(points), SURE).status == MarkStatus.DEGENERATE).all()
    matrix = [[500.0, 0, 320], [0, 500.0, 240], [0, 0, 1]]
    ahead = Rig(tuple(Camera(name, 640, 480, matrix, np.zeros(5), np.eye(3), [x, 0, 0]) for name, x in (("a", 20), ("b", -20))))
    behind = triangulate(ahead, np.array([[[200.0, 240]], [[440.0, 240]]]), SURE)
    assert behind.status.tolist() == [MarkStatus.DEGENERATE], "rays that diverge meet behind both cameras"


def test_wrong_arguments():
    for rig, cameras, word in ((Rig(around().cameras[:1]), 1, "two or more"), (around(), 2, "shape")):
        check_refused(word, triangulate, rig, np.zeros((cameras, 4, 2)))
    for wrong in ({"sigma_px": 0.0}, {"threshold": -1.0}, {"sigma_px": np.nan}):
        check_refused(": ", TriangulationOptions, **wrong)


def ribbon(rng) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(D, V, 3) centre lines near the origin, (D, E, 3, 3) frames, and (D, V, 2, 3) marks on both edges, 6.7 mm apart."""
    vertices = wavy_vertices(rng, count=4, marks=12)
    vertices = vertices - vertices.mean(axis=1, keepdims=True)
    frames = twisted_frames(vertices, np.array([0.3, -1.5, 2.0, 0.0]), rng)
    of_edges = np.pad(frames[..., 1], ((0, 0), (1, 1), (0, 0)), "edge")
    director = unit_vectors(of_edges[:, :-1] + of_edges[:, 1:])
    return vertices, frames, vertices[:, :, None] + np.array([[-3.35], [3.35]]) * director[:, :, None]


def marked(edges: np.ndarray, rng, noise: float = 0.0) -> Marks:
    exact = around().project(edges)
    return Marks(tuple(f"pose {d}" for d in range(len(edges))), exact + rng.normal(0, noise, exact.shape), "marks.csv")


def observed(marks: Marks, **labels):
    return observe(marks, triangulate(around(), marks.pixels.reshape(3, -1, 2), SURE), **labels)


def test_ribbons_get_their_frames(rng):
    vertices, frames, edges = ribbon(rng)
    found, filled = observed(marked(edges, rng), up=(0, 1, 0), end_distance=np.arange(4.0))
    np.testing.assert_allclose(found.vertices, vertices, atol=1e-8)
    np.testing.assert_allclose(found.frames[..., 0], frames[..., 0], atol=1e-7)
    # m1 points from left to right. The widths at both ends of an edge turn about it; their mean is its own director.
    assert np.sum(found.frames[:, 1:-1, :, 1] * frames[:, 1:-1, :, 1], axis=-1).min() > np.cos(np.radians(4))
    assert orthonormality_error(found.frames).max() < 1e-12 and (np.linalg.det(found.frames) > 0).all()
    np.testing.assert_array_equal(found.start_frame, found.frames[:, 0])
    np.testing.assert_array_equal(found.end_frame, found.frames[:, -1])
    assert not filled.any() and found.up.tolist() == [0, 1, 0] and found.end_distance.tolist() == [0, 1, 2, 3]


def test_a_ribbon_s_uncertainty_matches_the_errors(rng):
    scores = []
    for _ in range(10):
        vertices, _, edges = ribbon(rng)
        found, _ = observed(marked(edges, rng, NOISE))
        scores.append(np.mean((found.vertices - vertices) ** 2, axis=-1) / found.sigma**2)
    assert np.mean(scores) == pytest.approx(1, rel=0.12)


def test_missing_edge_marks(rng):
    _, frames, edges = ribbon(rng)
    marks = marked(edges, rng)
    marks.pixels[:, 1, 5, 0] = np.nan  # the left mark of an inner vertex, in all images
    marks.pixels[1:, 2, 0, 1] = np.nan  # the right mark of the first, in all but one
    found, filled = observed(marks)
    assert not found.valid[1, 5] and not found.valid[2, 0] and found.valid.sum() == found.valid.size - 2
    assert np.argwhere(filled).tolist() == [[1, 4], [1, 5], [2, 0]]
    assert found.start_frame is None and np.shape(found.end_frame) == (4, 3, 3)
    assert orthonormality_error(found.frames).max() < 1e-12
    assert np.sum(found.frames[1, 4:6, :, 1] * frames[1, 4:6, :, 1], axis=-1).min() > np.cos(np.radians(25))
    marks.pixels[:, 2, 1:] = np.nan
    check_refused("pose 2", observed, marks)  # an observation without two vertices


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


MARKS = {
    "unknown camera": (changed(3, 1, "cam9"), "camera: 'cam9' in line 5 .* cam0, cam1, cam2"),
    "not a number": (changed(2, 3, "left"), "u_px: 'left' in line 4"),
    "outside": (changed(5, 3, 1200), "u_px: '1200' in line 7 .* cam1, 640 x 480"),
    "above": (changed(5, 4, -3), "v_px: '-3' in line 7"),
    "twice": ([*good_rows(), good_rows()[1]], "mark: '1' in line 14 is there twice .* cam0"),
    "no mark": (changed(0, 2, "x"), "mark: 'x' in line 2"),
    "negative mark": (changed(0, 2, -1), "mark: '-1' in line 2"),
    "plain beside edges": (changed(0, 2, "0L"), "mark: '1' in line 3"),
    "a gap": ([row for row in good_rows() if row[2] != 2], "mark: 2 is missing"),
    "one edge only": ([(*row[:2], f"{row[2]}L", *row[3:]) for row in good_rows()], "mark: 0R is missing"),
    "too few": ([row for row in good_rows() if row[2] < 2], "2 marks"),
    "no name": (changed(4, 0, ""), "observation: '' in line 6"),
    "no rows": ([], "holds no rows"), "no column v_px": ([row[:4] for row in good_rows()], "v_px: ")}


@pytest.mark.parametrize("case", MARKS)
def test_wrong_marks(tmp_path, case):
    rows, message = MARKS[case]
    path = written(tmp_path, rows, HEADER.replace(",v_px", "") if case == "no column v_px" else HEADER)
    check_refused(message, read_marks, path, around())


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
