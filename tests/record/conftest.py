"""Recordings are written strictly: by default rerun only warns of wrong data and drops it."""

import pytest


@pytest.fixture(scope="module", autouse=True)
def strict():
    rerun = pytest.importorskip("rerun")
    rerun.set_strict_mode(True)
    yield
    rerun.set_strict_mode(False)
