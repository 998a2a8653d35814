"""Shared by all tests: where their data lies, and one printed seed for everything random."""

import os
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the commands set it, before NumPy reads it

import numpy as np  # noqa: E402
import pytest  # noqa: E402

SEED = 2011


def pytest_report_header() -> str:
    return f"seed: {SEED}"


@pytest.fixture
def rng() -> np.random.Generator:
    """A fresh generator for every test; its seed is in the header of each run and beside each failure."""
    print(f"seed: {SEED}")
    return np.random.default_rng(SEED)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of development data, which is not part of the project: tests that need it skip without it."""
    folder = Path(__file__).resolve().parents[2] / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"development data absent: {folder}")
    return folder


@pytest.fixture(params=["shipped", pytest.param("development", marks=pytest.mark.thorough)])
def laboratory(request) -> Path:
    """A folder with ``lab_a`` and ``images_a``: the one that ships with the tests, and that of the development data."""
    return Path(__file__).parent / "data" if request.param == "shipped" else request.getfixturevalue("shared_data")
