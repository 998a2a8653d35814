"""Evidence from both sides: threads traced in images of cameras close together, which growth alone does not recover."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial import cKDTree

import doo_ti as d
from doo_ti.perception.matching import Match, best_matches, curve_of, likely_matches
from doo_ti.perception.posterior import detected_places, line_trees, lines_at, vertex_sigma
from doo_ti.perception.seeds import Seed, fit_better, seed_from_pixels, whole_threads
from doo_ti.perception.traced import SMOOTHNESS
from doo_ti.rod.frames import arc_lengths, curve_length, normal_to, placed, unit_vectors
from doo_ti.vision.distance_map import coverage, misread
from doo_ti.vision.images import load_sets, read_image
from doo_ti.vision.paths import ImagePath
from doo_ti.vision.triangulation import rays
from tests.vision.scenes import line_of
from tools.studies.angle_study import EDGES, LENGTH_MM, apart, cameras, curve, dense, detection

MATERIAL, UP = d.Material(6e5, 8e5), np.array([0.0, 0.0, 1.0])


def views(rig: d.Rig, points: np.ndarray, noise: float, rng: np.random.Generator) -> list[d.Detection]:
    return [detection(camera, points, noise, rng) for camera in rig.cameras]


def begun(rig: d.Rig, images: list[d.Detection], points: np.ndarray) -> Seed:
    """Where a rod begins by a click on the first of ``points`` in the first image."""
    return seed_from_pixels(rig, images, {0: rig.cameras[0].project(points[0])}, "test")


@pytest.fixture(scope="module")
def seen():
    """(rig of two cameras 10° apart, three curves, their detections)."""
    rng = np.random.default_rng(5)
    rig, curves = cameras(10.0, third=False), [curve(rng) for _ in range(3)]
    return rig, curves, [views(rig, points, 0.2, rng) for points in curves]


def recovered(seen, length: float = LENGTH_MM, evidence: str = "both"):
    rig, curves, detections = seen
    start, further = (np.array([points[row] for points in curves]) for row in (0, 60))
    return d.perceive(d.distance_maps(detections), rig, start, further - start, np.full(EDGES, length / EDGES), MATERIAL, up=UP,
                      options=d.PerceptionOptions(evidence=evidence))


def of_whole_thread(rig: d.Rig, images: list[d.Detection], points: np.ndarray):
    """(the thread that begins at a click on the first of ``points``, the rod of its length)."""
    start = begun(rig, images, points).point[None]
    thread = whole_threads(rig, [images], start, None, MATERIAL, UP)
    lengths = np.full(EDGES, thread.length[0] / EDGES)
    return thread, d.perceive(d.distance_maps([images]), rig, start, thread.direction, lengths, MATERIAL)


def errors(found, curves, share: float = 1.0) -> np.ndarray:
    """mm, of that share of the rods and of the curves that are in both."""
    rods = [dense(rod)[: int(500 * min(1.0, 1 / share))] for rod in found.vertices]
    parts = [points[: int(len(points) * min(1.0, share))] for points in curves]
    return np.array([apart(rod, points) for rod, points in zip(rods, parts, strict=True)])


def arch(height: float, turn: float = 0.0) -> np.ndarray:
    """(N, 3) mm: level, both ends on one epipolar line: a thread as far away as the rays of opposite ends meet looks alike."""
    s = np.linspace(-1, 1, 2001)
    return np.stack([40 * s, -height * (1 - s**2) * np.cos(turn * s), 8 * np.sin(1.5 * s + turn)], axis=1)


@pytest.mark.parametrize("count", [1, pytest.param(3, marks=pytest.mark.thorough)])
def test_cameras_close_together_see_the_whole_thread(seen, count):
    rig, curves, detections = seen
    some = rig, curves[:count], detections[:count]
    found, alone = recovered(some), recovered(some, evidence="rod")
    error = errors(found, some[1])
    assert (error < 0.6).all() and (found.coverage > 0.97).all()
    assert errors(alone, some[1]).max() > 3 * error.max(), "the paper's one-sided evidence lets rods turn away"
    assert np.isnan(alone.coverage).all() and np.isnan(alone.thread_length).all()
    assert (np.abs(found.thread_length / LENGTH_MM - 1) < 0.03).all()


@pytest.mark.parametrize("turns", [[1, 3], pytest.param(range(4), marks=pytest.mark.thorough)])
def test_where_a_thread_runs_along_its_epipolar_lines_the_rod_is_on_it(turns):
    """There a tenth of a pixel beside the line is a millimetre of depth. Arches, level at their tops."""
    rng, rig = np.random.default_rng(3), cameras(40.0, third=False)
    arches = [points * LENGTH_MM / curve_length(points) for points in (arch(25.0, turn) for turn in turns)]
    found = recovered((rig, arches, [views(rig, points, 0.05, rng) for points in arches]))
    off = [cKDTree(dense(points)).query(rod)[0][:-3].max() for points, rod in zip(arches, found.vertices, strict=True)]
    assert max(off) < 0.2 and (found.verdict == d.PerceptionVerdict.CLEAR).all()


def test_lines_at_places_of_a_bend_are_on_it():
    """The mean of points would lie inside of it, by 0.03 px here, and rods of a given length be folded."""
    out, ahead = (np.stack([np.cos(angle), np.sin(angle)], axis=1)
                  for angle in (np.arange(-1.5, 1.5, 1 / 60), np.linspace(-1, 1, 33)))
    bend = line_of(300 + 60 * out, normal_to(out), shape=(600, 600))
    points, _, found = lines_at(300 + 60.3 * ahead[None, None], normal_to(ahead)[None, None], line_trees([[bend]]))
    assert found.all() and np.abs(np.linalg.norm(points - 300, axis=-1) - 60).max() < 0.005


def test_depth_stays_in_bounds_where_images_say_nothing_of_it():
    """Where both images are the same, without disparity, the curve would be infinitely far away."""
    camera = cameras(10.0, third=False).cameras[0]
    same = d.Rig((camera, replace(camera, name="beside", translation=camera.translation + [6.0, 0, 0])))
    place = np.arange(0.0, 300.0)
    path = ImagePath(np.stack([500 + place, 400 + 0.5 * place], axis=1), np.ones(300, dtype=bool), 0.0, 1.0)
    start = camera.centre + 300.0 * rays(camera, path.points[:1])[0]
    found, _, _ = curve_of(same, Match((path, path), np.tile(np.arange(0.0, 299.0, 2.0), (2, 1)), 0.0), start, 100.0, 0.0)
    assert camera.depth(found).max() <= 4.001 * camera.depth(start)


@pytest.mark.thorough
def test_a_rod_that_leaves_a_piece_of_the_thread_out_is_not_clear(seen):
    """It may be a short cut, as where strands cross."""
    rig, curves, detections = seen
    images = [[with_more(detections[0][0], detections[0][0].points[200], [0.6, 0.8], range(8, 38)), detections[0][1]]]
    found, whole = (recovered((rig, curves[:1], some)) for some in (images, detections[:1]))
    assert found.coverage.min() > 0.95 and errors(found, curves[:1])[0] < 0.6
    assert (found.verdict[0], whole.verdict[0]) == (d.PerceptionVerdict.AMBIGUOUS, d.PerceptionVerdict.CLEAR)
    assert whole.skipped.max() < 1 and 15 < found.skipped[0, 0] * images[0][0].width_px < 40 and found.skipped[0, 1] == 0


def test_a_rod_along_something_wider_or_twice_along_a_line_is_noticed(seen):
    rig, curves, (images, *_) = seen
    rod = np.array(curves[0][::15])
    ends = replace(images[0], width=np.where(np.arange(images[0].count) < 60, 3.0, 1.0) * images[0].width_px)
    back = np.concatenate([rod, rod[:-12:-1] + [0.1, 0.0, 0.0]])
    found, folded = (misread(rig, shape[None], [[ends, images[1]]]) for shape in (rod, back))
    assert found["skipped"].max() < 1 and found["twice"].max() < 1 and found["wider"][0, 1] == 0
    assert 50 < found["wider"][0, 0] * images[0].width_px < 70 and (folded["twice"] > 10).all()


@pytest.mark.thorough
@pytest.mark.parametrize("share", [0.8, 1.15])
def test_a_rod_of_another_length_lies_where_the_thread_is(seen, share):
    found = recovered(seen, share * LENGTH_MM)
    assert (errors(found, seen[1], share) < 0.8).all() and (np.abs(found.thread_length / LENGTH_MM - 1) < 0.03).all()
    assert not (found.verdict == d.PerceptionVerdict.CLEAR).any()
    assert (np.abs(found.left_over - max(0.0, 1 - share) * LENGTH_MM) < 0.03 * LENGTH_MM).all()


def test_a_rod_a_little_longer_than_the_thread_says_so(rng):
    """Between cameras far apart none is traced. Its end is bridged, not folded where two of three cameras do not see it."""
    rig, curves = cameras(40.0, third=True), [curve(np.random.default_rng(seed)) for seed in (1, 2)]
    found = recovered((rig, curves, [views(rig, points, 0.1, rng) for points in curves]), 1.05 * LENGTH_MM)
    assert (np.abs(found.thread_length / LENGTH_MM - 1) < 0.01).all() and not (found.verdict == d.PerceptionVerdict.CLEAR).any()
    for rod, sigma, points in zip(found.vertices, found.sigma, curves, strict=True):
        off = cKDTree(points).query(rod)[0]
        assert (off < 3 * sigma)[-7:].all() and off[:-2].max() < 0.3 and off[-1] < 0.06 * LENGTH_MM


def test_where_a_line_leaves_the_rod_no_camera_counts(seen):
    """The end of a rod that folds along the line of sight is still on the line of that camera."""
    rig, curves, detections = seen
    rod, camera = curves[0][::15].copy(), rig.cameras[0]
    on_it = detected_places(rig, rod[None], 1, detections[:1])[0].reshape(2, -1)
    rod[-12:] = camera.centre + (rod[-12:] - camera.centre) * np.linspace(1.0, 1.3, 12)[:, None]
    folded = detected_places(rig, rod[None], 1, detections[:1])[0].reshape(2, -1)
    assert (folded[:, :-30] == on_it[:, :-30]).all() and (on_it[:, 10:-10] == 1).all() and (folded[:, -12:] == 0).all()


@pytest.mark.thorough
def test_a_rod_does_not_bulge_where_one_mask_lacks_a_piece():
    """One a hundredth too long goes on beyond the end, and is where one camera alone sees it as one of the right length is,
    by half of its σ. Drawn by OpenCV."""
    rig, s = cameras(35.0, third=False), np.linspace(-1, 1, 2001)
    points, images = np.stack([35 * s, 10 * np.sin(1.5 * s + 1), -1.2 * np.sqrt(400 + 900 * s**2)], axis=1), []
    points -= points.mean(axis=0)
    for camera, hidden in zip(rig.cameras, (0, 40)):
        pixels, mask = camera.project(points), np.zeros((camera.height, camera.width), dtype=np.uint8)
        cv2.polylines(mask, [np.rint(16 * pixels).astype(np.int32)], False, 255, 5, cv2.LINE_AA, 4)
        for pixel in pixels[800 : 800 + 10 * hidden : 10]:
            cv2.circle(mask, np.rint(pixel).astype(int).tolist(), 10, 0, -1)
        images.append(d.detect_mask(np.where(mask > 127, 255, 0)))
    right, long = (recovered((rig, [points], [images]), factor * curve_length(points)) for factor in (1.0, 1.01))
    off, more = (cKDTree(points).query(found.vertices[0, :-2])[0] for found in (right, long))
    assert np.abs(more - off).max() < 0.15 and (np.maximum(off, more) < 2 * np.sqrt(3) * right.sigma[0, :-2] + 0.05).all()


def test_a_thread_begins_near_where_it_did_a_moment_before(rng):
    rig, points = cameras(30.0, third=False), arch(10.0)
    first, second = rig.cameras
    rays = np.stack([points[0] - first.centre, second.centre - points[-1]], axis=1)
    along = np.linalg.lstsq(rays, second.centre - first.centre, rcond=None)[0][0] * rays[:, 0]
    images, click = views(rig, points, 0.2, rng), {0: first.project(points[0])}
    again = seed_from_pixels(rig, images, click, "test", first.centre + along)
    assert np.linalg.norm(again.point - first.centre - along) < 0.02 * np.linalg.norm(along)
    assert np.linalg.norm(seed_from_pixels(rig, images, click, "test", points[0]).point - points[0]) < 1.0


def rising(turn: float) -> np.ndarray:
    """(N, 3) mm: it begins along the epipolar lines, where the curve does not say how far away it is."""
    t = np.linspace(0, 1, 2001)
    return np.stack([70 * t - 35, 30 * t**3 - 10, 15 * np.sin(4 * t + turn)], axis=1)


@pytest.mark.parametrize(("angle", "points", "most"), [
    (10.0, arch(10.0), 10.0), (15.0, arch(25.0), 10.0), (30.0, arch(10.0), 10.0), (10.0, rising(0.0), 1.5),
    (20.0, rising(0.0), 1.5), (30.0, rising(1.0), 1.5), (10.0, rising(2.0), 1.5)])
def test_a_thread_begins_where_the_rays_of_its_ends_meet(angle, points, most, rng):
    rig = cameras(angle, third=False)
    seed = begun(rig, views(rig, points, 0.3, rng), points)
    sigma = np.sqrt(np.trace(seed.covariance) / 3)
    assert np.linalg.norm(seed.point - points[0]) < min(1.5, 3 * sigma) and sigma < most


def with_more(found, start: np.ndarray, way, places: range):
    """A detection with points of something else, at so many px from ``start`` (2,) along the unit vector ``way``."""
    return found.with_parts([line_of(start + np.outer(places, way), np.asarray(way), found.width_px)])


def test_a_loop_is_passed_the_same_way_in_all_images():
    """Of a round loop before parallel cameras, passed the other way round in one image, all points fit together."""
    lens = np.array([[1000.0, 0, 500], [0, 1000, 500], [0, 0, 1]])
    rig = d.Rig(tuple(d.Camera(name, 1000, 1000, lens, np.zeros(5), np.eye(3), [-shift, 0, 0])
                    for name, shift in (("a", 0), ("b", 5))))
    turn, t = np.linspace(0, 2 * np.pi, 400), np.linspace(0, 1, 300)
    loop = np.stack([8 * np.sin(turn), 8 * np.cos(turn), 0 * turn + 100], axis=1)
    before, after = (np.stack([sign * 30 * share, 8 - 10 * share, 0 * t + 100], axis=1)
                     for sign, share in ((-1, 1 - t), (1, t)))

    def path(camera, middle):
        points = camera.project(np.concatenate([before, middle, after]))
        arc = arc_lengths(points)
        points = placed(np.arange(arc[-1]), arc, points)
        return ImagePath(points, np.ones(len(points), dtype=bool), 0.0, 1.0)

    first, second = rig.cameras
    paths = [[path(first, loop)], [path(second, loop[::-1]), path(second, loop)]]
    assert abs(np.diff([match.cost for match in best_matches(rig, paths, 2)])[0]) < 0.01
    assert likely_matches(rig, paths, before[0], SMOOTHNESS[0], 1)[0].paths[1] is paths[1][1]


def test_a_rig_whose_poses_mean_something_else_fits_worse(rng):
    """Poses from cameras to the world that are read as those from the world to cameras."""
    rig, points = cameras(40.0, third=False), curve(np.random.default_rng(7))
    images = views(rig, points, 0.2, rng)
    misread = d.Rig(tuple(replace(view, rotation=view.rotation.T, translation=view.centre) for view in rig.cameras))
    click = {0: rig.cameras[0].project(points[0])}
    assert fit_better(misread, {"right": rig, "same": misread}, images, click) == ["right"]
    assert fit_better(rig, {"misread": misread}, images, click) == []


def test_an_end_of_something_else_is_not_where_the_rod_begins(rng):
    """In one image the thread seems to go on, and its end is not free; in another one, an end of something is far from the
    rays of the others, but on the epipolar line of the click."""
    rig, t = cameras(25.0, third=True), np.linspace(0, 1, 2001)
    points = np.stack([60 * t - 30, 25 * np.sin(3 * t), 15 * np.sin(4 * t)], axis=1)
    images = views(rig, points, 0.1, rng)
    start, on = rig.cameras[1].project(np.stack([points[0], points[0] - 8 * (points[5] - points[0])]))
    way = unit_vectors(on - start)
    images[1] = with_more(images[1], start, way, range(1, 80))
    centre = rig.cameras[0].centre
    images[2] = with_more(images[2], rig.cameras[2].project(centre + 1.5 * (points[0] - centre)), [0.6, 0.8], range(40))
    for count in (2, 3):
        seed = begun(d.Rig(rig.cameras[:count]), images[:count], points)
        assert np.linalg.norm(seed.point - points[0]) < 3 * np.sqrt(np.trace(seed.covariance) / 3) < 4.0


@pytest.mark.thorough
def test_a_camera_from_which_a_part_is_hidden_does_not_cost_it(rng):
    rig, points = cameras(40.0, third=True), curve(np.random.default_rng(7))
    images = views(rig, points, 0.1, rng)
    images[2] = images[2].take(np.arange(int(0.7 * images[2].count)))
    thread, found = of_whole_thread(rig, images, points)
    assert abs(thread.length[0] / LENGTH_MM - 1) < 0.02
    assert errors(found, [points])[0] < 0.3 and found.verdict[0] == d.PerceptionVerdict.CLEAR
    assert 0.2 < found.hidden[0, 2] < 0.4 and (found.hidden[0, :2] == 0).all()


@pytest.mark.thorough
def test_where_a_rod_is_clear_the_range_of_its_length_holds_the_thread_s(rng):
    """A rod that is a hundredth too long folds in depth by more than its σ."""
    rig, clear = cameras(30.0, third=False), 0
    for _ in range(5):
        points = curve(rng)
        whole, found = of_whole_thread(rig, views(rig, points, 0.1, rng), points)
        if replace(found, length_range=whole.range).verdict[0] == d.PerceptionVerdict.CLEAR:
            clear += 1
            assert whole.range[0, 0] <= LENGTH_MM <= whole.range[0, 1] < 1.06 * LENGTH_MM
            assert abs(whole.length[0] / LENGTH_MM - 1) < 0.03 and errors(found, [points])[0] < 0.3
    assert clear >= 4


def test_coverage_is_the_share_of_points_near_the_rod(seen):
    rig, curves, detections = seen
    found = coverage(rig, np.array([points[:: 20][: 51] for points in curves]), np.arange(3), detections, 40.0)
    for row, images in enumerate(detections):
        for c, camera in enumerate(rig.cameras):
            off = cKDTree(camera.project(curves[row][:1001:5])).query(images[c].points)[0]
            assert found.share[row, c] == pytest.approx((off <= 3.0).mean(), abs=0.03)
    assert (found.line > 50).all() and (found.error > 0).all()


@pytest.mark.thorough
@pytest.mark.parametrize("group", [1, 6, *(pytest.param(number, marks=pytest.mark.slow) for number in (2, 3, 5, 7, 8, 9, 10))])
def test_stereo_pairs_that_others_rendered(shared_data, group):
    """Baselines of 1 and 5 mm at a distance of a decimetre; curves that no rod made."""
    folder = shared_data / "suture_stereo" / "rendered"
    truth, sets = np.load(folder / "truth.npz"), load_sets(folder / f"sets{group}.csv", d.load_rig(folder / f"rig{group}.yaml"))
    curves = [truth[f"curve_mm_{name}"] for name in sets.names]
    detections = [[d.detect(read_image(*image)) for image in zip(paths, sets.rig.cameras)] for paths in sets.paths]
    lengths = np.full(33, curve_length(curves[0]) / 33)
    found = d.perceive(d.distance_maps(detections), sets.rig, sets.point, sets.direction, lengths, MATERIAL)
    error = errors(found, curves)
    assert (error < 3.0).all() and np.median(error) < 1.5 and not ((found.verdict == 0) & (error > 2.0)).any()


@pytest.mark.thorough
@pytest.mark.parametrize("noise", [0.1, 0.5])
def test_sigma_is_as_large_as_the_errors(noise):
    """Of two cameras 10° apart, whose detected lines are off by more than is assumed."""
    rng = np.random.default_rng(5)
    rig, curves = cameras(10.0, third=False), [curve(rng) for _ in range(6)]
    found = recovered((rig, curves, [views(rig, points, noise, rng) for points in curves]))
    error = np.array([cKDTree(points).query(rod)[0][2:] for rod, points in zip(found.vertices, curves, strict=True)])
    assert 0.5 < np.sqrt(np.mean((error**2).mean(axis=1) / (3 * found.sigma[:, 2:] ** 2).mean(axis=1))) < 2


def test_where_nothing_was_detected_sigma_is_large(rng):
    """A third of the thread is hidden from both cameras: a rod that is there is known by its stiffness alone."""
    rig, points = cameras(40.0, third=False), curve(np.random.default_rng(7))
    images = views(rig, points, 0.1, rng)
    gap = [found.take(np.abs(np.linspace(-1, 1, found.count)) > 0.3) for found in images]
    marks = points[:: 50]
    whole, hidden = (vertex_sigma(rig, marks[None, ::4], 0.1, 5.0, 0.0, detected_places(rig, marks[None], 4, [found])[0])[0]
                     for found in (images, gap))
    assert whole == pytest.approx(vertex_sigma(rig, marks[None, ::4], 0.1, 5.0)[0], rel=0.15)  # but for a width at either end
    assert hidden[5] > 1.8 * whole[5] and hidden[1:3] == pytest.approx(whole[1:3], rel=0.3)
