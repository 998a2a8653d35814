"""The tables that host and kernels share, by the names of their columns, and the memory that they lie in (§III-B).

A rod is a pair (configuration, material) of rows in two tables, so a sweep of D observations over G cells sends D starts
and G materials, not D·G of each.
"""

import sys
from dataclasses import dataclass
from itertools import product
from math import prod
from threading import Lock

import numpy as np

from doo_ti.relaxation.external import External
from doo_ti.rod.types import Clamp

# As plain numbers, which NumPy compares ten times faster than members of an enumeration.
FREE, POSITION, TANGENT, FRAME = (int(kind) for kind in Clamp)

# Columns of a clamp.
TARGET, CLOSED, SPIN_START, SPIN_END, TILT_START, TILT_END, TILT_INNER, RELEASED = 0, 3, 4, 5, 6, 7, 8, 9
TOTAL, LONGEST, SHORTEST_PAIR, HANGING, ANCHOR, LOOSE, ENDS, CLAMP_COLUMNS = 10, 11, 12, 13, 14, 17, 18, 26
"""TARGET          the far point from vertex 0, mm
SPIN_, TILT_    one where that rotation of the first edge, of the last or of those between is unknown
TOTAL, LONGEST, SHORTEST_PAIR  mm: the rod, its longest edge, its shortest two neighbours
HANGING         mm²: the largest moment arm of gravity on an edge, times a length
ANCHOR          the point the chain hangs from, mm
ENDS            the first frame and the last as the clamps hold them

    start  far end  CLOSED  RELEASED  the chain hangs from
    held   held     1       0         vertex 0; closure brings the far end to its clamp
    held   free     0       0         vertex 0
    free   held     0       1         the far end
    free   free     0       0         vertex 0, where it is: only without weight or under an external energy

Under an external energy or among obstacles, which move vertex 0, a free start is LOOSE instead of RELEASED, and CLOSED where
the far end is held."""

# Columns of a material: of the rod, and its stiffness, once or edge by edge.
WEIGHT, LARGEST_BEND, STIFFEST, SOFTEST, ROUND, STIFFNESS = 0, 1, 2, 3, 4, 5
BEND, TWIST, REST, STIFFNESS_COLUMNS = 0, 3, 4, 6
"""LARGEST_BEND, STIFFEST, SOFTEST  the largest eigenvalue of B; that or β, if more; the smallest eigenvalue or β, if less
ROUND                            one where the rod looks the same from all sides: it may spin about itself at no cost
BEND                             B as (11, 22, 12)
TWIST, REST                      β and ω̄ of the inner vertex where the edge begins"""

# Columns of a rod: its rows of the other tables; START_ROW is FROM_RESULTS where it starts from the frames in RESULT_ROW.
CLAMP_ROW, MATERIAL_ROW, RESULT_ROW, START_ROW, EXTERNAL_ROW, ROD_COLUMNS = 0, 1, 2, 3, 4, 5
FROM_RESULTS = -1

# Columns of a rod's results.
ENERGY, RESIDUAL, CLOSURE, ITERATIONS, STATUS, STABLE, FORCE, ALONG, RESULTS = 0, 1, 2, 3, 4, 5, 6, 9, 10
DRIFT, LOADED_RESULTS = RESULTS, RESULTS + 3
"""FORCE  −λ, which holds the far end
ALONG  min over all edges of t·n, n the unit vector from one end to the other: the smaller of those at the start and at the
       end of the relaxation; where an edge has pointed backwards on the way, t·n < 0, the smallest on the way
DRIFT  under an external energy, how far vertex 0 has moved from the anchor, mm: in where a rod starts, and out"""

MOST_NUMBERS = 2**31 - 1  # a table has no more entries: the kernels count them with 32 bits

POOLED_BYTES = 1 << 30  # arrays no longer in use are kept up to this size
SMALLEST = 1 << 14  # numbers below which an array takes no pages of its own

pool: list[np.ndarray] = []
_pool_lock = Lock()


def room(*shape: int) -> np.ndarray:
    """An uninitialised f64 array, where it fits in memory of an earlier one that nothing refers to any more, not even a view: a
    fresh page costs as much as a rod's step."""
    size = prod(shape)
    if size < SMALLEST:
        return np.empty(shape)
    with _pool_lock:
        for kept in pool:
            # Held by the pool, by this loop and by the call only.
            if size <= kept.size <= 2 * size and sys.getrefcount(kept) == 3:
                return kept[:size].reshape(shape)
        fresh = np.empty(size)
        pool.append(fresh)
        while sum(kept.nbytes for kept in pool) > POOLED_BYTES:
            pool.pop(0)
        return fresh.reshape(shape)


@dataclass(frozen=True)
class Tables:
    """What the kernels read, all float64 and C-contiguous but ``rods``.

    start (S, E, 4) frames as given, of any length, whose ends the clamps turn to what they hold; rest_length (1 or S, E);
    clamp (S, CLAMP_COLUMNS); material (G, STIFFNESS + 1 or E · STIFFNESS_COLUMNS), isotropic (G,) bool, the kernel of each;
    rods (feasible ones, ROD_COLUMNS) int32, each from its start; feasible (S,) bool;
    configuration_index, material_index and external_index (R,), infeasible rods included; external the external energy,
    or None; up (3,); floating: some rod has both ends free; contact (a ``ContactTable``) with obstacles, or None;
    weight_per_length (G,) N/m, None where it is not known.
    """

    start: np.ndarray
    rest_length: np.ndarray
    clamp: np.ndarray
    material: np.ndarray
    isotropic: np.ndarray
    rods: np.ndarray
    feasible: np.ndarray
    configuration_index: np.ndarray
    material_index: np.ndarray
    external_index: np.ndarray
    external: External | None
    up: np.ndarray
    floating: bool
    contact: object = None
    weight_per_length: np.ndarray | None = None

    @property
    def spins_held(self) -> np.ndarray:
        """(S,) whether clamps hold the frames at both ends, so that neither can turn about its tangent."""
        return (self.clamp[:, SPIN_START] == 0) & (self.clamp[:, SPIN_END] == 0)

    @property
    def loaded(self) -> bool:
        """Whether an external energy or a contact may move vertex 0."""
        return self.external is not None or self.contact is not None

    @property
    def edges(self) -> int:
        return self.start.shape[1]

    @property
    def count(self) -> int:
        """R."""
        return len(self.configuration_index)

    @property
    def released(self) -> np.ndarray:
        return self.clamp[:, RELEASED] > 0

    @property
    def anchor(self) -> np.ndarray:
        """(S, 3) mm."""
        return self.clamp[:, ANCHOR : ANCHOR + 3]

    def continued(self, usable: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """``rods`` for another launch over the feasible of ``rows``: from their frames where ``usable`` (R,), else starts."""
        good = rows[self.feasible[self.configuration_index[rows]]]
        of_start = self.configuration_index[good]
        origin = np.where(usable[good], FROM_RESULTS, of_start)
        return rod_rows(of_start, self.material_index[good], good, origin, self.external_index[good])

    def by_material(self, rods: np.ndarray) -> list[tuple[bool, np.ndarray]]:
        """``rods`` (-, ROD_COLUMNS) parted by whether they are isotropic. A rod's own material decides which kernel takes it,
        so that its result does not depend on the others of a call."""
        return parted(rods, self.isotropic[rods[:, MATERIAL_ROW]])

    def by_kernel(self, rods: np.ndarray) -> list[tuple[bool, bool, np.ndarray]]:
        """``rods`` parted by the kernel that relaxes them: (isotropic, any_ends, rods), by their own materials and clamps.
        ``any_ends``: it has to know loose starts and, under an external energy or among obstacles, held far ends."""
        clamp = self.clamp[rods[:, CLAMP_ROW]]
        any_ends = clamp[:, LOOSE] > 0
        if self.external is not None:
            any_ends |= clamp[:, CLOSED] > 0
        if self.contact is not None:
            any_ends[:] = True
        return parted(rods, self.isotropic[rods[:, MATERIAL_ROW]], any_ends)


def parted(rods: np.ndarray, *flags: np.ndarray) -> list[tuple]:
    """(flags …, rods) of each combination of ``flags`` that some rods have."""
    parts = []
    for kind in product((True, False), repeat=len(flags)):
        own = np.all([flag == value for flag, value in zip(flags, kind, strict=True)], axis=0)
        if own.any():
            parts.append((*kind, rods if own.all() else rods[own]))
    return parts


def rod_rows(of_clamp, of_material, of_result, of_start, of_external) -> np.ndarray:
    """(R, ROD_COLUMNS) int32 from its columns."""
    rods = np.empty((len(of_result), ROD_COLUMNS), dtype=np.int32)
    rods[:, CLAMP_ROW], rods[:, MATERIAL_ROW], rods[:, RESULT_ROW] = of_clamp, of_material, of_result
    rods[:, START_ROW], rods[:, EXTERNAL_ROW] = of_start, of_external
    return rods


def outer_edges(edges: int) -> slice:
    """The first edge and the last."""
    return slice(None, None, edges - 1)


def whole_start(start: np.ndarray, clamp: np.ndarray) -> np.ndarray:
    """(S, E, 4) ``start`` normalised, with the frames of ``clamp`` at its ends."""
    result = start / np.linalg.norm(start, axis=-1, keepdims=True)
    result[:, outer_edges(start.shape[1])] = clamp[:, ENDS:].reshape(-1, 2, 4)
    return result
