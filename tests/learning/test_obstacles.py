"""Sweeps among obstacles: their identity, what is read back of them, and rods inside them."""

import numpy as np

from doo_ti import Axis, Descent, DistanceGrid, Grid, Surroundings
from doo_ti.contact.obstacles import Plane, Ring, Sphere
from doo_ti.learning.experiment import Experiment, SweepOptions
from doo_ti.learning.run_folder import claim, identity_of, read_plan
from tests.conftest import check_refused
from tests.learning.lab import small_lab

TRUE, RADIUS, HEIGHT = 2e5, 2.0, 25.0
GRID = Grid((Axis("bend", [5e4, 1e5, 2e5, 4e5]), Axis("twist", [TRUE])))


def experiment(*obstacles, radius=RADIUS, **options) -> Experiment:
    surroundings = Surroundings(obstacles, radius) if obstacles else Surroundings()
    return Experiment(small_lab(), GRID, SweepOptions(surroundings=surroundings, **options))


def test_the_identity_of_a_sweep_depends_on_its_obstacles():
    table, low = Plane((0, 0, -900), (0, 0, 1)), Plane((0, 0, -901), (0, 0, 1))
    found = [identity_of(one) for one in (
        experiment(), experiment(table), experiment(low), experiment(table, low), experiment(table, radius=1.5))]
    assert len(set(found)) == 5 and identity_of(experiment(Plane((0, 0, -900), (0, 0, 1)))) == found[1]


def test_obstacles_of_all_kinds_are_read_back_from_the_folder_of_a_run(tmp_path):
    values = np.full((4, 4, 4), 9.0)
    values[1:3, 1:3, 1:3] = -1.0
    around = [Plane((0, 0, -900), (0, 0, 1), 0.3), Sphere((0, 0, -900), 5), Ring((0, 900, 0), (0, 0, 1), 9, 1),
              DistanceGrid(values, 5.0, (0, 0, -900))]
    one = experiment(*around)
    claim(tmp_path / "run", identity_of(one), one)
    again, identity = read_plan(tmp_path / "run")
    assert identity == identity_of(one) and again.options.as_dict()["obstacles"] == one.options.as_dict()["obstacles"]
    assert list(map(type, again.options.surroundings.obstacles)) == list(map(type, around))
    for damage in ("obstacles.npz", "cells/plan.json"):
        path = tmp_path / "run" / damage
        path.write_bytes(path.read_bytes().replace(b"plane", b"space") if damage.endswith("json") else b"PK")
        check_refused(": ", read_plan, tmp_path / "run")


def test_rods_inside_obstacles_and_what_a_sweep_cannot_use_are_refused():
    far = Plane((0, 0, -900), (0, 0, 1))
    check_refused(r"obstacles: the clamp of rod \d is .* mm inside a Plane", experiment, Plane((0, 0, 900), (0, 0, 1)))
    middle = small_lab().vertices[:, 16]
    check_refused(r"obstacles: the centreline of rod . is [\d.]+ mm inside a Sphere", experiment, Sphere(middle[0], 3.0))
    check_refused("solver: Descent", experiment, far, solver=Descent())
    check_refused("obstacles: .* for each rod", experiment, far, radius=np.linspace(1.0, 2.0, 6))
