"""The landscape's picture, for every shape of grid; the grid view; from where rods in motion are shown, and forces on them."""

import io

import numpy as np
import pytest

from doo_ti import Observations, Observed, Plane, Surroundings
from doo_ti.report import canvas, motions
from doo_ti.report.contact import Touched
from doo_ti.report.figures import angle_curves_picture
from doo_ti.report.landscapes import LandscapePanel, draw_landscape, landscapes_picture
from doo_ti.report.motions import MovingRods, _view, motions_picture, save_rollout
from doo_ti.report.plane import LandscapePlane, cell_edges, valley_cells
from tests.record import runs

GREY = (154, 154, 154)


@pytest.mark.parametrize("vector, text", [((1, 0, 0), "x"), ((0, -1, 0), "−y"), ((0.94, 0.34, 0), "0.94 x + 0.34 y"),
                                          ((-0.6, 0, 0.8), "−0.6 x + 0.8 z"), ((0.8, -0.6, 0.001), "0.8 x − 0.6 y")])
def test_directions_as_text(vector, text):
    assert canvas.direction(np.array(vector, dtype=float)) == text


def run() -> tuple[list, np.ndarray]:
    grid = runs.grid()
    return grid.picture_axes, runs.landscape().reshape(grid.shape)


def test_titles_fit_into_the_picture():
    figure = canvas.new_figure((4.0, 3.0))
    left, right = figure.subplots(1, 2)
    figure.suptitle("a long title of a picture " * 4, fontsize=12)
    left.set_title("on the left " * 5, loc="left", fontsize=9)
    right.set_title("short", fontsize=9)
    canvas.fit_titles(figure)
    for title in (figure.texts[0], left._left_title, right.title):
        box = title.get_window_extent()
        assert box.x0 >= -1 and box.x1 <= figure.bbox.width + 1, title.get_text()[:9]
    assert right.title.get_fontsize() == 9


NAME, ANGLE = "a$^{$ b", np.arange(0.0, 360.0, 90.0)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("picture, given, options", [
    (landscapes_picture, ([[LandscapePanel(NAME, runs.plane(), ((NAME, (0, 0)),))]],), {}),
    (motions_picture, (MovingRods(np.arange(3.0), np.cumsum(np.ones((3, 1, 5, 3)), axis=2), [NAME], np.zeros((3, 1), int),
                                  np.ones((3, 1), bool)),), {}),
    (angle_curves_picture, (ANGLE, ANGLE[None]),
     {"phi": [0.0], "low": [0.0], "high": [9.0], "names": [NAME], "unsound": np.zeros((1, 4), bool)})])
def test_names_in_titles_legends_and_panels_are_no_mathematics(picture, given, options):
    """matplotlib parses text between dollar signs as mathematics, in which this is an error."""
    picture(io.BytesIO(), *given, title=NAME, **options)


@pytest.mark.thorough
def test_cells_not_evaluated_are_grey_and_unfinished_ones_hatched():
    axes, values = run()

    def image(values, unfinished=None):
        return canvas.pixels(draw_landscape(LandscapePlane.of(axes, values, (2, 1, 0), unfinished), "made up"))

    def grey(image):
        return (image == GREY).all(axis=-1).sum()
    plain = image(values)
    assert grey(plain) > 20_000 > 100 > grey(image(np.nan_to_num(values, nan=5.0)))
    counts = np.zeros(values.shape, int)
    counts[0, 0] = 3
    assert (image(values, counts) != plain).any()


@pytest.mark.sampled(1)
@pytest.mark.parametrize("shape", [(1, 1, 1), (7, 1, 1), (1, 1, 4), (3, 2, 2), (25, 30, 1), (3, 3, 3, 2)])
@pytest.mark.parametrize("empty", [False, True])
def test_every_shape_of_grid_is_drawn_with_its_key_inside_the_picture(shape, empty, rng):
    axes = [(name, np.geomspace(5e4, 1.26e7, count), name != "weight", "mm³")
            for name, count in zip(["bend_1", "bend_2", "twist", "weight"], shape, strict=False)]
    values = np.full(shape, np.nan) if empty else rng.uniform(0.5, 40, shape)
    minimum = None if empty else np.unravel_index(np.argmin(values), shape)
    unfinished = rng.integers(0, 60, shape)
    if not empty and values.size > 1:
        values.flat[(np.argmin(values) + 1) % values.size] = np.nan
    figure = draw_landscape(LandscapePlane.of(axes, values, minimum, unfinished), "made up")
    figure.canvas.draw()
    width, height = figure.canvas.get_width_height()
    for box in [key.get_window_extent() for key in figure.legends] + [figure.axes[0].title.get_window_extent()]:
        assert 0 <= box.x0 < box.x1 <= width and 0 <= box.y0 < box.y1 <= height


def test_more_than_two_free_axes_show_the_minimum_over_the_others(rng):
    counts = {"bend": 1, "a": 4, "b": 3, "c": 5, "d": 2}
    axes = [(name, np.arange(1.0, count + 1), False, "") for name, count in counts.items()]
    values = rng.uniform(1, 2, (1, 4, 3, 5, 2))
    minimum, unfinished = np.unravel_index(np.argmin(values), values.shape), rng.integers(0, 9, values.shape)
    plane = LandscapePlane.of(axes, values, minimum, unfinished)
    np.testing.assert_array_equal(plane.values, values[0].min(axis=(2, 3)))
    assert plane.minimum == minimum[1:3] and plane.hidden == ("c", "d")
    index = np.unravel_index(np.arange(values.size), values.shape)
    np.testing.assert_array_equal(plane.places(index), index[1:3])
    assert plane.best == tuple((axis[0], axis[1][k], "") for axis, k in zip(axes[1:], minimum[1:], strict=True))
    assert plane.unfinished[2, 1] == unfinished[0, 2, 1][np.unravel_index(np.argmin(values[0, 2, 1]), (5, 2))]


def test_valley_is_within_five_percent_leaves_nan_out_and_is_open_where_the_minimum_is_at_the_border():
    values = np.array([[1.0, 1.05, 1.0501], [np.nan, 2.0, 1.02]])
    np.testing.assert_array_equal(valley_cells(values, (0, 0)), [[True, True, False], [False, False, True]])
    assert not valley_cells(values, None).any()
    for line, minimum, at_border in (([3, 1, 2], 1, False), ([1, 2, 3], 0, True)):
        assert LandscapePlane.of([("bend", [1, 2, 4], True, "mm³")], line, (minimum,)).at_border == at_border


def test_cells_meet_halfway():
    np.testing.assert_allclose(cell_edges(("a", [1.0, 2.0, 4.0], False, "")), [0.5, 1.5, 3.0, 5.0])
    np.testing.assert_allclose(cell_edges(("a", [1.0, 100.0], True, "")), [0.1, 10.0, 1000.0])
    np.testing.assert_allclose(cell_edges(("a", [5.0], False, "")), [4.5, 5.5])


def test_surface_leaves_out_what_was_not_evaluated():
    axes, values = run()
    points, triangles = LandscapePlane.of(axes, values, (2, 1, 0)).surface()
    assert points.shape == (runs.BENDS, runs.RATIOS, 3)
    np.testing.assert_allclose(points[:, 0, 0], np.linspace(0, 1, runs.BENDS))
    corners = points[np.isfinite(points[..., 2])][triangles]
    area, cells = 0.5 * np.linalg.det(corners[:, 1:, :2] - corners[:, :1, :2]), (runs.BENDS - 1) * (runs.RATIOS - 1)
    np.testing.assert_allclose(area.sum(), 1 - 1 / cells)
    assert (area > 0).all()


def test_colors_are_the_picture_s_and_never_a_colour_for_nan():
    distance = np.array([0.4, 1.0, np.nan, 9.0])
    for colors in (canvas.landscape_colors(distance, distance), canvas.distance_colors(distance)):
        assert colors.shape == (4, 3) and colors.dtype == np.uint8 and tuple(colors[2]) == GREY
        assert len({tuple(color) for color in colors}) == 4
    assert canvas.distance_colors(np.full(3, np.nan)).tolist() == [list(GREY)] * 3


@pytest.mark.parametrize(("value", "text"), [
    (0, "0"), (0.7471, "0.747"), (14.07, "14.1"), (9999.9, "10⁴"), (123456, "1.23×10⁵"), (1e6, "10⁶"),
    (3.2e-5, "3.2×10⁻⁵"), (np.nan, "nan")])
def test_quantities_are_written_for_people(value, text):
    assert canvas.quantity(value) == text and canvas.quantity(value, "mm") == f"{text} mm"


def test_stiffness_stands_above_where_the_weight_is_known():
    plane = LandscapePlane.of([("bend", [1e5, 1e6, 1e7], True, "mm³")], [3.0, 1.0, 2.0], (1,))
    axes = draw_landscape(plane, "made up", newton_per_bend=2.45e-10).axes[0]
    (above,) = axes.child_axes
    assert above.get_xlabel() == "EI [N m²]"
    axes.figure.canvas.draw()
    assert np.allclose(np.array(axes.get_xlim()) * 2.45e-10, above.get_xlim())
    assert not draw_landscape(plane, "made up").axes[0].child_axes


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
    sheet = canvas.grid_view(Observed(vertices, labels))
    low, high = boxes(vertices, sheet)
    apart = ((low[:, None] > high[None]) | (low[None] > high[:, None]))[..., [0, 2]].any(axis=-1)
    assert (apart | np.eye(len(vertices), dtype=bool)).all() and (sheet.offset[0] == 0).all()
    corner = sheet.basis @ sheet.centre
    assert (low[:, [0, 2]] > corner[[0, 2]] - sheet.extent / 2).all()
    assert (high[:, [0, 2]] < corner[[0, 2]] + sheet.extent / 2).all()


def test_observations_are_called_what_their_file_calls_them(rng):
    vertices = runs.observations(rng)
    names = [f"trial {d}" for d in range(len(vertices))]
    seen = Observations(vertices, labels=names, end_distance=np.full(len(vertices), 30.0))
    assert Observed.of(seen).names[1] == "observation trial 1: 30 mm"


def test_labels_make_columns_and_rows(rng):
    vertices = runs.observations(rng)
    sheet = canvas.grid_view(Observed(vertices, LABELS))
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
    right, depth, above = canvas.grid_view(Observed(runs.observations(rng), {}, up)).basis
    np.testing.assert_allclose(above, np.array(up) / np.linalg.norm(up), atol=1e-12)
    basis = np.stack([right, depth, above])
    np.testing.assert_allclose(basis @ basis.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(basis) > 0
    if up == (0, 0, 1):
        assert right[0] > 0.99


@pytest.mark.sampled(2)
@pytest.mark.parametrize(("height", "view", "up"), [
    (2.0, "from above", (0.0, 1.0, 0.0)), (60.0, "from the side", (0.0, 0.0, 1.0)),
    (2.0, "from above", (0.0, 0.0, 1.0)), (60.0, "from the side", (0.0, 1.0, 0.0))])
def test_flat_rods_are_shown_from_above(tmp_path, monkeypatch, height, view, up):
    shown = []
    monkeypatch.setattr("doo_ti.report.canvas.literal", lambda text: shown.append(text) or text)
    s, shifts = np.linspace(0, np.pi, 12), np.linspace(0, 20, 5)[None, :, None]
    curve = np.stack([100 * np.cos(s) + 0 * shifts, 60 * np.sin(s) + shifts, height * np.sin(3 * s) + 0 * shifts], axis=-1)
    rods = curve if up[2] else curve[..., [0, 2, 1]]
    save_rollout(tmp_path / "f.png", "rods", ["a"], rods, None, 10.0, np.array(up))
    assert any(f"seen {view}" in text for text in shown)


def test_motion_across_the_rods_is_seen():
    """Rods along x that swing along y are seen at an angle; at rest, and if they swing along x, from the front."""
    s, t = np.linspace(0, np.pi, 30), np.linspace(0, 6, 40)[:, None]
    still = 0 * t * s
    shape = np.stack([100 * s + still, still, -50 * np.sin(s) + still], axis=-1)[None]
    swing = 60 * np.sin(t)[..., None] * np.sin(s)[None, :, None]
    for way, turned in (((0, 1, 0), True), ((1, 0, 0), False), ((0, 0, 0), False)):
        axes, _ = _view(shape + (swing * way)[None], np.array([0.0, 0, 1]))
        assert (abs(axes[0, 0]) < 0.9) == turned
        np.testing.assert_allclose(axes[1], [0, 0, 1])


def test_arrows_of_forces_are_in_newton_where_the_weight_is_known():
    positions = np.zeros((2, 1, 5, 3))
    positions[..., 0] = 25.0 * np.arange(5)
    force = np.zeros_like(positions)
    force[..., 2] = 40.0
    around = Surroundings([Plane((0, 0, 0), (0, 0, 1))], 1.0)
    plain, known = Touched(around, positions, force), Touched(around, positions, force, np.array([1e-3, 5e-4]))
    assert plain.legend.endswith("mm²/mm)") and known.legend.endswith(" N)")
    length = [np.linalg.norm(known.arrows(row, 0)[1], axis=-1) / known.arrow_scale for row in (0, 1)]
    np.testing.assert_allclose(length, np.array([[0.04], [0.02]]) * np.ones(5))
    shown = float(known.legend.split("10 mm: ")[1].split()[0])
    np.testing.assert_allclose(np.linalg.norm(known.arrows(0, 0)[1], axis=-1), 10 * 0.04 / shown)


def test_whole_arrows_are_in_pictures(tmp_path, monkeypatch):
    """Of a rod that hangs over an edge: the limits hold the tips, a fifth of the picture above it at most."""
    limits = []
    monkeypatch.setattr(motions.canvas, "save_figure", lambda figure, *rest: limits.append(figure.axes[0].get_ylim()))
    x = np.linspace(0, 100, 9)
    positions = np.tile(np.stack([x, 0 * x, -0.3 * np.abs(x - 50)], axis=-1), (1, 3, 1, 1))
    force = np.zeros_like(positions)
    force[0, :2, 4, 2], force[0, 2, 4, 2] = 1.0, 30.0
    touched = Touched(Surroundings([Plane((0, 0, 0), (0, 0, 1))], 1.0), positions, force)
    tip = np.linalg.norm(touched.arrows(0, 2)[1], axis=-1).max()
    assert 8 <= tip <= 20
    moving = MovingRods(np.arange(3.0), positions.swapaxes(0, 1), ["a"], np.zeros((3, 1), int), np.ones((3, 1), bool),
                        np.array([0.0, 0, 1]), touched=touched)
    motions_picture(tmp_path / "f.png", moving, title="flat")
    save_rollout(tmp_path / "g.png", "flat", ["a"], positions, None, 10.0, np.array([0.0, 0, 1]), touched=touched)
    assert min(high for _, high in limits) >= tip, (limits, tip)
