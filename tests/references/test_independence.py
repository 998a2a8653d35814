"""A rod's result is the same to the last bit alone, in a batch of 4096, and in any place of it."""

import numpy as np
import pytest

from doo_ti.relaxation import relax
from doo_ti.types import Material
from tests.references.rods import chain, clamps_at, jiggled, stacked

FIELDS = ("energy", "residual", "closure", "iterations", "status", "stable")


@pytest.mark.parametrize("precision", ["f64", "f32"])
@pytest.mark.parametrize("kind", ["isotropic", "general B"])
def test_alone_and_in_any_place_of_a_batch(rng, kind, precision):
    along = np.arange(20) / 19
    rods = []
    for k in range(6):
        tangents = np.stack([1 + 0 * along, np.sin(5 * along + k), np.cos(4 * along - k)], axis=1)
        rods.append(jiggled(chain(tangents, [0, 0.3, 1], 3.0, spin=2 * along), rng, 0.05))
    table = stacked(rods)
    clamps = clamps_at(stacked(rods))
    shape = np.eye(2) if kind == "isotropic" else np.array([[1.0, 0.2], [0.2, 0.5]])
    bend = np.geomspace(5e4, 1e7, 5)[:, None, None] * shape
    material = Material(bend, 1.5e5, 1.0)
    rows = rng.integers(0, [6, 5], size=(4096, 2))
    probes = [0, 1, 777, 2048, 4095]
    rows[probes] = [3, 2]
    batch = relax(
        table, material, clamps, precision=precision, configuration_index=rows[:, 0], material_index=rows[:, 1])
    alone = relax(table.take([3]), Material(bend[2:3], 1.5e5, 1.0), clamps.take([3]), precision=precision)
    pair = relax(table, material, clamps, precision=precision, configuration_index=[5, 3], material_index=[4, 2])
    for place in probes:
        for one, at in ((alone, 0), (pair, 1)):
            np.testing.assert_array_equal(batch.configuration.quaternions[place], one.configuration.quaternions[at])
            for name in FIELDS:
                np.testing.assert_array_equal(getattr(batch, name)[place], getattr(one, name)[at], err_msg=name)
