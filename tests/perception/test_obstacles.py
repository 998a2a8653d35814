"""A limp rod that hangs onto a table, perceived with the table; and Eq. 4 for a rope on a table."""

import numpy as np
import pytest

from doo_ti import PerceptionOptions, Plane, Surroundings, end_clamps, perceive, relax, save_observations, straight_rod
from doo_ti.commands.cli import main
from doo_ti.rod.types import Clamp, Material, Status
from doo_ti.vision.tubes import smooth_curve
from tests.commands.calls import refused, written
from tests.conftest import check_refused
from tests.vision.scenes import drawn_maps, three_cameras
from tools.studies import table_study

EDGES, LENGTH, RADIUS = 20, 3.0, 0.5
MATERIAL, REST_LENGTH = Material(2e3, 2e3), np.full(EDGES, LENGTH)
TABLE = Surroundings([Plane((0, 0, -10), (0, 0, 1))], RADIUS)


def lying(up: float, aside: float) -> np.ndarray:
    """(V, 3) a rod that begins above the table, in the direction (1, aside, up)."""
    one = straight_rod(EDGES * LENGTH, EDGES, (-25.0, -5.0, -4.0), (1.0, aside, up))
    found = relax(one, MATERIAL, end_clamps(one, Clamp.TANGENT), **TABLE.arguments)
    assert found.converged.all() and found.contact.touching.sum() > 5
    return found.configuration.vertices[0]


@pytest.mark.slow
def test_a_perceived_rod_lies_on_the_table_and_not_in_it():
    rods, rig = np.stack([lying(0.7, 0.1), lying(0.2, 0.3)]), three_cameras()
    maps = drawn_maps(rig, smooth_curve(rods, 4))
    given = maps, rig, rods[:, 0], rods[:, 1] - rods[:, 0], REST_LENGTH, MATERIAL
    on_table, free = (perceive(*given, options=PerceptionOptions(hypotheses=15), **around)
                      for around in ({"surroundings": TABLE}, {}))
    assert (on_table.status == Status.CONVERGED).all() and on_table.stable.all()
    assert (TABLE.smallest_gap(on_table.vertices) > -1e-3 * RADIUS).all()
    assert (TABLE.smallest_gap(free.vertices) < -0.01 * RADIUS).all(), "without the table the rod's weight pulls it down"
    off, more = (np.linalg.norm(found.vertices - rods, axis=-1).mean(axis=1) for found in (on_table, free))
    assert (off < more).all() and (off < 0.02).all()


def test_seeds_inside_obstacles_are_refused():
    rod = np.linspace([-25.0, -5.0, -4.0], [30.0, -5.0, -4.0], EDGES + 1)[None]
    maps, way = drawn_maps(three_cameras(), rod), rod[:, 1] - rod[:, 0]
    each = Surroundings([Plane([[0, 0, -10], [0, 0, -9]], [[0, 0, 1], [0, 0, 1]])], RADIUS)
    for lower, table, words in ((5.7, TABLE, "point: a rod that begins there is 0.2 mm inside a Plane"),
                                (0.0, each, "obstacles: other ones, or another radius, for each rod")):
        check_refused(words, perceive, maps, three_cameras(), rod[:, 0] - [0, 0, lower], way, REST_LENGTH, MATERIAL,
                      surroundings=table)


@pytest.mark.thorough
def test_twist_is_found_with_the_table(tmp_path, capsys):
    """Of a rope that lies on it: eight observations share an angle, which is zero as their end frames are known."""
    observations, truth = table_study.specimen(2014)
    save_observations(tmp_path / "rope.npz", observations)
    (tmp_path / "table.toml").write_text('[[obstacles]]\nkind = "plane"\npoint = [0, 0, 0]\nnormal = [0, 0, 1]\n')
    words = ["twist", str(tmp_path / "rope.npz"), "--observations", "8", "--bend", f"{truth['bend']}", "--twist",
             f"{truth['twist']}", "--obstacles", str(tmp_path / "table.toml"), "--out", str(tmp_path / "twist.npz")]
    assert main([*words, "--radius", "2"]) == 0 and abs(written(tmp_path / "twist.npz")["phi_deg"][0]) < 10.0
    capsys.readouterr()
    refused(capsys, tmp_path, words, "--radius: missing beside --obstacles")
