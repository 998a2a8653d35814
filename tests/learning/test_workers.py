"""Work in other processes: in order, no more than needed, and finished work is kept."""

import pickle
import time

import pytest

from doo_ti.learning.chunks import maker
from doo_ti.learning.workers import as_made, started_workers
from doo_ti.system.errors import InputError


def _slowly(first: int, last: int) -> int:
    if first == 3:
        time.sleep(0.5)
        raise ValueError("the fourth fails")
    return last - first


@pytest.mark.thorough
def test_chunks_come_in_order_whoever_does_them():
    chunks = [(k, k + k % 3) for k in range(3)] + [(k, k + k % 3) for k in range(4, 9)]
    for workers in (None, 1, 3):
        with started_workers(workers, None) as own:
            assert list(own.results(_slowly, chunks)) == [(chunk, chunk[1] - chunk[0]) for chunk in chunks]


@pytest.mark.thorough
def test_work_finished_before_a_failure_is_returned_and_the_rest_is_not_begun():
    asked = []

    def chunks():
        for k in range(1000):
            asked.append(k)
            yield k, k + 1

    found = []
    with pytest.raises(ValueError, match="the fourth fails"), started_workers(2, None) as own:
        for chunk, _ in own.results(_slowly, chunks()):
            found.append(chunk[0])
    assert found[:3] == [0, 1, 2] and 3 not in found and len(found) > 3
    assert len(asked) < 10


def test_a_worker_that_runs_something_else_is_refused():
    assert as_made(maker(), max, 3, 4) == 4
    with pytest.raises(InputError, match="99.0") as caught:
        as_made(maker() | {"doo_ti": "99.0"}, max, 3, 4)
    again = pickle.loads(pickle.dumps(caught.value))  # as it comes from another process
    assert (str(again), again.remedy) == (str(caught.value), caught.value.remedy)


def test_no_workers_are_refused():
    with pytest.raises(InputError, match="workers: 0 is below 1"), started_workers(0, None):
        pass
