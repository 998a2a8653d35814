"""The numbers that contact goes by: with each halved or doubled rods converge as often, and end where they do otherwise."""

import json

import numpy as np
import pytest

from doo_ti.relaxation import contact_table
from tests.processes import python

pytestmark = pytest.mark.slow

NUMBERS = [name for name, value in vars(contact_table).items() if isinstance(value, float)
           and name not in ("ROUGH", "FINE", "GAP_TOLERANCE")]
BOUNDED = {"SHORTENED"}  # shares near one: doubled, half of what they are short of it
RODS = """
import importlib, json, sys
module, name, value = sys.argv[1:]
setattr(importlib.import_module(module), name, float(value))
import numpy as np
from doo_ti import Dynamics, Stepping, relax, simulate
from doo_ti.rod.types import Status
from tests.contact import clutter
from tools import contact_motions as motions
from tools.bench import contact
rods, material, clamps = contact.Specimens(96).laid_down
laid = relax(rods, material, clamps, obstacles=contact.obstacles(), radius=contact.RADIUS)
amid = relax(*clutter.sagging(np.random.default_rng(5), 96), obstacles=clutter.OBSTACLES, radius=clutter.RADIUS)
possible = amid.status != Status.INFEASIBLE
rest, material, grippers = motions.drawn(np.random.default_rng(6), 32, False)
rows = np.flatnonzero(rest.converged & (motions.held_gap(grippers) > 0))
moved = simulate(rest.configuration.take(rows), material.take(rows), grippers.take(rows), Dynamics(),
                 Stepping(rate=10.0, quasi_static=True), obstacles=motions.obstacles(), radius=motions.RADIUS)
print(json.dumps({
    "converged": [laid.converged.mean(), amid.converged[possible].mean(), moved.converged.mean()],
    "gap": min(clutter.gaps(contact.obstacles(), laid.configuration.vertices[laid.converged], contact.RADIUS)),
    "energy": laid.energy.tolist(), "iterations": [laid.iterations.mean(), amid.iterations.mean(), moved.iterations.mean()]}))
"""


def found(name: str, value: float) -> dict:
    done = python("-c", RODS, contact_table.__name__, name, value)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


@pytest.fixture(scope="module")
def usual() -> dict:
    return found("SOFT", contact_table.SOFT)


@pytest.mark.parametrize("factor", [0.5, 2.0])
@pytest.mark.parametrize("name", NUMBERS)
def test_half_and_twice(usual, name, factor):
    value = getattr(contact_table, name)
    changed = 1 - (1 - value) / 2 if factor > 1 and name in BOUNDED else factor * value
    other = found(name, changed)
    print(f"{name} = {changed:g}: converged {other['converged']}, iterations {np.round(other['iterations'], 1)}, usually "
          f"{np.round(usual['iterations'], 1)}")
    assert min(other["converged"]) > 0.96 and other["gap"] > -1e-4
    ends = np.isclose(other["energy"], usual["energy"], rtol=1e-4, equal_nan=True)
    assert ends.mean() > 0.9, "other equilibria"
