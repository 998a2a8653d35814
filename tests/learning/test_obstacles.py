"""Sweeps over rods that lie on a table: with the table they find the true stiffness, without it they do not."""

import numpy as np
import pytest

from doo_ti import Axis, Descent, DistanceGrid, Grid, InputError, Observations, Pairs, Surroundings, hanging, relax, sweep
from doo_ti.contact.obstacles import Plane, Ring, Sphere
from doo_ti.learning.experiment import Experiment, SweepOptions
from doo_ti.learning.run_folder import claim, identity_of, read_experiment, read_plan
from doo_ti.rod.types import Clamp, Material
from tests.conftest import check_refused
from tests.learning.lab import small_lab

TRUE, RADIUS, HEIGHT = 2e5, 2.0, 25.0
TABLE = Surroundings([Plane((0, 0, 0), (0, 0, 1))], RADIUS)
GRID = Grid((Axis("bend", [5e4, 1e5, 2e5, 4e5]), Axis("twist", [TRUE])))
ON_TABLE = SweepOptions(precision="f64", surroundings=TABLE)


@pytest.fixture(scope="module")
def lying() -> Observations:
    """Rods of 240 mm between level clamps above the table, which lie down on it sideways."""
    span = np.array([170.0, 190.0, 205.0, 225.0])
    start, end = np.zeros((4, 3)), np.zeros((4, 3))
    start[:, 2] = end[:, 2] = HEIGHT
    end[:, 0] = span
    rods, clamps = hanging(240.0, 24, start, end, clamp=Clamp.FRAME)
    clamps.start_frame[:], clamps.end_frame[:] = np.eye(3), np.eye(3)
    bowed = relax(rods, Material(TRUE, TRUE), clamps, up=(0, -1, -0.3)).configuration
    found = relax(bowed, Material(TRUE, TRUE), clamps, **TABLE.arguments)
    assert found.converged.all() and found.contact.touching.any(axis=1).all()
    frames = found.configuration.frames
    return Observations(found.configuration.vertices, rest_length=rods.rest_length, start_frame=frames[:, 0],
                        end_frame=frames[:, -1], name="rope", end_distance=span, end_rotation=np.zeros(4))


@pytest.mark.slow
def test_with_the_table_a_sweep_finds_the_true_stiffness_and_without_it_not(tmp_path, lying):
    with_table = sweep(tmp_path / "with", lying, GRID, options=ON_TABLE)
    without = sweep(tmp_path / "without", lying, GRID, options=SweepOptions(precision="f64"))
    assert with_table["best"]["bend_1"] == TRUE and with_table["best"]["mean_distance_mm"] < 1e-3
    assert without["best"]["mean_distance_mm"] > 5.0 and without["best"]["bend_1"] != TRUE
    assert with_table["provenance"]["options"]["obstacles"]["kinds"] == ["plane"]
    # The folder alone gives the same experiment, and resuming it with another table is refused.
    kept = read_experiment(tmp_path / "with").options.surroundings
    assert (kept.obstacles[0].normal == TABLE.obstacles[0].normal).all() and kept.radius == RADIUS
    lower = Surroundings([Plane((0, 0, -1), (0, 0, 1))], RADIUS)
    with pytest.raises(InputError, match="holds another sweep"):
        sweep(tmp_path / "with", lying, GRID, options=SweepOptions(precision="f64", surroundings=lower))
    (tmp_path / "with" / "obstacles.npz").write_bytes(b"")
    with pytest.raises(InputError, match="obstacles.npz: file"):
        read_experiment(tmp_path / "with")


@pytest.mark.slow
def test_eq_3_over_a_table(tmp_path, lying):
    one = Grid((Axis("bend", [1e5, TRUE, 4e5]), Axis("twist", [TRUE])))
    found = sweep(tmp_path / "run", lying, one, pairs=Pairs([0, 1, 3], [1, 2, 2], [1.0, 1.0, 1.0]),
                  options=SweepOptions(precision="f64", objective="dynamic", surroundings=TABLE))
    assert found["best"]["bend_1"] == TRUE and found["best"]["mean_distance_mm"] < 0.1


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
