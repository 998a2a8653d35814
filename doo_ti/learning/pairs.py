"""Pairs of observations, the terms of Eq. 3: from Γ^x the clamps move to C^y, with the weight w_xy (§III-E).

Axes: P pairs.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np

from doo_ti.io.arrays import read_arrays
from doo_ti.rod.observations import Observations
from doo_ti.rod.types import Clamp, Clamps
from doo_ti.system.arguments import typed
from doo_ti.system.errors import InputError
from doo_ti.system.files import write_whole

APART_DEG = 120.0  # difference of the end rotations of the paper's pairs (footnote 7)
SAME = 1e-6  # labels closer than this, in mm or degrees, are the same
HALF_TURN = np.radians(1.0)
"""rad: two frames that differ by half a turn, to within this, do not determine the direction of the turn."""
MOST_TURNS = 100  # of the far clamp, from one observation of a pair to the other
COLUMNS = ("from", "to", "weight", "rotation_deg")


@typed
@dataclass(frozen=True)
class Pairs:
    """The motions of Eq. 3.

    from_index  (P,) x: the observation that a rod starts from
    to_index    (P,) y: the one at which it ends, and with which it is compared
    weight      (P,) w_xy, zero or more: a pair of weight zero is not run
    rotation    (P,) rad by which the far frame turned, whole turns included, or None: the shortest rotation
    source      file or other origin, for messages

    Raises InputError for a pair of an observation with itself, one given twice, and weights that are negative or all zero.
    """

    from_index: Annotated[np.ndarray, "P"]
    to_index: Annotated[np.ndarray, "P"]
    weight: Annotated[np.ndarray, "P"]
    rotation: Annotated[np.ndarray | None, "P"] = None
    source: str = "pairs"

    def __post_init__(self) -> None:
        for name, kind in (("from_index", np.int64), ("to_index", np.int64), ("weight", float), ("rotation", float)):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, np.array(getattr(self, name), dtype=kind))
        ends = np.stack([self.from_index, self.to_index], axis=-1)
        if not len(ends):
            raise InputError(self.source, "from", "no pairs", "give at least one")
        alone = np.flatnonzero(self.from_index == self.to_index)
        if len(alone):
            raise InputError(self.source, "to", f"pair {alone[0]} leads from {ends[alone[0], 0]} to itself",
                             "give two different observations")
        _, first, times = np.unique(ends, axis=0, return_index=True, return_counts=True)
        if (times > 1).any():
            x, y = ends[first[times > 1][0]]
            raise InputError(self.source, "from, to", f"the pair {x}, {y} is given twice", "give each pair once")
        wrong = np.flatnonzero(~(np.isfinite(self.weight) & (self.weight >= 0)))
        if len(wrong):
            raise InputError(self.source, "weight", f"{self.weight[wrong[0]]:g} of pair {wrong[0]}", "give zero or more")
        if not (self.weight > 0).any():
            raise InputError(self.source, "weight", "all are zero", "give at least one pair a positive weight")
        if self.rotation is not None and not (np.abs(self.rotation) <= 2 * np.pi * MOST_TURNS).all():
            raise InputError(self.source, "rotation_deg", f"not finite, or more than {MOST_TURNS} turns",
                             "give degrees for each pair, or leave the column out")

    @property
    def count(self) -> int:
        """P, the number of pairs."""
        return len(self.from_index)

    @property
    def weighted(self) -> "Pairs":
        """The pairs with a weight above zero."""
        some = self.weight > 0
        rotation = None if self.rotation is None else self.rotation[some]
        return Pairs(self.from_index[some], self.to_index[some], self.weight[some], rotation, self.source)


def pairs_from_labels(observations: Observations) -> Pairs:
    """The paper's pairs (footnote 7): equal end distances, end rotations that differ by 120° (300° and 60° do not), in both
    directions, each of weight one. Raises InputError where the labels are missing or contain no such pair."""
    distance, rotation = observations.end_distance, observations.end_rotation
    for key, label in (("end_distance_mm", distance), ("end_rotation_deg", rotation)):
        if label is None:
            raise InputError(observations.source, key, "missing, so that there are no pairs for the dynamic objective",
                             "add the labels, or give pairs")
    same = np.abs(distance[:, None] - distance) < SAME
    apart = np.abs(np.abs(rotation[:, None] - rotation) - APART_DEG) < SAME
    x, y = np.nonzero(same & apart)
    if not len(x):
        raise InputError(observations.source, "end_rotation_deg",
                         f"no two observations of the same end distance are {APART_DEG:g} degrees apart",
                         "give pairs")
    return Pairs(x, y, np.ones(len(x)), np.radians(rotation[y] - rotation[x]), f"labels of {observations.source}")


def load_pairs(path: Path, observations: Observations) -> Pairs:
    """The pairs of a CSV file with the columns ``from,to[,weight][,rotation_deg]``, rows of ``observations``.

    Without weights each pair has weight one; without rotations the far frame turned by the difference of the labels
    ``end_rotation``, if observations have them. Raises InputError for unreadable files, other columns, entries that are no
    numbers or no rows, and as :class:`Pairs` does.
    """
    if Path(path).suffix != ".csv":
        raise InputError(path, "file", f"suffix {Path(path).suffix!r}", "name a .csv file")
    columns = read_arrays(path, {name: ((), (name,)) for name in COLUMNS})
    ends = []
    for name in COLUMNS[:2]:
        if name not in columns:
            raise InputError(path, name, "the column is missing", "give the columns from,to[,weight][,rotation_deg]")
        rows = columns[name]
        wrong = np.flatnonzero(~((rows >= 0) & (rows < observations.count) & (rows == np.floor(rows))))
        if len(wrong):
            raise InputError(path, name, f"{rows[wrong[0]]:g} in line {wrong[0] + 2} is no observation",
                             f"give whole numbers from 0 to {observations.count - 1}")
        ends.append(rows.astype(np.int64))
    x, y = ends
    rotation = None
    if "rotation_deg" in columns:
        rotation = np.radians(columns["rotation_deg"])
    elif observations.end_rotation is not None:
        rotation = np.radians(observations.end_rotation[y] - observations.end_rotation[x])
    return Pairs(x, y, columns.get("weight", np.ones(len(x))), rotation, str(path))


def save_pairs(path: Path, pairs: Pairs) -> None:
    """Write ``pairs`` to a CSV file that :func:`load_pairs` reads."""
    columns = [pairs.from_index, pairs.to_index, pairs.weight]
    if pairs.rotation is not None:
        columns.append(np.degrees(pairs.rotation))
    rows = [COLUMNS[:len(columns)], *zip(*(column.tolist() for column in columns), strict=True)]
    text = "".join(",".join(map(str, row)) + "\n" for row in rows)
    write_whole(Path(path), lambda file: file.write(text.encode()))


def check_ways(pairs: Pairs, clamps: Clamps) -> None:
    """Raise InputError where a clamp turns by half a turn, and neither its frames nor a rotation determine the direction.

    clamps  (D) of the observations
    """
    ends = {"start": (clamps.start, clamps.start_frame), "end": (clamps.end, clamps.end_frame)}
    if pairs.rotation is not None:
        del ends["end"]
    for name, (kind, frame) in ends.items():
        kind = np.broadcast_to(kind, len(frame))[pairs.to_index]
        before, after = frame[pairs.from_index], frame[pairs.to_index]
        along = np.sum(before[..., 0] * after[..., 0], axis=-1)
        # The trace of a rotation is 1 + 2 cos of its angle.
        cosine = np.where(kind == Clamp.FRAME, 0.5 * (np.sum(before * after, axis=(-2, -1)) - 1), along)
        unclear = np.flatnonzero((kind >= Clamp.TANGENT) & (cosine < -np.cos(HALF_TURN)))
        if len(unclear):
            x, y = pairs.from_index[unclear[0]], pairs.to_index[unclear[0]]
            remedy = "give rotation_deg, or end_rotation_deg" if name == "end" else "leave the pair out"
            raise InputError(pairs.source, "from, to",
                             f"from {x} to {y} the {name} turns by half a turn, which has two directions", remedy)
