"""SETS.csv: the images of each set, and the seeds of the rods."""

import numpy as np
import pytest

from doo_ti.system.errors import InputError
from doo_ti.vision.detection.images import load_sets
from tests.vision.cameras.test_rig import rig

HEADER = "name,cam0,cam2,seed_x,seed_y,seed_z,dir_x,dir_y,dir_z\n"
LINE = "a,a0.png,a2.png,1,2,3,0,3,4\n"


def test_a_file_of_sets(tmp_path):
    (tmp_path / "sets.csv").write_text(HEADER + LINE + LINE.replace("a,", "b,", 1))
    sets = load_sets(tmp_path / "sets.csv", rig())
    assert sets.names == ("a", "b") and sets.rig.names == ("cam0", "cam2")
    assert sets.paths[0] == (tmp_path / "a0.png", tmp_path / "a2.png")
    np.testing.assert_allclose(sets.point[0], [1, 2, 3])
    np.testing.assert_allclose(sets.direction[0], [0, 0.6, 0.8])


CLICKS = "name,cam0,cam2,cam0_u,cam0_v,cam2_u,cam2_v\n"


def test_rods_that_begin_at_pixels(tmp_path):
    (tmp_path / "sets.csv").write_text(CLICKS + "a,a0.png,a2.png,10,20.5,,\nb,b0.png,b2.png,1,2,3,4\nc,c0.png,c2.png,,,5,6\n")
    sets = load_sets(tmp_path / "sets.csv", rig())
    assert sets.point is None and sets.direction is None and sets.rig.names == ("cam0", "cam2")
    assert sets.clicks == ({0: (10.0, 20.5)}, {0: (1.0, 2.0), 1: (3.0, 4.0)}, {1: (5.0, 6.0)})


@pytest.mark.parametrize("text, word", [
    (HEADER, "no rows"), (HEADER.replace("seed_y", "y") + LINE, "seed_y"), (HEADER.replace("cam2", "cam9") + LINE, "cam9"),
    (HEADER + LINE.replace("1,2,3", "1,x,3"), "seed_y: 'x' in line 2"), (HEADER + LINE + LINE, "twice"),
    (HEADER + LINE.replace("a2.png", ""), "cam2"), (HEADER + LINE.replace("0,3,4", "0,0,0"), "direction"),
    (HEADER + LINE.replace("1,2,3", "1,2,nan"), "finite"), (HEADER + LINE.replace("1,2,3", "0,0,-9000"), "behind"),
    (HEADER.replace("\n", ",cam0\n") + LINE.replace("\n", ",a0.png\n"), "cam0: .* twice"),
    (HEADER + LINE.replace("\n", ",7\n"), "10 cells under 9"), (HEADER + LINE.replace("a,", '"a\nb",', 1), "line break"),
    (CLICKS + "a,a0.png,a2.png,,,,\n", "cam0_u: '' in line 2"), (CLICKS + "a,a0.png,a2.png,3,,,\n", "cam0_v: '' in line 2"),
    (CLICKS.replace("cam2_u", "cam1_u") + "a,a0.png,a2.png,3,4,5,6\n", "cam1_v|cam2_v"),
    (CLICKS.replace("\n", ",seed_x\n") + "a,a0.png,a2.png,3,4,,,1\n", "seed_x"),
    (CLICKS.replace("cam0_v", "x") + "a,a0.png,a2.png,3,4,,\n", "cam0_v"),
    (CLICKS.replace("cam2_", "cam1_") + "a,a0.png,a2.png,3,4,,\n", "cam1"),
])
def test_wrong_lists_are_reported(tmp_path, text, word):
    (tmp_path / "sets.csv").write_text(text)
    with pytest.raises(InputError, match=word):
        load_sets(tmp_path / "sets.csv", rig())
