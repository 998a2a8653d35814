"""Cameras of a video a frame apart are noticed, by a swinging rope that no rod of the package describes."""

import numpy as np
import pytest

import doo_ti as d
from doo_ti.commands.track import _warn_of_instants
from doo_ti.vision.images import ImageSets
from doo_ti.vision.synchronisation import epipolar_extremes, frames_apart
from tests.vision.scenes import line_of, small_rig, three_cameras

FRAMES = 30


def rope(frame: float, swing: float) -> np.ndarray:
    """(100, 3) mm, 90 mm long: hangs from a point, and swings like a double pendulum by the angle ``swing``, in rad."""
    along = np.linspace(0, 1, 100)
    first = 0.3 + swing * np.sin(0.29 * frame + 1.3 * along)
    second = 0.8 * swing * np.cos(0.37 * frame + along)
    ways = np.stack([np.sin(first) * np.cos(second), np.sin(second), -np.cos(first) * np.cos(second)], axis=-1)
    return np.cumsum(0.9 * ways, axis=0) + [0, 0, 40]


def filmed(late: float, swing: float, rig: d.Rig, seed: int = 0, hidden: int = -1) -> np.ndarray:
    """(T, P, 2, 2): a film in which the second camera is ``late`` by some frames, and does not see the rope in one."""
    random, found = np.random.default_rng(seed), []
    for frame in range(FRAMES):
        seen = [camera.project(rope(frame - late * (k == 1), swing)) for k, camera in enumerate(rig.cameras)]
        lines = [line_of(one + random.normal(0, 0.3, one.shape)) for one in seen]
        if frame == hidden:
            lines[1] = d.Detection.none((480, 640), "ridge")
        found.append(epipolar_extremes(rig, lines))
    return np.array(found)


@pytest.mark.parametrize("late", [-2.0, -0.5, 1.0, 3.0])
def test_a_camera_that_is_late_is_found(late):
    """Among three the late one is in each pair that is found, and the third is not beside the first."""
    found = frames_apart(filmed(late, 0.3, three_cameras()))
    assert {one.cameras for one in found} <= {(0, 1), (1, 2)} and found
    for one in found:
        assert one.frames == (late if one.cameras == (0, 1) else -late)
        assert one.off[1] < 0.6 < 1 < one.off[0]


def test_a_frame_without_thread_is_left_out_and_a_few_tell_nothing():
    film = filmed(1.0, 0.3, small_rig(), hidden=7)
    assert [one.frames for one in frames_apart(film)] == [1.0] and not frames_apart(film[:11])


@pytest.mark.parametrize("seeds", [range(2), pytest.param(range(2, 10), marks=pytest.mark.thorough)])
@pytest.mark.parametrize("swing", [0.0, 0.02, 0.3])
def test_cameras_of_the_same_instant_are_not_blamed(swing, seeds):
    assert not any(frames_apart(filmed(0.0, swing, rig, seed)) for seed in seeds for rig in (three_cameras(), small_rig()))


def test_the_warning_names_cameras_rows_and_the_remedy(capsys):
    rig = small_rig()
    frames = ImageSets((), (), rig, None, None, "film.csv", ())
    _warn_of_instants(frames, filmed(-1.0, 0.3, rig))
    assert "film.csv: images of cam1 fit those of cam0 better 1 row earlier" in (said := capsys.readouterr().err)
    assert "give images of the same instant" in said
