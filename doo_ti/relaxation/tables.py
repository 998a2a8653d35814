"""What the kernels read: starts, clamps, materials and rods as plain tables, checked and laid out (§III-B).

A rod is a pair (configuration, material) of rows in two tables, so a sweep of D observations over G cells sends D starts
and G materials, not D·G of each.
"""

from dataclasses import dataclass, replace

import numpy as np

from doo_ti.errors import InputError
from doo_ti.relaxation.checked_input import (
    check_material,
    check_shapes,
    clamp_kinds,
    external_rows,
    paired_rows,
    rest_lengths,
)
from doo_ti.relaxation.clamp_kernel import INFEASIBLE
from doo_ti.relaxation.clamp_table import clamp_table, outer_edges, whole_start
from doo_ti.relaxation.columns import (
    ANCHOR,
    BEND,
    CLOSED,
    ENDS,
    FREE,
    FROM_RESULTS,
    LARGEST_BEND,
    LOOSE,
    MOST_NUMBERS,
    OF_CLAMP,
    OF_EXTERNAL,
    OF_MATERIAL,
    OF_RESULT,
    OF_START,
    RELEASED,
    REST,
    ROD_COLUMNS,
    ROUND,
    STIFFEST,
    STIFFNESS,
    STIFFNESS_COLUMNS,
    TARGET,
    TWIST,
    WEIGHT,
)
from doo_ti.relaxation.external import External
from doo_ti.relaxation.memory import room
from doo_ti.relaxation.prepared_start import prepared
from doo_ti.types import Clamps, Configuration, Material


@dataclass(frozen=True)
class Tables:
    """What the kernels read, all float64 and C-contiguous but ``rods``.

    start (S, E, 4) frames as given, of any length, whose ends the clamps turn to what they hold; rest_length (1 or S, E);
    clamp (S, CLAMP_COLUMNS); material (G, STIFFNESS + 1 or E · STIFFNESS_COLUMNS), isotropic: all of them are;
    rods (feasible ones, ROD_COLUMNS) int32, each from its start; feasible (S,) bool;
    configuration_index, material_index and external_index (R,), infeasible rods included; external the external energy,
    or None; up (3,); floating: some rod has both ends free.
    """

    start: np.ndarray
    rest_length: np.ndarray
    clamp: np.ndarray
    material: np.ndarray
    isotropic: bool
    rods: np.ndarray
    feasible: np.ndarray
    configuration_index: np.ndarray
    material_index: np.ndarray
    external_index: np.ndarray
    external: External | None
    up: np.ndarray
    floating: bool

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

    @property
    def weight(self) -> np.ndarray:
        """(G,) μ."""
        return self.material[:, WEIGHT]

    @property
    def bend(self) -> np.ndarray:
        """(G, 1 or E, 3) B as (11, 22, 12), mm³."""
        return np.ascontiguousarray(_edges(self.material)[..., BEND : BEND + 3])

    @property
    def twist(self) -> np.ndarray:
        """(G, 1 or E−1) β, mm³."""
        return np.ascontiguousarray(_joints(self.material)[..., TWIST])

    @property
    def rest(self) -> np.ndarray:
        """(G, 1 or E−1, 2) ω̄, 1/mm."""
        return np.ascontiguousarray(_joints(self.material)[..., REST : REST + 2])

    @property
    def whole(self) -> np.ndarray:
        """(S, E, 4) starts, normalised and with their ends imposed."""
        return whole_start(self.start, self.clamp)

    def continued(self, usable: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """``rods`` for another launch over the feasible ones of ``rows``: from their frames where ``usable`` (R,), else from
        their starts."""
        good = rows[self.feasible[self.configuration_index[rows]]]
        of_start = self.configuration_index[good]
        origin = np.where(usable[good], FROM_RESULTS, of_start)
        return _rods(of_start, self.material_index[good], good, origin, self.external_index[good])

    def resumed(self, usable: np.ndarray) -> np.ndarray:
        """``rods`` for a launch over other starts, one for each row of the results: from there where ``usable`` (R,), else
        from the frames in that row."""
        rods = self.rods.copy()
        rows = rods[:, OF_RESULT]
        rods[:, OF_START] = np.where(usable[rows], rows, FROM_RESULTS)
        return rods

    def under(self, material: Material, index=None) -> "Tables":
        """The same rods under another material: one row for each, one for all, or as many as before, each in the place of
        what was there; or as ``index`` (R,) says.

        Raises InputError where they do not match.
        """
        check_material(material, self.edges, self.floating and self.external is None)
        if index is None and material.count not in (1, self.count):
            index = self.material_index
            if material.count != len(self.material):
                raise InputError("relax", "material", f"{material.count} rows for {self.count} rods",
                                 "give one, one per rod, as many as before, or material_index")
        rows = np.arange(self.count) % material.count if index is None else np.asarray(index)
        if rows.shape != (self.count,):
            raise InputError("relax", "material_index", f"shape {rows.shape}", f"give ({self.count},) row numbers")
        _, rows = paired_rows(len(self.start), material.count, self.configuration_index, rows)
        isotropic = material.is_isotropic
        table = _material_table(material, isotropic, self.edges)
        rods = self.rods.copy()
        rods[:, OF_MATERIAL] = rows[rods[:, OF_RESULT]]
        return replace(self, material=table, isotropic=isotropic, material_index=rows, rods=rods)

    def restarted(self, frames: np.ndarray) -> "Tables":
        """The same rods with a start each, ``frames`` (R, E, 4); infeasible ones keep what they had."""
        of_start = self.configuration_index
        feasible = self.feasible[of_start]
        lengths = self.rest_length
        start = np.ascontiguousarray(np.where(feasible[:, None, None], frames, self.start[of_start]))
        clamp = self.clamp[of_start]
        clamp[:, ENDS:] = start[:, outer_edges(self.edges)].reshape(-1, 8)
        rods = self.rods.copy()
        rods[:, OF_CLAMP] = rods[:, OF_START] = rods[:, OF_RESULT]
        return replace(
            self, start=start, rest_length=lengths if len(lengths) == 1 else lengths[of_start], clamp=clamp, rods=rods,
            feasible=feasible, configuration_index=np.arange(self.count))


def _rods(of_clamp, of_material, of_result, of_start, of_external) -> np.ndarray:
    """(R, ROD_COLUMNS) int32 from its columns."""
    rods = np.empty((len(of_result), ROD_COLUMNS), dtype=np.int32)
    rods[:, OF_CLAMP], rods[:, OF_MATERIAL], rods[:, OF_RESULT] = of_clamp, of_material, of_result
    rods[:, OF_START], rods[:, OF_EXTERNAL] = of_start, of_external
    return rods


def tables(
    configuration: Configuration, material: Material, clamps: Clamps, up: np.ndarray,
    configuration_index=None, material_index=None, external: External | None = None, external_index=None,
) -> Tables:
    """Check what goes into F and lay it out for the kernels.

    Raises InputError where shapes do not match, an index is out of range, or both ends of a rod with weight are free that no
    external energy holds.
    """
    check_shapes(configuration, clamps)
    count, edges = configuration.count, configuration.edges
    lengths = rest_lengths(configuration)
    index_c, index_m = paired_rows(count, material.count, configuration_index, material_index)
    rods = len(index_c)
    if max(count, rods) * edges * 4 > MOST_NUMBERS:
        raise InputError("relax", "configuration", f"{max(count, rods):,} rods of {edges} edges in one call",
                         f"give at most {MOST_NUMBERS // (4 * edges):,} at a time")
    index_e = external_rows(external, external_index, rods, edges)
    kinds = clamp_kinds(clamps, count)
    floating = not kinds.any(axis=1).all()
    check_material(material, edges, floating and external is None)
    isotropic = material.is_isotropic
    clamp, found = clamp_table(configuration, lengths, kinds, clamps)
    if external is not None:
        _loosen(clamp, kinds, configuration, clamps)
    start = prepared(np.ascontiguousarray(configuration.quaternions, dtype=np.float64), lengths, clamp, found, up)
    feasible = found != INFEASIBLE
    sound = feasible[index_c]
    all_rods = _rods(index_c, index_m, np.arange(rods), index_c, index_e)
    return Tables(
        start=start,
        rest_length=lengths,
        clamp=clamp,
        material=_material_table(material, isotropic, edges),
        isotropic=isotropic,
        rods=all_rods if sound.all() else all_rods[sound],
        feasible=feasible,
        configuration_index=index_c,
        material_index=index_m,
        external_index=index_e,
        external=external,
        up=up,
        floating=floating,
    )


def _loosen(clamp: np.ndarray, kinds: np.ndarray, configuration: Configuration, clamps: Clamps) -> None:
    """Have vertex 0 of rods whose start is free be an unknown, in place: an external energy may move it."""
    loose = np.flatnonzero(kinds[:, 0] == FREE)
    held = kinds[loose, 1] != FREE
    anchor = np.asarray(configuration.start, dtype=np.float64)[loose]
    clamp[loose, LOOSE], clamp[loose, RELEASED], clamp[loose, CLOSED] = 1.0, 0.0, held
    clamp[loose[:, None], np.arange(ANCHOR, ANCHOR + 3)] = anchor
    line = np.where(held[:, None], np.asarray(clamps.end_position)[loose] - anchor, 0.0)
    clamp[loose[:, None], np.arange(TARGET, TARGET + 3)] = line


def _edges(material: np.ndarray) -> np.ndarray:
    """(G, 1 or E, STIFFNESS_COLUMNS), the part of the material table that may change along the rod, as a view."""
    return material[:, STIFFNESS:].reshape(len(material), -1, STIFFNESS_COLUMNS)


def _joints(material: np.ndarray) -> np.ndarray:
    """(G, 1 or E−1, STIFFNESS_COLUMNS), the same without the first edge, at which there is no joint."""
    edges = _edges(material)
    return edges[:, 1:] if edges.shape[1] > 1 else edges


def _material_table(material: Material, isotropic: bool, edges: int) -> np.ndarray:
    """(G, STIFFNESS + 1 or E · STIFFNESS_COLUMNS): see the columns' names. Raises InputError where that is too large."""
    bend, twist, rest = material.bend, material.twist, material.rest_curvature
    uniform = bend.shape[1] == twist.shape[1] == 1 and (rest is None or rest.shape[1] == 1)
    columns = STIFFNESS + (1 if uniform else edges) * STIFFNESS_COLUMNS
    if material.count * columns > MOST_NUMBERS:
        raise InputError("relax", "material", f"{material.count:,} rows in one call",
                         f"give at most {MOST_NUMBERS // columns:,} at a time")
    table = room(material.count, columns)
    table[:] = 0.0
    along, joints = _edges(table), _joints(table)
    first, second, mixed = bend[..., 0, 0], bend[..., 1, 1], bend[..., 0, 1]
    along[..., BEND], along[..., BEND + 1], along[..., BEND + 2] = first, second, mixed
    joints[..., TWIST] = twist
    largest, table[:, ROUND] = first, 1.0
    if not isotropic:
        half, apart = 0.5 * (first + second), 0.5 * (first - second)
        largest = half + np.hypot(apart, mixed)
        table[:, ROUND] = ((apart == 0) & (mixed == 0)).all(axis=1)
    if rest is not None:
        joints[..., REST : REST + 2] = rest
        table[:, ROUND] *= (rest == 0).all(axis=(1, 2))
    table[:, WEIGHT] = material.weight
    table[:, LARGEST_BEND] = largest.max(axis=1)
    table[:, STIFFEST] = np.maximum(table[:, LARGEST_BEND], twist.max(axis=1))
    return table
