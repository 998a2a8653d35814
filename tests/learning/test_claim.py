"""Ownership of a run's folder: of sweeps that start together one gets it, and an unfinished claim has no effect."""

from threading import Barrier, Thread

import pytest

from doo_ti import InputError, InterruptedRunError, sweep
from doo_ti.learning import run_folder
from doo_ti.learning.experiment import Experiment
from doo_ti.learning.run_folder import claim
from tests.learning.lab import GRID, small_lab


@pytest.fixture(scope="module")
def experiment():
    return Experiment(small_lab(), GRID)


def claimed_at_once(run, experiment, identities: list[str]) -> int:
    """How many of them got the folder."""
    together, got = Barrier(len(identities)), []

    def begin(identity: str) -> None:
        together.wait()
        try:
            claim(run, identity, experiment)
            got.append(identity)
        except InputError:
            pass

    threads = [Thread(target=begin, args=(identity,)) for identity in identities]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return len(got)


def test_of_different_sweeps_one_gets_a_folder_and_of_equal_ones_all(tmp_path, experiment):
    for attempt in range(8):
        assert claimed_at_once(tmp_path / f"different{attempt}", experiment, list("abcd")) == 1
        assert claimed_at_once(tmp_path / f"equal{attempt}", experiment, ["a"] * 4) == 4


def test_a_claim_on_a_full_disk_can_be_made_again(tmp_path, experiment, monkeypatch):
    def full(*arguments, **options):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as disk:
        disk.setattr(run_folder, "write_whole", full)
        with pytest.raises(InterruptedRunError, match="No space left"):
            sweep(tmp_path / "run", small_lab(), GRID)
    claim(tmp_path / "run", "mine", experiment)


def test_a_folder_that_holds_something_else_is_left_alone(tmp_path, experiment):
    for place in ("notes.txt", "cells/notes.txt"):
        run = tmp_path / place.replace("/", "_")
        (run / place).parent.mkdir(parents=True)
        (run / place).write_text("mine")
        with pytest.raises(InputError, match="something else"):
            claim(run, "mine", experiment)


def test_what_was_killed_holds_nothing_and_what_it_left_half_written_goes(tmp_path, experiment):
    left = [tmp_path / "cells" / ".identity.txt.0123.part", tmp_path / ".run.rrd.ab.part",
            tmp_path / "cells" / ".000000000-000000012.parquet.77.part"]
    left[0].parent.mkdir()
    left[0].write_bytes(b"half")
    claim(tmp_path, "mine", experiment)
    for path in left[1:]:
        path.write_bytes(b"half")
    claim(tmp_path, "mine", experiment)
    assert not any(path.exists() for path in left)
    with pytest.raises(InputError, match="another sweep"):
        claim(tmp_path, "other", experiment)
