"""From where rods in motion are shown, and the forces of contact on them."""

import numpy as np
import pytest

from doo_ti import Plane, Surroundings
from doo_ti.report import motions
from doo_ti.report.contact import Touched
from doo_ti.report.motions import MovingRods, _view, motions_picture, save_rollout


@pytest.mark.parametrize(("height", "view"), [(2.0, "from above"), (60.0, "from the side")])
@pytest.mark.parametrize("up", [(0.0, 0.0, 1.0), (0.0, 1.0, 0.0)])
def test_flat_rods_are_shown_from_above(tmp_path, monkeypatch, height, view, up):
    shown = []
    monkeypatch.setattr("doo_ti.report.motions.literal", lambda text: shown.append(text) or text)
    s = np.linspace(0, np.pi, 12)
    shifts = np.linspace(0, 20, 5)[None, :, None]
    across = 60 * np.sin(s) + shifts
    curve = np.stack([100 * np.cos(s) + 0 * shifts, across, height * np.sin(3 * s) + 0 * shifts], axis=-1)
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
    monkeypatch.setattr(motions, "save_figure", lambda figure, path: limits.append(figure.axes[0].get_ylim()))
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
