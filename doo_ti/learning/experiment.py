"""An experiment: the observations, the grid to search, the options of relaxation and comparison, the terms of the objective
(§III-E), and hypotheses about what was not recorded of an observation: its whole turns, and the roll of its clamps (§III-B).

Every hypothesis is a rod of its own. At the end of a sweep each observation keeps the one with the smallest distance, the same
in all cells, unless the data do not distinguish them.

Axes: G cells, D observations, H hypotheses of all observations, M of one, P pairs, N rods of each cell.
"""

from dataclasses import asdict, dataclass, fields
from functools import cached_property

import numpy as np

from doo_ti.contact.obstacle_file import described
from doo_ti.contact.surroundings import Surroundings
from doo_ti.learning.pairs import Pairs, check_ways, pairs_from_labels
from doo_ti.relaxation.contact_table import require_clear
from doo_ti.relaxation.descent import Descent
from doo_ti.relaxation.newton import Newton
from doo_ti.relaxation.relax import PRECISIONS
from doo_ti.rod.grid import Grid
from doo_ti.rod.observations import Observations
from doo_ti.rod.start import held_spins, observation_clamps, start_configuration, turn_hypotheses
from doo_ti.rod.types import LARGEST, Clamp, Clamps, Configuration
from doo_ti.system.arguments import typed
from doo_ti.system.errors import InputError, require_number, require_whole

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


SOLVERS = {"newton": Newton, "descent": Descent}
LEAST_SUB_STEP = 1e-5  # rad: smaller sub-steps change no result and take too long


@typed
@dataclass(frozen=True)
class SweepOptions:
    """Options of a sweep.

    frame_weight           w_m of Eq. 1, mm
    clamp_start, clamp_end what each clamp holds; None: the frame where it is given, else the tangent
    solver, precision      as :func:`doo_ti.relaxation.relax.relax` takes them
    objective              "static" (Eq. 2) or "dynamic" (Eq. 3)
    spins                  roll angles, evenly over a turn, to try for a clamp whose roll was not measured; 0: it turns freely
    sub_step               rad, the largest turn of a clamp in one sub-step of Eq. 3; its shift is limited in proportion
    seed                   kept for the provenance: a sweep itself uses no random numbers
    surroundings           what the observed rods lie on or touch, the same for all, and their radius
    workers                processes that share the chunks; None: this one. The result does not depend on it
    scheduler              address of a Dask scheduler whose workers share the chunks instead
    """

    frame_weight: float = 0.0
    clamp_start: Clamp | None = None
    clamp_end: Clamp | None = None
    solver: Newton | Descent = Newton()
    precision: str = "mixed"
    objective: str = "static"
    spins: int = 0
    sub_step: float = np.radians(10.0).item()
    seed: int = 0
    surroundings: Surroundings = Surroundings()
    workers: int | None = None
    scheduler: str | None = None

    def __post_init__(self) -> None:
        require_number("sweep", "frame_weight", self.frame_weight)
        require_number("sweep", "sub_step", self.sub_step)
        if not 0 <= self.frame_weight <= LARGEST:
            raise InputError("sweep", "frame_weight", f"{self.frame_weight!r} is no length", "give zero or more mm")
        if not LEAST_SUB_STEP <= self.sub_step <= np.pi:
            raise InputError("sweep", "sub_step", f"{self.sub_step!r}", f"give radians from {LEAST_SUB_STEP:g} to pi")
        require_whole("sweep", "spins", self.spins, 0)
        require_number("sweep", "seed", self.seed)
        around = self.surroundings
        if around and isinstance(self.solver, Descent):
            raise InputError("sweep", "solver", "Descent cannot use obstacles", "give Newton()")
        if around and (np.size(around.radius) != 1 or any(obstacle.count > 1 for obstacle in around.obstacles)):
            raise InputError("sweep", "obstacles", "other ones, or another radius, for each rod", "give the same to all rods")
        for name, allowed in (("precision", PRECISIONS), ("objective", ("static", "dynamic"))):
            if getattr(self, name) not in allowed:
                raise InputError("sweep", name, f"{getattr(self, name)!r}", f"give one of {', '.join(allowed)}")

    def as_dict(self) -> dict:
        """The options that cells depend on, as JSON holds them; :meth:`from_dict` reads them back."""
        kinds = {name: None if kind is None else Clamp(kind).name.lower()
                 for name, kind in (("clamp_start", self.clamp_start), ("clamp_end", self.clamp_end))}
        name = next(name for name, kind in SOLVERS.items() if isinstance(self.solver, kind))
        return {"frame_weight_mm": self.frame_weight, **kinds, "solver": {"name": name, **asdict(self.solver)},
                "precision": self.precision, "objective": self.objective, "spins": self.spins,
                "sub_step_rad": self.sub_step, **({"obstacles": described(self.surroundings)} if self.surroundings else {})}

    @classmethod
    def from_dict(cls, content: dict) -> "SweepOptions":
        """The options that :meth:`as_dict` wrote, without obstacles. Raises KeyError or TypeError where ``content`` holds
        none."""
        content = dict(content)
        solver = dict(content.pop("solver"))
        kinds = {name: None if content[name] is None else Clamp[content[name].upper()] for name in ("clamp_start", "clamp_end")}
        content |= {**kinds, "frame_weight": content["frame_weight_mm"], "sub_step": content["sub_step_rad"],
                    "solver": SOLVERS[solver.pop("name")](**solver)}
        return cls(**{field.name: content[field.name] for field in fields(cls) if field.name in content})


@dataclass(frozen=True)
class Experiment:
    """All that a sweep's cells depend on.

    Raises InputError for pairs under Eq. 2, for Eq. 3 without pairs or labels, for half turns of unknown direction, for
    ``spins`` where no roll is unknown, for two unknown rolls of a rod that is not round, and for rods inside obstacles.
    """

    observations: Observations
    grid: Grid
    options: SweepOptions = SweepOptions()
    pairs: Pairs | None = None  # the terms of Eq. 3, None under Eq. 2; by default those of the labels
    hypotheses: Hypotheses | None = None  # the rods of each observation; by default all that its labels allow

    def __post_init__(self) -> None:
        dynamic = self.options.objective == "dynamic"
        if self.pairs is not None and not dynamic:
            raise InputError(self.pairs.source, "pairs", "given, but the objective is static", "choose the dynamic objective")
        if dynamic:
            pairs = pairs_from_labels(self.observations) if self.pairs is None else self.pairs
            object.__setattr__(self, "pairs", pairs.weighted)
        clamps = self.clamps
        if dynamic:
            check_ways(self.pairs, clamps)
        both_unknown = np.broadcast_to(np.maximum(clamps.start, clamps.end) == Clamp.TANGENT, 1).any()
        if self.options.spins and both_unknown and not self.grid.is_isotropic:
            raise InputError(self.observations.source, "spins", "the rolls of both clamps are unknown and the rod is not round",
                             "give start_frame, or search over bend")
        if self.hypotheses is None:
            hypotheses = hypotheses_of(self.observations, clamps, self.options.spins)
            if dynamic:
                hypotheses = hypotheses.take(np.isin(hypotheses.observation, self.pairs.from_index))
            object.__setattr__(self, "hypotheses", hypotheses)
        if self.options.surroundings:
            starts, held = started(self.observations, clamps, self.hypotheses)
            require_clear(self.observations.source, self.options.surroundings, held, starts, self.hypotheses.observation)

    @cached_property
    def clamps(self) -> Clamps:
        """C of each observation; unknown rolls are not held."""
        return observation_clamps(self.observations, self.options.clamp_start, self.options.clamp_end)

    @cached_property
    def rods(self) -> tuple[np.ndarray, np.ndarray]:
        """(N,) hypothesis and (N,) term of each rod of a cell: the observation under Eq. 2, the pair under Eq. 3."""
        if self.pairs is None:
            return np.arange(self.hypotheses.count), self.hypotheses.observation
        term, hypothesis = np.nonzero(self.pairs.from_index[:, None] == self.hypotheses.observation)
        return hypothesis, term

    @property
    def terms(self) -> int:
        """D under Eq. 2, P under Eq. 3."""
        return self.observations.count if self.pairs is None else self.pairs.count

    @property
    def weight(self) -> np.ndarray:
        """(N,) w_xy of each rod, ones under Eq. 2."""
        hypothesis, term = self.rods
        return np.ones(len(term)) if self.pairs is None else self.pairs.weight[term]

    @property
    def decides(self) -> str:
        """The column that decides between hypotheses: the distance of the rod from the observation it starts from."""
        return "distance_mm" if self.pairs is None else "start_distance_mm"

    def rows_of(self, chosen: np.ndarray) -> np.ndarray:
        """The rows, of G·N rods, cell by cell, that belong to the hypotheses ``chosen`` (G, D) of each cell's observations."""
        of_rod, _ = self.rods
        observation, _ = self.hypotheses.table
        return np.flatnonzero(chosen[:, np.searchsorted(observation, self.hypotheses.observation[of_rod])] == of_rod)
