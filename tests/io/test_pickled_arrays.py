"""Pickles of the public cable data: arrays of numbers are read, and nothing that a file names is ever called."""

import os
import pickle

import numpy as np
import pytest

from doo_ti.io.cable_recordings import read_recordings
from doo_ti.io.pickled_arrays import ALLOWED, read_pickled_array
from doo_ti.system.errors import InputError

FRAMES = np.arange(5 * 3 * 4, dtype=np.float64).reshape(5, 3, 4) / 100


def written(path, value, protocol: int = 4):
    path.write_bytes(pickle.dumps(value, protocol))
    return path


class Calls:
    """A pickle that calls ``function`` where it is unpickled as usual."""

    def __init__(self, function, *arguments):
        self.what = function, arguments

    def __reduce__(self):
        return self.what


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
@pytest.mark.parametrize("value", [FRAMES, list(FRAMES), FRAMES.astype(">f4"), np.asfortranarray(FRAMES)],
                         ids=["array", "list", "other byte order", "other order"])
def test_arrays_are_read_under_every_protocol(tmp_path, value, protocol):
    found = read_pickled_array(written(tmp_path / "a.pkl", value, protocol))
    np.testing.assert_allclose(found, FRAMES, rtol=1e-6)
    assert found.dtype == np.float64


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
@pytest.mark.parametrize("hostile", [(os.system, "touch {}"), (eval, "open({!r}, 'w')"), (open, "{}", "w")], ids=str)
def test_nothing_that_a_file_names_is_called(tmp_path, hostile, protocol):
    trace = tmp_path / "trace"
    function, *arguments = hostile
    path = written(tmp_path / "a.pkl", [FRAMES[0], Calls(function, *(text.format(str(trace)) for text in arguments))], protocol)
    with pytest.raises(InputError, match="names "):
        read_pickled_array(path)
    assert not trace.exists()


def test_the_names_that_are_allowed_import_nothing():
    assert {module.partition(".")[0] for module, _ in ALLOWED} == {"numpy", "_codecs"}
    assert all(stand_in.__module__ == "doo_ti.io.pickled_arrays" for stand_in in ALLOWED.values())


@pytest.mark.parametrize("value", [
    [], {"a": FRAMES}, [FRAMES[0], FRAMES[0, :2]], [1.0, 2.0], np.array([None, "a"], dtype=object), np.array(["a"]),
    Calls(np.ndarray, (10**12,)), Calls(np.dtype, "O"),
], ids=["empty", "dict", "shapes", "floats", "objects", "texts", "huge", "dtype"])
def test_other_content_is_refused(tmp_path, value):
    with pytest.raises(InputError, match="a.pkl"):
        read_pickled_array(written(tmp_path / "a.pkl", value))


def test_a_folder_of_recordings_is_one_npz(tmp_path):
    for number in (9, 10):
        written(tmp_path / f"{number}.pkl", [number * frame for frame in FRAMES])
    positions, names = read_recordings(tmp_path)
    assert positions.shape == (2, 5, 4, 3) and names.tolist() == [9, 10]
    np.testing.assert_allclose(positions[1, 2, 3], 1e4 * FRAMES[2, :, 3], rtol=1e-6)
    with pytest.raises(InputError, match="frames"):
        read_recordings(written(tmp_path / "b.pkl", FRAMES[0]))
