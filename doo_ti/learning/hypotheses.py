"""Hypotheses about unrecorded properties of an observation: its whole turns, and the roll of its clamps (§III-B).

Every hypothesis is a rod of its own. At the end of a sweep each observation keeps the one with the smallest distance, the same
in all cells, unless the data do not distinguish them.

Axes: D observations, H hypotheses of all of them, M those of one observation, G cells.
"""

from dataclasses import dataclass

import numpy as np

from doo_ti.rod.observations import Observations
from doo_ti.rod.start import held_spins, start_configuration, turn_hypotheses
from doo_ti.rod.types import Clamp, Clamps, Configuration
from doo_ti.system.errors import InputError

NEAR = 1.05
"""Cells, and hypotheses, whose distance is at most this many times the smallest count as equally good."""
UNSOUND = 1e9
"""mm added to the distance of a rod that is no certified minimum: it is chosen only where all are none."""
ROUNDS = 50


@dataclass(frozen=True)
class Hypotheses:
    """The rods to start, those of an observation in succession.

    observation  (H,) the observation that each is about
    turns        (H,) whole turns, added to the angle in (−π, π] between the frames
    spin         (H,) rad, the angle between the frames that fixes an unknown roll, or None: such ends turn freely
    """

    observation: np.ndarray
    turns: np.ndarray
    spin: np.ndarray | None = None

    @property
    def count(self) -> int:
        """H, the number of hypotheses."""
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
        """The hypotheses named by ``index``, in that order."""
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
