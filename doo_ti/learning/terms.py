"""Which rods a sweep relaxes (§III-E): pairs of observations, the terms of Eq. 3, from whose Γ^x the clamps move to C^y, with
the weight w_xy; and hypotheses about what was not recorded of an observation: its whole turns, and the roll of its clamps
(§III-B).

Every hypothesis is a rod of its own. At the end of a sweep each observation keeps the one with the smallest distance, the same
in all cells, unless the data do not distinguish them.

Axes: P pairs, G cells, D observations, H hypotheses of all observations, M of one, N rods of each cell.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np

from doo_ti.io.arrays import read_csv
from doo_ti.rod.frames import is_half_turn
from doo_ti.rod.observations import Observations
from doo_ti.rod.start import held_spins, start_configuration, turn_hypotheses
from doo_ti.rod.types import Clamp, Clamps, Configuration
from doo_ti.system.arguments import typed
from doo_ti.system.errors import InputError
from doo_ti.system.files import csv_text, write_text

APART_DEG = 120.0  # difference of the end rotations of the paper's pairs (footnote 7)
SAME = 1e-6  # labels closer than this, in mm or degrees, are the same
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
    table = read_csv(Path(path), COLUMNS[:2], COLUMNS[2:], form="from,to[,weight][,rotation_deg]")
    ends = []
    for name in COLUMNS[:2]:
        rows = table.whole(name)
        table.refuse(name, (rows < 0) | (rows >= observations.count), "is no observation",
                     f"give whole numbers from 0 to {observations.count - 1}")
        ends.append(rows)
    x, y = ends
    weight, turn = (table.numbers(name) if name in table.columns else None for name in COLUMNS[2:])
    rotation = None
    if turn is not None:
        rotation = np.radians(turn)
    elif observations.end_rotation is not None:
        rotation = np.radians(observations.end_rotation[y] - observations.end_rotation[x])
    return Pairs(x, y, np.ones(len(x)) if weight is None else weight, rotation, str(path))


def save_pairs(path: Path, pairs: Pairs) -> None:
    """Write ``pairs`` to a CSV file that :func:`load_pairs` reads."""
    columns = [pairs.from_index, pairs.to_index, pairs.weight]
    if pairs.rotation is not None:
        columns.append(np.degrees(pairs.rotation))
    write_text(Path(path), csv_text(COLUMNS[: len(columns)], zip(*columns, strict=True)))


def check_ways(pairs: Pairs, clamps: Clamps) -> None:
    """Raise InputError where a clamp turns by half a turn, and neither its frames nor a rotation determine the direction.

    clamps  (D) of the observations
    """
    ends = {"start": (clamps.start, clamps.start_frame), "end": (clamps.end, clamps.end_frame)}
    if pairs.rotation is not None:
        del ends["end"]
    for name, (kind, frame) in ends.items():
        kind = np.broadcast_to(kind, len(frame))[pairs.to_index]
        half = is_half_turn(frame[pairs.from_index], frame[pairs.to_index], kind == Clamp.FRAME)
        unclear = np.flatnonzero((kind >= Clamp.TANGENT) & half)
        if len(unclear):
            x, y = pairs.from_index[unclear[0]], pairs.to_index[unclear[0]]
            remedy = "give rotation_deg, or end_rotation_deg" if name == "end" else "leave the pair out"
            raise InputError(pairs.source, "from, to",
                             f"from {x} to {y} the {name} turns by half a turn, which has two directions", remedy)


# --- hypotheses ----------------------------------------------------------------------------------------------------------

NEAR = 1.05  # cells, and hypotheses, whose distance is at most this many times the smallest count as equally good
UNSOUND = 1e9  # mm added to the distance of a rod that is no certified minimum: it is chosen only where all are none
ROUNDS = 50


@dataclass(frozen=True)
class Hypotheses:
    """The rods to start, those of an observation in succession."""

    observation: np.ndarray  # (H,) the observation that each is about
    turns: np.ndarray  # (H,) whole turns, added to the angle in (−π, π] between the frames
    # (H,) rad, the angle between the frames that fixes an unknown roll, or None: such ends turn freely
    spin: np.ndarray | None = None

    @property
    def count(self) -> int:
        return len(self.observation)

    @property
    def are_several(self) -> bool:
        """Whether some observation has more than one hypothesis."""
        return bool((self.observation[1:] == self.observation[:-1]).any())

    @property
    def table(self) -> tuple[np.ndarray, np.ndarray]:
        """(D,) observations, and (D, M) their hypotheses, the first repeated where there are fewer."""
        observation, first, count = np.unique(self.observation, return_index=True, return_counts=True)
        rank = np.arange(count.max())
        return observation, first[:, None] + np.where(rank < count[:, None], rank, 0)

    def take(self, index) -> "Hypotheses":
        return Hypotheses(self.observation[index], self.turns[index], None if self.spin is None else self.spin[index])

    def as_dict(self) -> dict:
        """As JSON holds it; :meth:`from_dict` reads it back exactly."""
        return {"observation": self.observation.tolist(), "turns": self.turns.tolist(),
                "spin": None if self.spin is None else self.spin.tolist()}

    @classmethod
    def from_dict(cls, content: dict) -> "Hypotheses":
        spin = content["spin"]
        return cls(np.array(content["observation"]), np.array(content["turns"]), None if spin is None else np.array(spin))


def hypotheses_of(observations: Observations, clamps: Clamps, spins: int = 0) -> Hypotheses:
    """The hypotheses of D observations: the whole turns of :func:`doo_ti.rod.start.turn_hypotheses`, and ``spins`` angles,
    evenly over a turn, where a clamp holds the tangent and its roll is unknown.

    Raises InputError for ``spins`` where no roll is unknown.
    """
    if not spins:
        return Hypotheses(*turn_hypotheses(observations, clamps))
    kinds = np.broadcast_arrays(clamps.start, clamps.end)
    if not (np.minimum(*kinds) == Clamp.TANGENT).all() or observations.frames is not None:
        raise InputError(observations.source, "spins", "no end is held by its tangent alone, or frames were measured",
                         "leave spins out, or clamp the end by its tangent")
    index = np.repeat(np.arange(observations.count), spins)
    spin = np.tile(2 * np.pi * np.arange(spins) / spins, observations.count)
    observed = observations.take(index)
    rows, turns = turn_hypotheses(observed, held_spins(observed, clamps.take(index), spin))
    return Hypotheses(index[rows], turns, spin[rows])


def started(observations: Observations, clamps: Clamps, hypotheses: Hypotheses) -> tuple[Configuration, Clamps]:
    """The starts of the H rods, and their clamps."""
    observed, held = observations.take(hypotheses.observation), clamps.take(hypotheses.observation)
    if hypotheses.spin is not None:
        held = held_spins(observed, held, hypotheses.spin)
    return start_configuration(observed, held, hypotheses.turns), held


def scores(distance: np.ndarray, sound: np.ndarray, weight: np.ndarray, of_rod: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(G, H) mean distance of each hypothesis's rods, mm, by their ``weight``, and whether all are ``sound``.

    distance, sound  (G, N) of each cell's rods; NaN counts as infinity
    weight, of_rod   (N,) w_xy, and the hypothesis of each rod
    """
    order = np.argsort(of_rod, kind="stable")
    begins = np.flatnonzero(np.concatenate([[True], np.diff(of_rod[order]) != 0]))
    far = np.where(np.isnan(distance), np.inf, distance)[:, order]
    mean = np.add.reduceat(far * weight[order], begins, axis=1) / np.add.reduceat(weight[order], begins)
    return mean, np.logical_and.reduceat(sound[:, order], begins, axis=1)


def nearest(distance: np.ndarray, sound: np.ndarray, hypotheses: Hypotheses) -> np.ndarray:
    """(G, D) in each cell the hypothesis of each observation with the smallest score (G, H), among the sound ones where there
    are any; of equal ones the first."""
    _, table = hypotheses.table
    best = np.argmin(_far(distance, sound)[:, table], axis=-1)
    return np.take_along_axis(table[None], best[..., None], axis=-1)[..., 0]


def resolved(distance: np.ndarray, sound: np.ndarray, weight: np.ndarray, hypotheses: Hypotheses):
    """(G, D) the hypothesis of each observation, the same in all cells, and (D,) bool: the ambiguous ones, for which each cell
    has its nearest.

    distance, sound  (G, H) scores of the hypotheses
    weight           (D,) of each observation in a cell's mean

    Each observation takes the hypothesis with the smallest mean distance over the cells near the best one. That may change
    which cell is best: it is repeated until nothing changes. An observation is ambiguous where a second hypothesis is within
    5 %.
    """
    _, table = hypotheses.table
    far, rows = _far(distance, sound), np.arange(len(table))
    cellwise = chosen = nearest(distance, sound, hypotheses)
    ambiguous, before = np.zeros(len(table), dtype=bool), None
    for _ in range(ROUNDS):
        value = np.take_along_axis(np.where(sound, distance, np.inf), chosen, axis=1)
        useful = np.isfinite(value).any(axis=0)
        if not useful.any():
            return cellwise, np.ones(len(table), dtype=bool)
        mean = (value[:, useful] * weight[useful]).sum(axis=1) / weight[useful].sum()
        near = mean <= NEAR * mean.min()
        there = far[near][:, table].mean(axis=0)
        best = np.argmin(there, axis=1)
        smallest, winner = there[rows, best], table[rows, best]
        ambiguous = ((table != winner[:, None]) & ~(there > NEAR * smallest[:, None])).any(axis=1)
        decision = np.where(ambiguous, -1, winner)
        if before is not None and (decision == before).all():
            break
        chosen, before = np.where(ambiguous, cellwise, decision), decision
    return chosen, ambiguous


def _far(distance: np.ndarray, sound: np.ndarray) -> np.ndarray:
    return distance + np.where(sound, 0.0, UNSOUND)
