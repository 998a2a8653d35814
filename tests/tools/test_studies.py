"""Studies whose tables pages show: what they count, the truth that they make, and some of their results at small sizes; the
recipe for the public cable data: which stretches are kept, and what happens without the data."""

import csv
import os
import pickle
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from doo_ti import ClampPath, InputError, Material, Observations, load_observations, load_path
from tests.conftest import SEED
from tests.perception.test_twist import MATERIAL, twisted_rods
from tests.relaxation.rods import lab
from tools.studies import detection_study, group_study, picture_study
from tools.studies.cables import APART, SLOWEST, STILL, STRETCH, main, read_recordings, slowest
from tools.studies.marks_study.rod import cross, equilibria, turned
from tools.studies.marks_study.study import deviation
from tools.studies.perception_study import CORRECT_MM, OPTIONS, THREADS, photographed, recovered, with_energy
from tools.studies.prediction_study import moved_as_one, moved_by_blend, predict_marks, predict_steps
from tools.studies.replication.images import PAPER_MM
from tools.studies.replication.specimens import scene
from tools.studies.replication.twist import SUCCESS, twist_trials


@pytest.mark.slow
@pytest.mark.parametrize(("study", "words", "said"), [
    (group_study, ["--groups", "4"], "converge"),
    (picture_study, ["--specimens", "1", "--seed", "2018"], "1 of 1 intervals")], ids=["groups", "pictures"])
def test_a_study_of_few(capfd, study, words, said):
    assert study.main(words) == 0 and said in capfd.readouterr().out


def test_the_marks_study_counts_what_is_outside_on_either_side():
    assert deviation([1.1, 0.9, 1.3], 1.0) == pytest.approx(1.96 * np.log(1.1) / np.log(1.1 / 0.9))
    assert deviation([1.1, 1.05, 1.3], 1.0) > 1.96 and deviation([0.9, 0.7, 0.95], 1.0) < -1.96
    assert deviation([2.0, None, 3.0], 1.0) == 0.0 and deviation(None, 1.0) is None


@pytest.mark.parametrize("load", [0.0, 60.0])
def test_a_rod_of_the_marks_study_solves_the_initial_value_problem_of_its_start(load):
    rng = np.random.default_rng(SEED)
    start, end = turned(rng.normal(0, 0.4, (4, 3))), turned(rng.normal(0, 0.6, (4, 3)))
    span = np.array([[0.7, 0.2, 0.1]]) * rng.uniform(0.8, 1.1, (4, 1))
    bent = np.array([0, 0.4, -0.2])
    rods, right = equilibria(34, 0.6, np.tile([0, 0, load], (4, 1)), start, span, end, np.tile(bent, (35, 1)))
    assert right.all()

    def along(s, y, rod):
        frame = y[3:12].reshape(3, 3)
        kappa = frame.T @ y[12:] / [0.6, 1, 1] + bent
        return np.concatenate([frame[:, 0], (frame @ cross(kappa)).ravel(), -np.cross(frame[:, 0], force(rod, s))])

    def force(rod, s):
        return rods.force[rod] + s * rods.weight[rod]

    for rod in range(4):
        y = np.concatenate([np.zeros(3), start[rod].ravel(), rods.moments()[rod, 0]])
        y = solve_ivp(along, (0, 1), y, args=(rod,), rtol=1e-9, atol=1e-11).y[:, -1]
        np.testing.assert_allclose(y[:3], span[rod], atol=3e-5)
        np.testing.assert_allclose(y[3:12], end[rod].ravel(), atol=3e-4)


def test_trials_of_eq_4_rotate_known_frames_and_find_the_angle():
    made = twisted_rods()
    trials = twist_trials(made, made.total_twist, MATERIAL, 3, 5, seed=4)
    assert trials.configurations.shape == (5, 3) and (np.diff(np.sort(trials.configurations)) > 0).all()
    assert np.ptp(trials.truth) > 1 and trials.error.max() < np.radians(1.5)
    again = twist_trials(made, made.total_twist, MATERIAL, 3, 5, seed=4)
    np.testing.assert_array_equal(again.estimate.phi, trials.estimate.phi)


@pytest.mark.thorough
def test_fig_7_on_the_lab(laboratory):
    """A part of the study: success within a quarter turn, whole turns counted, under the lab's own Θ."""
    observations = load_observations(laboratory / "lab_a" / "vicryl.npz")
    with np.load(laboratory / "lab_a" / "vicryl_truth.npz") as file:
        truth = np.radians(file["total_twist_deg"])
    for together, least in ((1, 0.9), (6, 0.99)):
        trials = twist_trials(observations, truth, Material(6e5, 8e5), together, 40, seed=1)
        assert np.mean(trials.error <= SUCCESS) >= least


@pytest.mark.sampled(1)
@pytest.mark.parametrize("name", ["ribbon", "nylon", "vicryl", "silk"])
def test_rotation_steps_of_the_lab_are_predicted(laboratory, name):
    """Where the ribbon's prediction ends on another branch than the observation, that is known."""
    rods = lab(laboratory, name)
    steps = predict_steps(rods.observations, rods.material())
    assert len(steps.error) == 54
    if name == "ribbon":
        assert np.median(steps.error) <= 0.8
        assert (np.abs(steps.error - steps.own_error)[steps.same_branch] < 0.5).all()
    else:
        assert steps.error.mean() <= 1.0 and steps.same_branch.all()


def test_a_cable_between_two_grippers(shared_data):
    """0.2 m/s: the quasi-static prediction is better than the baselines on every sequence."""
    folder = shared_data / "cables"
    still = load_observations(folder / "dlo1.npz")
    path = load_path(folder / "dlo1_motion.npz")
    assert path.count == 6 and path.moments == 150 and path.time[-1] == pytest.approx(1.49)
    with np.load(folder / "dlo1_motion.npz") as file:
        marks = file["positions_mm"].astype(float)
    first = Observations(marks[:, 0], rest_length=still.rest_length)
    sparse = ClampPath(path.time[::-1][::10][::-1], tangents_only=True, **{
        name: getattr(path, name)[::-1][::10][::-1] for name in ("start_position", "end_position", "start_frame", "end_frame")})
    prediction = predict_marks(first, Material(3.16e6, 3.16e6), sparse)
    assert prediction.followed.all()
    shifts = marks[:, -1, 0] - marks[:, 0, 0], marks[:, -1, -1] - marks[:, 0, -1]
    guesses = moved_as_one(first.vertices, *shifts), moved_by_blend(first.vertices, *shifts, still.rest_length)
    off, *others = (np.linalg.norm(shape - marks[:, -1], axis=-1).mean(axis=1) for shape in (prediction.vertices[-1], *guesses))
    assert (off < np.minimum(*others)).all()


@pytest.mark.thorough
def test_detection_is_measured(capsys, monkeypatch):
    monkeypatch.setattr(detection_study, "ROWS", detection_study.ROWS[:2])
    assert detection_study.main(["--rods", "1"]) == 0
    assert len(capsys.readouterr().out.strip().splitlines()) == 2 + len(detection_study.ROWS)


@pytest.mark.slow
@pytest.mark.parametrize("thread", THREADS)
def test_all_sets_of_the_paper_are_recovered_to_its_accuracy(thread):
    """§V-E: 60 sets of each thread."""
    case, _ = photographed(scene(thread).observations, 60)
    _, off, _ = recovered(case)
    assert off.mean() <= PAPER_MM[thread] and off.max() < 0.15


@pytest.mark.slow
def test_energy_distinguishes_rods_that_images_do_not():
    """Fig. 6, with the paper's E_proj: all views cross themselves; gaps of the detection are filled as in §V-E."""
    case, _ = photographed(scene("loops_vicryl").observations, crossing=True)
    assert len(case.rods.names) > 15
    paper = replace(OPTIONS, evidence="rod")
    wrong = [(recovered(case.filled(), with_energy(paper, share))[1] >= CORRECT_MM).sum() for share in (1.0, 1e-2)]
    assert wrong[0] <= 1 and wrong[1] >= 2 * max(wrong[0], 1)


FRAMES = np.arange(5 * 3 * 4, dtype=np.float64).reshape(5, 3, 4) / 100


class Calls:
    """A pickle that runs a command where it is unpickled as usual."""

    def __reduce__(self):
        return os.system, ("touch trace",)


def test_the_slowest_stretches_are_kept_in_order():
    """Recording r moves uniformly by r + 1 mm a frame, and stops for a while in one of them."""
    frames = 4 * APART + STRETCH
    place = np.cumsum(np.ones((3, frames)) * np.array([[1.0], [2.0], [3.0]]), axis=1)
    place[2, APART:] = place[2, APART]
    positions = np.zeros((3, frames, 4, 3), dtype=np.float32)
    positions[..., 0] = place[..., None]
    found, speed = slowest(positions)
    assert found.shape == (SLOWEST, STRETCH, 4, 3) and (np.diff(speed) >= 0).all()
    np.testing.assert_array_equal(found[0], positions[2, APART * 2 : APART * 2 + STRETCH])
    np.testing.assert_allclose(speed[4:], 0.1, rtol=1e-6)  # 1 mm a frame at 100 Hz


def test_still_frames_are_sixty_of_two_cables():
    with STILL.open(encoding="utf-8", newline="") as file:
        rows = [tuple(row.values()) for row in csv.DictReader(file)]
    assert len(set(rows)) == 120 and [sum(row[0] == name for row in rows) for name in ("dlo1", "dlo3")] == [60, 60]


def test_missing_data_is_an_error(tmp_path, capsys):
    assert main(["make", str(tmp_path), "--out", str(tmp_path / "out")]) == 2
    assert main(["results", str(tmp_path)]) == 1
    assert all("missing" in line or "folder" in line for line in capsys.readouterr().err.strip().splitlines())


@pytest.mark.parametrize("protocol", range(2, pickle.HIGHEST_PROTOCOL + 1))
def test_a_folder_of_pickles_becomes_one_array(tmp_path, monkeypatch, protocol):
    monkeypatch.chdir(tmp_path)
    for number in (9, 10):
        (tmp_path / f"{number}.pkl").write_bytes(pickle.dumps([number * frame for frame in FRAMES], protocol))
    positions, names = read_recordings(tmp_path)
    assert positions.shape == (2, 5, 4, 3) and names.tolist() == [9, 10]
    np.testing.assert_allclose(positions[1, 2, 3], 1e4 * FRAMES[2, :, 3], rtol=1e-6)
    (tmp_path / "11.pkl").write_bytes(pickle.dumps([FRAMES[0], Calls()], protocol))
    with pytest.raises(InputError, match="names"):
        read_recordings(tmp_path)
    assert not (tmp_path / "trace").exists()
