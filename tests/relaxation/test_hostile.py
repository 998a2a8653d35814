"""Wrong options, materials, tables and rows: each is refused in one sentence with what is wrong and what helps."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti import Clamp, Descent, InputError, Material, Newton, Springs, Stepping, relax
from tests.references.rods import clamps_at
from tests.relaxation.rods import wandering

EDGES, COUNT = 10, 6
MATERIAL = Material(1e5, 1e5)

OPTIONS = {
    "iterations beyond 32 bits": lambda: Newton(max_iterations=2**31), "escapes below zero": lambda: Newton(max_escapes=-1),
    "a flag of iterations": lambda: Newton(max_iterations=True), "text": lambda: Newton(tolerance="x"),
    "an endless shift": lambda: Newton(first_shift=np.inf), "a negative shift": lambda: Newton(first_shift=-1.0),
    "tolerance of zero": lambda: Newton(tolerance=0.0), "tolerance not a number": lambda: Newton(tolerance=np.nan),
    "rotations too large": lambda: Newton(max_rotation=2.0), "gaps without tolerance": lambda: Newton(gap_tolerance=0.0),
    "gaps of a radius": lambda: Stepping(100.0, gap_tolerance=1.0), "descent of none": lambda: Descent(max_iterations=0),
    "half a turn": lambda: Descent(largest_move=0.5), "springs of text": lambda: Springs("a", "b"),
    "a number too large": lambda: Material(10**400, 1.0), "twist of three axes": lambda: Material(1.0, np.ones((2, 3, 2))),
    "imaginary bend": lambda: Material(1e5 + 1j, 1.0),
    "unlike rows": lambda: Material.diagonal([1.0, 2.0], [1.0, 2.0, 3.0], 4.0),
    "a flag for twist": lambda: Material(1e5, True), "negative B": lambda: Material(-1e5, 1e5),
    "indefinite B": lambda: Material([[1e5, 2e5], [2e5, 1e5]], 1e5), "B not a number": lambda: Material(np.nan, 1e5),
    "asymmetric B": lambda: Material([[1e5, 2e4], [0.0, 1e5]], 1e5), "3 × 3": lambda: Material(np.ones((3, 3)), 1e5),
    "negative β": lambda: Material(1e5, -1.0), "negative μ": lambda: Material(1e5, 1e5, -1.0),
    "lengths differ": lambda: Material([1e5, 2e5], [1e5, 2e5, 3e5]), "one curvature": lambda: Material(1e5, 1e5, 1.0, 0.1)}
CALLS = {
    "rods of text": lambda s, c: relax(replace(s, quaternions=np.full(s.quaternions.shape, "a")), MATERIAL, c),
    "imaginary": lambda s, c: relax(replace(s, start=s.start + 0j), MATERIAL, c),
    "whole quaternions": lambda s, c: relax(replace(s, quaternions=s.quaternions.round().astype(int)), MATERIAL, c),
    "flags as positions": lambda s, c: relax(replace(s, start=s.start > 0), MATERIAL, c),
    "count of lengths": lambda s, c: relax(replace(s, rest_length=np.ones(EDGES + 1)), MATERIAL, c),
    "lengths not a number": lambda s, c: relax(replace(s, rest_length=np.full(EDGES, np.nan)), MATERIAL, c),
    "one edge": lambda s, c: relax(replace(s, quaternions=s.quaternions[:, :1], rest_length=np.ones(1)), MATERIAL, c),
    "fewer positions": lambda s, c: relax(replace(s, start=s.start[:3]), MATERIAL, c),
    "quaternions of three": lambda s, c: relax(replace(s, quaternions=s.quaternions[..., :3]), MATERIAL, c),
    "materials": lambda s, c: relax(s, Material([1e5, 2e5], 1e5), c),
    "count of B": lambda s, c: relax(s, Material(np.tile(1e5 * np.eye(2), (1, EDGES - 1, 1, 1)), 1e5), c),
    "count of ω̄": lambda s, c: relax(s, Material(1e5, 1e5, 1.0, np.zeros((1, EDGES, 2))), c),
    "no up": lambda s, c: relax(s, MATERIAL, c, up=[0, 0, 0]),
    "up not a number": lambda s, c: relax(s, MATERIAL, c, up=[0, 0, np.nan]),
    "up beyond floating point": lambda s, c: relax(s, MATERIAL, c, up=[10**400, 0, 0]),
    "precision": lambda s, c: relax(s, MATERIAL, c, precision="f16"),
    "row too large": lambda s, c: relax(s, MATERIAL, c, configuration_index=[0, COUNT]),
    "table of rows": lambda s, c: relax(s, MATERIAL, c, configuration_index=[[0, 1]]),
    "ragged rows": lambda s, c: relax(s, MATERIAL, c, configuration_index=[[0], [1, 2]]),
    "rows that are not whole": lambda s, c: relax(s, MATERIAL, c, configuration_index=[0.5, 1.5]),
    "no such material": lambda s, c: relax(s, MATERIAL, c, configuration_index=[0], material_index=[1]),
    "unlike indices": lambda s, c: relax(s, MATERIAL, c, configuration_index=np.arange(3), material_index=np.zeros(2, int)),
    "both ends free": lambda s, c: relax(s, MATERIAL, replace(c, start=Clamp.FREE, end=Clamp.FREE)),
    "fewer clamps": lambda s, c: relax(s, MATERIAL, c.take(np.arange(COUNT - 1))),
    "count of kinds": lambda s, c: relax(s, MATERIAL, replace(c, start=np.array([1, 2]))),
    "no such clamp": lambda s, c: relax(s, MATERIAL, replace(c, start=7)),
    "frames of one axis": lambda s, c: relax(s, MATERIAL, replace(c, end_frame=c.end_frame[:, 0])),
    "positions in a plane": lambda s, c: relax(s, MATERIAL, replace(c, end_position=c.end_position[:, :2]))}


@pytest.mark.parametrize("case", [*OPTIONS, *CALLS])
def test_wrong_input_is_refused(rng, case):
    rods = wandering(rng, COUNT, EDGES)
    with pytest.raises(InputError) as caught:
        OPTIONS[case]() if case in OPTIONS else CALLS[case](rods, clamps_at(rods))
    error = caught.value
    assert error.source and error.field and error.problem and error.remedy and "\n" not in str(error)
