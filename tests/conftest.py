"""Shared by all tests: where their data lies, and one printed seed for everything random."""

import os
from collections import Counter
from collections.abc import Callable
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the commands set it, before NumPy reads it
os.environ.setdefault("DOO_TI_COMPILE", "briefly")  # the same bits, in three quarters of the time of all tests

import numpy as np  # noqa: E402
import pytest  # noqa: E402

from doo_ti.physics.number import Number  # noqa: E402
from doo_ti.system.errors import InputError  # noqa: E402

pytest.register_assert_rewrite("tests.commands.calls")
SEED = 2011
SHARED_KERNELS = {
    "contact": ("tests/contact/", "tests/groups/", "tests/commands/test_contact.py", "tests/commands/test_group.py",
                "tests/refinement/test_on_a_table.py", "tests/perception/test_obstacles.py",
                "tests/commands/test_predict.py::test_clamps_inside", "tests/manipulation/test_servo.py::test_grippers_do_not",
                "tests/relaxation/test_extremes.py::test_a_start_below", "tests/examples/test_examples.py::test_example[12_",
                "tests/examples/test_examples.py::test_example[13_", "tests/examples/test_examples.py::test_example[14_"),
    "motions": ("tests/dynamics/", "tests/commands/test_simulate.py", "tests/motion/"),
    "images": ("tests/perception/", "tests/vision/test_distance_map.py", "tests/vision/test_relaxed_on_images.py",
               "tests/vision/test_reprojection.py", "tests/commands/test_perceive.py", "tests/commands/test_track.py",
               "tests/commands/test_servo.py", "tests/manipulation/", "tests/examples/test_examples.py::test_example[04_",
               "tests/examples/test_examples.py::test_example[08_"),
    "sweeps": ("tests/learning/test_sweep.py", "tests/learning/test_run_folder.py", "tests/commands/test_runs.py")}
"""Tests that use the same kernels, which take up to a minute to compile, or the same ``finished_sweeps``."""


def pytest_report_header() -> str:
    return f"seed: {SEED}"


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Of a test with ``sampled(n)`` the cases after the first n belong to the full run. Cases of packs are for a CPU."""
    if os.environ.get("DOO_TI_ARCHITECTURE", "cpu") != "cpu":
        for item in items:
            case = getattr(item, "callspec", None)
            if case is not None and any(isinstance(value, Number) and value.width > 1 for value in case.params.values()):
                item.add_marker(pytest.mark.skip(reason="a GPU has one rod per thread, no packs"))
    seen = Counter()
    for item in items:
        sampled = item.get_closest_marker("sampled")
        if sampled and item.get_closest_marker("thorough") is None:
            name = item.nodeid.partition("[")[0]
            seen[name] += 1
            if seen[name] > sampled.args[0]:
                item.add_marker(pytest.mark.thorough)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log):
    """One process runs all tests of a file, and one those that share kernels which take long to compile."""
    from xdist.scheduler import LoadScopeScheduling

    class Scheduling(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            sharing = (name for name, tests in SHARED_KERNELS.items() if nodeid.startswith(tests))
            return next(sharing, nodeid.partition("::")[0])
    return Scheduling(config, log)


def check_refused(said: str, function: Callable, *given, **options) -> None:
    """The call raises an InputError of one line, with a remedy, in which the regular expression ``said`` is found."""
    with pytest.raises(InputError, match=said) as caught:
        function(*given, **options)
    assert caught.value.remedy and "\n" not in str(caught.value)


@pytest.fixture
def rng() -> np.random.Generator:
    """A fresh generator for every test; its seed is in the header of each run and beside each failure."""
    print(f"seed: {SEED}")
    return np.random.default_rng(SEED)


@pytest.fixture(scope="session")
def finished_sweeps(tmp_path_factory) -> dict[str, tuple[Path, dict]]:
    """(folder, summary) of finished sweeps on the small lab, ``static`` and ``dynamic``: to be read, or copied."""
    from tests.learning.lab import DYNAMIC, GRID, small_lab, sweep

    folder, found = tmp_path_factory.mktemp("finished"), {}
    for name, options in (("static", {}), ("dynamic", {"options": DYNAMIC})):
        found[name] = folder / name, sweep(folder / name, small_lab(), GRID, command=["doo-ti", "sweep", "lab"], **options)
    return found


class DevelopmentData(type(Path())):
    """A folder of which what is asked for, and is not there, skips the test."""

    def __truediv__(self, name: str) -> Path:
        found = super().__truediv__(name)
        if not found.exists():
            pytest.skip(f"development data absent: {found}")
        return found


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of development data, which is not part of the project."""
    return DevelopmentData(Path(__file__).resolve().parents[2]) / "shared" / "data"


@pytest.fixture(scope="session")
def shipped_data() -> Path:
    """The folder of the data that ships with the tests: ``lab_a`` and ``images_a``, described in its README."""
    return Path(__file__).parent / "data"


@pytest.fixture(params=["shipped_data", pytest.param("shared_data", marks=pytest.mark.slow)])
def laboratory(request) -> Path:
    """A folder with ``lab_a`` and ``images_a``: the shipped one, and with ``-m slow`` that of the development data too."""
    return request.getfixturevalue(request.param)
