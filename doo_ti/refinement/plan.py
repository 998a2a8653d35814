"""Which configurations to measure: how strongly each informs α, β and μ, and in which order they narrow Θ down most.

At an equilibrium the sensitivity J = ∂x*/∂log Θ is how far the marks move when a parameter grows by a factor e. Θ is not
known before the experiment, so J is computed in every cell of a grid, the prior: a rod close to a snap in one cell must
not dominate.

How fast Θ is narrowed down depends on what else is unknown. So configurations are ranked with the model that ``refine`` fits,
with clips of unknown length, rest curvature and clamp errors (:mod:`doo_ti.refinement`) integrated out; in some cells of the
grid, evenly spread.

Axes: G grid cells, C cells of those, D configurations, P parameters, Q of them unknown, U unknowns with those first, K picks.
"""

from dataclasses import dataclass, replace
from warnings import catch_warnings, simplefilter

import numpy as np

from doo_ti.contact.surroundings import Surroundings
from doo_ti.io.scene import Synthesis
from doo_ti.lab.synthesis import synthesise
from doo_ti.refinement.evidence import integrated
from doo_ti.refinement.held_rod import HeldRod
from doo_ti.refinement.refine import FEWEST_EDGES, MOST_EDGES
from doo_ti.refinement.residuals import Comparison
from doo_ti.refinement.search import theta_of_cell
from doo_ti.refinement.theta import typical_scales
from doo_ti.refinement.unknowns import Unknowns
from doo_ti.relaxation.contact_table import require_clear
from doo_ti.relaxation.newton import Newton
from doo_ti.relaxation.relax import relax
from doo_ti.relaxation.sensitivity import sensitivity
from doo_ti.rod.grid import Grid
from doo_ti.rod.observations import LEAST_SIGMA_MM, MOST_SIGMA_MM, Observations
from doo_ti.rod.start import check_experiment, observation_clamps, start_configuration, turn_hypotheses
from doo_ti.rod.types import Clamp
from doo_ti.system.errors import InputError
from doo_ti.system.terminal import progress

CHUNK_RODS = 4096
MOST_RODS = 1_000_000
MOST_CELLS = 24  # cells in which the information about all unknowns is computed


@dataclass(frozen=True)
class Plan:
    """How informative each configuration is."""

    parameters: tuple[str, ...]  # names of Θ's parameters: bend, or bend_1 and bend_2, then twist and weight
    # (D, P) mm by which a mark moves, root mean square over the rod, when the parameter grows by a factor e: the median over
    # the grid. NaN where no cell gives an equilibrium
    strength: np.ndarray
    total: np.ndarray  # (D,) mm, the same over all parameters that the grid varies, together: root of the sum of squares
    order: np.ndarray  # (K,) rows of the configurations, the one to measure first at the front
    # (K,) volume of the confidence region after measuring so many of them, relative to the prior's (geometric mean over the
    # grid)
    volume: np.ndarray
    sensed: np.ndarray  # (D,) cells in which the rod has a certified equilibrium; the other cells do not count
    cells: int  # G
    # (C, D, U, U) of one measurement about all unknowns, the logarithms of the Q parameters in ``asked`` first; zero where the
    # rod has no certified equilibrium
    information: np.ndarray
    prior: np.ndarray  # (U, U) information about them before any measurement
    asked: tuple[int, ...]  # indices of the parameters that the grid varies

    @property
    def least(self) -> int:
        """The least informative configuration; one without equilibrium in any cell is not informative at all."""
        return int(np.argmin(np.nan_to_num(self.total)))


def planned(synthesis: Synthesis) -> Observations:
    """The configurations of a planned experiment: every end distance with every end rotation of the recipe.

    They are computed with the fitted model, straight at rest and without label noise, for the recipe's Θ: a guess, which only
    decides the branch that each rod is on. Raises InterruptedRunError where the rod cannot be carried there.
    """
    spacing = synthesis.length_mm / (synthesis.marks - 1)
    return synthesise(replace(
        synthesis, fine_edge_mm=spacing, clip_mm=spacing, rest_curvature_rms_per_mm=0.0, label_noise_mm=0.0,
        clip_tilt_deg=0.0, clip_offset_mm=0.0, clip_scatter_deg=0.0))


def plan(
    configurations: Observations, grid: Grid, *, sigma: float, picks: int = 10, clamp_start: Clamp | None = None,
    clamp_end: Clamp | None = None, measured=(), surroundings: Surroundings = Surroundings(),
) -> Plan:
    """Rank ``configurations``, observed or planned, by how much measuring them would reduce the uncertainty of Θ.

    configurations  clamps and shapes to start from, as for a sweep
    grid            the prior: Θ is in one of its cells, each as likely as the others
    sigma           label uncertainty, mm
    picks           K, configurations to rank, none twice
    measured        rows that are already measured: their information counts, and they are not ranked
    surroundings    what the rods touch, with one row for all configurations or one for each

    Greedy Bayesian D-optimality: the next configuration maximises the mean over the cells of log det (prior precision +
    information) of the logarithms of the parameters that the grid varies, with a prior as wide as the grid; all other unknowns
    of ``refine`` are integrated out. Raises InputError for wrong input, and for configurations inside obstacles.
    """
    clamps = observation_clamps(configurations, clamp_start, clamp_end)
    check_experiment(configurations, clamps, grid.axes[-1].values[-1], 0.0)
    if not LEAST_SIGMA_MM <= sigma <= MOST_SIGMA_MM:
        raise InputError("plan", "sigma", f"{sigma:g} mm",
                         f"give a label uncertainty of {LEAST_SIGMA_MM:g} to {MOST_SIGMA_MM:g} mm")
    if configurations.count * grid.size > MOST_RODS:
        raise InputError(grid.source, "grid", f"{grid.size:,} cells for {configurations.count} configurations",
                         f"give at most {MOST_RODS // configurations.count:,} cells: a plan needs no fine grid")
    parameters = ("bend", "twist", "weight") if grid.is_isotropic else ("bend_1", "bend_2", "twist", "weight")
    asked = _asked(grid, parameters)
    moved = _moved(configurations, clamps, grid, parameters, surroundings)
    marks = configurations.valid.sum(axis=1)[:, None]
    squares = np.einsum("gdpp->gdp", moved) / marks
    with catch_warnings():
        simplefilter("ignore", RuntimeWarning)  # where no cell gives an equilibrium
        strength = np.sqrt(np.nanmedian(squares, axis=0))
        total = np.sqrt(np.nanmedian(squares[..., asked].sum(axis=-1), axis=0))
    sensed = np.isfinite(moved).all(axis=(2, 3))
    names = tuple(parameters[k] for k in asked)
    seen = replace(configurations, sigma=np.array(sigma))
    information, prior = _information(seen, clamps, grid, names, surroundings)
    order, volume = _greedy(information, prior, len(asked), list(measured), picks)
    return Plan(parameters, strength, total, order, volume, sensed.sum(axis=0), grid.size, information, prior, asked)


def _asked(grid: Grid, parameters: tuple[str, ...]) -> tuple[int, ...]:
    """The parameters that vary over the grid. Raises InputError where none does, or all do, as they share a scale."""
    values = _values(grid, slice(None), parameters)
    asked = tuple(np.flatnonzero(np.ptp(values, axis=0) > 0).tolist())
    if not asked:
        raise InputError(grid.source, "grid", "a single cell, so nothing is unknown", "give at least one range LO:HI:N")
    if len(asked) == len(parameters):
        raise InputError(grid.source, "weight", "varied beside all others", "only ratios matter: keep one parameter fixed")
    logs = np.log(values[:, list(asked)])
    if np.linalg.matrix_rank(logs - logs.mean(axis=0), tol=1e-9) < len(asked):
        raise InputError(grid.source, "twist", "proportional to bend, so that observations cannot separate them",
                         "give `twist` or `GJ` a number, or `twist_ratio` a range")
    return asked


def _moved(configurations: Observations, clamps, grid: Grid, parameters, surroundings: Surroundings) -> np.ndarray:
    """(G, D, P, P) Jᵀ J over the valid marks, mm², NaN where a rod has no certified equilibrium."""
    index, turns = turn_hypotheses(configurations, clamps)
    if len(index) > configurations.count:
        # The whole turns of a rod that is not measured yet are unknown: take none.
        turns = np.zeros(configurations.count, dtype=np.int64)
    starts = start_configuration(configurations, clamps, turns)
    count = configurations.count
    if surroundings:
        require_clear(configurations.source, surroundings, clamps, starts, np.arange(count))
    step = max(1, CHUNK_RODS // count)
    moved = np.empty((grid.size, count, len(parameters), len(parameters)))
    with progress() as bar:
        task = bar.add_task("sensitivities", total=grid.size, unit="cells")
        for first in range(0, grid.size, step):
            last = min(first + step, grid.size)
            cell, row = np.divmod(np.arange((last - first) * count), count)
            solution = relax(starts, grid.materials(slice(first, last)), clamps, Newton(), up=configurations.up,
                             configuration_index=row, material_index=cell, **surroundings.take(row).arguments)
            found = sensitivity(solution, parameters, rotations=False, loads=False)
            values = _values(grid, slice(first, last), parameters)[cell]
            scaled = found.vertices * values[:, None, None] * configurations.valid[row][:, :, None, None]
            scaled[~found.usable] = np.nan
            moved[first:last] = np.einsum("rvip,rviq->rpq", scaled, scaled).reshape(last - first, count, *moved.shape[2:])
            bar.advance(task, last - first)
    return moved


def _values(grid: Grid, cells: slice, parameters) -> np.ndarray:
    """(G, P) the parameters' values in ``cells``."""
    values = grid.cell_values(cells)
    return np.stack([values["bend_1" if name == "bend" else name] for name in parameters], axis=-1)


def _information(seen: Observations, clamps, grid: Grid, names: tuple[str, ...], surroundings: Surroundings
                 ) -> tuple[np.ndarray, np.ndarray]:
    """(C, D, U, U) of each configuration about the unknowns of ``refine``, and their prior (U, U), that of ``names`` as wide as
    the grid."""
    rod = HeldRod(seen, clamps, int(np.clip(2 * seen.edges, FEWEST_EDGES, MOST_EDGES)), surroundings)
    unknowns = Unknowns(rod, names)
    comparison = Comparison.of(unknowns, with_frames=False)
    scales = typical_scales(rod.length, float(np.median(seen.rest_length)), set(), {"marks": 1.0})
    cells = np.unique(np.linspace(0, grid.size - 1, min(grid.size, MOST_CELLS)).round().astype(int))
    found = []
    with progress() as bar:
        task = bar.add_task("information", total=len(cells), unit="cells")
        for cell in cells:
            theta = theta_of_cell(grid, cell, seen.up)
            values = unknowns.begun(theta, unknowns.clip_prior)
            solution = rod.relaxed(*unknowns.model(values), Newton())
            sound = solution.converged & solution.stable
            linear, _ = comparison.linear(solution, values, sound)
            found.append(integrated(unknowns, linear, scales)[0])
            bar.advance(task, 1)
    prior, _ = unknowns.precision(scales)
    logs = np.log(_values(grid, slice(None), names))
    prior[: len(names), : len(names)] = np.linalg.inv(np.atleast_2d(np.cov(logs.T)))
    return np.stack(found), prior


def _greedy(information: np.ndarray, prior: np.ndarray, asked: int, measured: list[int], picks: int):
    """(K,) rows in the order of a greedy search, and (K,) the volume of the confidence region of the first ``asked`` unknowns,
    relative to that at the beginning."""
    def about(known: np.ndarray) -> np.ndarray:
        """ln det of the information about the asked unknowns, the others integrated out."""
        return np.linalg.slogdet(known)[1] - np.linalg.slogdet(known[..., asked:, asked:])[1]

    known = prior + information[:, measured].sum(axis=1)
    begun = about(known).mean()
    left = [row for row in range(information.shape[1]) if row not in set(measured)]
    order, volume = [], []
    for _ in range(min(picks, len(left))):
        gain = np.mean([about(cell + rows[left]) for cell, rows in zip(known, information, strict=True)], axis=0)
        best = int(np.argmax(gain))
        order.append(left.pop(best))
        known = known + information[:, order[-1]]
        volume.append(np.exp(0.5 * (begun - gain[best])))
    return np.array(order, dtype=np.int64), np.array(volume)
