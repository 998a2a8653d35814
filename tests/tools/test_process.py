"""Children: each task in a process of its own, and a child that fails."""

import os
import sys
from pathlib import Path

import pytest

from doo_ti.bench import workload
from doo_ti.system.errors import InterruptedRunError
from tools.bench.process import Children


@pytest.fixture(scope="module")
def children():
    with Children(lambda: workload.started(*workload.observed("nylon"))) as children:
        yield children


@pytest.mark.slow
def test_start_up_is_timed_and_leaves_the_environment_alone(children):
    before = dict(os.environ)
    assert 0 < children.import_seconds() < children.process_seconds()
    assert os.environ == before


@pytest.mark.slow
def test_threads_are_set_in_the_child(children):
    assert children.rods_per_second(1, 64, 1) > 0


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="memory is read from /proc")
def test_memory_is_reported(children):
    assert children.bytes_per_rod(4096) < 10_000
    assert abs(children.growth_kb_per_call(40)) < 10_000


@pytest.mark.slow
def test_a_child_that_fails_is_reported_in_one_sentence(children):
    with pytest.raises(InterruptedRunError) as caught:
        children.rods_per_second(1, -3, 1)
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.slow
def test_nothing_is_left_behind(children):
    with Children(lambda: workload.started(*workload.observed("nylon"))) as others:
        others.process_seconds()
        folder = Path(others.folder.name)
        assert list(folder.iterdir())
    assert not folder.exists()
