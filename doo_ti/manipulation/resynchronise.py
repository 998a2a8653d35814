"""The model of a rod that has snapped, from what is seen of it. Axes: B rods, V vertices."""

import numpy as np

from doo_ti.manipulation.poses import finite_rods
from doo_ti.relaxation.external import Springs
from doo_ti.relaxation.newton import Newton
from doo_ti.relaxation.relax import relax
from doo_ti.rod.types import Clamps, Configuration, Material, Solution

PULL = 30.0
"""Stiffness of a spring over B/s³, s the rod's length between marks: it draws a mark to a thirtieth of what bending between its
neighbours leaves. With 3 shapes of the old branch remain, with 300 noise bends the rod."""


def between_marks(values: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """(B, V, 3) ``values`` at vertices that are ``seen`` (B, V), linear between them, and constant beyond the outermost ones;
    zero where none is seen."""
    count = seen.shape[1]
    number = np.arange(count)
    before = np.maximum.accumulate(np.where(seen, number, -1), axis=1)
    after = np.minimum.accumulate(np.where(seen, number, count)[:, ::-1], axis=1)[:, ::-1]
    before, after = np.where(before < 0, after, before), np.where(after >= count, before, after)
    rods = np.arange(len(seen))[:, None]
    before, after = np.clip(before, 0, count - 1), np.clip(after, 0, count - 1)
    share = ((number - before) / np.maximum(after - before, 1))[..., None]
    known = np.where(seen[..., None], values, 0.0)
    return (1 - share) * known[rods, before] + share * known[rods, after]


def stiffness_of(material: Material, rest_length: np.ndarray, visible: np.ndarray) -> np.ndarray:
    """(B,) of the springs that draw vertices to marks (B, V) that are ``visible``."""
    spacing = rest_length.sum() / np.maximum(visible.sum(axis=1) - 1, 1)
    middle = material.bend.shape[1] // 2
    return PULL * material.bend[:, middle, 0, 0] / spacing**3


def resynchronised(rods: Configuration, material: Material, clamps: Clamps, seen: np.ndarray, up: np.ndarray, **around
                   ) -> Solution:
    """The B rods at rest on the branch that is nearest to the marks ``seen`` (B, V, 3) mm, NaN where not seen: drawn to them by
    springs, then let go."""
    visible = np.isfinite(seen).all(axis=-1)
    springs = Springs(np.where(visible[..., None], seen, 0.0),
                      visible * stiffness_of(material, rods.rest_length, visible)[:, None])
    index = np.arange(rods.count)
    drawn = relax(rods, material, clamps, Newton.careful(), up=up, external=springs, external_index=index, **around)
    return relax(finite_rods(drawn.configuration, rods), material, clamps, Newton.careful(), up=up, **around)
