"""An experiment: the observations, the grid to search, the options of relaxation and comparison, the terms of the objective;
and its rods, those of Eqs. 2 and 3, relaxed cell by cell (§III-E): rows of numbers as the run's files hold them, and shapes.

Axes: G cells or materials, D observations, H hypotheses of all observations, N rods of each cell, R = G·N rods, cell by cell.
"""

from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from doo_ti.contact.obstacle_file import described
from doo_ti.contact.surroundings import Surroundings
from doo_ti.learning.chunks import chunk_path, read_columns, read_rows, write_rows
from doo_ti.learning.terms import (
    Hypotheses,
    Pairs,
    check_ways,
    hypotheses_of,
    nearest,
    pairs_from_labels,
    resolved,
    scores,
    started,
)
from doo_ti.motion.journey import Journey
from doo_ti.motion.path import motion_between
from doo_ti.relaxation.contact_table import require_clear
from doo_ti.relaxation.descent import Descent
from doo_ti.relaxation.newton import Newton
from doo_ti.relaxation.relax import PRECISIONS, relax
from doo_ti.rod.grid import Grid
from doo_ti.rod.metric import distance
from doo_ti.rod.observations import Observations
from doo_ti.rod.start import observation_clamps
from doo_ti.rod.types import LARGEST, Clamp, Clamps, Configuration, Material, Solution, Status, sticky
from doo_ti.system.arguments import typed
from doo_ti.system.errors import InputError, require_whole

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
        if not 0 <= self.frame_weight <= LARGEST:
            raise InputError("sweep", "frame_weight", f"{self.frame_weight!r} is no length", "give zero or more mm")
        if not LEAST_SUB_STEP <= self.sub_step <= np.pi:
            raise InputError("sweep", "sub_step", f"{self.sub_step!r}", f"give radians from {LEAST_SUB_STEP:g} to pi")
        require_whole("sweep", "spins", self.spins, 0)
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
            check_ways(self.pairs, self.clamps)
        clamps = self.clamps
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
            starts, held = self.started
            require_clear(self.observations.source, self.options.surroundings, held, starts, self.hypotheses.observation)

    @cached_property
    def clamps(self) -> Clamps:
        """C of each observation; unknown rolls are not held."""
        return observation_clamps(self.observations, self.options.clamp_start, self.options.clamp_end)

    @property
    def started(self) -> tuple[Configuration, Clamps]:
        """The starts of the H rods, and their clamps."""
        return started(self.observations, self.clamps, self.hypotheses)

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


# --- its rods --------------------------------------------------------------------------------------------------------------

FEW_RODS = 64  # enough for the kernels of large batches: fewer rods have kernels with fewer of them in a value
RESULTS = ("energy", "residual", "iterations", "status", "stable", "precision")  # arrays of a solution that become columns


def relaxed(experiment: Experiment, materials: Material) -> Solution:
    """Γ̃^x of Eq. 2: each hypothesis under each material, G·H rods."""
    (starts, clamps), options = experiment.started, experiment.options
    of_material, hypothesis = np.divmod(np.arange(materials.count * starts.count), starts.count)
    return relax(starts, materials, clamps, options.solver, up=experiment.observations.up, precision=options.precision,
                 configuration_index=hypothesis, material_index=of_material, **options.surroundings.arguments)


def load_kernels(experiment: Experiment) -> None:
    """Relax a few rods, which compiles the kernels of a sweep, or loads them where they were compiled before."""
    hypotheses = experiment.hypotheses
    few = hypotheses.take(np.resize(np.arange(hypotheses.count), FEW_RODS))
    relaxed(replace(experiment, hypotheses=few), experiment.grid.materials(slice(0, 1)))


def carried(experiment: Experiment, materials: Material) -> tuple[Solution, np.ndarray, np.ndarray]:
    """Γ̃^xy of Eq. 3, R rods; the number of jumps of each (R,); and the distance of Γ̃^x from Γ^x (R,), Eq. 1 in mm."""
    begin, rows = _relaxed_once(experiment, materials)
    solution, jumps = journey(experiment, materials).end(begin.configuration.take(rows))
    first = np.tile(experiment.hypotheses.observation, materials.count)
    off = distance(begin.configuration, experiment.observations, first, experiment.options.frame_weight)
    status, iterations = sticky(begin.status[rows], solution.status), begin.iterations[rows] + solution.iterations
    return replace(solution, status=status, iterations=iterations), jumps, off[rows]


def sub_steps(experiment: Experiment, material: Material) -> Iterator[tuple[Configuration, np.ndarray, np.ndarray, np.ndarray]]:
    """Configuration, energy, residual and status (N,) of the rods of Eq. 3 under one material: before their motion, after each
    sub-step, and at the end."""
    begin, rows = _relaxed_once(experiment, material)
    there = begin.configuration.take(rows)
    yield there, begin.energy[rows], begin.residual[rows], begin.status[rows]
    for solution in journey(experiment, material).follow(there):
        yield solution.configuration, solution.energy, solution.residual, solution.status


def iterations(experiment: Experiment, material: Material, most: int) -> Iterator[tuple]:
    """As :func:`sub_steps` the rods of Eq. 2 at their starts, then after 1, 2, … iterations of Newton, ``most`` of them. A
    relaxation stopped after k iterations equals the first k of the whole one."""
    starts, clamps = experiment.started
    nothing = np.full(starts.count, np.nan)
    yield starts, nothing, nothing, None
    for count in range(1, most + 1):
        solution = relax(starts, material, clamps, Newton(max_iterations=count), up=experiment.observations.up,
                         **experiment.options.surroundings.arguments)
        yield solution.configuration, solution.energy, solution.residual, solution.status
        if (solution.iterations < count).all():
            return


def journey(experiment: Experiment, materials: Material) -> Journey:
    """The motions from C^x to C^y of the pairs, one for each hypothesis of x."""
    pairs, options, observations = experiment.pairs, experiment.options, experiment.observations
    hypothesis, term = experiment.rods
    rotation = None if pairs.rotation is None else pairs.rotation[term]
    motion = motion_between(experiment.started[1].take(hypothesis), experiment.clamps.take(pairs.to_index[term]), rotation)
    return Journey(motion, materials, options.sub_step, observations.rest_length, observations.up, options.solver,
                   options.precision, options.surroundings)


def relax_cells(experiment: Experiment, first: int, last: int) -> tuple[dict[str, np.ndarray], Configuration]:
    """The rows of cells ``first`` to ``last`` as their files hold them, columns by name, and the rods, aligned.

    Cell by cell, then observation by observation under Eq. 2 and pair by pair under Eq. 3. Of several hypotheses of an
    observation each cell holds the nearest one; the column ``turns`` says which.
    """
    columns, rods = relax_hypotheses(experiment, first, last)
    if not experiment.hypotheses.are_several:
        return columns, rods
    rows = experiment.rows_of(_nearest(experiment, columns))
    return {name: column[rows] for name, column in columns.items()}, rods.take(rows)


def relax_hypotheses(experiment: Experiment, first: int, last: int) -> tuple[dict[str, np.ndarray], Configuration]:
    """As :func:`relax_cells`, with a row for each hypothesis."""
    observations, grid, pairs = experiment.observations, experiment.grid, experiment.pairs
    hypothesis, term = experiment.rods
    cells, rods = last - first, len(hypothesis)
    of_cell, of_rod = np.divmod(np.arange(cells * rods), rods)
    materials = grid.materials(slice(first, last))
    if pairs is None:
        solution, observation = relaxed(experiment, materials), term
    else:
        solution, jumps, off = carried(experiment, materials)
        observation = pairs.to_index[term]
    own = observation[of_rod]
    columns = {name: values[of_cell] for name, values in grid.cell_values(slice(first, last)).items()}
    if pairs is not None:
        columns["from_observation"] = pairs.from_index[term].astype(np.int32)[of_rod]
    columns["observation"] = own.astype(np.int32)
    columns["turns"] = experiment.hypotheses.turns[hypothesis].astype(np.int32)[of_rod]
    if experiment.hypotheses.spin is not None:
        columns["spin_deg"] = np.degrees(experiment.hypotheses.spin[hypothesis])[of_rod]
    for name, labels in (("end_distance_mm", observations.end_distance), ("end_rotation_deg", observations.end_rotation)):
        columns[name] = np.full(len(own), np.nan) if labels is None else labels[own]
    columns["distance_mm"] = distance(solution.configuration, observations, own, experiment.options.frame_weight)
    columns |= {name: getattr(solution, name) for name in RESULTS}
    if pairs is not None:
        columns |= {"start_distance_mm": off, "jumps": jumps, "pair_weight": pairs.weight[term][of_rod]}
    return columns, solution.configuration


def are_certified(columns: dict[str, np.ndarray]) -> np.ndarray:
    """(R,) bool: whether the rods of :func:`relax_cells` are certified minima."""
    return (columns["status"] == Status.CONVERGED) & columns["stable"]


def with_nearest_turns(experiment: Experiment, cell: int) -> Experiment:
    """The experiment with one hypothesis for each observation: the nearest in that cell."""
    if not experiment.hypotheses.are_several:
        return experiment
    chosen, = _nearest(experiment, relax_hypotheses(experiment, cell, cell + 1)[0])
    return replace(experiment, hypotheses=experiment.hypotheses.take(chosen))


def resolve(run: Path, experiment: Experiment, chunks: list[tuple[int, int]]) -> dict:
    """Choose one hypothesis for each observation, the same in all cells, and write its rows of RUN/hypotheses into RUN/cells;
    returns the choice as JSON holds it.

    ``kept`` are the hypotheses of all observations: one, or of an ambiguous observation all that it has.
    """
    hypotheses, (of_rod, _) = experiment.hypotheses, experiment.rods
    names = [experiment.decides, "status", "stable"]
    of_chunks = (_by_cell(experiment, read_columns(chunk_path(run, "hypotheses", *chunk), names)) for chunk in chunks)
    score = scores(*map(np.concatenate, zip(*of_chunks, strict=True)), experiment.weight, of_rod)
    observation, table = hypotheses.table
    weight = np.ones(len(table))
    if experiment.pairs is not None:
        weight = np.bincount(experiment.pairs.from_index, experiment.pairs.weight)[observation]
    chosen, ambiguous = resolved(*score, weight, hypotheses)
    for first, last in chunks:
        rows = read_rows(chunk_path(run, "hypotheses", first, last))
        write_rows(chunk_path(run, "cells", first, last), rows.take(experiment.rows_of(chosen[first:last])))
    kept = np.isin(hypotheses.observation, observation[ambiguous]) | np.isin(np.arange(hypotheses.count), chosen[0])
    return {"hypotheses": hypotheses.count, "resolved": int((~ambiguous).sum()), "ambiguous": observation[ambiguous].tolist(),
            "kept": hypotheses.take(kept).as_dict()}


def _relaxed_once(experiment: Experiment, materials: Material) -> tuple[Solution, np.ndarray]:
    """Γ̃^x, each (material, hypothesis) once, and for each of the R rods its row (R,)."""
    hypothesis, _ = experiment.rods
    rows = np.arange(materials.count)[:, None] * experiment.hypotheses.count + hypothesis
    return relaxed(experiment, materials), rows.ravel()


def _nearest(experiment: Experiment, columns: dict[str, np.ndarray]) -> np.ndarray:
    """(G, D) the hypothesis of each observation that is nearest in each cell of ``columns``."""
    score = scores(*_by_cell(experiment, columns), experiment.weight, experiment.rods[0])
    return nearest(*score, experiment.hypotheses)


def _by_cell(experiment: Experiment, columns: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """(G, N) the distance that decides between hypotheses, mm, and whether the rod is a certified minimum."""
    shape = -1, len(experiment.rods[0])
    return columns[experiment.decides].reshape(shape), are_certified(columns).reshape(shape)
