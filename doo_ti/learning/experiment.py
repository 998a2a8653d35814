"""An experiment: the observations, the grid to search, the options of relaxation and comparison, and the terms of the
objective (§III-E).

Axes: G cells, D observations, H hypotheses of all observations, P pairs, N rods of each cell.
"""

from dataclasses import asdict, dataclass, fields
from functools import cached_property

import numpy as np

from doo_ti.contact.obstacle_arrays import described
from doo_ti.contact.surroundings import Surroundings
from doo_ti.learning.hypotheses import Hypotheses, hypotheses_of, started
from doo_ti.learning.pairs import Pairs, check_ways, pairs_from_labels
from doo_ti.relaxation.contact_table import require_clear
from doo_ti.relaxation.descent import Descent
from doo_ti.relaxation.newton import Newton
from doo_ti.relaxation.relax import PRECISIONS
from doo_ti.rod.grid import Grid
from doo_ti.rod.observations import Observations
from doo_ti.rod.start import observation_clamps
from doo_ti.rod.types import LARGEST, Clamp, Clamps
from doo_ti.system.arguments import typed
from doo_ti.system.errors import InputError, require_number, require_whole

SOLVERS = {"newton": Newton, "descent": Descent}
LEAST_SUB_STEP = 1e-5
"""rad: smaller sub-steps change no result and take too long."""


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
        if self.surroundings:
            self._check_surroundings()
        for name, allowed in (("precision", PRECISIONS), ("objective", ("static", "dynamic"))):
            if getattr(self, name) not in allowed:
                raise InputError("sweep", name, f"{getattr(self, name)!r}", f"give one of {', '.join(allowed)}")

    def _check_surroundings(self) -> None:
        if isinstance(self.solver, Descent):
            raise InputError("sweep", "solver", "Descent cannot use obstacles", "give Newton()")
        if np.size(self.surroundings.radius) != 1 or any(obstacle.count > 1 for obstacle in self.surroundings.obstacles):
            raise InputError("sweep", "obstacles", "other ones, or another radius, for each rod", "give the same to all rods")

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

    pairs       the terms of Eq. 3, None under Eq. 2; by default those of the labels
    hypotheses  the rods of each observation; by default all that its labels allow

    Raises InputError for pairs under Eq. 2, for Eq. 3 without pairs or labels, for half turns of unknown direction, for
    ``spins`` where no roll is unknown, for two unknown rolls of a rod that is not round, and for rods inside obstacles.
    """

    observations: Observations
    grid: Grid
    options: SweepOptions = SweepOptions()
    pairs: Pairs | None = None
    hypotheses: Hypotheses | None = None

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
