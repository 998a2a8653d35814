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
    before = results[rows]
    springs = _Springs(table, rows, Surroundings(bodies, table.contact.radius).take(rows))
    frames[rows] = whole_start(table.start[springs.of_start], table.clamp[springs.of_start])
    results[rows, of.DRIFT:] = 0.0
    stuck = np.ones(len(rows), dtype=bool)
    for number in range(ROUNDS):
        springs.pull(frames, results, stuck, CLEARANCE + FURTHER * number)
        least = (LEAST - 1.0) * np.reshape(springs.around.radius, -1)  # the centreline is inside, or hardly outside
        stuck &= ~(springs.around.smallest_gap(springs.vertices(frames, results)) > least)
        if not stuck.any():
            break
    results[rows[stuck]], frames[rows[stuck]] = before[stuck], np.nan
    return rows[~stuck]


class _Springs:
    """The rods ``rows`` of ``table`` as limp rods under springs, and the obstacles ``around`` them."""

    def __init__(self, table: Tables, rows: np.ndarray, around: Surroundings):
        self.rows, self.around = rows, around
        self.of_start = table.configuration_index[rows]
        self.anchor = table.anchor[self.of_start]
        self.lengths = np.broadcast_to(table.rest_length, (len(table.start), table.edges))[self.of_start]
        self.stiffness = 1.0 / self.lengths.mean(axis=1) ** 3
        index = np.zeros(table.count, dtype=np.int64)
        index[rows] = np.arange(len(rows))
        limp = Material(1.0, 1.0, 0.0)
        self.limp = replace(
            table, contact=None, external_index=index, material=material_table(limp, table.edges), isotropic=limp.isotropic,
            material_index=np.zeros(table.count, dtype=np.int64))

    def vertices(self, frames: np.ndarray, results: np.ndarray) -> np.ndarray:
        """(N, V, 3) mm."""
        start = self.anchor + results[self.rows, of.DRIFT:]
        return vertices_from_quaternions(start, frames[self.rows], self.lengths)

    def pull(self, frames: np.ndarray, results: np.ndarray, stuck: np.ndarray, clearance: float) -> None:
        """Relax the rods that are ``stuck`` (N,), in place, under springs to the nearest places outside, so many radii away."""
        places = self.vertices(frames, results)
        away = clearance * np.reshape(self.around.radius, (-1, 1))
        pushed = np.zeros(places.shape[:2], dtype=bool)
        for obstacle in self.around.bodies:
            distance, normal = obstacle.distance(places)
            pushed |= distance < away
            places = places + np.maximum(away - distance, 0.0)[..., None] * normal
        stiffness = self.stiffness[:, None] * np.where(pushed, PUSHING, HOLDING)
        limp = replace(self.limp, external=Springs(places, stiffness))
        usable = np.ones(limp.count, dtype=bool)
        batch.continue_newton(limp, Newton(tolerance=1e-5), 64, frames, results, self.rows[stuck], usable)
