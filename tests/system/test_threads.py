"""Several Python threads that use the kernels for the first time at the same moment: Taichi compiles for one at a time."""

import subprocess
import sys
from pathlib import Path

import pytest

from doo_ti.system import runtime
from tests.first_use import CALLS

ROOT = Path(__file__).resolve().parents[2]


def at_once(name: str, threads: int) -> None:
    command = [sys.executable, "-m", "tests.first_use", name, str(threads)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    assert done.stdout.split("\n")[-2:] == ["alike", ""], f"{done.stdout}{done.stderr}"


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["relax", "simulate"])
def test_eight_threads_begin_at_once(name):
    at_once(name, 8)


@pytest.mark.slow
@pytest.mark.parametrize("threads", [2, 8])
@pytest.mark.parametrize("name", CALLS)
def test_any_function_may_be_the_first(name, threads):
    at_once(name, threads)


def test_no_kernel_is_launched_beside_another():
    """A launch that does not hold the turn fails, whether or not another thread happens to launch then."""
    launched = []
    runtime.start()

    @runtime.kernel
    def nothing():
        pass

    with pytest.raises(RuntimeError, match="nothing"):
        nothing()
    runtime.exclusive(lambda: launched.append(nothing()))()
    assert launched == [None]
    with pytest.raises(RuntimeError):  # the turn is given back
        nothing()
