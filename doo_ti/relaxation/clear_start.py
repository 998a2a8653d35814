"""Starts that are inside an obstacle, by the noise of marks or by a guess, are moved out of it (docs/contact.md).

Springs pull every vertex of such a rod to where it is or, where that is inside, to the nearest place outside; the rod relaxes
under them as a limp, weightless one, without obstacles and between its own clamps. Its length may carry vertices in again:
this is repeated until the centreline is outside.
"""

from dataclasses import replace

import numpy as np

from doo_ti.contact.surroundings import Surroundings
from doo_ti.relaxation import batch
from doo_ti.relaxation import tables as of
from doo_ti.relaxation.external import Springs
from doo_ti.relaxation.input_tables import material_table
from doo_ti.relaxation.newton import Newton
from doo_ti.relaxation.tables import Tables, whole_start
from doo_ti.rod.frames import vertices_from_quaternions
from doo_ti.rod.material import Material
from doo_ti.rod.types import Status

ROUNDS = 24
PUSHING, HOLDING = 100.0, 1e-2  # stiffness of a spring over B/l³, of a vertex that is inside and of others
CLEARANCE, FURTHER = 1.05, 0.5
"""Radii from the centreline to an obstacle to which vertices are pulled, and how many more in each round."""
LEAST = 0.1  # radii: a centreline that is so far outside is clear


def move_out(table: Tables, frames: np.ndarray, results: np.ndarray) -> np.ndarray:
    """Of the rods of ``table`` that are infeasible (``results``) though their clamps are not, the rows (N,) of those whose
    starts could be moved out of the obstacles. Their moved starts are in ``frames`` and ``results`` then."""
    inside = (results[:, of.STATUS] == int(Status.INFEASIBLE)) & table.feasible[table.configuration_index] & table.contact.near
    rows = np.flatnonzero(inside)
    bodies = table.contact.surroundings.bodies
    if not len(rows) or not bodies:
        return rows[:0]
    around, of_start = Surroundings(bodies, table.contact.radius).take(rows), table.configuration_index[rows]
    lengths = np.broadcast_to(table.rest_length, (len(table.start), table.edges))[of_start]
    index = np.zeros(table.count, dtype=np.int64)
    index[rows] = np.arange(len(rows))
    material = Material(1.0, 1.0, 0.0)
    limp = replace(table, contact=None, external_index=index, material=material_table(material, table.edges),
                   isotropic=material.isotropic, material_index=np.zeros(table.count, dtype=np.int64))
    before, stuck, usable = results[rows], np.ones(len(rows), dtype=bool), np.ones(table.count, dtype=bool)
    frames[rows] = whole_start(table.start[of_start], table.clamp[of_start])
    results[rows, of.DRIFT:] = 0.0
    least = (LEAST - 1.0) * np.reshape(around.radius, -1)  # the centreline is inside, or hardly outside

    def vertices() -> np.ndarray:
        start = table.anchor[of_start] + results[rows, of.DRIFT:]
        return vertices_from_quaternions(start, frames[rows], lengths)

    for number in range(ROUNDS):
        springs = _springs(vertices(), around, CLEARANCE + FURTHER * number, lengths)
        batch.continue_newton(replace(limp, external=springs), Newton(tolerance=1e-5), 64, frames, results, rows[stuck], usable)
        stuck &= ~(around.smallest_gap(vertices()) > least)
        if not stuck.any():
            break
    results[rows[stuck]], frames[rows[stuck]] = before[stuck], np.nan
    return rows[~stuck]


def _springs(places: np.ndarray, around: Surroundings, clearance: float, lengths: np.ndarray) -> Springs:
    """Of rods with vertices at ``places`` (N, V, 3), to the nearest places outside all obstacles, so many radii away."""
    away = clearance * np.reshape(around.radius, (-1, 1))
    pushed = np.zeros(places.shape[:2], dtype=bool)
    for obstacle in around.bodies:
        distance, normal = obstacle.distance(places)
        pushed |= distance < away
        places = places + np.maximum(away - distance, 0.0)[..., None] * normal
    stiffness = 1.0 / lengths.mean(axis=1, keepdims=True) ** 3
    return Springs(places, stiffness * np.where(pushed, PUSHING, HOLDING))
