"""Scalars, tables and pairs of rows: every way to specify the same rods gives the same bits."""

import numpy as np
import pytest

from doo_ti import Material, relax
from tests.conftest import check_refused
from tests.references.rods import clamps_at, jiggled
from tests.relaxation.rods import assert_same, wandering

EDGES, COUNT = 10, 6
B = np.array([[2e5, 3e4], [3e4, 1e5]])


@pytest.fixture
def rods(rng):
    shapes = wandering(rng, COUNT, EDGES)
    return jiggled(shapes, rng, 0.05), clamps_at(shapes)


def repeated(value, *counts: int) -> np.ndarray:
    return np.tile(np.asarray(value, dtype=float), (*counts, *(1,) * np.ndim(value)))


SAME = {
    "αI as a matrix": (Material(2e5, 1e5, 1.0), Material(2e5 * np.eye(2), 1e5, 1.0)),
    "α for each rod": (Material(2e5, 1e5, 1.0), Material(repeated(2e5, COUNT), 1e5, 1.0)),
    "all for each rod": (Material(2e5, 1e5, 1.0), Material(repeated(2e5, COUNT), repeated(1e5, COUNT), np.ones(COUNT))),
    "integers": (Material(2e5, 1e5, 1.0), Material(200_000, 100_000, 1)),
    "lists": (Material(2e5, 1e5, 1.0), Material([2e5], [1e5], [1.0])),
    "B for each rod": (Material(B, 1e5, 1.0), Material(repeated(B, COUNT), 1e5, 1.0)),
    "B for each edge": (Material(B, 1e5, 1.0), Material(repeated(B, COUNT, EDGES), 1e5, 1.0)),
    "B for each edge of any rod": (Material(B, 1e5, 1.0), Material(repeated(B, 1, EDGES), 1e5, 1.0)),
    "β for each vertex": (Material(B, 1e5, 1.0), Material(B, repeated(1e5, COUNT, EDGES - 1), 1.0)),
    "β for each vertex of any rod": (Material(B, 1e5, 1.0), Material(B, repeated(1e5, 1, EDGES - 1), 1.0)),
    "ω̄ for each rod": (Material(B, 1e5, 1.0, [0.01, -0.02]), Material(B, 1e5, 1.0, repeated([0.01, -0.02], COUNT))),
    "ω̄ for each vertex": (
        Material(B, 1e5, 1.0, [0.01, -0.02]), Material(B, 1e5, 1.0, repeated([0.01, -0.02], COUNT, EDGES - 1))),
    "diagonal": (Material(np.diag([2e5, 1e5]), 1e5, 1.0), Material.diagonal(2e5, 1e5, 1e5)),
    "diagonal for each rod": (
        Material(np.diag([2e5, 1e5]), 1e5, 1.0), Material.diagonal(repeated(2e5, COUNT), 1e5, repeated(1e5, COUNT)))}


@pytest.mark.parametrize("way", SAME)
def test_the_same_material_said_in_two_ways(rods, way):
    start, clamps = rods
    first, second = SAME[way]
    assert first.is_isotropic == second.is_isotropic
    solution = relax(start, first, clamps)
    assert solution.converged.all() and len(solution.energy) == COUNT
    assert_same(solution, slice(None), relax(start, second, clamps), slice(None))


def test_what_differs_along_the_rod_or_across_it_is_not_isotropic():
    along = np.linspace(1.0, 2.0, EDGES)
    for material in (Material(2e5 * along[None, :, None, None] * np.eye(2), 1e5), Material(2e5, 1e5 * along[None, 1:]),
                     Material(2e5, 1e5, 1.0, [0.01, 0.0]), Material(B, 1e5), Material([2e5 * np.eye(2), B], 1e5)):
        assert not material.is_isotropic


def test_pairs_of_rows(rods):
    start, clamps = rods
    material = Material([1e5, 2e5, 5e5], 1e5, 1.0)
    rows, cells = np.array([5, 0, 3, 3, 1]), np.array([2, 0, 1, 0, 2])
    pairs = relax(start, material, clamps, configuration_index=rows, material_index=cells)
    for place, (row, cell) in enumerate(zip(rows, cells, strict=True)):
        alone = relax(start.take([row]), Material(material.bend[cell, 0], 1e5, 1.0), clamps.take([row]))
        assert_same(pairs, [place], alone, [0])
    assert_same(relax(start, Material(2e5, 1e5, 1.0), clamps, configuration_index=rows), slice(None),
                relax(start.take(rows), Material(2e5, 1e5, 1.0), clamps.take(rows)), slice(None))
    one = start.take([4]), material, clamps.take([4])
    assert_same(relax(*one), slice(None), relax(*one, material_index=[0, 1, 2]), slice(None))
    none = relax(start, material, clamps, configuration_index=[], material_index=[])
    assert len(none.energy) == 0 and none.configuration.vertices.shape == (0, EDGES + 1, 3)


def test_one_index_alone_leaves_the_rows_of_the_other_table_one_to_one(rods):
    start, clamps = rods
    material, rows = Material(np.linspace(1e5, 5e5, COUNT), 1e5, 1.0), np.arange(COUNT)[::-1]
    turned = relax(start, material, clamps, configuration_index=rows)
    assert_same(turned, slice(None), relax(start.take(rows), material, clamps.take(rows)), slice(None))
    turned = relax(start, material, clamps, material_index=rows)
    assert_same(turned, slice(None), relax(start, material.take(rows), clamps), slice(None))
    for index in ({"configuration_index": [0, 1]}, {"material_index": [0, 1]}, {"material_index": [2]}):
        check_refused("rows for", relax, start, material, clamps, **index)
