"""Keys that scenes of several kinds share: materials in physical units, and quantities at some moments."""

import numpy as np
import pytest

from doo_ti.dynamics.scene import load_motion_scene
from doo_ti.groups.scene import load_group_scene
from doo_ti.io.toml_file import NotNegative, Table, Vector, between_moments
from doo_ti.rod.material import STANDARD_GRAVITY
from doo_ti.system.errors import InputError

EI, GJ, DENSITY = 2e-5, 1.5e-5, 4.0
WEIGHT = 1e-3 * DENSITY * STANDARD_GRAVITY
"""N/m."""
SCENES = {
    load_motion_scene: "rod = { length_mm = 60.0, edges = 20 }\nrate_hz = 10.0\nduration_s = 1.0\n",
    load_group_scene: "".join(f'rods.{name} = {{ material = "{name}", edges = 10, length_mm = 90.0 }}\n' for name in "ab"),
}


def loaded(folder, load, *materials: str):
    """The scene with these tables of the materials a, b, …"""
    text = SCENES[load] + "".join(f"[materials.{name}]\n{one}\n" for name, one in zip("ab", materials, strict=False))
    (folder / "scene.toml").write_text(text)
    return load(folder / "scene.toml")


def test_stiffness_in_newton(tmp_path):
    scene = loaded(tmp_path, load_motion_scene, f"EI = {EI}\nGJ = {GJ}\nlinear_density = {DENSITY}",
                   f"bend = 3e5\ntwist = 2e5\nweight = 2.0\nlinear_density = {2 * DENSITY}")
    np.testing.assert_allclose(np.squeeze(scene.material.bend[0]) / 2e9 * WEIGHT, EI * np.eye(2))
    np.testing.assert_allclose(scene.material.twist[:, 0], [2e9 * GJ / WEIGHT, 2e5])
    assert scene.material.weight.tolist() == [1.0, 2.0]
    # A rod lying on the ground is held by twice its weight for each mm of it, in the units of the package, or its weight in N.
    np.testing.assert_allclose(scene.newtons * 2 * scene.material.weight * 60, 60e-3 * WEIGHT * np.array([1.0, 2.0]))
    scene = loaded(tmp_path, load_motion_scene, "bend = 3e5\ntwist = 2e5", f"EI = {EI}\nGJ = {GJ}\nlinear_density = 3")
    assert scene.newtons is None


def test_rods_of_a_group_share_one_unit(tmp_path):
    """Stiffness over the unit of weight per length, that of the first material, and weights in proportion."""
    scene = loaded(tmp_path, load_group_scene, f"EI = {EI}\nlinear_density = {DENSITY}",
                   f"EI = [[{EI}, 0], [0, {2 * EI}]]\nGJ = {GJ}\nlinear_density = {3 * DENSITY}")
    first, second = scene.group.materials
    np.testing.assert_allclose(second.bend[0], first.bend[0] * np.diag([1.0, 2.0]))
    np.testing.assert_allclose([first.twist.item(), second.twist.item()], 2e9 * np.array([EI, GJ]) / WEIGHT)
    assert [one.weight.item() for one in scene.group.materials] == [1.0, 3.0] and np.isclose(scene.newton, 5e-4 * WEIGHT)
    relative = loaded(tmp_path, load_group_scene, f"bend = 1e5\nlinear_density = {DENSITY}",
                      f"bend = 1e5\nweight = 3.0\nlinear_density = {3 * DENSITY}")
    assert np.isclose(relative.newton, 5e-4 * WEIGHT)


@pytest.mark.parametrize("load, tables, said", [
    (load_motion_scene, ["EI = 1e-5"], "materials.a.linear_density: missing"),
    (load_motion_scene, ["EI = 1e-5\nbend = 1e5\nlinear_density = 3"], "materials.a.bend: given beside EI"),
    (load_motion_scene, ["EI = 1e-5\nweight = 1\nlinear_density = 3"], "materials.a.weight: given beside EI"),
    (load_motion_scene, ["bend = 1e5\nGJ = 1e-5\nlinear_density = 3"], "materials.a.GJ: given beside bend"),
    (load_motion_scene, ["linear_density = 3"], "materials.a.bend: missing"),
    (load_motion_scene, ["EI = -1e-5\nlinear_density = 3"], "materials.a.EI"),
    (load_motion_scene, ["bend = [[1e5, 0], [0, 1e5]]\ntwist = 1e5"], "materials.a.bend: a matrix"),
    (load_group_scene, ["EI = 1e-5\nlinear_density = 3", "bend = 1e5"], "materials.b: in other units"),
    (load_group_scene, ["bend = 1e5\nlinear_density = 3", "bend = 1e5\nlinear_density = 4"], "not proportional"),
    (load_group_scene, ["EI = [[1e-5, 0], [0, 1e-5]]\nlinear_density = 3", "bend = 1e5"], "materials.b"),
])
def test_what_does_not_fit_is_named(tmp_path, load, tables, said):
    with pytest.raises(InputError, match=said):
        loaded(tmp_path, load, *tables)


class Moment(Table):
    time_s: NotNegative
    shift: Vector | None = None


@pytest.mark.parametrize(("moments", "first"), [
    ([], [0, 0, 0, 0, 0]), ([(0.0, 3.0)], [3, 3, 3, 3, 3]),
    ([(0.0, 1.0), (1.0, 2.0), (1.5, None)], [1, None, 2, 2, 2])])  # what is left out stays as it was
def test_quantities_between_moments(moments, first):
    rows = [{"time_s": time} | ({} if shift is None else {"shift": [shift, 0.0, 0.0]}) for time, shift in moments]
    found = between_moments("scene.toml", "moments", rows, Moment, {"shift": np.zeros(3)}, np.linspace(0.0, 2.0, 5))
    for value, expected in zip(found["shift"][:, 0], first, strict=True):
        assert 1.0 < value < 2.0 if expected is None else np.isclose(value, expected)
