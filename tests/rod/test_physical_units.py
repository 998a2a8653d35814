"""Physical units: stiffness in N m², forces in N, against a weighed cantilever and each other."""

import numpy as np
import pytest

from doo_ti import Clamp, Clamps, Configuration, InputError, Material, relax
from doo_ti.cli import main
from doo_ti.commands.options import grid
from doo_ti.rod.grid import parse_axis
from doo_ti.rod.physical_units import stiffness, weight_per_length

EI, GJ, DENSITY = 2e-6, 1.5e-6, 1.2  # N m², g/m: a suture
LENGTH, EDGES = 60.0, 40


def straight():
    """One straight rod along x, and clamps that hold its start."""
    frame = np.eye(3)[None]
    rod = Configuration(np.zeros((1, 3)), np.tile([1.0, 0, 0, 0], (1, EDGES, 1)), np.full(EDGES, LENGTH / EDGES))
    return rod, Clamps(Clamp.FRAME, Clamp.FREE, rod.start, rod.vertices[:, -1], frame, frame)


def test_a_cantilever_sags_as_beam_theory_says():
    weight = weight_per_length(DENSITY)
    rod, clamps = straight()
    stiff = 50 * EI  # sags little, where w L⁴/(8 EI) holds
    solution = relax(rod, Material.from_physical(stiff, stiff, weight), clamps)
    free = LENGTH - LENGTH / EDGES / 2  # the held edge clamps at its middle
    expected = weight * (free / 1e3) ** 4 / (8 * stiff) * 1e3
    assert -solution.configuration.vertices[0, -1, 2] == pytest.approx(expected, rel=0.01)


def test_a_held_end_carries_half_the_weight():
    weight = weight_per_length(DENSITY)
    rod, clamps = straight()
    end = rod.vertices[:, -1] - [3.0, 0, 0]
    held = Clamps(Clamp.POSITION, Clamp.POSITION, rod.start, end, clamps.start_frame, clamps.end_frame)
    solution = relax(rod, Material.from_physical(EI, GJ, weight), held)
    force = solution.end_force_in_newton(weight)[0]
    assert solution.converged.all()
    # Half of the whole weight, less that of the half edge which the clamp itself carries.
    assert force[2] == pytest.approx(0.5 * weight * LENGTH / 1e3, rel=0.02)


def test_there_and_back():
    material = Material.from_physical([EI, 2 * EI], GJ, weight_per_length(DENSITY))
    np.testing.assert_allclose(stiffness(material.bend[:, 0, 0, 0] / 2, DENSITY), [EI, 2 * EI])
    np.testing.assert_allclose(stiffness(material.twist[0, 0] / 2, DENSITY), GJ)


def test_a_rod_without_weight_has_no_relative_stiffness():
    with pytest.raises(InputError, match="weight_per_length"):
        Material.from_physical(EI, GJ, 0.0)


def options(**given):
    """What the parser makes of a material's options."""
    from argparse import ArgumentParser

    from doo_ti.commands.options import add_material

    parser = ArgumentParser()
    add_material(parser, "")
    return parser.parse_args([part for name, value in given.items() for part in (f"--{name.replace('_', '-')}", value)])


def test_ranges_in_newton_square_metres_are_axes_of_bend_and_twist():
    found = grid(options(EI="1e-6:1e-5:4", GJ="1.5e-6", linear_density="1.2"))
    factor = 2e9 / weight_per_length(1.2)
    axes = {axis.name: axis.values for axis in found.axes}
    np.testing.assert_allclose(axes["bend"], parse_axis("--bend", "1e-6:1e-5:4").values * factor)
    np.testing.assert_allclose(axes["twist"], [1.5e-6 * factor])


@pytest.mark.parametrize(("given", "field"), [
    (dict(weight=np.ones((1, 33))), "weight"),
    (dict(weight_per_length=np.ones((2, 2))), "weight_per_length"),
    (dict(weight_per_length=-1.0), "weight_per_length"),
    (dict(weight=0.0, weight_per_length=1.0), "weight_per_length"),
])
def test_a_weight_is_one_number_per_rod(given, field):
    """A row of 33 numbers is no 33 materials."""
    with pytest.raises(InputError, match=f"material: {field}: "):
        Material(1e5, 1e5, **given)


def test_rows_of_materials_keep_their_weight_per_length():
    material = Material.from_physical([1e-6, 2e-6], 1e-6, [1e-2, 3e-2])
    np.testing.assert_array_equal(material.take([1]).weight_per_length, [3e-2])


@pytest.mark.parametrize(("given", "field"), [
    (dict(EI="1e-6", GJ="1e-6"), "--linear-density"),
    (dict(EI="1e-6", bend="1e5", linear_density="1"), "--EI"),
    (dict(EI="1e-6", GJ="x", linear_density="1"), "--GJ"),
    (dict(EI="1e-6", GJ="1e-6", weight="2", linear_density="1"), "--EI"),
    (dict(EI="1e-6", GJ="1e-6", linear_density="0"), "--linear-density"),
])
def test_wrong_units_are_one_line(given, field):
    with pytest.raises(InputError, match=field):
        grid(options(**given))


def test_the_command_takes_them(tmp_path, capsys):
    assert main(["relax", str(tmp_path / "none.npz"), "--EI", "1e-6", "--out", str(tmp_path / "f.npz")]) == 2
    assert capsys.readouterr().err.count("\n") == 1
