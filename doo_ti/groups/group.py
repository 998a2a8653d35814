"""A group: rods that are relaxed together, each with its own material and clamps, and with points tied together
(docs/groups.md). Axes: N groups of the same make-up, G rods in each, K ties."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from doo_ti.rod.types import Clamps, Configuration, Material, Rows
from doo_ti.system.arguments import typed
from doo_ti.system.errors import InputError, real_array


@typed
@dataclass(frozen=True)
class Tie:
    """Two vertices that stay at one place.

    first, second  (rod, vertex), from 0; a vertex below 0 counts from the rod's end
    weight         of what sits at the tie, a connector, in the unit of all forces: energy (mm²) per mm, or N over the
                   :attr:`.Material.newton` of the group's first material
    weld           whether the edges that begin there, at a rod's last vertex the one that ends there, also keep the rotation
                   that they have to each other at the start; otherwise the rods turn freely there

    Raises InputError for anything else.
    """

    first: tuple[int, int]
    second: tuple[int, int]
    weight: float = 0.0
    weld: bool = False

    def __post_init__(self) -> None:
        if not 0 <= self.weight < np.inf:
            raise InputError("Tie", "weight", f"{self.weight}", "give a finite number from zero up")


@typed
@dataclass(frozen=True)
class Group:
    """N groups of G rods, what :func:`.relax_group` takes.

    rods       G starts, each with the N groups' rods of that place: N rows. They need not have equally many edges
    materials  G of them, with one row or N; or one for all rods. Either all have a weight per length in N/m, or none. All
               forces and energies of the group are then in the unit of its first material, which is ``group.newton`` N
    clamps     G of them, with N rows
    ties       K of them; the groups have the same

    Raises InputError where numbers of rods or rows do not match, a tie names a vertex that does not exist, or some materials
    have a weight per length and others not.
    """

    rods: Sequence[Configuration]
    materials: Sequence[Material] | Material
    clamps: Sequence[Clamps]
    ties: Sequence[Tie] = ()

    def __post_init__(self) -> None:
        if not len(self.rods):
            raise InputError("Group", "rods", "none", "give one or more")
        for name, values in (("clamps", self.clamps), ("materials", self._given)):
            if len(values) != len(self.rods):
                raise InputError("Group", name, f"{len(values)} for {len(self.rods)} rods", "give one for each rod of a group")
        rows = self.rods[0].count
        for rod, (start, material) in enumerate(zip(self.rods, self._given, strict=True)):
            if start.count != rows:
                raise InputError("Group", "rods", f"{start.count} rows of rod {rod}, {rows} of rod 0",
                                 "give one row for each group")
            if material.count not in (1, rows):
                raise InputError("Group", "materials", f"{material.count} rows of rod {rod} for {rows} groups",
                                 "give one, or one for each group")
            if (material.newton is None) != (self.newton is None):
                with_it, without = (0, rod) if material.newton is None else (rod, 0)
                raise InputError("Group", "materials", f"that of rod {with_it} has a weight per length in N/m, that of rod "
                                 f"{without} is relative to weight", "give all of them with a weight per length, or none")
        for number, tie in enumerate(self.ties):
            self._check_tie(number, tie)

    def _check_tie(self, number: int, tie: Tie) -> None:
        for rod, vertex in (tie.first, tie.second):
            if not 0 <= rod < len(self.rods):
                raise InputError("Group", "ties", f"tie {number} is at rod {rod}", f"give rods from 0 to {len(self.rods) - 1}")
            most = self.rods[rod].edges
            if not -most - 1 <= vertex <= most:
                raise InputError("Group", "ties", f"tie {number} is at vertex {vertex} of rod {rod}",
                                 f"give vertices from 0 to {most}")
        if self.tied[number, 0] == self.tied[number, 1]:
            raise InputError("Group", "ties", f"tie {number} ties vertex {tie.first[1]} of rod {tie.first[0]} to itself",
                             "give two vertices")
        if tie.weld and len(set(self.welded[number])) == 1:
            raise InputError("Group", "ties", f"tie {number} welds edge {tie.first[1]} of rod {tie.first[0]} to itself",
                             "give vertices of two edges")

    def __repr__(self) -> str:
        edges = ", ".join(str(rod.edges) for rod in self.rods)
        return f"Group({self.count} groups of {len(self.rods)} rods of {edges} edges, {len(self.ties)} ties)"

    @property
    def count(self) -> int:
        """N, the number of groups."""
        return self.rods[0].count

    @property
    def _given(self) -> list[Material]:
        return [self.materials] * len(self.rods) if isinstance(self.materials, Material) else list(self.materials)

    @property
    def newton(self) -> np.ndarray | None:
        """(1 or N,) N that the unit of all forces is. None where weights per length are not known."""
        return self._given[0].newton

    @property
    def each_material(self) -> list[Material]:
        """G of them, all in the unit of the first."""
        if self.newton is None:
            return self._given
        return [material.with_unit(self.newton) for material in self._given]

    @property
    def units(self) -> list[np.ndarray]:
        """G times (1 or N,) the units of energy in which the materials are given, over that of the first."""
        return [np.ones(1) if self.newton is None else material.newton / self.newton for material in self._given]

    @property
    def first_vertices(self) -> np.ndarray:
        """(G + 1,) the number of each rod's vertex 0 in the group, and of all vertices."""
        return np.cumsum([0] + [rod.edges + 1 for rod in self.rods])

    @property
    def rod_of(self) -> np.ndarray:
        """(vertices of the group,) the number of each vertex's rod."""
        return np.repeat(np.arange(len(self.rods)), np.diff(self.first_vertices))

    @property
    def tied(self) -> np.ndarray:
        """(K, 2) the numbers of both vertices of each tie in the group."""
        first = self.first_vertices
        return np.array([[first[rod] + vertex % (self.rods[rod].edges + 1) for rod, vertex in (tie.first, tie.second)]
                         for tie in self.ties], dtype=np.int64).reshape(-1, 2)

    @property
    def welded(self) -> dict[int, tuple[int, int]]:
        """The numbers of both edges in the chain of the group, the later first, of each tie that is a weld, by its number."""
        last = self.first_vertices[1:] - 1
        edges = np.sort(self.tied - np.isin(self.tied, last), axis=1)[:, ::-1]
        return {number: (int(edges[number, 0]), int(edges[number, 1])) for number, tie in enumerate(self.ties) if tie.weld}

    def radii(self, radius: ArrayLike) -> np.ndarray:
        """(1 or N, G) mm of the rods, where ``radius`` is as :func:`.relax_group` has it. Raises InputError for other shapes,
        and numbers that are not positive."""
        values = real_array("relax_group", "radius", radius, "give mm").astype(np.float64)
        values = values.reshape(-1, 1) if values.ndim < 2 else values
        rods = len(self.rods)
        if values.ndim > 2 or len(values) not in (1, self.count) or values.shape[1] not in (1, rods):
            raise InputError("relax_group", "radius", f"shape {np.shape(radius)} for {self.count} groups of {rods} rods",
                             "give one number of mm, (N,), or (1 or N, G) with one for each rod of a group")
        if not ((values > 0) & (values < np.inf)).all():
            raise InputError("relax_group", "radius", f"{values.min():g}", "give positive numbers of mm")
        return np.broadcast_to(values, (len(values), rods))

    def at_vertices(self, values: np.ndarray) -> np.ndarray:
        """(R, vertices of the group) of ``values`` (R, G) of the rods."""
        return np.repeat(values, np.diff(self.first_vertices), axis=1)

    def by_rod(self, values: np.ndarray) -> tuple[np.ndarray, ...]:
        """``values`` (N, vertices of the group, ...) of each rod."""
        return tuple(np.split(values, self.first_vertices[1:-1], axis=1))

    def take(self, index: Rows) -> "Group":
        """The groups named by ``index``, in that order."""
        materials = [material if material.count == 1 else material.take(index) for material in self.each_material]
        return replace(self, rods=[rod.take(index) for rod in self.rods], materials=materials,
                       clamps=[clamp.take(index) for clamp in self.clamps])
